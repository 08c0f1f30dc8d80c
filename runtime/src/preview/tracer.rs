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

/// Number of steps into which the middle part of a long profile is divided.
const STEPS_OF_LONG: f64 = 50_000.0;

/// Share of F from which the motion has the programmed speed.
const AT_F: f64 = 0.999;

/// Maximum number of corners of which the distance of the path is kept.
const CORNERS_MAX: usize = 100;

/// Distance of the path from a corner below which the corner is not kept, mm.
const CORNER_MIN_MM: f64 = 0.001;

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
    /// Parts of `feed` in which look-ahead is slower than F, by the share of F: [`SHARES`] equal ranges.
    pub slower: [f64; SHARES],
}

/// Number of ranges of the share of F.
pub(super) const SHARES: usize = 16;

impl Times {
    /// Returns the time at feedrate from these times to later ones at a feed override above 0, s. `is_replanned` is true
    /// if the override multiplies F and keeps the limits of the motors; motion that is slower than F because of
    /// these limits then takes longer only where its speed is above that of the override.
    pub fn feed_to(&self, end: &Self, factor: f64, is_replanned: bool) -> f64 {
        let feed = (end.feed - self.feed).max(0.0);
        if !is_replanned {
            return feed / factor;
        }
        let slower = || {
            self.slower
                .iter()
                .zip(&end.slower)
                .map(|(from, to)| (to - from).max(0.0))
        };
        let at_f = (feed - slower().sum::<f64>()).max(0.0);
        let scaled = slower().enumerate().map(|(range, time_s)| {
            let share = (range as f64 + 0.5) / SHARES as f64;
            time_s * (share / factor).max(1.0)
        });
        at_f / factor + scaled.sum::<f64>()
    }

    /// Interpolates between the times of two marks; `share` is from 0 to 1.
    pub fn between(&self, other: &Self, share: f64) -> Self {
        let part = |a: f64, b: f64| a + (b - a) * share;
        Self {
            total: part(self.total, other.total),
            feed: part(self.feed, other.feed),
            rapid: part(self.rapid, other.rapid),
            fixed: part(self.fixed, other.fixed),
            wait: part(self.wait, other.wait),
            slower: std::array::from_fn(|range| part(self.slower[range], other.slower[range])),
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
    /// The corners from which the path is farthest, in any order.
    corners: Vec<PlannedPeak>,
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
            corners: Vec::new(),
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

    /// Returns the corners from which the path is farthest, the largest distance first.
    pub fn corners(&self) -> Vec<PlannedPeak> {
        let mut corners = self.corners.clone();
        corners.sort_by(|one, other| other.value.total_cmp(&one.value));
        corners
    }

    /// Keeps the corner at the end of a profile if it is one of those from which the path is farthest.
    fn see_corner(&mut self, profile: &Profile) {
        let nearest =
            (self.corners.iter().enumerate()).min_by(|one, other| one.1.value.total_cmp(&other.1.value));
        let full = nearest.filter(|_| self.corners.len() >= CORNERS_MAX);
        let above = full.map_or(CORNER_MIN_MM, |(_, corner)| corner.value);
        let Some(value) = profile.corner_distance(above) else {
            return;
        };
        let corner = PlannedPeak {
            value,
            origin: profile.origin,
        };
        match full.map(|(index, _)| index) {
            Some(index) => self.corners[index] = corner,
            None => self.corners.push(corner),
        }
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
        self.see_corner(profile);
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
            self.see_rate(profile, t_s);
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

    /// Adds a period to the time in which look-ahead is slower than F.
    fn see_rate(&mut self, profile: &Profile, t_s: f64) {
        let Law::Paced { pace, .. } = &profile.law else {
            return;
        };
        let to_s = (t_s + self.period_s).min(profile.duration_s);
        let rate = (pace.plan_time(to_s) - pace.plan_time(t_s)) / (to_s - t_s);
        if rate < AT_F {
            let range = (rate * SHARES as f64).max(0.0);
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "it is a small number of at least 0"
            )]
            let range = (range as usize).min(SHARES - 1);
            self.times.slower[range] += self.period_s;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn m1d6_an_override_lengthens_only_motion_that_it_makes_slower() {
        // 4 s at F, 2 s near a quarter of F, 1 s near three quarters
        let mut end = Times {
            feed: 7.0,
            ..Times::default()
        };
        end.slower[SHARES / 4] = 2.0;
        end.slower[SHARES * 3 / 4] = 1.0;
        let start = Times::default();
        let middle = 0.5 / SHARES as f64;
        // At 50 percent: 8 s, 2 s, and 1 s in the proportion of the speeds
        let half = 8.0 + 2.0 + (0.75 + middle) / 0.5;
        assert!((start.feed_to(&end, 0.5, true) - half).abs() < 1e-9);
        assert!((start.feed_to(&end, 0.5, false) - 14.0).abs() < 1e-9);
        // At 200 percent only the motion at F is faster.
        assert!((start.feed_to(&end, 2.0, true) - 5.0).abs() < 1e-9);
        assert!((end.feed_to(&end, 0.5, true)).abs() < 1e-9);
    }
}
