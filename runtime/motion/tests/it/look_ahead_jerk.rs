//! G500 where motors have a maximum jerk (M1d): lines, and random chains.

use std::collections::VecDeque;

use tandem_model::alarm::LIMIT_ZERO;
use tandem_model::flow::{MultiBlock, Path, Segment, SegmentEnd, SegmentFeed, SegmentMotion};
use tandem_model::plane::{Plane, Turn};
use tandem_model::profile::{Law, PathPlace, Profile};
use tandem_model::settings::{CoordinateSystemSettings, ShortBlock};
use tandem_model::{ArcPath, Axis, AxisVector};
use tandem_motion::Planner;

use crate::look_ahead_random::{Random, chains, each_seed, random_blocks};
use crate::look_ahead_rig::{Chain, best_time_s, check, check_jerk, pace, same_path, time_s};
use crate::rig::{
    PERIOD_S, close, feed, integral_of_ramp, line, motor, refused, segment, settings, shortest_by_halving,
    vector,
};

/// Share of the maximum acceleration that remains for the plan after the reserve for feed hold.
pub const LEFT: f64 = 1.0 - 2e-3;

/// Returns lines through points with G500, from rest to rest.
fn lines(points: &[AxisVector], feed: SegmentFeed) -> Vec<Segment> {
    let ends = points.windows(2);
    ends.map(|ends| Segment {
        multi_block: MultiBlock::On,
        end: SegmentEnd::Continuous,
        ..line(ends[0], ends[1], feed)
    })
    .collect()
}

fn planned(settings: &CoordinateSystemSettings, segments: &[Segment]) -> (Planner, VecDeque<Profile>) {
    let mut planner = Planner::new(settings);
    let mut out = VecDeque::new();
    for segment in segments {
        planner.push(segment, &mut out).unwrap();
    }
    planner.flush(&mut out);
    (planner, out)
}

/// A motion that is planned to its end.
pub struct Motion(Vec<Profile>);

impl Motion {
    pub fn new(settings: &CoordinateSystemSettings, segments: &[Segment]) -> Self {
        Self(planned(settings, segments).1.into())
    }

    /// Plans the backward motion from the end.
    pub fn back(settings: &CoordinateSystemSettings, segments: &[Segment]) -> Self {
        let (mut planner, _) = planned(settings, segments);
        let end = PathPlace {
            segment: planner.last_segment(),
            plan_s: f64::INFINITY,
        };
        Self(planner.retrace(end).into())
    }

    pub fn time_s(&self) -> f64 {
        self.0.iter().map(|profile| profile.duration_s).sum()
    }

    /// Returns the times at which the profiles begin, and the end time.
    pub fn begins(&self) -> Vec<f64> {
        let ends = self.0.iter().scan(0.0, |end, profile| {
            *end += profile.duration_s;
            Some(*end)
        });
        [0.0].into_iter().chain(ends).collect()
    }

    pub fn position(&self, t: f64) -> AxisVector {
        let mut left = t;
        for profile in &self.0 {
            if left < profile.duration_s {
                return profile.position(left);
            }
            left -= profile.duration_s;
        }
        self.0[self.0.len() - 1].end_position()
    }

    /// Returns the time at which X reaches this position; X never decreases.
    fn when_x_is(&self, x: f64) -> f64 {
        let (mut low, mut high) = (0.0, self.time_s());
        for _ in 0..100 {
            let middle = f64::midpoint(low, high);
            if self.position(middle)[Axis::X] < x {
                low = middle;
            } else {
                high = middle;
            }
        }
        low
    }

    /// Returns the maxima of the second and third derivative from one time to another, by divided differences
    /// of the positions. Each difference is a mean of the derivative over its samples. The effect of rounding
    /// is subtracted.
    pub fn most(&self, axis: Axis, [from, to]: [f64; 2]) -> [f64; 2] {
        let n = 1000;
        let h = (to - from) / f64::from(n);
        let at = |k: i32| self.position(from + h * f64::from(k))[axis];
        // Positions are calculated from distances along the path; on an arc also from its radius.
        let lengths = self.0.iter().map(|profile| match &profile.law {
            Law::Paced { block, .. } => block.as_ramped().unwrap().path.length(),
            other => panic!("not paced: {other:?}"),
        });
        let places = [from, to].into_iter().flat_map(|t| self.position(t).0);
        let far = places.map(f64::abs).sum::<f64>() + lengths.fold(0.0, f64::max);
        let mut most = [0.0_f64; 2];
        for k in 0..n - 2 {
            let [a, b, c, d] = [at(k), at(k + 1), at(k + 2), at(k + 3)];
            most[0] = most[0].max((a - 2.0 * b + c).abs() / (h * h));
            most[1] = most[1].max((d - 3.0 * c + 3.0 * b - a).abs() / (h * h * h));
        }
        let rounding = 16.0 * f64::EPSILON * far;
        [most[0] - rounding / (h * h), most[1] - rounding / (h * h * h)]
    }
}

fn xy(acceleration: f64, jerk: f64) -> CoordinateSystemSettings {
    settings(std::array::from_fn(|i| {
        (i < 2).then(|| motor(1000.0, acceleration, Some(jerk)))
    }))
}

#[test]
fn m1d_a_line_from_rest_to_rest_has_the_profile_of_7_segments() {
    // 50 mm at 100 mm/s, 1000 mm/s^2, 10,000 mm/s^3; ta = v/a = 0.1 s, ts = a/j = 0.1 s, although 0.01 s are
    // programmed.
    let segments = lines(
        &[AxisVector::ZERO, vector(&[50.0])],
        feed(6000.0, [10.0, 10.0, 0.0]),
    );
    let motion = Motion::new(&xy(1000.0, 10_000.0), &segments);
    let a = 1000.0 * LEFT;
    let (ta, ts) = (100.0 / a, a / 10_000.0);
    let end = 50.0 / 100.0 + ta + ts;
    assert!((motion.time_s() - end).abs() < 1e-8);
    for k in 0..=1000 {
        let t = end * f64::from(k) / 1000.0;
        let expected = 100.0 * (integral_of_ramp(t, ta, ts) - integral_of_ramp(t - (end - ta - ts), ta, ts));
        let x = motion.position(t)[Axis::X];
        assert!((x - expected).abs() < 1e-6, "{t}: {x} is not {expected}");
    }
}

#[test]
fn m1d_ramps_within_the_maximum_jerk_are_as_programmed() {
    // 100 mm/s in 0.25 s, 0.05 s of it jerk: 500 mm/s^2, 10,000 mm/s^3.
    let segments = lines(
        &[AxisVector::ZERO, vector(&[50.0])],
        feed(6000.0, [200.0, 200.0, 50.0]),
    );
    let motion = Motion::new(&xy(505.0, 10_001.0), &segments);
    close(motion.time_s(), 50.0 / 100.0 + 0.25);
    close(
        motion.position(0.1)[Axis::X],
        100.0 * integral_of_ramp(0.1, 0.2, 0.05),
    );
}

#[test]
fn m1d_line_too_short_for_f_keeps_limits_and_takes_the_shortest_time() {
    each_seed(2000, |seed| {
        let mut random = Random(seed);
        let to = AxisVector(std::array::from_fn(|i| {
            if i < 4 { random.within(-1.0, 1.0) } else { 0.0 }
        }));
        let length = random.magnitude(0.01, 300.0);
        let to = to.scaled(length / to.orthogonal_length());
        let limits: [(f64, Option<f64>); 4] = std::array::from_fn(|_| {
            let acceleration = random.magnitude(50.0, 20_000.0);
            let jerk = acceleration * random.magnitude(2.0, 200.0);
            (acceleration, (random.unit() < 0.7).then_some(jerk))
        });
        if limits.iter().all(|(_, jerk)| jerk.is_none()) {
            return;
        }
        let machine = settings(std::array::from_fn(|i| {
            let (acceleration, jerk) = *limits.get(i)?;
            Some(motor(1e5, acceleration, jerk))
        }));
        let v = random.magnitude(5.0, 500.0);
        let is_programmed = random.unit() < 0.5;
        let times = if is_programmed {
            std::array::from_fn(|_| random.within(0.0, 200.0))
        } else {
            [0.0; 3]
        };
        let segments = lines(&[AxisVector::ZERO, to], feed(v * 60.0, times));
        let motion = Motion::new(&machine, &segments);
        let time = motion.time_s();
        let [mut a, mut j] = [f64::INFINITY; 2];
        for (axis, (acceleration, jerk)) in Axis::ALL.into_iter().zip(limits) {
            let most = motion.most(axis, [0.0, time]);
            let jerk = jerk.unwrap_or(f64::INFINITY);
            assert!(
                most[0] <= acceleration * (1.0 + 1e-6),
                "seed {seed}: {axis:?} {most:?}"
            );
            assert!(most[1] <= jerk * (1.0 + 1e-6), "seed {seed}: {axis:?} {most:?}");
            let share = to[axis].abs() / length;
            (a, j) = (a.min(acceleration / share), j.min(jerk / share));
        }
        let (_, best) = shortest_by_halving(length, v, a, Some(j));
        let period = if is_programmed { f64::INFINITY } else { PERIOD_S };
        assert!(
            time >= best * (1.0 - 1e-12) && time <= best * 1.002 + 2.0 * period,
            "seed {seed}: {time} {best}"
        );
        assert_eq!(motion.position(time), to);
    });
}

#[test]
fn m1d_chain_starts_and_ends_with_max_jerk_and_rounds_corners_like_g501() {
    let [corner, end] = [vector(&[100.0]), vector(&[100.0, 100.0])];
    let segments = lines(&[AxisVector::ZERO, corner, end], feed(6000.0, [20.0, 20.0, 10.0]));
    let motion = Motion::new(&xy(1000.0, 10_000.0), &segments);
    let time = motion.time_s();
    for (axis, span) in [(Axis::X, [0.0, 0.25]), (Axis::Y, [time - 0.25, time])] {
        let [acceleration, jerk] = motion.most(axis, span);
        assert!(
            (acceleration / 1000.0 - LEFT).abs() < 1e-5,
            "{axis:?}: {acceleration}"
        );
        assert!((jerk / 10_000.0 - 1.0).abs() < 1e-4, "{axis:?}: {jerk}");
    }
    let nearest = (0..=100_000)
        .map(|k| {
            let off = motion.position(time * f64::from(k) / 100_000.0).minus(corner);
            off.orthogonal_length()
        })
        .fold(f64::INFINITY, f64::min);
    // |dv| (ta/8 + ts^2/(24 ta)), M1b.
    let expected = 100.0 * 2.0_f64.sqrt() * (0.020 / 8.0 + 0.010 * 0.010 / (24.0 * 0.020));
    assert!(
        (nearest / expected - 1.0).abs() < 1e-4,
        "{nearest} is not {expected}"
    );
}

#[test]
fn m1d_line_slows_for_a_corner_between_its_ramps_with_max_jerk() {
    let [corner, end] = [vector(&[100.0]), vector(&[100.0, 100.0])];
    let segments = lines(&[AxisVector::ZERO, corner, end], feed(6000.0, [20.0, 20.0, 10.0]));
    let motion = Motion::new(&xy(1000.0, 10_000.0), &segments);
    // The corner's ramp begins v T/2 before the corner point.
    let low = motion.when_x_is(100.0 - 100.0 * 0.030 / 2.0);
    let [acceleration, jerk] = motion.most(Axis::X, [0.0, low]);
    assert!(acceleration <= 1000.0, "{acceleration}");
    assert!((jerk / 10_000.0 - 1.0).abs() < 1e-4, "{jerk}");
    // The motion slows down: the corner alone would need to change 100 mm/s within 0.02 s.
    let speed = (motion.position(low)[Axis::X] - motion.position(low - 1e-5)[Axis::X]) / 1e-5;
    assert!(speed < 60.0, "{speed}");
    // From the ramp at one end to the ramp at the other end, in both directions; both corners are equal.
    let back: Vec<AxisVector> = [end, corner, AxisVector::ZERO].into();
    let other = Motion::new(
        &xy(1000.0, 10_000.0),
        &lines(&back, feed(6000.0, [20.0, 20.0, 10.0])),
    );
    assert!((other.time_s() / motion.time_s() - 1.0).abs() < 1e-3);
}

#[test]
fn m1d_limiting_motor_keeps_acceleration_into_corner_without_jerk_time() {
    let [corner, end] = [vector(&[100.0]), vector(&[100.0, 100.0])];
    let segments = lines(&[AxisVector::ZERO, corner, end], feed(6000.0, [20.0, 20.0, 0.0]));
    let motion = Motion::new(&xy(1000.0, 10_000.0), &segments);
    let begin = motion.when_x_is(100.0 - 100.0 * 0.020 / 2.0);
    for span in [[begin - 0.01, begin], [begin, begin + 0.001]] {
        let [acceleration, _] = motion.most(Axis::X, span);
        assert!(
            (acceleration / 1000.0 - LEFT).abs() < 1e-3,
            "{span:?}: {acceleration}"
        );
    }
}

#[test]
fn m1d_line_too_short_for_jerk_between_corners_has_minimum_acceleration() {
    // 90 degrees, 4 mm of which 3 mm are ramps, and 45 degrees.
    let corners = [
        vector(&[100.0]),
        vector(&[100.0, 4.0]),
        vector(&[100.0 - 80.0, 4.0 + 80.0]),
    ];
    let points = [AxisVector::ZERO, corners[0], corners[1], corners[2]];
    let segments = lines(&points, feed(6000.0, [20.0, 20.0, 10.0]));
    let motion = Motion::new(&xy(1000.0, 10_000.0), &segments);
    // The jerk is w^3 |dv|/(ta ts), with |dv| of Y at the first corner and of X at the second corner.
    let [w1, w2] = [100.0, 100.0 * 0.5_f64.sqrt()].map(|turn| (10_000.0 * 0.020 * 0.010 / turn).cbrt());
    let length_s = (4.0 - 3.0) / 100.0;
    let expected = 100.0 * (w2 * w2 - w1 * w1) / (2.0 * length_s);
    let begins = motion.begins();
    let line = motion.0.iter().position(|profile| profile.segment == 2).unwrap();
    let span = [begins[line], begins[line] + length_s / w2];
    let [acceleration, jerk] = motion.most(Axis::Y, span);
    assert!(
        (acceleration / expected - 1.0).abs() < 1e-3,
        "{acceleration} is not {expected}"
    );
    assert!(jerk < 10.0, "{jerk}");
}

/// Returns the time and plan time in which a rate rises from w to its top. The acceleration rises and falls
/// with the maximum jerk.
pub fn rise(w: f64, top: f64, [acceleration, jerk]: [f64; 2]) -> [f64; 2] {
    if w >= top {
        return [0.0; 2];
    }
    let most = acceleration.min((jerk * (top - w)).sqrt());
    let time = (top - w) / most + most / jerk;
    [time, time * f64::midpoint(w, top)]
}

/// Lines long enough to change their speed within the jerk between their corners, and the times by the
/// formulas.
struct LongLines {
    machine: CoordinateSystemSettings,
    /// Maximum acceleration and jerk of each motor.
    limits: [[f64; 2]; 3],
    segments: Vec<Segment>,
    time_s: f64,
}

impl LongLines {
    fn random(random: &mut Random) -> Self {
        let v = random.magnitude(5.0, 500.0);
        let ta = random.within(0.005, 0.1);
        let ts = random.within(PERIOD_S, ta);
        let limits: [[f64; 2]; 3] = std::array::from_fn(|_| {
            let acceleration = random.magnitude(100.0, 20_000.0);
            [acceleration, acceleration * random.magnitude(5.0, 200.0)]
        });
        let machine = settings(std::array::from_fn(|i| {
            let [acceleration, jerk] = *limits.get(i)?;
            Some(motor(1e5, acceleration, Some(jerk)))
        }));
        let directions: Vec<AxisVector> = (0..2 + random.bits() % 4)
            .map(|_| {
                let to = AxisVector(std::array::from_fn(|i| {
                    if i < 3 { random.within(-1.0, 1.0) } else { 0.0 }
                }));
                to.scaled(1.0 / to.orthogonal_length())
            })
            .collect();
        let corners: Vec<f64> = directions
            .windows(2)
            .map(|pair| {
                let turn = pair[1].minus(pair[0]).scaled(v);
                limits.iter().zip(turn.0).fold(1.0_f64, |w, (limit, turn)| {
                    let by_acceleration = (limit[0] * LEFT * ta / turn.abs()).sqrt();
                    w.min(by_acceleration)
                        .min((limit[1] * ta * ts / turn.abs()).cbrt())
                })
            })
            .collect();
        let mut points = vec![AxisVector::ZERO];
        let mut time_s = corners.iter().map(|w| (ta + ts) / w).sum::<f64>();
        for (i, direction) in directions.iter().enumerate() {
            // Limits of the rate on this line.
            let own = [0, 1].map(|k| {
                let axes = limits.iter().zip(direction.0);
                axes.fold(f64::INFINITY, |least, (limit, share)| {
                    least.min(limit[k] * [LEFT, 1.0][k] / (share.abs() * v))
                })
            });
            let mut plan = random.within(0.001, 0.3);
            if i == 0 || i == corners.len() {
                // A ramp from rest takes at most the time that F takes for its line.
                plan += rest_ramp_s(own, [ta, ts]) / 2.0;
            }
            time_s += plan;
            for w in [i.checked_sub(1), Some(i)].map(|k| k.and_then(|k| corners.get(k))) {
                let [time, way] = match w {
                    Some(w) => {
                        let [time, way] = rise(*w, 1.0, own);
                        [time, way + f64::midpoint(ta, ts)]
                    }
                    None => [1.0, 0.5].map(|share| share * rest_ramp_s(own, [ta, ts])),
                };
                time_s += time;
                plan += way;
            }
            points.push(points[i].plus(direction.scaled(v * plan)));
        }
        let segments = lines(&points, feed(v * 60.0, [ta, ta, ts].map(|time| time * 1000.0)));
        Self {
            machine,
            limits,
            segments,
            time_s,
        }
    }
}

/// Returns the time of the ramp between rest and a rate of 1 within this acceleration and jerk of the rate,
/// at least the programmed time.
pub fn rest_ramp_s([acceleration, jerk]: [f64; 2], [ta, ts]: [f64; 2]) -> f64 {
    let long = ta.max(1.0 / acceleration);
    let bend = ts.max(1.0 / (jerk * long));
    if bend > long {
        2.0 / jerk.sqrt()
    } else {
        long + bend
    }
}

#[test]
fn m1d_long_lines_keep_corner_acceleration_and_jerk_and_formula_time() {
    each_seed(chains() / 10, |seed| {
        let long = LongLines::random(&mut Random(seed));
        let motion = Motion::new(&long.machine, &long.segments);
        let time = motion.time_s();
        assert!(
            (time / long.time_s - 1.0).abs() < 1e-6,
            "seed {seed}: {time} s, not {} s",
            long.time_s
        );
        for ends in motion.begins().windows(3) {
            let middles = [f64::midpoint(ends[0], ends[1]), f64::midpoint(ends[1], ends[2])];
            for (axis, [acceleration, jerk]) in Axis::ALL.into_iter().zip(long.limits) {
                let most = motion.most(axis, middles);
                let found = format!("seed {seed}: {axis:?} {most:?} at {middles:?}");
                assert!(most[0] <= acceleration * (1.0 + 1e-6), "{found}");
                assert!(most[1] <= jerk * (1.0 + 1e-4), "{found}");
            }
        }
    });
}

#[test]
fn m1d_random_chains_with_max_jerk_keep_motor_limits_and_jerk() {
    each_seed(chains() / 4, |seed| {
        let mut numbers = Random(5_000_000 + seed);
        let blocks = 2 + usize::try_from(numbers.bits() % 12).unwrap();
        let (accelerations, all) = random_blocks(&mut numbers, blocks);
        let jerks: Vec<Option<f64>> = accelerations
            .iter()
            .map(|a| (numbers.unit() < 0.7).then(|| a * numbers.magnitude(2.0, 2000.0)))
            .collect();
        let stiff = Chain::new(&accelerations, all.clone());
        let soft = Chain::soft(&accelerations, &jerks, all);
        let factor = numbers.within(0.5, 2.0).max(1.0);
        let profiles = soft.plan_for(factor);
        let found = check(&soft, &profiles, 6)
            .and_then(|()| same_path(&soft, &profiles))
            .and_then(|()| check_jerk(&soft, &profiles));
        if let Err(found) = found {
            panic!("seed {seed}, {blocks} blocks: {found}");
        }
        for profile in &profiles {
            let t = profile.duration_s * numbers.unit();
            let plan_s = pace(profile).plan_time(t);
            let back = pace(profile).when(plan_s).map_or(t, |(t, _)| t);
            // After a minute, plan time is exact to 1e-9 of its value.
            let digits = 1e-9 * profile.duration_s + 1e-12;
            let again = pace(profile).plan_time(back);
            assert!((again - plan_s).abs() <= digits, "seed {seed}: {t} {back}");
        }
        // Each rise or fall of the rate takes at most the additional time in which the acceleration rises and
        // falls; a corner is passed at a constant rate. Otherwise the time is within 2 percent and 3 servo
        // periods of the best time. On an arc a quarter of the acceleration remains for the rate, which
        // doubles the time, and the motion is slower by a tenth.
        let rise = accelerations.iter().zip(&jerks);
        let rise_s = rise.fold(0.0_f64, |most, (a, j)| most.max(j.map_or(0.0, |j| a / j)));
        let (slow, fast) = (time_s(&profiles), time_s(&stiff.plan_for(factor)));
        let least = (fast - 3.0 * PERIOD_S) / 1.02;
        let more = 3.0 * PERIOD_S + 2.0 * rise_s * (blocks + 1) as f64;
        let times = if soft.has_arcs() { 2.2 } else { 1.0 };
        let is_near = |best: f64| slow <= best * times * 1.02 + more;
        let is_near_best = || [100, 1000].into_iter().any(|n| is_near(best_time_s(&soft, n)));
        assert!(
            slow >= least && (is_near(fast) || is_near_best()),
            "seed {seed}: {slow} {fast}"
        );
    });
}

#[test]
fn m1d_ramp_from_rest_without_room_for_jerk_fills_its_line_at_one_rate() {
    // 11 mm take 0.11 s; 1000 mm/s^2 and 2000 mm/s^3 would take 0.45 s. In 0.055 s twice it is 100/0.055^2 mm/s^3.
    let segments = lines(
        &[AxisVector::ZERO, vector(&[11.0]), vector(&[11.0, 200.0])],
        feed(6000.0, [50.0, 50.0, 0.0]),
    );
    let motion = Motion::new(&xy(1000.0, 2000.0), &segments);
    let rate = (2000.0 * 0.055 * 0.055 / 100.0_f64).cbrt();
    for k in 1..=100 {
        let t = 0.11 / rate * f64::from(k) / 100.0;
        let x = motion.position(t)[Axis::X];
        let expected = 100.0 * integral_of_ramp(rate * t, 0.055, 0.055);
        assert!((x - expected).abs() < 1e-6, "{t}: {x} is not {expected}");
    }
}

#[test]
fn m1d_ramps_between_blocks_are_as_programmed_with_extend_and_with_g501() {
    let points = [AxisVector::ZERO, vector(&[2.0]), vector(&[4.0])];
    let times = [20.0, 20.0, 10.0];
    let machine = |rule, jerk| {
        let mut machine = xy(1e6, 1e9);
        machine.motion.short_block = rule;
        for motor in machine.motors.iter_mut().flatten() {
            motor.max_jerk = jerk;
        }
        machine
    };
    let extend = lines(&points, feed(6000.0, times));
    let [soft, stiff] = [Some(1e4), None].map(|jerk| {
        let motion = Motion::new(&machine(ShortBlock::Extend, jerk), &extend);
        let ramps = motion.0.iter().map(|profile| match &profile.law {
            Law::Paced { block, .. } => block.as_ramped().map(|block| [block.start, block.stop]).unwrap(),
            other => panic!("not paced: {other:?}"),
        });
        let mut ramps: Vec<_> = ramps.collect();
        ramps.dedup();
        ramps
    });
    assert_eq!(soft, stiff);
    let g501: Vec<Segment> = lines(&points[..2], feed(6000.0, times))
        .into_iter()
        .map(|segment| Segment {
            multi_block: MultiBlock::Off,
            ..segment
        })
        .collect();
    let motion = Motion::new(&machine(ShortBlock::Shrink, Some(1e4)), &g501);
    // 2 mm of the 3 mm that both ramps need at 100 mm/s.
    close(motion.time_s(), 0.060);
}

#[test]
fn m1d_max_jerk_not_above_zero_is_an_alarm_for_a_moving_motor() {
    for jerk in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let segments = lines(&[AxisVector::ZERO, vector(&[2.0])], feed(600.0, [20.0; 3]));
        let text = refused(&xy(1000.0, jerk), &segments[0], &LIMIT_ZERO);
        assert!(text.contains("max_jerk of axis X"), "{text}");
        let end = vector(&[4.0]);
        let circle = ArcPath::new(AxisVector::ZERO, end, Plane::Xy, [2.0, 0.0], Turn::Clockwise);
        let motion = SegmentMotion::Feed {
            path: Path::Arc(circle),
            feed: feed(600.0, [20.0; 3]),
        };
        let arc = Segment {
            multi_block: MultiBlock::On,
            ..segment(motion)
        };
        let text = refused(&xy(1000.0, jerk), &arc, &LIMIT_ZERO);
        assert!(text.contains("max_jerk of axis X"), "{text}");
    }
    let segments = lines(&[AxisVector::ZERO, vector(&[2.0])], feed(600.0, [20.0; 3]));
    let mut machine = xy(1000.0, 1000.0);
    for motor in machine.motors.iter_mut().skip(1).flatten() {
        motor.max_jerk = Some(0.0);
    }
    assert_eq!(Motion::new(&machine, &segments).position(9.0), vector(&[2.0]));
}
