//! Coordinates: G90, G91, work offsets, dwell forms.

use crate::support::formula::LATE_S;
use crate::support::machine::Machine;
use crate::support::simulated::{simulate, simulate_on};

#[test]
fn g90_words_are_positions_and_g91_words_are_distances() {
    let run = simulate("G90 G01 X10 F6000\nX20\nG91 X5 Y-3\nX5\nG90 Y7\nM30\n").completed();
    assert_eq!((run.machine("X"), run.machine("Y")), (30.0, 7.0));
}

#[test]
fn g90_is_the_start_up_state_and_axes_that_are_not_named_stay() {
    let run = simulate("G01 X10 Y5 F6000\nX12\nM30\n").completed();
    assert_eq!(
        (run.machine("X"), run.machine("Y"), run.machine("Z")),
        (12.0, 5.0, 0.0)
    );
}

#[test]
fn g54_to_g59_put_their_offset_between_program_and_machine() {
    for (code, offset) in [
        ("G54", 10.0),
        ("G55", 11.0),
        ("G56", 12.0),
        ("G57", 13.0),
        ("G58", 14.0),
        ("G59", 15.0),
    ] {
        let run = simulate(&format!("{code} G00 X5\nM30\n")).completed();
        assert_eq!(run.machine("X"), 5.0 + offset, "{code}");
        assert_eq!(run.work("X"), 5.0, "{code}");
    }
}

#[test]
fn d20_switching_an_offset_on_moves_nothing() {
    let run = simulate("G00 X5\nG54\nM100\nG91 G00 X1\nM30\n").completed();
    // At the M code the machine is where it was; then it moves by 1 and by nothing more.
    assert_eq!(run.machine("X"), 6.0);
    assert_eq!(run.work("X"), -4.0);
    let highest = run.trace.iter().map(|row| row.axes[0]).fold(f64::MIN, f64::max);
    assert_eq!(highest, 6.0);
}

#[test]
fn d20_an_offset_acts_on_all_its_axes() {
    let run = simulate("G54 G00 X0 Y0 Z0\nM30\n").completed();
    assert_eq!(
        (run.machine("X"), run.machine("Y"), run.machine("Z")),
        (10.0, 20.0, 30.0)
    );
}

#[test]
fn d25_units_inch_is_g20_at_start_up_and_settings_stay_in_mm() {
    let machine = Machine::new("units = \"inch\"\n[coordinate_system.work_offset]\nG54 = { X = 10.0 }\n");
    let program = "G54 G01 X1 F100 ta100 td100 ts0\nM30\n";
    let run = simulate_on(&machine, program, &["--cs", "2"]).completed();
    assert_eq!((run.machine("X"), run.work("X")), (35.4, 25.4));
    // 35.4 mm at 2540 mm/min, and half of both ramps
    let expected_s = 35.4 / (2540.0 / 60.0) + 0.1;
    let late_s = run.cycle_time_s() - expected_s;
    assert!((-1e-9..LATE_S).contains(&late_s), "{} s", run.cycle_time_s());
    let back = simulate_on(&machine, "G21 G01 X1 F100\nM30\n", &["--cs", "2"]).completed();
    assert_eq!(back.machine("X"), 1.0);
}

#[test]
fn g04_f_and_x_are_in_seconds_and_p_in_milliseconds() {
    for program in ["G04 X0.75\nM30\n", "G04 F0.75\nM30\n", "G04 P750\nM30\n"] {
        let run = simulate(program).completed();
        let late_s = run.cycle_time_s() - 0.75;
        assert!(
            (-1e-9..LATE_S).contains(&late_s),
            "{program}: {} s",
            run.cycle_time_s()
        );
        assert_eq!(run.machine("X"), 0.0, "a dwell word moves nothing");
    }
}

#[test]
fn d19_f_in_a_g04_block_is_a_dwell_word_and_the_feedrate_stays() {
    // Were F0.5 the feedrate, the second 10 mm would take 1200 s.
    let run = simulate("ta100 td100 ts0\nG01 X10 F600\nG04 F0.5\nX20\nM30\n").completed();
    // 1.1 s for each block
    assert!(
        (2.7 - 1e-9..2.7 + 3.0 * LATE_S).contains(&run.cycle_time_s()),
        "{}",
        run.cycle_time_s()
    );
    assert_eq!(run.machine("X"), 20.0);
}
