//! Programs of dialect dgshape on a simulated machine: the path of the motors, and the outputs.

use std::time::Duration;

use plc_protocol::types::request::OverrideChange;
use plc_protocol::types::state::SpindleDirection;
use tandem_testing::Bench;

use super::{MACHINE, program};
use crate::support::machine::Machine;
use crate::support::simulated::simulate_on;

fn machine(more: &str) -> Machine {
    Machine::with_config(&format!(
        "[machine]\nname = \"mill-1\"\nservo_late_ms = 1500\n{}{more}",
        *MACHINE
    ))
}

#[test]
fn dgshape_g00_is_straight_and_as_fast_as_the_motors_can_together() {
    let ran = simulate_on(&machine(""), &program("G00X40.Y20.Z5."), &[]).completed();
    for row in &ran.trace {
        let [x, y, z] = [row.axes[0], row.axes[1], row.axes[2]];
        assert!(
            (y - x / 2.0).abs() < 1e-8 && (z - x / 8.0).abs() < 1e-8,
            "{x} {y} {z}"
        );
    }
    // X is the slowest: 40 mm at 100 mm/s and 1000 mm/s^2 take 0.4 s and 0.1 s for the ramps
    assert!(
        (0.5..0.51).contains(&ran.cycle_time_s()),
        "{}",
        ran.cycle_time_s()
    );
}

#[test]
fn dgshape_1_4_the_override_gives_a_part_of_the_feedrate_that_is_written() {
    // 50 mm at 600 mm/min take 5 s, and the ramps less than 20 ms; an override stretches the time of the
    // whole path
    for (percent, part) in [("100", 1.0), ("50", 0.5), ("10", 0.1)] {
        let options = ["--feed-override", percent];
        let ran = simulate_on(&machine(""), &program("G01X50.0F600.0"), &options).completed();
        let took_s = ran.cycle_time_s();
        assert!((5.0..5.02).contains(&(took_s * part)), "{percent} %: {took_s} s");
    }
}

/// 1-4: a speed of 8,000 r/min at an override of 50% yields 4,000 r/min; operation beyond the minimum or maximum speed is not
/// possible.
#[test]
fn dgshape_1_4_the_override_of_the_spindle_keeps_within_its_speeds() {
    let (before, tools) = MACHINE.split_at(MACHINE.find("[[tool]]").unwrap());
    let machine = Machine::with_config(&format!(
        "[machine]\nname = \"mill-1\"\n{before}[coordinate_system.dgshape]\nmin_spindle_speed = 400.0\n\
         max_spindle_speed = 9000.0\n{tools}"
    ));
    let bench = Bench::with_config(machine.config()).unwrap();
    let speeds = bench.play(async |scene, _| {
        let cs = scene.cs(1);
        cs.wait_for(|_| true).await.unwrap();
        let mut speeds = Vec::new();
        for (r_min, percent) in [(8000.0, 50.0), (500.0, 50.0), (8000.0, 120.0), (500.0, 100.0)] {
            cs.set_spindle(SpindleDirection::Cw, r_min).await.unwrap();
            let change = OverrideChange {
                feed: None,
                rapid: None,
                spindle: Some(percent),
            };
            cs.set_overrides(change).await.unwrap();
            scene.plc().sleep(Duration::from_secs(3)).await;
            speeds.push(cs.spindle().await.unwrap().actual_rpm.round());
        }
        speeds
    });
    assert_eq!(speeds.unwrap(), [4000.0, 400.0, 9000.0, 500.0]);
}

#[test]
fn dgshape_2_7_outputs_act_with_the_motion_unless_configured() {
    let blocks = program("G00X10.\nM06T2X20.\nX30.");
    let timing = |more: &str| {
        let ran = simulate_on(&machine(more), &blocks, &[]).completed();
        let output = ran.events("output")[0].clone();
        assert_eq!(
            (output["m"].as_u64(), output["params"]["A"].as_f64()),
            (Some(6), Some(2.0))
        );
        // it is issued when the motion has reached its block
        assert_eq!(ran.at_outputs(0), [10.0]);
        (output["timing"].as_str().unwrap().to_owned(), ran.cycle_time_s())
    };
    let settings = "[m_code.6]\nstock = \"select_tool\"\nsimulated_ms = 1000\n";
    let (with_motion, sooner_s) = timing(settings);
    let (after_motion, later_s) = timing(&format!("{settings}timing = \"after_motion\"\n"));
    assert_eq!(
        (with_motion.as_str(), after_motion.as_str()),
        ("with_motion", "after_motion")
    );
    // the end of the program waits for the reset in both cases; with after_motion the following motion waits,
    // too
    assert!(later_s - sooner_s > 0.3, "{sooner_s} {later_s}");
}

#[test]
fn dgshape_m_codes_with_settings_are_outputs() {
    let blocks = program("M08\nG00X1.");
    let refused = simulate_on(&machine(""), &blocks, &[]);
    assert_eq!(
        refused.json["diagnostics"][0]["code"], "E0104",
        "{}",
        refused.json
    );
    let more = "[m_code.8]\nunhandled = \"auto_reset\"\n";
    let ran = simulate_on(&machine(more), &blocks, &[]).completed();
    assert_eq!(ran.events("output").len(), 1);
}

#[test]
fn dgshape_in_tool_diameter_offset_each_block_is_told_where_it_begins() {
    // after the arc a line continues to the beginning of the next block
    let blocks = program(
        "G10P1R3.\nG91G41D01G00X8.Y8.\nG01Z-7.F600.\nY35.\nX45.\nG03X15.Y-15.I15.\nG01Y-20.\nX-60.\nG40G00X-8.Y-8.",
    );
    let first = blocks
        .lines()
        .position(|line| line.starts_with("G91G41"))
        .unwrap()
        + 1;
    let ran = simulate_on(&machine(""), &blocks, &[]).completed();
    let told = ran
        .events("block")
        .into_iter()
        .map(|event| event["line"].as_u64());
    let told: Option<Vec<u64>> = told.collect();
    let first = u64::try_from(first).unwrap();
    assert_eq!(told.unwrap(), (first..first + 8).collect::<Vec<u64>>());
}

#[test]
fn dgshape_motion_keeps_to_the_path_through_corners() {
    // the two lines meet at a right angle
    let ran = simulate_on(&machine(""), &program("F3000.\nG01X20.\nY20."), &[]).completed();
    for row in &ran.trace {
        let [x, y] = [row.axes[0], row.axes[1]];
        assert!(y.abs() < 0.01 || (x - 20.0).abs() < 0.01, "{x} {y}");
    }
}

#[test]
fn dgshape_motion_keeps_to_a_circle_and_does_not_stop_on_it() {
    // a quarter of a circle about (0, 10) between its tangents, and a polygon of 1 degree a side: both at F3000
    let sides = (1..=90).map(|degrees| {
        let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
        format!("X{:.4}Y{:.4}\n", 10.0 * sin, 10.0 - 10.0 * cos)
    });
    let polygon = sides.collect::<Vec<_>>().concat();
    for way in ["G03X10.Y10.J10.\nG01", polygon.as_str()] {
        let blocks = program(&format!("F3000.\nG00X-10.\nG01X0\n{way}Y20."));
        let ran = simulate_on(&machine(""), &blocks, &[]).completed();
        for row in &ran.trace {
            let [x, y] = [row.axes[0], row.axes[1]];
            let off = if x <= 0.0 {
                y.abs()
            } else if y <= 10.0 {
                (x.hypot(y - 10.0) - 10.0).abs()
            } else {
                (x - 10.0).abs()
            };
            assert!(off < 0.01, "{off} off at {x} {y}");
        }
        // 35.7 mm at 50 mm/s, where the circle allows sqrt(1000 * 10) mm/s, and a ramp of 50 ms at both ends
        assert!(ran.cycle_time_s() < 1.2, "{}", ran.cycle_time_s());
    }
}
