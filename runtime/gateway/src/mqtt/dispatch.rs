//! Asks the port what came in over MQTT, in the order of arrival, without waiting for its answers.

use std::future::poll_fn;
use std::sync::Arc;
use std::task::Poll;
use std::time::SystemTime;

use plc_api::server::{ServedPort, ServerNotice};
use plc_api::types::command::{CommandReply, CommandStatus};
use plc_api::types::message::{Message, Payload};
use plc_api::types::request::{Refusal, RefusalCode, Request};
use plc_api::types::topic::{CsTopic, Topic};
use plc_api::types::{CoordinateSystemNumber, Timestamp};
use tokio::sync::{Semaphore, mpsc};
use tracing::warn;

use crate::metrics::{Metrics, add};
use plc_api::wire::mqtt::{Inbound, sender};
use plc_api::wire::problem::code_word;

/// Requests that may be unanswered; more are refused, but for hold, stop and abort.
const UNANSWERED_MAX: usize = 256;

/// The same for hold, stop and abort.
const URGENT_MAX: usize = 64;

/// Replies of our own that wait to be published; more are dropped with a warning.
const REPLIES_MAX: usize = 256;

/// Asks the port.
pub(super) struct Dispatch {
    port: Arc<dyn ServedPort>,
    metrics: Arc<Metrics>,
    unanswered: Arc<Semaphore>,
    urgent: Arc<Semaphore>,
    replies: mpsc::Sender<Message>,
}

impl Dispatch {
    /// The second value gives the replies to commands that never became a request.
    pub(super) fn new(port: Arc<dyn ServedPort>, metrics: Arc<Metrics>) -> (Self, mpsc::Receiver<Message>) {
        let (replies, receiver) = mpsc::channel(REPLIES_MAX);
        let dispatch = Self {
            port,
            metrics,
            unanswered: Arc::new(Semaphore::new(UNANSWERED_MAX)),
            urgent: Arc::new(Semaphore::new(URGENT_MAX)),
            replies,
        };
        (dispatch, receiver)
    }

    /// Carries out what came in. Each request has reached the port before the next is begun, so that the port
    /// sees them in the order of arrival; a slow answer holds up nothing.
    pub(super) async fn take(&self, inbound: Inbound) {
        match inbound {
            Inbound::Ask { request, urgent } => self.ask(request, urgent).await,
            Inbound::Reject {
                cs,
                client_id,
                command_id,
                refusal,
            } => self.reject(cs, client_id, command_id, refusal).await,
            Inbound::Drop(text) => {
                add(&self.metrics.mqtt_refused, 1);
                warn!("{text}");
            }
        }
    }

    pub(super) async fn ask(&self, request: Request, urgent: bool) {
        let places = if urgent { &self.urgent } else { &self.unanswered };
        let Ok(place) = Arc::clone(places).try_acquire_owned() else {
            return self.too_many(request).await;
        };
        let port = Arc::clone(&self.port);
        // who names itself is answered by the port, on its reply topic, also with a refusal
        let is_told = sender(&request).is_some();
        let mut asking = Box::pin(async move {
            if let Err(refusal) = port.request(request).await
                && !is_told
            {
                warn!("MQTT request refused: {refusal}");
            }
            drop(place);
        });
        let begun = poll_fn(|context| Poll::Ready(asking.as_mut().poll(context))).await;
        if begun.is_pending() {
            tokio::spawn(asking);
        }
    }

    async fn too_many(&self, request: Request) {
        let refusal = Refusal::new(
            RefusalCode::Unavailable,
            "too many requests are unanswered; send it again",
        );
        if let Some((cs, meta)) = sender(&request) {
            let (client_id, command_id) = (meta.client_id.clone(), meta.command_id.clone());
            self.reject(cs, client_id, command_id, refusal).await;
        } else {
            add(&self.metrics.mqtt_refused, 1);
            warn!("MQTT request refused: {refusal}");
        }
    }

    async fn reject(
        &self,
        cs: CoordinateSystemNumber,
        client_id: String,
        command_id: String,
        refusal: Refusal,
    ) {
        add(&self.metrics.mqtt_refused, 1);
        warn!("MQTT command {command_id} of {client_id} rejected: {refusal}");
        if refusal.code == RefusalCode::Retained {
            let text = format!("retained command {command_id:.128} of {client_id:.64} over MQTT: {refusal}");
            self.port.notice(ServerNotice::Warning(text));
        }
        let state = self.port.read(&Topic::cs(cs, CsTopic::State)).await;
        let reply = Message {
            topic: Topic::Reply(client_id),
            boot_id: self.port.boot_id(),
            ts: Timestamp::from_system_time(SystemTime::now()),
            rev: None,
            payload: Payload::Reply(CommandReply {
                command_id,
                status: CommandStatus::Rejected,
                code: code_word(refusal.code),
                text: refusal.text,
                state_rev: state.and_then(|state| state.rev).unwrap_or(0),
                variables: None,
                lease: None,
            }),
        };
        if self.replies.try_send(reply).is_err() {
            warn!("too many rejected MQTT commands at once; one reply was dropped");
        }
    }
}
