//! `tandem check`.

use serde_json::{Value, json};

use crate::support::machine::{COORDINATE_SYSTEMS, MOTORS, Machine};
use crate::support::simulated::{Ran, run};

/// Lines 2, 3 and 5 are wrong: a code that the language does not have, an axis twice, a word without a value.
const BROKEN: &str = "G90 G54\nG05 X10\nG00 X1 X2\nG01 X5 F600\nG01 Y\nM30\n";
const CLEAN: &str = "G90 G54\nM100 VA1\nM08\nM98 P1000\nG00 X5\nM30\n";

fn check(name: &str, text: &str, arguments: &[&str]) -> Ran {
    let machine = Machine::new("");
    machine.write(name, text);
    machine.write("1000.nc", "M07\nM99\n");
    let mut all = vec!["check", name];
    all.extend(arguments);
    run(machine.folder(), &all)
}

#[test]
fn a_clean_program_is_exit_0_and_its_m_codes_and_programs_are_listed() {
    let ran = check("main.nc", CLEAN, &[]);
    assert_eq!(ran.code, 0, "{}", ran.stdout);
    for word in ["M100", "M08", "1000", "0 errors"] {
        assert!(ran.stdout.contains(word), "{word} is missing in {}", ran.stdout);
    }
}

#[test]
fn all_errors_of_a_broken_file_are_shown_at_once_and_the_exit_code_is_1() {
    let ran = check("broken.nc", BROKEN, &[]);
    assert_eq!(ran.code, 1);
    for place in ["broken.nc:2:1", "broken.nc:3:8", "broken.nc:5:5"] {
        assert!(ran.stdout.contains(place), "{place} is missing in {}", ran.stdout);
    }
    assert!(
        !ran.stdout.contains("broken.nc:4:"),
        "line 4 is right: {}",
        ran.stdout
    );
    assert!(ran.stdout.contains("3 errors"), "{}", ran.stdout);
}

#[test]
fn a_finding_has_its_code_line_column_source_line_underline_and_help() {
    let ran = check("broken.nc", "G90\nG00 X1 X22\nM30\n", &[]);
    let lines: Vec<&str> = ran.stdout.lines().collect();
    assert!(lines[0].starts_with("error[E0"), "{}", lines[0]);
    assert!(ran.stdout.contains("broken.nc:2:8"), "{}", ran.stdout);
    let source = lines
        .iter()
        .position(|line| line.ends_with("G00 X1 X22"))
        .expect("the source line");
    let underline = lines[source + 1];
    let column = |line: &str, what: &str| line[..line.find(what).unwrap()].chars().count();
    assert_eq!(
        column(underline, "^^^"),
        column(lines[source], "X22"),
        "the underline stands under the word:\n{}",
        ran.stdout
    );
    assert!(ran.stdout.contains("help: "), "{}", ran.stdout);
    assert!(
        ran.stdout.contains("broken.nc: 1 error, 0 warnings"),
        "{}",
        ran.stdout
    );
}

#[test]
fn a_file_that_cannot_be_read_is_exit_2_and_is_named() {
    let machine = Machine::new("");
    let ran = run(machine.folder(), &["check", "nothing.nc"]);
    assert_eq!(ran.code, 2);
    assert!(ran.stderr.contains("nothing.nc"), "{}", ran.stderr);
}

#[test]
fn one_unreadable_file_does_not_hide_the_findings_of_the_others() {
    let machine = Machine::new("");
    machine.write("broken.nc", BROKEN);
    let ran = run(machine.folder(), &["check", "nothing.nc", "broken.nc"]);
    assert_eq!(ran.code, 2);
    assert!(ran.stdout.contains("broken.nc:2:1"), "{}", ran.stdout);
}

#[test]
fn several_files_are_checked_in_one_call() {
    let machine = Machine::new("");
    machine.write("a.nc", CLEAN);
    machine.write("1000.nc", "M99\n");
    machine.write("b.nc", BROKEN);
    let ran = run(machine.folder(), &["check", "a.nc", "b.nc", "--format", "json"]);
    assert_eq!(ran.code, 1);
    let files = ran.json()["files"].as_array().unwrap().clone();
    let names: Vec<_> = files.iter().map(|file| file["file"].as_str().unwrap()).collect();
    assert_eq!(names, ["a.nc", "b.nc"]);
}

fn keys(value: &Value) -> Vec<&str> {
    value
        .as_object()
        .expect("an object")
        .keys()
        .map(String::as_str)
        .collect()
}

#[test]
fn json_has_exactly_the_documented_shape() {
    let ran = check("main.nc", CLEAN, &["--format", "json"]);
    assert_eq!(ran.code, 0);
    let expected = json!({"files": [{
        "file": "main.nc", "diagnostics": [], "m_codes": [8, 100], "programs": [1000],
    }]});
    let found = ran.json();
    let mut m_codes = found["files"][0]["m_codes"].as_array().unwrap().clone();
    m_codes.sort_by_key(Value::as_u64);
    let mut sorted = found.clone();
    sorted["files"][0]["m_codes"] = Value::Array(m_codes);
    assert_eq!(sorted, expected);
}

#[test]
fn json_findings_have_exactly_the_documented_fields_and_places() {
    let found = check("broken.nc", BROKEN, &["--format", "json"]).json();
    let diagnostics = found["files"][0]["diagnostics"].as_array().unwrap();
    let places: Vec<_> = diagnostics
        .iter()
        .map(|one| ["line", "column", "end_line", "end_column"].map(|key| one[key].as_u64().unwrap()))
        .collect();
    assert_eq!(places, [[2, 1, 2, 4], [3, 8, 3, 10], [5, 5, 5, 6]]);
    for one in diagnostics {
        let mut names = keys(one);
        names.sort_unstable();
        assert_eq!(
            names,
            [
                "code",
                "column",
                "end_column",
                "end_line",
                "help",
                "line",
                "message",
                "severity"
            ]
        );
        assert_eq!(one["severity"], "error");
        let code = one["code"].as_str().unwrap();
        assert!(code.len() == 5 && code.starts_with('E'), "{code}");
        assert!(one["help"].as_str().is_some_and(|help| !help.is_empty()));
    }
}

#[test]
fn columns_count_characters_not_bytes() {
    let found = check("main.nc", "/* ä€ */ G05 X1\nM30\n", &["--format", "json"]).json();
    let one = &found["files"][0]["diagnostics"][0];
    assert_eq!((&one["line"], &one["column"]), (&1.into(), &10.into()), "{one}");
}

#[test]
fn d06_a_program_without_an_end_is_an_error() {
    let ran = check("main.nc", "G00 X1\n", &[]);
    assert_eq!(ran.code, 1);
    assert!(ran.stdout.contains("E0115"), "{}", ran.stdout);
}

#[test]
fn a_dialect_that_is_not_there_is_exit_2_and_names_those_that_are() {
    let ran = check("main.nc", CLEAN, &["--dialect", "iso"]);
    assert_eq!(ran.code, 2);
    assert!(ran.stderr.contains("write nj or dgshape"), "{}", ran.stderr);
}

#[test]
fn the_dialect_of_the_command_reads_the_program() {
    let text = "%\nO0001 (plate)\nG90 G00 X10.0\nM30\n%\n";
    let ran = check("main.nc", text, &["--dialect", "dgshape"]);
    assert_eq!((ran.code, ran.stderr.as_str()), (0, ""), "{}", ran.stdout);
    assert_eq!(check("main.nc", text, &[]).code, 1, "not a program of dialect nj");
    assert_eq!(
        check("main.nc", CLEAN, &["--dialect", "dgshape"]).code,
        1,
        "nor the other way"
    );
}

#[test]
fn what_the_program_can_do_without_is_a_warning_and_exit_0() {
    let machine = Machine::new("");
    machine.write("main.nc", "/9 N10\nM98 P4000\nM77\nM30\nG00 X1\n");
    let ran = run(
        machine.folder(),
        &["check", "main.nc", "--config", "tandem.toml", "--format", "json"],
    );
    assert_eq!(ran.code, 0, "{}", ran.stdout);
    let json = ran.json();
    let found = json["files"][0]["diagnostics"].as_array().unwrap();
    let codes: Vec<_> = found
        .iter()
        .map(|one| {
            (
                one["line"].as_u64().unwrap(),
                one["code"].as_str().unwrap(),
                one["severity"].as_str().unwrap(),
            )
        })
        .collect();
    assert_eq!(
        codes,
        [
            (1, "W0006", "warning"),
            (2, "W0001", "warning"),
            (3, "W0003", "warning"),
            (5, "W0002", "warning")
        ]
    );
}

#[test]
fn config_alone_is_checked() {
    let machine = Machine::new("");
    let ran = run(machine.folder(), &["check", "--config", "tandem.toml"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    assert!(ran.stdout.contains("tandem.toml"), "{}", ran.stdout);
}

#[test]
fn config_check_notes_max_jerk_and_rapid_limits_above_the_maximum() {
    let config = format!("[machine]\nname = \"test-1\"\n{MOTORS}{COORDINATE_SYSTEMS}").replacen(
        "max_velocity = 500.0\nmax_acceleration = 5000.0\nrapid_velocity = 100.0\nrapid_acceleration = 1000.0\n",
        "max_velocity = 500.0\nmax_acceleration = 5000.0\nmax_jerk = 9000.0\nrapid_velocity = 600.0\nrapid_acceleration = 6000.0\n",
        1,
    );
    let ran = run(
        Machine::with_config(&config).folder(),
        &["check", "--config", "tandem.toml"],
    );
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let notes: Vec<&str> = ran.stdout.lines().filter(|line| line.contains("note:")).collect();
    let expected = [
        "number = 1: max_jerk = 9000 bounds G00",
        "rapid_velocity = 600 is above max_velocity = 500",
        "rapid_acceleration = 6000 is above max_acceleration = 5000",
    ];
    assert_eq!(notes.len(), expected.len(), "{notes:?}");
    for (note, words) in notes.iter().zip(expected) {
        assert!(note.contains(words), "{note}");
    }
}

#[test]
fn unknown_config_key_reported_with_line_and_nearest_known_key() {
    for (more, key, known, line) in [
        ("[m_code.5]\ntimout_ms = 5\n", "timout_ms", "timeout_ms", 2),
        ("[mqtt]\nbrocker = \"embedded\"\n", "brocker", "broker", 2),
        ("[htp]\n", "htp", "http", 1),
    ] {
        let machine = Machine::with_config("");
        machine.write("tandem.toml", more);
        let ran = run(machine.folder(), &["check", "--config", "tandem.toml"]);
        assert_ne!(ran.code, 0, "{more}");
        for word in [
            format!("`{key}`"),
            format!("`{known}`"),
            format!("line {line}"),
            "tandem.toml".into(),
        ] {
            assert!(ran.stderr.contains(&word), "{word} is missing in {}", ran.stderr);
        }
    }
}

#[test]
fn a_config_that_cannot_be_read_is_exit_2() {
    let machine = Machine::new("");
    let ran = run(machine.folder(), &["check", "--config", "nothing.toml"]);
    assert_eq!(ran.code, 2);
    assert!(ran.stderr.contains("nothing.toml"), "{}", ran.stderr);
}

#[test]
fn with_a_config_axes_that_the_machine_does_not_have_are_errors() {
    let ran = check("main.nc", "G00 A5\nM30\n", &["--config", "tandem.toml"]);
    assert_eq!(ran.code, 1, "{}", ran.stdout);
    assert!(ran.stdout.contains("main.nc:1:5"), "{}", ran.stdout);
}

#[test]
fn called_programs_checked_in_the_state_of_their_call_and_named() {
    let machine = Machine::new("");
    machine.write("1.nc", "G01 X1 F100\nQ0 = 1001\nM98 P[Q0]\nM98 P1002\nM30\n");
    machine.write("1001.nc", "X3 R5\nM99\n");
    machine.write("1002.nc", "X4\nM98 P1003\nM99\n");
    machine.write("1003.nc", "G05\nX1 X2\nM99\n");
    let ran = run(machine.folder(), &["check", "1.nc", "--format", "json"]);
    assert_eq!(ran.code, 1);
    let json: Value = serde_json::from_str(&ran.stdout).unwrap();
    let of_file = |file: &Value| {
        let found = file["diagnostics"].as_array().unwrap().iter();
        let lines: Vec<_> = found.map(|found| found["line"].as_u64().unwrap()).collect();
        (file["file"].as_str().unwrap().to_owned(), lines)
    };
    let found: Vec<_> = json["files"].as_array().unwrap().iter().map(of_file).collect();
    let expected = [("1.nc", vec![]), ("1001.nc", vec![1]), ("1003.nc", vec![1, 2])];
    assert_eq!(found, expected.map(|(file, lines)| (file.to_owned(), lines)));
    let ran = run(machine.folder(), &["check", "1.nc"]);
    for place in [
        "1.nc: 0 errors",
        "1001.nc:1:4",
        "1003.nc:1:1",
        "1003.nc: 2 errors",
    ] {
        assert!(ran.stdout.contains(place), "{place} is missing in {}", ran.stdout);
    }
}

#[test]
fn an_error_of_a_called_program_that_cannot_be_read_is_told_once() {
    let machine = Machine::new("");
    machine.write("1.nc", "M98 P1001\nM30\n");
    machine.write("1001.nc", "G01 X1 ?\nM99\n");
    let ran = run(machine.folder(), &["check", "1.nc", "--format", "json"]);
    let found = ran.json()["files"][1]["diagnostics"].as_array().unwrap().clone();
    let codes: Vec<_> = found
        .iter()
        .map(|found| found["code"].as_str().unwrap())
        .collect();
    assert_eq!(codes, ["E0003"], "{}", ran.stdout);
}

#[test]
fn m_codes_of_a_spindle_that_there_is_need_no_settings() {
    let machine = Machine::new("");
    machine.write("1.nc", "S100 M03\nM05\nM07\nM30\n");
    let text = std::fs::read_to_string(machine.config()).unwrap();
    machine.write("without.toml", &text.replace("spindle = 4\n", ""));
    let warned = |config: &str| {
        let ran = run(machine.folder(), &["check", "1.nc", "--config", config]);
        ["M03", "M05", "M07"].map(|m| ran.stdout.contains(&format!("{m} has no settings")))
    };
    assert_eq!(warned("tandem.toml"), [false, false, true]);
    assert_eq!(warned("without.toml"), [true; 3]);
}

#[test]
fn a_configuration_without_default_feedrate_makes_a_missing_f_an_error() {
    let machine = Machine::new("");
    machine.write("1.nc", "G01 X1\nM30\n");
    let config = machine.config().display().to_string();
    let ran = run(machine.folder(), &["check", "1.nc", "--config", &config]);
    assert!(ran.stdout.contains("error[E0126]"), "{}", ran.stdout);
    assert_eq!(ran.code, 1);
}
