//! G01, F, ta, td, ts (M1) and the stops of M1c.

use crate::support::formula::{Block, LATE_S, assert_samples};
use crate::support::machine::Machine;
use crate::support::simulated::{Simulated, simulate, simulate_on};

const X: usize = 0;
const Y: usize = 1;
const Z: usize = 2;

/// Checks that the cycle takes the time of the formulas, plus the tolerance of each run between two stops.
fn assert_time(simulated: &Simulated, expected_s: f64, runs: u32) {
    let cycle_s = simulated.cycle_time_s();
    assert!(
        (expected_s - 1e-9..=expected_s + LATE_S * f64::from(runs)).contains(&cycle_s),
        "{cycle_s} s, the formulas give {expected_s} s"
    );
}

#[test]
fn m1a_a_block_takes_its_length_over_f_and_half_of_each_ramp() {
    // 60 mm at 100 mm/s: 0.6 s and half of (100 + 50 + 200 + 50) ms
    let run = simulate("ta100 td200 ts50\nG01 X60 F6000\nM30\n").completed();
    let block = Block::new(60.0, 100.0, 0.1, 0.2, 0.05);
    assert!((block.end_s - 0.8).abs() < 1e-12);
    assert_time(&run, 0.8, 1);
    assert_samples(&run.samples(1, 2, X), 0.0, 1.0, block.end_s, |t| block.way(t));
}

#[test]
fn m1a_without_ts_the_speed_is_a_trapezoid() {
    let run = simulate("ta50 td50 ts0\nG01 Z-20 F6000\nM30\n").completed();
    let block = Block::new(20.0, 100.0, 0.05, 0.05, 0.0);
    assert!((block.end_s - 0.25).abs() < 1e-12);
    assert_time(&run, 0.25, 1);
    assert_samples(&run.samples(1, 2, Z), 0.0, -1.0, block.end_s, |t| block.way(t));
}

#[test]
fn m1a_ta_smaller_than_ts_counts_as_ts() {
    // ta and td become 80: half of 4 times 80 ms is 160 ms
    let run = simulate("ta20 td20 ts80\nG01 X30 F6000\nM30\n").completed();
    let block = Block::new(30.0, 100.0, 0.08, 0.08, 0.08);
    assert!((block.end_s - 0.46).abs() < 1e-12);
    assert_time(&run, 0.46, 1);
    assert_samples(&run.samples(1, 2, X), 0.0, 1.0, block.end_s, |t| block.way(t));
}

#[test]
fn m1a_ta_0_is_one_servo_period() {
    let run = simulate("ta0 td0 ts0\nG01 X10 F6000\nM30\n").completed();
    let block = Block::new(10.0, 100.0, 0.001, 0.001, 0.0);
    assert!((block.end_s - 0.101).abs() < 1e-12);
    assert_time(&run, 0.101, 1);
    assert_samples(&run.samples(1, 2, X), 0.0, 1.0, block.end_s, |t| block.way(t));
}

#[test]
fn m1a_a_single_block_too_short_for_f_keeps_its_ramps_and_lowers_its_peak() {
    // 6 mm within two ramps of 150 ms: peak 40 mm/s instead of 100
    let run = simulate("ta100 td100 ts50\nG01 X6 F6000\nM30\n").completed();
    let block = Block::new(6.0, 100.0, 0.1, 0.1, 0.05);
    assert!((block.end_s - 0.3).abs() < 1e-12);
    assert_time(&run, 0.3, 1);
    let samples = run.samples(1, 2, X);
    assert_samples(&samples, 0.0, 1.0, block.end_s, |t| block.way(t));
    let peak = samples
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .fold(0.0, f64::max)
        / 0.001;
    assert!((39.5..=40.0 + 1e-6).contains(&peak), "peak {peak} mm/s");
}

#[test]
fn m1a_f_counts_along_the_vector_of_x_y_and_z() {
    // 2, 3, 6 make 7; ten times that is 70 mm at 70 mm/s
    let run = simulate("ta100 td100 ts0\nG01 X20 Y-30 Z60 F4200\nM30\n").completed();
    let block = Block::new(70.0, 70.0, 0.1, 0.1, 0.0);
    assert_time(&run, 1.1, 1);
    for (axis, share) in [(X, 2.0 / 7.0), (Y, -3.0 / 7.0), (Z, 6.0 / 7.0)] {
        assert_samples(&run.samples(1, 2, axis), 0.0, share, block.end_s, |t| {
            block.way(t)
        });
    }
}

#[test]
fn m1a_a_motor_at_its_maximum_velocity_slows_the_whole_block() {
    // Y is limited to 50 mm/s. At 3:4 its share would be 80 of 100 mm/s, so the path runs at 62.5 mm/s.
    let run = simulate("ta100 td100 ts0\nG01 X30 Y40 F6000\nM30\n").completed();
    let block = Block::new(50.0, 62.5, 0.1, 0.1, 0.0);
    assert_time(&run, 0.9, 1);
    assert_samples(&run.samples(1, 2, X), 0.0, 0.6, block.end_s, |t| block.way(t));
    assert_samples(&run.samples(1, 2, Y), 0.0, 0.8, block.end_s, |t| block.way(t));
}

#[test]
fn d11_f_above_the_maximum_feedrate_is_clipped_with_a_warning() {
    // The maximum is 12000 mm/min: 200 mm/s
    let run = simulate("ta100 td100 ts0\nG01 X100 F60000\nM30\n").completed();
    let block = Block::new(100.0, 200.0, 0.1, 0.1, 0.0);
    assert_time(&run, 0.6, 1);
    assert_samples(&run.samples(1, 2, X), 0.0, 1.0, block.end_s, |t| block.way(t));
    let warnings = run.json["warnings"].as_array().unwrap();
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert_eq!(warnings[0]["line"], 2);
}

#[test]
fn m1a_f_and_times_stay_in_force_with_configured_defaults() {
    // Defaults of a coordinate system: ta 100, td 100, ts 50 ms
    let run = simulate("G61\nG01 X10 F6000\nX20\nts0\nX30\nM30\n").completed();
    let with_ts = Block::new(10.0, 100.0, 0.1, 0.1, 0.05);
    let without = Block::new(10.0, 100.0, 0.1, 0.1, 0.0);
    for (line, from, block) in [(2, 0.0, with_ts), (3, 10.0, with_ts), (5, 20.0, without)] {
        assert_samples(&run.samples(1, line, X), from, 1.0, block.end_s, |t| block.way(t));
    }
    assert_time(&run, 2.0 * with_ts.end_s + without.end_s, 3);
}

#[test]
fn m1c_g61_stops_in_position_at_each_block_end() {
    let run = simulate("ta50 td50 ts0\nG61\nG01 X10 F6000\nY10\nM30\n").completed();
    let (x, y) = (
        Block::new(10.0, 100.0, 0.05, 0.05, 0.0),
        Block::new(10.0, 50.0, 0.05, 0.05, 0.0),
    );
    assert_samples(&run.samples(1, 3, X), 0.0, 1.0, x.end_s, |t| x.way(t));
    assert_samples(&run.samples(1, 4, Y), 0.0, 1.0, y.end_s, |t| y.way(t));
    let corner = run
        .trace
        .iter()
        .any(|row| row.axes[X] == 10.0 && row.axes[Y] == 0.0);
    assert!(corner, "the path meets the corner");
}

#[test]
fn m1c_g09_before_and_behind_the_axis_words_comes_to_rest_at_the_corner() {
    for program in ["G01 X10 F3000\nG09 Y10\nM30\n", "G01 X10 G09 F3000\nY10\nM30\n"] {
        let run = simulate(program).completed();
        let corner = run
            .trace
            .iter()
            .any(|row| row.axes[X] == 10.0 && row.axes[Y] == 0.0);
        assert!(corner, "the path meets the corner of {program}");
    }
}

#[test]
fn m1i_the_feed_override_scales_time_along_the_same_path() {
    // At 50 percent from the start on, everything takes twice as long.
    let machine = Machine::new("");
    let run = simulate_on(
        &machine,
        "ta100 td100 ts0\nG01 X60 F6000\nM30\n",
        &["--feed-override", "50"],
    );
    let run = run.completed();
    let block = Block::new(60.0, 100.0, 0.1, 0.1, 0.0);
    assert_time(&run, 2.0 * block.end_s, 1);
    assert_samples(&run.samples(1, 2, X), 0.0, 1.0, 2.0 * block.end_s, |t| {
        block.way(t / 2.0)
    });
}

#[test]
fn m1i_dwell_does_not_scale_with_the_override() {
    let machine = Machine::new("");
    let run = simulate_on(&machine, "G04 P500\nM30\n", &["--feed-override", "50"]).completed();
    assert_time(&run, 0.5, 1);
}
