//! Feed hold, resume and overrides within the maximum jerks of the motors (M1i.6).

use std::collections::VecDeque;
use std::f64::consts::TAU;

use proptest::prelude::*;
use proptest::test_runner::TestCaseError;
use tandem_model::AxisVector;
use tandem_model::flow::{MultiBlock, Path, Segment, SegmentEnd, SegmentFeed, SegmentMotion};
use tandem_model::profile::Profile;
use tandem_model::settings::CoordinateSystemSettings;
use tandem_motion::Planner;
use tandem_servo::{Control, Event};

use crate::planned::Machine;
use crate::rig::{Rig, T, origin, settings, vector};

const VELOCITY: f64 = 500.0;
const ACCELERATION: f64 = 5000.0;
const JERK: f64 = 50_000.0;

/// Largest number of cycles of a motion after its last event.
const CYCLES_MAX: u32 = 120_000;

fn soft() -> CoordinateSystemSettings {
    let mut settings = settings();
    for motor in settings.motors.iter_mut().flatten() {
        motor.max_velocity = VELOCITY;
        motor.max_acceleration = ACCELERATION;
        motor.rapid_velocity = VELOCITY;
        motor.rapid_acceleration = ACCELERATION;
        motor.max_jerk = Some(JERK);
    }
    settings.motion.path_tolerance_mm = 0.01;
    settings
}

/// Largest derivatives of the setpoints, in shares of the limits.
#[derive(Debug, Clone, Copy, Default)]
struct Used {
    velocity: f64,
    acceleration: f64,
    jerk: f64,
}

/// A machine whose setpoints are recorded.
struct Recorded {
    rig: Rig,
    points: Vec<AxisVector>,
    events: Vec<Event>,
    /// Limits of velocity, acceleration and jerk of the motor of X.
    limits: [f64; 3],
}

impl Recorded {
    fn new(settings: &CoordinateSystemSettings, profiles: impl IntoIterator<Item = Profile>) -> Self {
        let mut rig = Rig::with_room(settings, 100_000);
        for profile in profiles {
            rig.push(profile);
        }
        let at = rig.position();
        Self {
            rig,
            points: vec![at; 3],
            events: Vec::new(),
            limits: settings.motors[0].as_ref().map_or([0.0; 3], |motor| {
                [
                    motor.max_velocity,
                    motor.max_acceleration,
                    motor.max_jerk.unwrap_or(0.0),
                ]
            }),
        }
    }

    fn cycles(&mut self, n: u32) {
        for _ in 0..n {
            self.events.extend(self.rig.cycle());
            self.points.push(self.rig.position());
        }
    }

    fn used(&self) -> Used {
        let mut used = Used::default();
        let [velocity, acceleration, jerk] = self.limits;
        for window in self.points.windows(4) {
            for i in 0..3 {
                let [a, b, c, d] = [0, 1, 2, 3].map(|n| window[n].0[i]);
                used.velocity = used.velocity.max((d - c).abs() / T / velocity);
                used.acceleration = used
                    .acceleration
                    .max((d - 2.0 * c + b).abs() / (T * T) / acceleration);
                let j = (d - 3.0 * c + 3.0 * b - a).abs() / (T * T * T) / jerk;
                used.jerk = used.jerk.max(j);
            }
        }
        used
    }
}

fn rapid(settings: &CoordinateSystemSettings, to: AxisVector) -> VecDeque<Profile> {
    let mut planner = Planner::new(settings);
    let mut out = VecDeque::new();
    let segment = Segment {
        origin: origin(1),
        serial: 0,
        motion: SegmentMotion::Rapid {
            from: AxisVector::ZERO,
            to,
        },
        multi_block: MultiBlock::On,
        end: SegmentEnd::ExactStop,
    };
    planner.push(&segment, &mut out).unwrap();
    out
}

/// Returns a closed contour of chords with these ramp times ta and ts, ms.
fn contour(
    settings: &CoordinateSystemSettings,
    chords: u32,
    [ramp_ms, ts_ms]: [f64; 2],
) -> (Planner, VecDeque<Profile>) {
    let mut planner = Planner::new(settings);
    let mut out = VecDeque::new();
    let points: Vec<AxisVector> = (0..=chords)
        .map(|k| {
            let angle = TAU * f64::from(k % chords) / f64::from(chords);
            let radius = 30.0 * (1.0 + 0.3 * (5.0 * angle).cos());
            vector(&[radius * angle.cos() - 39.0, radius * angle.sin()])
        })
        .collect();
    for (n, ends) in points.windows(2).enumerate() {
        let length = ends[1].minus(ends[0]).orthogonal_length();
        let segment = Segment {
            origin: origin(n as u64 + 1),
            serial: 0,
            motion: SegmentMotion::Feed {
                path: Path::Line {
                    from: ends[0],
                    to: ends[1],
                    length,
                },
                feed: SegmentFeed {
                    feedrate_mm_min: 6000.0,
                    unit_mm: 1.0,
                    ta_ms: ramp_ms,
                    td_ms: ramp_ms,
                    ts_ms,
                    keeps_path: false,
                },
            },
            multi_block: MultiBlock::On,
            end: SegmentEnd::Continuous,
        };
        planner.push(&segment, &mut out).unwrap();
    }
    planner.flush(&mut out);
    (planner, out)
}

/// Events of an operator: feed hold, resume, and overrides, each after a number of cycles.
fn events() -> impl Strategy<Value = Vec<(u32, Control)>> {
    let control = prop_oneof![
        2 => Just(Control::Hold),
        3 => Just(Control::Resume),
        2 => (0.0..1.0, 0.0..1.0).prop_map(|(feed, rapid)| Control::Override { feed, rapid }),
    ];
    prop::collection::vec((1_u32..400, control), 1..12)
}

/// Runs profiles with these events, and then to their end.
fn run(
    settings: &CoordinateSystemSettings,
    profiles: &VecDeque<Profile>,
    events: &[(u32, Control)],
) -> Recorded {
    let mut machine = Recorded::new(settings, profiles.clone());
    for (cycles, control) in events {
        machine.cycles(*cycles);
        machine.rig.control(*control);
    }
    machine.rig.control(Control::Override {
        feed: 1.0,
        rapid: 1.0,
    });
    machine.rig.control(Control::Resume);
    for _ in 0..CYCLES_MAX / 1000 {
        let before = machine.rig.position();
        machine.cycles(1000);
        if machine.rig.position() == before {
            break;
        }
    }
    machine
}

fn check(machine: &Recorded, end: AxisVector) -> Result<(), TestCaseError> {
    let used = machine.used();
    prop_assert!(
        used.velocity <= 1.0 + 1e-6 && used.acceleration <= 1.0 + 1e-6 && used.jerk <= 1.001,
        "{used:?}"
    );
    prop_assert!(
        machine.rig.position().minus(end).orthogonal_length() < 1e-9,
        "{}",
        machine.rig.position().0[0]
    );
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn m1i6_events_in_a_rapid_keep_the_maximum_jerk(
        x in 1.0..200.0,
        y in -200.0..200.0,
        slew_ms in prop_oneof![Just(0.0), 1.0..300.0],
        events in events(),
    ) {
        let mut settings = soft();
        settings.hold_slew_ms = slew_ms;
        settings.override_slew_ms = slew_ms;
        let to = vector(&[x, y]);
        check(&run(&settings, &rapid(&settings, to), &events), to)?;
    }

    #[test]
    fn m1i6_events_on_a_smoothed_path_keep_the_maximum_jerk(
        acceleration in 500.0..5000.0,
        rise_s in 0.01..0.2,
        slew_ms in prop_oneof![Just(0.0), 1.0..300.0],
        events in events(),
    ) {
        let mut settings = soft();
        settings.hold_slew_ms = slew_ms;
        settings.override_slew_ms = slew_ms;
        for motor in settings.motors.iter_mut().flatten() {
            motor.max_acceleration = acceleration;
            motor.max_jerk = Some(acceleration / rise_s);
        }
        let profiles = contour(&settings, 600, [0.0; 2]).1;
        check(&run(&settings, &profiles, &events), AxisVector::ZERO)?;
    }

    #[test]
    fn m1i6_events_on_a_programmed_path_keep_the_maximum_jerk(
        acceleration in 500.0..5000.0,
        rise_s in 0.01..0.2,
        slew_ms in prop_oneof![Just(0.0), 1.0..300.0],
        ramps in prop_oneof![Just([20.0, 0.0]), Just([20.0, 10.0])],
        events in events(),
    ) {
        let mut settings = soft();
        settings.motion.path_tolerance_mm = 0.0;
        settings.hold_slew_ms = slew_ms;
        settings.override_slew_ms = slew_ms;
        for motor in settings.motors.iter_mut().flatten() {
            motor.max_acceleration = acceleration;
            motor.max_jerk = Some(acceleration / rise_s);
        }
        let profiles = contour(&settings, 60, ramps).1;
        check(&run(&settings, &profiles, &events), AxisVector::ZERO)?;
    }
}

#[test]
fn m1i6_a_new_plan_for_another_override_keeps_the_maximum_jerk() {
    let settings = soft();
    for (at, factors) in [
        (300, [0.5, 1.0]),
        (700, [0.2, 1.5]),
        (1234, [1.3, 0.8]),
        (2000, [2.0, 0.05]),
    ] {
        let (planner, out) = contour(&settings, 600, [0.0; 2]);
        let mut machine = Machine::of(&settings, planner, out);
        let mut points = vec![machine.rig.position(); 3];
        let mut taken = 0;
        let mut pass = |machine: &mut Machine, cycles: u32| {
            for _ in 0..cycles {
                machine.cycles(1);
                points.push(machine.rig.position());
            }
        };
        pass(&mut machine, at);
        for factor in factors {
            machine.rig.control(Control::Override {
                feed: factor,
                rapid: 1.0,
            });
            machine.planner.set_feed_override(factor);
            let place = machine.planner.place_ahead(machine.place(), 0.02).unwrap();
            let new = machine.planner.replan(place, false);
            machine.splice(Some(place), new.profiles.clone());
            pass(&mut machine, 700);
            if machine.settled() == Some(true) {
                machine.planner.adopt(new);
                taken += 1;
            }
        }
        pass(&mut machine, 20_000);
        let mut recorded = Recorded::new(&settings, []);
        recorded.points = points;
        let used = recorded.used();
        assert!(
            used.velocity <= 1.0 + 1e-6 && used.acceleration <= 1.0 + 1e-6 && used.jerk <= 1.001,
            "{at}: {used:?}"
        );
        assert!(used.jerk > 0.5 && taken > 0, "{at}: {taken} plans, {used:?}");
        assert!(machine.rig.position().orthogonal_length() < 1e-9);
    }
}
