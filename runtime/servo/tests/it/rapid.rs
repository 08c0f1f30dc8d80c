//! Feed hold, rapid override and stop within G00 and G31 (M1e, M1i). A rapid that uses the whole maximum
//! acceleration of its motors leaves no room for a slew while it speeds up or brakes.

use std::collections::VecDeque;

use proptest::prelude::*;
use tandem_model::flow::{MultiBlock, Segment, SegmentEnd, SegmentMotion};
use tandem_model::settings::SimulatedSkip;
use tandem_motion::Planner;
use tandem_servo::Control;

use crate::look_ahead::{Watch, is_fault, machine};
use crate::rig::{Rig, close, origin, vector};

fn controls() -> impl Strategy<Value = Vec<(u32, Control)>> {
    let rapid = prop_oneof![Just(0.0), Just(1.0), 0.0..1.0];
    let control = prop_oneof![
        Just(Control::Hold),
        Just(Control::Resume),
        rapid.prop_map(|rapid| Control::Override { feed: 1.0, rapid }),
    ];
    let wait = prop_oneof![0_u32..4, 0_u32..150];
    prop::collection::vec((wait, control), 1..12)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn m1i_holds_and_overrides_in_a_rapid_keep_motor_maximum_acceleration(
        way in prop::array::uniform3(-60.0..60.0),
        fractions in prop::array::uniform3(0.05..1.0),
        slew_ms in prop_oneof![Just(0.0), Just(20.0), Just(200.0)],
        jerk in prop_oneof![Just(None), Just(Some(40_000.0))],
        skips in any::<bool>(),
        controls in controls(),
    ) {
        let acceleration = 2000.0;
        let mut settings = machine(acceleration);
        (settings.hold_slew_ms, settings.override_slew_ms) = (slew_ms, slew_ms);
        for (motor, fraction) in settings.motors.iter_mut().flatten().zip(fractions) {
            (motor.rapid_velocity, motor.skip_velocity) = (400.0 * fraction, 300.0 * fraction);
            (motor.rapid_acceleration, motor.max_jerk) = (acceleration, jerk);
        }
        // X turns back half way to the target.
        let to = vector(&way);
        settings.motion.simulated_skip[0] = Some(if way[0] > 0.0 {
            SimulatedSkip::Above(way[0] / 2.0)
        } else {
            SimulatedSkip::Below(way[0] / 2.0)
        });
        let from = vector(&[]);
        let motion = if skips { SegmentMotion::Skip { from, to } } else { SegmentMotion::Rapid { from, to } };
        let segment = Segment { origin: origin(1), motion, end: SegmentEnd::ExactStop, multi_block: MultiBlock::Off, serial: 0 };
        let mut out = VecDeque::new();
        Planner::new(&settings).push(&segment, &mut out).unwrap();
        let mut rig = Rig::new(&settings);
        for profile in out {
            rig.push(profile);
        }
        let mut watch = Watch::new();
        for (wait, control) in controls {
            rig.control(control);
            for _ in 0..=wait {
                watch.cycle(&mut rig);
            }
        }
        rig.control(Control::Resume);
        rig.control(Control::Override { feed: 1.0, rapid: 1.0 });
        for _ in 0..20_000 {
            let events = watch.cycle(&mut rig);
            prop_assert!(!events.iter().any(is_fault), "{events:?}");
            if rig.servo.channel(0).is_idle() {
                break;
            }
        }
        prop_assert!(watch.worst <= acceleration * (1.0 + 1e-6), "{} of {acceleration}", watch.worst);
        let end = [if skips { way[0] / 2.0 } else { way[0] }, way[1], way[2]];
        for (axis, end) in end.into_iter().enumerate() {
            close(rig.position().0[axis], end);
        }
    }
}

#[test]
fn m1i_hold_during_maximum_rapid_braking_lets_it_brake_to_its_end() {
    // X brakes from 400 mm/s at 2000 mm/s^2: a ramp of 0.2 s. In its last part no acceleration is left for a
    // hold.
    let mut settings = machine(2000.0);
    settings.hold_slew_ms = 100.0;
    let x = settings.motors[0].as_mut().unwrap();
    (x.rapid_velocity, x.rapid_acceleration) = (400.0, 2000.0);
    let (from, to) = (vector(&[]), vector(&[120.0]));
    let segment = Segment {
        origin: origin(1),
        motion: SegmentMotion::Rapid { from, to },
        end: SegmentEnd::ExactStop,
        multi_block: MultiBlock::Off,
        serial: 0,
    };
    let mut out = VecDeque::new();
    Planner::new(&settings).push(&segment, &mut out).unwrap();
    let mut rig = Rig::new(&settings);
    for profile in out {
        rig.push(profile);
    }
    // The rapid takes 0.5 s: it speeds up until 0.2 s, and brakes from 0.3 s on.
    rig.cycles(351);
    rig.control(Control::Hold);
    rig.cycles(149);
    close(rig.x(), 120.0 - 2000.0 * 0.001_f64.powi(2) / 2.0);
    rig.cycle();
    close(rig.x(), 120.0);
}
