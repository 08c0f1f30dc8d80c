//! Knowledge about a machine's M codes without its handlers: `tandem check` and `tandem explain` with a file and with
//! the configuration.

use plc_api::units::KiloNewton;
use plc_api::{Alarm, AuxOutput, MCode, SequenceProgram, Va};

use crate::support::machine::{COORDINATE_SYSTEMS, MOTORS, Machine};
use crate::support::simulated::{Ran, run};

async fn clamp(Va(_force): Va<KiloNewton<1, 20>>) -> Result<(), Alarm> {
    Ok(())
}

async fn open(_output: AuxOutput) -> Result<(), Alarm> {
    Ok(())
}

/// A machine with the file of a sequence program, and M14 of the configuration.
fn machine() -> Machine {
    let m_codes =
        "[m_code.14]\nname = \"blow\"\nparams.VA = { name = \"pressure\", unit = \"bar\", min = 0.5 }\n";
    let machine = Machine::with_config(&format!(
        "[machine]\nserved = \"served.json\"\n{MOTORS}{COORDINATE_SYSTEMS}{m_codes}"
    ));
    let program = SequenceProgram::new()
        .handler_id("cell")
        .on(MCode::new(12, "clamp"), clamp)
        .on(13..=14, open);
    machine.write("served.json", &program.served().to_string());
    machine
}

fn tandem(machine: &Machine, arguments: &[&str]) -> Ran {
    let mut all = arguments.to_vec();
    all.extend(["--config", "tandem.toml"]);
    run(machine.folder(), &all)
}

#[test]
fn wrong_parameter_is_an_error_unserved_m_code_is_a_warning() {
    let machine = machine();
    machine.write(
        "main.nc",
        "M12 VA50\nM12 VA5\nM13 VC1\nM14 VA0.1\nG01 X1 F300\nM77\nM30\n",
    );
    let ran = tandem(&machine, &["check", "main.nc"]);
    assert_eq!(ran.code, 1, "{}", ran.stdout);
    for text in [
        "main.nc:1:5",
        "M12 clamp: VA is 50 kN; write 1 to 20 kN",
        "handler cell declares M12 clamp VA (1 to 20 kN).",
        "main.nc:4:5",
        "M14 blow: VA (pressure) is 0.1 bar; write 0.5 bar or more",
        "main.nc:6:1",
        "no handler serves M77",
        "2 errors, 1 warning",
    ] {
        assert!(ran.stdout.contains(text), "{text} is missing in {}", ran.stdout);
    }
}

#[test]
fn the_birth_of_a_machine_is_such_a_file() {
    let machine = machine();
    let birth = r#"{"v":1,"machine":"mill-1","limits":{},"serves":[{"m":77,"cs":[1],"handler_id":"cell","params":{}}]}"#;
    machine.write("served.json", birth);
    machine.write("main.nc", "M77 VB1\nM30\n");
    let ran = tandem(&machine, &["check", "main.nc"]);
    assert!(
        ran.stdout.contains("M77 takes no VB; it takes no parameters"),
        "{}",
        ran.stdout
    );
}

#[test]
fn check_of_the_configuration_tells_what_the_sequence_side_serves() {
    let ran = tandem(&machine(), &["check"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    for text in [
        "M12 clamp VA (1 to 20 kN): served by handler cell",
        "M13: served by handler cell",
        "M14 blow VA (pressure, 0.5 bar or more): declared in [m_code.14]",
    ] {
        assert!(ran.stdout.contains(text), "{text} is missing in {}", ran.stdout);
    }
}

#[test]
fn explain_tells_what_an_m_code_takes_by_its_number_and_by_its_name() {
    let machine = machine();
    for name in ["M12", "m 12", "clamp"] {
        let ran = tandem(&machine, &["explain", name]);
        assert!(
            ran.stdout.starts_with("M12: clamp\n"),
            "{name}: {}{}",
            ran.stdout,
            ran.stderr
        );
        for text in [
            "Declared by handler cell.",
            "    VA  1 to 20 kN",
            "Auxiliary Function",
        ] {
            assert!(ran.stdout.contains(text), "{text} is missing in {}", ran.stdout);
        }
    }
}

#[test]
fn a_file_that_cannot_be_read_is_a_problem_of_the_configuration() {
    let machine = machine();
    for (json, why) in [
        ("{", "EOF"),
        (r#"{"serves":[{"m":192}]}"#, "M codes are 0 to 191"),
    ] {
        machine.write("served.json", json);
        let ran = tandem(&machine, &["check"]);
        assert_eq!(ran.code, 2);
        for text in [
            "line 2, column 1",
            "[machine] served",
            why,
            "SequenceProgram::served",
        ] {
            assert!(ran.stderr.contains(text), "{text} is missing in {}", ran.stderr);
        }
    }
}
