//! Runs a program in the interpreter, with inputs that a test sets.

#![allow(
    clippy::panic,
    dead_code,
    reason = "helpers of tests; not each test file uses all"
)]

use std::collections::BTreeMap;
use std::sync::Arc;

use tandem_interp::dialects::nj;
use tandem_interp::{Inputs, Interpreter, NO_TOOLS};
use tandem_model::axis::{Axis, AxisSet, AxisVector};
use tandem_model::flow::{Action, Item};
use tandem_model::settings::{CoordinateSystemSettings, MotorKind, MotorSettings, Tool, WorkOffsets};
use tandem_model::{Alarm, Origin, Variables};
use tandem_syntax::{Grammar, NcProgram, parse};

fn motor(number: u16, kind: MotorKind, max_velocity: f64) -> MotorSettings {
    MotorSettings {
        skip_velocity: 10.0,
        ..MotorSettings::new(number, kind, max_velocity, 1000.0)
    }
}

/// Axes X, Y, Z, A, and a spindle of 8000 r/min; F at most 6000 mm/min and 500 at start-up.
pub fn settings() -> CoordinateSystemSettings {
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
        motors,
        spindle: Some(motor(5, MotorKind::Spindle, 8000.0)),
        max_feedrate_mm_min: 6000.0,
        default_feedrate_mm_min: 500.0,
        default_td_ms: 90.0,
        ..CoordinateSystemSettings::default()
    }
}

pub fn program(source: &str) -> Arc<NcProgram> {
    Arc::new(parse(source, Grammar::nj()).0)
}

/// A main program with number 1, its subprograms, and its inputs.
pub struct Run {
    pub interpreter: Interpreter,
    pub programs: BTreeMap<u16, Arc<NcProgram>>,
    pub optional_skip: u32,
    pub work_offsets: WorkOffsets,
    pub variables: Variables,
    pub tool: Option<Tool>,
    pub captured: [f64; 8],
    pub position: AxisVector,
    /// True if a G31 has been returned and has not ended.
    pub skips: bool,
}

impl Run {
    pub fn new(source: &str) -> Self {
        Self::with_settings(source, &settings())
    }

    pub fn with_settings(source: &str, settings: &CoordinateSystemSettings) -> Self {
        let mut interpreter = Interpreter::new(settings, nj());
        interpreter.start(program(source), 1);
        Self {
            interpreter,
            programs: BTreeMap::new(),
            optional_skip: 0,
            work_offsets: WorkOffsets::default(),
            variables: Variables::default(),
            tool: Some(Tool {
                length: 8.0,
                radius: 5.0,
            }),
            captured: [0.0; 8],
            position: AxisVector::ZERO,
            skips: false,
        }
    }

    pub fn with(mut self, number: u16, source: &str) -> Self {
        self.programs.insert(number, program(source));
        self
    }

    pub fn next(&mut self) -> Result<Item, Alarm> {
        self.interpreter.next(&Inputs {
            tools: &NO_TOOLS,
            programs: &self.programs,
            optional_skip: self.optional_skip,
            work_offsets: &self.work_offsets,
            variables: &self.variables,
            tool: self.tool,
            captured: Some(self.captured).filter(|_| !self.skips),
            position: Some(self.position).filter(|_| !self.skips),
        })
    }

    /// Returns all items up to the end or an alarm, as text.
    pub fn items(mut self) -> Vec<String> {
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

/// Returns an item as `program:line content`.
pub fn text(item: &Item) -> String {
    let place = |origin: &Origin| format!("{}:{}", origin.program, origin.line);
    match item {
        Item::Block(block) => {
            let what = match &block.action {
                Action::None => "none".to_owned(),
                Action::Rapid(words) => format!("rapid {}", axes(words.values, words.named)),
                Action::Linear(words) => format!("linear {}", axes(words.values, words.named)),
                Action::Dwell { dwell_s } => format!("dwell {dwell_s}"),
                Action::Transform(transform) => format!("transform X{}", transform.work_offset[Axis::X]),
                other => format!("{other:?}"),
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

pub fn axes(values: AxisVector, named: AxisSet) -> String {
    named
        .iter()
        .map(|axis| format!("{}{}", axis.letter(), values[axis]))
        .collect::<Vec<_>>()
        .join(" ")
}

pub fn check(source: &str, expect: &[&str]) {
    assert_eq!(Run::new(source).items(), expect, "{source:?}");
}

/// Returns the first block of a program, as the path stage receives it.
pub fn first_block(source: &str) -> tandem_model::flow::Block {
    match Run::new(source).next() {
        Ok(Item::Block(block)) => block,
        other => panic!("{source:?} gives {other:?}"),
    }
}

/// Returns the last motion block of a program.
pub fn last_motion(source: &str) -> tandem_model::flow::Block {
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
