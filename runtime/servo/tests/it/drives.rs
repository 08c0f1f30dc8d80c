//! Drives that must be enabled, drives that fail, and a bus that loses frames.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU16, AtomicU32, Ordering::Relaxed};

use tandem_model::{Axis, AxisSet, AxisVector};
use tandem_servo::{
    BusCounts, Command, Control, CycleResult, DriveBus, Event, Fault, Feedback, Hardware, Servo,
};

use crate::rig::{Rig, T, close, dwell, is_finished, is_stopped, rapid, settings, vector};

/// Number of cycles until a drive has power.
const POWER_UP: u32 = 5;

/// Switches by which a test changes the drives, and their observed commands.
#[derive(Debug, Default)]
struct DriveSwitches {
    /// Number of frames that the bus still loses; `late` is the number that it still delivers late.
    lose: AtomicU32,
    late: AtomicU32,
    /// Fault of the second motor. Clearing ends the fault, unless `fault_stays`.
    fault: AtomicU16,
    fault_stays: AtomicBool,
    has_no_supply: AtomicBool,
    enabled: AtomicBool,
    /// Homed state that all motors report; initially the state at the start.
    is_homed: AtomicBool,
}

/// Ideal drives.
#[derive(Debug)]
struct Bus {
    switches: Arc<DriveSwitches>,
    powered: u32,
}

impl DriveBus for Bus {
    fn exchange(&mut self, commands: &[Command], feedback: &mut [Feedback]) -> CycleResult {
        let switches = &self.switches;
        let take = |count: &AtomicU32| count.fetch_update(Relaxed, Relaxed, |n| n.checked_sub(1)).is_ok();
        if take(&switches.lose) {
            return CycleResult::Lost;
        }
        let enable = commands.iter().all(|command| command.enable);
        switches.enabled.store(enable, Relaxed);
        if commands[1].clear_fault && !switches.fault_stays.load(Relaxed) {
            switches.fault.store(0, Relaxed);
        }
        let fault = switches.fault.load(Relaxed);
        self.powered = if enable && fault == 0 && !switches.has_no_supply.load(Relaxed) {
            self.powered + 1
        } else {
            0
        };
        for (command, feedback) in commands.iter().zip(&mut *feedback) {
            feedback.is_homed = switches.is_homed.load(Relaxed);
            feedback.is_enabled = self.powered > POWER_UP;
            if feedback.is_enabled {
                feedback.position = command.position;
            }
        }
        feedback[1].fault = fault;
        if take(&switches.late) {
            CycleResult::Late
        } else {
            CycleResult::OnTime
        }
    }
}

/// Creates a rig with drives that have this report at the start.
fn rig_with(at_start: Feedback) -> (Rig, Arc<DriveSwitches>) {
    let switches = Arc::<DriveSwitches>::default();
    switches.is_homed.store(at_start.is_homed, Relaxed);
    let bus = Bus {
        switches: Arc::clone(&switches),
        powered: 0,
    };
    let hardware = Hardware {
        bus: Box::new(bus),
        at_start: vec![at_start; 3],
        spindles: vec![],
    };
    let (servo, mut handles) = Servo::new(&[(&settings(), 64)], T, hardware);
    let handle = handles.remove(0);
    (Rig { servo, handle }, switches)
}

fn rig() -> (Rig, Arc<DriveSwitches>) {
    rig_with(Feedback {
        is_enabled: false,
        ..Feedback::following(0.0)
    })
}

/// Creates a rig that moves at 100 mm/s.
fn moving() -> (Rig, Arc<DriveSwitches>) {
    let (mut rig, switches) = rig();
    rig.push(rapid(1, 0.0, 100.0));
    rig.until(|event| matches!(event, Event::Started { .. }));
    assert!(rig.cycles(300).is_empty());
    (rig, switches)
}

/// Brings the motion to rest, and returns the reported faults.
fn faults_until_rest(rig: &mut Rig) -> Vec<Fault> {
    let events = rig.cycles(200);
    let faults = events.iter().map(|event| match event {
        Event::Fault(fault) => *fault,
        other => panic!("{other:?}"),
    });
    faults.collect()
}

/// Stops without a reset of the drives, and returns the events of the first cycle of the next motion.
fn next_motion_after_stop(rig: &mut Rig) -> Vec<Event> {
    rig.control(Control::Stop { epoch: 1 });
    assert!(rig.cycle().iter().any(is_stopped));
    let mut next = dwell(2, rig.position(), 0.1);
    next.epoch = 1;
    rig.push(next);
    rig.cycle()
}

#[test]
fn drives_are_enabled_before_the_first_motion_and_it_waits_for_them() {
    let (mut rig, switches) = rig();
    rig.cycles(10);
    assert!(!switches.enabled.load(Relaxed), "nothing is to move");
    rig.push(rapid(1, 0.0, 20.0));
    assert_eq!(
        rig.until(|event| matches!(event, Event::Started { .. })),
        POWER_UP + 2
    );
    rig.until(is_finished(1));
    close(rig.x(), 20.0);
    rig.cycles(1000);
    assert!(switches.enabled.load(Relaxed), "they hold the machine");
}

#[test]
fn a_drive_that_does_not_come_to_power_in_time_is_a_fault() {
    let (mut rig, switches) = rig();
    switches.has_no_supply.store(true, Relaxed);
    rig.push(rapid(1, 0.0, 20.0));
    assert!(rig.cycles(1990).is_empty());
    let events = rig.cycles(200);
    let [Event::Fault(fault)] = events[..] else {
        panic!("{events:?}")
    };
    assert!(
        matches!(
            fault,
            Fault::NotEnabled {
                motor: 11,
                axis: Some(Axis::X)
            }
        ),
        "{fault:?}"
    );
    assert_eq!(fault.alarm().entry.number, 207);
    assert!(!switches.enabled.load(Relaxed));
    assert_eq!(rig.position(), AxisVector::ZERO);
}

#[test]
fn a_motor_that_is_not_homed_gets_no_power() {
    let (mut rig, switches) = rig_with(Feedback::default());
    rig.push(rapid(1, 0.0, 20.0));
    let events = rig.cycles(100);
    let [Event::Fault(fault)] = events[..] else {
        panic!("{events:?}")
    };
    assert_eq!(fault.alarm().entry.number, 208);
    assert!(!switches.enabled.load(Relaxed));
}

#[test]
fn p11_fault_before_the_first_motion_is_reported_once_without_power() {
    let faulty = |switches: &DriveSwitches| switches.fault.store(0x7305, Relaxed);
    let lost = |switches: &DriveSwitches| switches.lose.store(u32::MAX, Relaxed);
    for (break_it, alarm) in [(faulty as fn(&DriveSwitches), 205), (lost, 206)] {
        let (mut rig, switches) = rig();
        rig.cycles(10);
        break_it(&switches);
        let events = rig.cycles(100);
        let [Event::Fault(fault)] = events[..] else {
            panic!("{events:?}")
        };
        assert_eq!(fault.alarm().entry.number, alarm);
        assert!(!switches.enabled.load(Relaxed));
        assert!(rig.cycles(1000).is_empty(), "it is reported once");
        let again = next_motion_after_stop(&mut rig);
        assert!(matches!(again[..], [Event::Fault(_)]), "{again:?}");
        rig.cycles(10);
        assert!(!switches.enabled.load(Relaxed), "no power until a reset");
        assert_eq!(rig.position(), AxisVector::ZERO);
    }
}

#[test]
fn a_motor_that_is_homed_at_rest_is_told_in_that_cycle() {
    let at_start = Feedback {
        is_enabled: false,
        ..Feedback::default()
    };
    let (mut rig, switches) = rig_with(at_start);
    assert_eq!(rig.reading().homed, AxisSet::EMPTY);
    rig.cycles(10);
    switches.is_homed.store(true, Relaxed);
    rig.cycles(1);
    let axes: Vec<Axis> = rig.reading().homed.iter().collect();
    assert_eq!(axes, [Axis::X, Axis::Y, Axis::Z]);
    switches.is_homed.store(false, Relaxed);
    rig.cycles(1);
    assert_eq!(rig.reading().homed, AxisSet::EMPTY);
}

#[test]
fn one_frame_lost_or_late_changes_nothing_and_is_counted() {
    let (mut rig, switches) = moving();
    let (mut other, _) = moving();
    for _ in 0..10 {
        switches.lose.store(2, Relaxed);
        assert!(rig.cycles(3).is_empty());
        switches.late.store(1, Relaxed);
        rig.cycle();
    }
    other.cycles(40);
    assert_eq!(rig.position(), other.position());
    assert_eq!(rig.reading(), other.reading());
    assert_eq!(rig.servo.bus_counts(), BusCounts { late: 10, lost: 20 });
    rig.until(is_finished(1));
    close(rig.x(), 100.0);
}

#[test]
fn frames_lost_in_a_row_bring_the_machine_to_rest_with_a_fault_told_once() {
    let (mut rig, switches) = moving();
    let from_x = rig.x();
    switches.lose.store(u32::MAX, Relaxed);
    let faults = faults_until_rest(&mut rig);
    assert_eq!(faults, [Fault::BusLost { cycles: 3 }]);
    assert_eq!(faults[0].alarm().entry.number, 206);
    // Three cycles at 100 mm/s until the fault is detected; then 100^2 / (2 * 5000) mm.
    close(rig.x(), from_x + 3.0 * 100.0 * T + 1.0);
    let again = next_motion_after_stop(&mut rig);
    assert!(
        matches!(again[..], [Event::Fault(Fault::BusLost { .. })]),
        "{again:?}"
    );
    switches.lose.store(0, Relaxed);
    rig.cycle();
    assert!(!switches.enabled.load(Relaxed), "no power until a reset");
}

#[test]
fn drive_fault_stops_the_channel_and_reset_enables_at_actual_position() {
    let (mut rig, switches) = moving();
    switches.fault.store(0x7305, Relaxed);
    let faults = faults_until_rest(&mut rig);
    let [
        fault @ Fault::DriveFault {
            motor: 12,
            axis: Some(Axis::Y),
            code: 0x7305,
        },
    ] = faults[..]
    else {
        panic!("{faults:?}")
    };
    assert_eq!(fault.alarm().entry.number, 205);
    assert!(fault.alarm().text.contains("16#7305"));
    assert!(!switches.enabled.load(Relaxed), "at rest without power");
    // Without a reset the next motion finds the same fault, and does not begin.
    let again = next_motion_after_stop(&mut rig);
    assert!(
        matches!(again[..], [Event::Fault(Fault::DriveFault { .. })]),
        "{again:?}"
    );
    let stands = rig.reading().actual.0;
    assert!(
        stands.0[0] < rig.x(),
        "the motors lost power before the command was at rest"
    );
    rig.control(Control::ResetDrives);
    rig.control(Control::Stop { epoch: 2 });
    let stopped = rig.cycle();
    assert!(
        matches!(stopped[..], [Event::Stopped { epoch: 2, position }] if position.0 == stands),
        "{stopped:?}"
    );
    assert!(rig.cycles(20).is_empty());
    assert!(switches.enabled.load(Relaxed));
    let mut next = rapid(3, stands.0[0], 0.0);
    next.epoch = 2;
    rig.push(next);
    rig.until(is_finished(3));
    assert_eq!(rig.position(), vector(&[0.0]));
}

#[test]
fn a_fault_that_a_reset_does_not_clear_is_told_again() {
    let (mut rig, switches) = moving();
    switches.fault.store(1, Relaxed);
    switches.fault_stays.store(true, Relaxed);
    assert_eq!(faults_until_rest(&mut rig).len(), 1);
    rig.control(Control::ResetDrives);
    rig.control(Control::Stop { epoch: 1 });
    assert!(rig.cycle().iter().any(is_stopped));
    assert!(rig.cycles(1990).is_empty());
    let events = rig.cycles(1000);
    assert!(
        matches!(events[..], [Event::Fault(Fault::DriveFault { code: 1, .. })]),
        "{events:?}"
    );
}
