//! Tapping through the channel: the spindle in phase with Z in every cycle, holds that wait, stops (M1h).

use tandem_model::AxisVector;
use tandem_model::flow::TapLeg;
use tandem_model::profile::{Law, Profile};
use tandem_model::ramp::UnitRamp;
use tandem_model::settings::{CoordinateSystemSettings, MotorKind, MotorSettings};
use tandem_servo::{Control, Event, Fault, SpindleDirection};

use crate::rig::{Rig, T, close, dwell, is_finished, is_stopped, line, motor, origin, settings, vector};

const R: f64 = -5.0;
const DEPTH: f64 = -10.0;

/// S/F of F100 S300, revolutions per mm.
const PER_MM: f64 = 3.0;

/// Duration of 5 mm at F100 with ta 100, td 80, ts 50 ms: 3 s and half of both ramps.
const WAY_S: f64 = 3.0 + f64::midpoint(0.15, 0.13);

/// Time limit of a test, after which an expected event is missing.
const ENDLESS_S: f64 = 30.0;

pub fn with_spindle() -> CoordinateSystemSettings {
    CoordinateSystemSettings {
        spindle: Some(MotorSettings {
            kind: MotorKind::Spindle,
            max_velocity: 4000.0,
            max_acceleration: 3000.0,
            orientation_velocity: 600.0,
            orientation_position: 90.0,
            ..motor(5)
        }),
        ..settings()
    }
}

fn leg(segment: u64, from: f64, to: f64, revolutions: f64, leg: TapLeg) -> Profile {
    Profile {
        segment,
        epoch: 0,
        origin: origin(segment),
        law: Law::Tap {
            from: vector(&[0.0, 0.0, from]),
            to: vector(&[0.0, 0.0, to]),
            rate: 100.0 / 60.0 / 5.0,
            start: UnitRamp::new(0.1, 0.05),
            stop: UnitRamp::new(0.08, 0.05),
            revolutions,
            leg,
        },
        duration_s: WAY_S,
        exact_stop: true,
    }
}

/// Moves down to R and queues a move in, a wait of 0.5 s, a move out and a further move. The tool is at R at
/// return.
pub fn at_the_hole(rig: &mut Rig, turns: f64) {
    rig.push(line(1, AxisVector::ZERO, vector(&[0.0, 0.0, R]), 50.0, 0.05));
    rig.until(is_finished(1));
    rig.push(leg(2, R, DEPTH, turns, TapLeg::In));
    rig.push(dwell(3, vector(&[0.0, 0.0, DEPTH]), 0.5));
    rig.push(leg(4, DEPTH, R, -turns, TapLeg::Out));
    let (at, beside) = (vector(&[0.0, 0.0, R]), vector(&[10.0, 0.0, R]));
    rig.push(line(5, at, beside, 50.0, 0.05));
}

/// Orients the spindle, and then calls [`at_the_hole`].
fn oriented_at_the_hole(settings: &CoordinateSystemSettings, turns: f64) -> Rig {
    let mut rig = Rig::new(settings);
    if settings.spindle.is_some() {
        rig.control(Control::Spindle {
            direction: SpindleDirection::Orient,
            rpm: 0.0,
        });
        rig.until(|event| *event == Event::Oriented);
    }
    at_the_hole(&mut rig, turns);
    rig
}

/// Revolutions of the spindle since the tool was at R, from the angles of each cycle.
struct SpindleRevolutions {
    revolutions: f64,
    last_deg: f64,
}

impl SpindleRevolutions {
    fn new(rig: &Rig) -> Self {
        Self {
            revolutions: 0.0,
            last_deg: rig.reading().spindle_deg,
        }
    }

    /// Adds the angle of a cycle. The spindle must be in phase with Z within 1e-9 of a revolution.
    #[track_caller]
    fn check(&mut self, rig: &Rig, per_mm: f64) {
        let deg = rig.reading().spindle_deg;
        let step = (deg - self.last_deg + 540.0).rem_euclid(360.0) - 180.0;
        self.last_deg = deg;
        self.revolutions += step / 360.0;
        let expected = (R - rig.position().0[2]) * per_mm;
        let off = self.revolutions - expected;
        assert!(
            off.abs() <= 1e-9,
            "{} revolutions are not {expected}",
            self.revolutions
        );
    }
}

/// Returns the distance after `t`, from the formula of M1a with its ramps written out.
fn way(t: f64) -> f64 {
    let p = |t: f64, ta: f64, ts: f64| {
        let cut = |x: f64| x.max(0.0).powi(3);
        if t > ta + ts {
            t - f64::midpoint(ta, ts)
        } else {
            (cut(t) - cut(t - ta) - cut(t - ts)) / (6.0 * ta * ts)
        }
    };
    let stop = if t >= WAY_S { 0.13 } else { t - (WAY_S - 0.13) };
    100.0 / 60.0 * (p(t.min(WAY_S), 0.1, 0.05) - p(stop, 0.08, 0.05))
}

#[test]
fn m1h_spindle_is_in_phase_with_z_in_every_cycle_with_ramps_and_dwell() {
    for sense in [1.0, -1.0] {
        let mut rig = oriented_at_the_hole(&with_spindle(), 15.0 * sense);
        let mut turned = SpindleRevolutions::new(&rig);
        let mut events = rig.cycle();
        for k in 0..=3140 {
            close(rig.position().0[2], R - way(f64::from(k) * T));
            turned.check(&rig, PER_MM * sense);
            events = rig.cycle();
        }
        close(turned.revolutions, 15.0 * sense);
        assert!(
            matches!(events[..], [Event::Started { segment: 3, .. }]),
            "{events:?}"
        );
        for _ in 0..500 {
            turned.check(&rig, PER_MM * sense);
            close(rig.position().0[2], DEPTH);
            close(rig.reading().spindle_rpm, 0.0);
            assert!(!rig.reading().oriented);
            rig.cycle();
        }
        rig.cycle();
        for k in 0..=3140 {
            close(rig.position().0[2], DEPTH + way(f64::from(k) * T));
            turned.check(&rig, PER_MM * sense);
            if (500..2500).contains(&k) {
                close(rig.reading().spindle_rpm, -300.0 * sense);
            }
            rig.cycle();
        }
        close(turned.revolutions, 0.0);
        assert!(rig.reading().oriented, "back where M19 has put it");
        close(rig.reading().spindle_deg, 90.0);
    }
}

#[test]
fn m1h_overrides_do_not_act_on_a_thread() {
    let mut rig = oriented_at_the_hole(&with_spindle(), 15.0);
    rig.control(Control::Override {
        feed: 0.5,
        rapid: 0.1,
    });
    rig.cycle();
    assert_eq!(rig.until(is_finished(2)), 3140);
}

#[test]
fn m1i_a_hold_in_the_thread_comes_after_the_way_out() {
    // During the move in, in the dwell, and during the move out.
    for cycles in [1000, 3300, 5000] {
        let mut rig = oriented_at_the_hole(&with_spindle(), 15.0);
        let mut turned = SpindleRevolutions::new(&rig);
        let mut events = Vec::new();
        let mut step = |rig: &mut Rig, events: &mut Vec<Event>| {
            events.extend(rig.cycle());
            turned.check(rig, PER_MM);
        };
        for _ in 0..cycles {
            step(&mut rig, &mut events);
        }
        rig.control(Control::Hold);
        while !events.iter().any(|event| matches!(event, Event::Held { .. })) {
            step(&mut rig, &mut events);
            assert!(rig.reading().time_s < ENDLESS_S);
        }
        let last = &events[events.len() - 2..];
        assert!(
            matches!(last, [Event::Finished { segment: 4, .. }, Event::Held { .. }]),
            "{last:?}"
        );
        close(rig.position().0[2], R);
        assert!(rig.cycles(100).is_empty(), "the next move waits");
        rig.control(Control::Resume);
        rig.until(is_finished(5));
    }
}

#[test]
fn m1h_hold_in_phase_rests_in_the_thread_and_leaves_it_in_phase() {
    // During the move in, in the dwell, during the move out; also after a feed hold that waits for the end of
    // the thread.
    for cycles in [100, 1000, 3000, 3300, 5000] {
        for waits in [false, true] {
            let mut rig = oriented_at_the_hole(&with_spindle(), 15.0);
            let mut turned = SpindleRevolutions::new(&rig);
            let mut step = |rig: &mut Rig| {
                let events = rig.cycle();
                turned.check(rig, PER_MM);
                events
            };
            for _ in 0..cycles {
                step(&mut rig);
            }
            if waits {
                rig.control(Control::Hold);
                for _ in 0..20 {
                    step(&mut rig);
                }
            }
            rig.control(Control::HoldInPhase);
            let mut braking = 0;
            while !step(&mut rig)
                .iter()
                .any(|event| matches!(event, Event::Held { .. }))
            {
                braking += 1;
            }
            assert!(braking <= 200, "within the hold's slew time: {braking} cycles");
            let z = rig.position().0[2];
            for _ in 0..1000 {
                assert!(step(&mut rig).is_empty());
            }
            close(rig.position().0[2], z);
            rig.control(Control::Resume);
            while !step(&mut rig).iter().any(is_finished(4)) {
                assert!(rig.reading().time_s < ENDLESS_S);
            }
            close(rig.position().0[2], R);
            rig.until(is_finished(5));
        }
    }
}

#[test]
fn m1i_without_a_spindle_a_hold_waits_through_gaps_in_the_thread() {
    let mut rig = Rig::new(&settings());
    rig.push(line(1, AxisVector::ZERO, vector(&[0.0, 0.0, R]), 50.0, 0.05));
    rig.until(is_finished(1));
    rig.push(leg(2, R, DEPTH, 0.0, TapLeg::In));
    rig.cycle();
    rig.control(Control::Hold);
    rig.until(is_finished(2));
    // The sequence program reverses the spindle.
    assert!(rig.cycles(50).is_empty());
    rig.push(leg(3, DEPTH, R, 0.0, TapLeg::Out));
    rig.until(|event| matches!(event, Event::Held { .. }));
    close(rig.position().0[2], R);
}

#[test]
fn m1h_a_stop_in_the_thread_decelerates_in_phase() {
    let mut rig = oriented_at_the_hole(&with_spindle(), 15.0);
    let mut turned = SpindleRevolutions::new(&rig);
    for _ in 0..1000 {
        rig.cycle();
        turned.check(&rig, PER_MM);
    }
    let before = rig.position().0[2];
    rig.control(Control::Stop { epoch: 1 });
    while !rig.cycle().iter().any(is_stopped) {
        turned.check(&rig, PER_MM);
        assert!(rig.reading().time_s < ENDLESS_S);
    }
    turned.check(&rig, PER_MM);
    // v h/2 with the hold slew of 0.2 s: 300 r/min in 0.2 s is below 3000 r/min per second.
    close(before - rig.position().0[2], 100.0 / 60.0 * 0.1);
    let rest = rig.reading().spindle_deg;
    rig.cycles(200);
    close(rig.reading().spindle_deg, rest);
    close(rig.reading().spindle_rpm, 0.0);
}

#[test]
fn m1h_a_stop_keeps_the_spindles_acceleration() {
    let mut settings = with_spindle();
    settings.hold_slew_ms = 10.0;
    let mut rig = oriented_at_the_hole(&settings, 15.0);
    rig.cycles(1000);
    let before = rig.position().0[2];
    rig.control(Control::Stop { epoch: 1 });
    // 300 r/min at 3000 r/min per second: 0.1 s, not 0.01 s.
    assert_eq!(rig.until(is_stopped), 100);
    close(before - rig.position().0[2], 100.0 / 60.0 * 0.05);
}

#[test]
fn m1h_an_abort_brakes_each_motor_on_its_own() {
    let mut rig = oriented_at_the_hole(&with_spindle(), 15.0);
    rig.cycles(1000);
    close(rig.reading().spindle_rpm, 300.0);
    rig.control(Control::Abort { epoch: 1 });
    rig.until(is_stopped);
    // 300 r/min at 3000 r/min per second.
    rig.cycles(49);
    let rpm = rig.reading().spindle_rpm;
    assert!((100.0..200.0).contains(&rpm), "{rpm}");
    rig.cycles(60);
    close(rig.reading().spindle_rpm, 0.0);
}

#[test]
fn a_spindle_command_waits_until_the_tool_is_out() {
    let mut rig = oriented_at_the_hole(&with_spindle(), 15.0);
    rig.cycles(1000);
    let mut turned = SpindleRevolutions::new(&rig);
    turned.revolutions = (R - rig.position().0[2]) * PER_MM;
    rig.control(Control::Spindle {
        direction: SpindleDirection::Cw,
        rpm: 500.0,
    });
    while !rig.cycle().iter().any(is_finished(4)) {
        turned.check(&rig, PER_MM);
        assert!(rig.reading().time_s < ENDLESS_S);
    }
    rig.cycles(200);
    close(rig.reading().spindle_rpm, 500.0);
}

#[test]
fn a_thread_is_not_begun_while_the_spindle_turns() {
    let mut rig = Rig::new(&with_spindle());
    rig.control(Control::Spindle {
        direction: SpindleDirection::Cw,
        rpm: 30.0,
    });
    rig.cycles(100);
    rig.push(leg(1, 0.0, -5.0, 15.0, TapLeg::In));
    let is_refused =
        |event: &Event| matches!(event, Event::Fault(Fault::SpindleTurns { rpm }) if *rpm > 29.0);
    rig.until(is_refused);
    assert!(rig.cycles(100).is_empty());
    close(rig.position().0[2], 0.0);
}
