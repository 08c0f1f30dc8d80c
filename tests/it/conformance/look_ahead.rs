//! G64 with G500 (M1): the path of G501, slowed to the motors' maximum accelerations.

use crate::support::formula::Ramp;
use crate::support::machine::{COORDINATE_SYSTEMS, MOTORS, Machine};
use crate::support::simulated::{Row, Simulated, simulate, simulate_on};

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
    // Positions of a trace have a resolution of a nanometre or better.
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
fn m1d_short_read_ahead_slows_the_motion_within_limits_without_alarm() {
    // From 200 mm/s at 5000 mm/s^2 the distance to rest is 4 mm, which are 80 blocks.
    let fine: Vec<String> = (1..=400)
        .map(|n| format!("X{:.3} Y{:.4}\n", f64::from(n) * 0.05, f64::from(n % 2) * 1e-4))
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
fn m1d_at_most_128_micrometre_blocks_pass_in_one_servo_period() {
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
fn m1d_long_program_is_as_fast_if_read_ahead_holds_the_stopping_path() {
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

/// 20 mm along X, then 15 mm along Y, both at 40 mm/s; the blocks in between lead to machine X20 Y15 by `end`.
fn corner(between: &str, end: &str) -> Simulated {
    simulate(&format!(
        "ta100 td100 ts0 G500 G54 G01 F2400\nX10\n{between}\n{end}\nM30\n"
    ))
    .completed()
}

#[test]
fn m1c_with_g500_an_offset_change_keeps_the_chain_moving() {
    // G54 has X10 Y20, G57 has X13: M1b, 0.5 s and 0.375 s between the middles of ramps of 0.1 s
    let ramp = Ramp::new(0.1, 0.0);
    let way = |from: f64, to: f64, t: f64| 40.0 * (ramp.integral(t - from) - ramp.integral(t - to));
    let changes = [
        ("G57", "X7 Y15"),
        ("G52 X-1 Y-2", "X11 Y-3"),
        ("G51.1 X0", "X-10 Y-5"),
        ("G68 X10 Y-20 R90", "X25 Y-20"),
    ];
    for (between, end) in changes {
        let run = corner(between, end);
        let first = run
            .trace
            .iter()
            .position(|row| row.axes[X] > 0.0)
            .expect("motion")
            - 1;
        let moving = run.trace[first..].iter().enumerate();
        for (k, row) in moving.map(|(k, row)| (k as f64 * T, row)).take(975) {
            let expected = [way(0.0, 0.5, k), way(0.5, 0.875, k), 0.0];
            for (found, expected) in row.axes.iter().zip(expected) {
                assert!(
                    (found - expected).abs() < 1.1e-9,
                    "{between}: {row:?}, {expected} at {k} s"
                );
            }
        }
        assert!((run.machine("X") - 20.0).abs() < 1e-9 && (run.machine("Y") - 15.0).abs() < 1e-9);
    }
    let run = corner("G57", "X7 Y15");
    assert!((run.work("X") - 7.0).abs() < 1e-9 && (run.work("Y") - 15.0).abs() < 1e-9);
}

#[test]
fn m1c_with_g500_g09_stops_also_in_a_block_that_does_not_move() {
    let rests = |between: &str, end: &str| {
        let at_corner = |row: &Row| (row.axes[X], row.axes[Y]) == (20.0, 0.0);
        corner(between, end).trace.iter().any(at_corner)
    };
    assert!(!rests("G17", "Y-5"));
    for between in ["G09", "G09 G17", "G09 F2400", "F2400 G09", "G09\nG17"] {
        assert!(rests(between, "Y-5"), "{between}");
    }
    for between in ["G09 G57", "G57 G09"] {
        assert!(rests(between, "X7 Y15"), "{between}");
    }
}
