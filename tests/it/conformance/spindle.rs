//! S with a turning spindle: the simulated spindle reaches at most 3000 r/min and changes by 3000 r/min per
//! second.

use std::time::Duration;

use plc_protocol::types::state::SpindleDirection;

use crate::support::machine::{Machine, bench};
use crate::support::simulated::{Simulated, simulate_on};

/// Degrees in a servo period of 1 ms at 1 r/min.
const DEG_PER_RPM: f64 = 0.006;

/// r/min that the spindle changes in a servo period.
const SLEW_RPM: f64 = 3.0;

/// Cycles between a block's begin and the command that follows from it.
const LATE_CYCLES: f64 = 2.0;

fn run(program: &str) -> Simulated {
    let machine =
        Machine::new("\n[m_code.3]\ntiming = \"with_motion\"\n[m_code.4]\ntiming = \"with_motion\"\n");
    simulate_on(&machine, program, &["--trace-spindle"]).completed()
}

/// Line and speed of the spindle, r/min, clockwise positive, in each servo period.
fn speeds(run: &Simulated) -> Vec<(u32, f64)> {
    let angle = |row: usize| *run.trace[row].axes.last().unwrap();
    let speed = |row: usize| {
        let turned_deg = (angle(row) - angle(row - 1) + 540.0).rem_euclid(360.0) - 180.0;
        turned_deg / DEG_PER_RPM
    };
    (1..run.trace.len())
        .map(|row| (run.trace[row].line, speed(row)))
        .collect()
}

/// Checks that from the beginning of a line the spindle changes from one speed to another, in this number of
/// periods.
fn assert_goes(run: &Simulated, line: u32, periods: usize, from_rpm: f64, to_rpm: f64) {
    let of_line: Vec<f64> = (speeds(run).into_iter())
        .filter_map(|(at, rpm)| (at == line).then_some(rpm))
        .collect();
    for (period, rpm) in of_line[..periods].iter().enumerate() {
        let gone = SLEW_RPM * period as f64;
        let expected = from_rpm + (to_rpm - from_rpm).clamp(-gone, gone);
        let late_rpm = SLEW_RPM * LATE_CYCLES;
        assert!(
            (rpm - expected).abs() <= late_rpm,
            "line {line}, period {period}: {rpm} r/min, not {expected}"
        );
    }
}

#[test]
fn s_alone_changes_the_speed_of_a_turning_spindle_at_its_block() {
    for (m, sign) in [("M03", 1.0), ("M04", -1.0)] {
        let run = run(&format!(
            "{m} S1000\nG04 X1\nS500\nG04 X0.5\nS800 G01 X10 F6000\nX20\nX90\nM30\n"
        ));
        assert_goes(&run, 2, 1000, 0.0, sign * 1000.0);
        assert_goes(&run, 4, 500, sign * 1000.0, sign * 500.0);
        assert_goes(&run, 5, 100, sign * 500.0, sign * 800.0);
        assert_eq!(
            speeds(&run).last().map(|(_, rpm)| (sign * rpm).round()),
            Some(800.0)
        );
    }
}

#[test]
fn s_changes_nothing_at_a_spindle_that_m05_or_m19_has_stopped() {
    let run = run("M03 S1000\nG04 X0.5\nM05\nG04 X0.5\nS600\nG04 X0.1\nM19\nS700\nG04 X0.1\nM30\n");
    for line in [6, 9] {
        assert_goes(&run, line, 100, 0.0, 0.0);
    }
}

#[test]
fn d32_s_before_an_m03_issued_ahead_of_the_motion_has_no_effect() {
    // M03 is issued with the motion: when it is interpreted, while line 2 moves
    let run = run("M03 S300\nG01 X50 F3000 S400\nX60 S500\nX100 S600 M04\nG04 X0.5\nM30\n");
    assert_eq!(speeds(&run).last().map(|(_, rpm)| rpm.round()), Some(-600.0));
    let ahead = self::run("S300 M03\nG01 X50 F3000 S400\nM03 S500\nX100\nM30\n");
    let in_line_2 = speeds(&ahead).into_iter().filter(|(line, _)| *line == 2);
    assert!(
        in_line_2.skip(300).all(|(_, rpm)| rpm > 499.0),
        "S400 is older than S500"
    );
}

#[test]
fn d35_s_changes_nothing_at_a_spindle_that_a_sequence_program_commands() {
    let bench = bench("").subprogram(500, "M03 S1000\nG04 X1\nS500\nG04 X1\nM30\n");
    let rpm = bench.play(async |scene, _| {
        let (plc, system) = (scene.plc(), scene.cs(1));
        system.load(500).await.unwrap();
        system.start().await.unwrap();
        plc.sleep(Duration::from_millis(500)).await;
        system.set_spindle(SpindleDirection::Cw, 800.0).await.unwrap();
        plc.sleep(Duration::from_secs(1)).await;
        system.spindle().await.unwrap().actual_rpm
    });
    assert_eq!(rpm, Ok(800.0));
}
