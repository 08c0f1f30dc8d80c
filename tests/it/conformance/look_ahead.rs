//! G64 with G500 (motion rule 1d): the path of G501, slowed to the motors' maximum accelerations.

use crate::support::machine::{COORDINATE_SYSTEMS, MOTORS, Machine};
use crate::support::simulated::{Simulated, simulate, simulate_on};

const X: usize = 0;
const Y: usize = 1;

/// Maximum acceleration of X and Y on the machine of `simulate`, mm/s^2.
const ACCELERATION: f64 = 5000.0;

/// Servo period, s.
const T: f64 = 0.001;

/// Corners, a reversal, blocks of a micrometre, and words without movement, at 200 mm/s with ramps of 10 ms.
fn program(multi_block: &str) -> String {
    let tiny: Vec<String> = (1..=50)
        .map(|n| format!("X{:.3}\n", 30.0 + f64::from(n) / 1000.0))
        .collect();
    let tiny = tiny.concat();
    format!(
        "ta10 td10 ts0 {multi_block} G01 F12000\nX30\n{tiny}Y20\nF11000\nX10\nX30\nG91 X0.5 Y0.5\nX5 Y-5\nM30\n"
    )
}

/// Largest acceleration of X or Y by second differences, which are means of it.
fn acceleration(run: &Simulated) -> f64 {
    run.trace
        .windows(3)
        .flat_map(|rows| {
            [X, Y].map(|axis| {
                let at = |k: usize| rows[k].axes[axis];
                ((at(2) - 2.0 * at(1) + at(0)) / (T * T)).abs()
            })
        })
        .fold(0.0, f64::max)
}

#[test]
fn m1d_with_g500_no_motor_exceeds_its_maximum_acceleration() {
    let planned = simulate(&program("G501")).completed();
    assert!(acceleration(&planned) > 2.0 * ACCELERATION);
    let slowed = simulate(&program("G500")).completed();
    // A trace has positions to a nanometre or better.
    let found = acceleration(&slowed);
    assert!(found <= ACCELERATION * 1.001, "{found}");
    assert!(found >= ACCELERATION * 0.9, "{found}");
    assert!((slowed.machine("X") - planned.machine("X")).abs() < 1e-9);
    assert!((slowed.machine("Y") - planned.machine("Y")).abs() < 1e-9);
    assert!(slowed.cycle_time_s() > planned.cycle_time_s());
}

#[test]
fn m1d_a_program_within_the_limits_runs_as_with_g501() {
    let program =
        |multi_block: &str| format!("ta100 td100 ts50 {multi_block} G01 F3000\nX20\nY20\nX0 Y30\nM30\n");
    let planned = simulate(&program("G501")).completed();
    let same = simulate(&program("G500")).completed();
    assert_eq!(planned.trace.len(), same.trace.len());
    for (a, b) in planned.trace.iter().zip(&same.trace) {
        assert_eq!((a.time_s, a.line), (b.time_s, b.line));
        for (p, q) in a.axes.iter().zip(&b.axes) {
            assert!((p - q).abs() < 1e-9, "{a:?} {b:?}");
        }
    }
}

#[test]
fn m1d_with_few_blocks_read_ahead_the_motion_is_slower_within_the_limits_and_never_an_alarm() {
    let fine: Vec<String> = (1..=400)
        .map(|n| format!("X{:.3} Y{:.3}\n", f64::from(n) * 0.05, f64::from(n % 2) * 0.01))
        .collect();
    let fine = fine.concat();
    for multi_block in ["G500", "G501"] {
        let program = format!("ta10 td10 ts0 {multi_block} G01 F12000\n{fine}M30\n");
        let much = simulate(&program).completed();
        let config = format!("[machine]\nname = \"test-1\"\n{MOTORS}{COORDINATE_SYSTEMS}").replacen(
            "max_feedrate = 12000.0\n",
            "max_feedrate = 12000.0\npre_read_blocks = 16\n",
            1,
        );
        let little = simulate_on(&Machine::with_config(&config), &program, &[]).completed();
        assert!(little.cycle_time_s() > much.cycle_time_s(), "{multi_block}");
        assert_eq!(little.machine("X"), 20.0);
        if multi_block == "G500" {
            let found = acceleration(&little);
            assert!(found <= ACCELERATION * 1.001, "{found}");
        }
    }
}

#[test]
fn m1d_of_blocks_of_a_micrometre_at_most_128_pass_in_a_servo_period_and_no_limit_is_exceeded() {
    // 5 mm at 200 mm/s: 200 blocks a period.
    let tiny: Vec<String> = (1..=5000)
        .map(|n| format!("X{:.3}\n", f64::from(n) / 1000.0))
        .collect();
    let tiny = tiny.concat();
    let run = simulate(&format!("ta10 td10 ts0 G500 G01 F12000\n{tiny}M30\n")).completed();
    assert_eq!(run.machine("X"), 5.0);
    let steps = run.trace.windows(2).map(|rows| rows[1].axes[X] - rows[0].axes[X]);
    let fastest = steps.fold(0.0, f64::max);
    assert!(fastest <= 0.128 * (1.0 + 1e-6), "{fastest} mm in a period");
    assert!(fastest > 0.1, "{fastest} mm in a period");
    let found = acceleration(&run);
    assert!(found <= ACCELERATION * 1.001, "{found}");
}

#[test]
fn m1d_a_program_longer_than_what_is_read_ahead_is_as_fast_where_that_holds_the_way_to_rest() {
    // 12 mm in blocks of a micrometre at 25 mm/s, 25 of them in a servo period
    let fine: Vec<String> = (1..=12_000)
        .map(|n| format!("X{:.3}\n", f64::from(n) / 1000.0))
        .collect();
    let program = format!("ta0 td0 ts0 G500 G01 F1500\n{}M30\n", fine.concat());
    // v^2/(2 a): 63 and 391 blocks to rest
    for acceleration in [5000.0, 800.0] {
        let motors = MOTORS.replace(
            "max_acceleration = 5000.0",
            &format!("max_acceleration = {acceleration:?}"),
        );
        let config = format!("[machine]\nname = \"test-1\"\n{motors}{COORDINATE_SYSTEMS}").replacen(
            "max_feedrate = 12000.0\n",
            "max_feedrate = 12000.0\npre_read_blocks = 1000\n",
            1,
        );
        let run = simulate_on(&Machine::with_config(&config), &program, &[]).completed();
        let best_s = 12.0 / 25.0 + 25.0 / acceleration;
        let found_s = run.cycle_time_s();
        assert!(
            found_s <= 1.02 * best_s + 3.0 * T,
            "{acceleration} mm/s^2: {found_s} s, best {best_s} s"
        );
    }
}
