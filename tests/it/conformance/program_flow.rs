//! Subprograms, block skip, program stops and program ends.

use crate::support::machine::Machine;
use crate::support::simulated::{Simulated, simulate, simulate_on};

const STEP: &str = "G91 G00 X1\nM99\n";

/// Simulates `main` with subprograms.
fn with_subprograms(main: &str, subprograms: &[(u16, &str)]) -> Simulated {
    let machine = Machine::new("");
    for (number, text) in subprograms {
        machine.write(&format!("{number}.nc"), text);
    }
    simulate_on(&machine, main, &[])
}

#[test]
fn m98_calls_a_subprogram_once_and_goes_on_behind_the_call() {
    let run = with_subprograms("M98 P1000\nG91 G00 Y2\nM30\n", &[(1000, STEP)]).completed();
    assert_eq!((run.machine("X"), run.machine("Y")), (1.0, 2.0));
}

#[test]
fn m98_l_calls_so_many_times() {
    let run = with_subprograms("M98 P1000 L7\nM30\n", &[(1000, STEP)]).completed();
    assert_eq!(run.machine("X"), 7.0);
}

#[test]
fn d12_m98_l0_calls_nothing() {
    let run = with_subprograms("M98 P1000 L0\nM30\n", &[(1000, STEP)]).completed();
    assert_eq!(run.machine("X"), 0.0);
    assert_eq!(run.json["warnings"].as_array().unwrap().len(), 0);
}

#[test]
fn subprograms_are_found_beside_the_file_by_number_and_by_o_and_number() {
    let machine = Machine::new("");
    machine.write("O1000.nc", STEP);
    machine.write("3000.nc", STEP);
    let run = simulate_on(&machine, "M98 P1000\nM98 P3000\nM30\n", &[]).completed();
    assert_eq!(run.machine("X"), 2.0);
}

/// Program 1001 calls 1002, and so on up to `last`, each with a step of 1 mm before its call and 100 mm after
/// it.
fn chain(last: u16) -> Vec<(u16, String)> {
    let program = |number: u16| {
        let call = if number < last {
            format!("M98 P{}\n", number + 1)
        } else {
            String::new()
        };
        (number, format!("G91 G00 X1\n{call}G91 G00 Z10\nM99\n"))
    };
    (1001..=last).map(program).collect()
}

#[test]
fn m98_nests_eight_deep() {
    let chain = chain(1008);
    let texts: Vec<_> = chain
        .iter()
        .map(|(number, text)| (*number, text.as_str()))
        .collect();
    let run = with_subprograms("M98 P1001\nM30\n", &texts).completed();
    assert_eq!((run.machine("X"), run.machine("Z")), (8.0, 80.0));
    assert_eq!(run.json["warnings"].as_array().unwrap().len(), 0);
}

#[test]
fn d12_call_deeper_than_eight_is_skipped_with_a_warning() {
    let chain = chain(1009);
    let texts: Vec<_> = chain
        .iter()
        .map(|(number, text)| (*number, text.as_str()))
        .collect();
    let run = with_subprograms("M98 P1001\nM30\n", &texts).completed();
    assert_eq!((run.machine("X"), run.machine("Z")), (8.0, 80.0));
    let warnings = run.json["warnings"].as_array().unwrap();
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert_eq!(
        (&warnings[0]["program"], &warnings[0]["line"]),
        (&1008.into(), &2.into())
    );
}

#[test]
fn d12_missing_subprogram_is_an_alarm_at_its_call_after_earlier_blocks() {
    let run = with_subprograms("G00 X5\nM98 P2999\nG00 X9\nM30\n", &[]);
    assert_eq!(run.alarm(), 20);
    assert_eq!(
        (&run.json["alarm"]["program"], &run.json["alarm"]["line"]),
        (&1.into(), &2.into())
    );
    assert_eq!(run.machine("X"), 5.0);
}

#[test]
fn d12_m99_in_a_main_program_acts_as_m30() {
    let run = simulate("G00 X5\nM99\n").completed();
    assert_eq!(run.machine("X"), 5.0);
    assert_eq!(run.story(&["end"]), ["end"]);
}

#[test]
fn m30_in_a_subprogram_ends_the_whole_run() {
    let run = with_subprograms("M98 P1000\nG00 X9\nM30\n", &[(1000, "G00 X2\nM30\n")]).completed();
    assert_eq!(run.machine("X"), 2.0);
}

#[test]
fn m02_ends_the_program_like_m30_and_nothing_behind_it_runs() {
    let run = simulate("G00 X2\nM02\nG00 X9\nM30\n").completed();
    assert_eq!(run.machine("X"), 2.0);
}

const SKIPS: &str = "G91\n/ G00 X1\n/1 G00 X2\n/3 G00 X4\n/2/3 G00 X8\nM30\n";

fn with_skips(skip: &[&str]) -> f64 {
    simulate_on(&Machine::new(""), SKIPS, skip)
        .completed()
        .machine("X")
}

#[test]
fn d13_blocks_with_a_skip_number_that_is_off_run() {
    assert_eq!(with_skips(&[]), 15.0);
    assert_eq!(with_skips(&["--skip", "9"]), 15.0);
}

#[test]
fn d13_a_bare_slash_is_skip_1() {
    assert_eq!(with_skips(&["--skip", "1"]), 12.0);
}

#[test]
fn d13_block_with_several_skip_numbers_is_skipped_when_any_is_on() {
    assert_eq!(with_skips(&["--skip", "2"]), 7.0);
    assert_eq!(with_skips(&["--skip", "3"]), 3.0);
    assert_eq!(with_skips(&["--skip", "1,3"]), 0.0);
}

#[test]
fn m00_stops_always_and_m01_only_with_the_optional_stop_on() {
    let program = "G00 X5\nM00\nG00 X7\nM01\nM30\n";
    let off = simulate(program).completed();
    let stops = |run: &Simulated| {
        let stops = run.json["stops"].as_array().unwrap().clone();
        stops
            .iter()
            .map(|stop| (stop["m"].as_u64(), stop["line"].as_u64()))
            .collect::<Vec<_>>()
    };
    assert_eq!(stops(&off), [(Some(0), Some(2))]);
    let on = simulate_on(&Machine::new(""), program, &["--optional-stop"]).completed();
    assert_eq!(stops(&on), [(Some(0), Some(2)), (Some(1), Some(4))]);
    assert_eq!(on.machine("X"), 7.0);
}

#[test]
fn d14_m00_stops_when_motion_has_come_to_it() {
    // 50 mm take 0.6 s (M1)
    let run = simulate("G00 X50\nM00\nM30\n").completed();
    let at_s = run.json["stops"][0]["at_s"].as_f64().unwrap();
    assert!((0.6..0.6052).contains(&at_s), "{at_s}");
    assert_eq!(run.story(&["stop", "resume", "end"]), ["stop", "resume", "end"]);
}

#[test]
fn d35_m00_m01_m30_m98_and_m99_are_no_auxiliary_outputs() {
    let run = with_subprograms("M98 P1000\nM00\nM01\nM30\n", &[(1000, STEP)]).completed();
    assert_eq!(run.json["m_codes"].as_array().unwrap().len(), 0);
    assert!(run.events("output").is_empty());
}
