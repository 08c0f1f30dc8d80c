//! The image of the machine for one scan.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use futures_util::future::{join, join_all};

use super::flags::{Flags, Said, Shown};
use super::watch::CycleTimes;
use super::writes::{Writes, put};
use crate::alarm::Alarm;
use crate::handlers::AuxOutput;
use crate::hub::{Filter, Subscription};
use crate::plc::Plc;
use crate::types::CoordinateSystemNumber;
use crate::types::command::Command;
use crate::types::data::VariableArea;
use crate::types::io::{IoPoint, IoSet, IoState, IoValue};
use crate::types::machine::{AlarmRecord, Birth};
use crate::types::message::{Message, Payload};
use crate::types::output::Params;
use crate::types::request::typed::ReadVariables;
use crate::types::request::{Input, OverrideChange, Refusal, Request, SpindleCommand};
use crate::types::state::{
    Captured, Execution, Lock, LockSet, Modal, OptionalSkip, Overrides, Position, Spindle, SpindleDirection,
    State,
};
use crate::types::topic::{CsTopic, Topic};

/// Positions and variables that a scan program reads: [`ScanProgram::reads`](super::ScanProgram::reads).
///
/// Each is requested from the machine before each scan, so use few of them with a short period.
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
    /// Positions of a coordinate system.
    #[must_use]
    pub fn position(mut self, cs: CoordinateSystemNumber) -> Self {
        self.positions.push(cs);
        self
    }

    /// `count` P variables from `from` on, 1 to 1024, read at one moment.
    #[must_use]
    pub fn p(mut self, from: u32, count: u32) -> Self {
        self.variables.push((VariableArea::Global, from, count));
        self
    }

    /// `count` Q variables of a coordinate system from `from` on, 1 to 1024, read at one moment.
    #[must_use]
    pub fn q(mut self, cs: CoordinateSystemNumber, from: u32, count: u32) -> Self {
        self.variables
            .push((VariableArea::CoordinateSystem(cs), from, count));
        self
    }
}

/// The machine for one scan, and the writes of that scan. Values that are read do not change during a scan; writes are
/// carried out after it and can be read in a later one.
///
/// For a coordinate system that does not exist everything is off, and writes are refused ([`Image::refusals`]).
#[derive(Debug, Default)]
pub struct Image {
    time_s: f64,
    scans: u64,
    overruns: u64,
    cycles: CycleTimes,
    pub(super) said: Said,
    on: BTreeMap<(CoordinateSystemNumber, u16), AuxOutput>,
    states: Arc<States>,
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
    /// State of a coordinate system.
    state: State as State -> State;
    /// Modal G codes, F, S, ta, td, ts.
    modal: Modal as Modal -> Modal;
    /// Positions latched by the last G31; `None` before the first.
    captured: Captured as Captured -> Captured;
    /// Commanded spindle, r/min, and whether it is oriented; for its actual speed see [`Image::position`].
    spindle: Spindle as Spindle -> Spindle;
    /// Overrides, percent.
    overrides: Override as Override -> Overrides;
    /// Optional block skip inputs, and those that the interpreter uses now.
    optional_skip: OptionalSkip as OptionalSkip -> OptionalSkip;
    /// Interlock input and its reason.
    interlock: Interlock as Lock -> Lock;
    /// Start lock input and its reason.
    start_lock: StartLock as Lock -> Lock;
}

/// Values to read.
impl Image {
    /// Time of the image, seconds on the machine's clock.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// The same as a duration, to the nanosecond: what [timers](crate::function_blocks) take.
    pub fn now(&self) -> Duration {
        Duration::try_from_secs_f64(self.time_s).unwrap_or_default()
    }

    /// Number of scans before this one.
    pub fn scans(&self) -> u64 {
        self.scans
    }

    /// Periods without a scan because the one before took too long.
    pub fn overruns(&self) -> u64 {
        self.overruns
    }

    /// How long the scan before took, seconds on the machine's clock, from its image to its last write.
    pub fn last_scan_s(&self) -> f64 {
        self.cycles.last_s
    }

    /// The longest scan so far, seconds.
    pub fn longest_scan_s(&self) -> f64 {
        self.cycles.longest_s
    }

    /// Scans so far that took longer than [`ScanProgram::cycle_limit`](super::ScanProgram::cycle_limit). They are logged.
    /// A program for which a late scan is an alarm writes it: [`Image::set_alarm`].
    pub fn late_scans(&self) -> u64 {
        self.cycles.late
    }

    /// Refusals of writes of the scan before, and of reads for this one.
    pub fn refusals(&self) -> &[Refusal] {
        &self.refusals
    }

    /// True while an M code is put out and not answered. Only codes of this scan program are ever on. Between two outputs
    /// of the same number it is off for at least one scan, so that each has a rising edge.
    pub fn is_on(&self, cs: CoordinateSystemNumber, m: u16) -> bool {
        self.output(cs, m).is_some()
    }

    /// The output of an M code that is on, with program, line and redelivery.
    pub fn output(&self, cs: CoordinateSystemNumber, m: u16) -> Option<&AuxOutput> {
        self.on.get(&(cs, m))
    }

    /// VA to VH of an M code that is on.
    pub fn params(&self, cs: CoordinateSystemNumber, m: u16) -> Option<&Params> {
        self.output(cs, m).map(AuxOutput::params)
    }

    /// State word; STOPPED if there is no such coordinate system.
    pub fn execution(&self, cs: CoordinateSystemNumber) -> Execution {
        self.state(cs).map(|state| state.execution).unwrap_or_default()
    }

    /// True while an optional block skip input, 1 to 31, is on.
    pub fn is_optional_skip(&self, cs: CoordinateSystemNumber, number: u8) -> bool {
        let skip = self.optional_skip(cs);
        skip.is_some_and(|skip| skip.requested.contains(&number))
    }

    /// True while the optional stop input is on.
    pub fn is_optional_stop(&self, cs: CoordinateSystemNumber) -> bool {
        self.is_switch_on(cs, CsTopic::OptionalStop)
    }

    /// True while the single block input is on.
    pub fn is_single_block(&self, cs: CoordinateSystemNumber) -> bool {
        self.is_switch_on(cs, CsTopic::SingleBlock)
    }

    /// True while the dry run input is on.
    pub fn is_dry_run(&self, cs: CoordinateSystemNumber) -> bool {
        self.is_switch_on(cs, CsTopic::DryRun)
    }

    /// Number of the tool in the spindle; 0: none.
    pub fn tool(&self, cs: CoordinateSystemNumber) -> Option<u16> {
        match self.payload(cs, CsTopic::Tool)? {
            Payload::Tool(tool) => Some(tool.id),
            _ => None,
        }
    }

    /// Positions, mm or degrees, feedrate and spindle speed, if requested by [`Reads::position`].
    pub fn position(&self, cs: CoordinateSystemNumber) -> Option<&Position> {
        match &self.positions.get(&cs)?.payload {
            Payload::Position(position) => Some(position),
            _ => None,
        }
    }

    /// Active alarms of the machine, ascending by id.
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

    /// An input of the plant, `[io.in.NAME]`: `image.io_in("door_closed").is_on()`, `image.io_in("level") > 12.5`. Off for one
    /// that the configuration does not declare.
    pub fn io_in(&self, name: &str) -> IoValue {
        self.io_value(&IoPoint::input(name))
    }

    /// An output of the plant, `[io.out.NAME]`, as [`Image::io_in`].
    pub fn io_out(&self, name: &str) -> IoValue {
        self.io_value(&IoPoint::output(name))
    }

    fn io_value(&self, point: &IoPoint) -> IoValue {
        self.io(point).map(|state| state.value).unwrap_or_default()
    }

    /// An input or output of the plant with its owner, and whether it is forced.
    pub fn io(&self, point: &IoPoint) -> Option<&IoState> {
        match &self.states.get(&Topic::Io(point.clone()))?.payload {
            Payload::Io(state) => Some(state),
            _ => None,
        }
    }

    /// What the machine is.
    pub(super) fn birth(&self) -> Option<&Birth> {
        match &self.states.get(&Topic::Birth)?.payload {
            Payload::Birth(birth) => Some(birth),
            _ => None,
        }
    }

    /// A P variable, if requested by [`Reads::p`].
    pub fn p(&self, number: u32) -> Option<f64> {
        self.variables.get(&(VariableArea::Global, number)).copied()
    }

    /// A Q variable, if requested by [`Reads::q`].
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

/// Values to write. A flag of the machine keeps its value, even if others write it, as long as every scan writes it;
/// other flags are left to others. Commands and variables are carried out each time that they are written.
impl Image {
    /// Resets an M code: its program continues. No effect while it is off, so it may be written in every scan.
    pub fn reset(&mut self, cs: CoordinateSystemNumber, m: u16) {
        self.answer(cs, m, Ok(()));
    }

    /// Fails an M code: the alarm stops its program. No effect while it is off.
    pub fn fail(&mut self, cs: CoordinateSystemNumber, m: u16, alarm: Alarm) {
        self.answer(cs, m, Err(alarm));
    }

    /// Reports progress of an M code: [`AuxOutput::progress`]. No effect while it is off.
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

    /// Commands a coordinate system; write it in one scan only. The state shows whether it had its effect.
    pub fn command(&mut self, cs: CoordinateSystemNumber, command: Command) {
        self.writes.commands.push((cs, command));
    }

    /// Sets the tool in the spindle; 0: none.
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

    /// Sets the interlock: while it is on, motion is held and none starts; `text` is the reason.
    pub fn set_interlock(&mut self, cs: CoordinateSystemNumber, value: bool, text: impl Into<String>) {
        self.set_input(cs, Input::Interlock(LockSet::new(value, text)));
    }

    /// Sets the start lock: while it is on, no program starts; `text` is the reason.
    pub fn set_start_lock(&mut self, cs: CoordinateSystemNumber, value: bool, text: impl Into<String>) {
        self.set_input(cs, Input::StartLock(LockSet::new(value, text)));
    }

    /// Sets a source of the interlock, such as one of `[input.interlock.source.NAME]`, beside [`Image::set_interlock`], which is the
    /// source `default`.
    pub fn set_interlock_source(
        &mut self,
        cs: CoordinateSystemNumber,
        source: impl Into<String>,
        value: bool,
        text: impl Into<String>,
    ) {
        self.set_input(cs, Input::Interlock(LockSet::new(value, text).of_source(source)));
    }

    /// Sets a source of the start lock, as [`Image::set_interlock_source`].
    pub fn set_start_lock_source(
        &mut self,
        cs: CoordinateSystemNumber,
        source: impl Into<String>,
        value: bool,
        text: impl Into<String>,
    ) {
        self.set_input(cs, Input::StartLock(LockSet::new(value, text).of_source(source)));
    }

    /// Sets overrides, percent; `None` leaves one unchanged.
    pub fn set_overrides(&mut self, cs: CoordinateSystemNumber, change: OverrideChange) {
        self.set_input(cs, Input::Override(change));
    }

    /// Sets the skip input of a motor, by its CNC motor number: [`Plc::set_skip_input`].
    pub fn set_skip_input(&mut self, motor: u16, value: bool) {
        self.set(Request::SkipInput(motor, value));
    }

    /// Writes an output of the plant, which is this program's from then on: [`Io::set`](crate::Io::set).
    pub fn set_io_out(&mut self, name: &str, value: impl Into<IoValue>) {
        self.set_io(IoPoint::output(name), value.into());
    }

    /// Writes an input of the plant, as a gateway that reads it from a fieldbus: [`Image::set_io_out`].
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

    /// Sets a P variable. Up to 1024 consecutive ones of one scan change together, between two blocks of any program.
    pub fn set_p(&mut self, number: u32, value: f64) {
        self.writes
            .variables
            .insert((VariableArea::Global, number), value);
    }

    /// Sets a Q variable of a coordinate system, as [`Image::set_p`].
    pub fn set_q(&mut self, cs: CoordinateSystemNumber, number: u32, value: f64) {
        let area = VariableArea::CoordinateSystem(cs);
        self.writes.variables.insert((area, number), value);
    }

    /// Outputs that are on.
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

type States = BTreeMap<Topic, Arc<Message>>;

/// Makes images of the latest messages and of what is requested from the machine.
#[derive(Debug)]
pub(super) struct Camera {
    plc: Plc,
    reads: Reads,
    subscription: Subscription,
    states: Arc<States>,
    /// Outputs of the image before.
    shown: Shown,
}

impl Camera {
    pub(super) fn new(plc: &Plc, reads: Reads) -> Self {
        Self {
            plc: plc.clone(),
            reads,
            subscription: plc.port().subscribe(Filter::All),
            states: Arc::default(),
            shown: Shown::new(),
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
        // requests first, so that the rest is as new as possible
        self.request_reads(&mut image).await;
        self.take_messages();
        image.states = Arc::clone(&self.states);
        image.time_s = self.plc.now_s();
        image.on = flags.outputs(&self.shown);
        image.said = flags.said(&image.on);
        let shown = image.on.iter().map(|(place, output)| (*place, output.seq()));
        self.shown = shown.collect();
        image
    }

    /// Takes messages since the image before.
    fn take_messages(&mut self) {
        // the image before has been dropped, so this copies nothing
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
