//! G64 with G501: chains of blended blocks (M1), and what must not break or starve them.

use crate::support::formula::{Block, LATE_S, PERIOD_S, assert_samples};
use crate::support::machine::{COORDINATE_SYSTEMS, MOTORS, Machine};
use crate::support::simulated::{Simulated, simulate, simulate_on};

const X: usize = 0;

/// M20 goes along with motion and takes 500 ms.
const M_CODE: &str = "\n[m_code.20]\ntiming = \"with_motion\"\nsimulated_ms = 500\n";

/// 50 lines of 2 mm at 100 mm/s with ramps of 20 ms; `behind` follows the axis word of a line.
fn fifty_lines(behind: impl Fn(u32) -> &'static str) -> String {
    let lines: Vec<String> = (1..=50)
        .map(|line| format!("X{}{}\n", 2 * line, behind(line)))
        .collect();
    let lines = lines.concat();
    format!("ta20 td20 ts0 G01 F6000\n{lines}M30\n")
}

/// M1b: blocks of equal speed in one direction run as one block of `length` mm.
fn as_one_block(length: f64) -> Block {
    Block::new(length, 100.0, 0.02, 0.02, 0.0)
}

/// Positions of X from the first sample of line 2 until the first rest, the end point once.
fn until_rest(run: &Simulated) -> Vec<f64> {
    let first = run.trace.iter().position(|row| row.line == 2);
    let of_x: Vec<f64> = run.trace[first.unwrap()..]
        .iter()
        .map(|row| row.axes[X])
        .collect();
    let rest = (1..of_x.len()).find(|&k| of_x[k] == of_x[k - 1]);
    of_x[..rest.unwrap_or(of_x.len())].to_vec()
}

fn assert_time(run: &Simulated, expected_s: f64, runs: u32) {
    let cycle_s = run.cycle_time_s();
    assert!(
        (expected_s - 1e-9..=expected_s + LATE_S * f64::from(runs)).contains(&cycle_s),
        "{cycle_s} s, the formulas give {expected_s} s"
    );
}

#[test]
fn m1b_fifty_lines_in_one_direction_run_as_one() {
    let run = simulate(&fifty_lines(|_| "")).completed();
    // 100 mm at 100 mm/s and half of each ramp
    let one = as_one_block(100.0);
    assert!((one.end_s - 1.02).abs() < 1e-12);
    assert_time(&run, one.end_s, 1);
    assert_samples(&until_rest(&run), 0.0, 1.0, one.end_s, |t| one.way(t));
}

#[test]
fn m1b_a_corner_is_passed_without_a_stop() {
    // t_end = sum L/v + (T_0 + T_n)/2: 100 mm and 50 mm at 50 mm/s, ramps of 100 ms
    let run = simulate("ta100 td100 ts0 G01 F3000\nX100\nX100 Y50\nM30\n").completed();
    assert_time(&run, 2.0 + 1.0 + 0.1, 1);
    let corner = run
        .trace
        .iter()
        .any(|row| (row.axes[X] - 100.0).abs() < 1e-6 && row.axes[1].abs() < 1e-6);
    assert!(!corner, "the path is rounded");
}

#[test]
fn d32_a_with_motion_m_code_behind_the_axis_words_does_not_end_a_chain() {
    let machine = Machine::new(M_CODE);
    let program = fifty_lines(|line| if line == 25 { " M20" } else { "" });
    let run = simulate_on(&machine, &program, &[]).completed();
    assert_time(&run, as_one_block(100.0).end_s, 1);
}

#[test]
fn d32_a_chain_comes_to_rest_while_the_next_m_code_waits_for_room() {
    let machine = Machine::new(M_CODE);
    let program = fifty_lines(|line| if line == 10 || line == 20 { " M20" } else { "" });
    let run = simulate_on(&machine, &program, &[]).completed();
    // The pre-read makes the first M20 at once and waits 500 ms for its reset; 20 lines are done by then.
    let first = as_one_block(40.0);
    assert!(first.end_s < 0.5);
    assert_samples(&until_rest(&run), 0.0, 1.0, first.end_s, |t| first.way(t));
    assert_time(&run, 0.5 + as_one_block(60.0).end_s, 2);
    assert_eq!(run.story(&["output", "reset", "end"]).len(), 5);
}

#[test]
fn m98_in_a_chain_never_runs_out_of_blocks() {
    let machine = Machine::new("");
    machine.write("1000.nc", "G91 G01 X1\nX1\nM99\n");
    let run = simulate_on(
        &machine,
        "ta20 td20 ts0 G01 F6000\nM98 P1000 L50\nG01 X1\nM30\n",
        &[],
    )
    .completed();
    assert!((run.machine("X") - 101.0).abs() < 1e-9);
    let alarms = run.events("alarm");
    assert!(alarms.is_empty(), "{alarms:?}");
}

#[test]
fn m1c_a_block_of_m98_or_m99_ends_a_chain_and_program_codes_do_not() {
    let machine = Machine::new("");
    machine.write("1000.nc", "M99\n");
    let begin = "ta20 td20 ts0 G01 F6000\nX50\n";
    let stops = |run: &Simulated| {
        let at_corner = run
            .trace
            .iter()
            .any(|row| row.axes[X] == 50.0 && row.axes[1] == 0.0);
        assert!((run.machine("Y") - 50.0).abs() < 1e-9);
        at_corner
    };
    let called = simulate_on(&machine, &format!("{begin}M98 P1000\nY50\nM30\n"), &[]).completed();
    assert!(stops(&called), "M98 and M99 are blocks without movement");
    let calculated = simulate_on(&machine, &format!("{begin}L1=50\nY[L1]\nM30\n"), &[]).completed();
    assert!(!stops(&calculated), "an assignment is no block");
}

#[test]
fn m1c_a_chain_ends_at_rest_before_a_long_calculation() {
    // 10,000 blocks of a loop end the chain; the last line before them reaches its end, and no sample is
    // missing.
    let long = |times: u32| {
        format!("ta20 td20 ts0 G01 F6000\nX50\nL1=0\nwhile(L1<{times}) {{ L1=L1+1 }}\nY50\nM30\n")
    };
    let corner = |times| {
        let run = simulate(&long(times)).completed();
        run.trace
            .iter()
            .any(|row| row.axes[X] == 50.0 && row.axes[1] == 0.0)
    };
    assert!(!corner(1000));
    assert!(corner(6000));
}

/// A chain of equal short blocks along X at the feed override, against M1b: time, and all samples.
fn assert_short_blocks(blocks: u32, length: f64, feedrate: f64, feed_override: u32) {
    let program = format!(
        "G91 G01 F{feedrate}\n{}M30\n",
        format!("X{length}\n").repeat(blocks as usize)
    );
    let factor = f64::from(feed_override) / 100.0;
    let feed_override = feed_override.to_string();
    let arguments = ["--feed-override", &feed_override, "--max-time-s", "20"];
    let run = simulate_on(&Machine::new(""), &program, &arguments).completed();
    let one = Block::of_short_ones(blocks, length, feedrate / 60.0);
    assert_time(&run, one.end_s / factor, 1);
    let from_rest: Vec<f64> = run
        .trace
        .iter()
        .map(|row| row.axes[X])
        .skip_while(|x| *x == 0.0)
        .collect();
    let samples: Vec<f64> = std::iter::once(0.0).chain(from_rest).collect();
    assert_samples(&samples, 0.0, 1.0, one.end_s / factor, |t| one.way(t * factor));
}

#[test]
fn m1b_a_chain_of_any_number_of_short_blocks_keeps_f() {
    // 0.1 ms a block: 1025 blocks take as long as a feed hold until rest
    for blocks in [1025, 1050, 1500, 4500, 5000, 9000, 20_000] {
        assert_short_blocks(blocks, 0.01, 6000.0, 100);
    }
    assert_short_blocks(3000, 0.02, 12_000.0, 100);
}

#[test]
fn m1b_several_blocks_a_servo_period_keep_f_at_any_servo_period() {
    for period_us in [125, 1000, 10_000] {
        let machine = Machine::with_config(&format!(
            "[machine]\nname = \"test-1\"\nservo_period_us = {period_us}\n{MOTORS}{COORDINATE_SYSTEMS}"
        ));
        for (blocks, feed_override) in [(1500, 100), (1500, 200), (12_000, 100)] {
            let program = format!("G91 G01 F6000\n{}M30\n", "X.01\n".repeat(blocks as usize));
            let arguments = [
                "--feed-override",
                &feed_override.to_string(),
                "--max-time-s",
                "20",
            ];
            let run = simulate_on(&machine, &program, &arguments).completed();
            let end_s = Block::of_short_ones(blocks, 0.01, 100.0).end_s * 100.0 / f64::from(feed_override);
            let late_s = run.cycle_time_s() - end_s;
            let late_max_s = LATE_S / PERIOD_S * f64::from(period_us) * 1e-6;
            assert!(
                (-1e-9..=late_max_s).contains(&late_s),
                "{period_us} us: {late_s} s late"
            );
        }
    }
}

#[test]
fn m1i_known_path_limits_feedrate_of_blocks_too_short_to_read_ahead() {
    // Feed hold takes 200 ms until rest, with the distance of 100 ms at F, and 4 periods are added. At k
    // times F it takes k^2 100 ms + k 4 ms; 10,000 blocks of 0.01 ms are 100 ms, so k is 0.98. At least 0.9
    // of this is required
    let program = format!("G91 G01 F6000\n{}M30\n", "X.001\n".repeat(50_000));
    let run = simulate_on(&Machine::new(""), &program, &["--max-time-s", "20"]).completed();
    let fastest_s = 0.5;
    assert!(
        (fastest_s..=fastest_s / 0.98 / 0.9 + 0.1).contains(&run.cycle_time_s()),
        "{} s",
        run.cycle_time_s()
    );
}

#[test]
fn m1i_a_chain_of_short_blocks_keeps_f_at_a_feed_override_of_200_percent() {
    assert_short_blocks(1500, 0.015, 6000.0, 200);
    assert_short_blocks(3000, 0.02, 6000.0, 200);
    assert_short_blocks(12_000, 0.02, 6000.0, 200);
}
