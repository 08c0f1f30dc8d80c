//! A handler of an M code costs one function of the user, and is tested in simulated time.

use std::time::Duration;

use plc_api::{Alarm, AuxOutput, Execution, Plc, SequenceProgram};
use tandem_testing::Bench;

/// M150 VA: blows chips away for VA seconds.
async fn blow(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    let seconds = output
        .params()
        .a()
        .ok_or(Alarm::user(150, "M150 needs VA: seconds"))?;
    plc.sleep(Duration::from_secs_f64(seconds)).await;
    Ok(())
}

/// Runs a program with the handler; returns the kind and the time of its end, and the alarm's text.
fn run(program: &'static str) -> (Execution, f64, Option<String>) {
    let bench = Bench::new().serve(SequenceProgram::new().on(150, blow));
    let played = bench.subprogram(500, program).play(async |scene, _| {
        let (plc, system) = (scene.plc(), scene.cs(1));
        system.load(500).await.unwrap();
        let started_s = plc.now_s();
        system.start().await.unwrap();
        let ended = |state: &plc_protocol::types::state::State| {
            matches!(state.execution, Execution::ProgramCompleted | Execution::Stopped)
        };
        let state = system.wait_for(ended).await.unwrap();
        let took_s = plc.now_s() - started_s;
        let active = plc
            .port()
            .read(&plc_protocol::types::topic::Topic::AlarmActive)
            .await
            .unwrap();
        let text = match &active.payload {
            plc_protocol::types::message::Payload::AlarmActive(active) => {
                active.alarms.first().map(|alarm| alarm.text.clone())
            }
            _ => None,
        };
        (state.execution, took_s, text)
    });
    played.unwrap()
}

#[test]
fn a_handler_is_a_function_and_its_sleep_is_simulated_time() {
    let begun = std::time::Instant::now();
    let (execution, took_s, _) = run("M150 VA600\nM30\n");
    assert_eq!(execution, Execution::ProgramCompleted);
    assert!((600.0 - 1e-6..600.01).contains(&took_s), "{took_s}");
    assert!(
        begun.elapsed() < Duration::from_mins(1),
        "ten minutes do not take one"
    );
}

#[test]
fn a_handlers_error_stops_the_program_with_its_text() {
    let (execution, _, text) = run("M150\nM30\n");
    assert_eq!(execution, Execution::Stopped);
    assert_eq!(text.as_deref(), Some("M150 needs VA: seconds"));
}
