//! Cycles that change nothing pass at once, and leave what as many counted cycles leave.

use tandem_model::settings::CoordinateSystemSettings;
use tandem_servo::{Control, Event, SpindleDirection};

use crate::rig::{Rig, rapid, settings, spindle};

/// Drives with a lag, and a spindle of 1000 r/min per second.
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

#[test]
fn passing_cycles_leaves_what_counting_them_leaves() {
    let (mut passing, mut counting) = (Rig::new(&machine()), Rig::new(&machine()));
    for rig in [&mut passing, &mut counting] {
        rig.push(rapid(1, 0.0, 20.0));
        let (direction, rpm) = (SpindleDirection::Cw, 333.0);
        rig.control(Control::Spindle { direction, rpm });
    }
    let mut quiet_after = 0;
    while passing.servo.pass(12_345) == 0 {
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
    // the angle of the spindle decides how long its orientation takes
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
    assert_eq!(rig.servo.pass(10), 10);
    rig.control(Control::Hold);
    assert_eq!(rig.servo.pass(10), 0, "a control waits");
    rig.cycles(2);
    assert_eq!(rig.servo.pass(10), 10, "held at rest");
    rig.push(rapid(1, 0.0, 20.0));
    assert_eq!(rig.servo.pass(10), 0, "a profile waits");
}
