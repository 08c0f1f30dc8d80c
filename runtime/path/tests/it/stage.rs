//! Stops, soft limits, F, and rejected blocks.

use tandem_model::alarm::{AXIS_MISSING, FEEDRATE_MISSING, SOFT_LIMIT, VALUE_NOT_FINITE, VALUE_OUT_OF_RANGE};
use tandem_model::flow::{
    Action, Block, Distance, MultiBlock, Path, PathControl, ProgrammedFeed, Segment, SegmentEnd,
    SegmentMotion, TapLeg, Transform,
};
use tandem_model::{Axis, AxisVector, MachinePosition};
use tandem_path::{PathStage, work_position};

use crate::rig::{
    block, ends, g00, g01, length_and_feed, near, refused, run, settings, stage, target, words,
};

use Axis::{A, B, C, X, Y, Z};
use SegmentEnd::{Continuous, ExactStop};

#[test]
fn g90_counts_from_the_work_offset_and_g91_from_the_last_position() {
    let mut offset = AxisVector::ZERO;
    offset[X] = 10.0;
    offset[Y] = -5.0;
    let transform = Transform {
        work_offset: offset,
        ..Transform::default()
    };
    let segments = run(&[
        block(1, Action::Transform(Box::new(transform))),
        g01(2, &[(X, 20.0)]),
        block(
            3,
            Action::Linear(words(Distance::Incremental, &[(X, 1.5), (Y, 2.0)])),
        ),
        g00(4, &[(Y, 0.0)]),
    ]);
    assert_eq!(segments.len(), 3);
    near(target(&segments[0]), [30.0, 0.0, 0.0]);
    near(target(&segments[1]), [31.5, 2.0, 0.0]);
    near(target(&segments[2]), [31.5, -5.0, 0.0]);
}

#[test]
fn d20_enabling_a_transform_moves_nothing_and_work_position_inverts_it() {
    let mut stage = stage();
    let mut out = Vec::new();
    let mut offset = AxisVector::ZERO;
    offset[X] = 10.0;
    let transform = Transform {
        work_offset: offset,
        ..Transform::default()
    };
    stage
        .push(&block(1, Action::Transform(Box::new(transform))), &mut out)
        .unwrap();
    assert!(out.is_empty());
    assert_eq!(stage.transform(), &transform);
    assert!((work_position(&transform, stage.position()).0[X] + 10.0).abs() < 1e-12);
    stage.restart(MachinePosition::default());
    assert_eq!(stage.transform(), &Transform::default());
}

#[test]
fn s1a_f_counts_the_vector_length_of_x_y_z() {
    let segments = run(&[g01(1, &[(X, 3.0), (Y, 4.0), (Z, 12.0), (A, 720.0)])]);
    let (length, feed) = length_and_feed(&segments[0]);
    assert!((length - 13.0).abs() < 1e-12);
    assert!((feed - 600.0).abs() < 1e-12);
    match &segments[0].motion {
        SegmentMotion::Feed {
            path: path @ Path::Line { .. },
            ..
        } => {
            // A is as far along as X, Y and Z at every point of the line.
            let middle = path.point_at(6.5);
            assert!((middle[X] - 1.5).abs() < 1e-12 && (middle[A] - 360.0).abs() < 1e-12);
        }
        other => panic!("not a line: {other:?}"),
    }
}

#[test]
fn s1a_f_counts_the_vector_length_of_rotary_axes_when_only_they_move() {
    let block = g01(1, &[(A, 30.0), (C, 40.0)]);
    let (length, feed) = length_and_feed(&run(std::slice::from_ref(&block))[0]);
    assert!((length - 50.0).abs() < 1e-12);
    assert!((feed - 600.0).abs() < 1e-12);

    let mut settings = settings();
    settings.rotary_feedrate_deg_min = 3600.0;
    let mut stage = PathStage::new(&settings, MachinePosition::default());
    let mut out = Vec::new();
    stage.push(&block, &mut out).unwrap();
    stage.push(&g01(2, &[(X, 1.0), (A, 0.0)]), &mut out).unwrap();
    stage.flush(&mut out);
    assert!((length_and_feed(&out[0]).1 - 3600.0).abs() < 1e-12);
    assert!(
        (length_and_feed(&out[1]).1 - 600.0).abs() < 1e-12,
        "X moves too: F"
    );
}

#[test]
fn d25_what_a_block_moves_says_which_f_counts() {
    let in_inches = |mut block: Block| {
        (block.feed.feedrate_mm_min, block.feedrate_deg_min) = (254.0, 10.0);
        block
    };
    let mut stage = stage();
    let mut out = Vec::new();
    let longer = Transform {
        tool_length: 8.0,
        ..Transform::default()
    };
    stage.push(&in_inches(g01(1, &[(A, 30.0)])), &mut out).unwrap();
    stage
        .push(&in_inches(g01(2, &[(X, 0.0), (A, 60.0)])), &mut out)
        .unwrap();
    stage
        .push(&in_inches(g01(3, &[(X, 1.0), (A, 90.0)])), &mut out)
        .unwrap();
    // The next motion of Z applies the tool length (D22).
    stage.push(&crate::rig::transform(4, longer), &mut out).unwrap();
    stage.push(&in_inches(g01(5, &[(A, 0.0)])), &mut out).unwrap();
    stage.flush(&mut out);
    let expected = [(30.0, 10.0), (30.0, 10.0), (1.0, 254.0), (8.0, 254.0)];
    assert_eq!(out.len(), expected.len());
    for (segment, (length, feedrate)) in out.iter().zip(expected) {
        let (way, feed) = length_and_feed(segment);
        assert!((way - length).abs() < 1e-12 && (feed - feedrate).abs() < 1e-12);
    }
}

#[test]
fn dry_run_feedrate_replaces_f_in_cutting_blocks_and_not_in_threads() {
    let feed_of = |configured: f64, block: &Block| {
        let mut settings = settings();
        settings.max_feedrate_mm_min = 9000.0;
        settings.motion.dry_run_feedrate_mm_min = configured;
        let mut stage = PathStage::new(&settings, MachinePosition::default());
        stage.set_dry_run(true);
        let mut out = Vec::new();
        stage.push(block, &mut out).unwrap();
        stage.flush(&mut out);
        match out[0].motion {
            SegmentMotion::Feed { feed, .. } | SegmentMotion::Tap { feed, .. } => feed.feedrate_mm_min,
            _ => panic!("{out:?}"),
        }
    };
    let line = g01(1, &[(X, 10.0)]);
    assert!((feed_of(2500.0, &line) - 2500.0).abs() < 1e-12);
    assert!(
        (feed_of(0.0, &line) - 9000.0).abs() < 1e-12,
        "0 is the maximum feedrate"
    );
    assert!((feed_of(2500.0, &g01(1, &[(A, 10.0)])) - 2500.0).abs() < 1e-12);
    let thread = crate::tapping::tap(1, -5.0, TapLeg::In, Some(300.0));
    assert!((feed_of(2500.0, &thread) - 100.0).abs() < 1e-12);
}

#[test]
fn a_rounding_error_of_x_does_not_count_as_the_length_of_a_rotary_block() {
    let (length, _) = length_and_feed(&run(&[g01(1, &[(X, 3e-10), (A, 90.0)])])[0]);
    assert!((length - 90.0).abs() < 1e-12);
}

#[test]
fn an_axis_that_the_coordinate_system_lacks_is_an_alarm() {
    assert!(refused(&g01(4, &[(X, 1.0), (B, 1.0)]), &AXIS_MISSING).contains('B'));
    assert!(refused(&g00(4, &[(B, 0.0)]), &AXIS_MISSING).contains('B'));
}

#[test]
fn soft_limits_are_checked_first_and_text_names_axis_value_and_limit() {
    let text = refused(&g01(9, &[(X, 10.0), (Y, 200.5)]), &SOFT_LIMIT);
    assert!(
        text.contains('Y') && text.contains("200.5") && text.contains("upper limit 200.0"),
        "{text}"
    );
    let text = refused(&g00(9, &[(Z, -100.25)]), &SOFT_LIMIT);
    assert!(
        text.contains('Z') && text.contains("-100.25") && text.contains("lower limit -100.0"),
        "{text}"
    );
    // A target at the limit is allowed, also if rounding puts it slightly beyond.
    assert_eq!(
        run(&[g01(1, &[(X, 200.0)]), g01(2, &[(Y, 200.0 + 1e-12)])]).len(),
        2
    );
    // The limit applies to the machine position.
    let mut stage = stage();
    let mut offset = AxisVector::ZERO;
    offset[X] = 150.0;
    let transform = Transform {
        work_offset: offset,
        ..Transform::default()
    };
    let mut out = Vec::new();
    stage
        .push(&block(1, Action::Transform(Box::new(transform))), &mut out)
        .unwrap();
    assert_eq!(
        stage.push(&g01(2, &[(X, 60.0)]), &mut out).unwrap_err().entry,
        &SOFT_LIMIT
    );
    stage.push(&g01(2, &[(X, 50.0)]), &mut out).unwrap();
}

#[test]
fn an_axis_outside_its_limits_hinders_only_blocks_that_move_it() {
    let mut at = AxisVector::ZERO;
    at[X] = 250.0;
    let mut stage = PathStage::new(&settings(), MachinePosition(at));
    let mut out = Vec::new();
    stage.push(&g01(1, &[(Y, 5.0)]), &mut out).unwrap();
    assert_eq!(
        stage.push(&g01(2, &[(X, 240.0)]), &mut out).unwrap_err().entry,
        &SOFT_LIMIT
    );
    stage.push(&g01(3, &[(X, 200.0)]), &mut out).unwrap();
}

#[test]
fn a_missing_feedrate_is_an_alarm_only_for_a_block_that_moves() {
    let without_f = |block: Block| Block {
        feed: ProgrammedFeed {
            feedrate_mm_min: 0.0,
            ..block.feed
        },
        ..block
    };
    refused(&without_f(g01(1, &[(X, 1.0)])), &FEEDRATE_MISSING);
    assert!(run(&[without_f(g01(1, &[(X, 0.0)]))]).is_empty());
    assert_eq!(run(&[without_f(g00(1, &[(X, 1.0)]))]).len(), 1);

    let mut settings = settings();
    settings.default_feedrate_mm_min = 1000.0;
    let mut stage = PathStage::new(&settings, MachinePosition::default());
    let mut out = Vec::new();
    stage.push(&without_f(g01(1, &[(X, 1.0)])), &mut out).unwrap();
    stage.flush(&mut out);
    assert!((length_and_feed(&out[0]).1 - 1000.0).abs() < 1e-12);
}

#[test]
fn d07_a_value_that_is_not_a_number_is_an_alarm() {
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        refused(&g01(1, &[(X, value)]), &VALUE_NOT_FINITE);
        refused(&g00(1, &[(A, value)]), &VALUE_NOT_FINITE);
        refused(&block(1, Action::Dwell { dwell_s: value }), &VALUE_NOT_FINITE);
        let mut offset = AxisVector::ZERO;
        offset[Y] = value;
        let transform = Transform {
            work_offset: offset,
            ..Transform::default()
        };
        refused(
            &block(1, Action::Transform(Box::new(transform))),
            &VALUE_NOT_FINITE,
        );
        for field in 0..4 {
            let mut block = g01(1, &[(X, 1.0)]);
            let feed = &mut block.feed;
            *[
                &mut feed.feedrate_mm_min,
                &mut feed.ta_ms,
                &mut feed.td_ms,
                &mut feed.ts_ms,
            ][field] = value;
            refused(&block, &VALUE_NOT_FINITE);
        }
    }
    // The words are finite, but the length of the motion is not.
    refused(&g01(1, &[(A, 1e200), (C, 1e200)]), &VALUE_NOT_FINITE);
    refused(&block(1, Action::Dwell { dwell_s: -0.5 }), &VALUE_OUT_OF_RANGE);
}

#[test]
fn s1c_in_g64_a_block_is_continuous_when_another_follows() {
    let segments = run(&[g01(1, &[(X, 1.0)]), g01(2, &[(X, 2.0)]), g01(3, &[(X, 3.0)])]);
    assert_eq!(
        ends(&segments),
        [(1, Continuous), (2, Continuous), (3, ExactStop)]
    );
}

#[test]
fn s1c_the_last_block_is_held_back_until_the_next_one_or_a_flush() {
    let mut stage = stage();
    let mut out = Vec::new();
    stage.push(&g01(1, &[(X, 1.0)]), &mut out).unwrap();
    assert!(out.is_empty());
    stage.push(&g01(2, &[(X, 2.0)]), &mut out).unwrap();
    assert_eq!(ends(&out), [(1, Continuous)]);
    stage.flush(&mut out);
    stage.flush(&mut out);
    assert_eq!(ends(&out), [(1, Continuous), (2, ExactStop)]);
    stage.push(&g01(3, &[(X, 3.0)]), &mut out).unwrap();
    stage.restart(MachinePosition::default());
    stage.flush(&mut out);
    assert_eq!(out.len(), 2, "a restart discards the segments held back");
}

#[test]
fn d27_g09_stops_before_the_axis_words_or_after_them() {
    // The manual's example: G09 X10 separates its block from the one before, X10 G09 from the one after.
    let mut third = g01(3, &[(X, 30.0)]);
    third.exact_stop_before = true;
    let mut fourth = g01(4, &[(X, 40.0)]);
    fourth.exact_stop_after = true;
    let segments = run(&[
        g01(2, &[(X, 20.0)]),
        third,
        fourth,
        g01(5, &[(X, 50.0)]),
        g01(6, &[(X, 60.0)]),
    ]);
    assert_eq!(
        ends(&segments),
        [
            (2, ExactStop),
            (3, Continuous),
            (4, ExactStop),
            (5, Continuous),
            (6, ExactStop)
        ]
    );
}

#[test]
fn s1c_a_joint_blends_only_between_two_blocks_in_g64() {
    let exact = |mut block: Block| {
        block.path_control = PathControl::ExactStop;
        block
    };
    let segments = run(&[
        g01(1, &[(X, 1.0)]),
        exact(g01(2, &[(X, 2.0)])),
        g01(3, &[(X, 3.0)]),
        g01(4, &[(X, 4.0)]),
    ]);
    assert_eq!(
        ends(&segments),
        [(1, ExactStop), (2, ExactStop), (3, Continuous), (4, ExactStop)]
    );
    // In G61 no segment is held back.
    let mut stage = stage();
    let mut out = Vec::new();
    stage.push(&exact(g01(1, &[(X, 1.0)])), &mut out).unwrap();
    assert_eq!(ends(&out), [(1, ExactStop)]);
}

#[test]
fn s1c_rapid_dwell_transform_and_a_block_without_movement_end_a_chain() {
    let none = |line| block(line, Action::None);
    let dwell = |line| block(line, Action::Dwell { dwell_s: 0.5 });
    let transform = |line| block(line, Action::Transform(Box::default()));
    let without_words = |line| g01(line, &[]);
    for (between, segments) in [
        (none(2), 2),
        (dwell(2), 3),
        (transform(2), 2),
        (g00(2, &[(Y, 1.0)]), 3),
        (g00(2, &[(X, 1.0)]), 2),
        (without_words(2), 2),
    ] {
        let out = run(&[g01(1, &[(X, 1.0)]), between.clone(), g01(3, &[(X, 2.0)])]);
        assert_eq!(out.len(), segments, "{between:?}");
        assert!(out.iter().all(|segment| segment.end == ExactStop), "{between:?}");
    }
}

#[test]
fn m1c_g500_chain_ends_at_rapid_dwell_g09_tool_length_not_at_empty_block() {
    let with_g500 = |mut block: Block| {
        block.multi_block = MultiBlock::On;
        block
    };
    let before = |mut block: Block| {
        block.exact_stop_before = true;
        block
    };
    let after = |mut block: Block| {
        block.exact_stop_after = true;
        block
    };
    let none = || block(2, Action::None);
    let moved = |axis, value| {
        let mut transform = Transform::default();
        transform.local[axis] = value;
        block(2, Action::Transform(Box::new(transform)))
    };
    let longer = Transform {
        tool_length: 8.0,
        ..Transform::default()
    };
    for (between, continuous) in [
        (none(), true),
        (g01(2, &[]), true),
        (moved(X, 0.0), true),
        (moved(X, 5.0), true),
        (block(2, Action::Dwell { dwell_s: 0.5 }), false),
        (g00(2, &[(X, 1.0)]), false),
        (before(g01(2, &[(X, 1.0)])), false),
        (before(none()), false),
        (after(none()), false),
        (after(g01(2, &[])), false),
        (before(moved(X, 5.0)), false),
        (after(moved(X, 5.0)), false),
        (block(2, Action::Transform(Box::new(longer))), false),
    ] {
        let blocks = [g01(1, &[(X, 1.0)]), between.clone(), g01(3, &[(X, 2.0)])].map(with_g500);
        let out = run(&blocks);
        assert_eq!(out[0].end == Continuous, continuous, "{between:?}");
        let on = |segment: &Segment| segment.multi_block == MultiBlock::On;
        assert!(out.iter().all(on), "the motion stage receives G500");
    }
    let out = run(&[g01(1, &[(X, 1.0)]), moved(X, 5.0), g01(3, &[(X, 2.0)])].map(with_g500));
    near(target(&out[1]), [7.0, 0.0, 0.0]);
}

#[test]
fn a_move_of_length_zero_gives_no_segment_but_keeps_its_exact_stop() {
    let still = |line| g01(line, &[(X, 1.0)]);
    let chain = |between: Block| ends(&run(&[g01(1, &[(X, 1.0)]), between, g01(3, &[(X, 2.0)])]));
    assert_eq!(chain(still(2)), [(1, Continuous), (3, ExactStop)]);
    let mut before = still(2);
    before.exact_stop_before = true;
    assert_eq!(chain(before), [(1, ExactStop), (3, ExactStop)]);
    let mut after = still(2);
    after.exact_stop_after = true;
    assert_eq!(chain(after), [(1, ExactStop), (3, ExactStop)]);
    let mut g61 = still(2);
    g61.path_control = PathControl::ExactStop;
    assert_eq!(chain(g61), [(1, ExactStop), (3, ExactStop)]);
    assert!(run(&[block(1, Action::Dwell { dwell_s: 0.0 })]).is_empty());
}

#[test]
fn segments_join_without_a_gap() {
    let segments = run(&[
        g01(1, &[(X, 0.1)]),
        block(
            2,
            Action::Linear(words(Distance::Incremental, &[(X, 0.2), (Y, 1e-10)])),
        ),
        g00(3, &[(Z, 7.0)]),
        block(4, Action::Dwell { dwell_s: 0.1 }),
        g01(5, &[(A, 5.0)]),
    ]);
    let mut at = AxisVector::ZERO;
    for segment in &segments {
        let (from, to) = match &segment.motion {
            SegmentMotion::Feed { path, .. } => (path.start(), path.end()),
            SegmentMotion::Rapid { from, to }
            | SegmentMotion::Skip { from, to }
            | SegmentMotion::Tap { from, to, .. } => (*from, *to),
            SegmentMotion::Dwell { at, .. } => (*at, *at),
        };
        assert_eq!(from, at);
        at = to;
    }
    assert_eq!(segments.len(), 5);
}
