//! Jogging: the dead man's switch, soft limits, motor limits.

use std::time::Duration;

use plc_api::Execution;
use plc_protocol::types::command::{Command, CommandMeta, CommandReply, CommandStatus};
use plc_protocol::types::request::{RefusalCode, typed};
use plc_protocol::types::state::Reason;

use super::rig::{Rig, close, distance, on_machine, refused};
use crate::support::formula::PERIOD_S;

/// Begins a jog and returns at once; the answer arrives when the jog has ended.
fn begin(
    rig: &Rig,
    axis: char,
    velocity: f64,
    id: &'static str,
) -> tokio::task::JoinHandle<plc_api::Result<()>> {
    let cs = rig.plc.coordinate_system(1);
    tokio::spawn(async move { cs.jog(axis, velocity, None, id).await })
}

/// Jogs a distance, and returns the reply once the jog has ended.
async fn jog(rig: &Rig, axis: char, velocity: f64, distance: f64, id: &str) -> CommandReply {
    let command = typed::Command {
        cs: 1,
        command: Command::Jog {
            axis,
            velocity,
            distance: Some(distance),
            refresh_id: id.to_owned(),
        },
        meta: CommandMeta {
            command_id: id.to_owned(),
            client_id: "test".to_owned(),
            ..CommandMeta::default()
        },
        wait: true,
    };
    rig.plc.port().ask(command).await.unwrap()
}

/// Code of a reply `failed`, and the distances that it names.
#[track_caller]
fn failed(reply: &CommandReply) -> (&str, Vec<(char, f64)>) {
    assert_eq!(reply.status, CommandStatus::Failed, "{reply:?}");
    let moved = reply.moved.iter().map(|(axis, distance)| (*axis, *distance));
    (reply.code.as_str(), moved.collect())
}

#[test]
fn a_jog_stops_200_ms_after_its_last_refresh() {
    on_machine("", |rig| async move {
        let jog = begin(&rig, 'X', 6000.0, "a");
        rig.until(Execution::Active).await;
        for _ in 0..9 {
            rig.sleep(0.1).await;
            rig.cs.jog('X', 6000.0, None, "a").await.unwrap();
        }
        assert_eq!(rig.state().await, (Execution::Active, None));
        jog.await.unwrap().unwrap();
        assert_eq!(rig.state().await, (Execution::Ready, None));
        // Last refreshed at 0.9 s, so until 1.1 s at 100 mm/s: up with 1000 mm/s^2 (5 mm less), down with 5000 (1 mm).
        let x = rig.at().await[0];
        assert!(
            (110.0 - 5.0 + 1.0 - 0.4..110.0 - 5.0 + 1.0 + 0.4).contains(&x),
            "{x}"
        );
    });
}

#[test]
fn a_jog_keeps_the_limits_of_its_motor() {
    on_machine("", |rig| async move {
        // Y has 50 mm/s and 250 mm/s^2; three times this speed is requested. It stops with 5000 mm/s^2.
        let jog = begin(&rig, 'Y', -9000.0, "a");
        rig.until(Execution::Active).await;
        for _ in 0..5 {
            rig.sleep(0.15).await;
            rig.cs.jog('Y', -9000.0, None, "a").await.unwrap();
        }
        jog.await.unwrap().unwrap();
        let trace: Vec<f64> = rig.trace().into_iter().map(|point| point[1]).collect();
        let fastest = trace
            .windows(2)
            .map(|two| (two[1] - two[0]) / PERIOD_S)
            .fold(0.0, f64::min);
        assert!((-50.0 - 1e-6..-49.9).contains(&fastest), "{fastest}");
        for three in trace.windows(3) {
            let change = (three[2] - 2.0 * three[1] + three[0]) / PERIOD_S / PERIOD_S;
            assert!((-250.0 - 1e-3..=5000.0 + 1e-3).contains(&change), "{change}");
        }
        assert_eq!(rig.at().await[0], 0.0);
    });
}

#[test]
fn a_jog_ends_at_the_soft_limit_and_does_not_begin_beyond() {
    on_machine("", |rig| async move {
        // X may go from -100 to 300.
        rig.cs.mdi("G00 X295").await.unwrap();
        rig.trace();
        rig.cs.jog('X', 6000.0, None, "a").await.unwrap();
        close(rig.at().await, [300.0, 0.0, 0.0]);
        assert!(rig.trace().iter().all(|point| point[0] <= 300.0));
        let refusal = refused(rig.cs.jog('X', 6000.0, None, "b").await, RefusalCode::NotAllowed);
        assert!(refusal.text.contains("soft limit"), "{}", refusal.text);
        rig.cs.jog('X', -6000.0, Some(1.0), "c").await.unwrap();
        close(rig.at().await, [299.0, 0.0, 0.0]);
        let reply = jog(&rig, 'X', 6000.0, 5.0, "d").await;
        assert_eq!(failed(&reply), ("limit", vec![('X', 1.0)]));
        assert!(reply.text.contains("X 1.000 of 5.000 mm"), "{}", reply.text);
        close(rig.at().await, [300.0, 0.0, 0.0]);
        assert_eq!(rig.alarms().await, [0_u16; 0]);
    });
}

#[test]
fn a_jog_of_a_distance_ends_there_and_work_goes_on_from_there() {
    on_machine("", |rig| async move {
        rig.cs.jog('z', -600.0, Some(0.5), "a").await.unwrap();
        close(rig.at().await, [0.0, 0.0, -0.5]);
        rig.start("G91 G00 Z1\nM30\n").await;
        rig.until(Execution::ProgramCompleted).await;
        close(rig.at().await, [0.0, 0.0, 0.5]);
    });
}

#[test]
fn a_late_refresh_never_begins_a_jog_again() {
    on_machine("", |rig| async move {
        begin(&rig, 'X', 600.0, "a").await.unwrap().unwrap();
        let at = rig.at().await;
        let refusal = refused(rig.cs.jog('X', 600.0, None, "a").await, RefusalCode::NotAllowed);
        assert!(refusal.text.contains("ended"), "{}", refusal.text);
        rig.sleep(0.5).await;
        close(rig.at().await, at);
        rig.cs.jog('X', 600.0, Some(0.1), "b").await.unwrap();
        close(rig.at().await, [at[0] + 0.1, 0.0, 0.0]);
    });
}

/// Maximum number of servo cycles before a command reaches the servo.
const CYCLES: f64 = 2.0;

#[test]
fn the_end_of_a_jog_brakes_it_at_once_to_ready() {
    // 100 mm/s, reached with 1000 mm/s^2 and left with 5000: 1 mm to stop, where the time-out alone adds 20 mm
    let (velocity, deceleration) = (100.0_f64, 5000.0);
    on_machine("", move |rig| async move {
        let jog = begin(&rig, 'X', velocity * 60.0, "a");
        rig.until(Execution::Active).await;
        rig.sleep(0.15).await;
        let at = rig.at().await[0];
        rig.trace();
        rig.cs.jog_end("a").await.unwrap();
        assert_eq!(rig.state().await, (Execution::Ready, None));
        let braked = velocity.powi(2) / 2.0 / deceleration;
        let way = rig.at().await[0] - at;
        let late = velocity * PERIOD_S * CYCLES;
        assert!(
            (braked - late..=braked + late).contains(&way),
            "{way} is not {braked}"
        );
        let seconds = f64::from(u32::try_from(rig.trace().len()).unwrap()) * PERIOD_S;
        assert!(
            seconds <= velocity / deceleration + (CYCLES + 1.0) * PERIOD_S,
            "{seconds}"
        );
        jog.await.unwrap().unwrap();
        let rests = rig.at().await;
        refused(rig.cs.jog('X', 6000.0, None, "a").await, RefusalCode::NotAllowed);
        rig.sleep(0.5).await;
        close(rig.at().await, rests);
    });
}

#[test]
fn the_end_of_a_jog_before_it_or_twice_changes_nothing_else() {
    on_machine("", |rig| async move {
        rig.load("G01 X50 F3000\nM30\n").await;
        let loaded = rig.cs.state().await.unwrap();
        rig.cs.jog_end("early").await.unwrap();
        assert_eq!(rig.cs.state().await.unwrap(), loaded);
        let refusal = refused(
            rig.cs.jog('X', 600.0, None, "early").await,
            RefusalCode::NotAllowed,
        );
        assert!(refusal.text.contains("ended"), "{}", refusal.text);
        // of another jog
        let jog = begin(&rig, 'X', 600.0, "a");
        rig.until(Execution::Active).await;
        rig.cs.jog_end("b").await.unwrap();
        rig.sleep(0.1).await;
        assert_eq!(rig.state().await, (Execution::Active, None));
        assert!(!jog.is_finished(), "its caller waits for its own end");
        rig.cs.jog_end("a").await.unwrap();
        rig.cs.jog_end("a").await.unwrap();
        jog.await.unwrap().unwrap();
        // in a program
        rig.cs.start().await.unwrap();
        rig.until(Execution::Active).await;
        for id in ["a", "c"] {
            rig.cs.jog_end(id).await.unwrap();
        }
        assert_eq!(rig.until(Execution::ProgramCompleted).await.reason, None);
        assert!(distance(rig.at().await, [50.0, 0.0, 0.0]) < 1e-9);
        rig.cs.jog_end("c").await.unwrap();
        assert_eq!(rig.state().await, (Execution::ProgramCompleted, None));
    });
}

#[test]
fn a_jog_is_ended_also_under_a_lease_and_an_interlock() {
    on_machine("", |rig| async move {
        rig.cs.set_interlock(true, "door").await.unwrap();
        rig.cs.jog_end("a").await.unwrap();
        rig.cs.set_interlock(false, "").await.unwrap();
        let jog = begin(&rig, 'X', 600.0, "b");
        rig.until(Execution::Active).await;
        let holder = rig.plc.coordinate_system(1);
        let lease = holder.take_lease(Duration::from_secs(30)).await;
        assert!(lease.is_ok());
        rig.cs.jog_end("b").await.unwrap();
        jog.await.unwrap().unwrap();
        assert_eq!(rig.state().await, (Execution::Ready, None));
    });
}

#[test]
fn another_jog_or_program_is_refused_while_one_runs_and_stop_ends_it() {
    on_machine("", |rig| async move {
        rig.load("G00 X1\nM30\n").await;
        let jog = begin(&rig, 'X', 600.0, "a");
        rig.until(Execution::Active).await;
        refused(rig.cs.jog('Y', 600.0, None, "b").await, RefusalCode::NotAllowed);
        refused(rig.cs.start().await, RefusalCode::NotAllowed);
        rig.sleep(0.1).await;
        rig.cs.stop().await.unwrap();
        assert!(jog.await.unwrap().is_err());
        assert_eq!(rig.state().await, (Execution::Stopped, Some(Reason::Stop)));
        refused(rig.cs.jog('X', 0.0, None, "c").await, RefusalCode::Invalid);
        refused(rig.cs.jog('X', f64::NAN, None, "c").await, RefusalCode::Invalid);
        refused(rig.cs.jog('X', 1.0, Some(-1.0), "c").await, RefusalCode::Invalid);
        refused(rig.cs.jog('A', 1.0, None, "c").await, RefusalCode::Invalid);
    });
}

#[test]
fn a_step_needs_no_refresh_and_moves_its_whole_distance() {
    on_machine("", |rig| async move {
        let mut x = 0.0;
        // the last one takes 10 s, 50 times as long as a jog without refresh
        for (id, (distance, velocity)) in [(0.1, 600.0), (1.0, -600.0), (10.0, 600.0), (10.0, 60.0)]
            .into_iter()
            .enumerate()
        {
            let reply = jog(&rig, 'X', velocity, distance, &id.to_string()).await;
            assert_eq!(reply.status, CommandStatus::Done, "{reply:?}");
            assert!(reply.moved.is_empty());
            x += distance.copysign(velocity);
            close(rig.at().await, [x, 0.0, 0.0]);
        }
        assert_eq!(rig.state().await, (Execution::Ready, None));
    });
}

#[test]
fn a_longer_distance_without_refresh_fails_and_names_what_it_covered() {
    for (more, distance) in [("", 10.001), ("[hmi]\njog_step_max = 0.5\n", 0.501)] {
        on_machine(more, move |rig| async move {
            // 200 ms at 2 mm/s
            let reply = jog(&rig, 'X', 120.0, distance, "a").await;
            let x = rig.at().await[0];
            assert!((0.39..0.41).contains(&x), "{x}");
            let (code, moved) = failed(&reply);
            assert_eq!(code, "not_refreshed");
            assert!(
                matches!(moved[..], [('X', covered)] if (covered - x).abs() < 1e-6),
                "{moved:?}"
            );
            let covered = format!("X {x:.3} of {distance:.3} mm");
            assert!(reply.text.contains(&covered), "{}", reply.text);
            assert_eq!(rig.state().await, (Execution::Ready, None));
        });
    }
}

#[test]
fn a_refreshed_distance_is_done_where_it_ends() {
    on_machine("", |rig| async move {
        let cs = rig.plc.coordinate_system(1);
        let first = tokio::spawn(async move { cs.jog('X', 3000.0, Some(20.0), "a").await });
        for _ in 0..3 {
            rig.sleep(0.15).await;
            // the last refreshes may arrive after its end
            let _ = rig.cs.jog('X', 3000.0, Some(20.0), "a").await;
        }
        first.await.unwrap().unwrap();
        close(rig.at().await, [20.0, 0.0, 0.0]);
    });
}

#[test]
fn a_step_that_is_ended_early_fails_with_the_cause_and_the_distance() {
    for (what, state) in [
        ("hold", (Execution::Ready, None)),
        ("interlock", (Execution::Ready, None)),
        ("ended", (Execution::Ready, None)),
        ("stop", (Execution::Stopped, Some(Reason::Stop))),
        ("aborted", (Execution::Stopped, Some(Reason::Aborted))),
        ("alarm", (Execution::Stopped, Some(Reason::Alarm))),
    ] {
        on_machine("", move |rig| async move {
            let ender = rig.plc.coordinate_system(1);
            let plc = rig.plc.clone();
            let end = tokio::spawn(async move {
                plc.sleep(Duration::from_millis(500)).await;
                match what {
                    "hold" => ender.hold().await,
                    "interlock" => ender.set_interlock(true, "door").await,
                    "ended" => ender.jog_end("a").await,
                    "stop" => ender.stop().await,
                    "aborted" => ender.abort().await,
                    _ => ender.raise_alarm(plc_api::Alarm::user(7, "no oil")).await,
                }
            });
            let reply = jog(&rig, 'X', 60.0, 10.0, "a").await;
            end.await.unwrap().unwrap();
            let x = rig.at().await[0];
            assert!((0.4..0.6).contains(&x), "{what}: {x}");
            let (code, moved) = failed(&reply);
            assert_eq!(code, what);
            assert!(
                matches!(moved[..], [('X', covered)] if (covered - x).abs() < 1e-6),
                "{moved:?}"
            );
            assert!(reply.text.contains("of 10.000 mm"), "{}", reply.text);
            assert_eq!(
                reply.text.contains("10007, no oil"),
                what == "alarm",
                "{}",
                reply.text
            );
            assert_eq!(rig.state().await, state, "{what}");
            // it never continues automatically, nor by a resume
            rig.cs.set_interlock(false, "").await.unwrap();
            refused(rig.cs.resume().await, RefusalCode::NotAllowed);
            rig.sleep(1.0).await;
            close(rig.at().await, [x, 0.0, 0.0]);
        });
    }
}

#[test]
fn single_block_switched_on_in_a_step_does_not_interrupt_it() {
    on_machine("", |rig| async move {
        let cs = rig.plc.coordinate_system(1);
        let step = tokio::spawn(async move { cs.jog('X', 60.0, Some(1.0), "a").await });
        rig.until(Execution::Active).await;
        rig.cs.set_single_block(true).await.unwrap();
        step.await.unwrap().unwrap();
        close(rig.at().await, [1.0, 0.0, 0.0]);
        assert_eq!(rig.state().await, (Execution::Ready, None));
        rig.cs.jog('X', 60.0, Some(1.0), "b").await.unwrap();
        close(rig.at().await, [2.0, 0.0, 0.0]);
    });
}
