//! All files in `examples/` work as described.

use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::Duration;

use plc_api::{Execution, Plc};
use plc_protocol::types::state::Reason;
use tandem_runtime::{Config, demo_sequence_program};
use tandem_testing::Bench;

use crate::support::binary::{example, root};
use crate::support::machine::Machine;
use crate::support::served::{FREE_PORTS, Process, Served};
use crate::support::simulated::run;

/// Examples that serve until they are stopped, with the address of a machine as argument.
const HANDLERS: [&str; 1] = ["04_mqtt_handler"];

fn files(folder: &str, extension: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(root().join(folder)).expect("a folder");
    let mut files: Vec<_> = entries
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.extension().is_some_and(|it| it == extension))
        .collect();
    files.sort();
    assert!(!files.is_empty(), "nothing in {folder}");
    files
}

fn name(path: &std::path::Path) -> String {
    path.file_stem().expect("a name").to_string_lossy().into_owned()
}

#[test]
fn every_example_ends_well_within_a_minute() {
    for path in files("examples", "rs") {
        let name = name(&path);
        if HANDLERS.contains(&name.as_str()) {
            continue;
        }
        let folder = tempfile::tempdir().unwrap();
        let mut process = Process::start(&example(&name), folder.path(), &[]);
        let code = process.exit_code_within(Duration::from_mins(1));
        assert_eq!(code, Some(0), "{name}:\n{}", process.output);
        assert!(!process.output.trim().is_empty(), "{name} prints what it does");
    }
}

#[tokio::test]
async fn an_mqtt_handler_serves_a_machine_until_it_is_stopped() {
    for name in HANDLERS {
        let machine = Machine::new(FREE_PORTS);
        let served = Served::start(&machine);
        let url = served.mqtt_url();
        let mut handler = Process::start(&example(name), machine.folder(), &[url.as_str()]);
        handler.line("it is there", |line| line.contains(url.as_str()));
        served.load(1, 50, "G00 X5\nM12 VA5\nM30\n").await;
        crate::support::wait::until("the handler is known", async || {
            let handlers = served.get("/handlers").await.expect(200).body;
            handlers.contains("12").then_some(())
        })
        .await;
        served.command(1, "start").await;
        served.execution(1, "PROGRAM_COMPLETED").await;
        handler.signal("INT");
        assert_eq!(
            handler.exit_code_within(Duration::from_secs(5)),
            Some(0),
            "{}",
            handler.output
        );
    }
}

#[test]
fn every_example_says_how_to_run_it_and_has_at_most_80_lines() {
    for path in files("examples", "rs") {
        let text = std::fs::read_to_string(&path).unwrap();
        let call = format!("cargo run --example {}", name(&path));
        assert!(text.contains(&call), "{} does not say `{call}`", path.display());
        assert!(
            text.lines().count() <= 80,
            "{} has more than 80 lines",
            path.display()
        );
    }
}

#[test]
fn every_nc_program_is_clean_for_the_demo_machine() {
    let programs: Vec<_> = files("examples/nc", "nc")
        .iter()
        .map(|path| path.display().to_string())
        .collect();
    let mut arguments = vec!["check", "--format", "json"];
    arguments.extend(programs.iter().map(String::as_str));
    let ran = run(root(), &arguments);
    assert_eq!(ran.code, 0, "{}{}", ran.stdout, ran.stderr);
    for file in ran.json()["files"].as_array().unwrap() {
        assert_eq!(file["diagnostics"].as_array().unwrap().len(), 0, "{file}");
    }
}

#[test]
fn every_main_program_simulates_to_completion_on_the_demo_machine() {
    for path in files("examples/nc", "nc") {
        let is_subprogram = name(&path).parse::<u16>().is_ok_and(|number| number >= 1000);
        if is_subprogram {
            continue;
        }
        let cs = if name(&path) == "loader" { "2" } else { "1" };
        let ran = run(
            root(),
            &["simulate", path.to_str().unwrap(), "--cs", cs, "--json"],
        );
        assert_eq!(ran.code, 0, "{}: {}{}", path.display(), ran.stdout, ran.stderr);
        let result = ran.json();
        assert_eq!(result["outcome"], "completed");
        assert_eq!(result["warnings"].as_array().unwrap().len(), 0, "{result}");
        assert!(result["cycle_time_s"].as_f64().unwrap() > 1.0);
    }
}

#[test]
fn the_plate_of_dialect_dgshape_is_clean_and_simulates_to_completion() {
    let program = "examples/nc/dgshape/plate.nc";
    let config = ["--config", "examples/config/dgshape.toml"];
    let ran = run(root(), &[&["check", program], &config[..]].concat());
    assert!(
        ran.stdout.contains("0 errors, 0 warnings"),
        "{}{}",
        ran.stdout,
        ran.stderr
    );
    let ran = run(root(), &[&["simulate", program, "--json"], &config[..]].concat());
    let result = ran.json();
    assert_eq!(
        (ran.code, &result["outcome"]),
        (0, &"completed".into()),
        "{result}"
    );
    assert_eq!(result["warnings"].as_array().unwrap().len(), 0, "{result}");
    assert_eq!(result["machine"]["Z"], 100.0, "at the reference point");
}

#[test]
fn two_coordinate_systems_run_programs_of_two_dialects_at_once() {
    let arguments = [
        "simulate",
        "examples/nc/dgshape/plate.nc",
        "--with",
        "2=examples/nc/loader.nc",
        "--config",
        "examples/config/two-dialects.toml",
        "--json",
    ];
    let ran = run(root(), &arguments);
    assert_eq!(ran.code, 0, "{}{}", ran.stdout, ran.stderr);
    assert_eq!(ran.json()["outcome"], "completed");
}

#[test]
fn the_part_transfer_simulates_in_both_coordinate_systems_at_once() {
    let ran = run(
        root(),
        &[
            "simulate",
            "examples/nc/transfer.nc",
            "--with",
            "2=examples/nc/loader.nc",
            "--json",
        ],
    );
    assert_eq!(ran.code, 0, "{}{}", ran.stdout, ran.stderr);
    assert_eq!(ran.json()["outcome"], "completed");
}

#[test]
fn every_configuration_is_good() {
    for path in files("examples/config", "toml") {
        let ran = run(root(), &["check", "--config", path.to_str().unwrap()]);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
    }
}

#[test]
fn tandem_alone_takes_no_arguments_and_names_its_commands() {
    let help = Command::new(crate::support::binary::tandem())
        .arg("--help")
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let help = String::from_utf8(help.stdout).unwrap();
    for word in ["serve", "check", "simulate", "--config"] {
        assert!(help.contains(word), "{word} is missing in {help}");
    }
}

/// Runs programs of the demo machine with its own sequence program, in simulated time. M80 is reset by an operator.
fn demo(programs: &'static [(u8, u16)]) -> Vec<(Execution, Option<Reason>)> {
    let machine = Config::demo().resolve().expect("the demo machine");
    let bench = Bench::on_machine(machine).serve(demo_sequence_program());
    let played = bench.play(async move |scene, _| {
        let plc = scene.plc();
        for (cs, program) in programs {
            plc.coordinate_system(*cs).load(*program).await.expect("load");
        }
        for (cs, _) in programs {
            plc.coordinate_system(*cs).start().await.expect("start");
        }
        let mut ends = Vec::new();
        for (cs, _) in programs {
            ends.push(end(plc, *cs).await);
        }
        ends
    });
    played.expect("the runs end")
}

async fn end(plc: &Plc, cs: u8) -> (Execution, Option<Reason>) {
    let system = plc.coordinate_system(cs);
    loop {
        let over = |state: &plc_protocol::types::state::State| {
            let inspects = state.waiting_on.as_ref().is_some_and(|waiting| waiting.m == 80);
            inspects || matches!(state.execution, Execution::ProgramCompleted | Execution::Stopped)
        };
        let state = system.wait_for(over).await.expect("a state");
        let Some(waiting) = state.waiting_on else {
            return (state.execution, state.reason);
        };
        reset_by_hand(plc, cs, waiting.seq).await;
    }
}

async fn reset_by_hand(plc: &Plc, cs: u8, seq: u64) {
    use plc_protocol::types::output::{Reset, ResetResult};
    use plc_protocol::types::request::Request;
    let reset = Reset {
        boot_id: plc.port().boot_id(),
        seq,
        handler_id: "operator".into(),
        result: ResetResult::Ok,
        code: None,
        text: None,
        force: Some(true),
        instance: None,
    };
    plc.port()
        .request(Request::Reset(cs, None, reset))
        .await
        .expect("a reset");
    let system = plc.coordinate_system(cs);
    system
        .wait_for(|state| state.waiting_on.as_ref().is_none_or(|waiting| waiting.seq != seq))
        .await
        .expect("a state");
}

const COMPLETED: (Execution, Option<Reason>) = (Execution::ProgramCompleted, None);

#[test]
fn the_demo_sequence_program_handles_plate_holes_and_flange() {
    assert_eq!(demo(&[(1, 1)]), [COMPLETED]);
    assert_eq!(demo(&[(1, 2)]), [COMPLETED]);
    assert_eq!(demo(&[(1, 4)]), [COMPLETED]);
}

#[test]
fn the_demo_sequence_program_lets_mill_and_loader_meet() {
    assert_eq!(demo(&[(1, 3), (2, 20)]), [COMPLETED, COMPLETED]);
}
