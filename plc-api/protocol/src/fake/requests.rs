//! Answers of the scripted machine to requests.

use std::collections::BTreeMap;
use std::time::Duration;

use super::data::Data;
use super::system::System;
use super::{FakeMachine, FakePort};
use crate::handler_registry::PresenceEffect;
use crate::handshake::{Ledger, Now};
use crate::lock::lock;
use crate::port::Port;
use crate::types::command::{Command, CommandMeta, CommandReply, CommandStatus};
use crate::types::handler::HandlerResult;
use crate::types::lease::{LEASE_TTL_DEFAULT_MS, Lease, LeaseRequest};
use crate::types::lock::LockSet;
use crate::types::message::Payload;
use crate::types::not_after::NotAfter;
use crate::types::output::{HandlerPresence, OutputState};
use crate::types::request::{
    Answer, CoordinateSystemRequest, Destination, Input, MachineRequest, Refusal, RefusalCode, Request,
    SpindleCommand,
};
use crate::types::state::{Spindle, SpindleDirection, Tool};
use crate::types::topic::{CsTopic, Topic};
use crate::types::{CoordinateSystemNumber, Timestamp};
use crate::wire::takes_not_after;

impl FakePort {
    pub(super) fn answer(&self, request: Request) -> Result<Answer, Refusal> {
        self.record_request(&request);
        match request.into() {
            Destination::CoordinateSystem(cs, request) => self.answer_coordinate_system(cs, request),
            Destination::Machine(request) => self.answer_machine(request),
            Destination::Program(_) => unsupported(),
        }
    }

    /// Rejects a request if its age limit has passed on the clock of the scripted machine.
    pub(super) fn check_age(&self, not_after: &NotAfter, request: &Request) -> Result<(), Refusal> {
        let now_ms = Duration::try_from_secs_f64(lock(&self.inner).now_s).unwrap_or_default();
        let age_ms = now_ms.as_millis().saturating_sub(not_after.heartbeat.into());
        let is_old = age_ms > not_after.within_ms.into() || not_after.boot_id != self.boot_id();
        if is_old && takes_not_after(request) {
            let text = format!("the request is {age_ms} ms old; send a new one");
            return Err(Refusal::new(RefusalCode::Expired, text));
        }
        Ok(())
    }

    fn answer_coordinate_system(
        &self,
        cs: CoordinateSystemNumber,
        request: CoordinateSystemRequest,
    ) -> Result<Answer, Refusal> {
        match request {
            CoordinateSystemRequest::Output(m, request) => self
                .ledger(cs, |ledger, now| ledger.execute_request(now, m, &request))?
                .map(Answer::Handshake),
            CoordinateSystemRequest::ValidateResult(_, result) => {
                lock(&self.inner).validated.push(result);
                Ok(Answer::Done)
            }
            CoordinateSystemRequest::Command { command, meta, .. } => self.command(cs, &command, meta),
            CoordinateSystemRequest::Lease { request, meta } => Ok(lock(&self.inner).lease(request, meta)),
            CoordinateSystemRequest::Input(input) => self.input(cs, input),
            CoordinateSystemRequest::Tool(id) => self.set(cs, CsTopic::Tool, Payload::Tool(Tool { id })),
            CoordinateSystemRequest::Spindle(command) => self.set(cs, CsTopic::Spindle, spindle(command)),
            _ => unsupported(),
        }
    }

    fn answer_machine(&self, request: MachineRequest) -> Result<Answer, Refusal> {
        match request {
            MachineRequest::Handler(id, presence) => {
                self.handler(&id, &presence)?;
                Ok(Answer::Done)
            }
            MachineRequest::Handlers => Ok(Answer::Handlers(self.handlers())),
            MachineRequest::RaiseAlarm(raise) => self.on_raise(&raise).map(|()| Answer::Done),
            MachineRequest::AlarmHistory => Ok(Answer::Alarms(lock(&self.inner).alarms.clone())),
            MachineRequest::Heartbeat(_, beat) => beat.check().map(|()| Answer::Done),
            MachineRequest::SkipInput(..) => Ok(Answer::Done),
            MachineRequest::ReadVariables {
                area, from, count, ..
            } => lock(&self.inner).data.read(area, from, count),
            MachineRequest::WriteVariables {
                area, from, values, ..
            } => self.change_data(|data| data.write(area, from, &values)),
            MachineRequest::WriteIo(point, set) => self.write_io(point, set),
            MachineRequest::ForceIo(point, force) => self.force_io(point, force),
            MachineRequest::Tools => Ok(lock(&self.inner).data.tools()),
            MachineRequest::WriteTools(change) => self.change_data(|data| Ok(data.change_tools(&change))),
            MachineRequest::WorkOffsets(cs) => Ok(lock(&self.inner).data.work_offsets(cs)),
            MachineRequest::WriteWorkOffsets(cs, change) => {
                self.change_data(|data| Ok(data.change_work_offsets(cs, change)))
            }
            MachineRequest::LastRun(_) => Ok(Answer::LastRun(None)),
            MachineRequest::Journal { .. } => Ok(Answer::Journal(Vec::new())),
            MachineRequest::Programs => Ok(Answer::Programs(Vec::new())),
            _ => unsupported(),
        }
    }

    /// Calls `change` to change variables, tools or offsets, and publishes the changes.
    fn change_data(
        &self,
        change: impl FnOnce(&mut Data) -> Result<Answer, Refusal>,
    ) -> Result<Answer, Refusal> {
        let mut inner = lock(&self.inner);
        let answer = change(&mut inner.data)?;
        self.publish_data(&mut inner);
        Ok(answer)
    }

    fn ledger<T>(
        &self,
        cs: CoordinateSystemNumber,
        ask: impl FnOnce(&mut Ledger, Now) -> T,
    ) -> Result<T, Refusal> {
        self.with(cs, ask).ok_or_else(|| missing(cs))
    }

    fn set(&self, cs: CoordinateSystemNumber, topic: CsTopic, payload: Payload) -> Result<Answer, Refusal> {
        lock(&self.inner).system(cs)?;
        self.publish_message(cs, topic, payload);
        Ok(Answer::Done)
    }

    fn input(&self, cs: CoordinateSystemNumber, input: Input) -> Result<Answer, Refusal> {
        let mut inner = lock(&self.inner);
        let judged = match &input {
            Input::Interlock(LockSet {
                handler_id: Some(id),
                instance,
                ..
            })
            | Input::StartLock(LockSet {
                handler_id: Some(id),
                instance,
                ..
            }) => inner.handlers.check_writer(id, instance.as_ref()),
            _ => Ok(()),
        };
        inner.system(cs)?.set_input(input, |_, _| judged.clone())?;
        self.publish_system(&mut inner, cs);
        Ok(Answer::Done)
    }

    /// Executes a command at once. A command that would move axes only changes the state.
    fn command(
        &self,
        cs: CoordinateSystemNumber,
        command: &Command,
        meta: CommandMeta,
    ) -> Result<Answer, Refusal> {
        let mut inner = lock(&self.inner);
        let alarm_active = inner.alarm_count(cs) > 0;
        let cancel = inner.system(cs)?.command(command, alarm_active)?;
        match command {
            Command::Reset => self.clear_alarms(&mut inner, cs),
            Command::AlarmAcknowledge { id } => self.acknowledge(&mut inner, *id, &meta.client_id)?,
            _ => {}
        }
        inner.system(cs)?.set_last_command(&meta.command_id);
        match cancel {
            Some(reason) => self.end_run(&mut inner, cs, reason),
            None => self.issue_queued_outputs(&mut inner, cs),
        }
        self.publish_system(&mut inner, cs);
        Ok(Answer::Command(inner.done(meta)))
    }

    /// Issues the outputs that were queued while the run was paused (D18).
    fn issue_queued_outputs(&self, inner: &mut FakeMachine, cs: CoordinateSystemNumber) {
        let system = inner.systems.get(&cs).filter(|system| !system.is_paused());
        let open = system.map(|system| system.ledger.open()).unwrap_or_default();
        let queued = open.iter().filter(|output| output.state() == OutputState::Queued);
        for seq in queued.map(|output| output.notice.seq).collect::<Vec<_>>() {
            self.use_ledger(inner, cs, |ledger, now| ledger.issue_output(now, seq));
        }
    }

    /// Records a request, unless it belongs to the handshake.
    fn record_request(&self, request: &Request) {
        let is_handshake = matches!(
            Destination::from(request.clone()),
            Destination::CoordinateSystem(
                _,
                CoordinateSystemRequest::Output(..) | CoordinateSystemRequest::ValidateResult(..)
            ) | Destination::Machine(MachineRequest::Handler(..) | MachineRequest::Handlers)
        );
        if !is_handshake {
            lock(&self.inner).requests.push(request.clone());
        }
    }

    fn handler(&self, id: &str, presence: &HandlerPresence) -> Result<(), Refusal> {
        let changed = {
            let mut inner = lock(&self.inner);
            let (now, now_s) = (inner.now().time, inner.now_s);
            let changed = inner.handlers.set(id, presence, now, now_s);
            let asked = inner.handlers.instance_to_confirm(id).map(ToOwned::to_owned);
            (changed, asked)
        };
        let (changed, asked) = changed;
        if let Some(asked) = asked {
            self.publish_handler_result(id, HandlerResult::confirm(Some(asked)));
        }
        let changed = match changed {
            Ok(changed) => changed,
            Err(refusal) => {
                self.publish_handler_result(id, HandlerResult::refused(presence.instance.clone(), &refusal));
                return Err(refusal);
            }
        };
        let mut has_returned = false;
        match changed {
            PresenceEffect::Nothing => return Ok(()),
            PresenceEffect::Refreshed => {
                self.publish_handler_result(id, HandlerResult::accepted(presence.instance.clone()));
                return Ok(());
            }
            PresenceEffect::Offline(departure) => self.mark_handler_offline(id, departure),
            PresenceEffect::Online {
                took_over,
                has_returned: returned,
                ..
            } => {
                has_returned = returned;
                if let Some(displaced) = took_over {
                    self.mark_handler_offline(id, displaced.departure);
                    let instance = displaced.presence.instance;
                    self.publish_handler_result(id, HandlerResult::taken_over(instance, displaced.text));
                }
                self.mark_handler_online(id);
            }
        }
        let shown = HandlerPresence {
            take_over: false,
            ..presence.clone()
        };
        let topic = Topic::HandlerPresence(id.to_owned());
        self.publish(&mut lock(&self.inner), topic, Payload::HandlerPresence(shown));
        if presence.online {
            self.use_all_ledgers(|_, ledger, now| ledger.handler_online(now, id, presence));
            self.publish_handler_result(id, HandlerResult::accepted(presence.instance.clone()));
            if has_returned {
                self.publish_handler_result(id, HandlerResult::confirm(presence.instance.clone()));
            }
        }
        Ok(())
    }

    fn publish_handler_result(&self, id: &str, result: HandlerResult) {
        let topic = Topic::HandlerResult(id.to_owned());
        self.publish(&mut lock(&self.inner), topic, Payload::HandlerResult(result));
    }
}

impl FakeMachine {
    /// Returns a coordinate system of the fake machine.
    ///
    /// # Errors
    /// Fails if the coordinate system does not exist.
    pub(super) fn system(&mut self, cs: CoordinateSystemNumber) -> Result<&mut System, Refusal> {
        self.systems.get_mut(&cs).ok_or_else(|| missing(cs))
    }

    fn done(&self, meta: CommandMeta) -> CommandReply {
        CommandReply {
            command_id: meta.command_id,
            status: CommandStatus::Done,
            code: "ok".to_owned(),
            text: String::new(),
            state_rev: self.rev,
            variables: None,
            lease: None,
            hash: None,
            run_id: None,
            moved: BTreeMap::new(),
        }
    }

    fn lease(&mut self, request: LeaseRequest, meta: CommandMeta) -> Answer {
        Answer::Command(CommandReply {
            lease: self.granted(request, &meta),
            ..self.done(meta)
        })
    }

    /// Grants each request to take a lease; each new lease has its own fence. Returns `None` for any other
    /// request.
    fn granted(&mut self, request: LeaseRequest, meta: &CommandMeta) -> Option<Lease> {
        let LeaseRequest::Take(take) = request else {
            return None;
        };
        self.leases += u64::from(take.fence.is_none());
        let ttl = Duration::from_millis(take.ttl_ms.unwrap_or(LEASE_TTL_DEFAULT_MS));
        Some(Lease {
            holder: take.holder.unwrap_or_else(|| meta.client_id.clone()),
            fence: take.fence.unwrap_or(self.leases),
            expires_at: Timestamp::from_system_time(self.now().time + ttl),
        })
    }
}

/// Refuses a request that the scripted machine does not support. It supports the requests that sequence
/// programs need in unit tests.
fn unsupported() -> Result<Answer, Refusal> {
    let text = "the scripted machine (FakePort) does not support this; test with tandem_testing";
    Err(Refusal::new(RefusalCode::NotSupported, text))
}

fn spindle(command: SpindleCommand) -> Payload {
    let turns = matches!(command.direction, SpindleDirection::Cw | SpindleDirection::Ccw);
    Payload::Spindle(Spindle {
        direction: command.direction,
        rpm: command.rpm,
        actual_rpm: if turns { command.rpm } else { 0.0 },
        oriented: command.direction == SpindleDirection::Orient,
    })
}

fn missing(cs: CoordinateSystemNumber) -> Refusal {
    let text = format!("coordinate system {cs} does not exist");
    Refusal::new(RefusalCode::NotFound, text)
}
