//! Arcs, planes, units, reference points, skip, tool length, and the transforms of D20: the end positions of
//! each.

use crate::support::machine::{COORDINATE_SYSTEMS, MOTORS, Machine};
use crate::support::simulated::{Simulated, simulate, simulate_on};

/// M6 VA selects a tool; tool 1 is 8 mm long, tool 2 is 6 mm long.
const TOOLS: &str = "\n[m_code.6]\nstock = \"select_tool\"\n\
                     \n[[tool]]\nid = 1\nradius = 5.0\nlength = 8.0\n\n[[tool]]\nid = 2\nradius = 5.0\nlength = 6.0\n";

fn close(a: f64, b: f64) {
    assert!((a - b).abs() < 1e-9, "{a} is not {b}");
}

fn at(run: &Simulated, x: f64, y: f64, z: f64) {
    for (axis, expected) in [("X", x), ("Y", y), ("Z", z)] {
        close(run.machine(axis), expected);
    }
}

fn lowest(run: &Simulated, axis: usize) -> f64 {
    run.trace.iter().map(|row| row.axes[axis]).fold(0.0, f64::min)
}

fn highest(run: &Simulated, axis: usize) -> f64 {
    run.trace.iter().map(|row| row.axes[axis]).fold(0.0, f64::max)
}

/// Checks that the commanded positions of an arc are on the circle of radius 5 about a centre; returns the
/// range of each axis.
fn assert_on_circle(run: &Simulated, line: u32, axes: [usize; 2], centre: [f64; 2]) {
    let rows: Vec<_> = run.trace.iter().filter(|row| row.line == line).collect();
    assert!(rows.len() > 100, "{} samples", rows.len());
    for row in rows {
        let radius = (row.axes[axes[0]] - centre[0]).hypot(row.axes[axes[1]] - centre[1]);
        assert!((radius - 5.0).abs() < 2e-9, "radius {radius} at {} s", row.time_s);
    }
}

#[test]
fn m1f_g02_goes_clockwise_and_g03_counter_clockwise() {
    let run = simulate("G01 X10 F3000\nG61 G02 X20 I5\nM30\n").completed();
    assert_on_circle(&run, 2, [0, 1], [15.0, 0.0]);
    at(&run, 20.0, 0.0, 0.0);
    assert!(highest(&run, 1) > 4.999 && lowest(&run, 1) > -1e-6);
    let run = simulate("G01 X10 F3000\nG61 G03 X20 R5\nM30\n").completed();
    assert_on_circle(&run, 2, [0, 1], [15.0, 0.0]);
    assert!(lowest(&run, 1) < -4.999 && highest(&run, 1) < 1e-6);
}

#[test]
fn m1f_an_arc_takes_its_length_at_f() {
    // pi * 5 mm at 50 mm/s and half of each ramp of 20 ms
    let run = simulate("ta20 td20 ts0\nG61 G02 X10 I5 F3000\nM30\n").completed();
    let expected_s = std::f64::consts::PI * 5.0 / 50.0 + 0.02;
    let late_s = run.cycle_time_s() - expected_s;
    assert!((0.0..0.0052).contains(&late_s), "{} s", run.cycle_time_s());
}

#[test]
fn m1f_g18_turns_from_z_to_x_and_g19_from_y_to_z() {
    // From the start to 10 further on the first axis, counter-clockwise: by way of minus 5 on the second.
    let run = simulate("G61\nG18 G03 Z10 K5 F3000\nM30\n").completed();
    assert_on_circle(&run, 2, [2, 0], [5.0, 0.0]);
    assert!(lowest(&run, 0) < -4.999 && highest(&run, 0) < 1e-6);
    at(&run, 0.0, 0.0, 10.0);
    let run = simulate("G61\nG19 G03 Y10 J5 F3000\nM30\n").completed();
    assert_on_circle(&run, 2, [1, 2], [5.0, 0.0]);
    assert!(lowest(&run, 2) < -4.999 && highest(&run, 2) < 1e-6);
    at(&run, 0.0, 10.0, 0.0);
}

#[test]
fn d25_g20_reads_lengths_and_f_in_inches_and_g21_in_millimetres() {
    let run = simulate("ta20 td20 ts0 G61\nG20 G01 X1 F100\nG21 X30.4\nM30\n").completed();
    close(run.machine("X"), 30.4);
    // F100 inch/min is 42.333 mm/s for 25.4 mm, then for 5 mm
    let v = 100.0 * 25.4 / 60.0;
    let late_s = run.cycle_time_s() - (25.4 / v + 0.02 + 5.0 / v + 0.02);
    assert!((0.0..0.0104).contains(&late_s), "{} s", run.cycle_time_s());
}

#[test]
fn d25_the_numbers_of_max_and_default_feedrate_count_in_inches_in_g20() {
    let systems = COORDINATE_SYSTEMS.replacen(
        "max_feedrate = 12000.0",
        "max_feedrate = 120.0\ndefault_feedrate = 60.0",
        1,
    );
    let machine = Machine::with_config(&format!("[machine]\nname = \"test-1\"\n{MOTORS}{systems}"));
    // without F 60, with F600 the maximum of 120, in inch/min or in mm/min; one inch, or 25.4 mm, in each block
    for (text, unit_mm) in [("G20 G01 X1\nX2 F600", 25.4), ("G01 X25.4\nX50.8 F600", 1.0)] {
        let text = format!("ta20 td20 ts0 G61\n{text}\nM30\n");
        let run = simulate_on(&machine, &text, &[]).completed();
        close(run.machine("X"), 50.8);
        let time_s = 25.4 / unit_mm + 0.02 + 25.4 / (2.0 * unit_mm) + 0.02;
        let late_s = run.cycle_time_s() - time_s;
        assert!((0.0..0.0104).contains(&late_s), "{} s", run.cycle_time_s());
    }
    // the motor is limited to 500 mm/s: 120 inch/min is below this, 60000 inch/min is above
    let fast = systems.replacen("max_feedrate = 120.0", "max_feedrate = 60000.0", 1);
    let machine = Machine::with_config(&format!("[machine]\nname = \"test-1\"\n{MOTORS}{fast}"));
    let text = "ta20 td20 ts0 G61\nG20 G01 X10 F60000\nM30\n";
    let run = simulate_on(&machine, text, &[]).completed();
    assert!(run.cycle_time_s() > 254.0 / 500.0, "{} s", run.cycle_time_s());
}

/// A machine whose first to third motors have reference points.
fn with_reference_points() -> Machine {
    let points = "kind = \"linear\"\nreference_points = [-10.0, 20.0, 30.0, 40.0]\n";
    let motors = MOTORS.replace("kind = \"linear\"\n", points);
    Machine::with_config(&format!(
        "[machine]\nname = \"test-1\"\n{motors}{COORDINATE_SYSTEMS}"
    ))
}

#[test]
fn m1e_g28_goes_by_the_middle_point_and_moves_named_axes_only() {
    let machine = with_reference_points();
    let run = simulate_on(&machine, "G00 X5 Y5\nG28 X50\nM30\n", &[]).completed();
    at(&run, -10.0, 5.0, 0.0);
    close(highest(&run, 0), 50.0);
    let run = simulate_on(&machine, "G00 X5 Y5\nG28\nM30\n", &[]).completed();
    // D24: all axes, straight
    at(&run, -10.0, -10.0, -10.0);
    close(highest(&run, 0), 5.0);
}

#[test]
fn m1e_g30_goes_to_the_second_third_and_fourth_reference_point() {
    let machine = with_reference_points();
    for (p, expected) in [("", 20.0), ("P2", 20.0), ("P3", 30.0), ("P4", 40.0)] {
        let run = simulate_on(&machine, &format!("G30 {p} X1\nM30\n"), &[]).completed();
        at(&run, expected, 0.0, 0.0);
    }
}

#[test]
fn d40_g31_ends_where_the_skip_input_came_and_without_one_at_its_target() {
    let machine = Machine::new("\n[[simulated_skip]]\nmotor = 1\nabove = 7.3\n");
    let run = simulate_on(&machine, "G31 X20 Y4\nG91 G00 X1\nM30\n", &[]).completed();
    at(&run, 8.3, 4.0, 0.0);
    let captured = &run.json["captured"];
    assert_eq!(captured[0]["motor"], 1);
    close(captured[0]["position"].as_f64().unwrap(), 7.3);
    assert_eq!(
        (&captured[0]["captured"], &captured[1]["captured"]),
        (&true.into(), &false.into())
    );
    assert_eq!(captured[1]["position"], 4.0);
}

#[test]
fn d41_captured_positions_ascend_by_motor_after_their_g31_has_ended() {
    // X is motor 5, Y motor 1: position 0 is that of Y.
    let config = MOTORS.to_owned()
        + "\n[[coordinate_system]]\nnumber = 1\naxes = { X = 5, Y = 1 }\n\
           \n[coordinate_system.work_offset]\nG54 = { Y = 2.0 }\n\
           \n[[simulated_skip]]\nmotor = 1\nabove = 7.25\n\n[[simulated_skip]]\nmotor = 5\nbelow = -3.5\n";
    let machine = Machine::with_config(&format!("[machine]\nname = \"test-1\"\n{config}"));
    let program = "G54\nG31 X-20 Y40\nP0=_CNC_CapturedPosition0 P1=_CNC_CapturedPosition1\n\
                   M100 VA[_CNC_CapturedPosition0] VB[_CNC_CapturedPosition1]\n\
                   G31 X20\nP2=_CNC_CapturedPosition0 P3=_CNC_CapturedPosition1\nM30\n";
    let run = simulate_on(&machine, program, &[]).completed();
    let p = |n: u32| {
        run.json["variables"]["P"][n.to_string()]
            .as_f64()
            .unwrap_or_default()
    };
    // Machine coordinates: the position is the threshold, independent of G54. The second G31 leaves the
    // threshold of motor 5 and captures nothing, so the position is its target; motor 1 does not move in this
    // block, and reports its rest position.
    for (n, expected) in [(0, 7.25), (1, -3.5), (2, 7.25), (3, 20.0)] {
        close(p(n), expected);
    }
    let params = &run.json["m_codes"][0]["params"];
    close(params["A"].as_f64().unwrap(), 7.25);
    close(params["B"].as_f64().unwrap(), -3.5);
}

#[test]
fn d41_captured_positions_are_in_the_units_of_the_motors_also_in_inches() {
    let machine = Machine::new("\n[[simulated_skip]]\nmotor = 1\nabove = 7.25\n");
    let program = "G20\nG31 X1 Y0.5\nP0=_CNC_CapturedPosition0 P1=_CNC_CapturedPosition1\nM30\n";
    let run = simulate_on(&machine, program, &[]).completed();
    let p = |n: &str| run.json["variables"]["P"][n].as_f64().unwrap();
    close(p("0"), 7.25);
    close(p("1"), 12.7);
}

#[test]
fn d22_g43_and_g44_shift_z_by_the_tool_length_without_motion_of_their_own() {
    // The manual's figure: length 8, Z-10 ends at -2; length 6 at -4; G49, Z0 at 0.
    for (program, z) in [
        ("M6 VA1\nG43\nG00 Z-10\nM30\n", -2.0),
        ("M6 VA2\nG43\nG00 Z-10\nM30\n", -4.0),
        ("M6 VA1\nG43\nG00 Z-10\nG49\nG00 Z0\nM30\n", 0.0),
        ("M6 VA1\nG44\nG00 Z-10\nM30\n", -18.0),
        ("M6 VA1\nG43\nM30\n", 0.0),
        ("M6 VA1\nG43\nG00 X1\nM30\n", 8.0),
    ] {
        let run = simulate_on(&Machine::new(TOOLS), program, &[]).completed();
        close(run.machine("Z"), z);
    }
}

#[test]
fn d17_g41_to_g44_without_a_tool_of_the_table_tell_so_and_go_on() {
    // Tool 3 is not in the table.
    for select in ["", "M6 VA3"] {
        for (program, code, what) in [
            ("G41 G01 X10 F6000\nX20\nG40 X30", "G41", "radius"),
            ("G42 G01 X10 F6000\nX20\nG40 X30", "G42", "radius"),
            ("G43 G00 Z-10", "G43", "length"),
            ("G44 G00 Z-10", "G44", "length"),
        ] {
            let run =
                simulate_on(&Machine::new(TOOLS), &format!("{select}\n{program}\nM30\n"), &[]).completed();
            let warnings = run.json["warnings"].as_array().unwrap();
            assert_eq!(warnings.len(), 1, "{code}: {warnings:?}");
            assert_eq!(warnings[0]["line"], 2);
            let text = warnings[0]["text"].as_str().unwrap();
            assert!(
                text.contains(code) && text.contains(what) && text.contains("no tool"),
                "{text}"
            );
        }
    }
    let program = "M6 VA1\nG43 G41 G01 X10 F6000\nX20\nG40 X30\nG49\nM30\n";
    let run = simulate_on(&Machine::new(TOOLS), program, &[]).completed();
    assert_eq!(run.json["warnings"].as_array().unwrap().len(), 0, "{}", run.json);
}

/// The machine with an axis A.
fn with_rotary_axis() -> Machine {
    let motor = "[[motor]]\nnumber = 6\nkind = \"rotary\"\nmax_velocity = 500.0\nmax_acceleration = 5000.0\n";
    let systems = COORDINATE_SYSTEMS.replace("Z = 3 }", "Z = 3, A = 6 }");
    Machine::with_config(&format!(
        "[machine]\nname = \"test-1\"\n{MOTORS}\n{motor}{systems}{TOOLS}"
    ))
}

/// Asserts the time of a move of 60 at F with ramps of 0.02 s, stop to stop.
#[track_caller]
fn takes(program: &str, length: f64, feed_min: f64) {
    let run = simulate_on(&with_rotary_axis(), program, &[]).completed();
    let late_s = run.cycle_time_s() - (length / (feed_min / 60.0) + 0.02);
    assert!(
        (-1e-9..0.0104).contains(&late_s),
        "{program}: {} s",
        run.cycle_time_s()
    );
}

#[test]
fn d25_f_of_a_block_that_moves_rotary_axes_only_is_in_degrees_a_minute() {
    let times = "ta20 td20 ts0 G61\n";
    takes(&format!("{times}G20 G01 A60 F600\nM30\n"), 60.0, 600.0);
    // X is already at its target.
    takes(&format!("{times}G20 G01 X0 A60 F600\nM30\n"), 60.0, 600.0);
    takes(&format!("{times}G20 G01 F600\nA60\nM30\n"), 60.0, 600.0);
}

#[test]
fn d22_d25_f_counts_the_way_that_z_makes_good_in_a_block_of_rotary_axes() {
    // Tool 1 is 8 mm long: Z moves, so F is in inches a minute over its way (M1).
    let program = "M6 VA1\nta20 td20 ts0 G61\nG20 G43\nG01 A60 F10\nM30\n";
    takes(program, 8.0, 254.0);
    takes(&program.replace("G20", "G21"), 8.0, 10.0);
}

#[test]
fn d20_each_transform_leads_where_its_formula_says() {
    // Centre 2, factor 3: 2 + 3 (4 - 2). Mirror about 5: 2 * 5 - 3. By 90 degrees about (10, 0): (13, 0) to (10, 3).
    for (program, [x, y]) in [
        ("G51 X2 Y0 P3\nG00 X4 Y1\nM30\n", [8.0, 3.0]),
        ("G51 X2 Y0 I3 J1\nG00 X4 Y1\nM30\n", [8.0, 1.0]),
        ("G51 X2 P3\nG50\nG00 X4 Y1\nM30\n", [4.0, 1.0]),
        ("G51.1 X5\nG00 X3 Y1\nM30\n", [7.0, 1.0]),
        ("G51.1 X5\nG50.1\nG00 X3 Y1\nM30\n", [3.0, 1.0]),
        ("G68 X10 Y0 R90\nG00 X13 Y0\nM30\n", [10.0, 3.0]),
        ("G68 X10 Y0 R90\nG69\nG00 X13 Y0\nM30\n", [13.0, 0.0]),
        ("G54 G52 X5\nG00 X1 Y1\nM30\n", [16.0, 21.0]),
        ("G54 G52 X5\nG52\nG00 X1 Y1\nM30\n", [11.0, 21.0]),
        ("G54 G52 X5\nG53 X1 Y1\nM30\n", [1.0, 1.0]),
        ("G54\nG53 X1 Y1\nG00 X1\nM30\n", [11.0, 1.0]),
    ] {
        let run = simulate(program).completed();
        close(run.machine("X"), x);
        close(run.machine("Y"), y);
    }
}

#[test]
fn d23_g53_g28_and_g30_with_a_tool_length_do_not_run() {
    for code in ["G53 X1", "G28", "G30 X1"] {
        let run = simulate_on(&Machine::new(TOOLS), &format!("M6 VA1\nG43\n{code}\nM30\n"), &[]);
        assert_eq!(run.ran.code, 1, "{code}: {}", run.json);
        assert!(run.trace.iter().all(|row| row.axes == [0.0; 3]), "{code} moves");
    }
}

#[test]
fn d26_arc_is_checked_with_the_set_tolerance_in_machine_coordinates() {
    let keys = "max_feedrate = 12000.0\narc_radius_tolerance = 0.1\n";
    let systems = COORDINATE_SYSTEMS.replace("max_feedrate = 12000.0\n", keys);
    let machine = Machine::with_config(&format!("[machine]\nname = \"test-1\"\n{MOTORS}{systems}"));
    // Half the way is 5: short by 0.05, then by 0.2.
    for way in ["G90 G00 X0 Y0\nG02 X10 Y0", "G91\nG02 X10"] {
        for (radius, outcome) in [("4.95", "completed"), ("4.8", "errors")] {
            let run = simulate_on(&machine, &format!("F600\n{way} R{radius}\nM30\n"), &[]);
            assert_eq!(run.json["outcome"], outcome, "{way} R{radius}: {}", run.json);
        }
    }
    // Short by 0.05 is 0.005 mm at a tenth of the size, within the tolerance of 0.01 mm, and short by 0.5 is not.
    let small = "G51 X0 Y0 Z0 P0.1\nG90 G00 X0 Y0\n";
    simulate(&format!("{small}G02 X10 Y0 R4.95 F600\nM30\n")).completed();
    let run = simulate(&format!("{small}G02 X10 Y0 R4.5 F600\nM30\n"));
    assert_eq!(run.alarm(), 111);
}

#[test]
fn d21_an_arc_under_unequal_scale_is_an_alarm_and_moves_nothing() {
    let run = simulate("G51 X0 Y0 I2 J1\nG02 X10 I5 F3000\nM30\n");
    assert_eq!(run.ran.code, 1, "{}", run.json);
    at(&run, 0.0, 0.0, 0.0);
    assert_eq!(run.json["alarm"]["line"], 2);
}
