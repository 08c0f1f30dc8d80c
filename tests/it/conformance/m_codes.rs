//! M codes: when they are issued, in which order, and which blocks wait for their resets (D30 to D36).

use crate::support::formula::LATE_S;
use crate::support::machine::Machine;
use crate::support::simulated::{Simulated, simulate, simulate_on};

/// M20 and M21 are issued with the motion and take 500 ms; M100 waits and takes 300 ms.
const M_CODES: &str = r#"
[m_code.20]
timing = "with_motion"
simulated_ms = 500

[m_code.21]
timing = "with_motion"
simulated_ms = 500

[m_code.100]
simulated_ms = 300
"#;

fn run(program: &str) -> Simulated {
    simulate_on(&Machine::new(M_CODES), program, &[]).completed()
}

/// 50 mm in rapid motion (M1).
const RAPID_S: f64 = 0.6;

#[test]
fn d31_after_motion_output_is_issued_when_the_motion_is_at_rest() {
    let run = run("G00 X50\nM100\nG00 X0\nM30\n");
    let output_s = run.at_s("output", "m", 100);
    assert!((RAPID_S..RAPID_S + LATE_S).contains(&output_s), "{output_s}");
}

#[test]
fn d31_an_m_code_in_a_block_of_motion_is_put_out_behind_that_motion() {
    let run = run("G00 X50 M100\nM30\n");
    let output_s = run.at_s("output", "m", 100);
    assert!((RAPID_S..RAPID_S + LATE_S).contains(&output_s), "{output_s}");
    assert_eq!(run.machine("X"), 50.0);
}

#[test]
fn d31_the_next_block_waits_for_the_reset() {
    let run = run("M100\nG00 X50\nM30\n");
    let (output_s, reset_s) = (run.at_s("output", "m", 100), run.at_s("reset", "m", 100));
    assert!(
        (0.3 - 1e-9..0.302).contains(&(reset_s - output_s)),
        "300 ms, not {}",
        reset_s - output_s
    );
    let moved = run.trace.iter().find(|row| row.axes[0] != 0.0).unwrap();
    assert!(
        moved.time_s > reset_s,
        "moves at {} s, reset at {reset_s} s",
        moved.time_s
    );
    assert_eq!(
        run.story(&["output", "reset", "block", "end"]),
        ["output 100", "reset 100", "block 2", "end"]
    );
}

#[test]
fn d32_with_motion_output_is_issued_at_interpretation_without_waiting() {
    let run = run("G00 X50\nM20\nG00 X0\nM30\n");
    // The pre-read reaches M20 long before the first motion has ended.
    let output_s = run.at_s("output", "m", 20);
    assert!(output_s < 0.01, "{output_s}");
    // Both motions together take twice 0.6 s; nothing waits 500 ms for M20.
    let cycle_s = run.cycle_time_s();
    assert!((1.2..1.2 + 2.0 * LATE_S).contains(&cycle_s), "{cycle_s}");
}

#[test]
fn d15_nothing_but_what_the_rule_names_ends_the_pre_read() {
    let machine = Machine::new(M_CODES);
    machine.write("1000.nc", "G00 X40\nM99\n");
    for between in [
        "G04 X5",
        "G09 G01 X1 F600",
        "G61 G01 X1 F600",
        "G64 G01 X1 F600\nG01 Y1",
        "G500 G01 X1 F600",
        "G28 X60",
        "G30 P3 X60",
        "G53 G00 X1",
        "G55 G00 X1",
        "G52 X1",
        "G68 R90\nG01 X1 F600",
        "G51 P2\nG01 X1 F600",
        "G20 G01 X1 F10",
        "G02 X10 Y0 I-20 J0 F600",
        "G31 X60",
        "M98 P1000",
        "Q1=Q2+1\nif (Q1 > 0) {\nG00 X1\n}",
        "M21",
    ] {
        let run = simulate_on(&machine, &format!("G00 X50\n{between}\nM20\nM30\n"), &[]).completed();
        let output_s = run.at_s("output", "m", 20);
        assert!(output_s < 0.01, "{between}: {output_s} s");
    }
}

#[test]
fn d30_an_m_code_with_parameters_is_always_after_motion() {
    let run = run("G00 X50\nM20 VA1\nM30\n");
    let output_s = run.at_s("output", "m", 20);
    assert!((RAPID_S..RAPID_S + LATE_S).contains(&output_s), "{output_s}");
    assert_eq!(run.events("output")[0]["timing"], "after_motion");
}

#[test]
fn d32_the_same_m_number_again_waits_for_the_reset_of_the_first() {
    let run = run("M20\nM20\nM30\n");
    assert_eq!(
        run.story(&["output", "reset", "end"]),
        ["output 20", "reset 20", "output 20", "reset 20", "end"]
    );
    let cycle_s = run.cycle_time_s();
    assert!(
        (1.0 - 1e-9..1.005).contains(&cycle_s),
        "twice 500 ms, not {cycle_s}"
    );
}

#[test]
fn d32_repeated_m_number_waits_even_when_parameters_change_its_timing() {
    let run = run("M20\nM20 VA1\nM20\nM30\n");
    let each = ["output 20", "reset 20"];
    assert_eq!(
        run.story(&["output", "reset", "end"]),
        [&each.repeat(3)[..], &["end"]].concat()
    );
    let cycle_s = run.cycle_time_s();
    assert!(
        (1.5 - 1e-9..1.507).contains(&cycle_s),
        "three times 500 ms, not {cycle_s}"
    );
}

#[test]
fn after_motion_output_waits_while_the_maximum_of_outputs_is_pending() {
    let machine = Machine::new(M_CODES);
    let config = std::fs::read_to_string(machine.config()).unwrap();
    let system = "[[coordinate_system]]\nnumber = 1\n";
    assert!(config.contains(system), "{config}");
    let narrow = config.replacen(system, &format!("{system}open_outputs_max = 2\n"), 1);
    machine.write("tandem.toml", &narrow);
    let run = simulate_on(&machine, "M20\nM21\nM100\nM30\n", &[]).completed();
    let waited_s = run.at_s("output", "m", 100);
    assert!((0.5 - 1e-9..0.502).contains(&waited_s), "{waited_s}");
}

#[test]
fn d32_different_with_motion_codes_are_open_at_the_same_time() {
    let run = run("M20\nM21\nM30\n");
    assert_eq!(
        run.story(&["output", "reset", "end"]),
        ["output 20", "output 21", "reset 20", "reset 21", "end"]
    );
    let cycle_s = run.cycle_time_s();
    assert!((0.5 - 1e-9..0.505).contains(&cycle_s), "{cycle_s}");
}

#[test]
fn d32_m30_waits_for_the_reset_of_every_open_output() {
    let run = run("M20\nM30\n");
    assert_eq!(
        run.story(&["output", "reset", "end"]),
        ["output 20", "reset 20", "end"]
    );
    assert!(run.at_s("reset", "m", 20) >= 0.5 - 1e-9);
}

#[test]
fn d33_outputs_come_in_program_order_each_once_with_a_number_that_grows() {
    let run = run("M20\nM100\nM21\nM100 VA1\nM30\n");
    let outputs = run.events("output");
    let field = |name: &str| {
        outputs
            .iter()
            .map(|event| event[name].as_u64().unwrap())
            .collect::<Vec<_>>()
    };
    assert_eq!(field("m"), [20, 100, 21, 100]);
    assert_eq!(field("line"), [1, 2, 3, 4]);
    assert_eq!(field("program"), [1, 1, 1, 1]);
    let seq = field("seq");
    assert!(seq.windows(2).all(|pair| pair[0] < pair[1]), "{seq:?}");
    let resets = run.events("reset");
    let mut reset: Vec<_> = resets
        .iter()
        .map(|event| event["seq"].as_u64().unwrap())
        .collect();
    reset.sort_unstable();
    assert_eq!(reset, seq, "each output is reset once");
}

#[test]
fn d33_an_output_carries_va_to_vh_and_only_those_that_are_written() {
    let run = run("M100 VA1 VB-2.5 VC3 VD4 VE5 VF6 VG7 VH0.125\nM100 VC0\nM100\nM30\n");
    let params: Vec<_> = run
        .events("output")
        .iter()
        .map(|event| event["params"].clone())
        .collect();
    let all = serde_json::json!({
        "A": 1.0, "B": -2.5, "C": 3.0, "D": 4.0, "E": 5.0, "F": 6.0, "G": 7.0, "H": 0.125,
    });
    assert_eq!(
        params,
        [all, serde_json::json!({"C": 0.0}), serde_json::json!({})]
    );
}

#[test]
fn d33_an_output_of_a_subprogram_names_that_program_and_its_line() {
    let machine = Machine::new(M_CODES);
    machine.write("1000.nc", "\nM100\nM99\n");
    let run = simulate_on(&machine, "M98 P1000\nM30\n", &[]).completed();
    let output = run.events("output")[0];
    assert_eq!((&output["program"], &output["line"]), (&1000.into(), &2.into()));
}

#[test]
fn d35_m03_is_an_output_that_the_stock_sequence_program_resets() {
    let run = simulate("S1000 M03\nM05\nM30\n").completed();
    assert_eq!(
        run.story(&["output", "reset"]),
        ["output 3", "reset 3", "output 5", "reset 5"]
    );
}

#[test]
fn d36_a_reset_that_does_not_come_within_timeout_ms_is_an_alarm() {
    let machine = Machine::new("[m_code.100]\nunhandled = \"wait\"\ntimeout_ms = 250\n");
    let run = simulate_on(&machine, "G00 X5\nM100\nG00 X9\nM30\n", &[]);
    assert_eq!(run.alarm(), 301);
    assert_eq!(run.json["alarm"]["line"], 2);
    let waited_s = run.at_s("alarm", "number", 301) - run.at_s("output", "m", 100);
    assert!((0.25 - 1e-9..0.252).contains(&waited_s), "{waited_s}");
    assert_eq!(run.machine("X"), 5.0, "nothing moves behind the alarm");
}

#[test]
fn unhandled_alarm_stops_the_program_at_the_m_code() {
    let machine = Machine::new("[m_code.100]\nunhandled = \"alarm\"\n");
    let run = simulate_on(&machine, "G00 X5\nM100\nG00 X9\nM30\n", &[]);
    assert_eq!(run.alarm(), 300);
    assert_eq!(run.machine("X"), 5.0);
}

#[test]
fn unhandled_auto_reset_is_what_simulate_does_by_default() {
    let run = simulate("M100 VA7\nG00 X9\nM30\n").completed();
    assert_eq!(run.story(&["output", "reset"]), ["output 100", "reset 100"]);
    assert_eq!(run.machine("X"), 9.0);
}

#[test]
fn unhandled_wait_is_told_when_nothing_can_reset_it() {
    let machine = Machine::new("[m_code.100]\nunhandled = \"wait\"\n");
    let run = simulate_on(&machine, "M100\nM30\n", &[]);
    assert_eq!(run.alarm(), 390);
}
