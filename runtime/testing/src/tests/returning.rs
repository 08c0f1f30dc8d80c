//! Tests of a handler that announces the time of its return when it leaves.

use super::*;

fn program(name: &str) -> SequenceProgram {
    SequenceProgram::new()
        .handler_id(name)
        .on(20, async |_output: AuxOutput| Ok(()))
}

/// Adds a sequence program that starts at `from_s` and is stopped `to_s` seconds later.
fn there(bench: Bench, program: SequenceProgram, from_s: u64, to_s: u64) -> Bench {
    bench.plant(move |scene| async move {
        let plc = scene.plc().clone();
        plc.sleep(Duration::from_secs(from_s)).await;
        program
            .run_until(&plc, plc.sleep(Duration::from_secs(to_s)))
            .await
    })
}

#[test]
fn an_m_code_waits_for_its_handler_that_was_stopped_and_is_back_in_time() {
    let bench = there(Bench::new(), program("cell"), 0, 1);
    let bench = there(bench, program("cell"), 30, 1000);
    let run = bench.run("G04 X2\nM20\nM30").unwrap().completed().unwrap();
    let output = run.output(20).unwrap();
    assert!((output.output_s - 2.0).abs() < 0.05, "{output:?}");
    assert!((run.time_s - 30.0).abs() < 0.05, "{}", run.time_s);
}

#[test]
fn an_m_code_whose_handler_is_not_back_in_time_is_an_alarm_then() {
    let stopped = || program("cell").returns_within(Duration::from_secs(10));
    let run = there(Bench::new(), stopped(), 0, 1)
        .run("G04 X2\nM20\nM30")
        .unwrap();
    assert!(run.alarm().unwrap().text.contains("M20 has no handler"));
    assert!((run.time_s - 11.0).abs() < 0.05, "{}", run.time_s);
    // Outputs that are issued while the sequence program is ending wait for its return, too.
    let slow = stopped().on(21, wait);
    let run = there(Bench::new(), slow, 0, 1).beside(2, 7, "G04 X2\nM20\nM30");
    let run = run.run("M21 VA5\nM30").unwrap();
    assert!((run.time_s - 15.0).abs() < 0.05, "{}", run.time_s);
}

#[test]
fn one_that_does_not_come_back_is_waited_for_during_the_grace_time() {
    let gone = program("cell").returns_within(Duration::ZERO);
    let run = there(Bench::new(), gone, 0, 1).run("G04 X2\nM20\nM30").unwrap();
    assert!(run.alarm().unwrap().text.contains("M20 has no handler"));
    // The handler left at 1 s, and the grace time is 2 s.
    assert!((run.time_s - 3.0).abs() < 0.05, "{}", run.time_s);
}

#[test]
fn slow_handler_is_dropped_at_its_limit_and_its_successor_redoes_work() {
    let program = || {
        let program = SequenceProgram::new().handler_id("cell").on(21, wait);
        program.on_redelivery(Redelivery::Redo)
    };
    let slow = program().ends_within(Duration::from_secs(3));
    let bench = there(Bench::new(), slow, 0, 1);
    let run = there(bench, program(), 30, 1000).run("M21 VA5\nM30");
    let run = run.unwrap().completed().unwrap();
    assert!((run.time_s - 35.0).abs() < 0.05, "{}", run.time_s);
    // A handler that finishes its outputs within that time loses none of them.
    let quick = program().ends_within(Duration::from_secs(6));
    let bench = there(Bench::new(), quick, 0, 1);
    let run = there(bench, program(), 30, 1000).run("M21 VA5\nM30");
    assert!((run.unwrap().completed().unwrap().time_s - 5.0).abs() < 0.05);
}
