//! A million short blocks with G500: path and motion only, and including all stages before them.
//!
//! Blocks a second on one core of a 2-core virtual machine without other load; medians of five, the slowest and the
//! fastest:
//!
//! | program | path and plan | from text to profiles |
//! | --- | --- | --- |
//! | lines of 0.1 to 1 mm, F3000 | 1,791,000 | 1,268,000 (1,242,000 to 1,283,000) |
//! | the same, F24000, beyond the limits where the spiral is narrow | 990,000 | |
//! | quarter circles of 1 mm, left and right, F3000 | 404,000 (398,000 to 406,000) | 347,000 (344,000 to 349,000) |
//!
//! Other hosts reach three quarters of these values, or half.
//!
//! A new plan of the known blocks for another override costs nearly constant time for each block: 0.46 µs with 1000
//! blocks, 0.56 with 10,000, and 0.79 with 50,000, which no longer fit the cache.

use std::fmt::Write as _;

use divan::Bencher;
use divan::counter::ItemsCount;
use tandem_model::profile::PathPlace;
use tandem_motion::Replan;

use crate::{Stages, from_text, interpret, measured, parsed};

/// Number of blocks of a program.
fn length() -> usize {
    measured(1_000_000)
}

/// Returns a spiral of short straight blocks, as a CAM system writes them.
fn lines(blocks: usize, feedrate: u32) -> String {
    let mut text = String::with_capacity(blocks * 20);
    let _ = writeln!(text, "G17 G90 G64 G500 G01 F{feedrate} X0 Y0");
    for i in 2..blocks {
        let angle = i as f64 * 0.01;
        let radius = 10.0 + i as f64 * 0.000_1;
        let _ = writeln!(text, "X{:.3}Y{:.3}", radius * angle.cos(), radius * angle.sin());
    }
    text.push_str("M30\n");
    text
}

/// Returns the same length as a wave of quarter circles, alternately left and right.
fn arcs(feedrate: u32) -> String {
    let mut text = String::with_capacity(length() * 24);
    let _ = writeln!(text, "G17 G91 G64 G500 G01 F{feedrate} X1");
    for i in 2..length() {
        let block = match i % 4 {
            0 => "G03X1Y1I0J1",
            1 => "G02X1Y1I1J0",
            2 => "G02X1Y-1I0J-1",
            _ => "G03X1Y-1I1J0",
        };
        text.push_str(block);
        text.push('\n');
    }
    text.push_str("M30\n");
    text
}

fn path_and_plan(bencher: Bencher<'_, '_>, program: String) {
    let mut blocks = Vec::new();
    interpret(&parsed(&program.into()), |block| blocks.push(block));
    bencher.counter(ItemsCount::new(length())).bench_local(|| {
        let mut stages = Stages::new();
        for block in &blocks {
            stages.push(block);
        }
        stages.finish()
    });
}

fn text_to_profiles(bencher: Bencher<'_, '_>, program: String) {
    let source = program.into();
    assert!(from_text(&source) >= length() - 2);
    bencher
        .counter(ItemsCount::new(length()))
        .bench_local(|| from_text(&source));
}

/// With F as programmed, no limit is exceeded.
#[divan::bench(sample_count = 3)]
fn lines_path_and_plan(bencher: Bencher<'_, '_>) {
    path_and_plan(bencher, lines(length(), 3000));
}

/// Twice the speed that the curve allows at its beginning.
#[divan::bench(sample_count = 3)]
fn lines_beyond_the_limits_path_and_plan(bencher: Bencher<'_, '_>) {
    path_and_plan(bencher, lines(length(), 24_000));
}

#[divan::bench(sample_count = 3)]
fn arcs_path_and_plan(bencher: Bencher<'_, '_>) {
    path_and_plan(bencher, arcs(3000));
}

#[divan::bench(sample_count = 3)]
fn lines_from_text_to_profiles(bencher: Bencher<'_, '_>) {
    text_to_profiles(bencher, lines(length(), 3000));
}

#[divan::bench(sample_count = 3)]
fn arcs_from_text_to_profiles(bencher: Bencher<'_, '_>) {
    text_to_profiles(bencher, arcs(3000));
}

/// Changes the override to 200 percent with this many known blocks after the place from which it applies.
#[divan::bench(args = [1000, 10_000, 50_000], sample_count = 20)]
fn replan_for_another_override(bencher: Bencher<'_, '_>, blocks: usize) {
    let mut stages = Stages::new();
    interpret(&parsed(&lines(blocks, 3000).into()), |block| stages.push(&block));
    let mut planner = stages.planner;
    planner.set_feed_override(2.0);
    let begin = PathPlace {
        segment: 1,
        plan_s: 0.0,
    };
    let place = planner.place_ahead(begin, 0.01);
    assert!(place.is_some());
    bencher
        .counter(ItemsCount::new(blocks))
        .bench_local(|| -> Option<Replan> { Some(planner.replan(place?, false)) });
}
