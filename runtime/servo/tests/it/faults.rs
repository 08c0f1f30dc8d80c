//! Faults, and the limits of the rings.

use tandem_model::profile::Law;
use tandem_model::{Axis, AxisVector};
use tandem_servo::{
    CONTROLS_MAX, Command, Control, CycleResult, DriveBus, EVENTS_MAX, Event, Fault, Feedback,
    SpindleDirection,
};

use crate::rig::{Rig, T, close, dwell, is_stopped, rapid, settings, vector};

/// A bus whose second motor always stays half a millimetre behind.
#[derive(Debug)]
struct StuckMotorBus;

impl DriveBus for StuckMotorBus {
    fn exchange(&mut self, commands: &[Command], feedback: &mut [Feedback]) -> CycleResult {
        for (command, feedback) in commands.iter().zip(&mut *feedback) {
            feedback.position = command.position;
        }
        feedback[1].position -= 0.5;
        CycleResult::OnTime
    }
}

fn fault(events: &[Event]) -> Fault {
    match events {
        [Event::Fault(fault)] => *fault,
        other => panic!("not one fault: {other:?}"),
    }
}

#[test]
fn s1c_motor_not_in_position_after_its_timeout_is_a_fault() {
    let mut rig = Rig::on_bus(&settings(), StuckMotorBus);
    rig.push(dwell(1, AxisVector::ZERO, 0.1));
    rig.push(dwell(2, AxisVector::ZERO, 0.1));
    rig.cycles(101);
    assert!(rig.cycles(1999).is_empty());
    let fault = fault(&rig.cycle());
    let Fault::InPositionTimeout {
        motor: 12,
        axis: Axis::Y,
        following_error,
    } = fault
    else {
        panic!("{fault:?}");
    };
    close(following_error, 0.5);
    let alarm = fault.alarm();
    assert_eq!(alarm.entry.number, 200);
    assert!(
        alarm.text.contains("12") && alarm.text.contains('Y'),
        "{}",
        alarm.text
    );
    assert!(rig.cycles(100).is_empty(), "nothing starts");
    rig.control(Control::Stop { epoch: 1 });
    assert!(matches!(rig.cycle()[..], [Event::Stopped { epoch: 1, .. }]));
    let mut next = dwell(3, AxisVector::ZERO, 0.1);
    next.epoch = 1;
    rig.push(next);
    assert!(matches!(rig.cycle()[..], [Event::Started { segment: 3, .. }]));
}

#[test]
fn a_profile_that_does_not_begin_where_the_machine_is_never_moves() {
    for start in [5.0, f64::NAN] {
        let mut rig = Rig::new(&settings());
        rig.push(dwell(1, vector(&[0.0, start]), 0.1));
        let fault = fault(&rig.cycle());
        assert!(
            matches!(
                fault,
                Fault::PositionJump {
                    motor: 12,
                    axis: Axis::Y,
                    ..
                }
            ),
            "{fault:?}"
        );
        assert_eq!(fault.alarm().entry.number, 202);
        assert!(rig.cycles(100).is_empty());
        assert_eq!(rig.position(), AxisVector::ZERO);
        rig.control(Control::Abort { epoch: 1 });
        assert!(rig.cycle().iter().any(is_stopped));
    }
}

#[test]
fn a_position_that_is_not_a_number_reaches_no_drive() {
    let mut rig = Rig::new(&settings());
    let mut broken = rapid(1, 0.0, 30.0);
    let Law::Motors { moves, .. } = &mut broken.law else {
        panic!("a rapid moves motors");
    };
    moves[0].velocity = f64::NAN;
    rig.push(broken);
    let events = rig.cycles(10);
    assert!(
        matches!(
            events[..],
            [
                Event::Started { .. },
                Event::Fault(Fault::PositionJump {
                    motor: 11,
                    axis: Axis::X,
                    ..
                })
            ]
        ),
        "{events:?}"
    );
    assert_eq!(rig.position(), AxisVector::ZERO);
}

#[test]
fn a_spindle_command_without_a_spindle_is_a_fault() {
    let mut rig = Rig::new(&settings());
    rig.control(Control::Spindle {
        direction: SpindleDirection::Cw,
        rpm: 100.0,
    });
    let fault = fault(&rig.cycle());
    assert_eq!(fault, Fault::SpindleMissing);
    assert_eq!(fault.alarm().entry.number, 203);
}

#[test]
fn the_rings_refuse_what_is_beyond_their_limits() {
    let Rig { mut handle, .. } = Rig::with_room(&settings(), 3);
    for n in 1..=3 {
        handle.profiles.push(rapid(n, 0.0, 1.0)).unwrap();
    }
    assert!(handle.profiles.push(rapid(4, 0.0, 1.0)).is_err());
    for _ in 0..CONTROLS_MAX {
        handle.controls.push(Control::Hold).unwrap();
    }
    assert!(handle.controls.push(Control::Hold).is_err());
}

#[test]
fn no_event_of_a_stop_is_lost_when_nobody_reads_for_a_long_time() {
    let Rig {
        mut servo,
        mut handle,
    } = Rig::with_room(&settings(), 8);
    let mut pushed = 0_u64;
    // Twice the number of events that the ring holds, without a reader.
    for _ in 0..40_000 {
        if pushed < EVENTS_MAX as u64
            && handle
                .profiles
                .push(dwell(pushed + 1, AxisVector::ZERO, T))
                .is_ok()
        {
            pushed += 1;
        }
        servo.cycle();
    }
    assert!(!servo.channel(0).is_idle(), "the channel waits for its reader");
    let mut finished = 0;
    for _ in 0..40_000 {
        while let Ok(event) = handle.events.pop() {
            if let Event::Finished { segment, .. } = event {
                finished += 1;
                assert_eq!(segment, finished);
            }
        }
        if pushed < EVENTS_MAX as u64
            && handle
                .profiles
                .push(dwell(pushed + 1, AxisVector::ZERO, T))
                .is_ok()
        {
            pushed += 1;
        }
        servo.cycle();
    }
    assert_eq!(finished, EVENTS_MAX as u64);
}

#[test]
fn a_ring_full_of_old_profiles_empties_in_few_cycles() {
    let Rig {
        mut servo,
        mut handle,
    } = Rig::with_room(&settings(), 1000);
    handle.controls.push(Control::Stop { epoch: 1 }).unwrap();
    servo.cycle();
    for n in 0..1000 {
        handle.profiles.push(rapid(n + 1, 0.0, 1.0)).unwrap();
    }
    for _ in 0..16 {
        servo.cycle();
    }
    assert!(servo.channel(0).is_idle());
    assert_eq!(servo.channel(0).setpoint(), AxisVector::ZERO);
}
