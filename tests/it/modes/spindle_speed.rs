//! The stock sequence program resets M03 and M04 at speed and M05 at rest. The spindle reaches at most 3000
//! r/min and changes by 3000 r/min per second.

use plc_api::{Alarm, Execution};
use plc_protocol::types::request::OverrideChange;
use plc_protocol::types::state::{Reason, State};

use super::rig::{Rig, on_machine};
use crate::support::formula::PERIOD_S;

/// r/min per second.
const ACCELERATION: f64 = 3000.0;

async fn spindle_override(rig: &Rig, percent: f64) {
    let change = OverrideChange {
        spindle: Some(percent),
        ..OverrideChange::default()
    };
    rig.cs.set_overrides(change).await.unwrap();
}

/// Time until the next line runs, s; and the speed then, r/min.
async fn time_of(rig: &Rig, text: &str) -> (f64, f64) {
    let begun_s = rig.plc.now_s();
    rig.cs.mdi(text).await.unwrap();
    let rpm = rig.cs.spindle().await.unwrap().actual_rpm;
    (rig.plc.now_s() - begun_s, rpm)
}

#[track_caller]
fn assert_took(took_s: f64, expected_s: f64) {
    let late_s = 5.0 * PERIOD_S;
    assert!(
        (expected_s - 1e-9..=expected_s + late_s).contains(&took_s),
        "{took_s} s is not {expected_s} s"
    );
}

async fn waits_for(rig: &Rig, m: u16) -> State {
    let is_it = |state: &State| state.waiting_on.as_ref().is_some_and(|on| on.m == m);
    rig.cs.wait_for(is_it).await.unwrap()
}

fn text(state: &State) -> String {
    let waiting = state.waiting_on.as_ref().expect("an output");
    waiting.progress.as_ref().expect("why it waits").text.clone()
}

#[test]
fn m03_m04_and_m05_are_reset_at_the_speed_and_at_rest() {
    on_machine("", |rig| async move {
        // from 0 to 90 percent of 1500, from there (it keeps turning) to -900 of -1000, to 0, to 0 again
        let (took_s, rpm) = time_of(&rig, "M03 S1500").await;
        assert_took(took_s, 0.9 * 1500.0 / ACCELERATION);
        let (took_s, _) = time_of(&rig, "M04 S1000").await;
        assert_took(took_s, (rpm + 0.9 * 1000.0) / ACCELERATION);
        rig.sleep(1.0).await;
        let (took_s, rpm) = time_of(&rig, "M05").await;
        assert_took(took_s, 1000.0 / ACCELERATION);
        assert_eq!(rpm, 0.0);
        let (took_s, _) = time_of(&rig, "M05").await;
        assert_took(took_s, 0.0);
        let (took_s, _) = time_of(&rig, "M03 S0").await;
        assert_took(took_s, 0.0);
        // above its maximum it has reached its maximum
        spindle_override(&rig, 200.0).await;
        let (took_s, _) = time_of(&rig, "M03 S3000").await;
        assert_took(took_s, 0.9 * 3000.0 / ACCELERATION);
    });
}

#[test]
fn simulated_ms_and_the_speed_together_say_when_m03_is_reset() {
    let more = "\n[m_code.3]\nsimulated_ms = 800\n";
    on_machine(more, |rig| async move {
        let (took_s, _) = time_of(&rig, "M03 S300").await;
        assert_took(took_s, 0.8);
        let (took_s, _) = time_of(&rig, "M03 S3000").await;
        assert_took(took_s, (2700.0 - 300.0) / ACCELERATION);
    });
}

#[test]
fn a_change_of_the_spindle_override_changes_what_m03_waits_for() {
    on_machine("", |rig| async move {
        rig.start("M03 S2000\nG01 X1 F6000\nM30\n").await;
        let state = waits_for(&rig, 3).await;
        assert!(text(&state).contains("2000 r/min"), "{}", text(&state));
        spindle_override(&rig, 0.0).await;
        rig.sleep(5.0).await;
        let state = rig.cs.state().await.unwrap();
        assert_eq!(
            state.execution,
            Execution::Wait,
            "a spindle at rest is not at speed"
        );
        assert!(text(&state).contains("override is 0 percent"), "{}", text(&state));
        assert_eq!(rig.at().await[0], 0.0);
        let begun_s = rig.plc.now_s();
        spindle_override(&rig, 50.0).await;
        rig.until(Execution::Active).await;
        assert_took(rig.plc.now_s() - begun_s, 0.9 * 1000.0 / ACCELERATION);
        rig.until(Execution::ProgramCompleted).await;
    });
}

#[test]
fn stop_reset_and_alarm_end_the_wait_and_the_next_m05_waits_for_itself() {
    for what in ["stop", "reset", "alarm"] {
        on_machine("", move |rig| async move {
            rig.start("M03 S3000\nM30\n").await;
            waits_for(&rig, 3).await;
            rig.sleep(0.5).await;
            match what {
                "stop" => rig.cs.stop().await.unwrap(),
                "alarm" => {
                    rig.cs.raise_alarm(Alarm::user(1, "no air")).await.unwrap();
                    let state = rig.until(Execution::Stopped).await;
                    assert_eq!(state.reason, Some(Reason::Alarm));
                }
                _ => {}
            }
            rig.cs.reset().await.unwrap();
            let rpm = rig.cs.spindle().await.unwrap().actual_rpm;
            let (took_s, rest) = time_of(&rig, "M05").await;
            assert_took(took_s + PERIOD_S, rpm / ACCELERATION);
            assert_eq!(rest, 0.0, "{what}");
        });
    }
}

#[test]
fn spindle_that_never_reaches_its_speed_ends_with_the_time_limit_alarm() {
    let more = "\n[m_code.3]\ntimeout_ms = 1000\n";
    on_machine(more, |rig| async move {
        spindle_override(&rig, 0.0).await;
        rig.start("M03 S2000\nM30\n").await;
        let state = rig.until(Execution::Stopped).await;
        assert_eq!(state.reason, Some(Reason::Alarm));
        assert_eq!(rig.alarms().await, [301]);
    });
}

#[test]
fn a_start_from_a_line_waits_for_the_spindle_before_the_approach() {
    on_machine("", |rig| async move {
        rig.load("M03 S2000\nG00 X10\nG01 X20 F600\nM30\n").await;
        rig.cs
            .start_from(plc_protocol::types::line_start::LineStart::line(3))
            .await
            .unwrap();
        waits_for(&rig, 3).await;
        rig.until(Execution::Active).await;
        assert!(rig.cs.spindle().await.unwrap().actual_rpm >= 1800.0);
        assert_eq!(rig.at().await[0], 0.0, "nothing has moved before");
        rig.until(Execution::ProgramCompleted).await;
    });
}
