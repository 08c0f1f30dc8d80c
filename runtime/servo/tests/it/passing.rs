//! Cycles that change nothing are passed at once. The result equals the result of executed cycles.

use proptest::prelude::*;
use tandem_model::AxisVector;
use tandem_model::flow::SegmentFeed;
use tandem_model::profile::Profile;
use tandem_model::settings::CoordinateSystemSettings;
use tandem_servo::{Control, Event, Servo, SpindleDirection};

use crate::rig::{Rig, dwell, line, rapid, settings, spindle, vector};

/// Settings with drives that lag, and a spindle of 1000 r/min per second.
fn machine() -> CoordinateSystemSettings {
    let mut settings = CoordinateSystemSettings {
        spindle: Some(spindle()),
        ..settings()
    };
    for motor in settings.motors.iter_mut().flatten() {
        motor.lag_ms = 5.0;
    }
    settings
}

/// Passes as many cycles as possible, and returns their number.
fn pass(servo: &mut Servo, cycles_max: u64) -> u64 {
    let cycles = servo.cycles_to_pass(cycles_max);
    servo.pass(cycles);
    cycles
}

#[test]
fn passing_cycles_leaves_what_counting_them_leaves() {
    let (mut passing, mut counting) = (Rig::new(&machine()), Rig::new(&machine()));
    for rig in [&mut passing, &mut counting] {
        rig.push(rapid(1, 0.0, 20.0));
        let (direction, rpm) = (SpindleDirection::Cw, 333.0);
        rig.control(Control::Spindle { direction, rpm });
    }
    let mut quiet_after = 0;
    while pass(&mut passing.servo, 12_345) < 12_345 {
        passing.cycle();
        quiet_after += 1;
        assert!(quiet_after < 5000, "it never becomes quiet");
    }
    assert!(
        quiet_after > 333,
        "the spindle has not its speed, and the drives lag"
    );
    passing.cycle();
    counting.cycles(quiet_after + 12_345 + 1);
    assert_eq!(passing.reading(), counting.reading());
    assert_eq!(
        passing.servo.time_s().to_bits(),
        counting.servo.time_s().to_bits()
    );
    // The time of the orientation depends on the angle of the spindle.
    let mut oriented = [&mut passing, &mut counting].map(|rig| {
        let direction = SpindleDirection::Orient;
        rig.control(Control::Spindle { direction, rpm: 0.0 });
        rig.until(|event| *event == Event::Oriented)
    });
    oriented.sort_unstable();
    assert_eq!(oriented[0], oriented[1]);
}

#[test]
fn nothing_passes_while_something_is_to_be_done() {
    let mut rig = Rig::new(&machine());
    rig.cycle();
    assert_eq!(pass(&mut rig.servo, 10), 10);
    rig.control(Control::Hold);
    assert_eq!(pass(&mut rig.servo, 10), 0, "a control waits");
    rig.cycles(2);
    assert_eq!(pass(&mut rig.servo, 10), 10, "held at rest");
    rig.push(rapid(1, 0.0, 20.0));
    assert_eq!(pass(&mut rig.servo, 10), 0, "a profile waits");
}

#[test]
fn a_dwell_a_hold_and_a_line_pass_in_a_few_cycles() {
    let mut rig = Rig::new(&settings());
    rig.push(line(1, vector(&[0.0]), vector(&[600.0]), 1.0, 0.1));
    rig.push(dwell(2, vector(&[600.0]), 600.0));
    let (mut counted, mut passed) = (0, 0);
    let mut finished = 0;
    while finished < 2 {
        if counted == 100 {
            rig.control(Control::Hold);
        }
        let room = if counted < 1000 { 1_000 } else { u64::MAX };
        passed += pass(&mut rig.servo, room);
        let events = rig.cycle();
        finished += events
            .iter()
            .filter(|event| matches!(event, Event::Finished { .. }))
            .count();
        counted += 1;
        if counted == 1000 {
            rig.control(Control::Resume);
        }
        assert!(counted < 4000, "cycle by cycle");
    }
    // 600 s of the line, 600 s of the dwell, and the hold
    assert!(passed > 1_200_000, "{passed}");
}

/// Creates controls with their cycles, in a run of some blocks.
fn controls() -> impl Strategy<Value = Vec<(u64, Control)>> {
    let control = prop_oneof![
        Just(Control::Hold),
        Just(Control::Resume),
        Just(Control::HoldAfterBlock(true)),
        Just(Control::Abort { epoch: 1 }),
        (0.0..2.0, 0.0..1.0).prop_map(|(feed, rapid)| Control::Override { feed, rapid }),
        Just(Control::Override {
            feed: 0.0,
            rapid: 0.0
        }),
        (0.0..3000.0).prop_map(|rpm| Control::Spindle {
            direction: SpindleDirection::Cw,
            rpm
        }),
        Just(Control::Spindle {
            direction: SpindleDirection::Orient,
            rpm: 0.0
        }),
    ];
    prop::collection::vec((0_u64..6000, control), 0..10).prop_map(|mut controls| {
        controls.sort_by_key(|(at, _)| *at);
        controls
    })
}

/// Returns events and the last reading of 6000 cycles. If `passes`, as few cycles as possible are executed.
fn run(
    settings: &CoordinateSystemSettings,
    controls: &[(u64, Control)],
    passes: bool,
) -> (Vec<Event>, Vec<String>) {
    let mut rig = Rig::new(settings);
    let x = |x: f64| vector(&[x]);
    rig.push(line(1, x(0.0), x(40.0), 50.0, 0.1));
    rig.push(dwell(2, x(40.0), 0.7));
    rig.push(rapid(3, 40.0, -20.0));
    rig.push(line(4, x(-20.0), x(-19.0), 1.0, 0.2));
    let (mut at, mut events, mut readings) = (0, Vec::new(), Vec::new());
    let stops = controls.iter().map(|(at, control)| (*at, Some(*control)));
    for (until, control) in stops.chain([(6000, None)]) {
        while at < until {
            if passes {
                at += pass(&mut rig.servo, until - at - 1);
            }
            events.extend(rig.cycle());
            at += 1;
        }
        readings.push(format!("{:?}", rig.reading()));
        if let Some(control) = control {
            rig.control(control);
        }
    }
    (events, readings)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn whatever_is_commanded_passing_and_counting_give_the_same_bits(controls in controls(), lag in any::<bool>()) {
        let mut settings = machine();
        if !lag {
            for motor in settings.motors.iter_mut().flatten() {
                motor.lag_ms = 0.0;
            }
        }
        prop_assert_eq!(run(&settings, &controls, true), run(&settings, &controls, false));
    }
}

/// Returns positions every 10 ms over 2 s, and the number of counted cycles.
fn positions(
    settings: &CoordinateSystemSettings,
    profiles: &[Profile],
    passes: bool,
) -> (Vec<AxisVector>, u64) {
    let mut rig = Rig::new(settings);
    for profile in profiles {
        rig.push(profile.clone());
    }
    let (mut at, mut counted) = (0, 0);
    let positions = (1..=200).map(|n| {
        while at < 10 * n {
            if passes {
                at += pass(&mut rig.servo, 10 * n - at - 1);
            }
            rig.cycle();
            at += 1;
            counted += 1;
        }
        rig.position()
    });
    (positions.collect(), counted)
}

#[test]
fn line_with_late_next_block_slows_the_same_passed_or_cycle_by_cycle() {
    // 60 mm at 100 mm/s with ramps of 0.1 s take 0.7 s; a feed hold of 0.2 s needs the last 0.1 s of this
    // time.
    let mut late = line(1, vector(&[0.0]), vector(&[60.0]), 100.0, 0.1);
    late.exact_stop = false;
    let (passed, _) = positions(&settings(), &[late.clone()], true);
    let rest = passed[199].0[0];
    assert!((59.9..60.0).contains(&rest), "{rest}");
    assert_eq!(passed, positions(&settings(), &[late], false).0);
}

#[test]
fn g500_chain_with_late_blocks_slows_the_same_passed_or_cycle_by_cycle() {
    let settings = crate::look_ahead::machine(1000.0);
    let feed = SegmentFeed {
        feedrate_mm_min: 6000.0,
        ta_ms: 50.0,
        td_ms: 50.0,
        ts_ms: 0.0,
        ..SegmentFeed::default()
    };
    let profiles = crate::look_ahead::plan(&settings, &[(20.0, 1.0, false); 8], feed);
    for known in 2..profiles.len() {
        let (passed, _) = positions(&settings, &profiles[..known], true);
        let (counted, _) = positions(&settings, &profiles[..known], false);
        assert_eq!(passed, counted, "{known}");
    }
    let (_, counted) = positions(&settings, &profiles, true);
    assert!(counted < 1500, "cycle by cycle: {counted}");
}
