//! The image of the machine that one scan reads.

use std::collections::BTreeMap;
use std::sync::Arc;

use futures_util::future::{join, join_all};

use super::flags::Flags;
use super::writes::{Level, Writes};
use crate::alarm::Alarm;
use crate::handlers::AuxOutput;
use crate::hub::{Filter, Subscription};
use crate::plc::Plc;
use crate::types::CoordinateSystemNumber;
use crate::types::command::Command;
use crate::types::data::VariableArea;
use crate::types::machine::AlarmRecord;
use crate::types::message::{Message, Payload};
use crate::types::output::Params;
use crate::types::request::typed::ReadVariables;
use crate::types::request::{Input, OverrideChange, Refusal, SpindleCommand};
use crate::types::state::{
    Captured, Execution, Lock, Modal, OptionalSkip, Overrides, Position, Spindle, SpindleDirection, State,
};
use crate::types::topic::{CsTopic, Topic};

/// What a scan program reads beside what stands in every image: [`ScanProgram::reads`](super::ScanProgram::reads).
///
/// Each is asked of the machine before each scan, so a short period has few of them.
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

    /// `count` P variables from `from` on, 1 to 1024, as they are at one moment.
    #[must_use]
    pub fn p(mut self, from: u32, count: u32) -> Self {
        self.variables.push((VariableArea::Global, from, count));
        self
    }

    /// `count` Q variables of a coordinate system from `from` on, 1 to 1024, as they are at one moment.
    #[must_use]
    pub fn q(mut self, cs: CoordinateSystemNumber, from: u32, count: u32) -> Self {
        self.variables
            .push((VariableArea::CoordinateSystem(cs), from, count));
        self
    }
}

/// The machine as one scan sees it, and what the scan writes. Nothing in it changes during a scan; what the scan writes
/// is carried out after it, and read back in a later one.
///
/// Coordinate systems are named by number; of one that does not exist everything is off, and what is written to it is
/// refused ([`Image::refusals`]).
#[derive(Debug, Default)]
pub struct Image {
    time_s: f64,
    scans: u64,
    overruns: u64,
    on: BTreeMap<(CoordinateSystemNumber, u16), AuxOutput>,
    said: Arc<Said>,
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
                    match self.said.get(&Topic::cs(cs, CsTopic::$topic))? {
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
    /// Spindle as commanded, r/min, and whether it is oriented; its speed of now is that of [`Image::position`].
    spindle: Spindle as Spindle -> Spindle;
    /// Overrides, percent.
    overrides: Override as Override -> Overrides;
    /// Optional block skip inputs, and which of them the interpreter reads now.
    optional_skip: OptionalSkip as OptionalSkip -> OptionalSkip;
    /// The interlock input and why it is on.
    interlock: Interlock as Lock -> Lock;
    /// The start lock input and why it is on.
    start_lock: StartLock as Lock -> Lock;
}

/// What is read.
impl Image {
    /// Seconds on the machine's clock when the image was made.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Scans before this one; 0 in the first.
    pub fn scans(&self) -> u64 {
        self.scans
    }

    /// Periods that passed without a scan because the one before took too long.
    pub fn overruns(&self) -> u64 {
        self.overruns
    }

    /// What the machine refused of what the scan before has written, and of what this one reads.
    pub fn refusals(&self) -> &[Refusal] {
        &self.refusals
    }

    /// True while an M code is put out and not answered. Only codes that were given to the scan program are ever on.
    pub fn is_on(&self, cs: CoordinateSystemNumber, m: u16) -> bool {
        self.output(cs, m).is_some()
    }

    /// The output of an M code that is on, with program, line, and whether it was delivered before.
    pub fn output(&self, cs: CoordinateSystemNumber, m: u16) -> Option<&AuxOutput> {
        self.on.get(&(cs, m))
    }

    /// VA to VH of an M code that is on.
    pub fn params(&self, cs: CoordinateSystemNumber, m: u16) -> Option<&Params> {
        self.output(cs, m).map(AuxOutput::params)
    }

    /// State word of a coordinate system; STOPPED where there is none.
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
        match self.said.get(&Topic::cs(cs, CsTopic::Tool))? {
            Payload::Tool(tool) => Some(tool.id),
            _ => None,
        }
    }

    /// Positions, mm or degrees, feedrate and spindle speed; of the coordinate systems that [`Reads::position`] names.
    pub fn position(&self, cs: CoordinateSystemNumber) -> Option<&Position> {
        match &self.positions.get(&cs)?.payload {
            Payload::Position(position) => Some(position),
            _ => None,
        }
    }

    /// Active alarms of the machine, ascending by id.
    pub fn alarms(&self) -> &[AlarmRecord] {
        match self.said.get(&Topic::AlarmActive) {
            Some(Payload::AlarmActive(active)) => &active.alarms,
            _ => &[],
        }
    }

    /// A P variable of a range that [`Reads::p`] names.
    pub fn p(&self, number: u32) -> Option<f64> {
        self.variables.get(&(VariableArea::Global, number)).copied()
    }

    /// A Q variable of a range that [`Reads::q`] names.
    pub fn q(&self, cs: CoordinateSystemNumber, number: u32) -> Option<f64> {
        let area = VariableArea::CoordinateSystem(cs);
        self.variables.get(&(area, number)).copied()
    }

    fn is_switch_on(&self, cs: CoordinateSystemNumber, topic: CsTopic) -> bool {
        let said = self.said.get(&Topic::cs(cs, topic));
        matches!(said, Some(Payload::Switch(switch)) if switch.value)
    }
}

/// What is written. A flag of the machine stays as it is written, also when others write it, as long as every scan
/// writes it; a flag that the scan does not write is left to others. Commands and variables are carried out each time
/// that they are written.
impl Image {
    /// Writes the reset flag of an M code: its program goes on. Without effect while it is off, so that it may be
    /// written in every scan.
    pub fn reset(&mut self, cs: CoordinateSystemNumber, m: u16) {
        self.answer(cs, m, Ok(()));
    }

    /// Fails an M code: the alarm stops its program. Without effect while it is off.
    pub fn fail(&mut self, cs: CoordinateSystemNumber, m: u16, alarm: Alarm) {
        self.answer(cs, m, Err(alarm));
    }

    /// Tells how far the work on an M code is: [`AuxOutput::progress`]. Without effect while it is off.
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

    /// Commands a coordinate system, so it is written in one scan and not in each. Whether it had its effect the state
    /// tells.
    pub fn command(&mut self, cs: CoordinateSystemNumber, command: Command) {
        self.writes.commands.push((cs, command));
    }

    /// Which tool is in the spindle; 0: none.
    pub fn select_tool(&mut self, cs: CoordinateSystemNumber, id: u16) {
        self.writes.set(Level::Tool(cs, id));
    }

    /// Commands the spindle; `rpm` counts for `Cw` and `Ccw`.
    pub fn set_spindle(&mut self, cs: CoordinateSystemNumber, direction: SpindleDirection, rpm: f64) {
        let command = SpindleCommand { direction, rpm };
        self.writes.set(Level::Spindle(cs, command));
    }

    /// Sets one optional block skip input, 1 to 31.
    pub fn set_optional_skip(&mut self, cs: CoordinateSystemNumber, number: u8, value: bool) {
        self.set_input(cs, Input::OptionalSkip(BTreeMap::from([(number, value)])));
    }

    /// Sets the optional stop input (M01).
    pub fn set_optional_stop(&mut self, cs: CoordinateSystemNumber, value: bool) {
        self.set_input(cs, Input::OptionalStop(value));
    }

    /// Sets single block: each block ends at rest, INTERRUPTED, until it is resumed.
    pub fn set_single_block(&mut self, cs: CoordinateSystemNumber, value: bool) {
        self.set_input(cs, Input::SingleBlock(value));
    }

    /// Sets the interlock: while it is on, motion is held and nothing that moves begins; `text` says why.
    pub fn set_interlock(&mut self, cs: CoordinateSystemNumber, value: bool, text: impl Into<String>) {
        let text = text.into();
        self.set_input(cs, Input::Interlock(Lock { value, text }));
    }

    /// Sets the start lock: while it is on, no program begins; `text` says why.
    pub fn set_start_lock(&mut self, cs: CoordinateSystemNumber, value: bool, text: impl Into<String>) {
        let text = text.into();
        self.set_input(cs, Input::StartLock(Lock { value, text }));
    }

    /// Sets overrides, percent; those that are `None` stay.
    pub fn set_overrides(&mut self, cs: CoordinateSystemNumber, change: OverrideChange) {
        self.set_input(cs, Input::Override(change));
    }

    /// Sets the skip input of a motor, by its CNC motor number: [`Plc::set_skip_input`].
    pub fn set_skip_input(&mut self, motor: u16, value: bool) {
        self.writes.set(Level::SkipInput(motor, value));
    }

    /// Sets a P variable. Neighbours written in one scan, up to 1024, change at one moment, between two blocks of any
    /// program.
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

    fn set_input(&mut self, cs: CoordinateSystemNumber, input: Input) {
        self.writes.set(Level::Input(cs, input));
    }

    fn answer(&mut self, cs: CoordinateSystemNumber, m: u16, how: Result<(), Alarm>) {
        if let Some(output) = self.on.get(&(cs, m)) {
            self.writes.answers.insert((cs, m), (output.clone(), how));
        }
    }
}

/// The last value of each state topic.
#[derive(Debug, Clone, Default)]
struct Said(BTreeMap<Topic, Arc<Message>>);

impl Said {
    fn get(&self, topic: &Topic) -> Option<&Payload> {
        self.0.get(topic).map(|message| &message.payload)
    }
}

/// Makes images, each of what the machine has said until then and of what is asked of it.
#[derive(Debug)]
pub(super) struct Camera {
    plc: Plc,
    reads: Reads,
    subscription: Subscription,
    said: Arc<Said>,
}

impl Camera {
    pub(super) fn new(plc: &Plc, reads: Reads) -> Self {
        Self {
            plc: plc.clone(),
            reads,
            subscription: plc.port().subscribe(Filter::All),
            said: Arc::default(),
        }
    }

    pub(super) async fn image(
        &mut self,
        flags: &Flags,
        (scans, overruns): (u64, u64),
        refusals: Vec<Refusal>,
    ) -> Image {
        let mut image = Image {
            scans,
            overruns,
            refusals,
            ..Image::default()
        };
        // what has to be asked comes first, so that nothing else is older than need be
        self.ask(&mut image).await;
        self.hear();
        image.said = Arc::clone(&self.said);
        image.time_s = self.plc.now_s();
        for output in flags.outputs() {
            let place = (output.coordinate_system(), output.m());
            // of several with the same number the first is answered first
            image.on.entry(place).or_insert(output);
        }
        image
    }

    /// Takes what was said since the image before.
    fn hear(&mut self) {
        // no image is left, so that nothing is copied
        let said = Arc::make_mut(&mut self.said);
        while let Some(message) = self.subscription.try_next() {
            if message.topic.is_state() {
                said.0.insert(message.topic.clone(), message);
            }
        }
    }

    async fn ask(&self, image: &mut Image) {
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
