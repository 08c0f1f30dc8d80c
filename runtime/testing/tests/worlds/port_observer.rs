//! Observer between the port of the machine and all its clients. It reports requests and answers to the
//! oracle.

use std::sync::Arc;
use std::time::Duration;

use plc_protocol::hub::{Filter, Subscription};
use plc_protocol::port::{BoxFuture, Port};
use plc_protocol::server::{Origin, ServedPort, ServerNotice, ServoTiming};
use plc_protocol::supervisor::Supervisor;
use plc_protocol::types::BootId;
use plc_protocol::types::command::Command;
use plc_protocol::types::message::Message;
use plc_protocol::types::request::{Answer, Refusal, Request};
use plc_protocol::types::topic::Topic;
use tandem_testing::simulated_disk::SimulatedDisk;

use super::oracle::SharedOracle;

pub(super) struct PortObserver {
    pub port: Arc<dyn ServedPort>,
    pub disk: SimulatedDisk,
    pub truth: SharedOracle,
    pub boot: BootId,
}

/// Data of a request that the oracle needs when the machine answers the request.
enum ObservedRequest {
    Claim(u8, u64, String),
    Reset(u8, u64, String, bool),
    Other,
}

impl ObservedRequest {
    fn from_request(request: &Request) -> Self {
        match request {
            Request::Claim(cs, _, claim) => Self::Claim(*cs, claim.seq, claim.handler_id.clone()),
            Request::Reset(cs, _, reset) => Self::Reset(
                *cs,
                reset.seq,
                reset.handler_id.clone(),
                reset.force == Some(true),
            ),
            _ => Self::Other,
        }
    }
}

impl PortObserver {
    fn before(&self, request: &Request) {
        if self.disk.is_dead() {
            return;
        }
        let mut truth = self.truth.lock();
        match request {
            Request::Command { cs, command, .. } => {
                let may_move = matches!(
                    command,
                    Command::Start
                        | Command::Resume
                        | Command::BackTrace { .. }
                        | Command::Mdi { .. }
                        | Command::Jog { .. }
                        | Command::Home { .. }
                );
                if may_move {
                    truth.commanded(*cs);
                }
            }
            Request::Handler(id, presence) if !presence.online => truth.record_handler_offline(id),
            _ => {}
        }
    }

    fn after(&self, asked: &ObservedRequest, answer: &Result<Answer, Refusal>) {
        let Ok(Answer::Handshake(result)) = answer else {
            return;
        };
        if self.disk.is_dead() {
            return;
        }
        let mut truth = self.truth.lock();
        match asked {
            ObservedRequest::Claim(cs, seq, handler) => truth.claimed(*cs, *seq, handler, result.status),
            ObservedRequest::Reset(cs, seq, handler, force) => {
                truth.reset((*cs, *seq), handler, *force, result.status);
            }
            ObservedRequest::Other => {}
        }
    }
}

impl Port for PortObserver {
    fn boot_id(&self) -> BootId {
        self.boot.clone()
    }

    fn read<'a>(&'a self, topic: &'a Topic) -> BoxFuture<'a, Option<Arc<Message>>> {
        self.port.read(topic)
    }

    fn subscribe(&self, filter: Filter) -> Subscription {
        self.port.subscribe(filter)
    }

    fn request(&self, request: Request) -> BoxFuture<'_, Result<Answer, Refusal>> {
        let asked = ObservedRequest::from_request(&request);
        Box::pin(async move {
            self.before(&request);
            let answer = self.port.request(request).await;
            self.after(&asked, &answer);
            answer
        })
    }

    fn sleep(&self, duration: Duration) -> BoxFuture<'_, ()> {
        self.port.sleep(duration)
    }

    fn now_s(&self) -> f64 {
        self.port.now_s()
    }
}

impl ServedPort for PortObserver {
    fn request_from(&self, origin: Origin, request: Request) -> BoxFuture<'_, Result<Answer, Refusal>> {
        let asked = ObservedRequest::from_request(&request);
        Box::pin(async move {
            self.before(&request);
            let answer = self.port.request_from(origin, request).await;
            self.after(&asked, &answer);
            answer
        })
    }

    fn notice(&self, notice: ServerNotice) {
        self.port.notice(notice);
    }

    fn republish(&self) -> BoxFuture<'_, ()> {
        self.port.republish()
    }

    fn time(&self) -> std::time::SystemTime {
        self.port.time()
    }

    fn servo_timing(&self) -> Option<ServoTiming> {
        self.port.servo_timing()
    }

    fn supervisor(&self) -> Supervisor {
        self.port.supervisor()
    }
}
