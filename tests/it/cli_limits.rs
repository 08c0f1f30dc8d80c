//! Corners that the path misses, limits that a plan exceeds, and the path tolerance, as `tandem simulate` and
//! `tandem check` report them. Expected values follow from the formulas of motion (M1a, M1b, M1d).

use std::fmt::Write as _;

use serde_json::{Value, json};

use crate::support::machine::Machine;
use crate::support::simulated::{run, simulate_on};

/// The machine of `Machine::new("")` with more keys in its first coordinate system.
fn machine(keys: &str) -> Machine {
    let machine = Machine::new("");
    let path = machine.path("tandem.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    let feedrate = "max_feedrate = 12000.0\n";
    assert!(text.contains(feedrate));
    std::fs::write(&path, text.replacen(feedrate, &format!("{feedrate}{keys}\n"), 1)).unwrap();
    machine
}

/// There and back along X, at 100 mm/s with ramps of `ta` 100 ms and `ts` 50 ms.
const REVERSAL: &str = "G91 G64 G501 ta100 td100 ts50\nG01 X50 F6000\nX-50\nM30\n";

/// Distance from the corner by M1b.3: `2 v (ta/8 + ts^2/(24 ta))`.
const REVERSAL_MM: f64 = 200.0 * (0.1 / 8.0 + 0.05 * 0.05 / (24.0 * 0.1));

#[test]
fn m1b3_simulate_reports_the_largest_distance_from_a_corner() {
    let run = simulate_on(&machine(""), REVERSAL, &["--steps", "steps.jsonl"]).completed();
    let corner = &run.json["corner"];
    assert_eq!(corner["line"], 2);
    assert!(
        (corner["distance_mm"].as_f64().unwrap() - REVERSAL_MM).abs() < 1e-6,
        "{corner}"
    );
    let stops = simulate_on(&machine(""), &REVERSAL.replace("F6000", "F6000 G09"), &[]).completed();
    assert_eq!(stops.json["corner"], Value::Null);
}

#[test]
fn steps_report_the_distance_from_the_corner_of_each_block() {
    let machine = machine("");
    simulate_on(&machine, REVERSAL, &["--steps", "steps.jsonl"]).completed();
    let steps = std::fs::read_to_string(machine.path("steps.jsonl")).unwrap();
    let corners: Vec<Value> = steps
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).unwrap()["corner_mm"].clone())
        .collect();
    assert!(
        (corners[0].as_f64().unwrap() - REVERSAL_MM).abs() < 1e-6,
        "{corners:?}"
    );
    assert_eq!(corners[1..], [Value::Null]);
}

#[test]
fn steps_report_the_own_end_of_blocks_shorter_than_a_servo_period() {
    let machine = machine("");
    let blocks = 40;
    let mut program = "G91 G64 G500 G01 F12000\n".to_owned();
    for _ in 0..blocks {
        program += "X0.02\n";
    }
    program += "M30\n";
    simulate_on(&machine, &program, &["--steps", "steps.jsonl"]).completed();
    let steps = std::fs::read_to_string(machine.path("steps.jsonl")).unwrap();
    let ends = steps
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).unwrap());
    let ends: Vec<(u64, f64)> = ends
        .map(|step| {
            (
                step["line"].as_u64().unwrap(),
                step["machine"]["X"].as_f64().unwrap(),
            )
        })
        .collect();
    assert_eq!(ends.len(), blocks);
    for (n, (line, x)) in ends.iter().enumerate() {
        assert_eq!(*line, n as u64 + 2);
        assert!(
            (x - 0.02 * (n + 1) as f64).abs() < 1e-9,
            "line {line} ends at {x}"
        );
    }
}

fn warnings(machine: &Machine, program: &str) -> Vec<String> {
    machine.write("main.nc", program);
    let ran = run(
        machine.folder(),
        &["check", "main.nc", "--config", "tandem.toml", "--format", "json"],
    );
    assert_eq!(ran.code, 0, "{}{}", ran.stdout, ran.stderr);
    let found = ran.json();
    let found = found["files"][0]["diagnostics"].as_array().unwrap();
    found
        .iter()
        .map(|found| {
            let text = |key: &str| found[key].as_str().unwrap().to_owned();
            format!("{} {}: {}", text("code"), found["line"], text("message"))
        })
        .collect()
}

#[test]
fn check_warns_of_corners_missed_by_more_than_the_setting() {
    let near = warnings(&machine("corner_warning = 3.0"), REVERSAL);
    assert_eq!(near, [""; 0]);
    let far = warnings(&machine("corner_warning = 2.0"), REVERSAL);
    assert_eq!(far, ["W0020 2: the path misses this corner by 2.7083 mm"]);
}

/// X with ramps of 5 ms at 200 mm/s: 40,000 mm/s^2, 8 times the limit of motor 1.
const STEEP: &str = "G91 G501 ta5 td5 ts0\nG01 X50 F12000\nM30\n";

#[test]
fn m1a7_check_and_simulate_warn_of_an_exceeded_acceleration() {
    let expected = "W0021 2: motor 1 (X) reaches 8.00 times its max_acceleration";
    assert_eq!(warnings(&machine(""), STEEP), [expected]);
    assert_eq!(warnings(&machine(""), &STEEP.replace("G501", "G500")), [""; 0]);
    let run = simulate_on(&machine(""), STEEP, &[]).completed();
    assert_eq!(run.ran.code, 0);
    let expected = json!([{
        "program": 1, "line": 2,
        "text": "motor 1 (X) moves at 40000.000 mm/s2, 8.00 times its max_acceleration of 5000.000",
    }]);
    assert_eq!(run.json["warnings"], expected);
    let paced = simulate_on(&machine(""), &STEEP.replace("G501", "G500"), &[]).completed();
    assert_eq!(paced.json["warnings"], json!([]));
}

#[test]
fn m1d8_the_path_tolerance_is_the_distance_from_a_corner() {
    let machine = machine("path_tolerance = 0.05");
    let program = "G91 G64 G500 G01 X50 F6000\nY50\nX10\nM30\n";
    let run = simulate_on(&machine, program, &[]).completed();
    let corner = run.json["corner"]["distance_mm"].as_f64().unwrap();
    assert!((corner - 0.05).abs() < 1e-3, "{corner}");
    assert_eq!(run.json["warnings"], json!([]));
    // No row of the trace is farther from the two lines than the tolerance.
    for row in &run.trace {
        let [x, y] = [row.axes[0], row.axes[1]];
        let off = if y < 25.0 {
            y.min((50.0 - x).abs())
        } else {
            (x - 50.0).abs().min((50.0 - y).abs())
        };
        assert!(off.abs() <= 0.05 + 1e-6, "{x} {y}");
    }
}

#[test]
fn m1d6_an_override_of_50_percent_costs_no_acceleration() {
    let mut zigzag = "G91 G64 G500 ta0 td0 ts0\nG01 F9000\n".to_owned();
    for n in 0..200 {
        let _ = writeln!(zigzag, "X0.5 Z{}", if n % 2 == 0 { 0.2 } else { -0.2 });
    }
    zigzag += "M30\n";
    let time_s = |program: &str, keys: &str, arguments: &[&str]| {
        let run = simulate_on(&machine(keys), program, arguments).completed();
        run.json["cycle_time_s"].as_f64().unwrap()
    };
    let half = ["--feed-override", "50"];
    let slow_s = time_s(&zigzag, "", &half);
    // The path of F9000 at half of its speed: F4500 has other corners, which are passed in about the same time.
    let programmed_s = time_s(&zigzag.replace("F9000", "F4500"), "", &[]);
    assert!(
        slow_s <= 1.05 * programmed_s,
        "{slow_s} s, with F/2 {programmed_s} s"
    );
    let scaled_s = time_s(&zigzag, "override = \"time_base\"", &half);
    let full_s = time_s(&zigzag, "", &[]);
    assert!(
        (scaled_s - 2.0 * full_s).abs() < 0.02 * full_s,
        "{scaled_s} s, at 100 percent {full_s} s"
    );
}
