//! Speed of the language stages over a generated program of a million short blocks (15.7 MB).
//!
//! Measured on one core of an AMD EPYC virtual machine with two, shared with other builds: parsing 19 million blocks
//! a second, parsing and checking 8 to 14 million, interpretation 14 million (medians).

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::Arc;

use divan::Bencher;
use divan::counter::{BytesCount, ItemsCount};
use tandem_interp::{CheckContext, Inputs, Interpreter, check};
use tandem_model::flow::Item;
use tandem_model::settings::{CoordinateSystemSettings, WorkOffsets};
use tandem_syntax::{Grammar, parse};

const BLOCKS: usize = 1_000_000;

fn main() {
    divan::main();
}

/// A spiral of short straight blocks, as a CAM system writes them.
fn million_blocks() -> String {
    let mut text = String::with_capacity(BLOCKS * 20);
    text.push_str("G17 G90 G01 F3000 X0 Y0\n");
    for i in 2..BLOCKS {
        let angle = i as f64 * 0.01;
        let radius = 10.0 + i as f64 * 0.000_1;
        let _ = writeln!(text, "X{:.3}Y{:.3}", radius * angle.cos(), radius * angle.sin());
    }
    text.push_str("M30\n");
    text
}

fn settings() -> CoordinateSystemSettings {
    CoordinateSystemSettings {
        number: 1,
        motors: [const { None }; 8],
        spindle: None,
        max_feedrate_mm_min: 10_000.0,
        default_feedrate_mm_min: 0.0,
        default_ta_ms: 100.0,
        default_td_ms: 100.0,
        default_ts_ms: 50.0,
        rotary_feedrate_deg_min: 0.0,
        override_slew_ms: 1000.0,
        hold_slew_ms: 200.0,
        servo_period_s: 0.001,
        motion: tandem_model::settings::MotionOptions::default(),
    }
}

#[divan::bench(sample_count = 10)]
fn parse_only(bencher: Bencher<'_, '_>) {
    let source: Arc<str> = million_blocks().into();
    bencher
        .counter(ItemsCount::new(BLOCKS))
        .counter(BytesCount::new(source.len()))
        .bench(|| parse(Arc::clone(&source), Grammar::nj()));
}

#[divan::bench(sample_count = 10)]
fn parse_and_check(bencher: Bencher<'_, '_>) {
    let source: Arc<str> = million_blocks().into();
    bencher
        .counter(ItemsCount::new(BLOCKS))
        .counter(BytesCount::new(source.len()))
        .bench(|| {
            let (program, findings) = parse(Arc::clone(&source), Grammar::nj());
            assert!(findings.is_empty());
            let check = check(&program, &CheckContext::default());
            assert!(check.diagnostics.is_empty());
            program
        });
}

#[divan::bench(sample_count = 10)]
fn interpret(bencher: Bencher<'_, '_>) {
    let program = Arc::new(parse(million_blocks(), Grammar::nj()).0);
    let programs = BTreeMap::new();
    let work_offsets = WorkOffsets::default();
    let inputs = Inputs {
        programs: &programs,
        optional_skip: 0,
        work_offsets: &work_offsets,
    };
    let mut interpreter = Interpreter::new(&settings());
    bencher.counter(ItemsCount::new(BLOCKS)).bench_local(|| {
        interpreter.start(Arc::clone(&program), 1);
        let mut blocks = 0;
        while let Ok(item) = interpreter.next(&inputs) {
            blocks += 1;
            if matches!(item, Item::End(_)) {
                break;
            }
        }
        assert_eq!(blocks, BLOCKS);
    });
}
