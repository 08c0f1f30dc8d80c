//! Single blocks: the planner against formulas that are implemented a second time, in another form.

use std::collections::VecDeque;
use std::f64::consts::{PI, TAU};

use proptest::prelude::*;
use tandem_model::alarm::{LIMIT_ZERO, VALUE_NOT_FINITE, VALUE_OUT_OF_RANGE};
use tandem_model::flow::{Path, SegmentMotion};
use tandem_model::plane::{Plane, Turn};
use tandem_model::profile::{Law, Stretch, TimeBase};
use tandem_model::settings::MotorSettings;
use tandem_model::{AXES_MAX, ArcPath, Axis, AxisVector};
use tandem_motion::Planner;

use crate::rig::{
    PERIOD_S, close, fast, feed, integral_of_ramp, line, motor, plan, refused, segment, settings,
    shortest_by_halving, vector,
};

/// Returns the time of the whole block and the distance after `t`, by M1a.
fn ramped_distance(length: f64, v: f64, [ta, td, ts]: [f64; 3], t: f64) -> (f64, f64) {
    let (ta, td) = (ta.max(ts), td.max(ts));
    let (ramp_a, ramp_d) = (ta + ts, td + ts);
    let half = f64::midpoint(ramp_a, ramp_d);
    let (v, t_end) = if length / v >= half {
        (v, length / v + half)
    } else {
        (length / half, 2.0 * half)
    };
    let stopped = integral_of_ramp(t - (t_end - ramp_d), td, ts);
    (t_end, v * (integral_of_ramp(t, ta, ts) - stopped))
}

#[test]
fn s1a_a_block_takes_its_length_over_f_and_half_a_ramp_at_each_end() {
    // 100 mm at F6000: 1 s; ta + ts = 150 ms, td + ts = 250 ms: 1 + 0.4/2
    let block = line(
        AxisVector::ZERO,
        vector(&[60.0, 80.0]),
        feed(6000.0, [100.0, 200.0, 50.0]),
    );
    let profile = plan(&fast(), &block);
    close(profile.duration_s, 1.2);
    assert_eq!(profile.law.time_base(), TimeBase::Feed);
    assert!(profile.exact_stop);
    // Half a ramp of full speed after the ramp, then v t: 100 (0.5 - 0.075)
    close(profile.position(0.5)[Axis::X], 0.6 * 42.5);
    assert_eq!(profile.position(0.0), AxisVector::ZERO);
    assert_eq!(profile.position(1.2), vector(&[60.0, 80.0]));
}

#[test]
fn s1a_a_block_too_short_for_f_keeps_its_ramps_and_lowers_its_peak() {
    // 3 mm are shorter than half the ramps, 0.15 s at 100 mm/s = 15 mm: v_peak = 2 * 3 / 0.3 = 20 mm/s, t =
    // 0.3 s
    let block = line(
        AxisVector::ZERO,
        vector(&[3.0]),
        feed(6000.0, [100.0, 100.0, 50.0]),
    );
    let profile = plan(&fast(), &block);
    close(profile.duration_s, 0.3);
    close(profile.position(0.15)[Axis::X], 1.5);
    match profile.law {
        Law::Ramped { block, .. } => close(block.speed, 20.0),
        other => panic!("not ramped: {other:?}"),
    }
    // At the limit between the two rules both give the same result.
    let block = line(
        AxisVector::ZERO,
        vector(&[15.0]),
        feed(6000.0, [100.0, 100.0, 50.0]),
    );
    close(plan(&fast(), &block).duration_s, 0.3);
}

#[test]
fn s1a_acceleration_times_below_ts_are_raised_to_it() {
    let block = line(
        AxisVector::ZERO,
        vector(&[100.0]),
        feed(6000.0, [10.0, 0.0, 50.0]),
    );
    close(plan(&fast(), &block).duration_s, 1.1);
}

#[test]
fn s1a_an_acceleration_time_of_zero_counts_as_one_servo_period() {
    let block = line(AxisVector::ZERO, vector(&[100.0]), feed(6000.0, [0.0, 0.0, 0.0]));
    close(plan(&fast(), &block).duration_s, 1.0 + PERIOD_S);
}

#[test]
fn s1a_f_is_clipped_by_the_maximum_feedrate() {
    let mut settings = fast();
    settings.max_feedrate_mm_min = 3000.0;
    let block = line(
        AxisVector::ZERO,
        vector(&[100.0]),
        feed(6000.0, [100.0, 100.0, 0.0]),
    );
    close(plan(&settings, &block).duration_s, 2.1);
}

#[test]
fn s1a_whole_block_slows_so_that_no_motor_exceeds_its_maximum_velocity() {
    // X and Y 30 and 40 mm, C 90 degrees, F3000 = 50 mm/s: 1 s, C at 90 deg/s; its maximum is 45 deg/s: 2 s.
    let mut motors: [Option<MotorSettings>; AXES_MAX] = std::array::from_fn(|_| Some(motor(1e3, 1e4, None)));
    motors[Axis::C.index()] = Some(motor(45.0, 1e3, None));
    let to = vector(&[30.0, 40.0, 0.0, 0.0, 0.0, 90.0]);
    let profile = plan(
        &settings(motors),
        &line(AxisVector::ZERO, to, feed(3000.0, [100.0, 100.0, 0.0])),
    );
    close(profile.duration_s, 2.1);
    let middle = profile.position(1.05);
    close(middle[Axis::X], 15.0);
    close(middle[Axis::C], 45.0);
}

#[test]
fn s1f_an_arc_moves_along_its_length_as_a_line_does() {
    // A full circle of radius 30 in Z 4 at F3000: ramps of 0.15 s.
    let to = vector(&[0.0, 0.0, 4.0]);
    let arc = ArcPath::new(AxisVector::ZERO, to, Plane::Xy, [30.0, 0.0], Turn::Clockwise);
    let motion = SegmentMotion::Feed {
        path: Path::Arc(arc),
        feed: feed(3000.0, [100.0, 100.0, 50.0]),
    };
    let profile = plan(&fast(), &segment(motion));
    let length = (TAU * 30.0).hypot(4.0);
    close(profile.duration_s, length / 50.0 + 0.15);
    for k in 0..=100 {
        let t = profile.duration_s * f64::from(k) / 100.0;
        let (_, distance) = ramped_distance(length, 50.0, [0.1, 0.1, 0.05], t);
        let angle = PI - TAU * distance / length;
        let position = profile.position(t);
        close(position[Axis::X], 30.0 + 30.0 * angle.cos());
        close(position[Axis::Y], 30.0 * angle.sin());
        close(position[Axis::Z], 4.0 * distance / length);
    }
}

#[test]
fn s1f_an_arc_slows_so_that_no_motor_exceeds_its_maximum_velocity_on_it() {
    let slow_y = |limit| {
        let mut motors: [Option<MotorSettings>; AXES_MAX] =
            std::array::from_fn(|_| Some(motor(1e3, 1e4, None)));
        motors[Axis::Y.index()] = Some(motor(limit, 1e4, None));
        settings(motors)
    };
    let turn = |to: [f64; 2]| {
        let path = Path::Arc(ArcPath::new(
            vector(&[10.0, 0.0]),
            vector(&to),
            Plane::Xy,
            [0.0, 0.0],
            Turn::CounterClockwise,
        ));
        let feed = feed(3000.0, [100.0, 100.0, 0.0]);
        segment(SegmentMotion::Feed { path, feed })
    };
    // At (10, 0) only Y moves, so its 20 mm/s limit the whole quarter circle.
    let quarter = plan(&slow_y(20.0), &turn([0.0, 10.0]));
    close(quarter.duration_s, 10.0 * PI / 2.0 / 20.0 + 0.1);
    // From 60 to 90 degrees: |cos| is at most 1/2, so 40 mm/s are within 20 mm/s for Y.
    let path = Path::Arc(ArcPath::new(
        vector(&[5.0, 75.0_f64.sqrt()]),
        vector(&[0.0, 10.0]),
        Plane::Xy,
        [0.0, 0.0],
        Turn::CounterClockwise,
    ));
    let feed = feed(3000.0, [100.0, 100.0, 0.0]);
    let upper = plan(&slow_y(20.0), &segment(SegmentMotion::Feed { path, feed }));
    close(upper.duration_s, 10.0 * PI / 6.0 / 40.0 + 0.1);
}

#[test]
fn s1f_a_cone_slows_to_where_a_motor_is_fastest_on_it_and_no_further() {
    // from (10, 0, 0) to (6, 6, 20) about (0, 0): radius 10 to sqrt(72) over 45 degrees
    let (sweep, growth) = (PI / 4.0, 72.0_f64.sqrt() - 10.0);
    let rates = |u: f64| {
        let (sin, cos) = (sweep * u).sin_cos();
        let turn = sweep * (10.0 + growth * u);
        let x = growth * cos - turn * sin;
        (x.abs(), x.hypot(growth * sin + turn * cos).hypot(20.0))
    };
    let n = 200_000;
    let places = || (0..n).map(|i| (f64::from(i) + 0.5) / f64::from(n));
    let length = places().map(|u| rates(u).1).sum::<f64>() / f64::from(n);
    let steepest = places()
        .map(|u| rates(u).0 / rates(u).1)
        .fold(rates(1.0).0 / rates(1.0).1, f64::max);
    let speed = 20.0 / steepest;
    assert!((speed - 73.1).abs() < 0.05, "{speed} mm/s");
    let mut motors: [Option<MotorSettings>; AXES_MAX] = std::array::from_fn(|_| Some(motor(1e3, 1e4, None)));
    motors[Axis::X.index()] = Some(motor(20.0, 1e4, None));
    let path = Path::Arc(ArcPath::new(
        vector(&[10.0]),
        vector(&[6.0, 6.0, 20.0]),
        Plane::Xy,
        [0.0, 0.0],
        Turn::CounterClockwise,
    ));
    let feed = feed(6000.0, [20.0, 20.0, 0.0]);
    let profile = plan(&settings(motors), &segment(SegmentMotion::Feed { path, feed }));
    close(profile.duration_s, length / speed + 0.02);
}

#[test]
fn s1e_g00_moves_each_motor_alone_and_ends_with_the_slowest() {
    let mut motors: [Option<MotorSettings>; AXES_MAX] = Default::default();
    motors[0] = Some(motor(100.0, 1000.0, None));
    motors[1] = Some(motor(50.0, 1000.0, None));
    motors[2] = Some(motor(100.0, 1000.0, None));
    let to = vector(&[-40.0, 30.0, 2.5]);
    let motion = SegmentMotion::Rapid {
        from: AxisVector::ZERO,
        to,
    };
    let profile = plan(&settings(motors), &segment(motion));
    // X: 40/100 + 0.1 = 0.5; Y: 30/50 + 0.05 = 0.65; Z: 2.5 < v^2/a = 10: 2 sqrt(2.5/1000) = 0.1
    close(profile.duration_s, 0.65);
    assert_eq!(profile.law.time_base(), TimeBase::Rapid);
    close(profile.position(0.05)[Axis::Z], 1.25);
    close(profile.position(0.1)[Axis::Z], 2.5);
    close(profile.position(0.25)[Axis::X], -20.0);
    close(profile.position(0.25)[Axis::Y], 50.0 * (0.25 - 0.025));
    assert_eq!(profile.position(0.5)[Axis::X].to_bits(), (-40.0_f64).to_bits());
    assert_eq!(profile.position(0.65), to);
}

#[test]
fn s1e_g31_moves_as_g00_at_the_skip_velocities() {
    // Skip velocity is a tenth of 100: 40 mm at 10 mm/s, a 1000: 4.01 s
    let motors = std::array::from_fn(|_| Some(motor(100.0, 1000.0, None)));
    let (from, to) = (AxisVector::ZERO, vector(&[40.0, -5.0]));
    let profile = plan(&settings(motors), &segment(SegmentMotion::Skip { from, to }));
    close(profile.duration_s, 4.01);
    // Y takes 5/10 + 0.01 s; 5 ms before its end 1000 t^2/2 are left.
    close(profile.position(0.505)[Axis::Y], -5.0 + 500.0 * 0.005 * 0.005);
    assert!(matches!(profile.law, Law::Skip { .. }));
    assert_eq!(profile.law.time_base(), TimeBase::Rapid);
    let mut slow = fast();
    slow.motors[1].as_mut().unwrap().skip_velocity = 0.0;
    let text = refused(&slow, &segment(SegmentMotion::Skip { from, to }), &LIMIT_ZERO);
    assert!(text.contains("skip_velocity") && text.contains('Y'), "{text}");
}

#[test]
fn s1e_with_a_jerk_limit_a_rapid_has_seven_phases() {
    // v 100, a 1000, j 20000: jerk phases 0.05 s, ramps 0.15 s over 15 mm; 20 mm: 20/100 + 0.15
    // The plan leaves 3 percent of the acceleration and 5 percent of the jerk.
    let motors = std::array::from_fn(|_| Some(motor(100.0, 1000.0 / 0.97, Some(20_000.0 / 0.95))));
    let rapid = |distance: f64| {
        let to = vector(&[distance]);
        let from = AxisVector::ZERO;
        plan(
            &settings(motors.clone()),
            &segment(SegmentMotion::Rapid { from, to }),
        )
    };
    close(rapid(20.0).duration_s, 0.35);
    close(
        rapid(20.0).position(0.05)[Axis::X],
        20_000.0 * 0.05_f64.powi(3) / 6.0,
    );
    close(rapid(20.0).position(0.15)[Axis::X], 7.5);
    // 5.625 mm reaches a but not v: a/j + sqrt((a/j)^2 + 4 D/a) = 0.05 + 0.15
    close(rapid(5.625).duration_s, 0.05 + 0.025_f64.sqrt());
    // 2 a^3/j^2 = 5 mm: shorter moves never reach a: 4 cbrt(D/(2 j))
    close(rapid(1.35).duration_s, 4.0 * (1.35_f64 / 40_000.0).cbrt());
}

#[test]
fn g04_rests_as_long_as_programmed_and_no_override_scales_it() {
    let at = vector(&[1.0, 2.0]);
    let profile = plan(&fast(), &segment(SegmentMotion::Dwell { at, dwell_s: 0.75 }));
    close(profile.duration_s, 0.75);
    assert_eq!(profile.law.time_base(), TimeBase::Fixed);
    let stretch = Stretch::whole(0.75);
    assert_eq!(profile.law, Law::Rest { at, stretch });
}

#[test]
fn segment_numbers_go_on_over_a_restart_and_profiles_carry_its_epoch() {
    let mut planner = Planner::new(&fast());
    let mut out = VecDeque::new();
    let dwell = segment(SegmentMotion::Dwell {
        at: AxisVector::ZERO,
        dwell_s: 1.0,
    });
    planner.push(&dwell, &mut out).unwrap();
    planner.push(&dwell, &mut out).unwrap();
    planner.restart(4);
    planner.push(&dwell, &mut out).unwrap();
    let numbers: Vec<_> = out
        .iter()
        .map(|profile| (profile.segment, profile.epoch))
        .collect();
    assert_eq!(numbers, [(1, 0), (2, 0), (3, 4)]);
    assert_eq!(planner.last_segment(), 3);
    assert_eq!(out[2].origin, dwell.origin);
}

#[test]
fn a_limit_that_is_not_above_zero_is_an_alarm_for_a_motor_that_moves() {
    let with = |motor: Option<MotorSettings>| {
        let mut motors: [Option<MotorSettings>; AXES_MAX] =
            std::array::from_fn(|_| Some(self::motor(1.0, 1.0, None)));
        motors[1] = motor;
        settings(motors)
    };
    let y = vector(&[0.0, 5.0]);
    let cut = line(AxisVector::ZERO, y, feed(600.0, [100.0, 100.0, 50.0]));
    let rapid = segment(SegmentMotion::Rapid {
        from: AxisVector::ZERO,
        to: y,
    });
    for limit in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let text = refused(&with(Some(motor(limit, 1.0, None))), &cut, &LIMIT_ZERO);
        assert!(text.contains('Y'), "{text}");
        refused(&with(Some(motor(limit, 1.0, None))), &rapid, &LIMIT_ZERO);
        refused(&with(Some(motor(1.0, limit, None))), &rapid, &LIMIT_ZERO);
        refused(&with(Some(motor(1.0, 1.0, Some(limit)))), &rapid, &LIMIT_ZERO);
    }
    refused(&with(None), &cut, &LIMIT_ZERO);
    refused(&with(None), &rapid, &LIMIT_ZERO);
    // X moves alone, so the limit of Y has no effect.
    plan(
        &with(None),
        &line(AxisVector::ZERO, vector(&[5.0]), feed(600.0, [1.0; 3])),
    );
}

#[test]
fn what_cannot_be_planned_is_an_alarm() {
    let to = vector(&[10.0]);
    let cut = |feed| line(AxisVector::ZERO, to, feed);
    for value in [f64::NAN, f64::INFINITY] {
        refused(&fast(), &cut(feed(value, [1.0; 3])), &VALUE_NOT_FINITE);
        for i in 0..3 {
            let mut times = [1.0; 3];
            times[i] = value;
            refused(&fast(), &cut(feed(600.0, times)), &VALUE_NOT_FINITE);
            times[i] = -1.0;
            refused(&fast(), &cut(feed(600.0, times)), &VALUE_OUT_OF_RANGE);
        }
        let to = vector(&[value]);
        refused(
            &fast(),
            &line(AxisVector::ZERO, to, feed(600.0, [1.0; 3])),
            &VALUE_NOT_FINITE,
        );
        let from = AxisVector::ZERO;
        refused(
            &fast(),
            &segment(SegmentMotion::Rapid { from, to }),
            &VALUE_NOT_FINITE,
        );
        let dwell = SegmentMotion::Dwell {
            at: from,
            dwell_s: value,
        };
        refused(&fast(), &segment(dwell), &VALUE_NOT_FINITE);
    }
    refused(&fast(), &cut(feed(0.0, [1.0; 3])), &VALUE_OUT_OF_RANGE);
    refused(&fast(), &cut(feed(-5.0, [1.0; 3])), &VALUE_OUT_OF_RANGE);
    // More than 1e9 s, up to values beyond the range of a number.
    refused(&fast(), &cut(feed(1e-7, [1.0; 3])), &VALUE_OUT_OF_RANGE);
    refused(
        &fast(),
        &cut(feed(f64::MIN_POSITIVE, [1.0; 3])),
        &VALUE_NOT_FINITE,
    );
}

/// Coordinates in the range of real machines, including zero and signs.
fn coordinates() -> impl Strategy<Value = [f64; AXES_MAX]> {
    prop::array::uniform8(prop_oneof![3 => -500.0..500.0, 1 => Just(0.0), 1 => -0.05..0.05])
}

fn ramp_times() -> impl Strategy<Value = [f64; 3]> {
    let ts = prop_oneof![Just(0.0), 1.0..300.0];
    (1.0..500.0, 1.0..500.0, ts).prop_map(|(ta, td, ts)| [ta, td, ts])
}

proptest! {
    #[test]
    fn s1a_positions_are_those_of_the_formula(
        from in coordinates(),
        to in coordinates(),
        feedrate in 1.0..60_000.0,
        times in ramp_times(),
    ) {
        let (from, to) = (AxisVector(from), AxisVector(to));
        let way = to.minus(from);
        prop_assume!(way.orthogonal_length() > 1e-3);
        let profile = plan(&fast(), &line(from, to, feed(feedrate, times)));
        let seconds = times.map(|time| time / 1000.0);
        let fastest = way.0.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
        let v = (feedrate / 60.0).min(1e5 * way.orthogonal_length() / fastest);
        let length = way.orthogonal_length();
        let (t_end, _) = ramped_distance(length, v, seconds, 0.0);
        prop_assert!((profile.duration_s - t_end).abs() <= 1e-9 * t_end.max(1.0));
        for k in 0..=64 {
            let t = t_end * f64::from(k) / 64.0;
            let (_, distance) = ramped_distance(length, v, seconds, t);
            let expected = from.plus(way.scaled(distance / length));
            for axis in Axis::ALL {
                let error = (profile.position(t)[axis] - expected[axis]).abs();
                prop_assert!(error < 1e-9 * way[axis].abs().max(1.0), "{axis:?} at {t}: {error}");
            }
        }
        prop_assert_eq!(profile.position(0.0), from);
        prop_assert_eq!(profile.position(profile.duration_s), to);
    }

    #[test]
    fn s1a_no_motor_exceeds_its_maximum_velocity_and_the_speed_has_no_step(
        to in coordinates(),
        feedrate in 1.0..60_000.0,
        times in ramp_times(),
        limits in prop::array::uniform8(1.0..300.0),
    ) {
        let to = AxisVector(to);
        prop_assume!(to.orthogonal_length() > 1e-3);
        let settings = settings(std::array::from_fn(|i| Some(motor(limits[i], 1e4, None))));
        let profile = plan(&settings, &line(AxisVector::ZERO, to, feed(feedrate, times)));
        let step_s = profile.duration_s / 500.0;
        let ramp_s = times[0].min(times[1]).max(times[2]) / 1000.0;
        let mut velocity = AxisVector::ZERO;
        for k in 0..500 {
            let at = |n: i32| profile.position(step_s * f64::from(n));
            let next = at(k + 1).minus(at(k)).scaled(1.0 / step_s);
            for axis in Axis::ALL {
                let limit = limits[axis.index()];
                prop_assert!(next[axis].abs() <= limit * (1.0 + 1e-9) + 1e-7);
                // From rest to at most the limit within a ramp: the acceleration is at most limit/ta at each
                // end.
                let change = (next[axis] - velocity[axis]).abs();
                prop_assert!(change <= 2.0 * limit * step_s / ramp_s * (1.0 + 1e-6) + 1e-7);
            }
            velocity = next;
        }
    }

    #[test]
    fn s1e_a_rapid_takes_the_shortest_time_and_keeps_every_limit(
        from in -500.0..500.0,
        distance in prop_oneof![-800.0..800.0, -0.5..0.5, -1e-4..1e-4],
        velocity in 1.0..1000.0,
        acceleration in 10.0..20_000.0,
        jerk in prop::option::of(100.0..1e6),
    ) {
        prop_assume!(f64::abs(distance) > 1e-6);
        let limits = motor(velocity, acceleration, jerk);
        let settings = settings(std::array::from_fn(|i| (i == 0).then(|| limits.clone())));
        let (from, to) = (vector(&[from]), vector(&[from + distance]));
        let way = (to.0[0] - from.0[0]).abs();
        let profile = plan(&settings, &segment(SegmentMotion::Rapid { from, to }));
        let planned = if jerk.is_some() { 0.97 * acceleration } else { acceleration };
        let (peak, expected_s) = shortest_by_halving(way, velocity, planned, jerk.map(|jerk| 0.95 * jerk));
        prop_assert!((profile.duration_s - expected_s).abs() < 1e-9 * expected_s.max(1.0));
        prop_assert_eq!(profile.position(0.0), from);
        prop_assert_eq!(profile.position(profile.duration_s), to);

        let steps = 400;
        let step_s = profile.duration_s / f64::from(steps);
        let at = |n: i32| (profile.position(step_s * f64::from(n)).0[0] - from.0[0]) * f64::signum(distance);
        // Rounding of a position of up to 1300, in a first, second and third difference.
        let noise = |order: i32| 4e-12 / step_s.powi(order);
        for k in 0..steps {
            let v = (at(k + 1) - at(k)) / step_s;
            prop_assert!(v >= -noise(1) && v <= peak * (1.0 + 1e-9) + noise(1));
            let a = (at(k + 1) - 2.0 * at(k) + at(k - 1)) / (step_s * step_s);
            prop_assert!(a.abs() <= acceleration * (1.0 + 1e-6) + noise(2));
            if let Some(jerk) = jerk {
                let j = (at(k + 2) - 3.0 * at(k + 1) + 3.0 * at(k) - at(k - 1)) / step_s.powi(3);
                prop_assert!(j.abs() <= jerk * (1.0 + 1e-6) + noise(3));
            }
        }
    }

    #[test]
    fn any_numbers_give_a_finite_profile_or_an_alarm(
        numbers in prop::array::uniform16(any::<f64>()),
        limits in prop::array::uniform4(any::<f64>()),
        jerk in prop::option::of(any::<f64>()),
    ) {
        let limits = motor(limits[0], limits[1], jerk);
        let settings = settings(std::array::from_fn(|_| Some(limits.clone())));
        let from = vector(&numbers[..3]);
        let to = vector(&numbers[3..6]);
        let segments = [
            line(from, to, feed(numbers[6], [numbers[7], numbers[8], numbers[9]])),
            segment(SegmentMotion::Rapid { from, to }),
            segment(SegmentMotion::Dwell { at: AxisVector::ZERO, dwell_s: numbers[10] }),
        ];
        for segment in segments {
            let mut out = VecDeque::new();
            if Planner::new(&settings).push(&segment, &mut out).is_ok() {
                let profile = out.pop_front().unwrap();
                for share in [0.0, 0.1, 0.5, 0.9, 1.0] {
                    prop_assert!(profile.position(profile.duration_s * share).is_finite(), "{profile:?}");
                }
            }
        }
    }
}
