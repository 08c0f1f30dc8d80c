//! Late cycles: moving channels are held from their present position, within the limits of the motors at that
//! time.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use tandem_model::AxisVector;
use tandem_servo::{Command, Control, CycleResult, DriveBus, Event, Feedback};

use crate::rig::{Rig, T, close, dwell, is_finished, is_stopped, line, rapid, settings, vector};
use crate::tapping::{at_the_hole, with_spindle};

/// `max_acceleration` of the motors, mm/s^2.
const A_MAX: f64 = 5000.0;

fn is_held(event: &Event) -> bool {
    matches!(event, Event::Held { .. })
}

/// Drives that stop when no commands arrive.
#[derive(Debug, Default)]
struct Drives {
    heard: Arc<AtomicU64>,
}

impl DriveBus for Drives {
    fn exchange(&mut self, commands: &[Command], feedback: &mut [Feedback]) -> CycleResult {
        for (command, feedback) in commands.iter().zip(feedback) {
            *feedback = Feedback::following(command.position);
        }
        CycleResult::OnTime
    }

    fn heartbeat(&mut self, cycle: u64) {
        self.heard.store(cycle, Relaxed);
    }
}

fn on_drives() -> Rig {
    Rig::on_bus(&settings(), Drives::default())
}

/// Runs a cycle after `missed` cycles, and returns its events.
fn late(rig: &mut Rig, missed: u64) -> Vec<Event> {
    let told = rig.servo.cycle_after_missed(missed);
    let events: Vec<Event> = std::iter::from_fn(|| rig.handle.events.pop().ok()).collect();
    assert!(told || events.is_empty());
    events
}

/// Returns the largest change of X's velocity between cycles, per second, until such an event. The motors
/// start at the velocity `before`.
fn steepest(rig: &mut Rig, before: f64, wanted: impl Fn(&Event) -> bool) -> f64 {
    let (mut x, mut velocity, mut most) = (rig.x(), before, 0.0_f64);
    for _ in 0..100_000 {
        let events = rig.cycle();
        let now = (rig.x() - x) / T;
        most = most.max((now - velocity).abs() / T);
        (x, velocity) = (rig.x(), now);
        if events.iter().any(&wanted) {
            return most;
        }
    }
    panic!("the event never comes");
}

#[test]
fn late_servo_brakes_on_the_path_from_its_position_if_motors_keep_speed() {
    let mut rig = Rig::new(&settings());
    rig.push(line(1, AxisVector::ZERO, vector(&[1000.0]), 100.0, 0.1));
    rig.cycles(1001);
    close(rig.x(), 95.0);
    assert_eq!(late(&mut rig, 2000), [Event::Late { cycles: 2000 }]);
    assert!(
        rig.x() < 95.1 && rig.x() > 95.0,
        "the motion continues from its last position"
    );
    assert_eq!(rig.until(is_held), 199, "as by a feed hold of 0.2 s");
    close(rig.x(), 95.0 + 100.0 * 0.2 / 2.0);
    assert!(rig.cycles(500).is_empty(), "nothing continues without a resume");
    rig.control(Control::Resume);
    rig.until(is_finished(1));
    assert_eq!(rig.position(), vector(&[1000.0]));
}

#[test]
fn after_a_late_servo_stopped_motors_see_no_step_and_restart_from_rest() {
    for profile in [
        line(1, AxisVector::ZERO, vector(&[1000.0]), 100.0, 0.1),
        rapid(1, 0.0, 1000.0),
    ] {
        let mut rig = on_drives();
        rig.push(profile);
        rig.cycles(1002);
        let stood = rig.position();
        let events = late(&mut rig, 101);
        assert!(matches!(
            events[..],
            [Event::Late { cycles: 101 }, Event::Held { .. }]
        ));
        assert_eq!(rig.position(), stood, "no motion from a motor at rest");
        close(rig.reading().feedrate_mm_min, 0.0);
        assert!(rig.cycles(300).is_empty());
        assert_eq!(rig.position(), stood);
        rig.control(Control::Resume);
        let most = steepest(&mut rig, 0.0, is_finished(1));
        assert!(most <= A_MAX * (1.0 + 1e-6), "{most}");
        assert_eq!(rig.position(), vector(&[1000.0]));
    }
}

#[test]
fn a_servo_that_is_late_while_nothing_moves_holds_nothing() {
    let mut rig = on_drives();
    rig.cycles(10);
    assert!(late(&mut rig, 30_000).is_empty());
    rig.push(dwell(1, AxisVector::ZERO, 1.0));
    rig.push(line(2, AxisVector::ZERO, vector(&[10.0]), 50.0, 0.1));
    rig.cycles(100);
    assert!(late(&mut rig, 30_000).is_empty(), "a dwell");
    rig.cycles(1000);
    rig.control(Control::Hold);
    rig.until(is_held);
    assert!(late(&mut rig, 30_000).is_empty(), "a feed hold");
    rig.control(Control::Resume);
    rig.until(is_finished(2));
    rig.cycles(101);
    assert!(late(&mut rig, 30_000).is_empty(), "at rest for more than 0.1 s");
}

#[test]
fn p10_late_servo_at_a_reversal_holds_before_the_next_motion() {
    for cycles in [0, 1, 50, 100] {
        let mut rig = on_drives();
        rig.push(rapid(1, 0.0, 30.0));
        rig.until(is_finished(1));
        // The return path has not been passed to the servo.
        rig.cycles(cycles);
        let events = late(&mut rig, 100);
        assert!(
            matches!(events[..], [Event::Late { cycles: 100 }, Event::Held { .. }]),
            "{cycles}: {events:?}"
        );
        rig.push(rapid(2, 30.0, 0.0));
        assert!(rig.cycles(100).is_empty(), "{cycles}");
        rig.control(Control::Resume);
        rig.until(is_finished(2));
        close(rig.x(), 0.0);
    }
}

#[test]
fn p10_late_servo_in_any_cycle_of_a_stroke_holds() {
    let length = {
        let mut rig = on_drives();
        rig.push(rapid(1, 0.0, 5.0));
        rig.push(rapid(2, 5.0, 0.0));
        rig.until(is_finished(2))
    };
    for cycles in 0..length {
        let mut rig = on_drives();
        rig.push(rapid(1, 0.0, 5.0));
        rig.push(rapid(2, 5.0, 0.0));
        rig.cycles(cycles);
        let events = late(&mut rig, 100);
        assert!(
            events.contains(&Event::Late { cycles: 100 }),
            "{cycles}: {events:?}"
        );
        let at = rig.x();
        assert!(!rig.cycles(500).iter().any(is_finished(2)));
        assert!((rig.x() - at).abs() < 1.0);
    }
}

#[test]
fn between_two_blocks_of_motion_a_late_servo_holds_before_the_second() {
    let mut rig = on_drives();
    rig.push(rapid(1, 0.0, 30.0));
    rig.push(rapid(2, 30.0, 60.0));
    rig.until(is_finished(1));
    let events = late(&mut rig, 100);
    assert!(matches!(events[..], [Event::Late { .. }, Event::Held { .. }]));
    assert!(rig.cycles(100).is_empty());
    rig.control(Control::Resume);
    rig.until(is_finished(2));
    close(rig.x(), 60.0);
}

#[test]
fn what_brakes_already_rests_where_the_motors_rest_and_a_stop_is_answered() {
    for control in [Control::Abort { epoch: 1 }, Control::Stop { epoch: 1 }] {
        let mut rig = on_drives();
        rig.push(line(1, AxisVector::ZERO, vector(&[1000.0]), 100.0, 0.1));
        rig.cycles(1001);
        rig.control(control);
        rig.cycles(5);
        let stood = rig.position();
        let events = late(&mut rig, 500);
        assert!(matches!(
            events[..],
            [Event::Late { .. }, Event::Stopped { epoch: 1, .. }]
        ));
        assert_eq!(rig.position(), stood);
    }
}

#[test]
fn an_abort_behind_a_late_cycle_finds_motors_at_rest() {
    let mut rig = on_drives();
    rig.push(line(1, AxisVector::ZERO, vector(&[1000.0]), 100.0, 0.1));
    rig.cycles(1001);
    let stood = rig.position();
    rig.control(Control::Abort { epoch: 1 });
    assert!(late(&mut rig, 150).iter().any(is_stopped));
    assert_eq!(rig.position(), stood);
}

#[test]
fn late_again_while_it_comes_to_rest_is_told_and_holds_once() {
    let mut rig = Rig::new(&settings());
    rig.push(line(1, AxisVector::ZERO, vector(&[1000.0]), 100.0, 0.1));
    rig.cycles(1001);
    late(&mut rig, 100);
    rig.cycles(50);
    assert_eq!(late(&mut rig, 100), [Event::Late { cycles: 100 }]);
    rig.until(is_held);
    assert!(rig.cycles(100).is_empty());
}

#[test]
fn m1h_late_servo_in_a_thread_rests_where_it_stood_and_resumes() {
    let mut rig = Rig::on_bus(&with_spindle(), Drives::default());
    at_the_hole(&mut rig, 0.0);
    rig.cycles(1000);
    let stood = rig.position().0[2];
    assert!(stood < -5.5 && stood > -9.5, "{stood}");
    let events = late(&mut rig, 100);
    assert!(matches!(
        events[..],
        [Event::Late { cycles: 100 }, Event::Held { .. }]
    ));
    assert!(rig.cycles(1000).is_empty());
    close(rig.position().0[2], stood);
    rig.control(Control::Resume);
    rig.cycle();
    let first = stood - rig.position().0[2];
    assert!((0.0..0.5 * A_MAX * T * T).contains(&first), "from rest: {first}");
    rig.until(is_finished(4));
    close(rig.position().0[2], -5.0);
}

#[test]
fn bus_receives_a_heartbeat_in_each_executed_cycle_and_no_omitted_one() {
    let heard = Arc::default();
    let drives = Drives {
        heard: Arc::clone(&heard),
    };
    let mut rig = Rig::on_bus(&settings(), drives);
    for cycle in 1..=10 {
        rig.cycle();
        assert_eq!(heard.load(Relaxed), cycle, "at rest, too");
    }
    late(&mut rig, 1000);
    assert_eq!(heard.load(Relaxed), 11);
    let passed = rig.servo.cycles_to_pass(1000);
    rig.servo.pass(passed);
    assert!(passed > 0);
    assert_eq!(heard.load(Relaxed), 11 + passed);
}
