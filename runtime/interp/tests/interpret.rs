//! Items of the interpreter: one test for each rule.

#![allow(clippy::panic, reason = "helpers of tests")]

mod support;

use std::collections::BTreeMap;

use tandem_interp::dialects::nj;
use tandem_interp::{Inputs, Interpreter, NO_TOOLS};
use tandem_model::axis::{Axis, AxisVector};
use tandem_model::flow::{Action, Distance, Item, PathControl};
use tandem_model::settings::{CoordinateSystemSettings, Tool, WorkOffsets};
use tandem_model::{Alarm, Variables};

use support::{Run, check, first_block, last_motion, program, settings, text};

#[test]
fn motion_starts_as_g01_and_stays_in_force() {
    check(
        "X1 Y2\nG00 Z5\nX3\nG01 A4\nM30",
        &[
            "1:1 linear X1 Y2",
            "1:2 rapid Z5",
            "1:3 rapid X3",
            "1:4 linear A4",
            "1:5 end",
        ],
    );
}

#[test]
fn words_may_stand_in_any_order() {
    check(
        "Y2 G00 X1\nF100 X3 G01\nM30",
        &["1:1 rapid X1 Y2", "1:2 linear X3", "1:3 end"],
    );
}

#[test]
fn start_up_modal_state_is_that_of_the_manual() {
    let run = Run::new("M30");
    let groups: Vec<_> = run.interpreter.modal().groups().collect();
    assert_eq!(
        groups,
        [
            ("01", "G01"),
            ("02", "G17"),
            ("03", "G90"),
            ("06", "G21"),
            ("07", "G40"),
            ("08", "G49"),
            ("09", "G80"),
            ("10", "G98"),
            ("11", "G50"),
            ("15", "G64"),
            ("16", "G69"),
            ("22", "G50.1"),
            ("23", "G501"),
        ]
    );
    assert_eq!(run.interpreter.modal().work_offset(), None);
}

#[test]
fn modal_state_follows_the_program_and_a_start_brings_it_back() {
    let mut run = Run::new("G00 G91 G61 G56 F250 S1200 ta1 td2 ts3 X1\nM30");
    assert!(run.next().is_ok());
    let modal = run.interpreter.modal();
    let groups: BTreeMap<_, _> = modal.groups().collect();
    assert_eq!(
        (groups["01"], groups["03"], groups["14"], groups["15"]),
        ("G00", "G91", "G56", "G61")
    );
    assert_eq!(modal.work_offset(), Some("G56"));
    let values = [
        modal.feedrate_mm_min,
        modal.spindle_speed_r_min,
        modal.ta_ms,
        modal.td_ms,
        modal.ts_ms,
    ];
    assert_eq!(
        values.map(f64::to_bits),
        [250.0, 1200.0, 1.0, 2.0, 3.0].map(f64::to_bits)
    );
    run.interpreter.start(program("M30"), 1);
    assert_eq!(
        run.interpreter.modal(),
        Interpreter::new(&settings(), nj()).modal()
    );
}

#[test]
fn g90_and_g91_tell_how_axis_words_count() {
    let distance = |source: &str| match last_motion(source).action {
        Action::Linear(words) => words.distance,
        other => panic!("{other:?}"),
    };
    assert_eq!(distance("X1\nM30"), Distance::Absolute);
    assert_eq!(distance("G91\nX1\nM30"), Distance::Incremental);
    assert_eq!(distance("G91 X1\nG90 X1\nM30"), Distance::Absolute);
}

#[test]
fn g61_and_g64_stand_in_the_block() {
    assert_eq!(last_motion("X1\nM30").path_control, PathControl::ContinuousPath);
    assert_eq!(last_motion("G61\nX1\nM30").path_control, PathControl::ExactStop);
    assert_eq!(
        last_motion("G61 X1\nG64 X2\nM30").path_control,
        PathControl::ContinuousPath
    );
}

#[test]
fn feed_words_are_modal_and_start_from_the_settings() {
    let feed = |source: &str| {
        let feed = last_motion(source).feed;
        [feed.feedrate_mm_min, feed.ta_ms, feed.td_ms, feed.ts_ms].map(f64::to_bits)
    };
    assert_eq!(feed("X1\nM30"), [500.0, 100.0, 90.0, 50.0].map(f64::to_bits));
    assert_eq!(
        feed("F60 ta1 td2 ts3\nX1\nM30"),
        [60.0, 1.0, 2.0, 3.0].map(f64::to_bits)
    );
}

#[test]
fn d11_a_feedrate_above_the_maximum_is_clipped_with_a_warning() {
    check(
        "F9000 X1\nM30",
        &[
            "1:1 warning F9000 is above the maximum feedrate: 6000 mm/min is used",
            "1:1 linear X1",
            "1:2 end",
        ],
    );
    // the path stage clips F; the interpreter keeps it, because a thread has the pitch of F as written
    let block = last_motion("F9000 X1\nM30");
    let written = [block.feed.feedrate_mm_min, block.feedrate_deg_min].map(f64::to_bits);
    assert_eq!(written, [9000_f64.to_bits(); 2]);
}

#[test]
fn d11_a_spindle_speed_above_the_maximum_is_an_alarm() {
    check("S8000\nS8001\nM30", &["1:1 none", "1:2 alarm 11"]);
}

#[test]
fn d11_values_out_of_range_are_alarms() {
    check("X2000000\nM30", &["1:1 alarm 11"]);
    check("F0\nM30", &["1:1 alarm 11"]);
}

#[test]
fn d19_a_dwell_reads_its_words_as_times_and_moves_nothing() {
    check(
        "G04 P500\nG04 X1.5\nG04 F2\nG04\nX1\nM30",
        &[
            "1:1 dwell 0.5",
            "1:2 dwell 1.5",
            "1:3 dwell 2",
            "1:4 dwell 0",
            "1:5 linear X1",
            "1:6 end",
        ],
    );
    assert_eq!(
        last_motion("F60 X1\nG04 F2\nX2\nM30")
            .feed
            .feedrate_mm_min
            .to_bits(),
        60_f64.to_bits()
    );
}

#[test]
fn d27_g09_acts_at_its_place_among_the_axis_words() {
    let stops = |source: &str| {
        let block = first_block(source);
        (block.exact_stop_before, block.exact_stop_after)
    };
    assert_eq!(stops("X10\nM30"), (false, false));
    assert_eq!(stops("G09 X10\nM30"), (true, false));
    assert_eq!(stops("G01 F5 G09 X10\nM30"), (true, false));
    assert_eq!(stops("X10 G09\nM30"), (false, true));
    assert_eq!(stops("X10 G09 Y5\nM30"), (false, true));
    // a transform in the block is not a motion
    assert_eq!(stops("G54 G09 X10\nM30"), (false, false));
    let block = last_motion("G54 G09 X10\nM30");
    assert_eq!((block.exact_stop_before, block.exact_stop_after), (true, false));
    // without axis words, G09 stops before its block, whatever else the block does
    for source in [
        "G09\nM30",
        "G09 G17\nM30",
        "F600 G09\nM30",
        "G09 G54\nM30",
        "G69 G09\nM30",
    ] {
        assert_eq!(stops(source), (true, false), "{source}");
    }
    // G09 is not modal
    let block = last_motion("X10 G09\nX20\nM30");
    assert_eq!((block.exact_stop_before, block.exact_stop_after), (false, false));
}

#[test]
fn d16_d20_work_offsets_are_read_at_their_block_and_precede_its_motion() {
    let mut run = Run::new("G54\nG59 X1\nG54\nM30");
    run.work_offsets.0[0][Axis::X] = 10.0;
    run.work_offsets.0[5][Axis::X] = 60.0;
    assert_eq!(
        run.next().map(|item| text(&item)),
        Ok("1:1 transform X10".to_owned())
    );
    assert_eq!(
        run.next().map(|item| text(&item)),
        Ok("1:2 transform X60".to_owned())
    );
    assert_eq!(run.next().map(|item| text(&item)), Ok("1:2 linear X1".to_owned()));
    run.work_offsets.0[0][Axis::X] = 11.0;
    assert_eq!(
        run.next().map(|item| text(&item)),
        Ok("1:3 transform X11".to_owned())
    );
}

#[test]
fn blocks_without_motion_are_given_and_empty_lines_are_not() {
    check(
        "\nG17\n// comment\nN10\nF100\n;",
        &["1:2 none", "1:5 none", "1:6 alarm 23"],
    );
    check(
        "G91\nM03 S100\nM30",
        &["1:1 none", "1:2 none", "1:2 M3", "1:3 end"],
    );
}

#[test]
fn an_output_follows_the_motion_of_its_block_with_its_parameters() {
    check(
        "G54 X1 M100 VA1 VH-2.5\nM05\nM30",
        &[
            "1:1 transform X0",
            "1:1 linear X1",
            "1:1 M100 A1 H-2.5",
            "1:2 none",
            "1:2 M5",
            "1:3 end",
        ],
    );
}

#[test]
fn m00_and_m01_are_stops_after_the_motion_of_their_block() {
    check(
        "X1 M00\nM01\nM30",
        &["1:1 linear X1", "1:1 stop", "1:2 stop optional", "1:3 end"],
    );
}

#[test]
fn m02_and_m30_end_and_the_end_repeats() {
    for end in ["M02", "M30", "M99"] {
        let mut run = Run::new(&format!("X1 {end}\nX2"));
        assert_eq!(run.next().map(|item| text(&item)), Ok("1:1 linear X1".to_owned()));
        for _ in 0..3 {
            assert_eq!(
                run.next()
                    .map(|item| text(&item))
                    .ok()
                    .filter(|item| item == "1:1 end"),
                Some("1:1 end".to_owned())
            );
        }
    }
    let mut idle = Interpreter::new(&settings(), nj());
    let inputs = Inputs {
        tools: &NO_TOOLS,
        programs: &BTreeMap::new(),
        optional_skip: 0,
        work_offsets: &WorkOffsets::default(),
        variables: &Variables::default(),
        tool: Some(Tool::default()),
        captured: Some([0.0; 8]),
        position: Some(AxisVector::ZERO),
    };
    assert!(matches!(idle.next(&inputs), Ok(Item::End(_))));
}

#[test]
fn d13_block_skip_is_read_when_the_block_is_interpreted() {
    let mut run = Run::new("/1 X1\n/2/31 X2\nX3\n/31 X4\n/1 X5\nM30");
    run.optional_skip = 1 | 1 << 30;
    assert_eq!(run.next().map(|item| text(&item)), Ok("1:3 linear X3".to_owned()));
    run.optional_skip = 1;
    assert_eq!(run.next().map(|item| text(&item)), Ok("1:4 linear X4".to_owned()));
    assert_eq!(run.next().map(|item| text(&item)), Ok("1:6 end".to_owned()));
}

#[test]
fn d12_m98_calls_a_subprogram_l_times_and_m99_returns() {
    let run = Run::new("M98 P1000\nM98 P1000 L2\nM98 P1000 L0\nX9\nM30").with(1000, "X1\nM99\nX2");
    assert_eq!(
        run.items(),
        [
            "1:1 none",
            "1000:1 linear X1",
            "1000:2 none",
            "1:2 none",
            "1000:1 linear X1",
            "1000:2 none",
            "1000:1 linear X1",
            "1000:2 none",
            "1:3 none",
            "1:4 linear X9",
            "1:5 end"
        ]
    );
}

#[test]
fn d12_motion_of_the_calling_block_comes_first() {
    let run = Run::new("X5 M98 P1000\nM30").with(1000, "X1\nM99");
    assert_eq!(
        run.items(),
        ["1:1 linear X5", "1000:1 linear X1", "1000:2 none", "1:2 end"]
    );
}

#[test]
fn d12_a_missing_program_is_an_alarm_and_nothing_of_its_block_is_given() {
    check("X1\nX2 M98 P1000\nM30", &["1:1 linear X1", "1:2 alarm 20"]);
}

#[test]
fn d12_a_call_deeper_than_8_is_not_made() {
    let mut run = Run::new("M98 P1001\nM30");
    for depth in 1..=9_u16 {
        run = run.with(1000 + depth, &format!("X{depth}\nM98 P{}\nM99", 1001 + depth));
    }
    let items = run.items();
    let motions: Vec<&String> = items.iter().filter(|item| item.contains("linear")).collect();
    assert_eq!(motions.len(), 8);
    assert_eq!(motions[7], "1008:1 linear X8");
    assert!(items.contains(
        &"1008:2 warning the call of program 1009 is nested deeper than 8 and is skipped".to_owned()
    ));
    assert_eq!(items.last().map(String::as_str), Some("1:2 end"));
}

#[test]
fn m30_in_a_subprogram_ends_the_run() {
    let run = Run::new("M98 P1000\nX2\nM30").with(1000, "X1\nM30");
    assert_eq!(run.items(), ["1:1 none", "1000:1 linear X1", "1000:2 end"]);
}

#[test]
fn the_call_stack_names_program_and_calling_line() {
    let mut run = Run::new("X1\n  M98 P1000\nM30").with(1000, "\n\nX2\nM99");
    for _ in 0..3 {
        assert!(run.next().is_ok());
    }
    let stack: Vec<_> = run
        .interpreter
        .call_stack()
        .map(|at| (at.program, at.line, at.column))
        .collect();
    assert_eq!(stack, [(1, 2, 3), (1000, 3, 1)]);
}

#[test]
fn a_program_without_an_end_is_an_alarm() {
    check("X1", &["1:1 linear X1", "1:1 alarm 22"]);
    let run = Run::new("M98 P1000\nM30").with(1000, "X1");
    assert_eq!(run.items(), ["1:1 none", "1000:1 linear X1", "1000:1 alarm 22"]);
}

#[test]
fn a_program_with_errors_is_an_alarm_at_the_block_of_the_error() {
    for source in ["X1 R5", "X", "L1=", "X[L1", "if(L1){X1}", "X1 X1", "G05", "M98"] {
        check(&format!("X9\n{source}\nM30"), &["1:1 linear X9", "1:2 alarm 23"]);
    }
}

#[test]
fn d07_d11_an_alarm_about_a_value_names_the_column_of_its_word() {
    let places = [
        ("L1=0/0\nX20 ta[L1]\nM30", (2, 5)),
        ("L1=0/0\n  G02 X20 Y5 I[L1]\nM30", (2, 14)),
        ("L1=1/0\nX[L1] Y5\nM30", (2, 1)),
        ("L1=0-5\nX20 Y3 ts[L1]\nM30", (2, 8)),
    ];
    for (source, place) in places {
        let mut run = Run::new(source);
        let alarm = run.next().expect_err("an alarm");
        let at = alarm.origin.map(|origin| (origin.line, origin.column));
        assert_eq!(at, Some(place), "{source}");
    }
}

#[test]
fn an_alarm_repeats_until_the_next_start() {
    let mut run = Run::new("X");
    let first = run.next();
    assert!(first.is_err());
    assert_eq!(run.next(), first);
    run.interpreter.start(program("X1\nM30"), 1);
    assert!(run.next().is_ok());
}

/// Returns the first item that is not a block without movement, and the number of such blocks before it.
fn after_no_movement(run: &mut Run) -> (usize, Result<Item, Alarm>) {
    let mut passed = 0;
    loop {
        match run.next() {
            Ok(Item::Block(block)) if block.action == Action::None => passed += 1,
            other => return (passed, other),
        }
    }
}

#[test]
fn a_program_that_makes_no_progress_is_an_alarm() {
    let mut run = Run::new("M98 P1000 L10000\nM30")
        .with(1000, "M98 P1001 L10000\nM99")
        .with(1001, "/1 X1\nM99");
    run.optional_skip = 1;
    let number = |answer: Result<Item, Alarm>| answer.err().map(|alarm| alarm.entry.number);
    assert_eq!(number(after_no_movement(&mut run).1), Some(21));
    for endless in ["while(1==1) F100\nM30", "while(1==1) {\nG54\nG55\n}\nM30"] {
        let mut run = Run::new(endless);
        let alarm = (0..2_000_000).find_map(|_| run.next().err());
        assert_eq!(alarm.map(|alarm| alarm.entry.number), Some(21), "{endless:?}");
    }
    // a million blocks without an item are permitted, one more is an alarm
    for (skipped, ends) in [(1_000_000 - 1, true), (1_000_000, false)] {
        let mut run = Run::new(&("/1 X1\n".repeat(skipped) + "M30"));
        run.optional_skip = 1;
        assert_eq!(after_no_movement(&mut run).1.is_ok(), ends);
    }
}

#[test]
fn a_loop_that_reads_p_or_q_waits_and_is_no_alarm() {
    for variable in ["P7", "Q7"] {
        let mut run = Run::new(&format!("while({variable}==0) {{ }}\nX5\nM30"));
        for turn in 0..5000 {
            let item = run.next().expect("it waits");
            assert!(
                matches!(&item, Item::Block(block) if block.action == Action::None),
                "{turn}: {item:?}"
            );
        }
        run.variables.global.set(7, 1.0);
        run.variables.coordinate_system.set(7, 1.0);
        let (_, next) = after_no_movement(&mut run);
        assert!(matches!(next, Ok(Item::Block(_))), "{next:?}");
    }
}

#[test]
fn the_limit_of_blocks_without_motion_is_a_setting() {
    let settings = CoordinateSystemSettings {
        blocks_without_motion_max: 2000,
        ..settings()
    };
    for (turns, is_alarm) in [(600, false), (700, true)] {
        let text = format!("while(L1<{turns}) L1=L1+1\nX5\nM30");
        let mut run = Run::with_settings(&text, &settings);
        assert_eq!(after_no_movement(&mut run).1.is_err(), is_alarm, "{turns}");
    }
}

#[test]
fn alarm_23_has_code_and_help_of_its_diagnostic() {
    let alarm = Run::new("G01 X1 R5\nM30").next().unwrap_err();
    assert_eq!(alarm.entry.number, 23);
    for part in ["E0108: no code of the block takes R.", "Remove R, or write G02"] {
        assert!(alarm.text.contains(part), "{}", alarm.text);
    }
}

#[test]
fn g68_turns_by_up_to_360_degrees_with_a_warning_beyond_300() {
    for (angle, warns) in [
        ("R300", false),
        ("R-300", false),
        ("R300.5", true),
        ("R-360", true),
    ] {
        let mut run = Run::new(&format!("G68 X0 Y0 {angle}\nM30"));
        let first = run.next().expect("it turns");
        assert_eq!(matches!(first, Item::Warning(..)), warns, "{angle}: {first:?}");
    }
}

#[test]
fn m1c_each_10000_blocks_without_an_item_end_a_chain() {
    for (skipped, ended) in [(9_999, 0), (10_000, 1), (30_000, 3)] {
        let mut run = Run::new(&("X1\n".to_owned() + &"/1 X2\n".repeat(skipped) + "X3\nM30"));
        run.optional_skip = 1;
        assert!(run.next().is_ok());
        let (passed, next) = after_no_movement(&mut run);
        assert_eq!(passed, ended, "{skipped}");
        assert!(matches!(next, Ok(Item::Block(_))));
    }
}
