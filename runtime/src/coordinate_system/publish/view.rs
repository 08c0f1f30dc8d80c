//! A snapshot of a coordinate system that any thread may read at any time, without its task.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use parking_lot::Mutex;
use plc_protocol::types::heartbeat::Heartbeat;
use plc_protocol::types::start::StartObstacle;
use plc_protocol::types::state::{CallSite, Position, ProgramLocation};
use plc_protocol::types::trace::{Trace, TraceAxis, TraceQuery};
use tandem_model::flow::Transform;
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{Axis, AxisSet, AxisVector, MachinePosition, Origin};
use tandem_path::work_position;
use tandem_servo::{Readings, Trace as ServoTrace, TraceMotion, TraceSample};
use tandem_store::program_store::{ProgramStore, StoredProgram};

use crate::coordinate_system::run::conditions::RunStart;

/// Servo readings of a coordinate system, and its position in the program.
#[derive(Debug)]
pub(crate) struct View {
    axes: AxisSet,
    servo_period: Duration,
    readings: Arc<Readings>,
    trace: Arc<ServoTrace>,
    place: Mutex<ProgramPosition>,
    published_line: AtomicU64,
    prediction: Mutex<Option<Arc<Prediction>>>,
}

/// Alarm with which the rehearsal of a program ended.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Prediction {
    /// Hash of the program.
    pub hash: String,
    pub obstacle: StartObstacle,
}

/// Position of a run in its program.
#[derive(Debug, Clone, Default)]
pub(crate) struct ProgramPosition {
    pub transform: Transform,
    pub stack: Arc<[CallSite]>,
    pub executing: Origin,
    /// Number of the running segment, counted from the start of the run.
    pub segment: u64,
    /// Time in s since the start of the runtime at which the executing block began.
    pub since_s: f64,
    /// The active run, if it is the run of a stored program.
    pub run: Option<Arc<RunStart>>,
    pub interpreted_line: u32,
    /// Text of the manual data input that runs or ran last. This text has no program number.
    pub manual: Option<Arc<StoredProgram>>,
}

impl View {
    pub fn new(settings: &CoordinateSystemSettings, readings: Arc<Readings>, trace: Arc<ServoTrace>) -> Self {
        Self {
            axes: settings.axes(),
            servo_period: Duration::from_secs_f64(settings.servo_period_s),
            readings,
            trace,
            place: Mutex::default(),
            published_line: AtomicU64::default(),
            prediction: Mutex::default(),
        }
    }

    /// Notes that all messages about journal lines up to `line` have been published for the coordinate system.
    pub(crate) fn set_published_line(&self, line: u64) {
        self.published_line.store(line, Ordering::Release);
    }

    /// Returns the number of the last journal line up to which all messages have been published.
    pub fn published_line(&self) -> u64 {
        self.published_line.load(Ordering::Acquire)
    }

    pub(crate) fn update(&self, change: impl FnOnce(&mut ProgramPosition)) {
        change(&mut self.place.lock());
    }

    fn program_position(&self) -> ProgramPosition {
        self.place.lock().clone()
    }

    /// Sets the position to the start of a loaded program; `None` if no program is loaded.
    pub(crate) fn at_head(&self, program: Option<u16>) {
        self.update(|place| {
            place.executing = Origin {
                program: program.unwrap_or_default(),
                ..Origin::default()
            };
            place.segment = 0;
            place.stack = Arc::default();
            place.interpreted_line = 0;
        });
    }

    /// Returns the transform from programmed points to machine positions.
    pub fn transform(&self) -> Transform {
        self.place.lock().transform
    }

    /// Returns the commanded position of the last servo cycle.
    pub fn commanded(&self) -> MachinePosition {
        self.readings.read().commanded
    }

    /// Returns the commanded position of the last servo cycle; `None` while a motor is not homed.
    pub fn homed_position(&self) -> Option<MachinePosition> {
        let reading = self.readings.read();
        (reading.homed == self.axes).then_some(reading.commanded)
    }

    /// Returns the number of the running segment in the run, the executing block, and the time at which this block
    /// began. The time is in s since the start of the runtime.
    pub fn segment(&self) -> (u64, Origin, f64) {
        let place = self.place.lock();
        (place.segment, place.executing, place.since_s)
    }

    /// Returns the alarm with which the rehearsal of a program ended, if any.
    pub fn prediction(&self) -> Option<Arc<Prediction>> {
        self.prediction.lock().clone()
    }

    /// Stores the alarm that a rehearsal predicts. Returns true if it differs from the stored alarm.
    pub fn predict(&self, prediction: Option<Prediction>) -> bool {
        let mut kept = self.prediction.lock();
        let is_other = kept.as_deref() != prediction.as_ref();
        if is_other {
            *kept = prediction.map(Arc::new);
        }
        is_other
    }

    /// Returns the active run of a stored program, with its conditions at the start.
    pub fn run(&self) -> Option<Arc<RunStart>> {
        self.place.lock().run.clone()
    }

    /// Returns program and line of the executing block.
    pub fn executing(&self) -> Origin {
        self.place.lock().executing
    }

    /// Returns the actual spindle speed in r/min, and true if the spindle is oriented.
    pub fn spindle(&self) -> (f64, bool) {
        let reading = self.readings.read();
        (finite(reading.spindle_rpm), reading.oriented)
    }

    /// Returns the number of servo cycles since the start; the number is the same in all coordinate systems.
    pub fn heartbeat(&self) -> Heartbeat {
        let time = Duration::try_from_secs_f64(self.readings.read().time_s).unwrap_or_default();
        let cycles = (time + self.servo_period / 2).as_nanos() / self.servo_period.as_nanos().max(1);
        Heartbeat {
            cycle: u64::try_from(cycles).unwrap_or(u64::MAX),
        }
    }

    /// Returns the positions of the last servo cycle.
    pub fn position(&self) -> Position {
        let reading = self.readings.read();
        let work = work_position(&self.program_position().transform, reading.commanded);
        Position {
            machine: self.by_letter(reading.commanded.0),
            work: self.by_letter(work.0),
            actual: self.by_letter(reading.actual.0),
            homed: self
                .axes
                .iter()
                .map(|axis| (axis.letter().to_string(), reading.homed.contains(axis)))
                .collect(),
            following_error: self.by_letter(reading.commanded.0.minus(reading.actual.0)),
            distance_to_go: self.by_letter(reading.distance_to_go),
            feedrate: finite(reading.feedrate_mm_min),
            spindle_rpm: finite(reading.spindle_rpm),
        }
    }

    /// Returns the position in the program.
    pub fn program(&self, store: &ProgramStore) -> ProgramLocation {
        let ProgramPosition {
            stack,
            executing,
            interpreted_line,
            manual,
            ..
        } = self.program_position();
        let place = (executing != Origin::default()).then_some(executing.program);
        let program = match place {
            Some(0) => manual,
            numbered => numbered.and_then(|number| store.get(number)),
        };
        let number = place.filter(|number| *number != 0 || program.is_some());
        ProgramLocation {
            number,
            nest_level: u8::try_from(stack.len()).unwrap_or(u8::MAX),
            stack: stack.to_vec(),
            line: executing.line,
            block: program
                .map(|program| program.line(executing.line).to_owned())
                .unwrap_or_default(),
            interpreted_line,
        }
    }

    /// Returns the recent motion of the axes in `query`, without the time of day.
    ///
    /// # Errors
    /// Returns the letter of an axis if the coordinate system does not have this axis.
    pub fn trace(&self, query: &TraceQuery) -> Result<Trace, char> {
        let axes = self.trace.axes();
        let known = |letter: &char| axes.iter().any(|axis| axis.letter() == *letter);
        if let Some(other) = query.axes.chars().find(|letter| !known(letter)) {
            return Err(other);
        }
        let count = usize::try_from(query.count).unwrap_or(usize::MAX);
        let (first, samples) = self.trace.read(u64::from(query.from), count);
        let common =
            |value: fn(&TraceSample) -> f64| samples.iter().map(|sample| rounded(value(sample))).collect();
        let of_axis = |index: usize| {
            let column = |value: fn(&TraceMotion) -> f64| {
                let values = samples.iter().filter_map(|sample| sample.motions.get(index));
                values.map(|motion| rounded(value(motion))).collect()
            };
            TraceAxis {
                position: column(|motion| motion.position),
                velocity: column(|motion| motion.velocity),
                acceleration: column(|motion| motion.acceleration),
                following_error: column(|motion| motion.following_error),
            }
        };
        let wanted = |axis: &Axis| query.axes.is_empty() || query.axes.contains(axis.letter());
        let wanted = axes.iter().enumerate().filter(|(_, axis)| wanted(axis));
        let number = |count: u64| u32::try_from(count).unwrap_or(u32::MAX);
        Ok(Trace {
            interval_s: self.trace.interval_s(),
            first: number(first),
            next: number(first + samples.len() as u64),
            now_s: rounded(self.readings.read().time_s),
            time_s: common(|sample| sample.time_s),
            feedrate: common(|sample| sample.feedrate_mm_min),
            spindle_rpm: common(|sample| sample.spindle_rpm),
            axes: wanted
                .map(|(index, axis)| (axis.letter().to_string(), of_axis(index)))
                .collect(),
            ..Trace::default()
        })
    }

    fn by_letter(&self, values: AxisVector) -> BTreeMap<String, f64> {
        self.axes
            .iter()
            .map(|axis| (axis.letter().to_string(), finite(values[axis])))
            .collect()
    }
}

/// Rounds to a millionth, because further digits are of no use and make the JSON text long.
fn rounded(value: f64) -> f64 {
    finite((value * 1e6).round() / 1e6)
}

// JSON cannot represent NaN or infinity. The stages never produce them; if one did, readers must not fail. The addition
// removes the sign of a negative zero.
fn finite(value: f64) -> f64 {
    if value.is_finite() { value + 0.0 } else { 0.0 }
}
