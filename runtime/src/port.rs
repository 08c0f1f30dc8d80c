//! The runtime's own [`Port`]: requests go to the task or the store that they concern, reads are answered from the
//! hub and the servo's last cycle.

use std::collections::BTreeSet;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use plc_api::hub::{Filter, Subscription};
use plc_api::port::{BoxFuture, Port};
use plc_api::types::command::{Command, CommandMeta, CommandReply, CommandStatus, Verb};
use plc_api::types::machine::{AlarmRecord, AlarmSeverity};
use plc_api::types::message::{Message, Payload};
use plc_api::types::output::HandlerPresence;
use plc_api::types::program::ProgramCheck;
use plc_api::types::request::{Answer, Refusal, RefusalCode, Request};
use plc_api::types::state::{Execution, Spindle};
use plc_api::types::topic::{CsTopic, Topic};
use plc_api::types::{BootId, CoordinateSystemNumber};
use tandem_model::alarm::REQUEST_REFUSED;
use tandem_model::limits::PROGRAM_BYTES_MAX;
use tokio::sync::{mpsc, oneshot};

use crate::coordinate_system::{Envelope, Handle};
use crate::shared::Shared;

/// Characters of a command id.
const COMMAND_ID_MAX: usize = 128;

/// Characters of a client id and of a handler id: they are MQTT topic levels.
const CLIENT_ID_MAX: usize = 64;

/// M codes that one handler may say it serves: all of them in every coordinate system.
const HANDLED_CODES_MAX: usize = 8 * 192;

/// Characters of a warning that a server end raises.
const WARNING_TEXT_MAX: usize = 500;

/// The port of a running machine.
#[derive(Debug)]
pub(crate) struct RuntimePort {
    shared: Arc<Shared>,
    handles: Vec<Handle>,
}

impl RuntimePort {
    pub fn new(shared: Arc<Shared>, handles: Vec<Handle>) -> Self {
        Self { shared, handles }
    }

    pub fn handles(&self) -> &[Handle] {
        &self.handles
    }

    /// Stops every coordinate system that runs.
    pub async fn stop_all(&self) {
        for handle in self
            .handles
            .iter()
            .filter(|handle| self.running_program(handle.number).is_some())
        {
            let meta = CommandMeta {
                command_id: format!("shutdown-{}", handle.number),
                client_id: "runtime".into(),
                ..CommandMeta::default()
            };
            let stop = Request::Command {
                cs: handle.number,
                command: Command::Stop,
                meta,
                wait: true,
            };
            // Whatever the answer is, the task ends next.
            let _ = tokio::time::timeout(Duration::from_secs(2), self.request(stop)).await;
        }
    }

    fn handle(&self, cs: CoordinateSystemNumber) -> Result<&Handle, Refusal> {
        self.handles
            .iter()
            .find(|handle| handle.number == cs)
            .ok_or_else(|| {
                let numbers: Vec<_> = self
                    .handles
                    .iter()
                    .map(|handle| handle.number.to_string())
                    .collect();
                let text = format!(
                    "there is no coordinate system {cs}; there are {}",
                    numbers.join(", ")
                );
                Refusal::new(RefusalCode::NotFound, text)
            })
    }

    async fn ask(&self, queue: &mpsc::Sender<Envelope>, request: Request) -> Result<Answer, Refusal> {
        let gone = || Refusal::new(RefusalCode::Unavailable, "the runtime is stopping");
        if self.shared.closing.is_cancelled() {
            return Err(gone());
        }
        let (reply, answer) = oneshot::channel();
        queue
            .send(Envelope { request, reply })
            .await
            .map_err(|_| gone())?;
        answer.await.unwrap_or_else(|_| Err(gone()))
    }

    async fn command(
        &self,
        cs: CoordinateSystemNumber,
        command: Command,
        meta: CommandMeta,
        wait: bool,
    ) -> Result<Answer, Refusal> {
        check_ids(&meta)?;
        if let Some(reply) = self.shared.replied(&meta.command_id) {
            // Who asks again has not heard it.
            self.shared
                .publish(Topic::Reply(meta.client_id), Payload::Reply(reply.clone()));
            return Ok(Answer::Command(reply));
        }
        self.check_age(&meta)
            .map_err(|refusal| self.reject(&meta, refusal))?;
        let handle = self.handle(cs).map_err(|refusal| self.reject(&meta, refusal))?;
        if let Command::AlarmAcknowledge { id } = command
            && !self.shared.acknowledge_alarm(id, &meta.client_id)
        {
            return Err(self.reject(
                &meta,
                Refusal::new(RefusalCode::NotFound, format!("no alarm {id} is active")),
            ));
        }
        let urgent = matches!(command.verb(), Verb::Hold | Verb::Stop | Verb::Abort);
        let queue = if urgent { &handle.urgent } else { &handle.requests };
        self.ask(
            queue,
            Request::Command {
                cs,
                command,
                meta,
                wait,
            },
        )
        .await
    }

    fn check_age(&self, meta: &CommandMeta) -> Result<(), Refusal> {
        let invalid = |text: String| Err(Refusal::new(RefusalCode::Invalid, text));
        let Some(ttl_ms) = meta.ttl_ms else { return Ok(()) };
        let Some(issued_at) = &meta.issued_at else {
            return invalid("ttl_ms needs issued_at".into());
        };
        let Some(issued) = issued_at.to_system_time() else {
            return invalid(format!(
                "issued_at \"{:.64}\": write RFC 3339 in UTC",
                issued_at.0
            ));
        };
        let age = self
            .shared
            .clock
            .wall()
            .duration_since(issued)
            .unwrap_or_default();
        if age > Duration::from_millis(ttl_ms) {
            let text = format!(
                "the command is {} ms old, its ttl_ms is {ttl_ms}",
                age.as_millis()
            );
            return Err(Refusal::new(RefusalCode::Expired, text));
        }
        Ok(())
    }

    fn reject(&self, meta: &CommandMeta, refusal: Refusal) -> Refusal {
        let code = serde_json::to_value(refusal.code).ok();
        let reply = CommandReply {
            command_id: meta.command_id.clone(),
            status: CommandStatus::Rejected,
            code: code
                .and_then(|code| code.as_str().map(str::to_owned))
                .unwrap_or_default(),
            text: refusal.text.clone(),
            state_rev: 0,
        };
        self.shared.reply(&meta.client_id, reply);
        refusal
    }

    async fn handler(&self, id: String, presence: HandlerPresence) -> Result<Answer, Refusal> {
        check_id("handler_id", &id)?;
        if presence.handles.len() > HANDLED_CODES_MAX {
            let text = format!("a handler serves at most {HANDLED_CODES_MAX} M codes");
            return Err(Refusal::new(RefusalCode::TooLarge, text));
        }
        if !self.shared.set_handler(&id, presence.clone()) {
            return Err(Refusal::new(
                RefusalCode::Unavailable,
                "too many handlers are connected",
            ));
        }
        for handle in &self.handles {
            self.ask(&handle.requests, Request::Handler(id.clone(), presence.clone()))
                .await?;
        }
        Ok(Answer::Done)
    }

    async fn write_program(&self, number: u16, text: String) -> Result<Answer, Refusal> {
        if text.len() > PROGRAM_BYTES_MAX {
            let text = format!(
                "the program has {} bytes; at most {PROGRAM_BYTES_MAX} are read",
                text.len()
            );
            return Err(Refusal::new(RefusalCode::TooLarge, text));
        }
        self.refuse_while_running(number)?;
        let check = self
            .on_disk(move |shared| shared.store.write(number, &text))
            .await?;
        Ok(Answer::Check(check))
    }

    async fn delete_program(&self, number: u16) -> Result<Answer, Refusal> {
        self.refuse_while_running(number)?;
        if self.on_disk(move |shared| shared.store.delete(number)).await? {
            Ok(Answer::Done)
        } else {
            Err(no_program(number))
        }
    }

    /// Work on the store, off the tasks that must not wait; in simulated time there is no disk and one thread.
    async fn on_disk<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Shared) -> io::Result<T> + Send + 'static,
    ) -> Result<T, Refusal> {
        let done = if self.shared.clock.is_simulated() {
            work(&self.shared)
        } else {
            let shared = Arc::clone(&self.shared);
            tokio::task::spawn_blocking(move || work(&shared))
                .await
                .map_err(io::Error::other)
                .flatten()
        };
        done.map_err(|error| {
            let code = match error.kind() {
                io::ErrorKind::InvalidInput => RefusalCode::Invalid,
                _ => RefusalCode::Unavailable,
            };
            Refusal::new(code, error.to_string())
        })
    }

    fn refuse_while_running(&self, number: u16) -> Result<(), Refusal> {
        for handle in &self.handles {
            let main = self.running_program(handle.number);
            if main.is_some_and(|main| self.called_by(main).contains(&number)) {
                let text = format!(
                    "program {number} runs in coordinate system {}; stop it first",
                    handle.number
                );
                return Err(Refusal::new(RefusalCode::ProgramRuns, text));
            }
        }
        Ok(())
    }

    /// The main program of a run that has not ended.
    fn running_program(&self, cs: CoordinateSystemNumber) -> Option<u16> {
        let message = self.shared.hub.read(&Topic::cs(cs, CsTopic::State))?;
        let Payload::State(state) = &message.payload else {
            return None;
        };
        let ended = matches!(
            state.execution,
            Execution::Ready | Execution::Stopped | Execution::ProgramCompleted
        );
        state.program.filter(|_| !ended)
    }

    /// A program and all that it calls.
    fn called_by(&self, main: u16) -> BTreeSet<u16> {
        let all = self.shared.store.all();
        let (mut called, mut left) = (BTreeSet::from([main]), vec![main]);
        while let Some(program) = left.pop().and_then(|number| all.get(&number)) {
            left.extend(
                program
                    .check
                    .programs
                    .iter()
                    .filter(|number| called.insert(**number)),
            );
        }
        called
    }

    fn program_check(&self, number: u16) -> Result<ProgramCheck, Refusal> {
        Ok(self
            .shared
            .store
            .get(number)
            .ok_or_else(|| no_program(number))?
            .check
            .clone())
    }

    /// Topics whose value the servo's last cycle gives.
    fn read_live(&self, topic: &Topic) -> Option<Payload> {
        let Topic::CoordinateSystem(cs, topic) = topic else {
            return None;
        };
        let view = &self.handle(*cs).ok()?.view;
        match topic {
            CsTopic::Position => Some(Payload::Position(view.position())),
            CsTopic::Program => Some(Payload::Program(view.program(&self.shared.store))),
            CsTopic::Spindle => {
                let last = self.shared.hub.read(&Topic::cs(*cs, CsTopic::Spindle))?;
                let Payload::Spindle(spindle) = last.payload else {
                    return None;
                };
                let (actual_rpm, oriented) = view.spindle();
                Some(Payload::Spindle(Spindle {
                    actual_rpm,
                    oriented,
                    ..spindle
                }))
            }
            _ => None,
        }
    }

    async fn carry_out(&self, request: Request) -> Result<Answer, Refusal> {
        match request {
            Request::Command {
                cs,
                command,
                meta,
                wait,
            } => self.command(cs, command, meta, wait).await,
            Request::CommandStatus(id) => {
                let reply = self.shared.replied(&id).map(Answer::Command);
                reply.ok_or_else(|| Refusal::new(RefusalCode::NotFound, format!("no command {id} is known")))
            }
            Request::Claim(cs, ..)
            | Request::Reset(cs, ..)
            | Request::Progress(cs, ..)
            | Request::Redeliver(cs, ..)
            | Request::Input(cs, _)
            | Request::Spindle(cs, _)
            | Request::Tool(cs, _) => self.ask(&self.handle(cs)?.requests, request).await,
            Request::Handler(id, presence) => self.handler(id, presence).await,
            Request::Handlers => Ok(Answer::Handlers(self.shared.handlers())),
            Request::Programs => Ok(Answer::Programs(self.shared.store.list())),
            Request::ReadProgram(number) => {
                let program = self.shared.store.get(number).ok_or_else(|| no_program(number))?;
                Ok(Answer::ProgramText(program.text().to_owned()))
            }
            Request::WriteProgram(number, text) => self.write_program(number, text).await,
            Request::DeleteProgram(number) => self.delete_program(number).await,
            Request::CheckProgram(number) => self.program_check(number).map(Answer::Check),
            Request::Republish => {
                for handle in &self.handles {
                    self.ask(&handle.requests, Request::Republish).await?;
                }
                Ok(Answer::Done)
            }
            Request::Warn(text) => {
                self.shared.raise(AlarmRecord {
                    severity: AlarmSeverity::Warning,
                    number: REQUEST_REFUSED.number,
                    text: text.chars().take(WARNING_TEXT_MAX).collect(),
                    ..AlarmRecord::default()
                });
                Ok(Answer::Done)
            }
            Request::AlarmHistory => Ok(Answer::Alarms(self.shared.alarm_history())),
        }
    }
}

fn no_program(number: u16) -> Refusal {
    Refusal::new(
        RefusalCode::NotFound,
        format!("program {number} is not in the store"),
    )
}

fn check_ids(meta: &CommandMeta) -> Result<(), Refusal> {
    if meta.command_id.is_empty() || meta.command_id.chars().count() > COMMAND_ID_MAX {
        let text = format!("command_id: write 1 to {COMMAND_ID_MAX} characters");
        return Err(Refusal::new(RefusalCode::Invalid, text));
    }
    check_id("client_id", &meta.client_id)
}

fn check_id(what: &str, id: &str) -> Result<(), Refusal> {
    let length = id.chars().count();
    if length == 0 || length > CLIENT_ID_MAX || id.contains(['/', '+', '#', '\0']) {
        let text = format!("{what}: write 1 to {CLIENT_ID_MAX} characters without / + #");
        return Err(Refusal::new(RefusalCode::Invalid, text));
    }
    Ok(())
}

impl Port for RuntimePort {
    fn boot_id(&self) -> BootId {
        self.shared.boot_id.clone()
    }

    fn read<'a>(&'a self, topic: &'a Topic) -> BoxFuture<'a, Option<Arc<Message>>> {
        Box::pin(async move {
            let last = self.shared.hub.read(topic);
            match self.read_live(topic) {
                Some(payload) => {
                    let rev = last.and_then(|message| message.rev);
                    Some(Arc::new(self.shared.message(topic.clone(), rev, payload)))
                }
                None => last,
            }
        })
    }

    fn subscribe(&self, filter: Filter) -> Subscription {
        self.shared.hub.subscribe(filter)
    }

    fn request(&self, request: Request) -> BoxFuture<'_, Result<Answer, Refusal>> {
        Box::pin(self.carry_out(request))
    }

    fn sleep(&self, duration: Duration) -> BoxFuture<'_, ()> {
        Box::pin(self.shared.clock.sleep(duration))
    }

    fn now_s(&self) -> f64 {
        self.shared.clock.now_s()
    }
}

#[cfg(test)]
mod tests {
    use plc_api::types::Timestamp;
    use plc_api::types::command::Expect;

    use super::*;
    use crate::journal::Journal;
    use crate::simulation::{self, SimulationOptions};
    use crate::{Config, Runtime};

    fn start(command_id: &str) -> Request {
        let meta = CommandMeta {
            command_id: command_id.into(),
            client_id: "test".into(),
            ..CommandMeta::default()
        };
        Request::Command {
            cs: 1,
            command: Command::Start,
            meta,
            wait: false,
        }
    }

    /// Runs a test against the demo machine in simulated time, with a program loaded that waits for 1000 s.
    fn with_machine<T>(test: impl AsyncFnOnce(Arc<dyn Port>) -> T) -> T {
        simulation::run(async {
            let machine = Config::demo().resolve().unwrap();
            let options = SimulationOptions::default();
            let runtime = Runtime::start_simulated(machine, Journal::to_log(), options).unwrap();
            runtime.store().write(50, "G04 X1000\nM30\n").unwrap();
            let port = runtime.port();
            let Request::Command { meta, .. } = start("load") else {
                unreachable!()
            };
            let command = Command::Load { program: 50 };
            port.request(Request::Command {
                cs: 1,
                command,
                meta,
                wait: true,
            })
            .await
            .unwrap();
            test(port).await
        })
        .unwrap()
    }

    fn status(answer: &Result<Answer, Refusal>) -> Option<CommandStatus> {
        match answer {
            Ok(Answer::Command(reply)) => Some(reply.status),
            _ => None,
        }
    }

    #[test]
    fn a_command_that_comes_twice_at_once_is_carried_out_once() {
        with_machine(async |port| {
            let both = futures_util::future::join(port.request(start("s1")), port.request(start("s1")));
            let (first, second) = both.await;
            assert_eq!(status(&first), Some(CommandStatus::Accepted));
            assert!(
                matches!(
                    status(&second),
                    Some(CommandStatus::Accepted | CommandStatus::Done)
                ),
                "{second:?}"
            );
            let other = port.request(start("s2")).await;
            assert_eq!(other.unwrap_err().code, RefusalCode::NotAllowed);
        });
    }

    #[test]
    fn a_command_past_its_ttl_or_for_another_boot_is_refused_and_the_reply_is_published() {
        with_machine(async |port| {
            let Request::Command { mut meta, .. } = start("old") else {
                unreachable!()
            };
            (meta.ttl_ms, meta.issued_at) = (Some(500), Some(Timestamp("1999-12-31T23:59:59Z".into())));
            let mut replies = port.subscribe(Filter::Topics(vec![Topic::Reply("test".into())]));
            let command = Command::Start;
            let late = Request::Command {
                cs: 1,
                command: command.clone(),
                meta,
                wait: false,
            };
            assert_eq!(port.request(late).await.unwrap_err().code, RefusalCode::Expired);
            let said = replies.try_next().map(|message| message.payload.clone());
            assert!(matches!(said, Some(Payload::Reply(reply)) if reply.status == CommandStatus::Rejected));
            let Request::Command { mut meta, .. } = start("elsewhere") else {
                unreachable!()
            };
            meta.expect = Some(Expect {
                boot_id: Some(BootId("another".into())),
                state_rev: None,
            });
            let other = Request::Command {
                cs: 1,
                command,
                meta,
                wait: false,
            };
            assert_eq!(
                port.request(other).await.unwrap_err().code,
                RefusalCode::PreconditionFailed
            );
        });
    }

    #[test]
    fn a_program_cannot_be_written_while_it_runs() {
        with_machine(async |port| {
            port.request(start("s1")).await.unwrap();
            let write = port.request(Request::WriteProgram(50, "M30\n".into())).await;
            assert_eq!(write.unwrap_err().code, RefusalCode::ProgramRuns);
            assert!(
                port.request(Request::WriteProgram(51, "M30\n".into()))
                    .await
                    .is_ok()
            );
        });
    }
}
