//! Threads: Z as a block from stop to stop, the spindle in proportion to it, within the limits of both (M1h).

use tandem_model::alarm::{LIMIT_ZERO, VALUE_NOT_FINITE};
use tandem_model::flow::{Segment, SegmentMotion, TapLeg};
use tandem_model::profile::{Law, TimeBase};
use tandem_model::settings::{CoordinateSystemSettings, MotorKind, MotorSettings};

use crate::rig::{close, fast, feed, integral_of_ramp, motor, plan, refused, segment, vector};

/// Returns settings with a spindle of this maximum speed (r/min) and acceleration (r/min per second).
fn with_spindle(velocity: f64, acceleration: f64) -> CoordinateSystemSettings {
    CoordinateSystemSettings {
        spindle: Some(MotorSettings {
            kind: MotorKind::Spindle,
            ..motor(velocity, acceleration, None)
        }),
        ..fast()
    }
}

/// Creates a thread from Z-5 down by this length, at F100 with ta 100, td 80, ts 50 ms.
fn thread(length: f64, revolutions: f64) -> Segment {
    segment(SegmentMotion::Tap {
        from: vector(&[1.0, 2.0, -5.0]),
        to: vector(&[1.0, 2.0, -5.0 - length]),
        feed: feed(100.0, [100.0, 80.0, 50.0]),
        revolutions,
        leg: TapLeg::In,
    })
}

#[test]
fn m1h_z_and_spindle_follow_one_formula_at_every_instant() {
    // 5 mm at 5/3 mm/s: 3 s and half of both ramps.
    let profile = plan(&with_spindle(3000.0, 1e6), &thread(5.0, 15.0));
    let (v, ta, td, ts) = (100.0 / 60.0, 0.1, 0.08, 0.05);
    let end_s = 5.0 / v + f64::midpoint(ta + ts, td + ts);
    close(profile.duration_s, end_s);
    assert_eq!(profile.law.time_base(), TimeBase::Fixed);
    assert!(profile.exact_stop);
    for k in 0..=3200 {
        let t = f64::from(k) * 0.001;
        let way = if t >= end_s {
            5.0
        } else {
            v * (integral_of_ramp(t, ta, ts) - integral_of_ramp(t - (end_s - td - ts), td, ts))
        };
        let z = profile.position(t).0[2];
        close(z, -5.0 - way);
        let turned = profile.spindle_revolutions(t).unwrap();
        close(turned, way * 3.0);
        // The spindle is in step within 1e-9 of a revolution: S / F is 3 revolutions per millimetre.
        assert!((turned + (z + 5.0) * 3.0).abs() < 1e-9);
        assert!(profile.position(t).0[0].to_bits() == 1.0_f64.to_bits());
    }
    assert_eq!(profile.spindle_revolutions(end_s), Some(15.0));
    assert_eq!(profile.position(end_s), vector(&[1.0, 2.0, -10.0]));
}

#[test]
fn m1h_z_slows_down_to_the_spindles_maximum_speed() {
    // 3 revolutions per millimetre: 60 r/min are 1/3 mm/s.
    let profile = plan(&with_spindle(60.0, 1e6), &thread(5.0, -15.0));
    close(profile.duration_s, 15.0 + f64::midpoint(0.15, 0.13));
    let per_s = |t: f64| {
        (profile.spindle_revolutions(t + 0.5).unwrap() - profile.spindle_revolutions(t).unwrap()) * 2.0
    };
    close(per_s(5.0), -1.0);
}

#[test]
fn m1h_the_ramps_are_as_long_as_the_spindle_needs() {
    // 300 r/min at 1000 r/min per second: 0.3 s instead of ta 0.1 and td 0.08; ts stays.
    let profile = plan(&with_spindle(3000.0, 1000.0), &thread(5.0, 15.0));
    close(profile.duration_s, 3.0 + f64::midpoint(0.35, 0.35));
    let h = 1e-4;
    let turned = |t: f64| profile.spindle_revolutions(t).unwrap() * 60.0;
    let mut steepest = 0.0_f64;
    let mut t = h;
    while t < profile.duration_s - h {
        let acceleration = (turned(t + h) - 2.0 * turned(t) + turned(t - h)) / (h * h);
        steepest = steepest.max(acceleration.abs());
        t += 1e-3;
    }
    assert!((steepest - 1000.0).abs() < 0.1, "{steepest} r/min per second");
}

#[test]
fn m1h_a_thread_too_short_for_its_speed_keeps_its_ramps_and_its_pitch() {
    // The length is below half of both ramps at full speed, so the peak falls (M1a, extend).
    let profile = plan(&with_spindle(3000.0, 1e6), &thread(0.1, 0.3));
    close(profile.duration_s, 0.15 + 0.13);
    for k in 0..=280 {
        let t = f64::from(k) * 0.001;
        close(
            profile.spindle_revolutions(t).unwrap(),
            -(profile.position(t).0[2] + 5.0) * 3.0,
        );
    }
}

#[test]
fn m1h_without_a_locked_spindle_only_z_counts() {
    let profile = plan(&fast(), &thread(5.0, 0.0));
    close(profile.duration_s, 3.0 + f64::midpoint(0.15, 0.13));
    assert_eq!(profile.spindle_revolutions(1.0), None);
    assert!(matches!(profile.law, Law::Tap { leg: TapLeg::In, .. }));
}

#[test]
fn a_locked_spindle_needs_limits_above_zero() {
    for settings in [with_spindle(0.0, 1.0), with_spindle(1.0, 0.0), fast()] {
        refused(&settings, &thread(5.0, 15.0), &LIMIT_ZERO);
    }
    refused(&with_spindle(1.0, 1.0), &thread(5.0, f64::NAN), &VALUE_NOT_FINITE);
    refused(
        &with_spindle(1.0, 1.0),
        &thread(f64::INFINITY, 1.0),
        &VALUE_NOT_FINITE,
    );
}
