//! Random commands at random times: the motion stays on the path, nothing jumps, each stop is answered.

use proptest::prelude::*;
use tandem_model::AxisVector;
use tandem_servo::{Control, Event, SpindleDirection};

use crate::rig::{Rig, T, line, settings, vector};

fn control() -> impl Strategy<Value = Control> {
    let direction = prop_oneof![
        Just(SpindleDirection::Cw),
        Just(SpindleDirection::Stop),
        Just(SpindleDirection::Orient)
    ];
    prop_oneof![
        Just(Control::Hold),
        Just(Control::Resume),
        (any::<f64>(), any::<f64>()).prop_map(|(feed, rapid)| Control::Override { feed, rapid }),
        (0.0..2.0, 0.0..1.0).prop_map(|(feed, rapid)| Control::Override { feed, rapid }),
        (direction, any::<f64>()).prop_map(|(direction, rpm)| Control::Spindle { direction, rpm }),
    ]
}

fn timed<C: Strategy<Value = Control>>(control: C) -> impl Strategy<Value = Vec<(u32, Control)>> {
    prop::collection::vec((0_u32..400, control), 0..12)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn s1i_hold_resume_and_override_never_leave_the_path(controls in timed(control())) {
        let mut rig = Rig::new(&settings());
        rig.push(line(1, AxisVector::ZERO, vector(&[30.0, 40.0]), 100.0, 0.1));
        let mut last = 0.0;
        for (wait, control) in controls {
            rig.control(control);
            for _ in 0..=wait {
                rig.cycle();
                let [x, y, ..] = rig.position().0;
                prop_assert!((x * 40.0 - y * 30.0).abs() < 1e-9, "off the line at {x}, {y}");
                let along = x.hypot(y);
                // The motion is forward only, at most 200 percent of 100 mm/s.
                prop_assert!(along >= last - 1e-12 && along - last <= 200.0 * T * (1.0 + 1e-9));
                last = along;
            }
        }
        // The machine has no spindle; the resulting faults prevent only the next start.
        rig.control(Control::Resume);
        rig.control(Control::Override { feed: 1.0, rapid: 1.0 });
        rig.cycles(4000);
        prop_assert_eq!(rig.position(), vector(&[30.0, 40.0]));
    }

    #[test]
    fn every_stop_is_answered_and_nothing_older_runs_after_it(
        controls in timed(control()),
        aborts in any::<bool>(),
        later in timed(control()),
    ) {
        let mut rig = Rig::new(&settings());
        for n in 0..5_u32 {
            let (from, to) = (f64::from(n) * 10.0, f64::from(n + 1) * 10.0);
            rig.push(line(u64::from(n) + 1, vector(&[from]), vector(&[to]), 50.0, 0.1));
        }
        for (wait, control) in controls {
            rig.control(control);
            rig.cycles(wait);
        }
        rig.control(if aborts { Control::Abort { epoch: 1 } } else { Control::Stop { epoch: 1 } });
        // From 200 percent feed hold takes twice its slew time of 0.2 s.
        let events = rig.cycles(401);
        let stops: Vec<_> = events.iter().filter(|event| matches!(event, Event::Stopped { epoch: 1, .. })).collect();
        prop_assert_eq!(stops.len(), 1);
        let position = rig.position();
        for (wait, control) in later {
            rig.control(control);
            rig.cycles(wait);
        }
        prop_assert_eq!(rig.position(), position);
        prop_assert_eq!(rig.servo.channel(0).profiles_waiting(), 0);
    }
}
