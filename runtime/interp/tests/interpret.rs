//! What the interpreter gives: one test a rule.

#![allow(clippy::panic, reason = "helpers of tests")]

use std::collections::BTreeMap;
use std::sync::Arc;

use tandem_interp::{Inputs, Interpreter};
use tandem_model::axis::{Axis, AxisSet, AxisVector};
use tandem_model::flow::{Action, Distance, Item, PathControl};
use tandem_model::settings::{CoordinateSystemSettings, MotorKind, MotorSettings, WorkOffsets};
use tandem_model::{Alarm, Origin};
use tandem_syntax::{Grammar, NcProgram, parse};

fn motor(number: u16, kind: MotorKind, max_velocity: f64) -> MotorSettings {
    MotorSettings {
        number,
        kind,
        max_velocity,
        max_acceleration: 1000.0,
        max_jerk: None,
        rapid_velocity: max_velocity,
        rapid_acceleration: 1000.0,
        skip_velocity: 10.0,
        in_position: 0.01,
        in_position_timeout_ms: 2000.0,
        soft_limits: None,
        reference_points: [0.0; 4],
        lag_ms: 0.0,
        orientation_velocity: 100.0,
        orientation_position: 0.0,
    }
}

/// Axes X, Y, Z, A, and a spindle of 8000 r/min; F at most 6000 mm/min and 500 at start-up.
fn settings() -> CoordinateSystemSettings {
    let mut motors = [const { None }; 8];
    for (index, kind) in [
        MotorKind::Linear,
        MotorKind::Linear,
        MotorKind::Linear,
        MotorKind::Rotary,
    ]
    .into_iter()
    .enumerate()
    {
        motors[index] = Some(motor(u16::try_from(index).unwrap_or_default() + 1, kind, 100.0));
    }
    CoordinateSystemSettings {
        number: 1,
        motors,
        spindle: Some(motor(5, MotorKind::Spindle, 8000.0)),
        max_feedrate_mm_min: 6000.0,
        default_feedrate_mm_min: 500.0,
        default_ta_ms: 100.0,
        default_td_ms: 90.0,
        default_ts_ms: 50.0,
        rotary_feedrate_deg_min: 0.0,
        override_slew_ms: 1000.0,
        hold_slew_ms: 200.0,
        servo_period_s: 0.001,
        motion: tandem_model::settings::MotionOptions::default(),
    }
}

fn program(source: &str) -> Arc<NcProgram> {
    Arc::new(parse(source, Grammar::nj()).0)
}

/// A main program 1 with subprograms and inputs.
struct Run {
    interpreter: Interpreter,
    programs: BTreeMap<u16, Arc<NcProgram>>,
    optional_skip: u32,
    work_offsets: WorkOffsets,
}

impl Run {
    fn new(source: &str) -> Self {
        let mut interpreter = Interpreter::new(&settings());
        interpreter.start(program(source), 1);
        Self {
            interpreter,
            programs: BTreeMap::new(),
            optional_skip: 0,
            work_offsets: WorkOffsets::default(),
        }
    }

    fn with(mut self, number: u16, source: &str) -> Self {
        self.programs.insert(number, program(source));
        self
    }

    fn next(&mut self) -> Result<Item, Alarm> {
        self.interpreter.next(&Inputs {
            programs: &self.programs,
            optional_skip: self.optional_skip,
            work_offsets: &self.work_offsets,
        })
    }

    /// All items up to the end or an alarm, as text.
    fn items(mut self) -> Vec<String> {
        let mut items = Vec::new();
        loop {
            match self.next() {
                Ok(item) => {
                    let ended = matches!(item, Item::End(_));
                    items.push(text(&item));
                    if ended {
                        return items;
                    }
                }
                Err(alarm) => {
                    let origin = alarm.origin.unwrap_or_default();
                    items.push(format!(
                        "{}:{} alarm {}",
                        origin.program, origin.line, alarm.entry.number
                    ));
                    return items;
                }
            }
        }
    }
}

/// `program:line what`.
fn text(item: &Item) -> String {
    let place = |origin: &Origin| format!("{}:{}", origin.program, origin.line);
    match item {
        Item::Block(block) => {
            let what = match &block.action {
                Action::None => "none".to_owned(),
                Action::Rapid(words) => format!("rapid {}", axes(words.values, words.named)),
                Action::Linear(words) => format!("linear {}", axes(words.values, words.named)),
                Action::Dwell { dwell_s } => format!("dwell {dwell_s}"),
                Action::Transform(transform) => format!("transform X{}", transform.work_offset[Axis::X]),
            };
            format!("{} {what}", place(&block.origin))
        }
        Item::Output(output) => {
            let params: Vec<String> = ('A'..='H')
                .zip(output.params)
                .filter_map(|(letter, value)| value.map(|value| format!(" {letter}{value}")))
                .collect();
            format!("{} M{}{}", place(&output.origin), output.m, params.concat())
        }
        Item::Stop(stop) => format!(
            "{} stop{}",
            place(&stop.origin),
            if stop.optional { " optional" } else { "" }
        ),
        Item::NeedsStandstill(origin) => format!("{} standstill", place(origin)),
        Item::Warning(origin, text) => format!("{} warning {text}", place(origin)),
        Item::End(origin) => format!("{} end", place(origin)),
    }
}

fn axes(values: AxisVector, named: AxisSet) -> String {
    named
        .iter()
        .map(|axis| format!("{}{}", axis.letter(), values[axis]))
        .collect::<Vec<_>>()
        .join(" ")
}

fn check(source: &str, expect: &[&str]) {
    assert_eq!(Run::new(source).items(), expect, "{source:?}");
}

/// The first block of a program, as the path stage gets it.
fn first_block(source: &str) -> tandem_model::flow::Block {
    match Run::new(source).next() {
        Ok(Item::Block(block)) => block,
        other => panic!("{source:?} gives {other:?}"),
    }
}

/// The last motion block of a program.
fn last_motion(source: &str) -> tandem_model::flow::Block {
    let mut run = Run::new(source);
    let mut last = None;
    loop {
        match run.next() {
            Ok(Item::Block(block)) => last = Some(block),
            Ok(Item::End(_)) => return last.unwrap_or_else(|| panic!("no block")),
            Ok(_) => {}
            Err(alarm) => panic!("{alarm:?}"),
        }
    }
}

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
    assert_eq!(run.interpreter.modal(), Interpreter::new(&settings()).modal());
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
    let mut run = Run::new("F9000 X1\nM30");
    let _warning = run.next();
    assert!(
        matches!(run.next(), Ok(Item::Block(block)) if block.feed.feedrate_mm_min.to_bits() == 6000_f64.to_bits())
    );
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
    // a transform of the same block is no motion
    assert_eq!(stops("G54 G09 X10\nM30"), (false, false));
    let block = last_motion("G54 G09 X10\nM30");
    assert_eq!((block.exact_stop_before, block.exact_stop_after), (true, false));
    // it is not modal
    let block = last_motion("X10 G09\nX20\nM30");
    assert_eq!((block.exact_stop_before, block.exact_stop_after), (false, false));
}

#[test]
fn d16_d20_work_offsets_are_read_at_their_block_and_come_before_its_motion() {
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
    let mut idle = Interpreter::new(&settings());
    let inputs = Inputs {
        programs: &BTreeMap::new(),
        optional_skip: 0,
        work_offsets: &WorkOffsets::default(),
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
            "1000:1 linear X1",
            "1000:1 linear X1",
            "1000:1 linear X1",
            "1:4 linear X9",
            "1:5 end"
        ]
    );
}

#[test]
fn d12_motion_of_the_calling_block_comes_first() {
    let run = Run::new("X5 M98 P1000\nM30").with(1000, "X1\nM99");
    assert_eq!(run.items(), ["1:1 linear X5", "1000:1 linear X1", "1:2 end"]);
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
    assert!(
        items
            .contains(&"1008:2 warning the call of program 1009 is deeper than 8 and is not made".to_owned())
    );
    assert_eq!(items.last().map(String::as_str), Some("1:2 end"));
}

#[test]
fn m30_in_a_subprogram_ends_the_run() {
    let run = Run::new("M98 P1000\nX2\nM30").with(1000, "X1\nM30");
    assert_eq!(run.items(), ["1000:1 linear X1", "1000:2 end"]);
}

#[test]
fn the_call_stack_names_program_and_calling_line() {
    let mut run = Run::new("X1\n  M98 P1000\nM30").with(1000, "\n\nX2\nM99");
    for _ in 0..2 {
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
    assert_eq!(run.items(), ["1000:1 linear X1", "1000:1 alarm 22"]);
}

#[test]
fn a_program_with_errors_is_an_alarm_at_the_block_of_the_error() {
    for source in [
        "X1 R5",
        "X",
        "G02 X1 I1",
        "L1=5",
        "X[L1]",
        "if(L1==1){X1}",
        "X1 X1",
        "G05",
        "M98",
    ] {
        check(&format!("X9\n{source}\nM30"), &["1:1 linear X9", "1:2 alarm 23"]);
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

#[test]
fn a_program_that_makes_no_progress_is_an_alarm() {
    let run = Run::new("M98 P1000 L10000\nM30")
        .with(1000, "M98 P1001 L10000\nM99")
        .with(1001, "/1 X1\nM99");
    let mut run = run;
    run.optional_skip = 1;
    assert_eq!(run.next().err().map(|alarm| alarm.entry.number), Some(21));
    // a million blocks may be passed over, one more not
    for (skipped, ends) in [(1_000_000 - 1, true), (1_000_000, false)] {
        let mut run = Run::new(&("/1 X1\n".repeat(skipped) + "M30"));
        run.optional_skip = 1;
        assert_eq!(run.next().is_ok(), ends);
    }
}
