//! One coordinate system, from the point of view of a sequence program: commands, inputs and readings.

use std::collections::BTreeMap;

use crate::alarm::Alarm;
use crate::error::{Error, Result};
use crate::hub::Filter;
use crate::levels::LockKind;
use crate::plc::Plc;
use crate::types::CoordinateSystemNumber;
use crate::types::command::{Command, CommandMeta, CommandReply, CommandStatus};
use crate::types::lease::LeaseState;
use crate::types::line_start::{LineStart, LineState};
use crate::types::message::Payload;
use crate::types::output::Pending;
use crate::types::refusal::{Refusal, RefusalCode};
use crate::types::request::typed;
use crate::types::request::{Input, OverrideChange, SpindleCommand};
use crate::types::state::{
    Captured, Execution, Lock, LockSet, Modal, OptionalSkip, Overrides, Position, ProgramPlace, Spindle,
    SpindleDirection, State, Tool,
};
use crate::types::topic::{CsTopic, Topic};

/// One CNC coordinate system of a machine. Each command returns when it has had its effect.
#[derive(Debug, Clone)]
pub struct CoordinateSystem {
    plc: Plc,
    number: CoordinateSystemNumber,
    /// Fence of the control lease under which it commands.
    fence: Option<u64>,
}

macro_rules! readings {
    ($($(#[$doc:meta])* $name:ident: $topic:ident as $payload:ident -> $type:ty;)*) => {
        impl CoordinateSystem {
            $(
                $(#[$doc])*
                ///
                /// # Errors
                /// There is no such coordinate system, or it has not published this yet.
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
    /// State word, reason, and the output that the program waits for.
    state: State as State -> State;
    /// Running program, call stack and line.
    program: Program as Program -> ProgramPlace;
    /// Positions of the last servo cycle, over MQTT at most 0.1 s old; mm or degrees, feedrate mm/min.
    position: Position as Position -> Position;
    /// Modal G codes by group, F in mm/min, S in r/min, ta, td and ts in ms.
    modal: Modal as Modal -> Modal;
    /// Positions latched by the last G31.
    captured: Captured as Captured -> Captured;
    /// Spindle, commanded and actual, r/min.
    spindle: Spindle as Spindle -> Spindle;
    /// Tool in the spindle.
    tool: Tool as Tool -> Tool;
    /// Holder of the control lease, if there is one.
    lease: Lease as Lease -> LeaseState;
    /// Overrides, percent.
    overrides: Override as Override -> Overrides;
    /// Optional block skip inputs, and those that the interpreter uses now.
    optional_skip: OptionalSkip as OptionalSkip -> OptionalSkip;
    /// The interlock input and why it is on.
    interlock: Interlock as Lock -> Lock;
    /// The start lock input and why it is on.
    start_lock: StartLock as Lock -> Lock;
    /// Open auxiliary function outputs.
    pending: Pending as Pending -> Pending;
}

/// Commands and inputs: name and arguments, what is sent, and errors beyond those of all.
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
                #[doc = concat!($($errors, " ",)? "No such coordinate system, or the machine cannot be reached.")]
                pub async fn $name(&self, $($argument: $type),*) -> Result<()> {
                    self.$call($value).await
                }
            )*
        }
    };
}

calls! {
    /// Loads a program of the store by its number, 1 to 9999: READY. Allowed in READY, `PROGRAM_COMPLETED` and STOPPED
    /// without an alarm.
    load(program: u16) => command(Command::Load { program }),
        "Not allowed now, no such program, or the program has errors.";

    /// Starts the loaded program from its beginning: ACTIVE.
    start() => command(Command::Start), "Not allowed now, or a start lock is on.";

    /// Starts the loaded program from a line, with the state in force there: M codes to be restored are issued, the
    /// axes approach the start position, then ACTIVE. [`line_state`](Self::line_state) returns all of this in advance.
    start_from(from: LineStart) => command(Command::StartFrom(from)),
        "Not allowed now, a start lock is on, or the state at the line cannot be known.";

    /// Feed hold: `FEED_HOLD` once the axes are at rest. No effect if the program is paused or nothing runs.
    hold() => command(Command::Hold);

    /// Continues after a pause.
    resume() => command(Command::Resume), "Nothing is paused.";

    /// In a feed hold with G500: moves back along the path (`true`) as far as it is known, or forward again (`false`)
    /// as [`resume`](Self::resume) does. Outputs and dwells are not repeated.
    back_trace(on: bool) => command(Command::BackTrace { on }),
        "Not held, or no path to move back on; `false`: back trace is not on.";

    /// Decelerates on the path and ends the run; open outputs are cancelled.
    stop() => command(Command::Stop);

    /// Brakes each motor at its highest deceleration and ends the run; open outputs are cancelled.
    abort() => command(Command::Abort);

    /// Ends the run, cancels open outputs, and clears alarms of this coordinate system and of the whole machine.
    reset() => command(Command::Reset), "The program is ACTIVE.";

    /// Manual data input: runs lines of NC text to their end, then READY. The next input continues with their modal
    /// state, until a program, homing, a stop, an alarm or a reset.
    mdi(text: impl Into<String>) => command(Command::Mdi { text: text.into(), is_macro: false }),
        "Not allowed now, the text has errors, it was ended early, or a G31 of it ended without a touch.";

    /// Runs a text as a macro, for text that a program generates. Its numbers are in the configured unit and are
    /// positions. At its end, however it ends, the machine restores the modal state, the feedrate and the selected
    /// offsets that were in force before.
    mdi_macro(text: impl Into<String>) => command(Command::Mdi { text: text.into(), is_macro: true }),
        "As [`mdi`](Self::mdi).";

    /// Moves axes to their first reference points, then READY; an empty list means all axes.
    home(axes: &[char]) => command(Command::Home { axes: axes.to_vec() }),
        "Not allowed now, there is no such axis, or it was ended early.";

    /// Jogs one axis as long as it is called again with the same `refresh_id` at least every 200 ms. The first call
    /// returns when the jog has ended, the others at once. The sign of `velocity`, mm/min or deg/min, is the direction.
    /// `distance`, mm or degrees, ends the motion; up to `jog_step_max` of `[hmi]` (10 by default) no further call is needed.
    jog(axis: char, velocity: f64, distance: Option<f64>, refresh_id: impl Into<String>) =>
        command(Command::Jog { axis, velocity, distance, refresh_id: refresh_id.into() }),
        "Not allowed now, no such axis, a value out of range, the axis is at its soft limit, or the jog has ended.
         [`Error::CommandFailed`] names the distance covered and the reason if the motion ended before `distance`.";

    /// Ends the jog of this `refresh_id` at once, and returns when the axis rests: READY. If no such jog runs nothing
    /// changes, and one that comes later is refused.
    jog_end(refresh_id: impl Into<String>) => command(Command::JogEnd { refresh_id: refresh_id.into() }),
        "The jog was ended otherwise while it braked.";

    /// Records that an alarm of [`Plc::alarms`] has been seen, and by whom; it stays active until a reset.
    acknowledge_alarm(id: u64) => command(Command::AlarmAcknowledge { id }), "No active alarm has this id.";

    /// Sets one optional block skip input, 1 to 31.
    set_optional_skip(number: u8, value: bool) => set(Input::OptionalSkip(BTreeMap::from([(number, value)]))),
        "A number out of this range.";

    /// Sets the optional stop input (M01).
    set_optional_stop(value: bool) => set(Input::OptionalStop(value));

    /// Sets single block: after each block the axes stop, INTERRUPTED, until a resume.
    set_single_block(value: bool) => set(Input::SingleBlock(value)), "Within cutter compensation or a tapping cycle.";

    /// Sets dry run: blocks interpreted from now on move at the dry run feedrate instead of F, except threads.
    set_dry_run(value: bool) => set(Input::DryRun(value));

    /// Sets source `default` of the interlock: while any source is on, motion is held and none starts; `text` is the
    /// reason. While a [`SequenceProgram`](crate::SequenceProgram) serves this machine, the source belongs to that
    /// program: it is written again on every connection and at every boot, no other sender clears it, and the call
    /// waits for a machine that cannot be reached.
    set_interlock(value: bool, text: impl Into<String>) => set_lock((LockKind::Interlock, LockSet::new(value, text)));

    /// Sets a source of the interlock by its name, such as one of `[input.interlock.source.NAME]`.
    set_interlock_source(source: &str, value: bool, text: impl Into<String>) =>
        set_lock((LockKind::Interlock, LockSet::new(value, text).of_source(source))), "The source is another handler's.";

    /// Sets source `default` of the start lock: while any source is on, no program starts; `text` is the reason. It is
    /// owned as [`set_interlock`](Self::set_interlock) says.
    set_start_lock(value: bool, text: impl Into<String>) => set_lock((LockKind::StartLock, LockSet::new(value, text)));

    /// Sets a source of the start lock by its name, such as one of `[input.start_lock.source.NAME]`.
    set_start_lock_source(source: &str, value: bool, text: impl Into<String>) =>
        set_lock((LockKind::StartLock, LockSet::new(value, text).of_source(source))), "The source is another handler's.";

    /// Sets overrides, percent: feed and spindle 0 to 200, rapid 0 to 100; `None` leaves one unchanged.
    set_overrides(change: OverrideChange) => set(Input::Override(change)), "A value out of range.";
}

impl Plc {
    /// A CNC coordinate system by its number, from 1. If there is none, each call on it is an error.
    pub fn coordinate_system(&self, number: CoordinateSystemNumber) -> CoordinateSystem {
        CoordinateSystem {
            plc: self.clone(),
            number,
            fence: None,
        }
    }
}

impl CoordinateSystem {
    /// The same coordinate system, commanded under a control lease.
    pub(crate) fn under_lease(&self, fence: u64) -> Self {
        Self {
            fence: Some(fence),
            ..self.clone()
        }
    }

    pub(crate) fn plc(&self) -> &Plc {
        &self.plc
    }

    /// Its number, from 1.
    pub fn number(&self) -> CoordinateSystemNumber {
        self.number
    }

    /// Raises an alarm that stops this coordinate system and cancels its open outputs, until a reset.
    /// [`Plc::raise_alarm`] stops all of them.
    ///
    /// # Errors
    /// No such coordinate system, or as [`Plc::raise_alarm`].
    pub async fn raise_alarm(&self, alarm: Alarm) -> Result<()> {
        self.plc.raise(Some(self.number), alarm).await
    }

    /// Executes a command, and returns when its effect has been reached.
    ///
    /// # Errors
    /// [`Error::Refused`] if nothing has changed, [`Error::CommandFailed`] if something prevented its effect,
    /// [`Error::NoAnswer`] if it is not known whether it had its effect: [`CoordinateSystem::command_as`] finds out.
    pub async fn command(&self, command: Command) -> Result<()> {
        let id = self.plc.command_meta().command_id;
        self.command_as(command, id).await
    }

    /// The same under an id of your own, 1 to 128 characters. Sent again with the same id within 10 minutes, such as that of an
    /// [`Error::NoAnswer`], it is never done twice: the answer is how it ended.
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
    /// As [`CoordinateSystem::command`].
    pub async fn command_as(&self, command: Command, command_id: impl Into<String>) -> Result<()> {
        self.reply_to(command, command_id.into()).await.map(drop)
    }

    /// The reply to a command that is done.
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
            CommandStatus::Accepted | CommandStatus::Done => Ok(reply),
        }
    }

    /// Waits until the state word is `execution`, and returns that state.
    ///
    /// # Errors
    /// The machine has ended the connection.
    pub async fn wait_until(&self, execution: Execution) -> Result<State> {
        self.wait_for(|state| state.execution == execution).await
    }

    /// Waits for a state for which `is_it` is true, and returns it. States are examined in order; if they change faster
    /// than they are read, only the latest is.
    ///
    /// # Errors
    /// The machine has ended the connection.
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

    /// Reports the tool in the spindle, by its number in the [tool table](Plc::tools); 0: none. G41 to G44 interpreted
    /// from now on use its dimensions (D17). The number need not be in the table.
    ///
    /// # Errors
    /// No such coordinate system, or the machine cannot be reached.
    pub async fn select_tool(&self, id: u16) -> Result<()> {
        self.plc.request(typed::Tool(self.number, id)).await
    }

    /// Returns the state in force at a line of the loaded program, and the actions of [`start_from`](Self::start_from);
    /// nothing changes.
    ///
    /// # Errors
    /// No program is loaded, it does not come to the line, or the state there cannot be known; the text says why.
    pub async fn line_state(&self, from: LineStart) -> Result<LineState> {
        self.plc.request(typed::LineState(self.number, from)).await
    }

    /// Commands the spindle; `rpm` is used by `Cw` and `Ccw`.
    ///
    /// # Errors
    /// There is no spindle, or the speed is out of its range.
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
            "coordinate system {} does not exist, or has no {what} yet",
            self.number
        );
        Refusal::new(RefusalCode::NotFound, text).into()
    }
}
