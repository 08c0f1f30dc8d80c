use std::time::Duration;

use plc_api::{CoordinateSystem, Execution, Plc};
use plc_protocol::types::command::Command;
use plc_protocol::types::run::{Run, RunEndedHow, RunOrder};

use tandem_store::journal::Event;
use tandem_store::program_store::StoredProgram;
use tandem_testing::{Bench, kept_journal};

use crate::Runtime;
use crate::simulation::tests::play;

/// Program of a part that takes at least 3 s.
const PART: &str = "G90 G01 X10 F600\nX0 F600\nG04 X1\nM30\n";

fn order(parts: u32) -> RunOrder {
    RunOrder {
        program: Some(50),
        parts,
    }
}

fn s(s: u64) -> Duration {
    Duration::from_secs(s)
}

async fn run_of(cs: &CoordinateSystem) -> Run {
    cs.newest_run().await.unwrap().unwrap()
}

async fn end_of(cs: &CoordinateSystem) -> (RunEndedHow, u32) {
    let run = run_of(cs).await;
    (run.end.unwrap().how, run.parts_done)
}

/// Waits until a part waits, and returns the reason.
async fn waits_for(plc: &Plc, cs: &CoordinateSystem) -> String {
    loop {
        if let Some(text) = run_of(cs).await.waits_for {
            return text;
        }
        plc.sleep(Duration::from_millis(100)).await;
    }
}

#[test]
fn each_part_starts_after_the_previous_completion_and_all_are_one_run() {
    let (journal, lines) = kept_journal();
    let bench = Bench::new().journal(journal).subprogram(50, PART);
    let play = bench.play(async |scene, _| {
        let mill = scene.cs(1);
        let ordered = mill.order(order(3)).await.unwrap();
        let end = ordered.ended().await.unwrap();
        assert_eq!((end.parts, end.parts_done), (3, 3));
        assert_eq!(end.end.unwrap().how, RunEndedHow::Completed);
        assert_eq!(mill.state().await.unwrap().execution, Execution::ProgramCompleted);
        scene.plc().sleep(s(60)).await;
        let made = mill.runs(0, 10).await.unwrap();
        assert_eq!((made.runs.len(), made.production[0].parts), (1, 3));
        assert_eq!(made.runs[0].id, ordered.id());
        assert_eq!(end.id, ordered.id());
    });
    play.unwrap();
    let lines = lines.lock().unwrap();
    let told: Vec<_> = lines
        .iter()
        .filter_map(|line| match &line.event {
            Event::Start { run_id, .. } => Some(("start", run_id.clone())),
            Event::End(_) => Some(("end", String::new())),
            _ => None,
        })
        .collect();
    let words: Vec<_> = told.iter().map(|(word, _)| *word).collect();
    assert_eq!(words, ["start", "end", "start", "end", "start", "end"]);
    assert!(told[0].1 == told[2].1 && told[0].1 == told[4].1, "{told:?}");
}

#[test]
fn the_next_part_waits_for_the_end_of_the_start_lock_and_of_the_interlock() {
    let bench = Bench::new().subprogram(50, PART);
    let play = bench.play(async |scene, _| {
        let (plc, mill) = (scene.plc(), scene.cs(1));
        mill.order(order(3)).await.unwrap();
        mill.set_start_lock(true, "load a blank").await.unwrap();
        let why = waits_for(plc, &mill).await;
        assert!(why.contains("load a blank"), "{why}");
        plc.sleep(s(100)).await;
        assert_eq!(run_of(&mill).await.parts_done, 1);
        mill.set_start_lock(false, "").await.unwrap();
        plc.sleep(s(1)).await;
        assert_eq!(mill.state().await.unwrap().execution, Execution::Active);
        mill.wait_until(Execution::ProgramCompleted).await.unwrap();
        plc.sleep(s(60)).await;
        assert_eq!(end_of(&mill).await, (RunEndedHow::Completed, 3));
    });
    play.unwrap();
}

#[test]
fn no_part_begins_after_a_stop_an_alarm_or_a_reset() {
    for (how, wanted) in [
        ("stop", RunEndedHow::Stopped),
        ("abort", RunEndedHow::Aborted),
        ("alarm", RunEndedHow::Alarm),
        ("reset", RunEndedHow::Reset),
    ] {
        for between in [false, true] {
            let bench = Bench::new().subprogram(50, PART);
            let play = bench.play(async move |scene, _| {
                let (plc, mill) = (scene.plc(), scene.cs(1));
                mill.order(order(3)).await.unwrap();
                if between {
                    mill.set_start_lock(true, "not yet").await.unwrap();
                    waits_for(plc, &mill).await;
                } else {
                    plc.sleep(s(1)).await;
                }
                match how {
                    "stop" => mill.stop().await.unwrap(),
                    "abort" => mill.abort().await.unwrap(),
                    "alarm" => plc.raise_alarm(plc_api::Alarm::user(7, "door")).await.unwrap(),
                    _ => {
                        mill.hold().await.unwrap();
                        mill.reset().await.unwrap();
                    }
                }
                mill.set_start_lock(false, "").await.unwrap();
                plc.sleep(s(60)).await;
                let done = u32::from(between);
                assert_eq!(end_of(&mill).await, (wanted, done), "{how} {between}");
                let state = mill.state().await.unwrap().execution;
                assert_ne!(state, Execution::Active, "{how} {between}");
            });
            play.unwrap();
        }
    }
}

#[test]
fn another_command_takes_the_place_of_parts_that_have_not_begun() {
    let bench = Bench::new().subprogram(50, PART);
    let play = bench.play(async |scene, _| {
        let (plc, mill) = (scene.plc(), scene.cs(1));
        for command in [Command::Load { program: 50 }, Command::Home { axes: vec!['X'] }] {
            mill.order(order(2)).await.unwrap();
            mill.set_start_lock(true, "not yet").await.unwrap();
            waits_for(plc, &mill).await;
            mill.command(command).await.unwrap();
            mill.set_start_lock(false, "").await.unwrap();
            plc.sleep(s(60)).await;
            assert_eq!(end_of(&mill).await, (RunEndedHow::Replaced, 1));
            assert_eq!(mill.state().await.unwrap().execution, Execution::Ready);
        }
    });
    play.unwrap();
}

#[test]
fn no_part_begins_when_the_lease_of_the_order_has_ended() {
    let bench = Bench::new().subprogram(50, PART);
    let play = bench.play(async |scene, _| {
        let (plc, mill) = (scene.plc(), scene.cs(1));
        let lease = mill.take_lease(s(600)).await.unwrap();
        lease.coordinate_system().order(order(3)).await.unwrap();
        mill.set_start_lock(true, "not yet").await.unwrap();
        waits_for(plc, &mill).await;
        lease.release().await.unwrap();
        mill.set_start_lock(false, "").await.unwrap();
        plc.sleep(s(60)).await;
        assert_eq!(end_of(&mill).await, (RunEndedHow::LeaseLost, 1));
    });
    play.unwrap();
}

/// Writes another text into the machine's store, as if a person had changed a file in its folder.
fn write_outside(runtime: &Runtime, number: u16, text: &str) {
    let shared = &runtime.port.shared;
    let program = StoredProgram::new(number, text, shared.machine.text_rules());
    shared.store.keep(program);
    shared.wake_all();
}

/// Main program that computes which subprogram it calls: 1001 in the first part, 1002 in the second part.
const COMPUTES: &str = "P1 = P1 + 1\nL1 = 1000 + P1\nM98 P[L1]\nM98 P1010\nG90 G01 X10 F600\nX0\nM30\n";

const CALLED: &str = "G91 G01 X1 F600\nM99\n";

#[test]
fn the_next_part_is_refused_when_a_program_of_the_run_was_changed_outside() {
    for (number, is_refused) in [(50, true), (1001, true), (1010, true), (1003, false)] {
        let (journal, lines) = kept_journal();
        let programs = [
            (50, COMPUTES),
            (1001, CALLED),
            (1002, CALLED),
            (1003, CALLED),
            (1010, CALLED),
        ];
        let hash = play(journal, &programs, async move |runtime, plc| {
            let mill = plc.coordinate_system(1);
            let ordered = mill.order(order(2)).await.unwrap();
            let hash = mill.state().await.unwrap().hash;
            plc.sleep(s(1)).await;
            write_outside(runtime, number, "G91 G01 Y5 F600\nM99\n");
            let end = ordered.ended().await.unwrap();
            let (how, done) = (end.end.as_ref().unwrap().how, end.parts_done);
            let wanted = if is_refused {
                (RunEndedHow::Refused, 1)
            } else {
                (RunEndedHow::Completed, 2)
            };
            assert_eq!((how, done), wanted, "{number}");
            assert_eq!(end.hash, hash, "{number}");
            let text = end.end.unwrap().text;
            assert_eq!(
                text.contains(&format!("program {number} was changed")),
                is_refused,
                "{text}"
            );
            assert!(
                mill.position().await.unwrap().machine["Y"].abs() < 1e-9,
                "{number}"
            );
            hash
        });
        let lines = lines.lock().unwrap();
        let begun = lines.iter().filter_map(|line| match &line.event {
            Event::Start { program_hash, .. } => Some(program_hash),
            _ => None,
        });
        assert!(begun.into_iter().all(|begun| *begun == hash), "{number}");
    }
}

#[test]
fn a_run_without_a_program_or_of_one_with_errors_is_refused() {
    let bench = Bench::new().subprogram(50, PART).subprogram(60, "G01 Q\nM30\n");
    let play = bench.play(async |scene, _| {
        let mill = scene.cs(2);
        let none = RunOrder {
            program: None,
            parts: 1,
        };
        let refusal = mill.order(none).await.unwrap_err().to_string();
        assert!(refusal.contains("no program is loaded"), "{refusal}");
        let refusal = mill.run(60).await.unwrap_err().to_string();
        assert!(refusal.contains("60"), "{refusal}");
        assert_eq!(mill.newest_run().await.unwrap(), None);
    });
    play.unwrap();
}
