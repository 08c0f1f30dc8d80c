//! G31 (M1e, D40, D41): each motor returns to the position at which its skip input switched on.

use proptest::prelude::*;
use tandem_model::profile::{Law, MotorLimits, MotorMove, Profile};
use tandem_model::settings::{CoordinateSystemSettings, SimulatedRound, SimulatedSkip};
use tandem_model::{AXES_MAX, Axis, AxisSet};
use tandem_servo::{Control, Event};

use crate::rig::{Rig, T, close, is_finished, is_stopped, line, origin, settings, vector};

use Axis::{X, Y, Z};

/// Returns settings with X, Y, Z at skip velocity 50 and acceleration 1000, and these skip inputs.
fn with_inputs(inputs: &[(Axis, SimulatedSkip)]) -> CoordinateSystemSettings {
    let mut settings = settings();
    for motor in settings.motors.iter_mut().flatten() {
        motor.rapid_acceleration = 1000.0;
        motor.skip_velocity = 50.0;
    }
    for &(axis, input) in inputs {
        settings.motion.simulated_skip[axis.index()] = Some(input);
    }
    settings
}

fn skip(segment: u64, from: &[f64], to: &[f64]) -> Profile {
    skip_within(None, segment, from, to)
}

fn skip_within(jerk: Option<f64>, segment: u64, from: &[f64], to: &[f64]) -> Profile {
    let (from, to) = (vector(from), vector(to));
    let limits = MotorLimits {
        velocity: 50.0,
        acceleration: 1000.0,
        jerk,
    }
    .with_reserve();
    let moves: [MotorMove; AXES_MAX] =
        std::array::from_fn(|i| MotorMove::shortest(to.0[i] - from.0[i], limits));
    Profile {
        segment,
        epoch: 0,
        origin: origin(segment),
        law: Law::Skip { from, to, moves },
        duration_s: moves.iter().map(MotorMove::duration_s).fold(0.0, f64::max),
        exact_stop: true,
    }
}

/// Returns position and axes of the only capture in these events.
fn capture(events: &[Event]) -> ([f64; 3], AxisSet) {
    let captures: Vec<_> = events
        .iter()
        .filter_map(|event| match event {
            Event::Captured {
                position, captured, ..
            } => Some((position.0, *captured)),
            _ => None,
        })
        .collect();
    assert_eq!(captures.len(), 1, "{events:?}");
    let (position, captured) = captures[0];
    ([position[X], position[Y], position[Z]], captured)
}

fn set(axes: &[Axis]) -> AxisSet {
    axes.iter().copied().collect()
}

#[test]
fn s1e_overshoot_is_v2_over_2a_and_return_takes_1_plus_root_2_v_over_a() {
    // -1.25 - 50 (0.172 - 0.05) = -7.35 is the first sample beyond the threshold, by 1e-6.
    let mut rig = Rig::new(&with_inputs(&[(Z, SimulatedSkip::Below(-7.35 + 1e-6))]));
    rig.push(skip(1, &[0.0; 3], &[0.0, 0.0, -20.0]));
    let mut events = rig.cycle();
    let (mut lowest, mut cycles) = (0.0_f64, 0);
    while !events.iter().any(is_finished(1)) {
        events.extend(rig.cycle());
        cycles += 1;
        lowest = lowest.min(rig.position()[Z]);
        // The formula for three parts: motion down, braking, and the return as a triangle from rest to rest.
        let t = f64::from(cycles) * T;
        let expected = if t < 0.05 {
            -500.0 * t * t
        } else if t < 0.172 {
            -1.25 - 50.0 * (t - 0.05)
        } else if t < 0.222 {
            -7.35 - 50.0 * (t - 0.172) + 500.0 * (t - 0.172).powi(2)
        } else {
            let (way, past) = (1.25 + 1e-6, t - 0.222);
            let half = (way / 1000.0_f64).sqrt();
            let gone = if past < half {
                500.0 * past * past
            } else {
                way - 500.0 * (2.0 * half - past).max(0.0).powi(2)
            };
            -8.6 + gone
        };
        close(rig.position()[Z], expected);
    }
    close(lowest, -7.35 - 50.0 * 50.0 / 2000.0);
    let back_s = (1.0 + 2.0_f64.sqrt()) * 50.0 / 1000.0;
    let took_s = f64::from(cycles) * T - 0.172;
    assert!(
        took_s >= back_s && took_s <= back_s + 2.0 * T,
        "{took_s} s, not {back_s}"
    );
    let (position, captured) = capture(&events);
    assert_eq!(
        position[2].to_bits(),
        (-7.35_f64 + 1e-6).to_bits(),
        "the threshold itself"
    );
    assert_eq!(captured, set(&[Z]));
}

#[test]
fn m1e3_with_max_jerk_a_motor_brakes_and_returns_within_it() {
    let jerk = 10_000.0;
    // The input switches on while the motor speeds up, moves evenly, and slows down.
    for threshold in [-0.02, -0.5, -3.0, -7.35, -17.0, -19.5, -19.99] {
        let mut settings = with_inputs(&[(Z, SimulatedSkip::Below(threshold))]);
        for motor in settings.motors.iter_mut().flatten() {
            motor.max_jerk = Some(jerk);
        }
        let mut rig = Rig::new(&settings);
        rig.push(skip_within(Some(jerk), 1, &[0.0; 3], &[0.0, 0.0, -20.0]));
        let mut events = rig.cycle();
        let mut z = vec![0.0; 3];
        while !events.iter().any(is_finished(1)) {
            events.extend(rig.cycle());
            z.push(rig.position()[Z]);
        }
        z.extend([rig.position()[Z]; 3]);
        for four in z.windows(4) {
            let third = (four[3] - 3.0 * four[2] + 3.0 * four[1] - four[0]) / (T * T * T);
            assert!(third.abs() <= 1.001 * jerk, "{threshold}: {third}");
        }
        close(rig.position()[Z], threshold);
    }
}

#[test]
fn d40_each_motor_stops_alone_and_one_without_an_input_goes_to_the_target() {
    let inputs = [(X, SimulatedSkip::Above(4.0)), (Z, SimulatedSkip::Below(-30.0))];
    let mut rig = Rig::new(&with_inputs(&inputs));
    rig.push(skip(1, &[0.0; 3], &[20.0, 15.0, -25.0]));
    rig.push(line(
        2,
        vector(&[4.0, 15.0, -25.0]),
        vector(&[4.0, 15.0, 0.0]),
        50.0,
        0.1,
    ));
    let mut events = Vec::new();
    while !events.iter().any(is_finished(1)) {
        events.extend(rig.cycle());
    }
    // Captured comes before Finished; Z, the slowest motor, needs 25/50 + 0.05 s.
    let order: Vec<_> = events
        .iter()
        .skip(1)
        .map(|event| matches!(event, Event::Captured { .. }))
        .collect();
    assert_eq!(order, [true, false]);
    let Event::Finished { time_s, .. } = events[2] else {
        panic!("{events:?}");
    };
    assert!((time_s - 0.55).abs() <= 3.0 * T);
    let (position, captured) = capture(&events);
    assert_eq!(captured, set(&[X]));
    for (value, expected) in position.into_iter().zip([4.0, 15.0, -25.0]) {
        close(value, expected);
    }
    // The next block begins where the motors rest.
    rig.until(is_finished(2));
    assert_eq!(rig.position(), vector(&[4.0, 15.0, 0.0]));
}

#[test]
fn motor_past_threshold_at_start_stays_and_a_still_one_captures_nothing() {
    let inputs = [(X, SimulatedSkip::Below(5.0)), (Y, SimulatedSkip::Below(5.0))];
    let mut rig = Rig::new(&with_inputs(&inputs));
    rig.push(skip(1, &[0.0; 3], &[-10.0, 0.0, 3.0]));
    let mut events = Vec::new();
    while !events.iter().any(is_finished(1)) {
        events.extend(rig.cycle());
        close(rig.x(), 0.0);
    }
    assert_eq!(capture(&events), ([0.0, 0.0, 3.0], set(&[X])));
    // The next G31 starts from the beginning.
    rig.push(skip(2, &[0.0, 0.0, 3.0], &[0.0, 0.0, 6.0]));
    let mut events = Vec::new();
    while !events.iter().any(is_finished(2)) {
        events.extend(rig.cycle());
    }
    assert_eq!(capture(&events), ([0.0, 0.0, 6.0], AxisSet::EMPTY));
}

#[test]
fn lagging_motor_reaching_its_threshold_after_its_command_turns_back() {
    let mut settings = with_inputs(&[(X, SimulatedSkip::Above(9.99))]);
    settings.motors[0].as_mut().unwrap().lag_ms = 50.0;
    settings.motors[0].as_mut().unwrap().in_position = 0.001;
    let mut rig = Rig::new(&settings);
    rig.push(skip(1, &[0.0], &[10.0]));
    let mut events = Vec::new();
    while !events.iter().any(is_finished(1)) {
        events.extend(rig.cycle());
    }
    let (position, captured) = capture(&events);
    close(position[0], 9.99);
    assert_eq!(captured, set(&[X]));
}

#[test]
fn a_stop_within_g31_captures_nothing() {
    let mut rig = Rig::new(&with_inputs(&[(X, SimulatedSkip::Above(4.0))]));
    rig.push(skip(1, &[0.0], &[20.0]));
    // 0.1 s of motion remain at the slew of feed hold; the return takes until 0.23 s.
    rig.cycles(108);
    rig.control(Control::Stop { epoch: 1 });
    let events = rig.cycles(300);
    assert!(events.iter().any(is_stopped));
    assert!(!events.iter().any(|event| matches!(event, Event::Captured { .. })));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn s1i_hold_resume_and_rapid_override_keep_capture_and_continuity(
        controls in prop::collection::vec((0_u32..120, prop_oneof![
            Just(Control::Hold),
            Just(Control::Resume),
            (0.01..1.0).prop_map(|rapid| Control::Override { feed: 1.0, rapid }),
        ]), 0..10),
        threshold in 0.5..19.0,
    ) {
        let mut rig = Rig::new(&with_inputs(&[(X, SimulatedSkip::Above(threshold))]));
        rig.push(skip(1, &[0.0], &[20.0]));
        let mut events = Vec::new();
        let mut last = 0.0;
        let mut cycle = |rig: &mut Rig, events: &mut Vec<Event>| {
            events.extend(rig.cycle());
            let step = rig.x() - last;
            last = rig.x();
            // Never faster than 50 mm/s; never beyond the threshold by more than one sample and the braking
            // distance.
            prop_assert!(step.abs() <= 50.0 * T + 1e-9, "{step}");
            prop_assert!(last <= threshold + 0.05 + 1.25 + 1e-9);
            Ok(())
        };
        for (wait, control) in controls {
            rig.control(control);
            for _ in 0..=wait {
                cycle(&mut rig, &mut events)?;
            }
        }
        rig.control(Control::Resume);
        rig.control(Control::Override { feed: 1.0, rapid: 1.0 });
        for _ in 0..2000 {
            cycle(&mut rig, &mut events)?;
        }
        let (position, captured) = capture(&events);
        prop_assert_eq!(position[0].to_bits(), f64::to_bits(threshold));
        prop_assert_eq!(captured, set(&[X]));
    }
}

#[test]
fn external_skip_input_captures_the_motor_position_and_keeps_its_value() {
    let mut rig = Rig::new(&with_inputs(&[]));
    // Motor 13 is Z; 50 mm/s after 50 ms, 1.25 mm.
    rig.push(skip(1, &[0.0; 3], &[10.0, 0.0, -20.0]));
    rig.cycles(151);
    close(rig.position()[Z], -1.25 - 50.0 * 0.1);
    rig.control(Control::SkipInput { motor: 13, on: true });
    rig.control(Control::SkipInput { motor: 99, on: true });
    let mut events = Vec::new();
    while !events.iter().any(is_finished(1)) {
        events.extend(rig.cycle());
    }
    let (position, captured) = capture(&events);
    // The cycle that takes the control adds one more sample.
    close(position[2], -6.25 - 0.05);
    close(position[0], 10.0);
    assert_eq!(captured, set(&[Z]));
    // The input is still on: the next G31 captures its start position.
    let at = rig.position();
    rig.push(skip(2, &at.0[..3], &[10.0, 0.0, -20.0]));
    let mut events = Vec::new();
    while !events.iter().any(is_finished(2)) {
        events.extend(rig.cycle());
    }
    assert_eq!(
        capture(&events),
        ([position[0], position[1], position[2]], set(&[Z]))
    );
    // The input is off: the motors move to the target.
    rig.control(Control::SkipInput { motor: 13, on: false });
    let at = rig.position();
    rig.push(skip(3, &at.0[..3], &[10.0, 0.0, -20.0]));
    let mut events = Vec::new();
    while !events.iter().any(is_finished(3)) {
        events.extend(rig.cycle());
    }
    assert_eq!(capture(&events), ([10.0, 0.0, -20.0], AxisSet::EMPTY));
}

/// Returns the end position of a probe that moves from 0 to `to`, and the captured axes.
fn touched(round: SimulatedRound, to: [f64; 3]) -> ([f64; 3], AxisSet) {
    let mut settings = with_inputs(&[]);
    settings.motion.simulated_round = Some(round);
    let mut rig = Rig::new(&settings);
    rig.push(skip(1, &[0.0; 3], &to));
    let mut events = rig.cycle();
    while !events.iter().any(is_finished(1)) {
        events.extend(rig.cycle());
    }
    capture(&events)
}

#[test]
fn simulated_bore_is_touched_on_its_inner_circle_below_its_upper_edge() {
    // Centre (2, 1), radius 5: at Y 0 the wall is at X 2 +- sqrt(24), at X 0 it is at Y 1 +- sqrt(21).
    let round = SimulatedRound {
        centre: [2.0, 1.0],
        radius: 5.0,
        is_bore: true,
        below: 0.5,
    };
    let half = 24.0_f64.sqrt();
    for (to, x) in [(20.0, 2.0 + half), (-20.0, 2.0 - half)] {
        let (at, axes) = touched(round, [to, 0.0, 0.0]);
        close(at[0], x);
        assert_eq!(axes, set(&[X]));
    }
    let across = 21.0_f64.sqrt();
    close(touched(round, [0.0, -20.0, 0.0]).0[1], 1.0 - across);
    let above = SimulatedRound { below: 0.0, ..round };
    assert_eq!(
        touched(above, [20.0, 0.0, 0.0]),
        ([20.0, 0.0, 0.0], AxisSet::EMPTY)
    );
}

#[test]
fn a_simulated_boss_is_touched_on_its_circle_from_outside() {
    let round = SimulatedRound {
        centre: [20.0, 3.0],
        radius: 5.0,
        is_bore: false,
        below: 0.5,
    };
    close(touched(round, [40.0, 0.0, 0.0]).0[0], 16.0);
    let beside = SimulatedRound {
        centre: [20.0, 6.0],
        ..round
    };
    assert_eq!(touched(beside, [40.0, 0.0, 0.0]).1, AxisSet::EMPTY);
}
