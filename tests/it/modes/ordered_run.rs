//! All parts of an ordered run have the same text: its programs stay in the store until the run has ended.

use std::time::Duration;

use plc_api::{CoordinateSystem, Plc};
use plc_protocol::types::request::{RefusalCode, Request};
use plc_protocol::types::run::{Run, RunEndedHow, RunOrder};
use tandem_testing::Bench;

use crate::support::machine::bench;

/// The main program computes which subprogram it calls: 1001 in the first part, 1002 in the second one.
const COMPUTES: &str = "P1 = P1 + 1\nL1 = 1000 + P1\nM98 P[L1]\nM98 P1010\nG90 G01 X10 F600\nX0\nM30\n";

fn order(parts: u32) -> RunOrder {
    RunOrder {
        program: Some(50),
        parts,
    }
}

fn s(s: u64) -> Duration {
    Duration::from_secs(s)
}

async fn newest(cs: &CoordinateSystem) -> Run {
    cs.newest_run().await.unwrap().unwrap()
}

/// Waits until a run waits for an output.
async fn waits_for(plc: &Plc, cs: &CoordinateSystem) {
    while newest(cs).await.waits_for.is_none() {
        plc.sleep(Duration::from_millis(100)).await;
    }
}

fn computing() -> Bench {
    let called = "G91 G01 X1 F600\nM99\n";
    [1001, 1002, 1003, 1010]
        .into_iter()
        .fold(bench("").subprogram(50, COMPUTES), |bench, number| {
            bench.subprogram(number, called)
        })
}

async fn store(plc: &Plc, number: u16, text: &str) -> Result<(), (RefusalCode, Option<String>)> {
    let request = Request::WriteProgram(number, text.to_owned());
    let stored = plc.port().request(request).await;
    stored.map(drop).map_err(|refusal| (refusal.code, refusal.run_id))
}

async fn remove(plc: &Plc, number: u16) -> Result<(), (RefusalCode, Option<String>)> {
    let removed = plc.port().request(Request::DeleteProgram(number)).await;
    removed
        .map(drop)
        .map_err(|refusal| (refusal.code, refusal.run_id))
}

#[test]
fn programs_of_an_ordered_run_are_not_stored_or_removed_until_it_ends() {
    let play = computing().play(async |scene, _| {
        let (plc, mill) = (scene.plc(), scene.cs(1));
        let ordered = mill.order(order(2)).await.unwrap();
        let refused = Err((RefusalCode::ProgramRuns, Some(ordered.id().to_owned())));
        plc.sleep(s(1)).await;
        for number in [50, 1001, 1002, 1010] {
            assert_eq!(
                store(plc, number, "M30\n").await,
                refused,
                "{number} while a part moves"
            );
            assert_eq!(remove(plc, number).await, refused, "{number} while a part moves");
        }
        mill.set_start_lock(true, "the loader loads").await.unwrap();
        waits_for(plc, &mill).await;
        for number in [50, 1001, 1010] {
            assert_eq!(
                store(plc, number, "M30\n").await,
                refused,
                "{number} between parts"
            );
            assert_eq!(remove(plc, number).await, refused, "{number} between parts");
        }
        // no part has called it
        assert_eq!(store(plc, 1003, "M99\n").await, Ok(()));
        mill.set_start_lock(false, "").await.unwrap();
        assert_eq!(
            ordered.ended().await.unwrap().end.unwrap().how,
            RunEndedHow::Completed
        );
        for number in [50, 1001, 1002, 1010] {
            assert_eq!(
                store(plc, number, "M30\n").await,
                Ok(()),
                "{number} after the run"
            );
        }
    });
    play.unwrap();
}

#[test]
fn each_end_of_a_run_frees_its_programs() {
    for how in ["stop", "abort", "alarm", "reset", "load"] {
        for between in [false, true] {
            let play = computing().play(async move |scene, _| {
                let (plc, mill) = (scene.plc(), scene.cs(1));
                mill.order(order(3)).await.unwrap();
                if between {
                    mill.set_start_lock(true, "not yet").await.unwrap();
                    waits_for(plc, &mill).await;
                } else {
                    plc.sleep(s(1)).await;
                }
                assert!(store(plc, 50, "M30\n").await.is_err(), "{how} {between}");
                match how {
                    "stop" => mill.stop().await.unwrap(),
                    "abort" => mill.abort().await.unwrap(),
                    "alarm" => plc.raise_alarm(plc_api::Alarm::user(7, "door")).await.unwrap(),
                    "load" if between => mill.load(50).await.unwrap(),
                    _ => {
                        mill.hold().await.unwrap();
                        mill.reset().await.unwrap();
                    }
                }
                plc.sleep(s(1)).await;
                assert_eq!(store(plc, 50, "M30\n").await, Ok(()), "{how} {between}");
            });
            play.unwrap();
        }
    }
}
