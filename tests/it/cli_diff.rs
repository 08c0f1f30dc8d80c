//! `tandem diff`: where two programs differ, and where they do not.

use serde_json::{Value, json};

use crate::support::machine::Machine;
use crate::support::simulated::{Ran, run};

const OLD: &str = "G90 G00 X10\nG01 X50 F6000\nY40\nM100 VA5\nG01 X0\nM30\n";

fn diff(old: &str, new: &str, arguments: &[&str]) -> Ran {
    diff_on(&Machine::new(""), old, new, arguments)
}

fn diff_on(machine: &Machine, old: &str, new: &str, arguments: &[&str]) -> Ran {
    machine.write("old.nc", old);
    machine.write("new.nc", new);
    let mut all = vec!["diff", "old.nc", "new.nc", "--config", "tandem.toml"];
    all.extend(arguments);
    run(machine.folder(), &all)
}

/// Returns the differences, with the lines of both programs.
fn differences(old: &str, new: &str, arguments: &[&str]) -> Vec<Value> {
    let mut all = vec!["--json"];
    all.extend(arguments);
    let ran = diff(old, new, &all);
    let told = ran.json();
    let found = told["differences"].as_array().unwrap().clone();
    assert_eq!(told["equal"], json!(found.is_empty()), "{told}");
    assert_eq!(ran.code, i32::from(!found.is_empty()), "{told}");
    found
}

fn lines(part: &Value) -> [u64; 2] {
    ["from_line", "to_line"].map(|line| part[line].as_u64().unwrap())
}

#[test]
fn layout_comments_numbers_and_lines_in_two_parts_are_no_difference() {
    let new = "// the same\nN10 g90g0x10.\n\n/* as before */ N20 G1 X30. F6000\nN30 X50.000\nN40 Y40\nN50 M100VA5\nN60 X0\nN70 M30\n";
    assert_eq!(differences(OLD, new, &[]), Vec::<Value>::new());
    let ran = diff(OLD, new, &[]);
    assert!(
        ran.stdout
            .starts_with("no difference in path, M codes and time: old "),
        "{}",
        ran.stdout
    );
}

#[test]
fn another_way_is_told_with_the_lines_of_both() {
    let new = "G90 G00 X10\nG01 X50 F6000\n// longer\nY60\nM100 VA5\nX50 Y40\nX0\nM30\n";
    let found = differences(OLD, new, &[]);
    assert_eq!(found[0]["what"], json!(["path"]), "{found:?}");
    // the M code is equal, but is within the changed path
    let parts = (lines(&found[0]["old"]), lines(&found[0]["new"]));
    assert_eq!((found.len(), parts), (1, ([3, 4], [4, 6])), "{found:?}");
}

#[test]
fn ways_within_the_tolerance_are_the_same() {
    let new = OLD.replace("Y40", "Y40.01");
    assert!(!differences(OLD, &new, &[]).is_empty());
    assert!(differences(OLD, &new, &["--tolerance", "0.02"]).is_empty());
}

#[test]
fn a_rapid_is_not_a_line_and_an_arc_not_its_chord() {
    let found = differences(OLD, &OLD.replace("\nY40", "\nG00 Y40"), &[]);
    assert_eq!(
        (&found[0]["what"][0], lines(&found[0]["old"])),
        (&json!("path"), [3, 3])
    );
    let found = differences(OLD, &OLD.replace("\nY40", "\nG02 Y40 R20"), &[]);
    assert_eq!(
        (&found[0]["what"][0], lines(&found[0]["new"])),
        (&json!("path"), [3, 3])
    );
}

#[test]
fn another_time_on_the_same_way_is_told() {
    let found = differences(OLD, &OLD.replace("\nG01 X0\n", "\nG01 X0 F3000\n"), &[]);
    assert_eq!(found.len(), 1, "{found:?}");
    assert_eq!(
        (&found[0]["what"], lines(&found[0]["old"])),
        (&json!(["time"]), [5, 5])
    );
    // 50 mm at 100 mm/s and at 50 mm/s
    let time_s = |part: &Value| part["time_s"].as_f64().unwrap();
    let longer_s = time_s(&found[0]["new"]) - time_s(&found[0]["old"]);
    assert!((longer_s - 0.5).abs() < 1e-6, "{longer_s}");
}

#[test]
fn other_m_codes_and_parameters_are_told() {
    for (new, expected) in [
        ("M100 VA6", json!(["M100 VA6"])),
        ("M101 VA5", json!(["M101 VA5"])),
    ] {
        let found = differences(OLD, &OLD.replace("M100 VA5", new), &[]);
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!(
            (&found[0]["what"], &found[0]["old"]["m_codes"]),
            (&json!(["m_codes"]), &json!(["M100 VA5"]))
        );
        assert_eq!(
            (&found[0]["new"]["m_codes"], lines(&found[0]["new"])),
            (&expected, [4, 4])
        );
    }
    let ran = diff(OLD, &OLD.replace("M100 VA5\n", ""), &[]);
    assert_eq!(ran.code, 1);
    assert!(
        ran.stdout
            .contains("old line 4 of program 1 (0.000 s, M100 VA5), new nothing"),
        "{}",
        ran.stdout
    );
}

#[test]
fn the_picture_shows_both_ways_and_where_they_differ() {
    let machine = Machine::new("");
    let new = OLD.replace("\nY40", "\nG02 Y40 R20");
    assert_eq!(diff_on(&machine, OLD, &new, &["--svg", "out.svg"]).code, 1);
    let svg = std::fs::read_to_string(machine.path("out.svg")).unwrap();
    for class in ["both", "old", "new"] {
        assert!(
            svg.contains(&format!("<polyline class=\"{class}\"")),
            "{class}\n{svg}"
        );
    }
    // the arc is up to 20 mm away from its chord
    assert!(svg.contains("old.nc and new.nc"), "{svg}");
}

#[test]
fn what_cannot_be_read_or_has_errors_is_exit_2() {
    let machine = Machine::new("");
    machine.write("old.nc", OLD);
    assert_eq!(run(machine.folder(), &["diff", "old.nc", "nothing.nc"]).code, 2);
    assert_eq!(diff(OLD, "G01 X\n", &[]).code, 2);
    assert_eq!(diff(OLD, "G01 X\n", &["--json"]).code, 2);
}

#[test]
fn programs_of_the_other_dialect_are_compared() {
    let old = "%\nO1\nG90G00X10.\nG01X50.F600.\nM06T1\nM30\n%\n";
    let new = "%\nO1 (the same)\nN1 G90 G00 X10. (rapid)\nN2 G01 X50. F600.\nN3 M06 T1\nN4 M30\n%\n";
    let ran = diff(old, new, &["--dialect", "dgshape"]);
    assert_eq!(ran.code, 0, "{}{}", ran.stdout, ran.stderr);
    let ran = diff(old, &old.replace("T1", "T2"), &["--dialect", "dgshape"]);
    assert!(
        ran.code == 1 && ran.stdout.contains("M06 VA2"),
        "{}{}",
        ran.stdout,
        ran.stderr
    );
}

#[test]
fn a_copy_of_an_assigned_program_runs_where_the_program_does() {
    // X400 is beyond the soft limit of coordinate system 1
    let program = "G90 G00 X400\nM30\n";
    for (assigned, cs, code) in [("old.nc", None, 0), ("new.nc", None, 0), ("new.nc", Some("1"), 1)] {
        let machine = Machine::new(&format!("programs = {{ 2 = \"{assigned}\" }}\n"));
        let mut arguments = Vec::new();
        if let Some(cs) = cs {
            arguments.extend(["--cs", cs]);
        }
        let ran = diff_on(&machine, program, program, &arguments);
        let has_alarm = ran.stdout.contains("alarm") || ran.stderr.contains("limit");
        assert_eq!(has_alarm, code == 1, "{assigned}: {}{}", ran.stdout, ran.stderr);
    }
}
