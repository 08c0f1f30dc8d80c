//! Hold, resume, stop and abort.

use tandem_model::profile::Profile;
use tandem_model::{AxisVector, MachinePosition};
use tandem_servo::{Control, Event};

use crate::rig::{Rig, close, dwell, is_finished, is_stopped, line, origin, rapid, settings, vector};

fn is_held(event: &Event) -> bool {
    matches!(event, Event::Held { .. })
}

/// Creates a rig that has moved for one second, on 1000 mm in X at 100 mm/s.
fn under_way() -> Rig {
    let mut rig = Rig::new(&settings());
    rig.push(line(1, AxisVector::ZERO, vector(&[1000.0]), 100.0, 0.1));
    rig.cycles(1001);
    close(rig.x(), 95.0);
    rig
}

#[test]
fn s1i_feed_hold_of_slew_time_h_goes_on_for_v_h_half() {
    let mut rig = under_way();
    rig.control(Control::Hold);
    assert_eq!(rig.until(is_held), 200);
    close(rig.x(), 95.0 + 100.0 * 0.2 / 2.0);
    assert!(rig.reading().held);
    close(rig.reading().rate, 0.0);
    assert!(rig.cycles(500).is_empty());
    close(rig.x(), 105.0);
}

#[test]
fn s1i_resume_slews_to_the_override_and_the_motion_ends_where_programmed() {
    let mut rig = under_way();
    rig.control(Control::Hold);
    rig.until(is_held);
    rig.control(Control::Resume);
    rig.cycles(1000);
    // 0 to 100 percent takes 1 s.
    close(rig.x(), 105.0 + 50.0);
    assert!(!rig.reading().held);
    rig.until(is_finished(1));
    assert_eq!(rig.position(), vector(&[1000.0]));
}

#[test]
fn resume_before_rest_goes_on_from_the_rate_reached() {
    let mut rig = under_way();
    rig.control(Control::Hold);
    rig.cycles(100);
    close(rig.reading().rate, 0.5);
    rig.control(Control::Resume);
    assert!(rig.cycles(100).is_empty(), "not at rest: not told");
    close(rig.reading().rate, 0.6);
}

#[test]
fn hold_at_rest_is_told_at_once_and_nothing_starts_until_resume() {
    let mut rig = Rig::new(&settings());
    rig.control(Control::Hold);
    assert!(matches!(rig.cycle()[..], [Event::Held { .. }]));
    rig.push(line(1, AxisVector::ZERO, vector(&[10.0]), 50.0, 0.1));
    assert!(rig.cycles(50).is_empty());
    rig.control(Control::Hold);
    assert!(rig.cycles(2).is_empty(), "a second hold tells nothing new");
    rig.control(Control::Resume);
    assert!(matches!(rig.cycle()[..], [Event::Started { .. }]));
    assert_eq!(rig.until(is_finished(1)), 300, "from rest nothing slews");
}

#[test]
fn a_block_that_ends_under_hold_is_finished_and_the_next_one_waits() {
    let mut rig = Rig::new(&settings());
    rig.push(line(1, AxisVector::ZERO, vector(&[10.0]), 50.0, 0.1));
    rig.push(rapid(2, 10.0, 30.0));
    rig.cycles(299);
    rig.control(Control::Hold);
    let events = rig.cycles(300);
    assert!(
        matches!(
            events[..],
            [Event::Finished { segment: 1, .. }, Event::Held { .. }]
        ),
        "{events:?}"
    );
    assert_eq!(rig.servo.channel(0).profiles_waiting(), 1);
}

#[test]
fn s1i_feed_hold_stops_a_dwell_and_its_time_is_not_lost() {
    let mut rig = Rig::new(&settings());
    rig.push(dwell(1, AxisVector::ZERO, 0.1));
    rig.cycles(51);
    rig.control(Control::Hold);
    assert!(
        matches!(rig.cycle()[..], [Event::Held { .. }]),
        "nothing moves: at rest at once"
    );
    assert!(rig.cycles(1000).is_empty());
    rig.control(Control::Resume);
    assert_eq!(rig.until(is_finished(1)), 50);
}

#[test]
fn stop_decelerates_on_the_path_and_throws_away_what_is_older() {
    let mut rig = under_way();
    rig.push(rapid(2, 1000.0, 0.0));
    rig.control(Control::Stop { epoch: 1 });
    let mut next = rapid(3, 105.0, 85.0);
    next.epoch = 1;
    rig.push(next);
    let mut events = Vec::new();
    while !events.iter().any(is_stopped) {
        events.extend(rig.cycle());
    }
    let position = MachinePosition(rig.position());
    close(position.0.0[0], 105.0);
    assert_eq!(events, [Event::Stopped { epoch: 1, position }]);
    // The rounding of the position at the stop is not reported as a jump.
    let events = rig.cycles(400);
    assert!(
        matches!(
            events[..],
            [
                Event::Started { segment: 3, .. },
                Event::Finished { segment: 3, .. }
            ]
        ),
        "{events:?}"
    );
    assert_eq!(rig.position(), vector(&[85.0]));
}

#[test]
fn stop_during_hold_and_at_rest_answers_at_once_and_ends_the_hold() {
    let mut rig = under_way();
    rig.control(Control::Hold);
    rig.until(is_held);
    rig.control(Control::Stop { epoch: 7 });
    let events = rig.cycle();
    assert!(
        matches!(events[..], [Event::Stopped { epoch: 7, .. }]),
        "{events:?}"
    );
    assert!(!rig.reading().held);
    assert!(rig.servo.channel(0).is_idle());
    rig.control(Control::Stop { epoch: 8 });
    assert!(matches!(rig.cycle()[..], [Event::Stopped { epoch: 8, .. }]));
    let x = rig.x();
    let mut next = rapid(2, x, x + 20.0);
    next.epoch = 8;
    rig.push(next);
    assert!(matches!(rig.cycle()[..], [Event::Started { segment: 2, .. }]));
}

#[test]
fn stop_goes_on_through_joints_while_it_decelerates() {
    let mut rig = Rig::new(&settings());
    for n in 0..20_u32 {
        let (from, to) = (f64::from(n), f64::from(n + 1));
        let mut short = line(u64::from(n) + 1, vector(&[from]), vector(&[to]), 50.0, 0.01);
        short.exact_stop = false;
        rig.push(short);
    }
    rig.cycles(100);
    rig.control(Control::Stop { epoch: 1 });
    rig.until(is_stopped);
    // Each block takes 0.03 s: after 0.1 s, 0.1 s at half speed on average.
    close(
        rig.x(),
        line(1, vector(&[6.0]), vector(&[7.0]), 50.0, 0.01)
            .position(0.199 - 0.18)
            .0[0],
    );
    assert!(rig.cycles(100).is_empty());
    assert!(
        rig.servo.channel(0).is_idle(),
        "the rest of the chain is thrown away"
    );
}

#[test]
fn abort_brakes_each_motor_at_its_maximum_acceleration() {
    let mut settings = settings();
    settings.motors[1].as_mut().unwrap().max_acceleration = 1000.0;
    let mut rig = Rig::new(&settings);
    // X at 60, Y at 80 mm/s; v^2/(2a): 3600/10000 and 6400/2000.
    rig.push(line(1, AxisVector::ZERO, vector(&[600.0, 800.0]), 100.0, 0.1));
    rig.push(rapid(2, 600.0, 0.0));
    rig.cycles(1051);
    rig.control(Control::Abort { epoch: 3 });
    let cycles = rig.until(is_stopped);
    assert!(
        (80..=81).contains(&cycles),
        "80 mm/s at 1000 mm/s^2 take 80 ms, not {cycles}"
    );
    close(rig.position().0[0], 60.0 + 0.36);
    close(rig.position().0[1], 80.0 + 3.2);
    assert!(rig.cycles(200).is_empty());
    assert!(rig.servo.channel(0).is_idle());
}

#[test]
fn abort_overrides_a_running_stop_and_reports_the_highest_epoch_once() {
    let mut rig = under_way();
    rig.control(Control::Stop { epoch: 4 });
    rig.cycles(100);
    // At half the rate: 50 mm/s, 50^2/10000.
    let x = rig.x();
    rig.control(Control::Abort { epoch: 3 });
    rig.control(Control::Resume);
    rig.control(Control::Hold);
    let events = rig.cycles(300);
    let position = MachinePosition(rig.position());
    assert_eq!(events, [Event::Stopped { epoch: 4, position }]);
    assert!((position.0.0[0] - x - 0.25).abs() < 0.02);
    assert!(!rig.reading().held);
}

#[test]
fn abort_at_rest_answers_in_the_same_cycle() {
    let mut rig = Rig::new(&settings());
    rig.control(Control::Abort { epoch: 1 });
    let position = MachinePosition::default();
    assert_eq!(rig.cycle(), [Event::Stopped { epoch: 1, position }]);
}

#[test]
fn a_hold_slew_of_zero_stops_at_once_if_the_motors_can() {
    let mut settings = settings();
    settings.hold_slew_ms = 0.0;
    for motor in settings.motors.iter_mut().flatten() {
        motor.max_acceleration = 1e12;
    }
    let mut rig = Rig::new(&settings);
    rig.push(line(1, AxisVector::ZERO, vector(&[1000.0]), 100.0, 0.1));
    rig.cycles(1001);
    let x = rig.x();
    rig.control(Control::Hold);
    assert!(matches!(rig.cycle()[..], [Event::Held { .. }]));
    assert!((rig.x() - x).abs() < 1e-7, "{}", rig.x() - x);
}

#[test]
fn s1i_single_block_rests_at_the_end_of_each_block_that_stops_there() {
    let mut rig = Rig::new(&settings());
    rig.push(line(1, AxisVector::ZERO, vector(&[10.0]), 50.0, 0.1));
    rig.push(rapid(2, 10.0, 30.0));
    // A second profile of the same block, as G28 has.
    rig.push(Profile {
        origin: origin(2),
        ..rapid(3, 30.0, 50.0)
    });
    rig.cycles(100);
    rig.control(Control::HoldAfterBlock(true));
    rig.until(is_held);
    close(rig.x(), 10.0);
    assert!(rig.cycles(500).is_empty());
    rig.control(Control::Resume);
    rig.control(Control::HoldAfterBlock(true));
    rig.until(is_held);
    close(rig.x(), 50.0);
}

#[test]
fn revoked_single_block_holds_nothing_and_a_hold_takes_precedence() {
    let mut rig = Rig::new(&settings());
    rig.push(line(1, AxisVector::ZERO, vector(&[10.0]), 50.0, 0.1));
    rig.push(rapid(2, 10.0, 30.0));
    rig.control(Control::HoldAfterBlock(true));
    rig.cycles(50);
    assert!(!rig.reading().held);
    rig.control(Control::HoldAfterBlock(false));
    rig.until(is_finished(2));
    assert!(!rig.reading().held);
    rig.push(rapid(3, 30.0, 60.0));
    rig.control(Control::HoldAfterBlock(true));
    rig.cycles(150);
    rig.control(Control::Hold);
    rig.until(is_held);
    assert!(rig.x() < 60.0, "the hold did not wait for the end of the block");
    rig.control(Control::HoldAfterBlock(false));
    assert!(rig.cycles(100).is_empty(), "only a resume ends a hold");
}
