//! The spindle through the channel.

use tandem_model::settings::CoordinateSystemSettings;
use tandem_servo::{Control, Event, SpindleDirection};

use crate::rig::{Rig, close, settings, spindle};

/// 4000 r/min at most, 1000 r/min per second, orientation at 60 r/min.
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
    // 0.06 s to 60 r/min, at most a turn of 1 s, 0.06 s to rest
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
