//! The image of the machine for one scan.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use futures_util::future::{join, join_all};
use plc_protocol::alarm::Alarm;
use plc_protocol::hub::{Filter, Subscription};
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::command::Command;
use plc_protocol::types::data::VariableArea;
use plc_protocol::types::io::{IoPoint, IoSet, IoState, IoValue};
use plc_protocol::types::machine::{AlarmRecord, Birth};
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::output::Params;
use plc_protocol::types::request::typed::ReadVariables;
use plc_protocol::types::request::{Input, OverrideChange, Refusal, Request, SpindleCommand};
use plc_protocol::types::state::{
    CapturedPositions, Execution, Lock, LockSet, Modal, OptionalSkip, Overrides, Position, Spindle,
    SpindleDirection, State,
};
use plc_protocol::types::topic::{CsTopic, Topic};

use super::flags::{Flags, OperatorAnswers, ShownSeqs};
use super::watch::CycleTimes;
use super::writes::{Writes, put};
use crate::handlers::AuxOutput;
use crate::plc::Plc;

/// Positions and variables that a scan program reads, returned by
/// [`ScanProgram::reads`](super::ScanProgram::reads).
///
/// Before each scan, the program requests each of these values from the machine. With a short period, read
/// only a few of them.
///
/// ```
/// use plc_api::scan::Reads;
/// let reads = Reads::default().position(1).p(100, 10).q(1, 0, 4);
/// ```
#[derive(Debug, Clone, Default)]
pub struct Reads {
    positions: Vec<CoordinateSystemNumber>,
    variables: Vec<(VariableArea, u32, u32)>,
}

impl Reads {
    /// Adds the positions of a coordinate system.
    #[must_use]
    pub fn position(mut self, cs: CoordinateSystemNumber) -> Self {
        self.positions.push(cs);
        self
    }

    /// Adds `count` P variables (1 to 1024) from number `from` on. All of them are read at one moment.
    #[must_use]
    pub fn p(mut self, from: u32, count: u32) -> Self {
        self.variables.push((VariableArea::Global, from, count));
        self
    }

    /// Adds `count` Q variables (1 to 1024) of a coordinate system from number `from` on. All of them are
    /// read at one moment.
    #[must_use]
    pub fn q(mut self, cs: CoordinateSystemNumber, from: u32, count: u32) -> Self {
        self.variables
            .push((VariableArea::CoordinateSystem(cs), from, count));
        self
    }
}

/// State of the machine for one scan, and the writes of that scan. The values that a scan reads do not change
/// during the scan. Writes are executed after the scan, and a later scan can read their effect.
///
/// For a coordinate system that does not exist, all flags are off, and writes are refused
/// ([`Image::refusals`]).
#[derive(Debug, Default)]
pub struct Image {
    time_s: f64,
    scans: u64,
    overruns: u64,
    cycles: CycleTimes,
    pub(super) operator_answers: OperatorAnswers,
    on: BTreeMap<(CoordinateSystemNumber, u16), AuxOutput>,
    states: Arc<StateMessages>,
    positions: BTreeMap<CoordinateSystemNumber, Arc<Message>>,
    variables: BTreeMap<(VariableArea, u32), f64>,
    refusals: Vec<Refusal>,
    pub(super) writes: Writes,
}

macro_rules! values {
    ($($(#[$doc:meta])* $name:ident: $topic:ident as $payload:ident -> $type:ty;)*) => {
        impl Image {
            $(
                $(#[$doc])*
                pub fn $name(&self, cs: CoordinateSystemNumber) -> Option<&$type> {
                    match self.payload(cs, CsTopic::$topic)? {
                        Payload::$payload(value) => Some(value),
                        _ => None,
                    }
                }
            )*
        }
    };
}

values! {
    /// Returns the state of a coordinate system.
    state: State as State -> State;
    /// Returns the modal G codes, F, S, ta, td and ts.
    modal: Modal as Modal -> Modal;
    /// Returns the positions that the last G31 latched; `None` before the first G31.
    captured: Captured as Captured -> CapturedPositions;
    /// Returns the commanded spindle speed, r/min, and whether the spindle is oriented. For the actual speed
    /// see [`Image::position`].
    spindle: Spindle as Spindle -> Spindle;
    /// Returns the overrides, percent.
    overrides: Override as Override -> Overrides;
    /// Returns the optional block skip inputs, and the inputs that the interpreter uses now.
    optional_skip: OptionalSkip as OptionalSkip -> OptionalSkip;
    /// Returns the interlock input and its reason.
    interlock: Interlock as Lock -> Lock;
    /// Returns the start lock input and its reason.
    start_lock: StartLock as Lock -> Lock;
}

/// Methods that read the image.
impl Image {
    /// Returns the time of the image, seconds on the machine's clock.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Returns the time of the image as a duration, with a resolution of nanoseconds, for the
    /// [timers](crate::function_blocks).
    pub fn now(&self) -> Duration {
        Duration::try_from_secs_f64(self.time_s).unwrap_or_default()
    }

    /// Returns the number of scans before this one.
    pub fn scans(&self) -> u64 {
        self.scans
    }

    /// Returns the number of periods without a scan because the previous scan took too long.
    pub fn overruns(&self) -> u64 {
        self.overruns
    }

    /// Returns the duration of the previous scan, from its image to its last write, seconds on the machine's
    /// clock.
    pub fn last_scan_s(&self) -> f64 {
        self.cycles.last_s
    }

    /// Returns the duration of the longest scan so far, seconds.
    pub fn longest_scan_s(&self) -> f64 {
        self.cycles.longest_s
    }

    /// Returns the number of late scans so far. A scan is late if it took longer than
    /// [`ScanProgram::cycle_limit`](super::ScanProgram::cycle_limit). Late scans are logged. To raise an
    /// alarm for a late scan, call [`Image::set_alarm`].
    pub fn late_scans(&self) -> u64 {
        self.cycles.late
    }

    /// Returns the refusals of writes of the previous scan, and the refusals of reads for this scan.
    pub fn refusals(&self) -> &[Refusal] {
        &self.refusals
    }

    /// Returns true while an output of this M code is issued and not answered. Only M codes of this scan
    /// program can be on. Between two outputs with the same number, the flag is off for at least one scan, so
    /// that each output has a rising edge.
    pub fn is_on(&self, cs: CoordinateSystemNumber, m: u16) -> bool {
        self.output(cs, m).is_some()
    }

    /// Returns the output of an M code that is on, with NC program, line and redelivery.
    pub fn output(&self, cs: CoordinateSystemNumber, m: u16) -> Option<&AuxOutput> {
        self.on.get(&(cs, m))
    }

    /// Returns the parameters VA to VH of an M code that is on.
    pub fn params(&self, cs: CoordinateSystemNumber, m: u16) -> Option<&Params> {
        self.output(cs, m).map(AuxOutput::params)
    }

    /// Returns the state word, or STOPPED if the coordinate system does not exist.
    pub fn execution(&self, cs: CoordinateSystemNumber) -> Execution {
        self.state(cs).map(|state| state.execution).unwrap_or_default()
    }

    /// Returns true while an optional block skip input, 1 to 31, is on.
    pub fn is_optional_skip(&self, cs: CoordinateSystemNumber, number: u8) -> bool {
        let skip = self.optional_skip(cs);
        skip.is_some_and(|skip| skip.requested.contains(&number))
    }

    /// Returns true while the optional stop input is on.
    pub fn is_optional_stop(&self, cs: CoordinateSystemNumber) -> bool {
        self.is_switch_on(cs, CsTopic::OptionalStop)
    }

    /// Returns true while the single block input is on.
    pub fn is_single_block(&self, cs: CoordinateSystemNumber) -> bool {
        self.is_switch_on(cs, CsTopic::SingleBlock)
    }

    /// Returns true while the dry run input is on.
    pub fn is_dry_run(&self, cs: CoordinateSystemNumber) -> bool {
        self.is_switch_on(cs, CsTopic::DryRun)
    }

    /// Returns the number of the tool in the spindle; 0 if the spindle is empty.
    pub fn tool(&self, cs: CoordinateSystemNumber) -> Option<u16> {
        match self.payload(cs, CsTopic::Tool)? {
            Payload::Tool(tool) => Some(tool.id),
            _ => None,
        }
    }

    /// Returns the positions (mm or degrees), the feedrate and the spindle speed, if [`Reads::position`]
    /// requests them.
    pub fn position(&self, cs: CoordinateSystemNumber) -> Option<&Position> {
        match &self.positions.get(&cs)?.payload {
            Payload::Position(position) => Some(position),
            _ => None,
        }
    }

    /// Returns the active alarms of the machine, ascending by id.
    pub fn alarms(&self) -> &[AlarmRecord] {
        match self
            .states
            .get(&Topic::AlarmActive)
            .map(|message| &message.payload)
        {
            Some(Payload::AlarmActive(active)) => &active.alarms,
            _ => &[],
        }
    }

    /// Returns the value of an input of the plant, `[io.in.NAME]`: `image.io_in("door_closed").is_on()`,
    /// `image.io_in("level") > 12.5`. An input that the configuration does not declare is off.
    pub fn io_in(&self, name: &str) -> IoValue {
        self.io_value(&IoPoint::input(name))
    }

    /// Returns the value of an output of the plant, `[io.out.NAME]`, as [`Image::io_in`] does for an input.
    pub fn io_out(&self, name: &str) -> IoValue {
        self.io_value(&IoPoint::output(name))
    }

    fn io_value(&self, point: &IoPoint) -> IoValue {
        self.io(point).map(|state| state.value).unwrap_or_default()
    }

    /// Returns the state of an input or output of the plant: the value, the owner, and whether the value is
    /// forced.
    pub fn io(&self, point: &IoPoint) -> Option<&IoState> {
        match &self.states.get(&Topic::Io(point.clone()))?.payload {
            Payload::Io(state) => Some(state),
            _ => None,
        }
    }

    /// Returns the description of the machine.
    pub(super) fn birth(&self) -> Option<&Birth> {
        match &self.states.get(&Topic::Birth)?.payload {
            Payload::Birth(birth) => Some(birth),
            _ => None,
        }
    }

    /// Returns the value of a P variable, if [`Reads::p`] requests it.
    pub fn p(&self, number: u32) -> Option<f64> {
        self.variables.get(&(VariableArea::Global, number)).copied()
    }

    /// Returns the value of a Q variable, if [`Reads::q`] requests it.
    pub fn q(&self, cs: CoordinateSystemNumber, number: u32) -> Option<f64> {
        let area = VariableArea::CoordinateSystem(cs);
        self.variables.get(&(area, number)).copied()
    }

    fn is_switch_on(&self, cs: CoordinateSystemNumber, topic: CsTopic) -> bool {
        matches!(self.payload(cs, topic), Some(Payload::Switch(switch)) if switch.value)
    }

    fn payload(&self, cs: CoordinateSystemNumber, topic: CsTopic) -> Option<&Payload> {
        let message = self.states.get(&Topic::cs(cs, topic))?;
        Some(&message.payload)
    }
}

/// Methods that write the image. If every scan writes a flag of the machine, the flag keeps the written
/// value, even if another client writes the flag. The program does not change flags that no scan writes.
/// Commands and variables are executed each time that a scan writes them.
impl Image {
    /// Resets the output of an M code: its NC program continues. No effect while the M code is off, so a
    /// program may write the reset in every scan.
    pub fn reset(&mut self, cs: CoordinateSystemNumber, m: u16) {
        self.answer(cs, m, Ok(()));
    }

    /// Ends the output of an M code as failed: the alarm stops its NC program. No effect while the M code is
    /// off.
    pub fn fail(&mut self, cs: CoordinateSystemNumber, m: u16, alarm: Alarm) {
        self.answer(cs, m, Err(alarm));
    }

    /// Reports progress of an M code, as [`AuxOutput::progress`] does. No effect while the M code is off.
    pub fn progress(
        &mut self,
        cs: CoordinateSystemNumber,
        m: u16,
        text: impl Into<String>,
        percent: impl Into<Option<f64>>,
    ) {
        if let Some(output) = self.on.get(&(cs, m)) {
            let progress = (output.clone(), text.into(), percent.into());
            self.writes.progress.push(progress);
        }
    }

    /// Sends a command to a coordinate system. Write a command in one scan only. The state shows whether the
    /// command had its effect.
    pub fn command(&mut self, cs: CoordinateSystemNumber, command: Command) {
        self.writes.commands.push((cs, command));
    }

    /// Sets the number of the tool in the spindle; 0 means that the spindle is empty.
    pub fn select_tool(&mut self, cs: CoordinateSystemNumber, id: u16) {
        self.set(Request::Tool(cs, id));
    }

    /// Commands the spindle; `rpm` is used by `Cw` and `Ccw`.
    pub fn set_spindle(&mut self, cs: CoordinateSystemNumber, direction: SpindleDirection, rpm: f64) {
        self.set(Request::Spindle(cs, SpindleCommand { direction, rpm }));
    }

    /// Sets one optional block skip input, 1 to 31.
    pub fn set_optional_skip(&mut self, cs: CoordinateSystemNumber, number: u8, value: bool) {
        self.set_input(cs, Input::OptionalSkip(BTreeMap::from([(number, value)])));
    }

    /// Sets the optional stop input (M01).
    pub fn set_optional_stop(&mut self, cs: CoordinateSystemNumber, value: bool) {
        self.set_input(cs, Input::OptionalStop(value));
    }

    /// Sets single block: after each block the axes stop, INTERRUPTED, until a resume.
    pub fn set_single_block(&mut self, cs: CoordinateSystemNumber, value: bool) {
        self.set_input(cs, Input::SingleBlock(value));
    }

    /// Sets the source `default` of the interlock. While the interlock is on, motion is held and no motion
    /// starts; `text` is the reason.
    pub fn set_interlock(&mut self, cs: CoordinateSystemNumber, value: bool, text: impl Into<String>) {
        self.set_input(cs, Input::Interlock(LockSet::new(value, text)));
    }

    /// Sets the source `default` of the start lock. While the start lock is on, no program starts; `text` is
    /// the reason.
    pub fn set_start_lock(&mut self, cs: CoordinateSystemNumber, value: bool, text: impl Into<String>) {
        self.set_input(cs, Input::StartLock(LockSet::new(value, text)));
    }

    /// Sets a source of the interlock by its name, such as a source that `[input.interlock.source.NAME]`
    /// declares. [`Image::set_interlock`] sets the source `default`.
    pub fn set_interlock_source(
        &mut self,
        cs: CoordinateSystemNumber,
        source: impl Into<String>,
        value: bool,
        text: impl Into<String>,
    ) {
        self.set_input(cs, Input::Interlock(LockSet::new(value, text).of_source(source)));
    }

    /// Sets a source of the start lock by its name, as [`Image::set_interlock_source`] does for the
    /// interlock.
    pub fn set_start_lock_source(
        &mut self,
        cs: CoordinateSystemNumber,
        source: impl Into<String>,
        value: bool,
        text: impl Into<String>,
    ) {
        self.set_input(cs, Input::StartLock(LockSet::new(value, text).of_source(source)));
    }

    /// Sets overrides, percent; `None` leaves an override unchanged.
    pub fn set_overrides(&mut self, cs: CoordinateSystemNumber, change: OverrideChange) {
        self.set_input(cs, Input::Override(change));
    }

    /// Sets the skip input of a motor, by its CNC motor number, as [`Plc::set_skip_input`] does.
    pub fn set_skip_input(&mut self, motor: u16, value: bool) {
        self.set(Request::SkipInput(motor, value));
    }

    /// Writes an output of the plant. This program owns the output from then on, see
    /// [`Io::set`](crate::Io::set).
    pub fn set_io_out(&mut self, name: &str, value: impl Into<IoValue>) {
        self.set_io(IoPoint::output(name), value.into());
    }

    /// Writes an input of the plant, for a gateway that reads the input from a fieldbus. Ownership is as for
    /// [`Image::set_io_out`].
    pub fn set_io_in(&mut self, name: &str, value: impl Into<IoValue>) {
        self.set_io(IoPoint::input(name), value.into());
    }

    fn set_io(&mut self, point: IoPoint, value: IoValue) {
        let set = IoSet {
            value,
            ..IoSet::default()
        };
        self.set(Request::WriteIo(point, set));
    }

    /// Sets a P variable. Up to 1024 consecutive variables that one scan sets change together, between two
    /// blocks of any NC program.
    pub fn set_p(&mut self, number: u32, value: f64) {
        self.writes
            .variables
            .insert((VariableArea::Global, number), value);
    }

    /// Sets a Q variable of a coordinate system, as [`Image::set_p`] does for P variables.
    pub fn set_q(&mut self, cs: CoordinateSystemNumber, number: u32, value: f64) {
        let area = VariableArea::CoordinateSystem(cs);
        self.writes.variables.insert((area, number), value);
    }

    /// Returns the outputs that are on.
    pub(super) fn outputs(&self) -> impl Iterator<Item = (&(CoordinateSystemNumber, u16), &AuxOutput)> {
        self.on.iter()
    }

    fn set_input(&mut self, cs: CoordinateSystemNumber, input: Input) {
        self.set(Request::Input(cs, input));
    }

    fn set(&mut self, flag: Request) {
        put(&mut self.writes.flags, flag);
    }

    fn answer(&mut self, cs: CoordinateSystemNumber, m: u16, how: Result<(), Alarm>) {
        if let Some(output) = self.on.get(&(cs, m)) {
            self.writes.answers.insert((cs, m), (output.clone(), how));
        }
    }
}

type StateMessages = BTreeMap<Topic, Arc<Message>>;

/// Creator of images. Combines the latest messages of the machine with values requested for the image.
#[derive(Debug)]
pub(super) struct Camera {
    plc: Plc,
    reads: Reads,
    subscription: Subscription,
    states: Arc<StateMessages>,
    /// Outputs that were on in the previous image.
    shown: ShownSeqs,
}

impl Camera {
    pub(super) fn new(plc: &Plc, reads: Reads) -> Self {
        Self {
            plc: plc.clone(),
            reads,
            subscription: plc.port().subscribe(Filter::All),
            states: Arc::default(),
            shown: ShownSeqs::new(),
        }
    }

    pub(super) async fn image(
        &mut self,
        flags: &Flags,
        (scans, overruns, cycles): (u64, u64, CycleTimes),
        refusals: Vec<Refusal>,
    ) -> Image {
        let mut image = Image {
            scans,
            overruns,
            cycles,
            refusals,
            ..Image::default()
        };
        // requests first, so that the states from messages are as new as possible
        self.request_reads(&mut image).await;
        self.take_messages();
        image.states = Arc::clone(&self.states);
        image.time_s = self.plc.now_s();
        image.on = flags.outputs(&self.shown);
        image.operator_answers = flags.operator_answers(&image.on);
        let shown = image.on.iter().map(|(place, output)| (*place, output.seq()));
        self.shown = shown.collect();
        image
    }

    /// Stores the state messages that have arrived since the previous image.
    fn take_messages(&mut self) {
        // the previous image has been dropped, so this call copies nothing
        let states = Arc::make_mut(&mut self.states);
        while let Some(message) = self.subscription.try_next() {
            if message.topic.is_state() {
                states.insert(message.topic.clone(), message);
            }
        }
    }

    async fn request_reads(&self, image: &mut Image) {
        let port = self.plc.port();
        let variables = self.reads.variables.iter();
        let variables = variables.map(|&(area, from, count)| {
            port.ask(ReadVariables {
                area,
                from,
                count,
                meta: None,
            })
        });
        let positions = self.reads.positions.iter().map(|&cs| async move {
            let message = port.read(&Topic::cs(cs, CsTopic::Position)).await;
            message.map(|message| (cs, message))
        });
        let (variables, positions) = join(join_all(variables), join_all(positions)).await;
        image.positions = positions.into_iter().flatten().collect();
        for (answer, &(area, from, _)) in variables.into_iter().zip(&self.reads.variables) {
            match answer {
                Ok(values) => {
                    let numbered = (from..).map(|number| (area, number)).zip(values);
                    image.variables.extend(numbered);
                }
                Err(refusal) => image.refusals.push(refusal),
            }
        }
    }
}
