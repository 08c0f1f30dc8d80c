//! A program through interpreter and path stage, without a machine: the alarm that stops it whatever happens around it.
//!
//! What only a machine knows is assumed, twice and differently: where the axes stand at the start, the tool, block skip,
//! where a G31 ends. An alarm that comes both times is certain. P and Q that the program has not written itself are not
//! known at all: where it reads one, it is run again with values that it compares with, and what comes of that is not
//! certain.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::Arc;

use plc_api::types::output::Timing;
use tandem_interp::codes::ModalGroup;
use tandem_interp::meaning::{ModalValue, MotionKind, Role};
use tandem_interp::{Dialect, Inputs, Interpreter, NO_TOOLS};
use tandem_model::alarm::{PROGRAM_NOT_FOUND, VALUE_LOST};
use tandem_model::flow::{Compensation, Item, Output, Segment};
use tandem_model::lost::{LOST, is_lost};
use tandem_model::settings::{CoordinateSystemSettings, MotorKind, MotorSettings, Tool, WorkOffsets};
use tandem_model::variables::{GLOBAL_VARIABLES, VariableArray, Variables};
use tandem_model::{AXES_MAX, Alarm, Axis, AxisVector, Diagnostic, MachinePosition, Origin};
use tandem_path::PathStage;
use tandem_syntax::diagnostics::{self, DiagnosticEntry};
use tandem_syntax::{Address, NcProgram, Word};

use crate::config::{CoordinateSystem as ConfiguredSystem, Machine, Stock};
use crate::coordinate_system::rest_refused;
use crate::sequence::stock::selected_tool;

/// Blocks that a trial takes beyond four times those of the program.
const STEPS_MAX: u64 = 2_000_000;

/// Values that P and Q are given.
const VALUES_MAX: usize = 16;

/// Warnings of the run that are listed.
const WARNINGS_MAX: usize = 100;

/// Limits of motors that nobody has told: none that a program meets.
const UNLIMITED: f64 = 1e9;

/// What is tried.
#[derive(Debug, Clone, Copy)]
pub struct Trial<'a> {
    /// The program; its number is 0.
    pub program: &'a Arc<NcProgram>,
    /// The programs that it may call.
    pub programs: &'a BTreeMap<u16, Arc<NcProgram>>,
    /// Its dialect.
    pub dialect: &'static Dialect,
    /// The machine that it is for, with the coordinate system; `None`: one without limits.
    pub machine: Option<(&'a Machine, &'a ConfiguredSystem)>,
}

/// What a trial shows.
#[derive(Debug, Default, PartialEq)]
pub struct Shown {
    /// The alarm that ends the program.
    pub stop: Option<Stop>,
    /// Warnings of the run, each once; none without a machine.
    pub warnings: Vec<Warning>,
}

/// What a run warns of.
#[derive(Debug, PartialEq)]
pub struct Warning {
    /// Its entry in the table of diagnostics.
    pub entry: &'static DiagnosticEntry,
    /// The block.
    pub origin: Origin,
    /// What is wrong there.
    pub text: String,
}

/// An alarm that ends the program.
#[derive(Debug, PartialEq)]
pub struct Stop {
    /// The alarm, with its place.
    pub alarm: Alarm,
    /// What was assumed, where it depends on that.
    pub assumed: Option<String>,
}

impl Shown {
    /// The findings, each with the number of its program.
    pub fn findings(self, of: &Trial<'_>) -> Vec<(u16, Diagnostic)> {
        let place = |origin: Origin, words: &str| {
            let program = of.programs.get(&origin.program).unwrap_or(of.program);
            program.span_at(origin, words).unwrap_or_default()
        };
        let warnings = self.warnings.into_iter().map(|warning| {
            let Warning { entry, origin, text } = warning;
            let help = format!("See `tandem explain {}`.", entry.code);
            (origin.program, entry.at(place(origin, ""), text, help))
        });
        let stop = self.stop.map(|Stop { alarm, assumed }| {
            let origin = alarm.origin.unwrap_or_default();
            let Alarm {
                entry, text, words, ..
            } = alarm;
            let message = format!("alarm {}: {}: {text}", entry.number, entry.title);
            let span = place(origin, &words);
            let found = match assumed {
                None => diagnostics::STOPS.at(span, message, entry.remedy),
                Some(assumed) => {
                    diagnostics::STOPS_IF.at(span, format!("{message}, where {assumed}"), entry.remedy)
                }
            };
            (origin.program, found)
        });
        warnings.chain(stop).collect()
    }
}

/// What only a machine knows.
#[derive(Debug, Clone, Copy)]
struct Assumed {
    start: f64,
    tool: Tool,
    optional_skip: u32,
    /// Of the way of a G31 that is travelled.
    skip_share: f64,
    /// P and Q that the program has not written.
    outside: f64,
}

const FIRST: Assumed = Assumed {
    start: 0.0,
    tool: Tool {
        length: 0.0,
        radius: 0.0,
    },
    optional_skip: 0,
    skip_share: 1.0,
    outside: LOST,
};

const SECOND: Assumed = Assumed {
    start: 1.375,
    tool: Tool {
        length: 2.0,
        radius: 0.0,
    },
    optional_skip: u32::MAX,
    skip_share: 0.5,
    outside: LOST,
};

/// How a run ends.
enum End {
    Alarm(Alarm),
    /// It ends, or nobody can tell.
    Open,
    /// It reads a variable that it has not written.
    Reads,
}

impl Trial<'_> {
    /// Runs the program, some times; all runs together take at most four times its blocks and two millions more.
    pub fn run(&self) -> Shown {
        if self.machine.is_none() && self.all().all(|program| self.is_plain(program)) {
            return Shown::default();
        }
        let settings = match self.machine {
            Some((_, system)) => Cow::Borrowed(&system.settings),
            None => Cow::Owned(unlimited(self.dialect)),
        };
        let mut runs = Runs {
            trial: self,
            settings: &settings,
            steps_left: 4 * self.program.blocks().len() as u64 + STEPS_MAX,
            warnings: Vec::new(),
        };
        let stop = match runs.once(FIRST) {
            End::Alarm(alarm) => Some(runs.compare(alarm)),
            End::Reads => runs.with_values(),
            End::Open if self.has_skips() => runs.with_skips(LOST),
            End::Open => None,
        };
        let is_told = self.machine.is_some();
        Shown {
            stop,
            warnings: if is_told { runs.warnings } else { Vec::new() },
        }
    }

    fn all(&self) -> impl Iterator<Item = &Arc<NcProgram>> {
        std::iter::once(self.program).chain(self.programs.values())
    }

    /// Straight lines and nothing that changes them: without limits no stage refuses one, and no loop goes on for ever.
    fn is_plain(&self, program: &NcProgram) -> bool {
        let mut last = None;
        let mut is_known = |word: &Word| {
            let code = Some((word.address, word.number().map(f64::to_bits)));
            std::mem::replace(&mut last, code) == code
        };
        program.blocks().iter().all(|block| {
            let mut words = program.words(block).iter();
            program.program_code(block).is_none()
                && words.all(|word| {
                    !matches!(word.address, Address::G | Address::M)
                        || is_known(word)
                        || self.is_plain_code(word)
                })
        })
    }

    fn is_plain_code(&self, word: &Word) -> bool {
        let code = word
            .number()
            .and_then(|number| self.dialect.code(word.address, number));
        match code.map(|code| (code.role, code.sets)) {
            None => word.address == Address::M,
            Some((Role::Motion(kind), _)) => kind != MotionKind::Arc,
            Some((Role::Plain, sets)) => matches!(
                sets,
                None | Some(
                    ModalValue::Plane(_)
                        | ModalValue::Distance(_)
                        | ModalValue::Unit(_)
                        | ModalValue::PathControl(_)
                        | ModalValue::MultiBlock(_)
                )
            ),
            Some((Role::Coordinates, _)) => {
                code.is_some_and(|code| code.group == ModalGroup::WorkCoordinates)
            }
            Some((role, _)) => matches!(role, Role::Auxiliary | Role::Stop | Role::End),
        }
    }

    fn has_skips(&self) -> bool {
        let mut blocks = self.all().flat_map(|program| program.blocks());
        blocks.any(|block| block.skip_numbers() != 0)
    }

    /// Zero, and what values are compared with, each with the next one.
    fn values(&self) -> Vec<f64> {
        let compared = self.all().flat_map(|program| program.compared_with());
        let mut values = vec![0.0];
        for value in compared.flat_map(|value| [value, value + 1.0]) {
            if values.len() == VALUES_MAX {
                break;
            }
            if !values.contains(&value) {
                values.push(value);
            }
        }
        values
    }
}

/// The runs of a trial.
struct Runs<'a> {
    trial: &'a Trial<'a>,
    settings: &'a CoordinateSystemSettings,
    steps_left: u64,
    warnings: Vec<Warning>,
}

impl Runs<'_> {
    /// An alarm is certain where it comes under other assumptions, too.
    fn compare(&mut self, alarm: Alarm) -> Stop {
        let same = |other: &Alarm| other.entry == alarm.entry && other.origin == alarm.origin;
        let is_certain = matches!(&self.once(SECOND), End::Alarm(other) if same(other));
        let assumed =
            "the axes stand at 0 at the start, no block skip input is on, and G31 reaches its target";
        Stop {
            alarm,
            assumed: (!is_certain).then(|| assumed.to_owned()),
        }
    }

    /// The first alarm with the values that P and Q may have.
    fn with_values(&mut self) -> Option<Stop> {
        for outside in self.trial.values() {
            if let End::Alarm(alarm) = self.once(Assumed { outside, ..FIRST }) {
                let assumed = Some(format!("P and Q that the program does not write are {outside}"));
                return Some(Stop { alarm, assumed });
            }
            if let (true, Some(stop)) = (self.trial.has_skips(), self.with_skips(outside)) {
                return Some(stop);
            }
        }
        None
    }

    fn with_skips(&mut self, outside: f64) -> Option<Stop> {
        let with_skips = Assumed {
            outside,
            optional_skip: u32::MAX,
            ..FIRST
        };
        let End::Alarm(alarm) = self.once(with_skips) else {
            return None;
        };
        let mut assumed = "the block skip inputs are on".to_owned();
        if !is_lost(outside) {
            let _ = write!(
                assumed,
                " and P and Q that the program does not write are {outside}"
            );
        }
        Some(Stop {
            alarm,
            assumed: Some(assumed),
        })
    }

    fn once(&mut self, assumed: Assumed) -> End {
        let mut run = Run::new(self.trial, self.settings, assumed, self.steps_left);
        let end = run.run_out(&mut self.warnings);
        self.steps_left -= run.interpreter.steps().min(self.steps_left);
        match end {
            Ok(()) => End::Open,
            Err(alarm) if *alarm.entry == PROGRAM_NOT_FOUND => End::Open,
            Err(alarm) if *alarm.entry == VALUE_LOST => End::Reads,
            Err(alarm) => End::Alarm(alarm),
        }
    }
}

/// One run under one assumption.
struct Run<'a> {
    trial: &'a Trial<'a>,
    assumed: Assumed,
    interpreter: Interpreter,
    path: PathStage,
    segments: Vec<Segment>,
    variables: Variables,
    work_offsets: WorkOffsets,
    tool: Tool,
    captured: [f64; AXES_MAX],
    /// Motion was interpreted since the program last came to rest.
    is_moving: bool,
    steps_max: u64,
}

impl<'a> Run<'a> {
    fn new(
        trial: &'a Trial<'_>,
        settings: &CoordinateSystemSettings,
        assumed: Assumed,
        steps_max: u64,
    ) -> Self {
        let variables = Variables::new(VariableArray::new(GLOBAL_VARIABLES));
        for array in [&variables.global, &variables.coordinate_system] {
            (0..array.len()).for_each(|index| _ = array.set(index, assumed.outside));
        }
        let mut interpreter = Interpreter::new(settings, trial.dialect);
        interpreter.start(Arc::clone(trial.program), 0);
        let start = Axis::ALL
            .into_iter()
            .filter(|axis| settings.axes().contains(*axis));
        let mut at = AxisVector::ZERO;
        start.for_each(|axis| at[axis] = assumed.start);
        Self {
            trial,
            assumed,
            interpreter,
            path: PathStage::new(settings, MachinePosition(at)),
            segments: Vec::new(),
            variables,
            work_offsets: trial
                .machine
                .map_or_else(WorkOffsets::default, |(_, system)| system.work_offsets),
            tool: assumed.tool,
            captured: [0.0; AXES_MAX],
            is_moving: false,
            steps_max,
        }
    }

    fn run_out(&mut self, warnings: &mut Vec<Warning>) -> Result<(), Alarm> {
        while self.interpreter.steps() < self.steps_max {
            let item = match self.next() {
                Ok(item) => item,
                // a block before it that was held back comes first
                Err(alarm) => return self.finish().and(Err(alarm)),
            };
            match item {
                Item::Block(block) => {
                    let from = self.path.position();
                    self.path.push(&block, &mut self.segments)?;
                    self.is_moving |= !self.segments.is_empty() || self.path.position() != from;
                    self.segments.clear();
                    self.end_skip(from);
                }
                Item::Output(output) => {
                    if self.timing(&output) == Timing::AfterMotion {
                        self.rest(&item)?;
                    }
                    self.look_at_motion(&output, warnings);
                    self.select_tool(&output, warnings);
                }
                Item::Stop(_) => self.rest(&item)?,
                Item::NeedsStandstill(_) => self.flush(),
                Item::Warning(origin, text) => note(warnings, &diagnostics::WARNS_IN_RUN, origin, text),
                Item::End(_) => {
                    self.rest(&item)?;
                    return self.finish();
                }
            }
        }
        Ok(())
    }

    fn next(&mut self) -> Result<Item, Alarm> {
        let tools = self
            .trial
            .machine
            .map_or(&NO_TOOLS, |(machine, _)| &machine.tools);
        self.interpreter.next(&Inputs {
            programs: self.trial.programs,
            optional_skip: self.assumed.optional_skip,
            work_offsets: &self.work_offsets,
            variables: &self.variables,
            tool: Some(self.tool),
            tools,
            captured: Some(self.captured),
            position: Some(self.path.counts_from().0),
        })
    }

    fn finish(&mut self) -> Result<(), Alarm> {
        self.path.finish(&mut self.segments)
    }

    /// Comes to rest, which cutter compensation refuses.
    fn rest(&mut self, item: &Item) -> Result<(), Alarm> {
        let is_compensating =
            self.path.is_compensating() || self.interpreter.modal().compensation != Compensation::Off;
        if let (true, Some(alarm)) = (is_compensating, rest_refused(item)) {
            return Err(alarm);
        }
        self.flush();
        Ok(())
    }

    fn flush(&mut self) {
        self.path.flush(&mut self.segments);
        self.segments.clear();
        self.is_moving = false;
    }

    /// A G31 ends at once, after its share of the way.
    fn end_skip(&mut self, from: MachinePosition) {
        if !self.path.is_skipping() {
            return;
        }
        let way = self.path.position().0.minus(from.0);
        let mut at = from.0;
        for axis in Axis::ALL {
            at[axis] += way[axis] * self.assumed.skip_share;
            self.captured[axis.index()] = at[axis];
        }
        self.path.skipped_to(MachinePosition(at));
    }

    /// Without a machine an output waits only where the manual leaves no choice (D30).
    fn timing(&self, output: &Output) -> Timing {
        match self.trial.machine {
            Some((machine, system)) => system.timing(output, machine.m_codes.get(&output.m)),
            None if output.has_params() => Timing::AfterMotion,
            None => Timing::WithMotion,
        }
    }

    /// An output that is made when its block is interpreted comes before the end of the motion before it.
    fn look_at_motion(&self, output: &Output, warnings: &mut Vec<Warning>) {
        let Some((machine, system)) = self.trial.machine else {
            return;
        };
        let is_at_once = system.is_put_out_at_once(
            output,
            machine.m_codes.get(&output.m),
            self.path.is_compensating(),
        );
        let entry = &diagnostics::OUTPUT_BEFORE_MOTION_ENDS;
        let text = format!(
            "M{:02} is put out when its block is interpreted: motion before it may not be over, or not have begun",
            output.m
        );
        let is_known = |warning: &Warning| warning.entry == entry && warning.text == text;
        if self.is_moving && is_at_once && !warnings.iter().any(is_known) {
            note(warnings, entry, output.origin, text);
        }
    }

    fn select_tool(&mut self, output: &Output, warnings: &mut Vec<Warning>) {
        let Some((machine, _)) = self.trial.machine else {
            return;
        };
        let settings = machine.m_codes.get(&output.m);
        if settings.is_none_or(|settings| settings.stock != Some(Stock::SelectTool)) {
            return;
        }
        let Ok(id) = selected_tool(output.m, output.params[0]) else {
            return;
        };
        self.tool = machine.tools.get(&id).copied().unwrap_or_else(|| {
            let text = format!(
                "M{:02} selects tool {id}, which is not in the tool table",
                output.m
            );
            note(warnings, &diagnostics::WARNS_IN_RUN, output.origin, text);
            Tool::default()
        });
    }
}

fn note(warnings: &mut Vec<Warning>, entry: &'static DiagnosticEntry, origin: Origin, text: String) {
    let warning = Warning { entry, origin, text };
    if warnings.len() < WARNINGS_MAX && !warnings.contains(&warning) {
        warnings.push(warning);
    }
}

/// The settings of a coordinate system of which nothing is known: all axes, and no limits.
fn unlimited(dialect: &Dialect) -> CoordinateSystemSettings {
    let motor = |axis: Axis| {
        let kind = match axis {
            Axis::X | Axis::Y | Axis::Z => MotorKind::Linear,
            _ => MotorKind::Rotary,
        };
        let number = u16::try_from(axis.index()).unwrap_or_default();
        MotorSettings::new(number, kind, UNLIMITED, UNLIMITED)
    };
    CoordinateSystemSettings {
        motors: Axis::ALL.map(|axis| Some(motor(axis))),
        spindle: Some(MotorSettings::new(
            u16::MAX,
            MotorKind::Spindle,
            UNLIMITED,
            UNLIMITED,
        )),
        max_feedrate_mm_min: UNLIMITED,
        default_feedrate_mm_min: 1.0,
        path: dialect.path,
        ..CoordinateSystemSettings::default()
    }
}
