//! Tests of each cell of the table, in simulated time, at moments that a seed determines.

use std::time::Duration;

use plc_api::{Alarm, CoordinateSystem, Execution, SequenceProgram};
use plc_protocol::lock_input::LockRules;
use plc_protocol::server::ServerNotice;
use plc_protocol::types::lock::OnLoss;
use plc_protocol::types::state::Reason;
use tandem_runtime::{Config, Machine, Runtime};
use tandem_testing::{Bench, Scene};

use super::*;

/// Maximum delay in s of the published state after the motion, including a servo cycle.
const STATE_S: f64 = 0.01;

/// Time without a heartbeat after which a client is lost.
const TTL: Duration = Duration::from_millis(100);

/// Duration of the omitted servo cycles.
const GAP: Duration = Duration::from_millis(150);

/// Number of moments at which each cell is tested.
const SEEDS: u64 = 3;

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

fn machine() -> Machine {
    let mut machine = Config::demo().resolve().unwrap();
    machine.hold_on_bus_loss = true;
    for system in &mut machine.coordinate_systems {
        system.programs.clear();
        system.locks[0] = LockRules {
            sources: [("door".to_owned(), OnLoss::On)].into(),
            ..LockRules::default()
        };
    }
    machine
}

fn program(motion: StoppedMotion) -> &'static str {
    match motion {
        StoppedMotion::Rapid => "G00 X290\nM30\n",
        StoppedMotion::Line => "G01 X290 F6000\nM30\n",
        StoppedMotion::Arc => "G02 X100 Y0 I50 F6000\nM30\n",
        StoppedMotion::Thread => "S300\nG84 X0 Y0 Z-20 R-5 F300\nG80\nM30\n",
        StoppedMotion::Dwell => "G04 X3\nM30\n",
        StoppedMotion::Compensation => "G01 G41 X20 Y0 F6000\nX280\nG40 X290\nM30\n",
        StoppedMotion::Reversal => "G00 X20\nX0\nX20\nX0\nM30\n",
        StoppedMotion::Jog | StoppedMotion::Home => "M30\n",
    }
}

async fn at(system: &CoordinateSystem, axis: &str) -> f64 {
    system.position().await.unwrap().machine[axis]
}

/// Starts a motion, and returns when it is active.
async fn begin(scene: &Scene, motion: StoppedMotion, seed: u64) {
    let (plc, system) = (scene.plc(), scene.cs(1));
    match motion {
        StoppedMotion::Jog => {
            let jogger = scene.cs(1);
            let pause = plc.clone();
            tokio::spawn(async move {
                while jogger.jog('X', 6000.0, None, "j").await.is_ok() {
                    pause.sleep(ms(1)).await;
                }
            });
        }
        StoppedMotion::Home => {
            system.mdi("G00 X290").await.unwrap();
            let homing = scene.cs(1);
            tokio::spawn(async move { homing.home(&['X']).await });
        }
        _ => {
            system.select_tool(1).await.unwrap();
            system.load(50).await.unwrap();
            system.start().await.unwrap();
        }
    }
    match motion {
        StoppedMotion::Thread => {
            while at(&system, "Z").await > -6.0 {
                plc.sleep(ms(1)).await;
            }
            plc.sleep(ms(150 * seed)).await;
        }
        StoppedMotion::Reversal => {
            while at(&system, "X").await < 20.0 {
                plc.sleep(ms(1)).await;
            }
            plc.sleep(ms(seed)).await;
        }
        StoppedMotion::Jog => plc.sleep(ms(60 + 20 * seed)).await,
        _ => plc.sleep(ms(150 + 90 * seed)).await,
    }
}

async fn raise(scene: &Scene, runtime: &Runtime, cause: StopCause) {
    let system = scene.cs(1);
    match cause {
        StopCause::Interlock => system.set_interlock(true, "the door is open").await.unwrap(),
        StopCause::SourceLost => scene.kill_handlers(),
        StopCause::ServoLate => runtime.simulation().unwrap().delay_servo(GAP),
        StopCause::ClientLost => {
            drop(system.heartbeat(TTL).await.unwrap());
            scene.plc().sleep(TTL).await;
        }
        StopCause::BusLost => runtime.served_port().notice(ServerNotice::BusLink {
            connected: false,
            broker: None,
        }),
        StopCause::Alarm => system.raise_alarm(Alarm::user(1, "no air")).await.unwrap(),
        StopCause::Hold | StopCause::Stop | StopCause::Abort => {
            let commander = scene.cs(1);
            tokio::spawn(async move {
                match cause {
                    StopCause::Hold => commander.hold().await,
                    StopCause::Stop => commander.stop().await,
                    _ => commander.abort().await,
                }
            });
        }
    }
}

/// Waits until no axis moves and no transition is in progress. Returns the waiting time in s.
async fn until_rest(scene: &Scene, max_s: f64) -> f64 {
    let (plc, system) = (scene.plc(), scene.cs(1));
    let from_s = plc.now_s();
    let mut before = system.position().await.unwrap().machine;
    while plc.now_s() - from_s < max_s {
        plc.sleep(ms(1)).await;
        let now = system.position().await.unwrap().machine;
        let state = system.state().await.unwrap();
        let rests = !matches!(state.execution, Execution::Active | Execution::Wait);
        if now == before && state.transition.is_none() && rests {
            return plc.now_s() - from_s;
        }
        before = now;
    }
    f64::INFINITY
}

fn play(cause: StopCause, motion: StoppedMotion, seed: u64) {
    let reaction = cause.reaction(motion);
    let cell = format!("{cause:?} {motion:?} {seed}");
    let of_play = cell.clone();
    let bench = Bench::on_machine(machine())
        .serve(SequenceProgram::new().handler_id("door"))
        .subprogram(50, program(motion));
    let played = bench.play(async move |owned: Scene, runtime| {
        let scene = &owned;
        let (cell, system) = (of_play, scene.cs(1));
        system.set_interlock_source("door", false, "").await.unwrap();
        begin(scene, motion, seed).await;
        let hold_slew_ms = runtime.machine().coordinate_systems[0].settings.hold_slew_ms;
        raise(scene, runtime, cause).await;
        let took_s = until_rest(scene, 30.0).await;
        let state = system.state().await.unwrap();
        let gap_s = if cause == StopCause::ServoLate {
            GAP.as_secs_f64()
        } else {
            0.0
        };
        if let Some(limit_s) = reaction.limit_s(hold_slew_ms) {
            assert!(
                took_s <= limit_s + gap_s + STATE_S,
                "{cell}: {took_s} s, {state:?}"
            );
        }
        let held = [Execution::FeedHold, Execution::Interrupted].contains(&state.execution);
        match reaction {
            StopReaction::Holds | StopReaction::HoldsInPhase | StopReaction::HoldsAfterThread => {
                assert!(held, "{cell}: {state:?}");
                let z = at(&system, "Z").await;
                if motion == StoppedMotion::Thread {
                    let is_out = z >= -5.0 - 1e-9;
                    assert_eq!(is_out, reaction == StopReaction::HoldsAfterThread, "{cell}: Z{z}");
                }
                resume_and_check_end(scene, cause, motion, &cell).await;
            }
            StopReaction::EndsJog => {
                scene.plc().sleep(ms(200)).await;
                let state = system.state().await.unwrap();
                assert_eq!(state.execution, Execution::Ready, "{cell}");
            }
            StopReaction::Stops | StopReaction::Brakes => {
                assert_eq!(state.execution, Execution::Stopped, "{cell}");
            }
            // after the thread the program waits for an M code, and the lost broker holds the run there
            StopReaction::Continues if motion == StoppedMotion::Thread => {
                assert!(at(&system, "Z").await >= -5.0 - 1e-9, "{cell}: {state:?}");
            }
            StopReaction::Continues => {
                assert_eq!(state.execution, motion_ends_in(motion), "{cell}");
            }
        }
    });
    played.unwrap_or_else(|error| panic!("{cell}: {error}"));
}

/// Returns the state word in which a motion ends if no cause stops it.
fn motion_ends_in(motion: StoppedMotion) -> Execution {
    match motion {
        StoppedMotion::Jog | StoppedMotion::Home => Execution::Ready,
        _ => Execution::ProgramCompleted,
    }
}

/// Ends the cause, resumes the motion and checks that it reaches its end.
async fn resume_and_check_end(scene: &Scene, cause: StopCause, motion: StoppedMotion, cell: &str) {
    let system = scene.cs(1);
    match cause {
        StopCause::Interlock => system.set_interlock(false, "").await.unwrap(),
        StopCause::SourceLost => {
            scene.serve(SequenceProgram::new().handler_id("door"));
            scene.plc().sleep(ms(100)).await;
            system.set_interlock_source("door", false, "").await.unwrap();
        }
        _ => {}
    }
    system
        .resume()
        .await
        .unwrap_or_else(|error| panic!("{cell}: {error}"));
    until_rest(scene, 60.0).await;
    let state = system.state().await.unwrap();
    assert_eq!(state.execution, motion_ends_in(motion), "{cell}");
    let x = at(&system, "X").await;
    let end = match motion {
        StoppedMotion::Rapid | StoppedMotion::Line | StoppedMotion::Compensation => 290.0,
        StoppedMotion::Arc => 100.0,
        _ => 0.0,
    };
    assert!((x - end).abs() < 1e-9, "{cell}: {x}");
}

/// An operator's hold that waits for the end of a thread must not delay a cause that acts in the thread.
#[test]
fn p10_cause_that_acts_in_a_thread_overtakes_a_hold_that_waits() {
    let motion = StoppedMotion::Thread;
    let act = |cause: &StopCause| cause.reaction(motion) == StopReaction::HoldsInPhase;
    for cause in StopCause::ALL.into_iter().filter(act) {
        let bench = Bench::on_machine(machine())
            .serve(SequenceProgram::new().handler_id("door"))
            .subprogram(50, program(motion));
        let played = bench.play(async move |owned: Scene, runtime| {
            let (scene, system) = (&owned, owned.cs(1));
            system.set_interlock_source("door", false, "").await.unwrap();
            begin(scene, motion, 0).await;
            raise(scene, runtime, StopCause::Hold).await;
            scene.plc().sleep(ms(50)).await;
            assert_eq!(
                system.state().await.unwrap().execution,
                Execution::Active,
                "it waits"
            );
            raise(scene, runtime, cause).await;
            until_rest(scene, 30.0).await;
            let state = system.state().await.unwrap();
            let z = at(&system, "Z").await;
            assert!(z < -5.0, "{cause:?}: Z{z} {state:?}");
            let expected = match cause {
                StopCause::ServoLate => Some(Reason::ServoLate),
                StopCause::ClientLost => Some(Reason::ClientLost),
                _ => Some(Reason::Interlock),
            };
            assert_eq!(state.reason, expected, "{cause:?}");
            resume_and_check_end(scene, cause, motion, &format!("{cause:?}")).await;
        });
        played.unwrap_or_else(|error| panic!("{cause:?}: {error}"));
    }
}

macro_rules! cells {
    ($($name:ident = $motion:ident;)*) => {
        $(#[test]
        fn $name() {
            for cause in StopCause::ALL {
                for seed in 0..SEEDS {
                    play(cause, StoppedMotion::$motion, seed);
                }
            }
        })*
    };
}

cells! {
    p10_each_cause_stops_a_rapid_as_the_table_says = Rapid;
    p10_each_cause_stops_a_line_as_the_table_says = Line;
    p10_each_cause_stops_an_arc_as_the_table_says = Arc;
    p10_each_cause_stops_a_thread_as_the_table_says = Thread;
    p10_each_cause_stops_a_dwell_as_the_table_says = Dwell;
    p10_each_cause_stops_a_jog_as_the_table_says = Jog;
    p10_each_cause_stops_homing_as_the_table_says = Home;
    p10_each_cause_stops_compensated_motion_as_the_table_says = Compensation;
    p10_each_cause_stops_at_a_reversal_as_the_table_says = Reversal;
}
