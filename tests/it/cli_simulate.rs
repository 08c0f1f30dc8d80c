//! `tandem simulate`: its outputs, flags and exit codes.

use serde_json::{Value, json};

use crate::support::machine::Machine;
use crate::support::simulated::{Simulated, run, simulate, simulate_on};

fn keys(value: &Value) -> Vec<String> {
    let mut keys: Vec<_> = value.as_object().expect("an object").keys().cloned().collect();
    keys.sort_unstable();
    keys
}

#[test]
fn json_has_exactly_the_documented_fields() {
    let machine = Machine::new("[m_code.100]\nsimulated_ms = 250\n");
    let run = simulate_on(&machine, "G00 X5\nM100 VA2\nM00\nM30\n", &[]).completed();
    assert_eq!(
        keys(&run.json),
        [
            "alarm",
            "blocks",
            "captured",
            "corner",
            "cycle_time_s",
            "lost",
            "m_codes",
            "machine",
            "motors",
            "outcome",
            "programs",
            "ranges",
            "stops",
            "tools",
            "variables",
            "warnings",
            "work"
        ]
    );
    assert_eq!(run.json["alarm"], Value::Null);
    assert_eq!(run.json["machine"], json!({"X": 5.0, "Y": 0.0, "Z": 0.0}));
    assert_eq!(run.json["work"], json!({"X": 5.0, "Y": 0.0, "Z": 0.0}));
    assert_eq!(run.json["variables"], json!({"P": {}, "Q": {}}));
    assert_eq!(run.json["warnings"], json!([]));
    let output = &run.json["m_codes"][0];
    assert_eq!(
        keys(output),
        ["line", "m", "output_s", "params", "program", "reset_s", "seq"]
    );
    let expected = json!({"m": 100, "params": {"A": 2.0}, "program": 1, "line": 2});
    for (key, value) in expected.as_object().unwrap() {
        assert_eq!(&output[key], value, "{key}");
    }
    let took_s = output["reset_s"].as_f64().unwrap() - output["output_s"].as_f64().unwrap();
    assert!((0.25 - 1e-9..0.252).contains(&took_s), "{took_s}");
    assert_eq!(keys(&run.json["stops"][0]), ["at_s", "line", "m"]);
    assert_eq!(keys(&run.json["captured"][0]), ["captured", "motor", "position"]);
}

#[test]
fn json_of_an_alarm_has_exactly_the_documented_fields_and_exit_1() {
    let run = simulate("G00 X999\nM30\n");
    run.alarm();
    assert_eq!(
        keys(&run.json["alarm"]),
        ["column", "line", "number", "program", "text"]
    );
}

#[test]
fn the_trace_has_a_row_each_period_from_0_to_the_end() {
    let machine = Machine::new("");
    let run = simulate_on(&machine, "G00 X5\nG04 P40\nG01 Y-1 F600\nM30\n", &[]).completed();
    let text = std::fs::read_to_string(machine.path("trace.csv")).unwrap();
    assert_eq!(text.lines().next(), Some("time_s,program,line,X,Y,Z"));
    for line in text.lines().skip(1) {
        for cell in line.split(',').skip(3) {
            assert_eq!(
                cell.split_once('.').expect("a decimal point").1.len(),
                9,
                "{line}"
            );
        }
    }
    for (k, row) in run.trace.iter().enumerate() {
        assert!(
            (row.time_s - k as f64 * 0.001).abs() < 1e-9,
            "row {k} is at {}",
            row.time_s
        );
    }
    let last = run.trace.last().unwrap();
    assert!(
        (last.time_s - run.cycle_time_s()).abs() < 0.0011,
        "{} {}",
        last.time_s,
        run.cycle_time_s()
    );
    assert_eq!(last.axes, [5.0, -1.0, 0.0]);
    let lines: Vec<_> = run
        .trace
        .iter()
        .map(|row| row.line)
        .filter(|line| *line > 0)
        .collect();
    assert!(
        lines.windows(2).all(|pair| pair[0] <= pair[1]),
        "lines come in program order"
    );
    assert!(lines.contains(&1) && lines.contains(&3));
}

#[test]
fn the_trace_has_every_axis_of_the_coordinate_system_and_no_other() {
    let machine = Machine::new("");
    simulate_on(&machine, "G00 X5\nM30\n", &["--cs", "2"]).completed();
    let text = std::fs::read_to_string(machine.path("trace.csv")).unwrap();
    assert_eq!(text.lines().next(), Some("time_s,program,line,X"));
}

#[test]
fn m1h_the_trace_tells_the_spindles_angle_which_is_in_phase_with_z() {
    let machine = Machine::new("");
    let program = "F100 S300\nG99 G84 Z-10 R-5\nG80\nM30\n";
    let run = simulate_on(&machine, program, &["--trace-spindle"]).completed();
    let text = std::fs::read_to_string(machine.path("trace.csv")).unwrap();
    assert_eq!(text.lines().next(), Some("time_s,program,line,X,Y,Z,spindle_deg"));
    // M19 leaves it at 0 degrees; from the R point on it makes 3 revolutions a millimetre.
    let in_thread = run.trace.iter().filter(|row| row.axes[2] < -5.0);
    let mut turned = 0;
    for row in in_thread {
        let expected = 360.0 * 3.0 * (-5.0 - row.axes[2]);
        let off = (row.axes[3] - expected + 180.0).rem_euclid(360.0) - 180.0;
        assert!(off.abs() < 2e-6, "{off} degrees off at Z{}", row.axes[2]);
        turned += 1;
    }
    assert!(
        turned > 6000,
        "5 mm at 100 mm/min, in and out, take 6 s: {turned} rows"
    );
}

#[test]
fn a_trace_of_a_spindle_that_is_not_there_is_refused() {
    let machine = Machine::new("");
    machine.write("main.nc", "M30\n");
    let arguments = [
        "simulate",
        "main.nc",
        "--cs",
        "2",
        "--trace",
        "out",
        "--trace-spindle",
    ];
    let ran = run(machine.folder(), &arguments);
    assert_eq!(ran.code, 2, "{}", ran.stdout);
    assert!(ran.stderr.contains("no spindle"), "{}", ran.stderr);
    assert!(!machine.path("out").exists());
}

#[test]
fn events_are_one_json_object_a_line_in_the_order_of_time() {
    let run = simulate("G00 X5\nM100 VA1\nM00\nM30\n").completed();
    let kinds: Vec<_> = run
        .events
        .iter()
        .map(|event| event["event"].as_str().unwrap())
        .collect();
    assert_eq!(
        kinds,
        ["start", "block", "output", "reset", "stop", "resume", "end"]
    );
    let mut last_s = 0.0;
    for event in &run.events {
        assert_eq!(event["cs"], 1);
        let t_s = event["t_s"].as_f64().expect("t_s");
        assert!(t_s >= last_s, "{event}");
        last_s = t_s;
    }
    let output = run.events("output")[0];
    for key in [
        "seq",
        "run_id",
        "m",
        "params",
        "timing",
        "program",
        "line",
        "attempt",
        "redelivered",
    ] {
        assert!(!output[key].is_null(), "{key} is missing in {output}");
    }
}

#[test]
fn an_optional_stop_is_listed_and_resumes_at_once() {
    let program = "G00 X5\nM01\nG00 X7\nM30\n";
    let run = simulate_on(&Machine::new(""), program, &["--optional-stop"]).completed();
    assert_eq!(run.json["stops"][0]["m"], 1);
    assert_eq!(run.json["stops"][0]["line"], 2);
    assert_eq!(run.machine("X"), 7.0);
    assert_eq!(simulate(program).completed().json["stops"], json!([]));
}

#[test]
fn with_runs_another_coordinate_system_at_the_same_time() {
    // 0.6 s and 0.4 s, in parallel (M1)
    let machine = Machine::new("");
    machine.write("second.nc", "G00 X30\nM30\n");
    let run = simulate_on(&machine, "G00 X50\nM30\n", &["--with", "2=second.nc"]).completed();
    assert!(
        (0.6..0.6052).contains(&run.cycle_time_s()),
        "{}",
        run.cycle_time_s()
    );
    let ends: Vec<_> = run
        .events("end")
        .iter()
        .map(|event| (event["cs"].as_u64(), event["t_s"].as_f64()))
        .collect();
    assert_eq!(ends.len(), 2, "{ends:?}");
    assert_eq!((ends[0].0, ends[1].0), (Some(2), Some(1)));
    assert!((0.4..0.4052).contains(&ends[0].1.unwrap()), "{ends:?}");
}

#[test]
fn two_runs_give_the_same_bytes() {
    let program = "G54 G00 X5\nM20\nG01 Y3 F600\nM100 VA1\nM98 P1000 L2\nM30\n";
    let bytes = || {
        let machine = Machine::new("[m_code.20]\ntiming = \"with_motion\"\nsimulated_ms = 30\n");
        machine.write("1000.nc", "G91 G00 Z1\nG90\nM99\n");
        machine.write("second.nc", "G01 X3 F999\nM100 VA2\nM30\n");
        let run = simulate_on(&machine, program, &["--with", "2=second.nc"]).completed();
        let read = |name: &str| std::fs::read(machine.path(name)).unwrap();
        (run.ran.stdout, read("trace.csv"), read("events.jsonl"))
    };
    assert!(bytes() == bytes());
}

#[test]
fn a_program_that_does_not_end_is_ended_by_max_time_s() {
    let machine = Machine::new("");
    let run = simulate_on(&machine, "G04 X100\nM30\n", &["--max-time-s", "2"]);
    assert_eq!(run.alarm(), 391);
    assert!(
        (1.99..=2.01).contains(&run.cycle_time_s()),
        "{}",
        run.cycle_time_s()
    );
}

#[test]
fn a_loop_that_moves_nothing_is_ended_by_max_time_s() {
    let machine = Machine::new("\n[m_code.50]\nunhandled = \"auto_reset\"\n");
    for block in ["G01 X0", "G00 X0", "G04 P0", "M50"] {
        let program = format!("F1000\nwhile(1==1) {{\n{block}\n}}\nM30\n");
        let run = simulate_on(&machine, &program, &["--max-time-s", "0.02"]);
        assert_eq!(run.alarm(), 391, "{block}");
        assert!(
            (0.019..=0.021).contains(&run.cycle_time_s()),
            "{block}: {} s",
            run.cycle_time_s()
        );
    }
}

#[test]
fn a_program_with_errors_runs_nothing_and_gives_its_diagnostics() {
    let machine = Machine::new("");
    let Simulated { ran, json, trace, .. } = simulate_on(&machine, "G00 X1 X2\nG05\nM30\n", &[]);
    assert_eq!(ran.code, 1);
    assert_eq!(keys(&json), ["diagnostics", "outcome"]);
    assert_eq!(json["outcome"], "errors");
    let lines: Vec<_> = json["diagnostics"]
        .as_array()
        .unwrap()
        .iter()
        .map(|one| one["line"].as_u64())
        .collect();
    assert_eq!(lines, [Some(1), Some(2)]);
    assert!(trace.is_empty());
}

#[test]
fn errors_in_a_subprogram_are_errors_too_and_name_its_file() {
    let machine = Machine::new("");
    machine.write("1000.nc", "G05\nM99\n");
    let run = simulate_on(&machine, "M98 P1000\nM30\n", &[]);
    assert_eq!(run.json["outcome"], "errors");
    let file = run.json["diagnostics"][0]["file"].as_str().unwrap();
    assert!(file.ends_with("1000.nc"), "{file}");
    assert_eq!(run.ran.code, 1);
}

#[test]
fn subprograms_of_computed_calls_are_found() {
    let machine = Machine::new("");
    machine.write("1004.nc", "G00 X7\nM99\n");
    for number in ["Q0=1000 Q1=Q0+4", "Q1=P3+1004"] {
        let run = simulate_on(&machine, &format!("{number}\nM98 P[Q1]\nM30\n"), &[]);
        assert_eq!(run.json["outcome"], "completed", "{}", run.json);
        assert_eq!(run.json["machine"]["X"], 7.0, "{}", run.json);
    }
}

#[test]
fn an_axis_that_the_machine_does_not_have_is_an_error_with_its_place() {
    let run = simulate_on(&Machine::new(""), "G00 X1\nG00 A1\nM30\n", &[]);
    assert_eq!(run.json["outcome"], "errors", "{} {}", run.json, run.ran.stderr);
    assert_eq!(run.json["diagnostics"][0]["line"], 2);
    assert_eq!(run.ran.code, 1);
}

#[test]
fn what_cannot_be_read_is_exit_2_and_is_named() {
    let machine = Machine::new("");
    machine.write("main.nc", "M30\n");
    for (arguments, named) in [
        (&["simulate", "nothing.nc"][..], "nothing.nc"),
        (
            &["simulate", "main.nc", "--config", "nothing.toml"],
            "nothing.toml",
        ),
        (&["simulate", "main.nc", "--with", "2=nothing.nc"], "nothing.nc"),
        (&["simulate", "main.nc", "--cs", "7"], "7"),
    ] {
        let ran = run(machine.folder(), arguments);
        assert_eq!(ran.code, 2, "{arguments:?}: {}", ran.stderr);
        assert!(ran.stderr.contains(named), "{}", ran.stderr);
        assert!(ran.stdout.is_empty(), "{}", ran.stdout);
    }
}

#[test]
fn without_json_the_result_is_text_for_people() {
    let machine = Machine::new("");
    machine.write("main.nc", "G00 X5\nM100 VA3\nM30\n");
    let ran = run(
        machine.folder(),
        &["simulate", "main.nc", "--config", "tandem.toml"],
    );
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    for word in ["completed", "X 5.0000", "M100", "VA3"] {
        assert!(ran.stdout.contains(word), "{word} is missing in {}", ran.stdout);
    }
}

#[test]
fn simulate_neither_reads_nor_writes_the_data_folder_and_starts_from_zero() {
    let machine = Machine::new("");
    simulate_on(&machine, "G00 X5\nM30\n", &[]).completed();
    assert!(!machine.path("tandem-data").exists());
}

#[test]
fn blocks_counts_a_fixed_cycle_once_and_each_loop_pass() {
    for (program, blocks) in [
        ("F100 S300\nG84 X5 Z-10 R-5 P200\nX10\nG80\nG00 X40\nM30\n", 3),
        ("G00 X20\nG28 X10\nG00 X5\nM30\n", 3),
        ("L1=0\nwhile(L1<3) {\nG91 G00 X1\nL1=L1+1\n}\nM30\n", 3),
    ] {
        let run = simulate(program).completed();
        assert_eq!(run.json["blocks"], blocks, "{program}");
        assert_eq!(run.events("block").len(), blocks, "{program}");
    }
}

#[test]
fn a_program_beside_takes_no_number_that_the_first_one_calls() {
    let machine = Machine::new("");
    std::fs::create_dir(machine.path("b")).unwrap();
    machine.write("1000.nc", "G91 G00 Z1\nG90\nM99\n");
    machine.write("b/1000.nc", "G00 X7\nM30\n");
    let run = simulate_on(&machine, "M98 P1000\nM30\n", &["--with", "2=b/1000.nc"]).completed();
    let started: Vec<_> = run
        .events("start")
        .iter()
        .map(|event| (event["cs"].as_u64(), event["program"].as_u64()))
        .collect();
    assert_eq!(started, [(Some(1), Some(1)), (Some(2), Some(1001))]);
    assert_eq!(run.json["machine"]["Z"], 1.0, "one call of the subprogram");
}

#[test]
fn two_subprograms_of_one_number_from_two_folders_are_refused() {
    let machine = Machine::new("");
    std::fs::create_dir(machine.path("b")).unwrap();
    machine.write("1000.nc", "M99\n");
    machine.write("b/1000.nc", "G00 X5\nM99\n");
    machine.write("main.nc", "M98 P1000\nM30\n");
    machine.write("b/second.nc", "M98 P1000\nM30\n");
    let arguments = [
        "simulate",
        "main.nc",
        "--config",
        "tandem.toml",
        "--with",
        "2=b/second.nc",
    ];
    let ran = run(machine.folder(), &arguments);
    assert_eq!(ran.code, 2, "{}", ran.stdout);
    for word in ["1000", "b/1000.nc"] {
        assert!(ran.stderr.contains(word), "{word} in {}", ran.stderr);
    }
}

#[test]
fn trace_and_events_do_not_go_into_one_file() {
    let machine = Machine::new("");
    machine.write("main.nc", "M30\n");
    let arguments = ["simulate", "main.nc", "--trace", "out", "--events", "out"];
    let ran = run(machine.folder(), &arguments);
    assert_eq!(ran.code, 2, "{}", ran.stdout);
    assert!(!machine.path("out").exists());
}
