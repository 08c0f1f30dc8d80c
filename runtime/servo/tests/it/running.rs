//! Profiles at 100 percent and under an override, without holds or faults.

use tandem_model::AxisVector;
use tandem_servo::{Control, Event, Reading, Servo};

use crate::rig::{Rig, T, close, dwell, is_finished, line, origin, rapid, settings, vector};

#[test]
fn s1c_sample_k_is_the_formula_at_k_periods_and_the_last_the_end_point() {
    let mut rig = Rig::new(&settings());
    // 10.005 mm at 50 mm/s, ramps 0.1 s: 0.3001 s, not a whole number of periods
    let profile = line(1, AxisVector::ZERO, vector(&[6.003, -8.004]), 50.0, 0.1);
    rig.push(profile.clone());
    let started = rig.cycle();
    let Event::Started {
        segment: 1,
        origin: place,
        time_s,
        ..
    } = started[0]
    else {
        panic!("{started:?}");
    };
    assert_eq!(place, origin(1));
    assert!(
        time_s <= 3.0 * T,
        "the first run starts at most 3 periods after time 0"
    );
    assert_eq!(rig.position(), AxisVector::ZERO);
    for k in 1..=300 {
        assert!(rig.cycle().is_empty());
        assert_eq!(rig.position(), profile.position(f64::from(k) * T), "sample {k}");
    }
    let finished = rig.cycle();
    assert_eq!(rig.position(), vector(&[6.003, -8.004]));
    let Event::Finished {
        segment: 1,
        time_s: end_s,
    } = finished[0]
    else {
        panic!("{finished:?}");
    };
    assert!(end_s - time_s - 0.3001 <= 3.0 * T);
    close(end_s, rig.servo.time_s());
    assert!(rig.servo.channel(0).is_idle());
}

#[test]
fn s1c_a_duration_of_whole_periods_ends_on_its_period() {
    // 0.3 is not exactly 300 * 0.001 in binary numbers.
    let mut rig = Rig::new(&settings());
    rig.push(line(1, AxisVector::ZERO, vector(&[10.0]), 50.0, 0.1));
    assert_eq!(rig.until(is_finished(1)), 301);
    assert_eq!(rig.position(), vector(&[10.0]));
}

#[test]
fn s1c_the_next_run_starts_at_the_tick_after_in_position_is_found() {
    let mut rig = Rig::new(&settings());
    rig.push(line(1, AxisVector::ZERO, vector(&[10.0]), 50.0, 0.1));
    rig.push(rapid(2, 10.0, -20.0));
    rig.push(dwell(3, vector(&[-20.0]), 0.0105));
    rig.until(is_finished(1));
    assert!(matches!(rig.cycle()[0], Event::Started { segment: 2, .. }));
    assert_eq!(rig.position(), vector(&[10.0]));
    assert_eq!(rig.until(is_finished(2)), 400);
    assert!(matches!(rig.cycle()[0], Event::Started { segment: 3, .. }));
    assert_eq!(rig.until(is_finished(3)), 11);
    assert_eq!(rig.position(), vector(&[-20.0]));
}

#[test]
fn s1c_a_motor_that_lags_delays_the_end_until_it_is_in_position() {
    // The expected time comes from integrating actual' = (command - actual)/lag in steps of a microsecond.
    let mut settings = settings();
    settings.motors[0].as_mut().unwrap().lag_ms = 20.0;
    let mut rig = Rig::new(&settings);
    rig.push(line(1, AxisVector::ZERO, vector(&[10.0]), 50.0, 0.1));
    let cycles = rig.until(is_finished(1));
    let error = rig.position().0[0] - rig.reading().actual.0.0[0];
    assert!(error > 0.0 && error <= 0.01);

    let (mut actual, mut t, step) = (0.0, 0.0, 1e-6);
    let command = |t: f64| {
        let ramp = |t: f64| {
            if t <= 0.0 {
                0.0
            } else if t < 0.1 {
                t * t / 0.2
            } else {
                t - 0.05
            }
        };
        50.0 * (ramp(t) - ramp(t - 0.2))
    };
    while t < 0.3 || command(t) - actual > 0.01 {
        actual += (command(t + step / 2.0) - actual) * step / 0.02;
        t += step;
    }
    let expected = t / T;
    // One cycle for the start point, and rounding up to a whole period.
    assert!(
        (f64::from(cycles) - 1.0 - expected).abs() <= 1.0,
        "{cycles} cycles, not {expected}"
    );
}

#[test]
fn s1i_an_override_in_force_before_the_start_needs_no_slew() {
    for (feed, rapid_override) in [(0.5, 1.0), (1.7, 0.25)] {
        let mut rig = Rig::new(&settings());
        rig.control(Control::Override {
            feed,
            rapid: rapid_override,
        });
        let cut = line(1, AxisVector::ZERO, vector(&[10.0]), 50.0, 0.1);
        let way = rapid(2, 10.0, 40.0);
        rig.push(cut.clone());
        rig.push(way.clone());
        rig.cycle();
        for k in 1..200 {
            if rig.cycle().iter().any(is_finished(1)) {
                break;
            }
            close(rig.x(), cut.position(f64::from(k) * feed * T).0[0]);
        }
        rig.until(|event| matches!(event, Event::Started { segment: 2, .. }));
        for k in 1..200 {
            rig.cycle();
            close(rig.x(), way.position(f64::from(k) * rapid_override * T).0[0]);
        }
    }
}

#[test]
fn s1i_an_override_change_slews_the_time_base() {
    // From 100 to 50 percent at 100 percent per second: 0.5 s at 75 percent on average.
    let mut rig = Rig::new(&settings());
    rig.push(line(1, AxisVector::ZERO, vector(&[1000.0]), 100.0, 0.1));
    rig.cycles(1001);
    let before = rig.x();
    rig.control(Control::Override {
        feed: 0.5,
        rapid: 1.0,
    });
    rig.cycles(500);
    close(rig.x() - before, 100.0 * 0.5 * 0.75);
    close(rig.reading().rate, 0.5);
    let before = rig.x();
    rig.cycles(100);
    close(rig.x() - before, 100.0 * 0.1 * 0.5);
}

#[test]
fn an_override_is_limited_and_what_is_not_a_number_changes_nothing() {
    let mut rig = Rig::new(&settings());
    rig.control(Control::Override {
        feed: 9.0,
        rapid: 9.0,
    });
    rig.control(Control::Override {
        feed: f64::NAN,
        rapid: f64::NAN,
    });
    rig.push(line(1, AxisVector::ZERO, vector(&[1000.0]), 100.0, 0.1));
    rig.cycles(2);
    close(rig.reading().rate, 2.0);
    rig.control(Control::Override {
        feed: -1.0,
        rapid: 1.0,
    });
    rig.cycles(2000);
    let x = rig.x();
    assert!(
        rig.cycles(100).is_empty(),
        "an override of 0 rests and tells nothing"
    );
    close(rig.x(), x);
}

#[test]
fn s1i_a_dwell_does_not_scale_with_an_override() {
    let mut rig = Rig::new(&settings());
    rig.control(Control::Override {
        feed: 0.1,
        rapid: 0.1,
    });
    rig.push(dwell(1, AxisVector::ZERO, 0.25));
    assert_eq!(rig.until(is_finished(1)), 251);
}

#[test]
fn a_joint_without_a_stop_loses_no_time() {
    // Two profiles of 0.3001 s end after 0.6002 s: 601 periods after the start, not 602.
    let mut rig = Rig::new(&settings());
    let mut first = line(1, AxisVector::ZERO, vector(&[10.005]), 50.0, 0.1);
    first.exact_stop = false;
    let second = line(2, vector(&[10.005]), vector(&[20.01]), 50.0, 0.1);
    rig.push(first);
    rig.push(second.clone());
    rig.cycles(301);
    let joint = rig.cycle();
    assert!(matches!(
        joint[..],
        [
            Event::Finished { segment: 1, .. },
            Event::Started { segment: 2, .. }
        ]
    ));
    close(rig.x(), second.position(0.0009).0[0]);
    assert_eq!(302 + rig.until(is_finished(2)), 602);
}

#[test]
fn many_short_profiles_pass_within_one_cycle() {
    let mut rig = Rig::new(&settings());
    for n in 1..=40 {
        let mut profile = dwell(n, AxisVector::ZERO, 0.0001);
        profile.exact_stop = n == 40;
        rig.push(profile);
    }
    // 40 blocks of a tenth of a period: 4 periods after the start.
    assert_eq!(rig.until(is_finished(40)), 5);
}

#[test]
fn readings_show_the_running_block() {
    let mut rig = Rig::new(&settings());
    rig.push(line(1, AxisVector::ZERO, vector(&[60.0, 80.0]), 50.0, 0.1));
    rig.cycles(1051);
    let reading = rig.reading();
    // 50 (1.05 - 0.05) = 50 mm covered, 50 mm to go.
    close(reading.time_s, 1.051);
    close(reading.commanded.0.0[0], 30.0);
    close(reading.actual.0.0[1], 40.0);
    close(reading.distance_to_go.0[0], 30.0);
    close(reading.distance_to_go.0[1], 40.0);
    assert!((reading.feedrate_mm_min - 3000.0).abs() < 1e-6);
    close(reading.rate, 1.0);
    assert_eq!(reading.segment, 1);
    assert_eq!(reading.executing, Some(origin(1)));
    assert_eq!(rig.servo.channel(0).executing(), Some(origin(1)));
    rig.until(is_finished(1));
    assert_eq!(
        rig.reading().executing,
        Some(origin(1)),
        "the end point belongs to its block"
    );
    rig.cycle();
    let reading = rig.reading();
    assert_eq!(reading.executing, None);
    assert_eq!(reading.distance_to_go, AxisVector::ZERO);
    close(reading.feedrate_mm_min, 0.0);
    close(reading.rate, 0.0);
    assert_eq!(reading.segment, 1);
}

#[test]
fn at_rest_time_goes_on_and_nothing_else_changes() {
    let mut rig = Rig::new(&settings());
    rig.cycle();
    assert!(rig.reading().plan_s.is_infinite(), "before the first block");
    rig.push(line(1, AxisVector::ZERO, vector(&[60.0, 80.0]), 50.0, 0.1));
    rig.until(is_finished(1));
    rig.cycle();
    let at_rest = rig.reading();
    for _ in 0..3 {
        assert!(rig.cycle().is_empty());
        let time_s = rig.servo.time_s();
        assert_eq!(rig.reading(), Reading { time_s, ..at_rest });
    }
    rig.push(rapid(2, 0.0, 20.0));
    rig.control(Control::Hold);
    assert!(matches!(rig.cycle()[..], [Event::Held { .. }]));
    assert!(rig.reading().held);
}

#[test]
fn channels_cycle_in_lock_step_and_apart() {
    let settings = settings();
    let (mut servo, mut handles) = Servo::simulated(&[(&settings, 4), (&settings, 4)], T);
    let [first_handle, second_handle] = &mut handles[..] else {
        panic!("two handles");
    };
    first_handle.profiles.push(rapid(1, 0.0, 20.0)).unwrap();
    second_handle.profiles.push(rapid(1, 0.0, -30.0)).unwrap();
    first_handle.controls.push(Control::Hold).unwrap();
    for _ in 0..401 {
        servo.cycle();
    }
    close(servo.channel(0).setpoint().0[0], 0.0);
    close(servo.channel(1).setpoint().0[0], -30.0);
    assert_eq!(servo.channel(0).profiles_waiting(), 1);
    assert!(!servo.channel(0).is_idle());
    assert!(servo.channels()[1].is_idle());
    assert!(matches!(first_handle.events.pop(), Ok(Event::Held { .. })));
    close(
        first_handle.readings.read().time_s,
        second_handle.readings.read().time_s,
    );
}
