//! Tapping cycles as the path stage receives them: one test for each rule.

#![allow(
    clippy::panic,
    clippy::float_cmp,
    reason = "helpers of tests; values come through unchanged"
)]

mod support;

use support::Run;
use tandem_model::axis::Axis;
use tandem_model::flow::{Action, Block, Distance, Frame, Item};

/// Creates a run that begins at machine Z20, with or without a spindle.
fn tapping(source: &str, spindle: bool) -> Vec<String> {
    let mut settings = support::settings();
    if !spindle {
        settings.spindle = None;
    }
    let mut run = Run::with_settings(source, &settings);
    run.work_offsets.0[0][Axis::Z] = 7.0;
    run.position[Axis::Z] = 20.0;
    let mut items = Vec::new();
    loop {
        let item = run.next().unwrap_or_else(|alarm| panic!("{alarm:?}"));
        let ended = matches!(item, Item::End(_));
        items.push(match &item {
            Item::Block(Block {
                action: Action::ThreadAhead(ahead),
                ..
            }) => format!(
                "ahead R{} Z{}",
                ahead.r_point.values[Axis::Z],
                ahead.tap.target.values[Axis::Z]
            ),
            Item::Block(Block {
                action: Action::Tap(tap),
                ..
            }) => {
                let speed = tap
                    .spindle_speed_r_min
                    .map_or(String::new(), |speed| format!(" S{speed}"));
                assert_eq!(
                    (tap.target.frame, tap.target.distance),
                    (Frame::Work, Distance::Absolute)
                );
                format!(
                    "{:?} Z{} {:?}{speed}",
                    tap.leg,
                    tap.target.values[Axis::Z],
                    tap.turn
                )
            }
            other => support::text(other),
        });
        if ended {
            return items;
        }
    }
}

#[test]
fn d42_each_hole_of_a_cycle_expands_on_its_own() {
    assert_eq!(
        tapping(
            "F100 S300 G99 G84 X10 Y0 Z-10 R-5 P1000\nG98 X30\nG80\nX40\nM30",
            true
        ),
        [
            "ahead R-5 Z-10",
            "1:1 M19",
            "1:1 rapid X10 Y0",
            "1:1 rapid Z-5",
            "In Z-10 Clockwise S300",
            "1:1 dwell 1",
            "Out Z-5 CounterClockwise S300",
            "1:1 M5",
            "ahead R-5 Z-10",
            "1:2 M19",
            "1:2 rapid X30",
            "1:2 rapid Z-5",
            "In Z-10 Clockwise S300",
            "1:2 dwell 1",
            "Out Z-5 CounterClockwise S300",
            "1:2 rapid Z20",
            "1:2 M5",
            "1:3 none",
            "1:4 linear X40",
            "1:5 end"
        ]
    );
}

#[test]
fn d42_repetitions_stand_between_orientation_and_stop() {
    // from Z20: R at 15, Z at 5
    let hole = [
        "1:1 rapid X10",
        "1:1 rapid Z15",
        "In Z5 CounterClockwise S300",
        "1:1 dwell 0",
        "Out Z15 Clockwise S300",
    ];
    let cycle = |level: &str| tapping(&format!("G91 S300 {level} G74 X10 Z-10 R-5 K2\nG80 M30"), true);
    let mut expected = vec!["ahead R15 Z5", "1:1 M19"];
    for _ in 0..2 {
        expected.extend(hole);
        expected.push("1:1 rapid Z20");
    }
    expected.extend(["1:1 M5", "1:2 end"]);
    assert_eq!(cycle("G98"), expected);
    let mut expected = vec!["ahead R15 Z5", "1:1 M19"];
    expected.extend(hole);
    expected.extend([hole[0], hole[2], hole[3], hole[4], "1:1 M5", "1:2 end"]);
    assert_eq!(cycle("G99"), expected);
    assert_eq!(tapping("S300 G84 X10 Z-10 R-5 K0\nG80 M30", true), ["1:2 end"]);
}

#[test]
fn d42_without_a_spindle_m_codes_turn_it() {
    let cycle = |level: &str| tapping(&format!("S300 {level} G84 X10 Z-10 R-5 P500\nG80 M30"), false);
    let mut expected = vec![
        "ahead R-5 Z-10",
        "1:1 rapid X10",
        "1:1 rapid Z-5",
        "1:1 M19",
        "1:1 M3",
        "In Z-10 Clockwise",
        "1:1 dwell 0.5",
        "1:1 M4",
        "Out Z-5 CounterClockwise",
        "1:1 M3",
    ];
    assert_eq!(cycle("G99")[..10], expected);
    expected.extend(["1:1 linear Z20", "1:2 end"]);
    assert_eq!(cycle("G98"), expected);
}

#[test]
fn d42_the_initial_level_is_z_in_work_coordinates_where_the_cycle_began() {
    // machine Z20 is Z13 with the offset of G54
    let items = tapping("G54 G99 G84 S300 X10 Z-10 R-5\nG98 X20\nG80 M30", true);
    assert_eq!(items[items.len() - 3], "1:2 rapid Z13");
    // the manual's incremental example: all holes have the same levels, whatever the level that each starts from
    let mut settings = support::settings();
    settings.spindle = None;
    let mut run = Run::with_settings(
        "G91 G99 G84 X10 Z-10 R-5\nG99 X10\nG98 X10\nG80\nG98 G84 R-1 Z-2\nG80 M30",
        &settings,
    );
    let mut levels = Vec::new();
    loop {
        match run.next().unwrap() {
            Item::Block(Block {
                action: Action::Tap(tap),
                ..
            }) => {
                run.position[Axis::Z] = tap.target.values[Axis::Z];
                levels.push(run.position[Axis::Z]);
            }
            Item::Block(Block {
                action: Action::Linear(words),
                ..
            }) => run.position[Axis::Z] = words.values[Axis::Z],
            // the next cycle begins at another level
            Item::Block(Block {
                action: Action::None, ..
            }) => run.position[Axis::Z] = 3.0,
            Item::End(_) => break,
            _ => {}
        }
    }
    assert_eq!(levels, [-15.0, -5.0, -15.0, -5.0, -15.0, -5.0, 0.0, 2.0]);
}

#[test]
fn a_motion_ends_a_fixed_cycle() {
    assert_eq!(
        tapping("S300 G84 X10 Z-10 R-5\nG01 X5\nX6\nM30", true)[9..],
        ["1:2 linear X5", "1:3 linear X6", "1:4 end"]
    );
}
