//! G41 and G42 on the machine (M1): positions, alarms, and permitted blocks in between.

use crate::support::machine::{COORDINATE_SYSTEMS, MOTORS, Machine};
use crate::support::simulated::{Simulated, simulate_on};

/// Tool 1 has a radius of 5 mm; M100 VA1 selects it. M20 is issued with the motion, M21 after the motion.
const TOOLS: &str = "
[[tool]]
id = 1
radius = 5.0
length = 0.0

[m_code.100]
stock = \"select_tool\"

[m_code.20]
timing = \"with_motion\"
simulated_ms = 500

[m_code.21]
";

fn run(program: &str) -> Simulated {
    simulate_on(
        &Machine::new(TOOLS),
        &format!("M100 VA1\nta20 td20 ts0 F6000\n{program}"),
        &[],
    )
}

/// X and Y of the last sample of a line.
#[track_caller]
fn end_of(run: &Simulated, line: u32) -> [f64; 2] {
    let last = run.trace.iter().rev().find(|row| row.line == line);
    let row = last.unwrap_or_else(|| panic!("line {line} does not move"));
    [row.axes[0], row.axes[1]]
}

#[track_caller]
fn near(a: [f64; 2], b: [f64; 2]) {
    assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 1e-6, "{a:?} is not {b:?}");
}

#[test]
fn s1g_the_manuals_figure_with_a_stop_at_each_block() {
    for (code, expected) in [
        ("G41", [[10.0, 10.0], [10.0, 25.0], [45.0, 25.0], [45.0, 10.0]]),
        ("G42", [[20.0, 10.0], [20.0, 15.0], [35.0, 15.0], [35.0, 10.0]]),
    ] {
        let run = run(&format!("G61 G01 {code}\nX15 Y10\nY20\nX40\nY10\nG40\nY0\nM30\n")).completed();
        for (point, line) in expected.into_iter().zip(4..) {
            near(end_of(&run, line), point);
        }
        near(end_of(&run, 9), [40.0, 0.0]);
        assert_eq!((run.machine("X"), run.machine("Y")), (40.0, 0.0));
    }
}

#[test]
fn s1g_an_outside_corner_is_passed_on_an_arc_about_it() {
    // From (20, 5) about (20, 0) to the other side of a reversal.
    let run = run("G01 G41\nX10\nX20\nX0\nG40\nX-10\nM30\n").completed();
    let arc: Vec<[f64; 2]> = run
        .trace
        .iter()
        .map(|row| [row.axes[0], row.axes[1]])
        .filter(|[x, _]| *x > 20.0 + 1e-6)
        .collect();
    assert!(arc.len() > 50);
    let farthest = arc.iter().map(|[x, _]| *x).fold(0.0, f64::max);
    assert!((24.9..25.0 + 1e-6).contains(&farthest), "{farthest}");
    near(end_of(&run, 6), [0.0, -5.0]);
}

/// Distance of each sample of a line from a centre.
fn radii(run: &Simulated, line: u32, [x, y]: [f64; 2]) -> Vec<f64> {
    let rows = run.trace.iter().filter(|row| row.line == line);
    rows.map(|row| (row.axes[0] - x).hypot(row.axes[1] - y)).collect()
}

#[test]
fn s1g_arc_offset_is_concentric_with_radius_plus_or_minus_tool_radius() {
    // Tangent all along: to the right about (10, -10), down, to the left about (30, -30), on to the right. To the left of
    // it the first radius is R + r, the second R - r; to its right the other way round.
    for (code, side) in [("G41", 1.0), ("G42", -1.0)] {
        let run = run(&format!(
            "G61 G01 {code}\nX10\nG02 X20 Y-10 J-10\nG01 Y-30\nG03 X30 Y-40 I10\nG01 X50\nG40\nX60\nM30\n"
        ))
        .completed();
        let r = 5.0 * side;
        for (line, end) in [
            (4, [10.0, r]),
            (5, [20.0 + r, -10.0]),
            (6, [20.0 + r, -30.0]),
            (7, [30.0, -40.0 + r]),
            (8, [50.0, -40.0 + r]),
            (10, [60.0, -40.0]),
        ] {
            near(end_of(&run, line), end);
        }
        for (line, centre, radius) in [(5, [10.0, -10.0], 10.0 + r), (7, [30.0, -30.0], 10.0 - r)] {
            let radii = radii(&run, line, centre);
            assert!(radii.len() > 50);
            for found in radii {
                assert!(
                    (found - radius).abs() < 1e-6,
                    "{code} line {line}: {found} is not {radius}"
                );
            }
        }
    }
}

#[test]
fn s1g_an_m_code_that_waits_is_an_alarm_before_the_lead_out() {
    for (program, line) in [
        ("G01 G41\nX10\nX20\nM21\nX30\nG40\nX40\nM30\n", 6),
        ("G01 G41\nX10\nX20\nX30\nG40\nM21\nX40\nM30\n", 8),
    ] {
        let run = run(program);
        assert_eq!(run.alarm(), 40);
        assert_eq!(run.json["alarm"]["line"], line);
        let outputs = run.events("output");
        assert!(outputs.iter().all(|output| output["m"] == 100), "{outputs:?}");
        // The last block before it does not move, because the next block would determine its end.
        let last = (run.machine("X"), run.machine("Y"));
        assert_eq!(last, if line == 6 { (10.0, 5.0) } else { (20.0, 5.0) });
    }
}

#[test]
fn s1g_with_motion_m_code_is_allowed_and_may_wait_for_the_previous() {
    let run = run("G01 G41\nX10\nX20 M20\nX30 M20\nX40\nG40\nX50\nM30\n").completed();
    assert_eq!(
        run.events("output")
            .iter()
            .filter(|output| output["m"] == 20)
            .count(),
        2
    );
    assert_eq!((run.machine("X"), run.machine("Y")), (50.0, 0.0));
    near(end_of(&run, 7), [40.0, 5.0]);
}

#[test]
fn s1g_a_program_that_ends_without_a_lead_out_is_an_alarm() {
    let machine = Machine::new(TOOLS);
    machine.write("1000.nc", "G01 G41\nX10\nX20\nM99\n");
    let program = "M100 VA1\nF6000\nM98 P1000\nM30\n";
    let run = simulate_on(&machine, program, &[]);
    assert_eq!(run.alarm(), 40);
    assert_eq!(run.json["alarm"]["line"], 4);
}

/// A groove 8 mm wide and 10 mm deep under a tool of 10 mm.
const GROOVE: &str = "M100 VA1\nta20 td20 ts0 F6000\nG01 G41\nX10\nX30\nY-10\nX38\nY0\nX60\nG40\nX70\nM30\n";

#[test]
fn s1g_an_overcut_is_found_before_the_first_block_that_it_concerns_moves() {
    let run = simulate_on(&Machine::new(TOOLS), GROOVE, &[]);
    assert_eq!(run.alarm(), 120);
    assert_eq!(
        (&run.json["alarm"]["program"], &run.json["alarm"]["line"]),
        (&1.into(), &7.into())
    );
    // Next to the groove's edge, not in it.
    assert_eq!((run.machine("X"), run.machine("Y")), (35.0, 5.0));
}

#[test]
fn s1g_prevention_leaves_the_groove_out() {
    let systems = COORDINATE_SYSTEMS.replacen(
        "max_feedrate = 12000.0",
        "max_feedrate = 12000.0\novercut = \"prevent\"",
        1,
    );
    let machine = Machine::with_config(&format!("{MOTORS}{systems}{TOOLS}"));
    let run = simulate_on(&machine, GROOVE, &[]).completed();
    let lowest = (run.trace.iter())
        .filter(|row| (20.0..50.0).contains(&row.axes[0]))
        .map(|row| row.axes[1])
        .fold(f64::MAX, f64::min);
    assert!((lowest - 5.0).abs() < 1e-6, "{lowest}");
    assert_eq!((run.machine("X"), run.machine("Y")), (70.0, 0.0));
}
