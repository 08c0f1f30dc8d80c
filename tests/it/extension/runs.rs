//! A program of a custom dialect, checked and interpreted.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use tandem_interp::{CheckContext, Dialect, Inputs, Interpreter, NO_TOOLS, check_source};
use tandem_model::axis::{AXES_MAX, Axis, AxisVector};
use tandem_model::flow::{Action, AxisWords, Block, Distance, Item};
use tandem_model::profile::Profile;
use tandem_model::settings::{Tool, WorkOffsets};
use tandem_model::variables::Variables;
use tandem_model::{Alarm, MachinePosition};
use tandem_motion::Planner;
use tandem_path::PathStage;
use tandem_runtime::Config;
use tandem_syntax::parse;

/// Codes of the findings, in the order of the text.
pub fn findings(text: &str, dialect: &'static Dialect) -> Vec<&'static str> {
    let (_, check) = check_source(text, dialect, &CheckContext::default());
    check.diagnostics.iter().map(|one| one.code).collect()
}

/// Messages and help of the findings.
pub fn texts(text: &str, dialect: &'static Dialect) -> Vec<(String, String)> {
    let (_, check) = check_source(text, dialect, &CheckContext::default());
    let findings = check.diagnostics.into_iter();
    findings.map(|one| (one.message, one.help)).collect()
}

/// Returns the items of a program to its end, from position 0, with a tool of radius 5 mm and length 8 mm.
///
/// # Errors
/// Fails with the alarm that ends the program.
pub fn items(text: &str, dialect: &'static Dialect) -> Result<Vec<Item>, Alarm> {
    let machine = Config::demo().resolve().unwrap();
    let mut interpreter = Interpreter::new(&machine.coordinate_systems[0].settings, dialect);
    let (tree, diagnostics) = parse(text, (dialect.grammar)());
    assert!(diagnostics.is_empty(), "{diagnostics:?}");
    interpreter.start(Arc::new(tree), 1);
    let (programs, work_offsets) = (BTreeMap::new(), WorkOffsets::default());
    let mut position = AxisVector::ZERO;
    let mut items = Vec::new();
    loop {
        let item = interpreter.next(&Inputs {
            programs: &programs,
            tools: &NO_TOOLS,
            optional_skip: 0,
            work_offsets: &work_offsets,
            variables: &Variables::default(),
            tool: Some(Tool {
                radius: 5.0,
                length: 8.0,
            }),
            captured: Some([0.0; AXES_MAX]),
            position: Some(position),
        })?;
        match item {
            Item::End(_) => return Ok(items),
            Item::Block(ref block) => follow(&mut position, &block.action),
            _ => {}
        }
        items.push(item);
    }
}

/// Returns the blocks among the items of a program.
pub fn blocks(text: &str, dialect: &'static Dialect) -> Vec<Block> {
    let items = items(text, dialect).unwrap().into_iter();
    let blocks = items.filter_map(|item| match item {
        Item::Block(block) => Some(block),
        _ => None,
    });
    blocks.collect()
}

/// Returns the motion of a program from machine position 0 to its end, each profile from rest to rest, as
/// path stage and planner produce it.
pub fn profiles(text: &str, dialect: &'static Dialect) -> Vec<Profile> {
    let machine = Config::demo().resolve().unwrap();
    let settings = &machine.coordinate_systems[0].settings;
    let mut path = PathStage::new(settings, MachinePosition::default());
    let mut planner = Planner::new(settings);
    let (mut segments, mut profiles) = (Vec::new(), VecDeque::new());
    for block in blocks(text, dialect) {
        path.push(&block, &mut segments).unwrap();
    }
    path.finish(&mut segments).unwrap();
    for segment in &segments {
        planner.push(segment, &mut profiles).unwrap();
    }
    planner.flush(&mut profiles);
    profiles.into()
}

fn follow(position: &mut AxisVector, action: &Action) {
    if let Action::Rapid(words) | Action::Linear(words) = action {
        for axis in words.named.iter() {
            match words.distance {
                Distance::Absolute => position[axis] = words.values[axis],
                Distance::Incremental => position[axis] += words.values[axis],
            }
        }
    }
}

/// `rapid X1 Y2`; of a distance `rapid X+1`.
pub fn shown(action: &Action) -> String {
    let (name, words) = match action {
        Action::Rapid(words) => ("rapid", words),
        Action::Linear(words) => ("linear", words),
        other => return format!("{other:?}"),
    };
    format!("{name}{}", axes(words))
}

fn axes(words: &AxisWords) -> String {
    let sign = match words.distance {
        Distance::Absolute => "",
        Distance::Incremental => "+",
    };
    let axis = |axis: Axis| format!(" {}{sign}{}", axis.letter(), words.values[axis]);
    words.named.iter().map(axis).collect()
}
