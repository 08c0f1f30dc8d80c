//! Time of one servo cycle, for 8 channels of 8 axes (the maximum of a machine) and for one channel of 3
//! axes. Each axis has a simulated drive that lags, each channel a spindle. Cases are (channels, axes).
//!
//! Medians on two cores of an AMD EPYC virtual machine (a servo period is 1 ms = 1,000,000 ns):
//!
//! | case | 1 channel, 3 axes | 8 channels, 8 axes |
//! | --- | --- | --- |
//! | idle | 16 ns | 150 ns |
//! | G01, ramp with jerk phases | 57 ns | 499 ns |
//! | G00, seven phases a motor | 74 ns | 644 ns |
//! | G500, the override slewing | 94 ns | 779 ns |

use std::hint::black_box;

use divan::Bencher;
use tandem_model::flow::Path;
use tandem_model::profile::{
    ChainPlace, Law, MotorMove, Pace, PacePiece, PacedMotion, Profile, RampedMotion, SlewRoom, SpeedGrowth,
    Stretch,
};
use tandem_model::ramp::UnitRamp;
use tandem_model::settings::{CoordinateSystemSettings, MotorKind, MotorSettings};
use tandem_model::{AXES_MAX, AxisVector, Origin};
use tandem_servo::{ChannelHandle, Control, Servo, TRACE_SAMPLES};

const T: f64 = 0.001;

/// Duration of the profiles, s, longer than any measurement.
const DURATION_S: f64 = 1e8;

fn main() {
    divan::main();
}

fn motor(number: u16) -> MotorSettings {
    MotorSettings {
        lag_ms: 5.0,
        ..MotorSettings::new(number, MotorKind::Linear, 500.0, 5000.0)
    }
}

fn settings(axes: usize) -> CoordinateSystemSettings {
    CoordinateSystemSettings {
        motors: std::array::from_fn(|i| (i < axes).then(|| motor(1))),
        spindle: Some(motor(9)),
        servo_period_s: T,
        ..CoordinateSystemSettings::default()
    }
}

/// Returns a servo that has run until each page of its traces is in memory.
fn servo(settings: &CoordinateSystemSettings, channels: usize) -> (Servo, Vec<ChannelHandle>) {
    let (mut servo, handles) = Servo::simulated(&vec![(settings, 16); channels], T);
    for _ in 0..10 * TRACE_SAMPLES {
        servo.cycle();
    }
    (servo, handles)
}

/// Returns a slow motion of all axes that lasts as long as the bench.
fn law(rapid: bool) -> Law {
    let from = AxisVector::ZERO;
    let to = AxisVector([1000.0; AXES_MAX]);
    if rapid {
        let slow = MotorMove {
            velocity: 2000.0 / DURATION_S,
            ramp_s: DURATION_S / 2.0,
            jerk_s: DURATION_S / 8.0,
            cruise_s: 0.0,
        };
        let moves = [slow; AXES_MAX];
        let stretch = Stretch::whole(DURATION_S);
        Law::Motors {
            from,
            to,
            moves,
            stretch,
        }
    } else {
        let length = to.orthogonal_length();
        let ramp = UnitRamp::new(DURATION_S / 4.0, DURATION_S / 4.0);
        let path = Path::Line { from, to, length };
        let block = RampedMotion {
            path,
            speed: 2.0 * length / DURATION_S,
            start: ramp,
            stop: ramp,
            begun_s: 0.0,
            next: None,
            plan_s: DURATION_S,
        };
        let place = ChainPlace {
            first_segment: 1,
            ends_s: DURATION_S,
        };
        Law::Ramped { block, place }
    }
}

fn moving(channels: usize, axes: usize, rapid: bool) -> (Servo, Vec<ChannelHandle>) {
    let settings = settings(axes);
    let (mut servo, mut handles) = servo(&settings, channels);
    for handle in &mut handles {
        let profile = Profile {
            segment: 1,
            epoch: 0,
            origin: Origin::default(),
            law: law(rapid),
            duration_s: DURATION_S,
            exact_stop: true,
        };
        assert!(handle.profiles.push(profile).is_ok());
    }
    servo.cycle();
    assert!(
        servo
            .channels()
            .iter()
            .all(|channel| channel.executing().is_some())
    );
    (servo, handles)
}

#[divan::bench(args = [(1, 3), (8, 8)])]
fn linear(bencher: Bencher, (channels, axes): (usize, usize)) {
    let (mut servo, _handles) = moving(channels, axes, false);
    bencher.bench_local(|| black_box(&mut servo).cycle());
}

/// G500 while the override changes slowly: each cycle determines the room that the motors leave.
#[divan::bench(args = [(1, 3), (8, 8)])]
fn look_ahead(bencher: Bencher, (channels, axes): (usize, usize)) {
    let mut settings = settings(axes);
    settings.override_slew_ms = 1e9;
    let (mut servo, mut handles) = servo(&settings, channels);
    for handle in &mut handles {
        assert!(handle.profiles.push(paced()).is_ok());
    }
    servo.cycle();
    for handle in &mut handles {
        let half = Control::Override {
            feed: 0.5,
            rapid: 1.0,
        };
        assert!(handle.controls.push(half).is_ok());
    }
    bencher.bench_local(|| black_box(&mut servo).cycle());
}

/// Returns the line of [`law`] in eight pieces.
fn paced() -> Profile {
    let from = AxisVector::ZERO;
    let to = AxisVector([1000.0; AXES_MAX]);
    let length = to.orthogonal_length();
    let ramp = UnitRamp::new(DURATION_S / 4.0, DURATION_S / 4.0);
    let room = SlewRoom {
        slope: 10.0,
        braking: 0.5,
        driving: 0.5,
    };
    let pieces = [0.0, 1.0, 2.0, 3.0].map(|n| PacePiece {
        begins_s: n * DURATION_S / 4.0,
        plan_s: n * DURATION_S / 4.0,
        rate: 1.0,
        rate_change: 0.0,
        rate_jerk: 0.0,
        rate_slope: 0.0,
        growth: SpeedGrowth::default(),
        room,
    });
    Profile {
        segment: 1,
        epoch: 0,
        origin: Origin::default(),
        law: Law::Paced {
            block: PacedMotion::Ramped(RampedMotion {
                path: Path::Line { from, to, length },
                speed: 2.0 * length / DURATION_S,
                start: ramp,
                stop: ramp,
                begun_s: 0.0,
                next: None,
                plan_s: DURATION_S,
            }),
            pace: Pace::new(pieces, DURATION_S, 1.0, 1),
        },
        duration_s: DURATION_S,
        exact_stop: true,
    }
}

#[divan::bench(args = [(1, 3), (8, 8)])]
fn rapid(bencher: Bencher, (channels, axes): (usize, usize)) {
    let (mut servo, _handles) = moving(channels, axes, true);
    bencher.bench_local(|| black_box(&mut servo).cycle());
}

#[divan::bench(args = [(1, 3), (8, 8)])]
fn idle(bencher: Bencher, (channels, axes): (usize, usize)) {
    let settings = settings(axes);
    let (mut servo, _handles) = servo(&settings, channels);
    bencher.bench_local(|| black_box(&mut servo).cycle());
}
