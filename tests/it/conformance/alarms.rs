//! Alarms of the program: at their block, before its motion.

use crate::support::machine::Machine;
use crate::support::simulated::{simulate, simulate_on};

#[test]
fn a_target_beyond_a_soft_limit_is_an_alarm_before_its_motion_starts() {
    // X may go to 300 mm.
    let run = simulate("G00 X200\nG01 X301 F6000\nM30\n");
    assert_eq!(run.alarm(), 102);
    assert_eq!(
        (&run.json["alarm"]["program"], &run.json["alarm"]["line"]),
        (&1.into(), &2.into())
    );
    let highest = run.trace.iter().map(|row| row.axes[0]).fold(f64::MIN, f64::max);
    assert_eq!(highest, 200.0);
}

#[test]
fn an_alarm_names_the_column_of_the_word_to_blame() {
    for (block, alarm, column) in [
        ("N5 G00 Y1 X301", 102, 11),
        ("G91 G01 Y1 X301 F600", 102, 12),
        // the circle of radius 200 about X0 Y200 reaches X-200: only the word X is the cause
        ("G02 Y400 X0 J200 F600", 102, 10),
        ("G28 X301", 102, 5),
        ("G02 X10 Y0 J0 I10 F600", 111, 12),
        ("X1 G03 R[P0] Y10 F600", 111, 8),
        ("G01 X5 S[P1] F600", 11, 8),
        ("G84 Z-5 R-1 S0 F600", 113, 13),
        // no word of the block is the cause
        ("  G01 X5", 101, 3),
        (" G84 Z-5 R-1 F600", 113, 2),
    ] {
        let run = simulate(&format!("P0=1 P1=3001\n{block}\nG80\nM30\n"));
        assert_eq!(run.alarm(), alarm, "{block}");
        let place = (&run.json["alarm"]["line"], &run.json["alarm"]["column"]);
        assert_eq!(place, (&2.into(), &column.into()), "{block}");
    }
}

#[test]
fn a_target_on_a_soft_limit_is_reached() {
    let run = simulate("G00 X300\nG00 X-100\nM30\n").completed();
    assert_eq!(run.machine("X"), -100.0);
}

#[test]
fn a_soft_limit_is_a_machine_position() {
    // G54 puts 10 mm between program and machine.
    let run = simulate("G54 G00 X290.5\nM30\n");
    assert_eq!(run.alarm(), 102);
    assert_eq!(run.machine("X"), 0.0);
}

#[test]
fn cutting_without_a_feedrate_is_an_alarm_and_moves_nothing() {
    let run = simulate("G01 X10\nM30\n");
    assert_eq!(run.alarm(), 101);
    assert_eq!(run.machine("X"), 0.0);
}

#[test]
fn default_feedrate_is_the_f_of_a_program_that_writes_none() {
    let config = "[[motor]]\nnumber = 1\nkind = \"linear\"\nmax_velocity = 500.0\nmax_acceleration = 5000.0\n\
                  [[coordinate_system]]\nnumber = 1\naxes = { X = 1 }\ndefault_feedrate = 6000.0\n";
    let run = simulate_on(
        &Machine::with_config(config),
        "ta100 td100 ts0\nG01 X60\nM30\n",
        &[],
    )
    .completed();
    assert!(
        (0.7..0.7051).contains(&run.cycle_time_s()),
        "{}",
        run.cycle_time_s()
    );
}

#[test]
fn d11_s_above_the_spindles_maximum_does_not_run() {
    let run = simulate("S3000\nM30\n").completed();
    assert!(run.json["alarm"].is_null());
    let machine = Machine::new("");
    let run = simulate_on(&machine, "G00 X5\nS3001\nM30\n", &[]);
    assert_eq!(run.ran.code, 1, "{}", run.json);
    assert_ne!(run.json["outcome"], "completed");
}

#[test]
fn an_axis_that_the_coordinate_system_does_not_have_does_not_run() {
    let run = simulate_on(&Machine::new(""), "G00 X5\nG00 A1\nM30\n", &[]);
    assert_eq!(run.ran.code, 1, "{}", run.json);
    assert_ne!(run.json["outcome"], "completed");
}

#[test]
fn an_alarm_cancels_the_open_outputs() {
    let machine = Machine::new("[m_code.20]\ntiming = \"with_motion\"\nsimulated_ms = 60000\n");
    let run = simulate_on(&machine, "M20\nG00 X50\nG00 X900\nM30\n", &[]);
    assert_eq!(run.alarm(), 102);
    assert!(
        run.events("reset").is_empty(),
        "the cancelled output is not reset"
    );
    assert!(run.json["m_codes"][0]["reset_s"].is_null());
}

#[test]
fn an_alarm_of_one_coordinate_system_does_not_stop_the_other() {
    let machine = Machine::new("");
    machine.write("second.nc", "G00 X50\nG00 X0\nM30\n");
    let run = simulate_on(&machine, "G00 X900\nM30\n", &["--with", "2=second.nc"]);
    assert_eq!(run.alarm(), 102);
    let ended = run
        .events
        .iter()
        .any(|event| event["cs"] == 2 && event["event"] == "end");
    assert!(ended, "coordinate system 2 comes to its end: {:?}", run.events);
}

#[test]
fn an_alarm_of_a_motor_that_does_not_arrive_names_program_and_line() {
    // X follows with a lag of 10 s: after 0.1 s it is far from its command.
    let config = "[[motor]]\nnumber = 1\nkind = \"linear\"\nmax_velocity = 500.0\nmax_acceleration = 5000.0\n\
                  lag_ms = 10000.0\nin_position_timeout_ms = 100.0\n\
                  [[coordinate_system]]\nnumber = 1\naxes = { X = 1 }\n";
    let run = simulate_on(&Machine::with_config(config), "\n\nG00 X10\nM30\n", &[]);
    assert_eq!(run.alarm(), 200);
    assert_eq!(
        (&run.json["alarm"]["program"], &run.json["alarm"]["line"]),
        (&1.into(), &3.into())
    );
    let text = run.json["alarm"]["text"].as_str().unwrap();
    assert!(text.contains("Motor 1 (axis X)"), "{text}");
}
