//! `tandem simulate`: its tables and `--steps`. Expected values follow from the formulas of motion (M1a, M1b).

use serde_json::{Value, json};

use crate::support::machine::Machine;
use crate::support::simulated::{Simulated, run, simulate, simulate_on};

/// Servo period and the wait for motors to be in position.
const CYCLES_S: f64 = 0.004;

fn number(of: &Value) -> f64 {
    of.as_f64().unwrap_or_else(|| panic!("{of} is no number"))
}

fn close(value: &Value, expected: f64, within: f64) {
    let value = number(value);
    assert!((value - expected).abs() <= within, "{value} is not {expected}");
}

fn completed(program: &str) -> Simulated {
    simulate(program).completed()
}

#[test]
fn the_peaks_of_a_motor_are_those_of_the_ramp_with_the_line_that_has_it() {
    // F 6000 are 100 mm/s; the acceleration is v / ta, the jerk v / (ta ts)
    let run = completed("G90 G01 X10 F600 ta100 td100 ts50\nG01 X110 F6000\nM30\n");
    let motors = run.json["motors"].as_array().unwrap();
    let x = &motors[0];
    assert_eq!((&x["axis"], &x["motor"]), (&json!("X"), &json!(1)));
    for (what, value) in [("speed", 100.0), ("acceleration", 1000.0), ("jerk", 20_000.0)] {
        close(&x[what]["value"], value, value * 1e-4);
        assert_eq!(
            (&x[what]["program"], &x[what]["line"]),
            (&json!(1), &json!(2)),
            "{what}"
        );
    }
    let y = &motors[1];
    assert_eq!(number(&y["speed"]["value"]), 0.0);
}

#[test]
fn an_exact_stop_loses_half_of_both_ramps_and_the_wait_between_them() {
    let blocks = |control: &str| {
        completed(&format!(
            "{control} G90 G01 X100 F6000 ta100 td200 ts50\nX200\nM30\n"
        ))
    };
    let (stopped, blended) = (blocks("G61"), blocks("G64"));
    // a ramp takes T = ta + ts and covers v T / 2, which takes T / 2 at v
    let lost = &stopped.json["lost"]["exact_stops"];
    let halves_s = f64::midpoint(0.2 + 0.05, 0.1 + 0.05);
    let lost_s = number(&lost["lost_s"]);
    assert!((halves_s..halves_s + CYCLES_S).contains(&lost_s), "{lost_s}");
    assert_eq!(lost["places"], 1);
    assert_eq!(
        (&lost["worst"]["program"], &lost["worst"]["line"]),
        (&json!(1), &json!(1))
    );
    assert_eq!(stopped.json["lost"]["corners"]["places"], 0);
    // superposed ramps lose no time on a straight line, so the run is shorter by that time
    assert_eq!(blended.json["lost"]["exact_stops"]["places"], 0);
    assert_eq!(blended.json["lost"]["corners"]["places"], 1);
    close(&blended.json["lost"]["corners"]["lost_s"], 0.0, 1e-9);
    let shorter_s = number(&stopped.json["cycle_time_s"]) - number(&blended.json["cycle_time_s"]);
    assert!(
        (shorter_s - lost_s).abs() <= 0.0021,
        "{shorter_s} is not {lost_s}"
    );
}

#[test]
fn corners_lose_what_the_run_takes_longer_than_straight_on() {
    // v / ta is twice the maximum acceleration, which slows the corners down; straight on there is nothing to slow down
    let run = |blocks: &str| {
        let program = format!("G500 G64 G90 G01 X50 F6000 ta10 td10 ts0\n{blocks}\nM30\n");
        completed(&program).json
    };
    let (corners, straight) = (run("Z50\nX0"), run("X100\nX150"));
    assert_eq!(corners["lost"]["corners"]["places"], 2);
    assert_eq!(corners["lost"]["exact_stops"]["places"], 0);
    close(&straight["lost"]["corners"]["lost_s"], 0.0, 1e-6);
    let longer_s = number(&corners["cycle_time_s"]) - number(&straight["cycle_time_s"]);
    close(&corners["lost"]["corners"]["lost_s"], longer_s, 0.002);
    assert!(longer_s > 0.005, "{longer_s}");
}

#[test]
fn a_wait_a_rapid_and_a_dwell_are_no_exact_stops() {
    let run = completed("G90 G01 X10 F6000\nM100\nX20\nG00 X30\nG01 X40\nG04 P100\nX50\nM30\n");
    assert_eq!(
        run.json["lost"]["exact_stops"]["places"], 0,
        "{}",
        run.json["lost"]
    );
    assert_eq!(run.json["lost"]["corners"]["places"], 0);
}

#[test]
fn time_and_way_are_told_by_tool_and_by_program() {
    let machine = Machine::new("[m_code.100]\nstock = \"select_tool\"\nsimulated_ms = 500\n");
    machine.write("1000.nc", "G01 Y40 F600\nM99\n");
    let program = "G90 G00 X50\nG01 X80 F6000\nM100 VA5\nM98 P1000\nG01 X0\nG04 F2\nM30\n";
    let run = simulate_on(&machine, program, &[]).completed();
    let (tools, programs) = (&run.json["tools"], &run.json["programs"]);
    close(&tools["0"]["rapid_mm"], 50.0, 1e-9);
    close(&tools["0"]["feed_mm"], 30.0, 1e-9);
    // 50 mm at 100 mm/s with ramps of 0.1 s
    close(&tools["0"]["rapid_s"], 0.6, CYCLES_S);
    close(&tools["5"]["rapid_mm"], 0.0, 1e-9);
    // two chains of lines: superposed ramps round the corner, so the path is at most as long as the lines
    let way = number(&tools["5"]["feed_mm"]);
    assert!((90.0..=120.0 + 1e-9).contains(&way), "{way}");
    close(&tools["5"]["wait_s"], 2.0, CYCLES_S);
    let keys: Vec<&String> = programs.as_object().unwrap().keys().collect();
    assert_eq!(keys, ["1", "1000"]);
    close(&programs["1000"]["feed_s"], 4.0, 0.3);
    for table in [tools, programs] {
        let rows = table.as_object().unwrap().values();
        let all_s: f64 = rows.map(|row| number(&row["time_s"])).sum();
        close(&run.json["cycle_time_s"], all_s, 1e-9);
    }
    for row in tools.as_object().unwrap().values() {
        let parts = ["feed_s", "rapid_s", "wait_s"].map(|part| number(&row[part]));
        close(&row["time_s"], parts.iter().sum(), 1e-9);
    }
}

#[test]
fn the_range_of_an_axis_is_told_in_both_coordinates() {
    // G54 is at X 10, Y 20, Z 30
    let run = completed("G54 G90 G00 X5 Y-20 Z-30\nG02 X25 Y-20 I10 J0 F600\nM30\n");
    let of = |axis: &str, coordinates: &str| {
        let range = &run.json["ranges"][axis][coordinates];
        [number(&range["lowest"]), number(&range["highest"])]
    };
    assert_eq!(of("X", "machine"), [0.0, 35.0]);
    assert_eq!(of("X", "program"), [-10.0, 25.0]);
    // the arc reaches its radius of 10 above its centre
    let [lowest, highest] = of("Y", "machine");
    assert!(
        lowest.abs() < 1e-9 && (highest - 10.0).abs() < 1e-3,
        "{lowest} {highest}"
    );
    assert_eq!(of("Z", "machine"), [0.0, 0.0]);
}

#[test]
fn the_text_has_the_tables_behind_what_it_said_before() {
    let machine = Machine::new("");
    machine.write("main.nc", "G61 G90 G01 X100 F6000\nX200\nM30\n");
    let ran = run(
        machine.folder(),
        &["simulate", "main.nc", "--config", "tandem.toml"],
    );
    let lines: Vec<&str> = ran.stdout.lines().collect();
    assert!(lines[0].starts_with("completed after ") && lines[1].starts_with("  machine "));
    for begin in [
        "  tool ",
        "  program ",
        "  range X  machine 0.0000 to 200.0000",
        "  motor X  100.000 mm/s in line 1",
    ] {
        assert!(
            lines[3..].iter().any(|line| line.starts_with(begin)),
            "{begin}\n{}",
            ran.stdout
        );
    }
    assert!(
        ran.stdout.contains("\n  lost to exact stops: 0."),
        "{}",
        ran.stdout
    );
    assert!(
        ran.stdout.ends_with("  lost to corners: 0.000 s in 0 places\n"),
        "{}",
        ran.stdout
    );
}

fn steps(machine: &Machine, program: &str) -> Vec<Value> {
    simulate_on(machine, program, &["--steps", "steps.jsonl"]).completed();
    let text = std::fs::read_to_string(machine.path("steps.jsonl")).unwrap();
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

#[test]
fn steps_tell_block_by_block_what_is_in_force_and_where_it_ends() {
    let machine = Machine::new("[m_code.100]\nsimulated_ms = 250\n");
    let program = "G54 G90 G00 X5\nG91 G01 X10 F600 S500\nM100 VA2\nG04 P100\nM00\nM30\n";
    let steps = steps(&machine, program);
    let lines: Vec<u64> = steps.iter().map(|step| step["line"].as_u64().unwrap()).collect();
    assert_eq!(lines, [1, 2, 3, 4, 5]);
    assert_eq!(steps[0]["machine"], json!({"X": 15.0, "Y": 0.0, "Z": 0.0}));
    assert_eq!(steps[0]["programmed"], json!({"X": 5.0, "Y": -20.0, "Z": -30.0}));
    assert_eq!(
        steps[0]["offsets"]["work"],
        json!({"X": 10.0, "Y": 20.0, "Z": 30.0})
    );
    assert_eq!(steps[0]["modal"]["work_offset"], "G54");
    assert_eq!(steps[0]["modal"]["g"]["03"], "G90");
    assert_eq!(steps[1]["machine"]["X"], 25.0);
    assert_eq!(
        (&steps[1]["modal"]["g"]["01"], &steps[1]["modal"]["g"]["03"]),
        (&json!("G01"), &json!("G91"))
    );
    assert_eq!(
        (number(&steps[1]["modal"]["f"]), number(&steps[1]["modal"]["s"])),
        (600.0, 500.0)
    );
    // 10 mm at 10 mm/s
    let took_s = number(&steps[1]["end_s"]) - number(&steps[1]["start_s"]);
    assert!((1.0..1.3).contains(&took_s), "{took_s}");
    let output = &steps[2]["outputs"][0];
    assert_eq!(
        (&output["m"], &output["params"]),
        (&json!(100), &json!({"A": 2.0}))
    );
    close(
        &json!(number(&output["reset_s"]) - number(&output["output_s"])),
        0.25,
        0.002,
    );
    close(
        &json!(number(&steps[3]["end_s"]) - number(&steps[3]["start_s"])),
        0.1,
        CYCLES_S,
    );
    assert_eq!(steps[4]["stop"]["m"], 0);
    for pair in steps.windows(2) {
        assert_eq!(pair[0]["end_s"], pair[1]["start_s"]);
    }
}

#[test]
fn an_output_beside_the_motion_has_a_line_of_its_own() {
    let machine = Machine::new("[m_code.8]\ntiming = \"with_motion\"\n");
    let steps = steps(&machine, "G90 G01 X10 F600 M08\nX20\nM30\n");
    let of_m: Vec<&Value> = steps.iter().filter(|step| step["outputs"] != json!([])).collect();
    assert_eq!(of_m.len(), 1, "{steps:?}");
    assert_eq!(
        (&of_m[0]["line"], &of_m[0]["outputs"][0]["m"]),
        (&json!(1), &json!(8))
    );
    let moves: Vec<u64> = (steps.iter().filter(|step| step["outputs"] == json!([])))
        .map(|step| step["line"].as_u64().unwrap())
        .collect();
    assert_eq!(moves, [1, 2]);
}

#[test]
fn steps_of_a_long_program_are_one_line_a_block() {
    let mut program = String::from("G91 G01 F6000\n");
    for _ in 0..5_000 {
        program.push_str("X0.1\nX-0.1\n");
    }
    program.push_str("M30\n");
    let steps = steps(&Machine::new(""), &program);
    assert_eq!(steps.len(), 10_000);
    assert_eq!(
        (&steps[9_999]["line"], &steps[9_999]["machine"]["X"]),
        (&json!(10_001), &json!(0.0))
    );
}

/// All numbers in a value, in order.
fn numbers(value: &Value, into: &mut Vec<f64>) {
    match value {
        Value::Number(_) => into.push(number(value)),
        Value::Array(list) => list.iter().for_each(|value| numbers(value, into)),
        Value::Object(fields) => fields.values().for_each(|value| numbers(value, into)),
        _ => {}
    }
}

#[test]
fn what_is_measured_is_the_same_where_even_motion_is_left_out() {
    let machine = Machine::new("[m_code.100]\nsimulated_ms = 5000\n");
    let program =
        "G61 G90 G00 X50\nG01 X0 F600 ta100 td200 ts50\nX20 Z10\nM100\nG04 F3\nG02 X40 I10 F3000\nM30\n";
    let counted = simulate_on(&machine, program, &[]).completed().json;
    let arguments = ["simulate", "main.nc", "--config", "tandem.toml", "--json"];
    let passed = run(machine.folder(), &arguments).json();
    for table in ["tools", "programs", "ranges", "motors", "lost"] {
        let (mut expected, mut found) = (Vec::new(), Vec::new());
        numbers(&counted[table], &mut expected);
        numbers(&passed[table], &mut found);
        assert_eq!(expected.len(), found.len());
        for (expected, found) in expected.iter().zip(&found) {
            let within = 1e-6 * expected.abs().max(1.0);
            assert!(
                (expected - found).abs() <= within,
                "{table}: {found} is not {expected}"
            );
        }
    }
}
