//! G64 with G500 (motion rule 1d): the path of G501, slowed to the motors' maximum accelerations.

use crate::support::simulated::{Simulated, simulate};

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
