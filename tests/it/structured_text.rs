//! Sequence programs in Structured Text: `tandem st`, and the example on a machine in simulated time.

use std::time::Duration;

use plc_api::SequenceProgram;
use tandem_structured_text::Program;
use tandem_testing::{Bench, Run};

use crate::book::generated::check;
use crate::support::binary::{root, tandem};
use crate::support::machine::Machine;
use crate::support::served::{FREE_PORTS, Process, Served};
use crate::support::simulated::run;

const DOOR: &str = include_str!("../../examples/structured-text/door.st");

#[test]
fn the_page_of_structured_text_is_that_of_its_tables() {
    check(
        "docs/src/reference/structured-text.md",
        &tandem_structured_text::reference::page(),
    );
}

fn st(text: &str, arguments: &[&str]) -> crate::support::simulated::Ran {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("a.st"), text).unwrap();
    run(folder.path(), &[&["st", "a.st"], arguments].concat())
}

#[test]
fn a_check_tells_line_column_code_and_help_and_exits_with_1() {
    let ran = st(
        "PROGRAM p\nVAR a : INT; b : DINT; END_VAR\n  a := b;\nEND_PROGRAM\n",
        &["--check"],
    );
    assert_eq!((ran.code, ran.stderr.as_str()), (1, ""));
    for part in [
        "error[ST031]",
        "a.st:3:8",
        "DINT is not converted to INT implicitly",
        "write DINT_TO_INT(...)",
        "a.st: 1 error",
    ] {
        assert!(ran.stdout.contains(part), "no {part} in {}", ran.stdout);
    }
}

#[test]
fn a_program_that_is_right_tells_the_m_codes_that_it_serves() {
    let ran = st(DOOR, &[]);
    let text = "a.st: 0 errors\n  M codes that the program serves: M08 M09 M10\n";
    assert_eq!(
        (ran.code, ran.stdout.as_str(), ran.stderr.as_str()),
        (0, text, "")
    );
}

#[test]
fn findings_as_json_have_the_form_of_tandem_check() {
    let ran = st(
        "PROGRAM p\nVAR m : MCODE; END_VAR\nm(M := 12);\nx := 1;\nEND_PROGRAM\n",
        &["--format", "json"],
    );
    assert_eq!(ran.code, 1);
    let found = &ran.json()["files"][0]["diagnostics"][0];
    assert_eq!(
        (&found["code"], &found["line"], &found["column"]),
        (&"ST020".into(), &4.into(), &1.into())
    );
    let ran = st(
        "PROGRAM p VAR m : MCODE; END_VAR m(M := 12); END_PROGRAM",
        &["--format", "json"],
    );
    assert_eq!(ran.json()["files"][0]["m_codes"], serde_json::json!([12]));
}

#[test]
fn a_program_that_is_wrong_is_not_run_and_a_run_needs_a_machine() {
    let ran = st(
        "PROGRAM p x := 1; END_PROGRAM",
        &["--run", "--connect", "mqtt://127.0.0.1:1/mill-1"],
    );
    assert_eq!((ran.code, ran.stdout.as_str()), (1, ""));
    assert!(ran.stderr.contains("ST020"), "{}", ran.stderr);
    assert_eq!(st(DOOR, &["--run"]).code, 2);
    assert_eq!(
        st(DOOR, &["--run", "--connect", "mqtt://127.0.0.1:1/mill-1"]).code,
        2
    );
}

#[test]
fn a_finding_is_explained() {
    let folder = tempfile::tempdir().unwrap();
    let ran = run(folder.path(), &["explain", "st031"]);
    assert!(
        ran.stdout.starts_with("ST031: A value could be lost"),
        "{}",
        ran.stdout
    );
}

/// The example, scanned every 10 ms.
fn sequence() -> SequenceProgram {
    let program = Program::compile("door.st", DOOR).unwrap();
    program.sequence_program(Duration::from_millis(10))
}

/// The example on a machine in simulated time. The pressure of the clamp comes 0.5 s after M10, unless it fails.
fn door(program: &str, pressure: f64) -> Run {
    Bench::new()
        .serve(sequence())
        .at_output(10, move |scene| async move {
            scene.plc().sleep(Duration::from_millis(500)).await;
            scene.plc().variables().set(501, pressure).await
        })
        .run(program)
        .unwrap()
}

#[test]
fn the_clamp_of_the_example_closes_before_the_motion_goes_on() {
    let run = door("M10 VA5\nG01 X10 F3000\nM30", 5.0).completed().unwrap();
    assert_eq!(run.order(1), ["output M10 VA5", "reset M10", "block 2", "end"]);
    // 0.5 s of the plant, 0.2 s of pressure, and the time of scans and reads
    let took_s = run.output(10).unwrap().took_s().unwrap();
    assert!((0.7..0.8).contains(&took_s), "{took_s}");
    assert_eq!(run.p(503), 5.0);
}

#[test]
fn the_clamp_of_the_example_that_does_not_close_is_an_alarm_after_3_s() {
    let run = door("M10 VA5\nM30", 4.0);
    assert_eq!(run.alarm().unwrap().text, "the clamp does not close within 3 s");
    assert!((3.0..3.1).contains(&run.time_s), "{}", run.time_s);
    let run = door("M10 VA21\nM30", 4.0);
    assert_eq!(run.alarm().unwrap().text, "M10 takes a force VA of 1 to 20 kN");
}

#[test]
fn the_coolant_of_the_example_follows_m08_and_m09() {
    for (program, valve) in [("M08\nG04 P1\nM30", 1.0), ("M08\nG04 P1\nM09\nG04 P1\nM30", 0.0)] {
        let run = Bench::new()
            .serve(sequence())
            .run(program)
            .unwrap()
            .completed()
            .unwrap();
        assert_eq!(run.p(502), valve, "{program}");
    }
}

#[test]
fn an_open_door_of_the_example_holds_the_motion() {
    let run = Bench::new()
        .serve(sequence())
        .at_s(
            0.5,
            |scene| async move { scene.plc().variables().set(500, 1.0).await },
        )
        .max_time_s(5.0)
        .run("G01 X100 F600\nM30")
        .unwrap();
    // 10 s of motion at 10 mm/s, held shortly after 0.5 s
    let x = run.system(1).unwrap().machine["X"];
    assert!((4.0..7.0).contains(&x), "{x}");
}

#[tokio::test]
async fn a_program_runs_on_a_machine_until_ctrl_c_over_mqtt_and_rest() {
    let machine = Machine::new(FREE_PORTS);
    let served = Served::start(&machine);
    for (number, url) in [(50, served.mqtt_url()), (51, served.http_url())] {
        run_door(&machine, &served, &url, number).await;
        served.command(1, "reset").await;
    }
}

async fn run_door(machine: &Machine, served: &Served, url: &str, number: u16) {
    let path = root().join("examples/structured-text/door.st");
    let path = path.to_string_lossy();
    let arguments = [
        "st",
        &*path,
        "--run",
        "--connect",
        url,
        "--handler-id",
        "door",
        "--period-ms",
        "5",
    ];
    let mut program = Process::start(tandem(), machine.folder(), &arguments);
    program.line("it runs", |line| line.contains("The program runs"));
    served.load(1, number, "M08\nM09\nG00 X5\nM30\n").await;
    crate::support::wait::until("the program is known", async || {
        let handlers = served.get("/handlers").await.expect(200).body;
        handlers.contains("door").then_some(())
    })
    .await;
    served.command(1, "start").await;
    served.execution(1, "PROGRAM_COMPLETED").await;
    program.signal("INT");
    assert_eq!(
        program.exit_code_within(Duration::from_secs(10)),
        Some(0),
        "{}",
        program.output
    );
}
