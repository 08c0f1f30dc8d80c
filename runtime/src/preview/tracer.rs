//! Follows profiles as the servo does, one setpoint per period at 100 percent override. Records positions,
//! times and speeds.

use tandem_model::profile::{Law, Profile, TimeBase};
use tandem_model::settings::{CoordinateSystemSettings, MotorSettings};
use tandem_model::{Axis, AxisVector, MachinePosition, Origin};

use super::chunk::{CHUNK_LINES, Chunk, Palette, Vertex, single};
use super::path_simplifier::PathSimplifier;

/// Maximum number of vertices of one path: about 50 MB with all levels. The picture ends there; the rehearsal
/// continues.
pub(super) const VERTICES_MAX: usize = 1 << 21;

/// Share of a servo period: if less is left of a profile, it has ended. The servo uses the same rule.
const END_TOLERANCE: f64 = 1e-6;

/// Profile duration in s from which the middle part is followed in longer steps, because its speed is
/// constant.
const LONG_S: f64 = 60.0;

/// Number of steps in which a long profile is followed.
const STEPS_OF_LONG: f64 = 50_000.0;

/// Maximum number of marks. At this number, every second mark is dropped.
const MARKS_MAX: usize = 8192;

/// Time from the start of the plan, in total and by category, s.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Times {
    pub total: f64,
    pub feed: f64,
    pub rapid: f64,
    pub fixed: f64,
    pub wait: f64,
}

impl Times {
    /// Interpolates between the times of two marks; `share` is from 0 to 1.
    pub fn between(&self, other: &Self, share: f64) -> Self {
        let part = |a: f64, b: f64| a + (b - a) * share;
        Self {
            total: part(self.total, other.total),
            feed: part(self.feed, other.feed),
            rapid: part(self.rapid, other.rapid),
            fixed: part(self.fixed, other.fixed),
            wait: part(self.wait, other.wait),
        }
    }
}

/// Mark at the beginning of a block or at the issue of an M code.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct PlanMark {
    /// Number of the segment in the run.
    pub segment: u64,
    pub origin: Origin,
    pub times: Times,
    /// True if the program waits for an M code after that segment.
    pub waits: bool,
}

/// Maximum of a value, and the block that causes it.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PlannedPeak {
    pub value: f64,
    pub origin: Origin,
}

/// Recorded range of positions of an axis, and its maximum velocity and acceleration.
#[derive(Debug, Clone, Copy)]
pub(super) struct AxisTrace {
    pub axis: Axis,
    pub lowest: f64,
    pub highest: f64,
    pub velocity: PlannedPeak,
    pub acceleration: PlannedPeak,
}

/// An axis with a model of the drive that follows its setpoints.
#[derive(Debug, Clone, Copy)]
struct FollowedAxis {
    trace: AxisTrace,
    last: f64,
    velocity: f64,
    /// Following error of the drive, mm or degrees.
    error: f64,
    lag_periods: f64,
    decay: f64,
    in_position: f64,
    timeout_s: f64,
}

impl FollowedAxis {
    fn new(axis: Axis, motor: &MotorSettings, at: f64, period_s: f64) -> Self {
        let lag_periods = (motor.lag_ms / 1000.0 / period_s).max(0.0);
        let trace = AxisTrace {
            axis,
            lowest: at,
            highest: at,
            velocity: PlannedPeak::default(),
            acceleration: PlannedPeak::default(),
        };
        Self {
            trace,
            last: at,
            velocity: 0.0,
            error: 0.0,
            lag_periods,
            decay: if lag_periods > 0.0 {
                (-1.0 / lag_periods).exp()
            } else {
                0.0
            },
            in_position: motor.in_position,
            timeout_s: motor.in_position_timeout_ms / 1000.0,
        }
    }

    /// Moves the axis to the setpoint `at`, which is `periods` periods later.
    fn go_to(&mut self, at: f64, periods: f64, period_s: f64, origin: Origin) {
        let step = at - self.last;
        let velocity = step / (periods * period_s);
        let acceleration = (velocity - self.velocity) / period_s;
        let trace = &mut self.trace;
        trace.lowest = trace.lowest.min(at);
        trace.highest = trace.highest.max(at);
        for (peak, value) in [
            (&mut trace.velocity, velocity),
            (&mut trace.acceleration, acceleration),
        ] {
            if value.abs() > peak.value * (1.0 + 1e-6) {
                *peak = PlannedPeak {
                    value: value.abs(),
                    origin,
                };
            }
        }
        let settled = step / periods * self.lag_periods;
        self.error = settled + (self.error - settled) * self.decay.powf(periods);
        (self.last, self.velocity) = (at, velocity);
    }

    fn is_in_position(&self) -> bool {
        self.error.abs() <= self.in_position
    }
}

/// Record of the planned motion from the start of the plan.
#[derive(Debug)]
pub(super) struct Tracer {
    period_s: f64,
    axes: Vec<FollowedAxis>,
    times: Times,
    /// Profile time of the next setpoint, s; `None` if the machine rests.
    phase_s: Option<f64>,
    origin: Origin,
    base: TimeBase,
    sleeve: PathSimplifier,
    at: AxisVector,
    pub palette: Palette,
    vertices: Vec<Vertex>,
    /// Completed chunks that the planning has not collected yet.
    pub chunks: Vec<Chunk>,
    vertex_count: usize,
    pub marks: Vec<PlanMark>,
    /// Number of blocks between two marks.
    stride: u32,
    unmarked: u32,
}

impl Tracer {
    /// Creates the tracer of a program; the machine is at rest at this position.
    pub fn new(settings: &CoordinateSystemSettings, program: u16, at: MachinePosition) -> Self {
        let period_s = settings.servo_period_s;
        let motor = |axis: Axis| settings.motors[axis.index()].as_ref();
        let axes = settings
            .axes()
            .iter()
            .filter_map(|axis| Some((axis, motor(axis)?)));
        let tolerance = super::chunk::TOLERANCES_MM[0];
        let mut tracer = Self {
            period_s,
            axes: axes
                .map(|(axis, motor)| FollowedAxis::new(axis, motor, at.0[axis], period_s))
                .collect(),
            times: Times::default(),
            phase_s: None,
            origin: Origin {
                program,
                ..Origin::default()
            },
            base: TimeBase::Fixed,
            sleeve: PathSimplifier::new(tolerance, (picture_position(at.0), 0.0)),
            at: at.0,
            palette: Palette::default(),
            vertices: Vec::new(),
            chunks: Vec::new(),
            vertex_count: 0,
            marks: Vec::new(),
            stride: 1,
            unmarked: 0,
        };
        tracer.vertex((picture_position(at.0), 0.0));
        tracer
    }

    /// Returns the time from the start of the plan, by category.
    pub fn times(&self) -> Times {
        self.times
    }

    /// Returns true if the path has reached [`VERTICES_MAX`] vertices.
    pub fn is_cut(&self) -> bool {
        self.vertex_count >= VERTICES_MAX
    }

    /// Returns the recorded values of each axis.
    pub fn axes(&self) -> impl Iterator<Item = &AxisTrace> {
        self.axes.iter().map(|followed| &followed.trace)
    }

    /// Begins the block to which this segment belongs, unless the block has already begun.
    pub fn begin_block(&mut self, origin: Origin, segment: u64) {
        if self.origin == origin && !self.marks.is_empty() {
            return;
        }
        self.cut();
        self.origin = origin;
        self.unmarked += 1;
        if self.unmarked < self.stride {
            return;
        }
        self.unmarked = 0;
        self.mark(origin, segment, false);
    }

    /// Ends the block: the next motion begins a new block, even if its origin is the same.
    pub fn end_block(&mut self) {
        self.origin.line = 0;
    }

    /// Records the times up to now as a mark.
    fn mark(&mut self, origin: Origin, segment: u64, waits: bool) {
        if self.marks.len() >= MARKS_MAX {
            let mut i = 0;
            self.marks.retain(|_| {
                i += 1;
                i % 2 == 1
            });
            self.stride *= 2;
        }
        let times = self.times;
        self.marks.push(PlanMark {
            segment,
            origin,
            times,
            waits,
        });
    }

    /// Adds a wait of the program after this segment, s.
    pub fn wait(&mut self, origin: Origin, segment: u64, time_s: f64) {
        self.cut();
        self.origin = origin;
        self.mark(origin, segment, true);
        self.rest(time_s, true);
    }

    /// Follows a profile to its end and records its setpoints.
    pub fn follow(&mut self, profile: &Profile) {
        self.begin_block(profile.origin, profile.segment);
        let base = profile.law.time_base();
        if self.base != base {
            self.cut();
            self.base = base;
        }
        if let Law::Rest { .. } = &profile.law {
            self.rest(profile.duration_s, false);
            return;
        }
        let (mut first_s, mut k) = (self.phase_s.unwrap_or(0.0), 0.0);
        let end_s = profile.duration_s;
        let stride = (end_s / STEPS_OF_LONG / self.period_s).ceil().max(1.0);
        loop {
            let t_s = first_s + k * self.period_s;
            if end_s - t_s <= END_TOLERANCE * self.period_s {
                first_s = t_s - end_s;
                break;
            }
            self.setpoint(profile.position(t_s), 1.0);
            let is_middle = end_s > LONG_S && t_s > LONG_S / 10.0 && end_s - t_s > LONG_S / 10.0;
            if is_middle && stride > 1.0 {
                k += stride - 1.0;
                self.setpoint(profile.position(first_s + k * self.period_s), stride - 1.0);
            }
            k += 1.0;
        }
        if profile.exact_stop {
            self.setpoint(profile.end_position(), 1.0);
            self.come_into_position();
            self.phase_s = None;
        } else {
            self.phase_s = Some(first_s);
        }
    }

    fn setpoint(&mut self, at: AxisVector, periods: f64) {
        for axis in &mut self.axes {
            axis.go_to(at[axis.trace.axis], periods, self.period_s, self.origin);
        }
        self.at = at;
        self.pass(periods);
        if let Some(vertex) = self.sleeve.push((picture_position(at), self.times.total)) {
            self.vertex(vertex);
        }
    }

    fn pass(&mut self, periods: f64) {
        let time_s = periods * self.period_s;
        self.times.total += time_s;
        match self.base {
            TimeBase::Feed => self.times.feed += time_s,
            TimeBase::Rapid => self.times.rapid += time_s,
            TimeBase::Fixed => self.times.fixed += time_s,
        }
    }

    /// Waits at rest until the following error of each drive is small, or until the axis's timeout.
    fn come_into_position(&mut self) {
        let mut waited_s = 0.0;
        while self
            .axes
            .iter()
            .any(|axis| !axis.is_in_position() && waited_s < axis.timeout_s)
        {
            for axis in &mut self.axes {
                axis.go_to(axis.last, 1.0, self.period_s, self.origin);
            }
            waited_s += self.period_s;
        }
        self.times.total += waited_s;
        self.times.fixed += waited_s;
        for axis in &mut self.axes {
            axis.velocity = 0.0;
        }
        self.rested();
    }

    /// Keeps the machine at rest for a dwell or, if `is_wait`, for a wait of the program.
    fn rest(&mut self, time_s: f64, is_wait: bool) {
        let periods = (time_s / self.period_s - END_TOLERANCE).ceil().max(0.0);
        // A dwell has a first setpoint and one at its end; a wait has no setpoints.
        let time_s = if is_wait { periods } else { periods + 1.0 } * self.period_s;
        self.times.total += time_s;
        if is_wait {
            self.times.wait += time_s;
        } else {
            self.times.fixed += time_s;
        }
        self.phase_s = None;
        self.rested();
    }

    /// Adds the rest that has ended now to the path.
    fn rested(&mut self) {
        self.cut();
        let (at, since_s) = self.sleeve.end_point();
        self.sleeve.rest(self.times.total);
        if self.times.total - since_s > 2.0 * self.period_s {
            self.vertex((at, self.times.total));
        }
    }

    fn cut(&mut self) {
        if let Some(vertex) = self.sleeve.cut() {
            self.vertex(vertex);
        }
    }

    fn vertex(&mut self, (at, time_s): ([f64; 3], f64)) {
        if self.is_cut() {
            return;
        }
        let word = self.palette.word(self.origin, self.base == TimeBase::Rapid);
        let vertex = Vertex {
            at: at.map(single),
            word,
            time_s: single(time_s),
        };
        if let [.., before, last] = self.vertices.as_mut_slice()
            && [before.at, last.at]
                .iter()
                .all(|at| at.map(f32::to_bits) == vertex.at.map(f32::to_bits))
        {
            // The previous vertex also ends a rest at this position; the two rests become one.
            *last = vertex;
            return;
        }
        self.vertices.push(vertex);
        self.vertex_count += 1;
        if self.vertices.len() > CHUNK_LINES {
            let full = std::mem::replace(&mut self.vertices, vec![vertex]);
            self.chunks.push(Chunk::new(full));
        }
    }

    /// Ends the record; the remaining vertices become the last chunk.
    pub fn finish_chunks(&mut self) {
        self.cut();
        let left = std::mem::take(&mut self.vertices);
        if left.len() > 1 || self.chunks.is_empty() {
            self.chunks.push(Chunk::new(left));
        }
    }
}

/// Returns the X, Y and Z positions of the picture, mm.
fn picture_position(at: AxisVector) -> [f64; 3] {
    Axis::ORTHOGONAL.map(|axis| at[axis])
}
