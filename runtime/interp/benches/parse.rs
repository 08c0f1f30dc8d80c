//! Speed of the parser, the checker and the interpreter on a generated program of a million short blocks
//! (15.7 MB).
//!
//! Medians on one core of a virtual machine with two cores of an Intel Xeon, without other load: parsing 23.9
//! million blocks a second, parsing and checking 10.8 million, interpretation 7.1 million. Compare only runs
//! made within minutes of each other: in a slow hour, the same machine reached a third of these values. The
//! checker that follows every state takes as long to parse and check as the earlier checker that discarded
//! states at branches (74.2 to 74.0 ms, the fastest of alternating pairs on an AMD EPYC). It took 1.33 times
//! as long before the code for rare cases was moved out of the path of each block and word. Interpretation
//! takes 0.85 times as long since the kind of an action is stored in a word, not a byte (113 to 132 ms, the
//! fastest of four pairs on an AMD EPYC).

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::Arc;

use divan::Bencher;
use divan::counter::{BytesCount, ItemsCount};
use tandem_interp::dialects::nj;
use tandem_interp::{CheckContext, Inputs, Interpreter, NO_TOOLS, check};
use tandem_model::flow::Item;
use tandem_model::settings::{CoordinateSystemSettings, Tool, WorkOffsets};
use tandem_model::{AxisVector, Variables};
use tandem_syntax::{Grammar, NcProgram, parse};

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

fn inputs<'a>(
    programs: &'a BTreeMap<u16, Arc<NcProgram>>,
    work_offsets: &'a WorkOffsets,
    variables: &'a Variables,
) -> Inputs<'a> {
    Inputs {
        tools: &NO_TOOLS,
        programs,
        optional_skip: 0,
        work_offsets,
        variables,
        tool: Some(Tool::default()),
        captured: Some([0.0; 8]),
        position: Some(AxisVector::ZERO),
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
            let check = check(&program, nj(), &CheckContext::default());
            assert!(check.diagnostics.is_empty());
            program
        });
}

/// Measures the time until a parsed program gives its first block.
#[divan::bench]
fn first_block(bencher: Bencher<'_, '_>) {
    let program = Arc::new(parse(million_blocks(), Grammar::nj()).0);
    let (programs, work_offsets, variables) = (BTreeMap::new(), WorkOffsets::default(), Variables::default());
    let inputs = inputs(&programs, &work_offsets, &variables);
    let mut interpreter = Interpreter::new(&CoordinateSystemSettings::default(), nj());
    bencher.bench_local(|| {
        interpreter.start(Arc::clone(&program), 1);
        assert!(matches!(interpreter.next(&inputs), Ok(Item::Block(_))));
    });
}

#[divan::bench(sample_count = 10)]
fn interpret(bencher: Bencher<'_, '_>) {
    let program = Arc::new(parse(million_blocks(), Grammar::nj()).0);
    let (programs, work_offsets, variables) = (BTreeMap::new(), WorkOffsets::default(), Variables::default());
    let inputs = inputs(&programs, &work_offsets, &variables);
    let mut interpreter = Interpreter::new(&CoordinateSystemSettings::default(), nj());
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
