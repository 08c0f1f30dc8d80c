//! Speed of the path and motion stages over a million short blocks with G500, and with everything before them.
//!
//! Blocks a second on one core of a 2-core virtual machine with nothing beside it; medians of five, the slowest and the
//! fastest:
//!
//! | program | path and plan | from text to profiles |
//! | --- | --- | --- |
//! | lines of 0.1 to 1 mm, F3000 | 1,791,000 | 1,268,000 (1,242,000 to 1,283,000) |
//! | the same, F24000, beyond the limits where the spiral is narrow | 990,000 | |
//! | quarter circles of 1 mm, left and right, F3000 | 404,000 (398,000 to 406,000) | 347,000 (344,000 to 349,000) |
//!
//! Other hosts do three quarters of it, and half.
//!
//! A new plan of what is known, for another override, costs a block the same however many there are: 0.46 µs of 1000,
//! 0.56 of 10,000, and 0.79 of 50,000, which no longer fit the cache.

use std::collections::{BTreeMap, VecDeque};
use std::fmt::Write as _;
use std::sync::Arc;

use divan::Bencher;
use divan::counter::ItemsCount;
use tandem_interp::dialects::nj;
use tandem_interp::{Inputs, Interpreter};
use tandem_model::flow::{Block, Item};
use tandem_model::profile::PathPlace;
use tandem_model::settings::{CoordinateSystemSettings, MotorKind, MotorSettings, Tool, WorkOffsets};
use tandem_model::{AxisVector, MachinePosition, Variables};
use tandem_motion::{Planner, Replan};
use tandem_path::PathStage;
use tandem_syntax::{Grammar, NcProgram, parse};

const BLOCKS: usize = 1_000_000;

fn main() {
    divan::main();
}

/// A spiral of short straight blocks, as a CAM system writes them.
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

/// The same length as a wave of quarter circles, left and right in turn.
fn arcs(feedrate: u32) -> String {
    let mut text = String::with_capacity(BLOCKS * 24);
    let _ = writeln!(text, "G17 G91 G64 G500 G01 F{feedrate} X1");
    for i in 2..BLOCKS {
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

fn motor() -> MotorSettings {
    MotorSettings::new(1, MotorKind::Linear, 500.0, 5000.0)
}

fn settings() -> CoordinateSystemSettings {
    CoordinateSystemSettings {
        motors: std::array::from_fn(|i| (i < 3).then(motor)),
        max_feedrate_mm_min: 60_000.0,
        ..CoordinateSystemSettings::default()
    }
}

/// Calls `each` with all blocks of a program.
fn interpret(program: &Arc<NcProgram>, mut each: impl FnMut(Block)) {
    let programs = BTreeMap::new();
    let work_offsets = WorkOffsets::default();
    let variables = Variables::default();
    let inputs = Inputs {
        programs: &programs,
        optional_skip: 0,
        work_offsets: &work_offsets,
        variables: &variables,
        tool: Some(Tool::default()),
        captured: Some([0.0; 8]),
        position: Some(AxisVector::ZERO),
    };
    let mut interpreter = Interpreter::new(&settings(), nj());
    interpreter.start(Arc::clone(program), 1);
    loop {
        let item = interpreter.next(&inputs);
        assert!(item.is_ok());
        match item {
            Ok(Item::Block(block)) => each(block),
            Ok(Item::End(_)) | Err(_) => return,
            Ok(_) => {}
        }
    }
}

/// Path and motion, profiles thrown away as the servo takes them.
struct Stages {
    path: PathStage,
    planner: Planner,
    segments: Vec<tandem_model::flow::Segment>,
    profiles: VecDeque<tandem_model::profile::Profile>,
    planned: usize,
}

impl Stages {
    fn new() -> Self {
        Self {
            path: PathStage::new(&settings(), MachinePosition::default()),
            planner: Planner::new(&settings()),
            segments: Vec::new(),
            profiles: VecDeque::new(),
            planned: 0,
        }
    }

    fn push(&mut self, block: &Block) {
        let taken = self.path.push(block, &mut self.segments);
        assert!(taken.is_ok());
        self.plan();
        self.planned += self.profiles.len();
        self.profiles.clear();
    }

    fn plan(&mut self) {
        for segment in self.segments.drain(..) {
            assert!(self.planner.push(&segment, &mut self.profiles).is_ok());
        }
    }

    fn finish(mut self) {
        self.path.flush(&mut self.segments);
        self.plan();
        self.planner.flush(&mut self.profiles);
        let planned = self.planned + self.profiles.len();
        assert!(planned >= BLOCKS - 2, "{planned} profiles");
    }
}

fn path_and_plan(bencher: Bencher<'_, '_>, program: String) {
    let program = Arc::new(parse(program, Grammar::nj()).0);
    let mut blocks = Vec::new();
    interpret(&program, |block| blocks.push(block));
    bencher.counter(ItemsCount::new(BLOCKS)).bench_local(|| {
        let mut stages = Stages::new();
        for block in &blocks {
            stages.push(block);
        }
        stages.finish();
    });
}

/// At F as programmed nothing exceeds a limit.
#[divan::bench(sample_count = 3)]
fn lines_path_and_plan(bencher: Bencher<'_, '_>) {
    path_and_plan(bencher, lines(BLOCKS, 3000));
}

/// Twice as fast as the curve allows at its begin.
#[divan::bench(sample_count = 3)]
fn lines_beyond_the_limits_path_and_plan(bencher: Bencher<'_, '_>) {
    path_and_plan(bencher, lines(BLOCKS, 24_000));
}

#[divan::bench(sample_count = 3)]
fn arcs_path_and_plan(bencher: Bencher<'_, '_>) {
    path_and_plan(bencher, arcs(3000));
}

#[divan::bench(sample_count = 3)]
fn lines_from_text_to_profiles(bencher: Bencher<'_, '_>) {
    from_text(bencher, lines(BLOCKS, 3000));
}

#[divan::bench(sample_count = 3)]
fn arcs_from_text_to_profiles(bencher: Bencher<'_, '_>) {
    from_text(bencher, arcs(3000));
}

fn from_text(bencher: Bencher<'_, '_>, program: String) {
    let source: Arc<str> = program.into();
    bencher.counter(ItemsCount::new(BLOCKS)).bench_local(|| {
        let program = Arc::new(parse(Arc::clone(&source), Grammar::nj()).0);
        let mut stages = Stages::new();
        interpret(&program, |block| stages.push(&block));
        stages.finish();
    });
}

/// The override goes to 200 percent with this many blocks known behind the place from which on it acts.
#[divan::bench(args = [1000, 10_000, 50_000], sample_count = 20)]
fn replan_for_another_override(bencher: Bencher<'_, '_>, blocks: usize) {
    let program = Arc::new(parse(lines(blocks, 3000), Grammar::nj()).0);
    let mut stages = Stages::new();
    interpret(&program, |block| stages.push(&block));
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
