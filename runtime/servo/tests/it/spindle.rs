//! The spindle, controlled through a channel.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU16, Ordering::Relaxed};

use tandem_model::settings::CoordinateSystemSettings;
use tandem_servo::{
    Control, Event, Fault, Hardware, Orientation, Servo, SimulatedBus, Spindle, SpindleDirection,
    SpindleState, ThreadStep,
};

use crate::rig::{Rig, T, close, is_finished, is_stopped, rapid, settings, spindle};
use crate::tapping::{self, at_the_hole};

/// Returns settings with a spindle: 4000 r/min at most, 1000 r/min per second, orientation at 60 r/min.
fn with_spindle() -> CoordinateSystemSettings {
    CoordinateSystemSettings {
        spindle: Some(spindle()),
        ..settings()
    }
}

fn command(direction: SpindleDirection, rpm: f64) -> Control {
    Control::Spindle { direction, rpm }
}

#[test]
fn the_spindle_turns_as_commanded_also_under_hold_and_after_a_stop() {
    let mut rig = Rig::new(&with_spindle());
    rig.control(command(SpindleDirection::Cw, 500.0));
    rig.control(Control::Hold);
    rig.cycles(250);
    close(rig.reading().spindle_rpm, 250.0);
    rig.control(Control::Stop { epoch: 1 });
    rig.cycles(250);
    close(rig.reading().spindle_rpm, 500.0);
    rig.control(command(SpindleDirection::Ccw, 100.0));
    rig.cycles(600);
    close(rig.reading().spindle_rpm, -100.0);
}

#[test]
fn orientation_is_told_once_for_each_command() {
    let mut rig = Rig::new(&with_spindle());
    rig.control(command(SpindleDirection::Orient, 0.0));
    // 0.06 s to 60 r/min, at most a turn of 1 s, 0.06 s to rest.
    assert!(rig.until(|event| *event == Event::Oriented) <= 1200);
    assert!(rig.reading().oriented);
    close(rig.reading().spindle_rpm, 0.0);
    assert!(rig.cycles(100).is_empty());
    rig.control(command(SpindleDirection::Orient, 0.0));
    assert_eq!(rig.cycle(), [Event::Oriented]);
    rig.control(command(SpindleDirection::Cw, 100.0));
    rig.cycle();
    assert!(!rig.reading().oriented);
}

/// Number of cycles until the spindle's drive has power.
const POWER_UP: u32 = 5;

/// Switches by which a test changes the spindle's drive, and its observed commands.
#[derive(Debug, Default)]
struct SpindleSwitches {
    /// Fault of the drive. Clearing ends the fault, unless `fault_stays`.
    fault: AtomicU16,
    fault_stays: AtomicBool,
    has_no_supply: AtomicBool,
    enabled: AtomicBool,
    is_steady: AtomicBool,
}

/// A drive that follows each command at once while it has power.
#[derive(Debug, Default)]
struct Drive {
    switches: Arc<SpindleSwitches>,
    powered: u32,
    rpm: f64,
    orients: bool,
}

impl Drive {
    fn has_power(&self) -> bool {
        self.powered > POWER_UP
    }
}

impl Spindle for Drive {
    fn power(&mut self, enable: bool, clear_fault: bool) {
        self.switches.enabled.store(enable, Relaxed);
        if clear_fault && !self.switches.fault_stays.load(Relaxed) {
            self.switches.fault.store(0, Relaxed);
        }
    }

    fn command(&mut self, direction: SpindleDirection, rpm: f64) {
        assert!(
            self.has_power() || direction == SpindleDirection::Stop,
            "{direction:?} without power"
        );
        self.orients = direction == SpindleDirection::Orient;
        self.rpm = match direction {
            SpindleDirection::Cw => rpm,
            SpindleDirection::Ccw => -rpm,
            SpindleDirection::Stop | SpindleDirection::Orient => 0.0,
        };
    }

    fn follow(&mut self, step: ThreadStep) {
        assert!(self.has_power() || matches!(step, ThreadStep::End { .. }));
    }

    fn cycle(&mut self) -> SpindleState {
        let switches = &self.switches;
        let is_supplied = switches.fault.load(Relaxed) == 0 && !switches.has_no_supply.load(Relaxed);
        self.powered = if is_supplied && switches.enabled.load(Relaxed) {
            self.powered + 1
        } else {
            0
        };
        self.state()
    }

    fn state(&self) -> SpindleState {
        SpindleState {
            rpm: if self.has_power() { self.rpm } else { 0.0 },
            orientation: if self.orients {
                Orientation::Reached
            } else {
                Orientation::Open
            },
            rests: self.rpm == 0.0,
            is_steady: self.switches.is_steady.load(Relaxed),
            is_enabled: self.has_power(),
            fault: self.switches.fault.load(Relaxed),
            ..SpindleState::default()
        }
    }
}

fn rig_with_drive(settings: &CoordinateSystemSettings) -> (Rig, Arc<SpindleSwitches>) {
    let drive = Drive::default();
    let switches = Arc::clone(&drive.switches);
    let bus = SimulatedBus::new([settings]);
    let hardware = Hardware {
        at_start: bus.feedback(),
        bus: Box::new(bus),
        spindles: vec![Some(Box::new(drive))],
    };
    let (servo, mut handles) = Servo::new(&[(settings, 64)], T, hardware);
    let handle = handles.remove(0);
    (Rig { servo, handle }, switches)
}

/// Creates a rig in which the spindle turns, and X moves at 100 mm/s.
fn moving() -> (Rig, Arc<SpindleSwitches>) {
    let (mut rig, switches) = rig_with_drive(&with_spindle());
    rig.control(command(SpindleDirection::Cw, 500.0));
    rig.cycles(20);
    rig.push(rapid(1, 0.0, 100.0));
    rig.cycles(300);
    (rig, switches)
}

#[test]
fn a_spindle_is_enabled_before_it_turns_and_the_command_waits_for_it() {
    let (mut rig, switches) = rig_with_drive(&with_spindle());
    rig.cycles(10);
    assert!(!switches.enabled.load(Relaxed), "nothing is to turn");
    rig.control(command(SpindleDirection::Stop, 0.0));
    rig.cycles(10);
    assert!(!switches.enabled.load(Relaxed), "a stop needs no power");
    rig.control(command(SpindleDirection::Ccw, 300.0));
    rig.cycles(POWER_UP);
    close(rig.reading().spindle_rpm, 0.0);
    assert!(!rig.servo.channel(0).is_idle());
    rig.cycles(2);
    close(rig.reading().spindle_rpm, -300.0);
    assert!(switches.enabled.load(Relaxed));
}

#[test]
fn the_last_of_several_commands_counts_when_the_spindle_has_power() {
    for (last, rpm) in [(SpindleDirection::Ccw, -200.0), (SpindleDirection::Stop, 0.0)] {
        let (mut rig, _) = rig_with_drive(&with_spindle());
        rig.control(command(SpindleDirection::Cw, 300.0));
        rig.cycle();
        rig.control(command(last, 200.0));
        rig.cycles(20);
        close(rig.reading().spindle_rpm, rpm);
    }
}

#[test]
fn a_spindle_that_is_not_enabled_in_time_is_a_fault() {
    let (mut rig, switches) = rig_with_drive(&with_spindle());
    switches.has_no_supply.store(true, Relaxed);
    rig.control(command(SpindleDirection::Cw, 300.0));
    assert!(rig.cycles(1990).is_empty());
    let events = rig.cycles(200);
    let [Event::Fault(fault @ Fault::NotEnabled { motor: 5, axis: None })] = events[..] else {
        panic!("{events:?}")
    };
    assert_eq!(fault.alarm().entry.number, 207);
    assert_eq!(fault.alarm().text, "The drive of motor 5 (spindle) has no power");
    assert!(!switches.enabled.load(Relaxed));
    // The pending command is discarded together with the power.
    switches.has_no_supply.store(false, Relaxed);
    assert!(rig.cycles(100).is_empty());
    close(rig.reading().spindle_rpm, 0.0);
}

#[test]
fn p11_fault_of_a_spindle_at_rest_is_reported_in_that_cycle() {
    for (is_steady, was_commanded) in [(false, false), (true, false), (false, true), (true, true)] {
        let (mut rig, switches) = rig_with_drive(&with_spindle());
        switches.is_steady.store(is_steady, Relaxed);
        if was_commanded {
            rig.control(command(SpindleDirection::Cw, 500.0));
            rig.cycles(20);
            rig.control(command(SpindleDirection::Stop, 0.0));
        }
        rig.cycles(1000);
        switches.fault.store(0x7305, Relaxed);
        let events = rig.cycle();
        assert!(
            matches!(
                events[..],
                [Event::Fault(Fault::DriveFault {
                    motor: 5,
                    axis: None,
                    code: 0x7305
                })]
            ),
            "{is_steady} {was_commanded}: {events:?}"
        );
        assert!(!switches.enabled.load(Relaxed), "it has no power");
        assert!(rig.cycles(1000).is_empty(), "it is reported once");
        rig.control(Control::ResetDrives);
        rig.control(Control::Stop { epoch: 1 });
        assert!(rig.cycle().iter().any(is_stopped));
        assert!(rig.cycles(20).is_empty());
        assert!(switches.enabled.load(Relaxed), "the reset has cleared the fault");
    }
}

#[test]
fn p11_spindle_fault_before_the_first_motion_enables_no_axis() {
    let (mut rig, switches) = rig_with_drive(&with_spindle());
    rig.cycles(10);
    switches.fault.store(1, Relaxed);
    assert!(matches!(
        rig.cycle()[..],
        [Event::Fault(Fault::DriveFault { .. })]
    ));
    rig.push(rapid(1, 0.0, 100.0));
    assert!(rig.cycles(100).is_empty());
    close(rig.x(), 0.0);
}

#[test]
fn spindle_fault_brakes_motors_and_reset_clears_it_and_enables_at_rest() {
    let (mut rig, switches) = moving();
    let from_x = rig.x();
    switches.fault.store(0x7305, Relaxed);
    let events = rig.cycles(200);
    let [
        Event::Fault(
            fault @ Fault::DriveFault {
                motor: 5,
                axis: None,
                code: 0x7305,
            },
        ),
    ] = events[..]
    else {
        panic!("{events:?}")
    };
    assert_eq!(fault.alarm().entry.number, 205);
    assert!(!switches.enabled.load(Relaxed));
    // One cycle at 100 mm/s until the fault is detected; then 100^2 / (2 * 5000) mm.
    close(rig.x(), from_x + 100.0 * T + 1.0);
    rig.control(command(SpindleDirection::Cw, 500.0));
    let again = rig.cycles(10);
    assert!(
        matches!(again[..], [Event::Fault(Fault::DriveFault { axis: None, .. })]),
        "no power until a reset: {again:?}"
    );
    rig.control(Control::ResetDrives);
    rig.control(Control::Stop { epoch: 1 });
    assert!(rig.cycle().iter().any(is_stopped));
    assert!(rig.cycles(20).is_empty());
    assert!(switches.enabled.load(Relaxed));
    close(rig.reading().spindle_rpm, 0.0);
    rig.control(command(SpindleDirection::Cw, 500.0));
    rig.cycle();
    close(rig.reading().spindle_rpm, 500.0);
    let mut next = rapid(2, rig.x(), 0.0);
    next.epoch = 1;
    rig.push(next);
    rig.until(is_finished(2));
}

#[test]
fn a_fault_of_the_spindle_that_a_reset_does_not_clear_is_told_again() {
    let (mut rig, switches) = moving();
    switches.fault.store(1, Relaxed);
    switches.fault_stays.store(true, Relaxed);
    rig.cycles(200);
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

#[test]
fn a_turning_spindle_that_loses_power_is_a_fault() {
    let (mut rig, switches) = moving();
    switches.has_no_supply.store(true, Relaxed);
    let events = rig.cycle();
    assert!(
        matches!(events[..], [Event::Fault(Fault::NotEnabled { axis: None, .. })]),
        "{events:?}"
    );
}

#[test]
fn a_thread_begins_when_the_spindle_has_power() {
    let settings = tapping::with_spindle();
    let (mut rig, switches) = rig_with_drive(&settings);
    at_the_hole(&mut rig, 15.0);
    assert!(!switches.enabled.load(Relaxed));
    rig.until(is_finished(4));
    assert!(switches.enabled.load(Relaxed));
}
