//! G500 against an independent implementation of M1b and M1d: derivatives of the path by plan time, and the
//! best possible time on a dense grid.

use std::collections::VecDeque;

use tandem_model::flow::{MultiBlock, Path, Segment, SegmentEnd, SegmentMotion};
use tandem_model::plane::Plane;
use tandem_model::profile::{Law, Pace, PacePiece, Profile, SpeedGrowth};
use tandem_model::ramp::UnitRamp;
use tandem_model::settings::{CoordinateSystemSettings, ShortBlock};
use tandem_model::{AXES_MAX, Axis, AxisVector};
use tandem_motion::Planner;

use crate::chain::Formula;
use crate::rig::{PERIOD_S, motor, settings};

/// Geometry of a block, kept in addition to its path.
#[derive(Debug, Clone, Copy)]
pub enum Shape {
    Line,
    /// An arc from an angle through a signed angle. The radius and all axes outside the plane change in
    /// proportion to the angle.
    Arc {
        plane: Plane,
        centre: [f64; 2],
        radius: f64,
        growth: f64,
        angle: f64,
        sweep: f64,
    },
}

/// A chain to plan with G500, and its machine.
pub struct Chain {
    pub settings: CoordinateSystemSettings,
    pub segments: Vec<Segment>,
    pub shapes: Vec<Shape>,
    pub formula: Formula,
}

impl Chain {
    /// Creates a chain for the first motors of X, Y, Z, A, B, C: one for each acceleration.
    pub fn new(accelerations: &[f64], blocks: Vec<(Segment, Shape)>) -> Self {
        let (segments, shapes): (Vec<_>, Vec<_>) = blocks
            .into_iter()
            .map(|(segment, shape)| {
                let segment = Segment {
                    end: SegmentEnd::Continuous,
                    multi_block: MultiBlock::On,
                    ..segment
                };
                (segment, shape)
            })
            .unzip();
        let rule = if segments.len() == 1 {
            ShortBlock::Extend
        } else {
            ShortBlock::Shrink
        };
        // An acceleration time of 0 is replaced by one servo period.
        let counted: Vec<Segment> = segments
            .iter()
            .cloned()
            .map(|mut segment| {
                if let SegmentMotion::Feed { feed, .. } = &mut segment.motion {
                    for time in [&mut feed.ta_ms, &mut feed.td_ms] {
                        if *time == 0.0 {
                            *time = PERIOD_S * 1000.0;
                        }
                    }
                }
                segment
            })
            .collect();
        let formula = Formula::new(&counted, rule);
        let motors = std::array::from_fn(|i| {
            let acceleration = *accelerations.get(i)?;
            let steepest = |path: &Path| match i {
                0..3 => 1.0,
                _ => path.steepest(Axis::ALL[i]) * (1.0 + 1e-9),
            };
            let speeds = formula.paths.iter().zip(&formula.speeds);
            let fastest = speeds.fold(1e-3_f64, |v, (path, &w)| v.max(w * steepest(path)));
            Some(motor(fastest, acceleration, None))
        });
        Self {
            settings: settings(motors),
            segments,
            shapes,
            formula,
        }
    }

    /// Creates a chain of two blocks or more with maximum jerks. The ramps from rest and to rest are those of
    /// the plan.
    pub fn soft(accelerations: &[f64], jerks: &[Option<f64>], blocks: Vec<(Segment, Shape)>) -> Self {
        let mut chain = Self::new(accelerations, blocks);
        for (motor, jerk) in chain.settings.motors.iter_mut().flatten().zip(jerks) {
            motor.max_jerk = *jerk;
        }
        let profiles = chain.plan();
        let times = |ramp: UnitRamp| {
            let [jerk_phase, steady, _] = ramp.phases();
            [steady[1], jerk_phase[1]]
        };
        let ends = match [&profiles[0].law, &profiles[profiles.len() - 1].law] {
            [Law::Paced { block: first, .. }, Law::Paced { block: last, .. }] => [
                times(first.as_ramped().unwrap().start),
                times(last.as_ramped().unwrap().stop),
            ],
            other => panic!("not paced: {other:?}"),
        };
        chain.formula = chain.formula.with_ends(ends);
        chain
    }

    pub fn plan(&self) -> Vec<Profile> {
        self.plan_for(1.0)
    }

    /// Plans the chain for a feed override.
    pub fn plan_for(&self, factor: f64) -> Vec<Profile> {
        let mut planner = Planner::new(&self.settings);
        planner.set_feed_override(factor);
        let mut out = VecDeque::new();
        for segment in &self.segments {
            planner.push(segment, &mut out).unwrap();
        }
        planner.flush(&mut out);
        out.into()
    }

    /// Returns velocity and acceleration of M1b, `t` after the start of the profile of block i (from 0).
    /// Where the acceleration steps, returns the value on the side of `within`. Times begin at the profile,
    /// so that long chains lose no digits.
    pub fn derivatives(&self, i: usize, t: f64, within: f64) -> [AxisVector; 2] {
        let formula = &self.formula;
        let total = |k: usize| formula.ramps[k][0] + formula.ramps[k][1];
        let half_before = if i == 0 { total(0) } else { -total(i) } / 2.0;
        let stop = formula.paths[i].length() / formula.speeds[i] + half_before - total(i + 1) / 2.0;
        let start = if i == 0 { 0.0 } else { -total(i) };
        let at = |k: usize, begin: f64| {
            ramp(
                t - begin,
                within - begin,
                formula.ramps[k][0],
                formula.ramps[k][1],
            )
        };
        let (from, to) = (at(i, start), at(i + 1, stop));
        let mut sum = [AxisVector::ZERO; 2];
        for (block, shares) in [(i, [0, 1, 2].map(|n| from[n] - to[n])), (i + 1, to)] {
            if block < formula.paths.len() && (shares[1] > 0.0 || shares[2] != 0.0) {
                let [s0, s1, s2] = shares.map(|share| share * formula.speeds[block]);
                let [p1, p2] = self.path_derivatives(block, s0);
                sum[0] = sum[0].plus(p1.scaled(s1));
                sum[1] = sum[1].plus(p2.scaled(s1 * s1)).plus(p1.scaled(s2));
            }
        }
        sum
    }

    fn path_derivatives(&self, i: usize, gone: f64) -> [AxisVector; 2] {
        let path = &self.formula.paths[i];
        let way = path.end().minus(path.start());
        let Shape::Arc {
            plane,
            centre,
            radius,
            growth,
            angle,
            sweep,
        } = self.shapes[i]
        else {
            return [way.scaled(1.0 / size_of_way(way)), AxisVector::ZERO];
        };
        let in_plane = plane.axes();
        // Share of the angle that the motion has covered; on a spiral it follows from the radius.
        let share = if growth.abs() < 1e-7 * radius {
            gone / path.length()
        } else {
            let off = in_plane.map(|axis| path.point_at(gone)[axis]);
            ((off[0] - centre[0]).hypot(off[1] - centre[1]) - radius) / growth
        };
        let r = radius + growth * share;
        let mut beside = way;
        for axis in in_plane {
            beside[axis] = 0.0;
        }
        // With p(u), u the share, and l = ds/du: p_s = p_u/l and p_ss = p_uu/l^2 - p_u l_u/l^3.
        let l = (sweep * r).hypot(growth).hypot(beside.orthogonal_length());
        let l_u = sweep * sweep * r * growth / l;
        let (sin, cos) = (angle + sweep * share).sin_cos();
        let (mut p_u, mut p_uu) = (beside, AxisVector::ZERO);
        for (axis, along, across) in [(in_plane[0], cos, -sin), (in_plane[1], sin, cos)] {
            p_u[axis] = growth * along + r * sweep * across;
            p_uu[axis] = 2.0 * growth * sweep * across - r * sweep * sweep * along;
        }
        let bend = p_u.scaled(-l_u / (l * l * l));
        [p_u.scaled(1.0 / l), p_uu.scaled(1.0 / (l * l)).plus(bend)]
    }

    /// Returns the plan time at which the profile of a segment (from 1) begins.
    pub fn begins(&self, segment: u64) -> f64 {
        let i = usize::try_from(segment).unwrap() - 1;
        if i == 0 {
            return 0.0;
        }
        let [ta, ts] = self.formula.ramps[i];
        self.formula.centres[i] + f64::midpoint(ta, ts)
    }

    /// Returns the number of motors.
    pub fn axes(&self) -> usize {
        self.settings.motors.iter().flatten().count()
    }

    pub fn limit(&self, axis: usize) -> f64 {
        self.settings.motors[axis].as_ref().unwrap().max_acceleration
    }
}

/// Returns P, S and the slope of S as truncated powers: the integral of step * box(ta) * box(ts).
fn ramp(t: f64, within: f64, ta: f64, ts: f64) -> [f64; 3] {
    let cut = |x: f64, power: i32| if x > 0.0 { x.powi(power) } else { 0.0 };
    let total = ta + ts;
    if within >= total {
        return [t - total / 2.0, 1.0, 0.0];
    }
    // The time is limited to the ramp that contains the piece, including its ends.
    let t = if within > 0.0 { t.clamp(0.0, total) } else { t };
    if ts > 0.0 {
        let with =
            |power: i32| cut(t, power) - cut(t - ta, power) - cut(t - ts, power) + cut(t - ta - ts, power);
        [
            with(3) / (6.0 * ta * ts),
            with(2) / (2.0 * ta * ts),
            with(1) / (ta * ts),
        ]
    } else {
        let inside = if within > 0.0 && within < ta {
            1.0 / ta
        } else {
            0.0
        };
        [
            (cut(t, 2) - cut(t - ta, 2)) / (2.0 * ta),
            (cut(t, 1) - cut(t - ta, 1)) / ta,
            inside,
        ]
    }
}

/// Returns the largest rate that the override allows at a point with these derivatives. Below 100 percent, ramps from
/// rest and to rest may be faster while the speed is below F.
fn largest_rate(chain: &Chain, profile: &Profile, block: usize, rate: f64, q1: AxisVector) -> f64 {
    let factor = pace(profile).feed_override;
    let speeds = [block, block + 1].map(|i| chain.formula.speeds.get(i).copied().unwrap_or(0.0));
    let speed = rate * size_of_way(q1) / speeds[0].max(speeds[1]);
    let is_slow = factor < 1.0 && speed <= factor * (1.0 + 1e-6);
    (if is_slow { 1.0 } else { factor }) * (1.0 + 1e-9)
}

/// Returns the length to which F refers: over X, Y and Z, or over the other axes if those rest.
fn size_of_way(way: AxisVector) -> f64 {
    match way.orthogonal_length() {
        0.0 => way.rotary_length(),
        length => length,
    }
}

pub fn pace(profile: &Profile) -> &Pace {
    match &profile.law {
        Law::Paced { pace, .. } => pace,
        other => panic!("not paced: {other:?}"),
    }
}

/// Returns each piece of a profile with its duration.
pub fn pieces(profile: &Profile) -> Vec<(PacePiece, f64)> {
    let pieces = pace(profile).pieces();
    let ends = pieces[1..]
        .iter()
        .map(|piece| piece.begins_s)
        .chain([profile.duration_s]);
    pieces
        .iter()
        .zip(ends)
        .map(|(piece, end)| (*piece, end - piece.begins_s))
        .collect()
}

/// Returns plan time t after the start of a piece, its first and its second derivative, if the change of the rate is linear
/// in plan time: by the power series of `s'' = b + c s`.
fn by_power_series(piece: &PacePiece, t: f64) -> [f64; 3] {
    let c = piece.rate_slope;
    let mut terms = [0.0, piece.rate, piece.rate_change / 2.0];
    let [mut s, mut first] = [0.0; 2];
    let mut power = 1.0;
    for n in 1..60 {
        let factor = f64::from(n);
        first += factor * terms[1] * power;
        power *= t;
        s += terms[1] * power;
        let next = c * terms[1] / ((factor + 2.0) * (factor + 1.0));
        terms = [terms[1], terms[2], next];
    }
    [piece.plan_s + s, first, piece.rate_change + c * s]
}

/// Returns plan time t after the start of a piece, by bisection of the distance if the rate counts distance.
pub fn plan_time(piece: &PacePiece, t: f64) -> f64 {
    if piece.rate_slope != 0.0 {
        return by_power_series(piece, t)[0];
    }
    let gone = t * (piece.rate + piece.rate_change * t / 2.0 + piece.rate_jerk * t * t / 6.0);
    let SpeedGrowth { first, second } = piece.growth;
    let (mut low, mut high) = (0.0, if piece.growth.is_none() { 0.0 } else { 1.0 });
    let distance = |x: f64| x + first * x * x / 2.0 + second * x * x * x / 6.0;
    while distance(high) < gone && high > 0.0 && 1.0 + first * high + second * high * high / 2.0 > 0.0 {
        low = high;
        high *= 2.0;
    }
    if piece.growth.is_none() {
        return piece.plan_s + gone;
    }
    for _ in 0..200 {
        let middle = f64::midpoint(low, high);
        if distance(middle) < gone && 1.0 + first * middle + second * middle * middle / 2.0 > 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    piece.plan_s + low
}

/// Returns the first and second derivative of plan time by time, t after the start of a piece.
pub fn rate_of_plan(piece: &PacePiece, t: f64) -> [f64; 2] {
    if piece.rate_slope != 0.0 {
        let [_, rate, rate_change] = by_power_series(piece, t);
        return [rate, rate_change];
    }
    let SpeedGrowth { first, second } = piece.growth;
    let past = plan_time(piece, t) - piece.plan_s;
    let speed = 1.0 + first * past + second * past * past / 2.0;
    let rate = (piece.rate + piece.rate_change * t + piece.rate_jerk * t * t / 2.0) / speed;
    [
        rate,
        (piece.rate_change + piece.rate_jerk * t - rate * rate * (first + second * past)) / speed,
    ]
}

/// Returns the first limit that is exceeded with these derivatives by plan time, this rate and its change.
fn exceeded(
    chain: &Chain,
    [q1, q2]: [AxisVector; 2],
    [rate, rate_change]: [f64; 2],
    digits: f64,
) -> Option<String> {
    (0..chain.axes()).find_map(|axis| {
        let limit = chain.limit(axis);
        let a = (q2.0[axis] * rate * rate + q1.0[axis] * rate_change).abs();
        let v = (q1.0[axis] * rate).abs();
        let most = chain.settings.motors[axis].as_ref().unwrap().max_velocity;
        if a > limit * (1.0 + 1e-6 + digits) {
            Some(format!("axis {axis}: {} of its acceleration", a / limit))
        } else if v > most * (1.0 + 1e-6) {
            Some(format!("axis {axis}: {} of its velocity", v / most))
        } else {
            None
        }
    })
}

/// Returns an error if the exact derivatives of the plan exceed a maximum acceleration or velocity.
pub fn check(chain: &Chain, profiles: &[Profile], samples: u32) -> Result<(), String> {
    let mut rate_before = None;
    for profile in profiles {
        let block = usize::try_from(profile.segment).unwrap() - 1;
        for (piece, duration_s) in pieces(profile) {
            if let Some(before) = rate_before {
                let step: f64 = piece.rate - before;
                if step.abs() > 1e-6 * piece.rate.max(1e-3) {
                    return Err(format!("the rate steps by {step} in segment {}", profile.segment));
                }
            }
            rate_before = Some(rate_of_plan(&piece, duration_s)[0]);
            let plan = |t: f64| plan_time(&piece, t);
            let within = plan(duration_s / 2.0);
            // After a minute, ten digits of a microsecond ramp remain.
            let ramp_s = chain.formula.ramps[block + 1].iter().sum::<f64>();
            let phases = chain.formula.ramps[block]
                .iter()
                .chain(&chain.formula.ramps[block + 1]);
            let shortest_s = phases.copied().filter(|s| *s > 0.0).fold(1.0, f64::min);
            let digits = 200.0 * f64::EPSILON * within / ramp_s;
            for k in 0..=samples {
                // Samples at both ends and between them, but never exactly in the middle, where the plan may
                // have joined two ramps.
                let shift = if k == 0 || k == samples { 0.0 } else { 0.0317 };
                let t = duration_s * (f64::from(k) + shift) / f64::from(samples);
                let [rate, rate_change] = rate_of_plan(&piece, t);
                let [q1, _] = chain.derivatives(block, plan(t), within);
                if !(0.0..=largest_rate(chain, profile, block, rate, q1)).contains(&rate) {
                    return Err(format!("the rate is {rate} in segment {}", profile.segment));
                }
                // Samples lie inside the phase, so that rounding does not select the adjacent phase. Only a
                // piece at the planned rate, or planned within the jerk, may contain several phases.
                let is_even =
                    piece.rate_change.abs() < 1e-12 && piece.rate_jerk == 0.0 && piece.growth.is_none();
                let joined = is_even || piece.rate_slope != 0.0;
                let inwards = within - plan(t);
                let inside = plan(t)
                    + if joined {
                        inwards.signum() * (inwards.abs() * 1e-3).min(shortest_s * 1e-3)
                    } else {
                        inwards
                    };
                let found_at = |off: f64| {
                    let derivatives = chain.derivatives(block, plan(t) + off, inside + off);
                    exceeded(chain, derivatives, [rate, rate_change], digits)
                };
                // Rounding of plan time moves the start of a ramp, in the plan and in the formula. If a ramp
                // is much steeper than the motors allow, the acceleration is a small difference of two large
                // values that both shift. So a limit is treated as exceeded only if it is exceeded for all starts
                // within the rounding.
                let rounding = [-2.0, -1.0, 0.0, 1.0, 2.0].map(|n| n * f64::EPSILON * within);
                if let Some(found) = found_at(0.0)
                    && rounding.into_iter().all(|off| found_at(off).is_some())
                {
                    return Err(format!(
                        "{found} in segment {} at {t} of {duration_s} s",
                        profile.segment
                    ));
                }
            }
        }
    }
    Ok(())
}

/// Checks that positions equal those of M1b at the plan time of each sample.
pub fn same_path(chain: &Chain, profiles: &[Profile]) -> Result<(), String> {
    for profile in profiles {
        let offset = chain.begins(profile.segment);
        for k in 0..=4 {
            let t = profile.duration_s * f64::from(k) / 4.0;
            let planned = if k == 4 {
                pace(profile).ends_s
            } else {
                pace(profile).plan_time(t)
            };
            let off = profile
                .position(t)
                .minus(chain.formula.position(offset + planned))
                .0
                .iter()
                .fold(0.0_f64, |most, off| most.max(off.abs()));
            if off > 1e-7 {
                return Err(format!("{off} off the path in segment {}", profile.segment));
            }
        }
    }
    Ok(())
}

pub fn time_s(profiles: &[Profile]) -> f64 {
    profiles.iter().map(|profile| profile.duration_s).sum()
}

/// A step of plan time. For each axis, its acceleration in the middle of the step divided by the maximum, as
/// factors of the squares of the rate at both ends: `q'' (x + y)/2 + q' (y - x)/(2 h)`.
pub struct Step {
    pub h: f64,
    /// Largest square of the rate.
    pub most: f64,
    pub rows: [[f64; 2]; AXES_MAX],
}

/// Returns a dense grid: each phase of a ramp, and each part between ramps, in `n` steps.
fn grid(chain: &Chain, n: u32) -> Vec<Step> {
    let formula = &chain.formula;
    let mut breaks = vec![0.0];
    for (centre, [ta, ts]) in formula.centres.iter().zip(&formula.ramps) {
        let begin = centre - f64::midpoint(*ta, *ts);
        breaks.extend([0.0, *ts, *ta, ta + ts].map(|phase| begin + phase));
    }
    let mut times = vec![0.0];
    for pair in breaks.windows(2) {
        if pair[1] - pair[0] > 1e-9 * formula.end_s / formula.centres.len() as f64 {
            let from = times[times.len() - 1];
            times.extend((1..=n).map(|k| from + (pair[1] - from) * f64::from(k) / f64::from(n)));
        }
    }
    let step = |pair: &[f64]| {
        let (h, middle) = (pair[1] - pair[0], f64::midpoint(pair[0], pair[1]));
        let block = (1..chain.segments.len())
            .rev()
            .find(|&i| chain.begins(i as u64 + 1) <= middle)
            .unwrap_or(0);
        let local = middle - chain.begins(block as u64 + 1);
        let [q1, q2] = chain.derivatives(block, local, local);
        let mut rows = [[0.0; 2]; AXES_MAX];
        for (axis, row) in rows.iter_mut().enumerate().take(chain.axes()) {
            let (a, b) = (q2.0[axis] / 2.0, q1.0[axis] / (2.0 * h));
            *row = [(a - b) / chain.limit(axis), (a + b) / chain.limit(axis)];
        }
        let most = 1.0;
        Step { h, most, rows }
    };
    times.windows(2).map(step).collect()
}

impl Step {
    /// Returns the largest square of the rate at the end, up to `most`, that is possible with x at the start.
    fn end(&self, x: f64, most: f64) -> Option<f64> {
        let (mut low, mut high) = (0.0_f64, most.min(self.most));
        for [left, right] in self.rows {
            if right != 0.0 {
                let (a, b) = ((1.0 - left * x) / right, (-1.0 - left * x) / right);
                (low, high) = (low.max(a.min(b)), high.min(a.max(b)));
            } else if (left * x).abs() > 1.0 {
                return None;
            }
        }
        (low <= high).then_some(high)
    }

    /// Returns the largest square of the rate at the start, by bisection.
    fn start(&self, end: f64) -> f64 {
        if self.end(self.most, end).is_some() {
            return self.most;
        }
        let (mut low, mut high) = (0.0, self.most);
        for _ in 0..50 {
            let middle = f64::midpoint(low, high);
            if self.end(middle, end).is_some() {
                low = middle;
            } else {
                high = middle;
            }
        }
        low
    }
}

/// Returns the best possible time on a dense grid of plan time: the largest squares of the rate backward,
/// then forward.
pub fn best_time_s(chain: &Chain, n: u32) -> f64 {
    best_time_at(chain, n, 1.0)
}

/// Returns the best possible time if the rate is at most `factor`.
pub fn best_time_at(chain: &Chain, n: u32, factor: f64) -> f64 {
    let mut steps = grid(chain, n);
    for step in &mut steps {
        step.most = step.most.min(factor * factor);
    }
    best_time_of(&steps, [factor * factor; 2])
}

/// Returns the best possible time over these steps, with these largest squares of the rate at both ends.
pub fn best_time_of(steps: &[Step], [begin, end]: [f64; 2]) -> f64 {
    let mut limits = vec![end; steps.len() + 1];
    for (i, step) in steps.iter().enumerate().rev() {
        limits[i] = step.start(limits[i + 1]);
    }
    let mut x = limits[0].min(begin);
    let mut time = 0.0;
    for (i, step) in steps.iter().enumerate() {
        let y = step
            .end(x.min(limits[i]), limits[i + 1])
            .unwrap_or(x.min(limits[i + 1]));
        time += 2.0 * step.h / (x.sqrt() + y.sqrt());
        x = y;
    }
    time
}
