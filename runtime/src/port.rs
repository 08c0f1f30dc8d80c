//! The runtime's own [`Port`]. Each request goes to the task or store that it concerns; reads are answered from the hub
//! and from the last servo cycle.

mod access;
mod audit;
mod background;
mod commands;
mod data;
mod handlers;
mod programs;
mod sender;
mod stored_data;

use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, SystemTime};

use futures_util::future::join_all;
use plc_protocol::handler_registry::Reach;
use plc_protocol::hub::{Filter, Subscription};
use plc_protocol::port::{BoxFuture, Port};
use plc_protocol::server::{Origin, ServedPort, ServerNotice, ServerTransport, ServoTiming};
use plc_protocol::supervisor::Supervisor;
use plc_protocol::types::command::{Command, CommandMeta};
use plc_protocol::types::explained::Explanation;
use plc_protocol::types::heartbeat::ClientHeartbeat;
use plc_protocol::types::ids::check_client_id;
use plc_protocol::types::machine::{AlarmRaise, AlarmRecord, AlarmSeverity};
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::not_after::NotAfter;
use plc_protocol::types::planned::PathQuery;
use plc_protocol::types::request::{
    Answer, CoordinateSystemRequest, Destination, MachineRequest, ProgramRequest, Refusal, RefusalCode,
    Request,
};
use plc_protocol::types::run::{RUN_WAIT_MAX_S, RUNS_KEPT, Run};
use plc_protocol::types::state::{Execution, Spindle, State};
use plc_protocol::types::topic::{CsTopic, Topic};
use plc_protocol::types::trace::{Trace, TraceQuery};
use plc_protocol::types::upload::{ProgramCondition, ProgramUpload};
use plc_protocol::types::{BootId, CoordinateSystemNumber};
use plc_protocol::wire::takes_not_after;
use tandem_model::alarm::{MESSAGES_NOT_KEPT, REQUEST_REFUSED};

pub(crate) use access::AccessLines;
use sender::Sender;
use tandem_config::explain::{explain_here, nearest, picture};
use tandem_store::persistence::LastRuns;

use crate::coordinate_system::Mailbox;
use crate::preview::Previews;
use crate::shared::SharedState;
use crate::state_writer::StateWriter;

/// Maximum length in characters of the text of a warning that a server end raises.
const WARNING_TEXT_MAX: usize = 500;

/// The port of a running machine.
#[derive(Debug)]
pub(crate) struct RuntimePort {
    pub shared: Arc<SharedState>,
    pub mailboxes: Vec<Arc<Mailbox>>,
    /// Handle of the state writer; `None` in simulated time or without a data folder.
    pub writer: Option<StateWriter>,
    /// Last run of each coordinate system before this start of the runtime.
    pub last_runs: LastRuns,
    /// Limit on journal lines about logins and refused access.
    pub access: AccessLines,
    /// Plans and rehearsals of programs, made ahead of their runs.
    pub previews: Previews,
    /// Serializes the storage of outputs, so that the value on disk is always the one written last.
    pub io_turn: tokio::sync::Mutex<()>,
}

impl RuntimePort {
    /// Stops the run of every coordinate system in which one is active.
    pub async fn stop_all(&self) {
        for mailbox in &self.mailboxes {
            if self.running(mailbox.number).is_none() {
                continue;
            }
            let meta = CommandMeta {
                command_id: format!("shutdown-{}", mailbox.number),
                client_id: "runtime".into(),
                ..CommandMeta::default()
            };
            let stop = Request::Command {
                cs: mailbox.number,
                command: Command::Stop,
                meta,
                wait: true,
            };
            // The task of the coordinate system ends next, whether the stop succeeds or not.
            let clock = &self.shared.clock;
            let _ = clock
                .within_real(
                    Duration::from_secs(2),
                    self.execute_request(stop, Sender::in_process()),
                )
                .await;
        }
    }

    fn mailbox(&self, cs: CoordinateSystemNumber) -> Result<&Mailbox, Refusal> {
        let mut mailboxes = self.mailboxes.iter();
        let found = mailboxes.find(|mailbox| mailbox.number == cs);
        found.map(Arc::as_ref).ok_or_else(|| {
            let numbers = self.mailboxes.iter().map(|mailbox| mailbox.number.to_string());
            let numbers = numbers.collect::<Vec<_>>().join(", ");
            let text = format!("there is no coordinate system {cs}; there are {numbers}");
            Refusal::new(RefusalCode::NotFound, text)
        })
    }

    /// Sends a request to all coordinate systems at the same time, so that no coordinate system waits for another.
    async fn pass_to_all(&self, request: CoordinateSystemRequest) -> Result<(), Refusal> {
        let asked = self
            .mailboxes
            .iter()
            .map(|mailbox| mailbox.ask(request.clone(), false));
        let answers = join_all(asked).await;
        answers.into_iter().try_for_each(|answer| answer.map(drop))
    }

    /// Passes the heartbeat of a client to the coordinate system that it names, otherwise to all.
    async fn heartbeat(&self, id: String, beat: ClientHeartbeat) -> Result<Answer, Refusal> {
        check_client_id("client", &id)?;
        beat.check()?;
        if let Some(cs) = beat.cs {
            let request = CoordinateSystemRequest::Heartbeat(id, beat);
            return self.mailbox(cs)?.ask(request, false).await;
        }
        self.pass_to_all(CoordinateSystemRequest::Heartbeat(id, beat))
            .await?;
        Ok(Answer::Done)
    }

    /// Passes the skip input of a motor to each coordinate system that has this motor as an axis.
    async fn skip_input(&self, motor: u16, value: bool, sender: &Sender) -> Result<Answer, Refusal> {
        let mut found = false;
        for system in &self.shared.machine.coordinate_systems {
            let mut motors = system.settings.motors.iter().flatten();
            if motors.any(|axis| axis.number == motor) {
                found = true;
                let mailbox = self.mailbox(system.settings.number)?;
                mailbox
                    .ask_not_after(
                        CoordinateSystemRequest::SkipInput(motor, value),
                        sender.not_after.clone(),
                    )
                    .await?;
            }
        }
        if found {
            Ok(Answer::Done)
        } else {
            let text = format!("no axis has motor {motor}");
            Err(Refusal::new(RefusalCode::NotFound, text))
        }
    }

    /// Does work on the disk in a thread that may block; in simulated time, which has only one thread, does it at once.
    async fn on_disk<T: Send + 'static>(
        &self,
        work: impl FnOnce(&SharedState) -> io::Result<T> + Send + 'static,
    ) -> Result<T, Refusal> {
        let done = if self.shared.clock.is_simulated() {
            work(&self.shared)
        } else {
            let shared = Arc::clone(&self.shared);
            let supervisor = &self.shared.supervisor;
            let done = supervisor.catch_blocking("request that waits for the disk", move || work(&shared));
            let fault = || io::Error::other("an internal fault occurred; the request may have had an effect");
            done.await.unwrap_or_else(|| Err(fault()))
        };
        done.map_err(|error| {
            let code = match error.kind() {
                io::ErrorKind::InvalidInput => RefusalCode::Invalid,
                // unlike a full disk, this limit remains until the request is changed
                io::ErrorKind::QuotaExceeded => RefusalCode::TooLarge,
                _ => RefusalCode::Unavailable,
            };
            Refusal::new(code, error.to_string())
        })
    }

    /// Returns the state of a coordinate system if a run is active, including a run by hand.
    fn running(&self, cs: CoordinateSystemNumber) -> Option<State> {
        let message = self.shared.hub.read(&Topic::cs(cs, CsTopic::State))?;
        let Payload::State(state) = &message.payload else {
            return None;
        };
        let ended = matches!(
            state.execution,
            Execution::Ready | Execution::Stopped | Execution::ProgramCompleted
        );
        (!ended).then(|| state.clone())
    }

    /// Returns the current value of a topic that depends on the last servo cycle; `None` for other topics.
    fn read_live(&self, topic: &Topic) -> Option<Payload> {
        let (cs, topic) = match topic {
            Topic::CoordinateSystem(cs, topic) => (cs, topic),
            Topic::Heartbeat => {
                let heartbeat = self
                    .shared
                    .note_heartbeat(self.mailboxes.first()?.view.heartbeat());
                return Some(Payload::Heartbeat(heartbeat));
            }
            _ => return None,
        };
        let view = &self.mailbox(*cs).ok()?.view;
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

    /// Raises an alarm of one coordinate system or of the whole machine. The latter is one alarm, and stops each
    /// coordinate system.
    async fn raise_alarm(&self, raise: AlarmRaise) -> Result<Answer, Refusal> {
        let alarm = raise.alarm()?;
        if let Some(cs) = raise.cs {
            return self
                .mailbox(cs)?
                .ask(CoordinateSystemRequest::RaiseAlarm(raise), true)
                .await;
        }
        self.shared.raise(AlarmRecord {
            number: alarm.number,
            text: alarm.text,
            ..AlarmRecord::default()
        });
        // if a coordinate system refuses, the others are stopped regardless
        let mut answer = Ok(Answer::Done);
        for mailbox in &self.mailboxes {
            let stopped = mailbox
                .ask(CoordinateSystemRequest::RaiseAlarm(raise.clone()), true)
                .await;
            answer = answer.and(stopped);
        }
        answer
    }

    /// Executes a request. A request that is older than its age limit when it would take effect is refused.
    fn execute_request(&self, request: Request, sender: Sender) -> BoxFuture<'_, Result<Answer, Refusal>> {
        match request.into() {
            Destination::CoordinateSystem(cs, request) => self.pass_on(cs, request, sender),
            Destination::Program(request) => Box::pin(self.of_program(request, sender.user)),
            Destination::Machine(request) => Box::pin(self.of_machine(request, sender)),
        }
    }

    async fn of_machine(&self, request: MachineRequest, sender: Sender) -> Result<Answer, Refusal> {
        self.check_sender(&request, &sender)?;
        match request {
            MachineRequest::CommandStatus(id) => {
                let reply = self.shared.find_reply(&sender.user, &id).map(Answer::Command);
                reply.ok_or_else(|| Refusal::new(RefusalCode::NotFound, format!("command {id} is unknown")))
            }
            MachineRequest::ReadVariables {
                area,
                from,
                count,
                meta,
            } => self.read_variables(area, from, count, meta),
            MachineRequest::WriteVariables {
                area,
                from,
                values,
                meta,
            } => self.write_variables(area, from, &values, meta, sender),
            MachineRequest::WriteIo(point, set) => self.write_io(point, set, sender.not_after).await,
            MachineRequest::ForceIo(point, force) => {
                self.shared.force_io(&point, force).map(|()| Answer::Done)
            }
            MachineRequest::Tools => Ok(Answer::Tools(self.shared.tables.tools())),
            MachineRequest::WriteTools(change) => {
                self.change(sender.not_after, move |tables| tables.with_tools(&change))
                    .await
            }
            MachineRequest::WorkOffsets(cs) => self.shared.tables.work_offsets(cs).map(Answer::WorkOffsets),
            MachineRequest::WriteWorkOffsets(cs, change) => {
                self.change(sender.not_after, move |tables| {
                    tables.with_work_offsets(cs, &change)
                })
                .await
            }
            MachineRequest::LastRun(cs) => self.last_run(cs),
            MachineRequest::Journal { from, count, filter } => {
                self.journal(from, count, filter, &sender.user).await
            }
            MachineRequest::Handler(id, presence) => self.handler(Reach::Subscribed, id, presence).await,
            MachineRequest::Heartbeat(id, beat) => self.heartbeat(id, beat).await,
            MachineRequest::Handlers => Ok(Answer::Handlers(self.shared.handlers())),
            MachineRequest::Programs => Ok(Answer::Programs(self.shared.store.list())),
            MachineRequest::RaiseAlarm(raise) => self.raise_alarm(raise).await,
            MachineRequest::AnswerStoredData(answer) => self.answer_stored_data(answer.decision).await,
            MachineRequest::SkipInput(motor, value) => self.skip_input(motor, value, &sender).await,
            MachineRequest::Run { id, wait_s } => self.run(&id, wait_s).await.map(Answer::Run),
            MachineRequest::Runs(query) => Ok(Answer::Runs(self.shared.runs.lock().runs(query))),
            MachineRequest::Explain(what) => self.explain(what),
            MachineRequest::AlarmHistory => Ok(Answer::Alarms(self.shared.alarm_history())),
            MachineRequest::Trace(cs, query) => self.trace(cs, &query),
            MachineRequest::LineState(cs, from) => {
                self.mailbox(cs)?;
                let search = self.previews.line_state(cs, from);
                self.search(&sender.user, search).await?.map(Answer::LineState)
            }
            MachineRequest::ManualPath(cs, text) => {
                let query = PathQuery {
                    cs: Some(cs),
                    ..PathQuery::default()
                };
                let planned = self.previews.path(self.manual(cs, &text)?, &query);
                planned.await.map(Answer::Path)
            }
            MachineRequest::ManualRehearsal(cs, text) => {
                let rehearsed = self.previews.rehearsal(self.manual(cs, &text)?, Some(cs));
                rehearsed.await.map(Answer::Rehearsed)
            }
        }
    }

    /// Returns a run as soon as it has ended, at the latest after `wait_s` seconds.
    async fn run(&self, id: &str, wait_s: u32) -> Result<Run, Refusal> {
        let numbers = self.mailboxes.iter().map(|mailbox| mailbox.number);
        let topics = numbers.map(|cs| Topic::cs(cs, CsTopic::Run)).collect();
        let mut messages = self.shared.hub.subscribe(Filter::Topics(topics));
        let until_s = self.shared.clock.now_s() + f64::from(wait_s.min(RUN_WAIT_MAX_S));
        loop {
            let now_s = self.shared.clock.now_s();
            let run = self.shared.runs.lock().run(id, now_s);
            let run = run.ok_or_else(|| {
                let text = format!("no run {id:.128?} is known; GET /runs lists the last {RUNS_KEPT}");
                Refusal::new(RefusalCode::NotFound, text)
            })?;
            if run.end.is_some() || now_s >= until_s {
                return Ok(run);
            }
            tokio::select! {
                biased;
                message = messages.next() => if message.is_none() { return Ok(run) },
                () = self.shared.clock.sleep(Duration::from_secs_f64(until_s - now_s)) => {}
            }
        }
    }

    fn trace(&self, cs: CoordinateSystemNumber, query: &TraceQuery) -> Result<Answer, Refusal> {
        let trace = self.mailbox(cs)?.view.trace(query).map_err(|letter| {
            let text = format!(
                "axes={:.16}: coordinate system {cs} has no axis {letter}",
                query.axes
            );
            Refusal::new(RefusalCode::Invalid, text)
        })?;
        Ok(Answer::Trace(Trace {
            cs,
            now: self.shared.timestamp(),
            ..trace
        }))
    }

    fn explain(&self, what: String) -> Result<Answer, Refusal> {
        let dialect = self.shared.machine.dialect();
        let alarm_text = |code| self.shared.alarm_text(code);
        let text = explain_here(&what, dialect, &self.shared.declared(), alarm_text).ok_or_else(|| {
            let text = format!("{what} is unknown; did you mean {}?", nearest(&what, dialect));
            Refusal::new(RefusalCode::NotFound, text)
        })?;
        let picture = picture(&what, dialect);
        Ok(Answer::Explanation(Explanation { what, text, picture }))
    }

    async fn of_program(&self, request: ProgramRequest, user: String) -> Result<Answer, Refusal> {
        match request {
            ProgramRequest::ReadProgram(number) => self.read_program(number),
            ProgramRequest::WriteProgram(number, text) => {
                let upload = ProgramUpload {
                    text,
                    ..ProgramUpload::default()
                };
                self.store_program(number, upload).await
            }
            ProgramRequest::DeleteProgram(number) => {
                self.remove_program(number, ProgramCondition::default()).await
            }
            ProgramRequest::FetchProgram(number) => self.fetch_program(number),
            ProgramRequest::StoreProgram(number, upload) => self.store_program(number, upload).await,
            ProgramRequest::RemoveProgram(number, condition) => self.remove_program(number, condition).await,
            ProgramRequest::CheckProgram(number) => self.check_program(number),
            ProgramRequest::CheckText(number, dialect, text) => {
                self.check_text(number, dialect.as_deref(), text, &user).await
            }
            ProgramRequest::PutInFolder(number, folder) => self.put_in_folder(number, &folder).await,
            ProgramRequest::IntermediateCode(number) => self.intermediate_code(number, &user).await,
            ProgramRequest::PlannedPath(number, query) => {
                let program = self.planned(number, query.cs)?;
                self.previews.path(program, &query).await.map(Answer::Path)
            }
            ProgramRequest::Rehearsal(number, cs) => {
                let program = self.planned(number, cs)?;
                self.previews.rehearsal(program, cs).await.map(Answer::Rehearsed)
            }
        }
    }

    /// Passes a request to its coordinate system; commands, leases and tools need further steps before.
    fn pass_on(
        &self,
        cs: CoordinateSystemNumber,
        request: CoordinateSystemRequest,
        Sender { user, not_after }: Sender,
    ) -> BoxFuture<'_, Result<Answer, Refusal>> {
        match request {
            CoordinateSystemRequest::Command { command, meta, wait } => {
                Box::pin(self.command(cs, command, meta.limited(not_after), wait, user))
            }
            CoordinateSystemRequest::Lease { request, meta } => Box::pin(self.lease(cs, request, meta, user)),
            CoordinateSystemRequest::Tool(id) => Box::pin(self.tool(cs, id, not_after)),
            request => match self.mailbox(cs) {
                Ok(mailbox) => Box::pin(mailbox.ask_not_after(request, not_after)),
                Err(refusal) => Box::pin(std::future::ready(Err(refusal))),
            },
        }
    }
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
        audit::record_edit(&self.shared, None, &request);
        self.execute_request(request, Sender::in_process())
    }

    fn request_as<'a>(&'a self, client: &'a str, request: Request) -> BoxFuture<'a, Result<Answer, Refusal>> {
        audit::record_edit(&self.shared, Some(client), &request);
        self.execute_request(request, Sender::in_process())
    }

    fn request_not_after<'a>(
        &'a self,
        not_after: &'a NotAfter,
        client: Option<&'a str>,
        request: Request,
    ) -> BoxFuture<'a, Result<Answer, Refusal>> {
        if let Err(text) = not_after.check() {
            return Box::pin(std::future::ready(Err(Refusal::new(RefusalCode::Invalid, text))));
        }
        audit::record_edit(&self.shared, client, &request);
        let not_after = takes_not_after(&request).then(|| not_after.clone());
        let sender = Sender {
            not_after,
            ..Sender::in_process()
        };
        self.execute_request(request, sender)
    }

    fn sleep(&self, duration: Duration) -> BoxFuture<'_, ()> {
        Box::pin(self.shared.clock.sleep(duration))
    }

    fn now_s(&self) -> f64 {
        self.shared.clock.now_s()
    }
}

impl ServedPort for RuntimePort {
    fn request_from(&self, origin: Origin, mut request: Request) -> BoxFuture<'_, Result<Answer, Refusal>> {
        if let (Request::ForceIo(_, force), Some(user)) = (&mut request, &origin.user) {
            force.by = Some(user.clone());
        }
        let sender = Sender::from_origin(&origin);
        if origin.right.is_recorded() && !audit::is_own_level(&request) {
            audit::record(&self.shared, origin.clone(), &request);
        }
        match request {
            Request::Handler(id, presence) if origin.over == ServerTransport::Rest => {
                Box::pin(self.handler(Reach::Polling, id, presence))
            }
            request => self.execute_request(request, sender),
        }
    }

    fn republish(&self) -> BoxFuture<'_, ()> {
        Box::pin(async move {
            // a refusal is ignored: it means that the runtime is stopping
            let _ = self.pass_to_all(CoordinateSystemRequest::Republish).await;
        })
    }

    fn notice(&self, notice: ServerNotice) {
        match notice {
            ServerNotice::BusLink { connected, broker } => {
                self.shared.bus_connected.store(connected, Ordering::Relaxed);
                self.shared.publish_broker(broker);
            }
            ServerNotice::NotRetained(text) => {
                self.shared
                    .update_standing_warning(&MESSAGES_NOT_KEPT, text.as_deref());
            }
            ServerNotice::Access(note) => {
                self.access.record(&self.shared, note);
                return;
            }
            ServerNotice::Warning(text) => {
                self.shared.raise(AlarmRecord {
                    severity: AlarmSeverity::Warning,
                    number: REQUEST_REFUSED.number,
                    text: text.chars().take(WARNING_TEXT_MAX).collect(),
                    ..AlarmRecord::default()
                });
                return;
            }
        }
        self.shared.wake_all();
    }

    fn time(&self) -> SystemTime {
        self.shared.clock.wall()
    }

    fn servo_timing(&self) -> Option<ServoTiming> {
        let period = self.shared.machine.servo_period();
        (!self.shared.clock.is_simulated()).then(|| self.shared.servo.timing(period))
    }

    fn supervisor(&self) -> Supervisor {
        self.shared.supervisor.clone()
    }
}

#[cfg(test)]
mod tests;
