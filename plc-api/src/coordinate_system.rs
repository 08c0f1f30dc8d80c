//! One coordinate system, from the point of view of a sequence program: commands, inputs and readings.

use std::collections::BTreeMap;

use plc_protocol::alarm::Alarm;
use plc_protocol::error::{Error, Result};
use plc_protocol::hub::Filter;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::command::{Command, CommandMeta, CommandReply, CommandStatus};
use plc_protocol::types::lease::LeaseState;
use plc_protocol::types::line_start::{LineStart, LineState};
use plc_protocol::types::message::Payload;
use plc_protocol::types::output::Pending;
use plc_protocol::types::refusal::{Refusal, RefusalCode};
use plc_protocol::types::request::typed;
use plc_protocol::types::request::{Input, OverrideChange, SpindleCommand};
use plc_protocol::types::state::{
    CapturedPositions, Execution, Lock, LockSet, Modal, OptionalSkip, Overrides, Position, ProgramLocation,
    Spindle, SpindleDirection, State, Tool,
};
use plc_protocol::types::topic::{CsTopic, Topic};

use crate::levels::LockKind;
use crate::plc::Plc;

/// One CNC coordinate system of a machine. Each method that sends a command returns after the effect of the
/// command.
#[derive(Debug, Clone)]
pub struct CoordinateSystem {
    plc: Plc,
    number: CoordinateSystemNumber,
    /// Fence of the control lease under which this handle sends commands.
    fence: Option<u64>,
}

macro_rules! readings {
    ($($(#[$doc:meta])* $name:ident: $topic:ident as $payload:ident -> $type:ty;)*) => {
        impl CoordinateSystem {
            $(
                $(#[$doc])*
                ///
                /// # Errors
                /// Fails if the coordinate system does not exist, or the machine has not published this value
                /// yet.
                pub async fn $name(&self) -> Result<$type> {
                    let topic = Topic::cs(self.number, CsTopic::$topic);
                    match self.plc.port().read(&topic).await.as_deref().map(|message| &message.payload) {
                        Some(Payload::$payload(value)) => Ok(value.clone()),
                        _ => Err(self.no_value(stringify!($name))),
                    }
                }
            )*
        }
    };
}

readings! {
    /// Returns the state word, the reason, and the output for which the program waits.
    state: State as State -> State;
    /// Returns the running program, the call stack and the line.
    program: Program as Program -> ProgramLocation;
    /// Returns the positions in the last servo cycle, mm or degrees, and the feedrate, mm/min. Over MQTT the
    /// values are at most 0.1 s old.
    position: Position as Position -> Position;
    /// Returns the modal G codes by group, F in mm/min, S in r/min, ta, td and ts in ms.
    modal: Modal as Modal -> Modal;
    /// Returns the positions that the last G31 captured.
    captured: Captured as Captured -> CapturedPositions;
    /// Returns the commanded and the actual spindle speed, r/min.
    spindle: Spindle as Spindle -> Spindle;
    /// Returns the tool in the spindle.
    tool: Tool as Tool -> Tool;
    /// Returns the holder of the control lease; all fields are empty if no client holds the lease.
    lease: Lease as Lease -> LeaseState;
    /// Returns the overrides, percent.
    overrides: Override as Override -> Overrides;
    /// Returns the optional block skip inputs, and those that the interpreter uses now.
    optional_skip: OptionalSkip as OptionalSkip -> OptionalSkip;
    /// Returns the interlock input, and the reasons why it is on.
    interlock: Interlock as Lock -> Lock;
    /// Returns the start lock input, and the reasons why it is on.
    start_lock: StartLock as Lock -> Lock;
    /// Returns the open auxiliary function outputs.
    pending: Pending as Pending -> Pending;
}

/// Defines methods for commands and inputs: name, arguments, request, and errors in addition to the common
/// errors.
macro_rules! calls {
    ($(
        $(#[$doc:meta])*
        $name:ident($($argument:ident: $type:ty),*) => $call:ident($value:expr) $(, $errors:literal)?;
    )*) => {
        impl CoordinateSystem {
            $(
                $(#[$doc])*
                ///
                /// # Errors
                #[doc = concat!($($errors, " ",)? "Fails if the coordinate system does not exist or the machine cannot be reached.")]
                pub async fn $name(&self, $($argument: $type),*) -> Result<()> {
                    self.$call($value).await
                }
            )*
        }
    };
}

calls! {
    /// Loads a program of the store by its number, 1 to 9999. The state word is READY after that. Allowed in
    /// READY, `PROGRAM_COMPLETED` and STOPPED without an alarm.
    load(program: u16) => command(Command::Load { program }),
        "Fails if the command is not allowed now, the program does not exist, or the program has errors.";

    /// Starts the loaded program from its beginning; the state word is ACTIVE after that.
    start() => command(Command::Start), "Fails if the command is not allowed now, or a start lock is on.";

    /// Starts the loaded program from a line, with the state in force at that line: the M codes that must be
    /// restored are issued, the axes approach the start position, then the state word is ACTIVE.
    /// [`line_state`](Self::line_state) returns this state and these actions in advance.
    start_from(from: LineStart) => command(Command::StartFrom(from)),
        "Fails if the command is not allowed now, a start lock is on, or the state at the line is unknown.";

    /// Requests a feed hold: the state word is `FEED_HOLD` as soon as the axes are at rest. No effect if the
    /// program is paused or no program runs.
    hold() => command(Command::Hold);

    /// Continues the program after a pause.
    resume() => command(Command::Resume), "Fails if no program is paused.";

    /// Moves back along the path (`on` is `true`) during a feed hold with G500, as far as the path is known.
    /// If `on` is `false`, moves forward again as [`resume`](Self::resume) does. Outputs and dwells on this
    /// path are not repeated.
    back_trace(on: bool) => command(Command::BackTrace { on }),
        "Fails if the program is not held, no path to move back is known, or `on` is `false` and back trace is not active.";

    /// Decelerates on the path and ends the run; open outputs are cancelled.
    stop() => command(Command::Stop);

    /// Brakes each motor at its highest deceleration and ends the run; open outputs are cancelled.
    abort() => command(Command::Abort);

    /// Ends the run, cancels open outputs, and clears alarms of this coordinate system and of the whole
    /// machine.
    reset() => command(Command::Reset), "Fails if the program is ACTIVE.";

    /// Executes manual data input: runs lines of NC text to their end; the state word is READY after that.
    /// The next manual data input continues with the modal state of these lines, unless a program, homing, a
    /// stop, an alarm or a reset comes between.
    mdi(text: impl Into<String>) => command(Command::Mdi { text: text.into(), is_macro: false }),
        "Fails if the command is not allowed now, the text has errors, the run ended early, or a G31 ended without a touch.";

    /// Runs a text as a macro: NC text that a program generates. The macro starts with the configured unit
    /// and absolute positions (G90) in force. At its end, also after an error or a stop, the machine restores
    /// the modal state, the feedrate and the selected offsets that were in force before the macro.
    mdi_macro(text: impl Into<String>) => command(Command::Mdi { text: text.into(), is_macro: true }),
        "Fails as [`mdi`](Self::mdi).";

    /// Moves axes to their first reference points; the state word is READY after that. An empty list means
    /// all axes.
    home(axes: &[char]) => command(Command::Home { axes: axes.to_vec() }),
        "Fails if the command is not allowed now, an axis does not exist, or the motion ended early.";

    /// Jogs one axis as long as this method is called again with the same `refresh_id` at least every 200 ms.
    /// The first call returns when the jog has ended, the further calls return at once. The sign of
    /// `velocity`, mm/min or deg/min, is the direction. The motion ends after `distance`, mm or degrees. If
    /// `distance` is at most `jog_step_max` of `[hmi]` (10 by default), no further call is needed.
    jog(axis: char, velocity: f64, distance: Option<f64>, refresh_id: impl Into<String>) =>
        command(Command::Jog { axis, velocity, distance, refresh_id: refresh_id.into() }),
        "Fails if the command is not allowed now, the axis does not exist, a value is out of range, the axis is at its
         soft limit, or the jog has ended. [`Error::CommandFailed`] names the distance covered and the reason if the
         motion ended before `distance`.";

    /// Ends the jog with this `refresh_id` at once, and returns when the axis is at rest; the state word is
    /// READY after that. If no such jog runs, nothing changes, and a jog with this `refresh_id` that arrives
    /// later is refused.
    jog_end(refresh_id: impl Into<String>) => command(Command::JogEnd { refresh_id: refresh_id.into() }),
        "Fails if another event ended the jog while the axis decelerated.";

    /// Records that an operator has seen an alarm of [`Plc::alarms`], with the name of the operator. The
    /// alarm stays active until a reset.
    acknowledge_alarm(id: u64) => command(Command::AlarmAcknowledge { id }), "Fails if no active alarm has this id.";

    /// Sets one optional block skip input, 1 to 31.
    set_optional_skip(number: u8, value: bool) => set(Input::OptionalSkip(BTreeMap::from([(number, value)]))),
        "Fails if `number` is out of range.";

    /// Sets the optional stop input (M01).
    set_optional_stop(value: bool) => set(Input::OptionalStop(value));

    /// Sets single block: after each block the axes stop, INTERRUPTED, until a resume.
    set_single_block(value: bool) => set(Input::SingleBlock(value)), "Fails within cutter compensation or a tapping cycle.";

    /// Sets dry run: blocks that are interpreted after this call move at the dry run feedrate instead of F,
    /// except threads.
    set_dry_run(value: bool) => set(Input::DryRun(value));

    /// Sets the source `default` of the interlock. While any source is on, motion is held and no motion
    /// starts; `text` is the reason. If a [`SequenceProgram`](crate::SequenceProgram) runs on the same
    /// [`Plc`], the source belongs to that program: the program writes the source again on every connection
    /// and at every boot, no other sender can clear the source, and the call waits while the machine cannot
    /// be reached.
    set_interlock(value: bool, text: impl Into<String>) => set_lock((LockKind::Interlock, LockSet::new(value, text)));

    /// Sets a source of the interlock by its name, such as a source that `[input.interlock.source.NAME]`
    /// declares. Ownership is as for [`set_interlock`](Self::set_interlock).
    set_interlock_source(source: &str, value: bool, text: impl Into<String>) =>
        set_lock((LockKind::Interlock, LockSet::new(value, text).of_source(source))), "The source is another handler's.";

    /// Sets the source `default` of the start lock. While any source is on, no program starts; `text` is the
    /// reason. Ownership is as for [`set_interlock`](Self::set_interlock).
    set_start_lock(value: bool, text: impl Into<String>) => set_lock((LockKind::StartLock, LockSet::new(value, text)));

    /// Sets a source of the start lock by its name, such as a source that `[input.start_lock.source.NAME]`
    /// declares. Ownership is as for [`set_interlock`](Self::set_interlock).
    set_start_lock_source(source: &str, value: bool, text: impl Into<String>) =>
        set_lock((LockKind::StartLock, LockSet::new(value, text).of_source(source))), "The source is another handler's.";

    /// Sets overrides, percent: feed and spindle 0 to 200, rapid 0 to 100; `None` leaves an override
    /// unchanged.
    set_overrides(change: OverrideChange) => set(Input::Override(change)), "Fails if a value is out of range.";
}

impl Plc {
    /// Returns a handle to a CNC coordinate system by its number, from 1. If the coordinate system does not
    /// exist, each request of the handle fails.
    pub fn coordinate_system(&self, number: CoordinateSystemNumber) -> CoordinateSystem {
        CoordinateSystem {
            plc: self.clone(),
            number,
            fence: None,
        }
    }
}

impl CoordinateSystem {
    /// Returns a handle to the same coordinate system, which sends its commands under a control lease.
    pub(crate) fn under_lease(&self, fence: u64) -> Self {
        Self {
            fence: Some(fence),
            ..self.clone()
        }
    }

    pub(crate) fn plc(&self) -> &Plc {
        &self.plc
    }

    /// Returns the number of the coordinate system, from 1.
    pub fn number(&self) -> CoordinateSystemNumber {
        self.number
    }

    /// Raises an alarm that stops this coordinate system and cancels its open outputs, until a reset.
    /// [`Plc::raise_alarm`] stops all coordinate systems.
    ///
    /// # Errors
    /// Fails as [`Plc::raise_alarm`], and if the coordinate system does not exist.
    pub async fn raise_alarm(&self, alarm: Alarm) -> Result<()> {
        self.plc.raise(Some(self.number), alarm).await
    }

    /// Executes a command, and returns when its effect has been reached.
    ///
    /// # Errors
    /// - [`Error::Refused`] if the machine refused the command; nothing has changed.
    /// - [`Error::CommandFailed`] if the machine accepted the command, but its effect was prevented.
    /// - [`Error::NoAnswer`] if it is unknown whether the command had its effect. Send the command again with
    ///   the same id ([`CoordinateSystem::command_as`]) to find out.
    pub async fn command(&self, command: Command) -> Result<()> {
        let id = self.plc.command_meta().command_id;
        self.command_as(command, id).await
    }

    /// Executes a command as [`command`](Self::command) does, under an id that the caller chooses, 1 to 128
    /// characters. If the same id is sent again within 10 minutes, such as the id of an [`Error::NoAnswer`],
    /// the machine does not execute the command a second time: it returns the result of the first execution.
    ///
    /// ```
    /// use plc_api::types::command::Command;
    /// use plc_api::{CoordinateSystem, Error};
    ///
    /// /// Starts once, over a connection that may be lost.
    /// async fn start(mill: &CoordinateSystem) -> plc_api::Result<()> {
    ///     let mut ended = mill.command(Command::Start).await;
    ///     while let Err(Error::NoAnswer { command_id: Some(id), .. }) = &ended {
    ///         ended = mill.command_as(Command::Start, id).await;
    ///     }
    ///     ended
    /// }
    /// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
    /// # start(&plc_api::fake::FakePort::new([1]).plc().coordinate_system(1)).await
    /// # }
    /// ```
    ///
    /// # Errors
    /// Fails as [`CoordinateSystem::command`].
    pub async fn command_as(&self, command: Command, command_id: impl Into<String>) -> Result<()> {
        self.reply_to(command, command_id.into()).await.map(drop)
    }

    /// Sends a command, and returns the reply that the machine sends after the effect of the command.
    pub(crate) async fn reply_to(&self, command: Command, command_id: String) -> Result<CommandReply> {
        let verb = command.verb();
        let request = typed::Command {
            cs: self.number,
            command,
            meta: CommandMeta {
                fence: self.fence,
                command_id: command_id.clone(),
                ..self.plc.command_meta()
            },
            wait: true,
        };
        let reply = self.plc.request(request).await.map_err(|error| match error {
            Error::NoAnswer { text, .. } => Error::NoAnswer {
                command_id: Some(command_id),
                text,
            },
            other => other,
        })?;
        match reply.status {
            CommandStatus::Rejected => Err(Refusal::new(RefusalCode::NotAllowed, reply.text).into()),
            CommandStatus::Failed => Err(Error::CommandFailed {
                verb: format!("{verb:?}").to_lowercase(),
                cs: self.number,
                code: reply.code,
                text: reply.text,
            }),
            _ => Ok(reply),
        }
    }

    /// Waits until the state word is `execution`, and returns that state.
    ///
    /// # Errors
    /// Fails if the machine has ended the connection.
    pub async fn wait_until(&self, execution: Execution) -> Result<State> {
        self.wait_for(|state| state.execution == execution).await
    }

    /// Waits until `is_it` returns true for a state, and returns that state. `is_it` is called with each
    /// state in order; if the state changes faster than the program reads, `is_it` is called only with the
    /// latest state.
    ///
    /// # Errors
    /// Fails if the machine has ended the connection.
    pub async fn wait_for(&self, is_it: impl Fn(&State) -> bool) -> Result<State> {
        let topic = Topic::cs(self.number, CsTopic::State);
        let mut states = self.plc.port().subscribe(Filter::Topics(vec![topic]));
        while let Some(message) = states.next().await {
            if let Payload::State(state) = &message.payload
                && is_it(state)
            {
                return Ok(state.clone());
            }
        }
        Err(Error::Closed)
    }

    /// Reports the number of the tool in the spindle to the machine; the number refers to the [tool
    /// table](Plc::tools), and 0 means that the spindle is empty. G41 to G44 that are interpreted after this
    /// call use the dimensions of this tool (D17). The table need not contain the number.
    ///
    /// # Errors
    /// Fails if the coordinate system does not exist, or the machine cannot be reached.
    pub async fn select_tool(&self, id: u16) -> Result<()> {
        self.plc.request(typed::Tool(self.number, id)).await
    }

    /// Returns the state in force at a line of the loaded program, and the actions that
    /// [`start_from`](Self::start_from) would take. Nothing changes.
    ///
    /// # Errors
    /// Fails if no program is loaded, the program does not reach the line, or the state at the line is
    /// unknown; the text names the reason.
    pub async fn line_state(&self, from: LineStart) -> Result<LineState> {
        self.plc.request(typed::LineState(self.number, from)).await
    }

    /// Commands the spindle; the directions `Cw` and `Ccw` use the speed `rpm`.
    ///
    /// # Errors
    /// Fails if the coordinate system has no spindle, or the speed is out of range.
    pub async fn set_spindle(&self, direction: SpindleDirection, rpm: f64) -> Result<()> {
        let command = SpindleCommand { direction, rpm };
        self.plc.request(typed::Spindle(self.number, command)).await
    }

    async fn set(&self, input: Input) -> Result<()> {
        self.plc.request(typed::Input(self.number, input)).await
    }

    async fn set_lock(&self, (kind, set): (LockKind, LockSet)) -> Result<()> {
        self.plc.set_lock(self.number, kind, set).await
    }

    fn no_value(&self, what: &str) -> Error {
        let text = format!(
            "coordinate system {} does not exist, or has not published its {what} yet",
            self.number
        );
        Refusal::new(RefusalCode::NotFound, text).into()
    }
}
