//! Speed of the stages in sequence, from NC text to profiles, on one core; the profiles are dropped in the order of the
//! servo.
//!
//! ```text
//! cargo bench -p tandem-runtime --bench stages                all
//! cargo bench -p tandem-runtime --bench stages -- lines       those with `lines` in their name
//! ```

mod look_ahead;
mod squares;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use tandem_interp::dialects::nj;
use tandem_interp::{Inputs, Interpreter, NO_TOOLS};
use tandem_model::flow::{Block, Item, Segment};
use tandem_model::profile::Profile;
use tandem_model::settings::{CoordinateSystemSettings, MotorKind, MotorSettings, Tool, WorkOffsets};
use tandem_model::{AxisVector, MachinePosition, Variables};
use tandem_motion::Planner;
use tandem_path::PathStage;
use tandem_syntax::{Grammar, NcProgram, parse};

fn main() {
    divan::main();
}

/// Number of blocks in a measurement; a twentieth of it if `cargo test --benches` runs each bench once.
fn measured<N: std::ops::Div<Output = N> + From<u8>>(number: N) -> N {
    if std::env::args().any(|argument| argument == "--bench") {
        number
    } else {
        number / N::from(20)
    }
}

/// Three linear motors of 500 mm/s and 5000 mm/s². The arcs have a total length of a million millimetres, so the soft
/// limits are larger.
fn settings() -> CoordinateSystemSettings {
    let motor = |number| {
        Some(MotorSettings {
            soft_limits: Some([-2e6, 2e6]),
            ..MotorSettings::new(number, MotorKind::Linear, 500.0, 5000.0)
        })
    };
    CoordinateSystemSettings {
        motors: [motor(1), motor(2), motor(3), None, None, None, None, None],
        max_feedrate_mm_min: 60_000.0,
        ..CoordinateSystemSettings::default()
    }
}

/// Returns the tree of a program without findings.
fn parsed(source: &Arc<str>) -> Arc<NcProgram> {
    let (program, findings) = parse(Arc::clone(source), Grammar::nj());
    assert!(findings.is_empty());
    Arc::new(program)
}

/// Calls `each` with all blocks of a program.
fn interpret(program: &Arc<NcProgram>, mut each: impl FnMut(Block)) {
    let (programs, work_offsets, variables) = (BTreeMap::new(), WorkOffsets::default(), Variables::default());
    let inputs = Inputs {
        tools: &NO_TOOLS,
        programs: &programs,
        optional_skip: 0,
        work_offsets: &work_offsets,
        variables: &variables,
        tool: Some(Tool {
            length: 0.0,
            radius: 3.0,
        }),
        captured: Some([0.0; 8]),
        position: Some(AxisVector::ZERO),
    };
    let mut interpreter = Interpreter::new(&settings(), nj());
    interpreter.start(Arc::clone(program), 1);
    loop {
        match interpreter.next(&inputs) {
            Ok(Item::Block(block)) => each(block),
            Ok(Item::End(_)) => return,
            other => assert!(other.is_ok(), "{other:?}"),
        }
    }
}

/// Runs path and motion.
struct Stages {
    path: PathStage,
    planner: Planner,
    segments: Vec<Segment>,
    profiles: VecDeque<Profile>,
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
        assert_eq!(self.path.push(block, &mut self.segments), Ok(()));
        self.plan();
    }

    fn plan(&mut self) {
        for segment in self.segments.drain(..) {
            assert_eq!(self.planner.push(&segment, &mut self.profiles), Ok(()));
        }
        self.planned += self.profiles.len();
        self.profiles.clear();
    }

    /// Returns the number of profiles.
    fn finish(mut self) -> usize {
        assert_eq!(self.path.finish(&mut self.segments), Ok(()));
        self.plan();
        self.planner.flush(&mut self.profiles);
        self.planned + self.profiles.len()
    }
}

/// Runs all stages; returns the number of profiles.
fn from_text(source: &Arc<str>) -> usize {
    let mut stages = Stages::new();
    interpret(&parsed(source), |block| stages.push(&block));
    stages.finish()
}
