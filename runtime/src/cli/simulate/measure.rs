//! Measures a run from setpoint to setpoint: times, distances, ranges of the axes, and peak values of the motors.

use std::collections::BTreeMap;

use serde::Serialize;
use tandem_model::flow::Transform;
use tandem_model::profile::TimeBase;
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{Axis, AxisVector, Origin};
use tandem_runtime::simulation::PlannedMotion;
use tandem_servo::Servo;

use super::super::print_line;
use super::exceeded::ExceededLimits;
use super::losses::{CornerDistance, Losses, PassedBlock, TransitionLoss};

/// Function that returns the coordinate transform in force.
pub(super) type Coordinates = Box<dyn Fn() -> Transform + Send>;

/// Activity for which time is counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Doing {
    Feed,
    Rapid,
    #[default]
    Wait,
}

/// Times and distances of one tool or one program.
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct TimeShare {
    time_s: f64,
    feed_s: f64,
    rapid_s: f64,
    wait_s: f64,
    feed_mm: f64,
    rapid_mm: f64,
}

impl TimeShare {
    fn add(&mut self, doing: Doing, time_s: f64, way_mm: f64) {
        self.time_s += time_s;
        match doing {
            Doing::Feed => {
                self.feed_s += time_s;
                self.feed_mm += way_mm;
            }
            Doing::Rapid => {
                self.rapid_s += time_s;
                self.rapid_mm += way_mm;
            }
            Doing::Wait => self.wait_s += time_s,
        }
    }

    /// Returns the cells of a table row: time, shares in percent, distances.
    pub fn cells(&self) -> String {
        let percent = |part_s: f64| {
            if self.time_s > 0.0 {
                100.0 * part_s / self.time_s
            } else {
                0.0
            }
        };
        format!(
            "{:>10.3} {:>6.1} {:>7.1} {:>6.1} {:>12.3} {:>12.3}",
            self.time_s,
            percent(self.feed_s),
            percent(self.rapid_s),
            percent(self.wait_s),
            self.feed_mm,
            self.rapid_mm
        )
    }
}

/// Lowest and highest position of an axis, mm or degrees.
#[derive(Debug, Clone, Copy, Serialize)]
pub(super) struct Range {
    pub lowest: f64,
    pub highest: f64,
}

impl Range {
    fn add(range: &mut Option<Self>, value: f64) {
        // Adding zero removes the sign of a negative zero.
        let value = value + 0.0;
        *range = Some(range.map_or(
            Self {
                lowest: value,
                highest: value,
            },
            |range| Self {
                lowest: range.lowest.min(value),
                highest: range.highest.max(value),
            },
        ));
    }
}

/// Range of an axis in machine and in program coordinates; `None` if the axis has not moved.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub(super) struct Ranges {
    pub machine: Option<Range>,
    pub program: Option<Range>,
}

/// A peak value, and the block in which it occurs.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub(super) struct BlockPeak {
    pub value: f64,
    program: u16,
    pub line: u32,
}

/// Peak values of velocity, acceleration and jerk of a motor.
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct MotorPeaks {
    pub axis: String,
    motor: u16,
    pub speed: BlockPeak,
    pub acceleration: BlockPeak,
    pub jerk: BlockPeak,
}

impl MotorPeaks {
    fn add(&mut self, values: [f64; 3], at: Origin) {
        for (peak, value) in [&mut self.speed, &mut self.acceleration, &mut self.jerk]
            .into_iter()
            .zip(values)
        {
            // If values are equal except for rounding, the peak is assigned to the first block.
            if value.abs() > peak.value * (1.0 + 1e-6) {
                *peak = BlockPeak {
                    value: value.abs(),
                    program: at.program,
                    line: at.line,
                };
            }
        }
    }
}

/// Time lost between blocks at feedrate.
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct TimeLost {
    pub exact_stops: TransitionLoss,
    pub corners: TransitionLoss,
}

/// Results of the measurement of one coordinate system.
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct SimulationMeasurements {
    /// Times and distances by tool number.
    pub tools: BTreeMap<u16, TimeShare>,
    /// Times and distances by program number; those of called programs are not included.
    pub programs: BTreeMap<u16, TimeShare>,
    /// Ranges by axis letter.
    pub ranges: BTreeMap<char, Ranges>,
    pub motors: Vec<MotorPeaks>,
    pub lost: TimeLost,
    /// Largest distance of the path from a programmed corner; null if the path passes each corner.
    pub corner: Option<CornerDistance>,
}

const HEADING: &str = "     time s feed % rapid % wait %      feed mm     rapid mm";

impl SimulationMeasurements {
    /// Prints the results as tables.
    pub fn print(&self) {
        for (name, shares) in [("tool", &self.tools), ("program", &self.programs)] {
            print_line(format!("  {name:<8}{HEADING}"));
            for (number, share) in shares {
                print_line(format!("  {number:<8}{}", share.cells()));
            }
        }
        for (letter, ranges) in &self.ranges {
            let text = |range: Option<Range>| {
                let range = range.unwrap_or(Range {
                    lowest: 0.0,
                    highest: 0.0,
                });
                format!("{:.4} to {:.4}", range.lowest, range.highest)
            };
            let (machine, program) = (text(ranges.machine), text(ranges.program));
            print_line(format!("  range {letter}  machine {machine}, program {program}"));
        }
        for motor in self.motors.iter().filter(|motor| motor.speed.value > 0.0) {
            let unit = if "XYZ".contains(&motor.axis) { "mm" } else { "deg" };
            let peak =
                |peak: &BlockPeak, per: &str| format!("{:.3} {unit}/{per} in line {}", peak.value, peak.line);
            print_line(format!(
                "  motor {}  {}, {}, {}",
                motor.axis,
                peak(&motor.speed, "s"),
                peak(&motor.acceleration, "s2"),
                peak(&motor.jerk, "s3")
            ));
        }
        print_line(format!("  lost to exact stops: {}", self.lost.exact_stops.text()));
        print_line(format!("  lost to corners: {}", self.lost.corners.text()));
        if let Some(corner) = &self.corner {
            print_line(format!(
                "  largest distance from a corner: {:.4} mm after line {}",
                corner.distance_mm, corner.line
            ));
        }
    }
}

/// Measures the run of one coordinate system.
pub(super) struct Measure {
    index: usize,
    period_s: f64,
    axes: Vec<Axis>,
    coordinates: Option<Coordinates>,
    transform: Transform,
    running: bool,
    /// Time up to which the run is measured, s.
    now_s: f64,
    doing: Doing,
    place: Origin,
    tool: u16,
    /// Position, speed and acceleration in the last servo cycle.
    last: [AxisVector; 3],
    /// Motion of the last cycle (from, to). Its program coordinates are determined later, because its block
    /// may change the transform.
    moved: Option<[AxisVector; 2]>,
    losses: Losses,
    /// Exceeded limits of each motor, in the order of `axes`.
    exceeded: Vec<ExceededLimits>,
    measured: SimulationMeasurements,
}

impl Measure {
    /// Creates the measurement. With `each_block`, [`Measure::end_of`] returns the end of each block.
    pub fn new(
        index: usize,
        settings: &CoordinateSystemSettings,
        feed_override: f64,
        each_block: bool,
    ) -> Self {
        let axes: Vec<Axis> = settings.axes().iter().collect();
        let motors = axes.iter().filter_map(|axis| {
            Some(MotorPeaks {
                axis: axis.letter().to_string(),
                motor: settings.motors[axis.index()].as_ref()?.number,
                ..MotorPeaks::default()
            })
        });
        Self {
            index,
            period_s: settings.servo_period_s,
            coordinates: None,
            transform: Transform::default(),
            running: false,
            now_s: 0.0,
            doing: Doing::default(),
            place: Origin::default(),
            tool: 0,
            last: [AxisVector::ZERO; 3],
            moved: None,
            losses: Losses::new(feed_override, each_block),
            exceeded: axes
                .iter()
                .filter_map(|axis| {
                    let motor = settings.motors[axis.index()].as_ref()?;
                    Some(ExceededLimits::new(axis.letter(), motor))
                })
                .collect(),
            measured: SimulationMeasurements {
                motors: motors.collect(),
                ..SimulationMeasurements::default()
            },
            axes,
        }
    }

    pub fn look_at(&mut self, coordinates: Coordinates) {
        self.coordinates = Some(coordinates);
    }

    pub fn plan(&mut self, planned: PlannedMotion<'_>) {
        self.losses.plan(planned);
    }

    pub fn start(&mut self, now_s: f64, program: u16) {
        self.running = true;
        self.now_s = now_s;
        self.place.program = program;
    }

    /// Records the start of a block. The transform that the block has set is then in force.
    pub fn block(&mut self) {
        if let Some(coordinates) = &self.coordinates {
            self.transform = coordinates();
        }
    }

    /// Records that the coordinate system uses this tool from now on.
    pub fn select(&mut self, tool: u16) {
        self.tool = tool;
    }

    /// Records that the program waits for an output or is paused.
    pub fn wait(&mut self) {
        self.losses.wait();
    }

    pub fn end_run(&mut self, now_s: f64) {
        self.spend(now_s - self.now_s, 0.0);
        self.range();
        self.losses.end_run();
        self.running = false;
    }

    /// Returns the commanded machine position and the end position of the last passed block.
    pub fn position(&self) -> [AxisVector; 2] {
        let [at, ..] = self.last;
        [at, self.losses.target().unwrap_or(at)]
    }

    /// Returns the end of the block that began at this place, if the servo has passed it.
    pub fn end_of(&mut self, program: u16, line: u32) -> Option<PassedBlock> {
        self.losses.end_of(program, line)
    }

    /// Returns the transform from the programmed point to the machine position.
    pub fn transform(&self) -> Transform {
        self.transform
    }

    /// Returns a warning for each limit of a motor that the run exceeded.
    pub fn warnings(&self) -> impl Iterator<Item = serde_json::Value> {
        self.exceeded.iter().flat_map(ExceededLimits::warnings)
    }

    pub fn finish(&mut self) -> SimulationMeasurements {
        self.measured.lost = TimeLost {
            exact_stops: self.losses.stops.clone(),
            corners: self.losses.corners.clone(),
        };
        self.measured.corner = self.losses.corner;
        std::mem::take(&mut self.measured)
    }

    pub fn on_cycle(&mut self, servo: &Servo) {
        let channel = servo.channel(self.index);
        let (to, now_s) = (channel.setpoint(), servo.time_s());
        self.range();
        let [from, speed, acceleration] = self.last;
        let per_s = 1.0 / self.period_s;
        let mut moved_s = self.period_s;
        // The simulation may have skipped cycles in which the motors kept their speeds.
        let left_out_s = now_s - self.now_s - self.period_s;
        if left_out_s > self.period_s / 2.0 {
            self.spend(left_out_s, 0.0);
            if speed != AxisVector::ZERO {
                moved_s += left_out_s;
            }
        }
        let new_speed = to.minus(from).scaled(1.0 / moved_s);
        let new_acceleration = new_speed.minus(speed).scaled(per_s);
        let jerk = new_acceleration.minus(acceleration).scaled(per_s);
        self.last = [to, new_speed, new_acceleration];
        if let Some(origin) = channel.executing() {
            self.place = origin;
        }
        self.doing = match (channel.executing(), channel.time_base()) {
            (Some(_), Some(TimeBase::Rapid)) => Doing::Rapid,
            (Some(_), Some(TimeBase::Feed)) => Doing::Feed,
            (Some(_), Some(TimeBase::Fixed)) if to != from => Doing::Feed,
            _ => Doing::Wait,
        };
        if !self.running {
            return;
        }
        self.losses.reach(channel.segment(), now_s);
        self.spend(now_s - self.now_s, to.minus(from).orthogonal_length());
        if to != from {
            self.moved = Some([from, to]);
        }
        let is_rapid = self.doing == Doing::Rapid;
        let motors = self.measured.motors.iter_mut().zip(&mut self.exceeded);
        for ((motor, exceeded), axis) in motors.zip(&self.axes) {
            let values = [new_speed, new_acceleration, jerk].map(|values| values[*axis]);
            motor.add(values, self.place);
            exceeded.compare(values, is_rapid, self.place);
        }
    }

    fn spend(&mut self, time_s: f64, way_mm: f64) {
        if self.running {
            let tool = self.measured.tools.entry(self.tool).or_default();
            tool.add(self.doing, time_s, way_mm);
            let program = self.measured.programs.entry(self.place.program).or_default();
            program.add(self.doing, time_s, way_mm);
        }
        self.now_s += time_s;
    }

    /// Adds the motion of the last cycle to the ranges, in the coordinates of its block.
    fn range(&mut self) {
        let Some(way) = self.moved.take() else { return };
        for machine in way {
            let program = self.transform.inverse(machine);
            for axis in &self.axes {
                let ranges = self.measured.ranges.entry(axis.letter()).or_default();
                Range::add(&mut ranges.machine, machine[*axis]);
                Range::add(&mut ranges.program, program[*axis]);
            }
        }
    }
}
