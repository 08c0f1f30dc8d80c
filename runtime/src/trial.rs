//! Runs a program through interpreter and path stage without a machine. So it finds alarms that stop the program under
//! all conditions.
//!
//! Some values are known only on a machine: the axis positions at the start, the tool, block skip, the end position of
//! a G31. The trial assumes these values, and runs the program twice with different values. An alarm in both runs is
//! certain. P and Q variables that the program has not written are unknown. If the program reads such a variable, it is
//! run again with the values with which it compares variables; the resulting alarms are not certain. Soft limits and
//! cutter compensation leave no doubt about the tool position. So their alarms do not end a run here, and all of them
//! are reported at once.

mod run;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::Arc;

use tandem_config::{ConfiguredSystem, Machine};
use tandem_interp::Dialect;
use tandem_interp::codes::ModalGroup;
use tandem_interp::meaning::{ModalValue, MotionKind, Role};
use tandem_model::alarm::{PROGRAM_NOT_FOUND, VALUE_LOST};
use tandem_model::lost::{LOST, is_lost};
use tandem_model::settings::{CoordinateSystemSettings, MotorKind, MotorSettings};
use tandem_model::{Alarm, Axis, Diagnostic, Origin};
use tandem_syntax::diagnostics::{self, DiagnosticEntry};
use tandem_syntax::{Address, NcProgram, Word};

use self::run::{FIRST, SECOND, TrialAssumptions, TrialRun};

/// Maximum number of executed blocks, in addition to four times the blocks of the program.
const STEPS_MAX: u64 = 2_000_000;

/// Maximum number of values that are tried for unknown P and Q variables.
const VALUES_MAX: usize = 16;

/// Maximum number of listed warnings of all runs, and of listed alarms.
const LISTED_MAX: usize = 100;

/// Value that stands for limits of motors that are unknown. No program reaches this value.
const UNLIMITED: f64 = 1e9;

/// Text of the assumption for a subprogram that is tried alone.
const CALLED: &str = "no program has called it and set the modal state";

/// M codes that end a main program; below, the M code that returns from a subprogram.
const MAIN_ENDS: [u32; 2] = [2, 30];
const RETURN: u32 = 99;

/// Returns true if the last end in the program returns to a caller; an M02 or M30 before it is in a branch. The modal
/// state of such a program at its start depends on its callers.
fn is_subprogram(program: &NcProgram) -> bool {
    let is_end = |word: &&Word| {
        let is_known = |m: u32| m == RETURN || MAIN_ENDS.contains(&m);
        word.address == Address::M && word.whole().is_some_and(is_known)
    };
    let last = program.all_words().iter().rfind(is_end);
    last.is_some_and(|word| word.whole() == Some(RETURN))
}

/// Input of a trial.
#[derive(Debug, Clone, Copy)]
pub struct Trial<'a> {
    /// The program to try. Its number is 0.
    pub program: &'a Arc<NcProgram>,
    /// The programs that the program may call.
    pub programs: &'a BTreeMap<u16, Arc<NcProgram>>,
    /// Dialect of the program.
    pub dialect: &'static Dialect,
    /// The target machine and its coordinate system; `None` for a trial without limits.
    pub machine: Option<(&'a Machine, &'a ConfiguredSystem)>,
}

/// Result of a trial.
#[derive(Debug, Default, PartialEq)]
pub struct TrialResult {
    /// The alarms that end the program. On a machine, the first of them ends it.
    pub stops: Vec<StoppingAlarm>,
    /// Warnings of the runs, each once. Empty without a machine.
    pub warnings: Vec<Warning>,
}

/// A warning during a run.
#[derive(Debug, PartialEq)]
pub struct Warning {
    /// Entry of the warning in the table of diagnostics.
    pub entry: &'static DiagnosticEntry,
    /// Block that causes the warning.
    pub origin: Origin,
    /// Text of the warning.
    pub text: String,
}

/// An alarm that ends the program.
#[derive(Debug, PartialEq)]
pub struct StoppingAlarm {
    /// The alarm with its location.
    pub alarm: Alarm,
    /// Description of the assumptions on which the alarm depends; `None` if it is certain.
    pub assumed: Option<String>,
}

impl TrialResult {
    /// Returns the findings as diagnostics, each with the number of its program.
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
        let called = is_subprogram(of.program).then(|| CALLED.to_owned());
        let stops = self.stops.into_iter().map(|StoppingAlarm { alarm, assumed }| {
            let assumed = assumed.or_else(|| called.clone());
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
        warnings.chain(stops).collect()
    }
}

impl Trial<'_> {
    /// Runs the program several times. All runs together execute at most four times the blocks of the program plus two
    /// million.
    pub fn run(&self) -> TrialResult {
        if self.machine.is_none() && self.all().all(|program| self.is_plain(program)) {
            return TrialResult::default();
        }
        let settings = match self.machine {
            Some((_, system)) => Cow::Borrowed(&system.settings),
            None => Cow::Owned(unlimited(self.dialect)),
        };
        let mut runs = Runs {
            trial: self,
            settings: &settings,
            steps_left: 4 * self.program.blocks().len() as u64 + STEPS_MAX,
            shown: TrialResult::default(),
        };
        runs.all();
        let mut shown = runs.shown;
        if self.machine.is_none() {
            shown.warnings.clear();
        }
        shown
    }

    fn all(&self) -> impl Iterator<Item = &Arc<NcProgram>> {
        std::iter::once(self.program).chain(self.programs.values())
    }

    /// Returns true if a program contains only straight lines and known codes. Without limits no stage rejects such a
    /// program, and it has no endless loop.
    fn is_plain(&self, program: &NcProgram) -> bool {
        let mut last = None;
        let mut is_known = |word: &Word| {
            let code = Some((word.address, word.number().map(f64::to_bits)));
            std::mem::replace(&mut last, code) == code
        };
        program.blocks().iter().all(|block| {
            let mut words = program.words(block).iter();
            program.program_code(block).is_none()
                && words.all(|word| match word.address {
                    Address::G | Address::M => is_known(word) || self.is_plain_code(word),
                    // a computed value may be out of range
                    _ => word.number().is_some(),
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

    /// Returns zero, and the values with which the programs compare variables, each with its successor.
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

/// The runs of a trial and their results so far.
struct Runs<'a> {
    trial: &'a Trial<'a>,
    settings: &'a CoordinateSystemSettings,
    steps_left: u64,
    shown: TrialResult,
}

impl Runs<'_> {
    fn all(&mut self) {
        let first = self.once(FIRST);
        if !first.alarms.is_empty() {
            self.compare(first.alarms);
        }
        let values = if first.reads {
            self.trial.values()
        } else {
            vec![LOST]
        };
        let has_skips = self.trial.has_skips();
        for outside in values {
            if first.reads {
                self.suppose(TrialAssumptions { outside, ..FIRST });
            }
            if has_skips {
                self.suppose(TrialAssumptions {
                    outside,
                    optional_skip: u32::MAX,
                    ..FIRST
                });
            }
        }
    }

    /// Adds the alarms of the first run. An alarm is certain if it also occurs under the second assumptions.
    fn compare(&mut self, alarms: Vec<Alarm>) {
        let others = self.once(SECOND).alarms;
        for alarm in alarms {
            let is_certain = others.iter().any(|other| is_same(other, &alarm));
            let assumed = "the axes are at start_at at the start, no block skip input is on, and G31 reaches its target";
            self.shown.stops.push(StoppingAlarm {
                alarm,
                assumed: (!is_certain).then(|| assumed.to_owned()),
            });
        }
    }

    /// Adds the alarms that occur with assumed values of P and Q, or with block skip inputs that are on.
    fn suppose(&mut self, assumed: TrialAssumptions) {
        let value = format!("P and Q that the program does not write are {}", assumed.outside);
        let text = match (assumed.optional_skip, is_lost(assumed.outside)) {
            (0, _) => value,
            (_, true) => "the block skip inputs are on".to_owned(),
            (_, false) => format!("the block skip inputs are on and {value}"),
        };
        let found = self.once(assumed).alarms;
        for alarm in found {
            let stops = &mut self.shown.stops;
            if stops.len() < LISTED_MAX && !stops.iter().any(|known| is_same(&known.alarm, &alarm)) {
                let assumed = Some(text.clone());
                stops.push(StoppingAlarm { alarm, assumed });
            }
        }
    }

    fn once(&mut self, assumed: TrialAssumptions) -> TrialRunResult {
        let mut run = TrialRun::new(self.trial, self.settings, assumed, self.steps_left);
        let end = run.run_out(&mut self.shown.warnings);
        self.steps_left -= run.steps().min(self.steps_left);
        let mut ended = TrialRunResult {
            alarms: run.into_alarms(),
            reads: false,
        };
        match end {
            Err(alarm) if *alarm.entry == VALUE_LOST => ended.reads = true,
            Err(alarm) if *alarm.entry != PROGRAM_NOT_FOUND => ended.alarms.push(alarm),
            _ => {}
        }
        ended
    }
}

/// Result of a run.
struct TrialRunResult {
    /// Alarms of the run in order.
    alarms: Vec<Alarm>,
    /// True if the run has read a variable that the program has not written.
    reads: bool,
}

fn is_same(one: &Alarm, other: &Alarm) -> bool {
    one.entry == other.entry && one.origin == other.origin
}

/// Returns the settings of an unknown coordinate system with all axes and without limits.
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
