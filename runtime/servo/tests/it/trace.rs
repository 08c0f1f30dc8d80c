//! The trace of a motion, compared with the formula of a trapezoid: 100 mm/s, reached in 0.1 s, so 1000 mm/s².

use tandem_servo::{Event, TraceSample};

use crate::rig::{Rig, T, close, is_finished, rapid, settings};

const SPEED: f64 = 100.0;
const RAMP_S: f64 = 0.1;
const ACCELERATION: f64 = SPEED / RAMP_S;

/// Runs 50 mm: 0.1 s acceleration, 0.4 s at speed, 0.1 s deceleration. Returns the samples with their times
/// since the start.
fn traced(rig: &mut Rig) -> Vec<(f64, TraceSample)> {
    rig.push(rapid(1, 0.0, 50.0));
    let mut begun_s = None;
    while begun_s.is_none() {
        begun_s = rig.cycle().iter().find_map(|event| match event {
            Event::Started { time_s, .. } => Some(*time_s),
            _ => None,
        });
    }
    rig.until(is_finished(1));
    let (_, samples) = rig.handle.trace.read(0, usize::MAX);
    let since = |sample: TraceSample| (sample.time_s - begun_s.unwrap_or_default(), sample);
    samples.into_iter().map(since).collect()
}

#[test]
fn position_velocity_and_acceleration_are_those_of_the_trapezoid() {
    let mut rig = Rig::new(&settings());
    let samples = traced(&mut rig);
    assert!(samples.len() >= 59, "{} samples in 0.6 s", samples.len());
    let mut seen = [false; 3];
    for (since_s, sample) in samples {
        let x = sample.motions[0];
        // The velocity is the distance of one cycle divided by its time: the velocity in the middle of the
        // cycle.
        let middle_s = since_s - T / 2.0;
        if since_s > 2.0 * T && since_s < RAMP_S {
            seen[0] = true;
            close(x.position, ACCELERATION * since_s * since_s / 2.0);
            assert!(
                (x.velocity - ACCELERATION * middle_s).abs() < 1e-6,
                "{x:?} at {since_s}"
            );
            assert!((x.acceleration - ACCELERATION).abs() < 1e-3, "{x:?} at {since_s}");
        } else if since_s > RAMP_S + 2.0 * T && since_s < 0.5 {
            seen[1] = true;
            assert!((x.velocity - SPEED).abs() < 1e-6, "{x:?} at {since_s}");
            assert!(x.acceleration.abs() < 1e-3, "{x:?} at {since_s}");
            assert!((sample.feedrate_mm_min - SPEED * 60.0).abs() < 1e-4);
        } else if since_s > 0.5 + 2.0 * T && since_s < 0.6 {
            seen[2] = true;
            assert!(
                (x.velocity - ACCELERATION * (0.6 - middle_s)).abs() < 1e-6,
                "{x:?} at {since_s}"
            );
            assert!((x.acceleration + ACCELERATION).abs() < 1e-3, "{x:?} at {since_s}");
        }
        assert!(x.following_error.abs() < 1e-12, "the drives are ideal");
        assert!(sample.motions[1].position.abs() < 1e-12, "Y rests");
    }
    assert_eq!(seen, [true; 3]);
}

#[test]
fn the_following_error_of_a_lagging_drive_at_speed_is_speed_times_lag() {
    let mut settings = settings();
    for motor in settings.motors.iter_mut().flatten() {
        motor.lag_ms = 20.0;
    }
    let mut rig = Rig::new(&settings);
    let samples = traced(&mut rig);
    // After 15 times the lag, the effect of the start is below a millionth.
    let steady = samples.iter().filter(|(since_s, _)| (0.4..0.5).contains(since_s));
    let mut count = 0;
    for (since_s, sample) in steady {
        let error = sample.motions[0].following_error;
        assert!((error - SPEED * 0.02).abs() < SPEED * T, "{error} at {since_s}");
        count += 1;
    }
    assert!(count >= 9);
}
