//! Blocks after a G31 are interpreted at once, and move from the positions at which the motors have stopped
//! (D15, M1).

use crate::support::machine::Machine;
use crate::support::simulated::{Simulated, simulate_on};

/// X is captured at 7.3 mm; M20 is issued with the motion and takes 500 ms, M6 selects a tool.
const MORE: &str = r#"
[[simulated_skip]]
motor = 1
above = 7.3

[m_code.20]
timing = "with_motion"
simulated_ms = 500

[m_code.6]
stock = "select_tool"

[[tool]]
id = 1
radius = 2.0
length = 8.0
"#;

fn run(program: &str) -> Simulated {
    simulate_on(&Machine::new(MORE), program, &[])
}

#[track_caller]
fn at(run: &Simulated, expected: [f64; 3]) {
    let found = ["X", "Y", "Z"].map(|axis| run.machine(axis));
    let close = found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9);
    assert!(close, "{found:?} is not {expected:?}");
}

/// Returns the positions in motion after line 2.
fn moved(run: &Simulated) -> Vec<Vec<f64>> {
    let rows = run.trace.iter().filter(|row| row.program != 1 || row.line > 2);
    let mut moved: Vec<Vec<f64>> = rows.map(|row| row.axes.clone()).collect();
    moved.dedup();
    moved
}

#[test]
fn d15_a_with_motion_output_behind_a_g31_is_made_while_it_moves() {
    // 7.3 mm at 10 mm/s, a tenth of the rapid velocity, take 0.7 s.
    for behind in [
        "M20\n",
        "G91 G01 X1 F600 M20\n",
        "G91 G01 X1 F600\nG01 Y2\nG31 X-1\nM20\n",
    ] {
        let run = run(&format!("G31 X20\n{behind}M30\n")).completed();
        let output_s = run.at_s("output", "m", 20);
        assert!(output_s < 0.01, "{behind}: {output_s} s");
    }
}

#[test]
fn d40_blocks_after_g31_move_from_where_the_motors_stopped() {
    for behind in [
        "G91 G01 X1 Y3 F600\nX2\nG00 Z2\n",
        "G90 G01 Y5 F600\nZ3\n",
        "G90 G03 X17.3 Y14 I0 J10 F600\n",
        "G91 G02 X4 Y4 R4 F600\nG04 X0.5\nG01 X1\n",
        "G54 G43 G00 Y30\nG49\nG01 X20 F600\n",
        "G41 G01 Y12 F600\nX20\nY30\nG40 X30\n",
        "G68 R90\nG01 X20 F600\n",
        "G51 P2\nG01 X10 Y10 F600\n",
        "G500 G01 X20 F6000\nY20\nX30\n",
        "S300 F300\nG84 Z-5 R2\nG80\n",
        "M98 P1009\n",
    ] {
        let machine = Machine::new(MORE);
        machine.write("O1009.nc", "G91 G01 X1 F600\nM99\n");
        let whole =
            |first: &str| simulate_on(&machine, &format!("M6 VA1\n{first}\n{behind}M30\n"), &[]).completed();
        let (skipped, rapid) = (whole("G31 X20 Y4"), whole("G00 X7.3 Y4"));
        at(&skipped, ["X", "Y", "Z"].map(|axis| rapid.machine(axis)));
        let (a, b) = (moved(&skipped), moved(&rapid));
        assert_eq!(a.len(), b.len(), "{behind}");
        for (a, b) in a.iter().zip(&b) {
            let close = a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
            assert!(close, "{behind}: {a:?} is not {b:?}");
        }
    }
}

#[test]
fn d40_block_after_g31_keeps_soft_limits_from_where_motors_stopped() {
    // 7.3 + 290 is within the upper limit of 300, the target of G31 + 290 is not.
    at(
        &run("G31 X20\nG91 G00 X290\nM30\n").completed(),
        [297.3, 0.0, 0.0],
    );
    let refused = run("G31 X20 Y2\nM20\nG91 G00 X293\nX-1\nM30\n");
    assert_eq!(refused.alarm(), 102);
    assert_eq!(refused.json["alarm"]["line"], 3);
    at(&refused, [7.3, 2.0, 0.0]);
}

#[test]
fn d15_a_g31_behind_a_g31_begins_where_the_first_has_ended() {
    // The second one leaves the threshold, and captures nothing.
    let run = run("G31 X20\nG91 G31 X-3 Y1\nP0=_CNC_CapturedPosition0\nG01 X1 F600\nM30\n").completed();
    at(&run, [5.3, 1.0, 0.0]);
    let p0 = run.json["variables"]["P"]["0"].as_f64().unwrap();
    assert!((p0 - 4.3).abs() < 1e-9, "{p0}");
}

#[test]
fn d15_a_captured_position_is_read_without_a_stop_once_its_g31_has_ended() {
    // M100 has waited for the end of G31, so the following chain does not stop at line 4.
    let chain = |read: &str| {
        let text = format!("G31 X20\nM100\nG91 G01 X10 F6000\n{read}\nX10\nM30\n");
        let more = format!("{MORE}\n[m_code.100]\nsimulated_ms = 1\n");
        simulate_on(&Machine::new(&more), &text, &[])
            .completed()
            .cycle_time_s()
    };
    let (with, without) = (chain("L1=_CNC_CapturedPosition0"), chain("L1=1"));
    assert!((with - without).abs() < 1e-9, "{with} s, {without} s");
}
