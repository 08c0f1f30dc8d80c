//! Findings for other tools: as SARIF, and of a program that comes from standard input.

use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::{Value, json};

use crate::support::binary::tandem;
use crate::support::machine::Machine;
use crate::support::simulated::{Ran, run};

const BROKEN: &str = "G90 G54\n/* ä */ G05 X10\nM30\n";

/// Runs `tandem` in a folder and gives it a text.
pub(crate) fn run_with(folder: &Path, arguments: &[&str], text: &str) -> Ran {
    let mut child = Command::new(tandem())
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("tandem starts");
    // a command that does not read it may have ended
    let _ = child.stdin.take().expect("piped").write_all(text.as_bytes());
    Ran::new(child.wait_with_output().expect("tandem ends"))
}

/// Requirements of SARIF 2.1.0 on the written objects, as in its schema: only members of the schema, and all required
/// ones.
fn sarif_schema() -> Value {
    let text = json!({
        "type": "object", "additionalProperties": false, "required": ["text"],
        "properties": {"text": {"type": "string"}, "markdown": {"type": "string"}},
    });
    let from_one = json!({"type": "integer", "minimum": 1});
    let region = json!({
        "type": "object", "additionalProperties": false, "required": ["startLine"],
        "properties": {"startLine": from_one, "startColumn": from_one, "endLine": from_one, "endColumn": from_one},
    });
    let artifact = json!({
        "type": "object", "additionalProperties": false,
        "properties": {"uri": {"type": "string", "format": "uri-reference"}},
    });
    let place = json!({
        "type": "object", "additionalProperties": false, "required": ["artifactLocation"],
        "properties": {"artifactLocation": artifact, "region": region},
    });
    let result = json!({
        "type": "object", "additionalProperties": false, "required": ["message"],
        "properties": {
            "ruleId": {"type": "string"},
            "level": {"enum": ["none", "note", "warning", "error"]},
            "message": text,
            "locations": {"type": "array", "items": {
                "type": "object", "additionalProperties": false, "properties": {"physicalLocation": place},
            }},
        },
    });
    let rule = json!({
        "type": "object", "additionalProperties": false, "required": ["id"],
        "properties": {"id": {"type": "string"}, "shortDescription": text, "fullDescription": text, "help": text},
    });
    let driver = json!({
        "type": "object", "additionalProperties": false, "required": ["name"],
        "properties": {
            "name": {"type": "string"}, "version": {"type": "string"},
            "informationUri": {"type": "string", "format": "uri"},
            "rules": {"type": "array", "uniqueItems": true, "items": rule},
        },
    });
    let run = json!({
        "type": "object", "additionalProperties": false, "required": ["tool"],
        "properties": {
            "tool": {"type": "object", "additionalProperties": false, "required": ["driver"], "properties": {"driver": driver}},
            "columnKind": {"enum": ["utf16CodeUnits", "unicodeCodePoints"]},
            "invocations": {"type": "array", "items": {
                "type": "object", "additionalProperties": false, "required": ["executionSuccessful"],
                "properties": {"executionSuccessful": {"type": "boolean"}},
            }},
            "results": {"type": "array", "items": result},
        },
    });
    json!({
        "type": "object", "additionalProperties": false, "required": ["version", "runs"],
        "properties": {
            "$schema": {"type": "string", "format": "uri"},
            "version": {"enum": ["2.1.0"]},
            "runs": {"type": "array", "items": run},
        },
    })
}

fn sarif(ran: &Ran) -> Value {
    let log = ran.json();
    let options = jsonschema::options().should_validate_formats(true);
    let validator = options.build(&sarif_schema()).expect("a schema");
    let wrong: Vec<String> = validator
        .iter_errors(&log)
        .map(|error| format!("{}: {error}", error.instance_path))
        .collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
    log
}

#[test]
fn sarif_matches_its_schema_with_rule_level_and_location() {
    let machine = Machine::new("");
    machine.write("a part.nc", BROKEN);
    machine.write("warned.nc", "M98 P4000\nM30\n");
    let ran = run(
        machine.folder(),
        &["check", "a part.nc", "warned.nc", "--format", "sarif"],
    );
    assert_eq!(ran.code, 1, "{}", ran.stderr);
    let log = sarif(&ran);
    let run = &log["runs"][0];
    let results = run["results"].as_array().unwrap();
    let of = |result: &Value| {
        let place = &result["locations"][0]["physicalLocation"];
        let level = result["level"].as_str().unwrap().to_owned();
        (
            level,
            place["artifactLocation"]["uri"].clone(),
            place["region"].clone(),
        )
    };
    let region =
        |line, from, to| json!({"startLine": line, "startColumn": from, "endLine": line, "endColumn": to});
    let expected = [
        ("error".to_owned(), json!("a%20part.nc"), region(2, 9, 12)),
        ("warning".to_owned(), json!("warned.nc"), region(1, 5, 10)),
    ];
    assert_eq!(results.iter().map(of).collect::<Vec<_>>(), expected);
    let rules = run["tool"]["driver"]["rules"].as_array().unwrap();
    for result in results {
        assert!(
            rules.iter().any(|rule| rule["id"] == result["ruleId"]),
            "{result}"
        );
    }
    assert_eq!(run["invocations"][0]["executionSuccessful"], true);
}

#[test]
fn sarif_encodes_file_uris_and_reports_an_unreadable_file() {
    let machine = Machine::new("");
    for name in ["1:2.nc", "ä#%.nc"] {
        machine.write(name, "G05\nM30\n");
    }
    let whole = machine.path("1:2.nc");
    let ran = run(
        machine.folder(),
        &[
            "check",
            "1:2.nc",
            "ä#%.nc",
            whole.to_str().unwrap(),
            "nothing.nc",
            "--format",
            "sarif",
        ],
    );
    assert_eq!(ran.code, 2);
    let log = sarif(&ran);
    let results = log["runs"][0]["results"].as_array().unwrap();
    let uri = |result: &Value| result["locations"][0]["physicalLocation"]["artifactLocation"]["uri"].clone();
    let expected = [
        json!("1%3A2.nc"),
        json!("%C3%A4%23%25.nc"),
        json!(format!("file://{}", whole.display())),
    ];
    assert_eq!(results.iter().map(uri).collect::<Vec<_>>(), expected);
    assert_eq!(log["runs"][0]["invocations"][0]["executionSuccessful"], false);
}

#[test]
fn sarif_of_nothing_wrong_is_a_run_without_results() {
    let machine = Machine::new("");
    machine.write("main.nc", "G90\nM30\n");
    for arguments in [
        vec!["check", "main.nc", "--format", "sarif"],
        vec!["check", "--config", "tandem.toml", "--format", "sarif"],
    ] {
        let ran = run(machine.folder(), &arguments);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        assert_eq!(sarif(&ran)["runs"][0]["results"], json!([]));
    }
}

#[test]
fn check_reads_stdin_and_finds_subprograms_in_the_current_folder() {
    let machine = Machine::new("");
    machine.write("1000.nc", "M07\nM99\n");
    let ran = run_with(machine.folder(), &["check", "-"], BROKEN);
    assert_eq!(ran.code, 1, "{}", ran.stderr);
    assert!(ran.stdout.contains("<stdin>:2:9"), "{}", ran.stdout);
    let text = "M98 P1000\nM98 P1001\nM30\n";
    let ran = run_with(machine.folder(), &["check", "-", "--format", "json"], text);
    assert_eq!(ran.code, 0, "{}", ran.stdout);
    let json = ran.json();
    assert_eq!(json["files"][0]["file"], "<stdin>");
    let found = json["files"][0]["diagnostics"].as_array().unwrap();
    let lines: Vec<_> = found.iter().map(|one| one["line"].clone()).collect();
    assert_eq!(lines, [2], "only 1001 is not there: {found:?}");
}

#[test]
fn simulate_plot_and_compile_read_standard_input_too() {
    let machine = Machine::new("");
    machine.write("1000.nc", "G01 X5 F600\nM99\n");
    let text = "G90 G54\nM98 P1000\nM30\n";
    let ran = run_with(machine.folder(), &["simulate", "-", "--json"], text);
    assert_eq!(
        (ran.code, &ran.json()["outcome"]),
        (0, &json!("completed")),
        "{}",
        ran.stderr
    );
    let ran = run_with(machine.folder(), &["plot", "-", "-o", "plot.svg"], text);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    assert!(machine.path("plot.svg").exists());
    let ran = run_with(machine.folder(), &["compile", "-"], "G90\nM30\n");
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let ran = run_with(machine.folder(), &["compile", "-"], BROKEN);
    assert_eq!(ran.code, 1);
    assert!(ran.stderr.contains("<stdin>: not compiled"), "{}", ran.stderr);
}

#[test]
fn standard_input_is_one_program() {
    let machine = Machine::new("");
    let ran = run_with(machine.folder(), &["check", "-", "-"], BROKEN);
    assert_eq!(ran.code, 2);
    assert!(ran.stdout.contains("<stdin>:2:9"), "{}", ran.stdout);
    assert!(ran.stderr.contains("write - once"), "{}", ran.stderr);
}

#[test]
fn a_program_in_utf_16_is_one_finding_of_each_command() {
    let machine = Machine::new("");
    let wide = |mark: bool| -> Vec<u8> {
        let text = "%\nG90 G01 X10 F100 // gr\u{f6}\u{df}er\nG02 X20 R5\nM30\n";
        let mark = mark.then_some(0xFEFF).into_iter();
        mark.chain(text.encode_utf16())
            .flat_map(u16::to_le_bytes)
            .collect()
    };
    for mark in [true, false] {
        std::fs::write(machine.path("wide.nc"), wide(mark)).unwrap();
        for dialect in ["nj", "dgshape"] {
            let json = run(
                machine.folder(),
                &["check", "wide.nc", "--format", "json", "--dialect", dialect],
            );
            let found = json.json()["files"][0]["diagnostics"].clone();
            assert_eq!(found.as_array().unwrap().len(), 1, "{found}");
            assert_eq!(
                (&found[0]["code"], &found[0]["line"]),
                (&json!("E0003"), &json!(1))
            );
            let message = found[0]["message"].as_str().unwrap();
            assert!(
                message.contains("UTF-16") && message.contains("UTF-8"),
                "{message}"
            );
        }
        for command in [
            &["simulate", "wide.nc"][..],
            &["compile", "wide.nc"],
            &["fmt", "wide.nc"],
            &["convert", "wide.nc", "--from", "fanuc"],
        ] {
            let ran = run(machine.folder(), command);
            assert_ne!(ran.code, 0, "{command:?}");
            let told = format!("{}{}", ran.stdout, ran.stderr);
            assert!(told.contains("UTF-8"), "{command:?}: {told}");
            assert!(told.matches("error[").count() <= 1, "{command:?}: {told}");
        }
    }
}
