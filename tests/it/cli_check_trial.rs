//! `tandem check` runs a program without moving anything: refusals of the stages after the checker are found
//! as well.

use serde_json::Value;

use crate::support::machine::Machine;
use crate::support::simulated::run;

const M_CODES: &str = r#"
[m_code.6]
stock = "select_tool"

[m_code.8]
timing = "with_motion"

[m_code.9]

[[tool]]
id = 1
radius = 5.0
length = 80.0
"#;

/// Returns the findings of a program, each as position and code.
fn found(text: &str, with_config: bool) -> Vec<String> {
    let machine = Machine::new(M_CODES);
    machine.write("main.nc", text);
    machine.write("1000.nc", "G01 X1 Y2\nG02 X5 Y2 I2\nM99\n");
    let mut arguments = vec!["check", "main.nc", "--format", "json"];
    if with_config {
        arguments.extend(["--config", "tandem.toml"]);
    }
    let files = run(machine.folder(), &arguments).json();
    let of_file = |file: &Value| {
        let name = file["file"].as_str().unwrap().to_owned();
        let found = file["diagnostics"].as_array().unwrap().clone();
        let place = move |found: Value| {
            let code = found["code"].as_str().unwrap().to_owned();
            format!("{name}:{}:{} {code}", found["line"], found["column"])
        };
        found.into_iter().map(place)
    };
    files["files"]
        .as_array()
        .unwrap()
        .iter()
        .flat_map(of_file)
        .collect()
}

#[test]
fn a_target_beyond_a_soft_limit_is_an_error_with_the_machine_alone() {
    // G54 is at X 10, and the motor's limit is 300
    let at = |x: &str| format!("G90 G54 G00 X0\nG01 F500 X{x}\nM30\n");
    assert_eq!(found(&at("290"), true), [""; 0]);
    assert_eq!(found(&at("290.001"), true), ["main.nc:2:10 E0128"]);
    assert_eq!(found(&at("290.001"), false), [""; 0]);
}

#[test]
fn all_targets_beyond_soft_limits_are_told_at_once() {
    // G54 is at X 10 and Y 20; the limit of the X motor is 300
    let text = "G90 G54 G00 X400\nG01 F500 X500\nX0 Y0\nG02 X0 Y600 R300\nG00 X295\nM30\n";
    let beyond = [
        "main.nc:1:13 E0128",
        "main.nc:2:10 E0128",
        "main.nc:4:5 E0128",
        "main.nc:5:5 E0128",
    ];
    assert_eq!(found(text, true), beyond);
    // distances continue from there
    let by_distances = "G91 G00 X400\nX-150\nX100\nM30\n";
    assert_eq!(
        found(by_distances, true),
        ["main.nc:1:9 E0128", "main.nc:3:1 E0128"]
    );
}

#[test]
fn all_that_cutter_compensation_refuses_is_told_at_once() {
    // tool 1 has a radius of 5
    let lead = |y: u8| format!("G41 G01 X4.5 F500\nY{}\nG40 X0 Y{}\n", y + 30, y + 50);
    let short_twice = format!("G90 G54 G00 X0 Y0\nM06 VA1\n{}{}M30\n", lead(0), lead(50));
    assert_eq!(
        found(&short_twice, true),
        ["main.nc:3:1 E0128", "main.nc:6:1 E0128"]
    );
    let waits = "G90 G54 G00 X0 Y0\nM06 VA1\nG41 G01 X20 F500\nM09\nY40\nM09\nY50\nG40 G01 X0 Y60\nM30\n";
    assert_eq!(found(waits, true), ["main.nc:4:1 E0128", "main.nc:6:1 E0128"]);
}

#[test]
fn cut_before_f_is_a_warning_without_a_machine_and_an_error_with_one() {
    let cuts = "G90 G54 G00 X0\nG01 X10\nX20\nM30\n";
    assert_eq!(found(cuts, false), ["main.nc:2:1 W0018"], "once");
    assert_eq!(found(cuts, true), ["main.nc:2:1 E0126"], "default_feedrate is 0");
    assert_eq!(found("G90 G54 G00 X0\nG01 X10 F500\nM30\n", false), [""; 0]);
    // a subprogram may have that of its caller
    assert_eq!(found("G01 X10\nM99\n", false), [""; 0]);
}

#[test]
fn an_m_code_that_waits_within_cutter_compensation_is_an_error() {
    let with =
        |m: &str| format!("G90 G54 G00 X0 Y0\nM06 VA1\nG41 G01 X20 F500\n{m}\nY40\nG40 G01 X0 Y60\nM30\n");
    assert_eq!(found(&with("M08"), true), ["main.nc:4:1 W0015"], "with_motion");
    assert_eq!(found(&with("M09"), true), ["main.nc:4:1 E0128"], "after_motion");
    assert_eq!(found(&with("M09"), false), [""; 0], "the machine decides");
    assert_eq!(
        found(&with("M09 VA2"), false),
        ["main.nc:4:1 E0119"],
        "always after_motion (D30)"
    );
}

#[test]
fn an_m_code_with_motion_behind_motion_is_a_warning_at_its_first_place() {
    let with = |text: &str| found(&format!("G90 G54 G00 F500\n{text}M30\n"), true);
    assert_eq!(with("M08\nG01 X20\nM09\n"), [""; 0], "nothing moves before M08");
    assert_eq!(with("G01 X20\nM08\nG01 X30\nM08\n"), ["main.nc:3:1 W0015"]);
    assert_eq!(with("G01 X20\nM09\nM08\n"), [""; 0], "M09 waits for the motion");
    assert_eq!(with("G01 X20\nM00\nM08\n"), [""; 0], "M00 waits for the motion");
}

#[test]
fn a_tool_that_is_not_in_the_table_is_a_warning() {
    let with = |tool: u8| format!("G90 G54 G00 X0 Y0 Z0\nM06 VA{tool}\nM30\n");
    assert_eq!(found(&with(1), true), [""; 0]);
    assert_eq!(found(&with(7), true), ["main.nc:2:1 W0014"]);
    assert_eq!(found(&with(7), false), [""; 0]);
}

#[test]
fn a_lead_in_shorter_than_the_radius_of_the_selected_tool_is_an_error() {
    // tool 1 has a radius of 5
    let with = |x: &str| format!("G90 G54 G00 X0 Y0\nM06 VA1\nG41 G01 X{x} F500\nY40\nG40 X0 Y60\nM30\n");
    assert_eq!(found(&with("5.5"), true), [""; 0]);
    assert_eq!(found(&with("4.5"), true), ["main.nc:3:1 E0128"]);
    assert_eq!(found(&with("4.5"), false), [""; 0]);
}

#[test]
fn an_arc_that_transforms_distort_is_an_error_in_the_file_that_has_it() {
    let text = "G90 G54 G00 X0 Y0 Z0\nG51 X0 Y0 Z0 I2 J1 K1\nF500\nM98 P1000\nG50\nM30\n";
    assert_eq!(found(text, false), ["1000.nc:2:1 E0128"]);
}

#[test]
fn a_loop_that_neither_moves_nor_waits_nor_ends_is_an_error() {
    assert_eq!(
        found("L1=5\nwhile (L1 > 1) {\nL2=L1\n}\nM30\n", false),
        ["main.nc:4:1 E0128"]
    );
    assert_eq!(
        found("while (P1 > 1) {\nL2=P1\n}\nM30\n", false),
        [""; 0],
        "it waits for P1"
    );
}

#[test]
fn fault_that_depends_on_value_skip_or_start_is_a_warning() {
    let distorts = "G90 G54 G00 X0 Y0 Z0\nG51 X0 Y0 Z0 I2 J1 K1\n";
    let arc = "G02 X4 I2 F500\n";
    let on_value = format!("{distorts}if (P5 == 3) {{\n{arc}}}\nM30\n");
    assert_eq!(found(&on_value, false), ["main.nc:4:1 W0013"]);
    let on_skip = format!("{distorts}/1 G50\n{arc}M30\n");
    assert_eq!(found(&on_skip, false), ["main.nc:4:1 W0013"]);
    // the machine is at 0 and then reaches its limit, with and without the block
    assert_eq!(found("G91 G00 X300\n/1 G04 P10\nM30\n", true), [""; 0]);
    // G31 may end anywhere, and G91 continues from there
    let on_skip_input = "G90 G54 G00 X0\nG31 X200\nG91 G00 X100\nM30\n";
    assert_eq!(found(on_skip_input, true), ["main.nc:3:9 W0013"]);
}

#[test]
fn variable_feedrate_is_tried_in_a_program_of_straight_lines() {
    assert_eq!(found("G01 F[P0] X1\nM30\n", false), ["main.nc:1:1 W0013"]);
    assert_eq!(found("F100\nG01 X[P0]\nM30\n", false), [""; 0]);
}

/// An error that every run reaches is not reported as a warning as well.
#[test]
fn an_alarm_that_is_certain_is_one_finding() {
    let text = "F100\nQ0=0\nX5\nL1=10/Q0\nX[L1]\nM30\n";
    assert_eq!(found(text, false), ["main.nc:5:1 E0128"]);
}

#[test]
fn a_warning_tells_what_was_assumed_and_what_to_do() {
    let machine = Machine::new("");
    machine.write("main.nc", "G90 G54 G00 X0\nif (P5 == 3) {\nX[P5]\nX300\n}\nM30\n");
    let ran = run(machine.folder(), &["check", "main.nc", "--config", "tandem.toml"]);
    assert_eq!(ran.code, 0, "{}", ran.stdout);
    for part in [
        "alarm 102",
        "P and Q that the program does not write are 3",
        "Correct the position",
    ] {
        assert!(ran.stdout.contains(part), "{part} is missing in {}", ran.stdout);
    }
}

#[test]
fn a_program_is_checked_for_the_coordinate_system_that_is_named() {
    // coordinate system 2 has the axis X alone, without soft limits
    let machine = Machine::new("");
    machine.write("main.nc", "G90 G00 X400\nM30\n");
    let code = |cs: &[&str]| {
        let arguments = [&["check", "main.nc", "--config", "tandem.toml"], cs].concat();
        run(machine.folder(), &arguments).code
    };
    assert_eq!(code(&[]), 1, "the first one ends at 300");
    assert_eq!(code(&["--cs", "1"]), 1);
    assert_eq!(code(&["--cs", "2"]), 0);
    assert_eq!(code(&["--cs", "3"]), 2, "there is none");
}

#[test]
fn a_program_is_checked_for_the_system_whose_configuration_names_it() {
    // the text of the configuration ends within coordinate system 2, which has no soft limits
    let machine = Machine::new("programs = { 2 = \"main.nc\" }\n");
    machine.write("main.nc", "G90 G00 X400\nM30\n");
    machine.write("other.nc", "G90 G00 X400\nM30\n");
    let code =
        |command: &str, file: &str| run(machine.folder(), &[command, file, "--config", "tandem.toml"]).code;
    assert_eq!(code("check", "main.nc"), 0);
    assert_eq!(code("check", "other.nc"), 1, "the first one ends at 300");
    assert_eq!(code("simulate", "main.nc"), 0);
    assert_eq!(code("simulate", "other.nc"), 1);
}

#[test]
fn a_warning_of_a_block_does_not_hide_its_alarm() {
    let text = "G90 G54 F1000\nG00 X0 Y0 Z0\nG42\nG01 Y39 X[Q0]\nG02 Y6.7 J0.46 K8\nG40\nG01 X1\nM30\n";
    let codes = |text: &str| -> Vec<String> {
        let of_line = |place: &String| place.starts_with("main.nc:5:");
        let found = found(text, false).into_iter().filter(of_line);
        found
            .map(|place| place.rsplit(' ').next().unwrap().to_owned())
            .collect()
    };
    let alarms = codes(&text.replace(" K8", ""));
    assert_eq!(alarms, ["W0013"], "an alarm without the word that is not used");
    let both = codes(text);
    assert!(
        both.contains(&"W0012".to_owned()) && both.contains(&"W0013".to_owned()),
        "{both:?}"
    );
}

#[test]
fn a_subprogram_alone_has_no_error_that_depends_on_its_callers() {
    for text in [
        "G84 Z-5 R2\nG80\nM99\n",
        "G01 X5\nM99\n",
        "G02 X90 R3\nM99\n",
        "G41\nG01 X10\nX20\nM99\n",
        "/M30\nG84 Z-5 R2\nG80\nM99\n",
        "/M30\nG02 X90 R3\nM99\n",
    ] {
        let machine = Machine::new("");
        machine.write("1003.nc", text);
        let ran = run(machine.folder(), &["check", "1003.nc", "--config", "tandem.toml"]);
        assert_eq!(ran.code, 0, "{text}{}", ran.stdout);
    }
    let machine = Machine::new("");
    machine.write("1003.nc", "G77\nM99\n");
    let ran = run(machine.folder(), &["check", "1003.nc", "--config", "tandem.toml"]);
    assert_eq!(ran.code, 1, "an error of its own text stays");
}

#[test]
fn p25_check_begins_at_start_at_within_soft_limits() {
    // X is at 100 at switch-on; its upper limit is 300, and Y has none
    let machine = Machine::new(M_CODES);
    let config = std::fs::read_to_string(machine.config()).unwrap().replace(
        "soft_limits = [-100.0, 300.0]",
        "soft_limits = [90.0, 300.0]\nstart_at = 100.0",
    );
    machine.write("tandem.toml", &config);
    let check = |text: &str| {
        machine.write("main.nc", text);
        let checked = run(
            machine.folder(),
            &["check", "main.nc", "--config", "tandem.toml", "--format", "json"],
        );
        let found = checked.json()["files"][0]["diagnostics"].clone();
        let codes = found.as_array().unwrap().iter().map(|one| one["code"].clone());
        codes.collect::<Vec<_>>()
    };
    assert_eq!(check("G91 G00 X150\nM30\n"), Vec::<Value>::new());
    assert_eq!(check("G91 G00 X250\nM30\n"), ["E0128"]);
    // without a motion of X, no limit of X is exceeded
    assert_eq!(check("G91 G01 Y5 F500\nM30\n"), Vec::<Value>::new());
}
