//! Finds the state in force at a line of a program: interprets the program from its beginning, as in a run, without
//! motion.
//!
//! This works only if the texts, the tables and the current inputs determine the path of the program. If the path
//! depends on a handler, a captured position or a skip input, the search is refused and the text names the cause. A
//! variable that the program sets is treated as known, although a handler may have changed the variable since.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use plc_protocol::types::data::VariableKind;
use plc_protocol::types::line_start::{Approach, LineStart, LineState, RestoredOutput};
use plc_protocol::types::request::{Refusal, RefusalCode};
use tandem_config::{MCodeSettings, Stock, UnhandledReaction};
use tandem_interp::{Inputs, Interpreter};
use tandem_model::alarm::VALUE_LOST;
use tandem_model::flow::{Compensation, Item, Output, Segment};
use tandem_model::settings::{Tool, WorkOffsets};
use tandem_model::{Alarm, Axis, AxisVector, MachinePosition, Origin, Variables};
use tandem_path::{PathStage, work_position};

use super::conditions::Conditions;
use crate::coordinate_system::{callers, published_modal, rest_refused};
use crate::sequence::stock;
use crate::shared::SharedState;

/// Maximum number of blocks interpreted to reach a line. Reason: a loop may never end.
const BLOCKS_MAX: u64 = 10_000_000;

/// State with which a run from a line begins.
#[derive(Debug)]
pub(crate) struct LineEntry {
    /// State before the target block.
    pub interpreter: Interpreter,
    pub arrival: LineArrival,
}

/// Arrival of a run at its line: approach, outputs and variables.
#[derive(Debug)]
pub(crate) struct LineArrival {
    /// Path stage at rest at the start of the target block.
    pub path: PathStage,
    /// Axis at right angles to the plane that is in force at the line.
    infeed: Axis,
    /// The target block: program and line.
    pub target: Origin,
    pub occurrence: u32,
    /// Number of the tool in the spindle at the line; `None` if it is unknown.
    pub tool: Option<u16>,
    /// Outputs issued before the approach, in order.
    pub restore: VecDeque<Output>,
    /// The last output of each M code that the start does not issue again.
    pub not_restored: Vec<Output>,
    /// Variables that the program sets before the line.
    pub variables: Vec<(VariableKind, usize, f64)>,
    pub approach: Approach,
}

impl LineArrival {
    /// Returns the machine positions to which the axes move from `from`, in sequence. Returns none if the axes are
    /// already at the start of the target block.
    pub fn approach_from(&self, from: MachinePosition) -> Vec<MachinePosition> {
        let to = self.path.position().0;
        let infeed = self.infeed;
        let move_axes = |at: AxisVector, moves: &dyn Fn(Axis) -> bool| {
            let mut next = at;
            for axis in Axis::ALL.into_iter().filter(|axis| moves(*axis)) {
                next[axis] = to[axis];
            }
            next
        };
        let first = match self.approach {
            Approach::PlaneFirst => move_axes(from.0, &|axis| axis != infeed),
            Approach::InfeedFirst => move_axes(from.0, &|axis| axis == infeed),
            Approach::Direct => to,
        };
        let mut at = from.0;
        let mut steps = Vec::new();
        for next in [first, to] {
            if next != at {
                steps.push(MachinePosition(next));
                at = next;
            }
        }
        steps
    }
}

/// Returns the state at the target line for display to operators.
pub(crate) fn line_state(
    LineEntry { interpreter, arrival }: &LineEntry,
    conditions: &Conditions,
) -> LineState {
    let axes = conditions.configured.settings.axes();
    let by_letter = |at: AxisVector| -> BTreeMap<String, f64> {
        let letters = axes.iter().map(|axis| (axis.letter().to_string(), at[axis]));
        letters.collect()
    };
    let at = arrival.path.position();
    let mut before = conditions.at;
    let approach = arrival.approach_from(before).into_iter().map(|step| {
        let moved = axes
            .iter()
            .filter(|axis| step.0[*axis].to_bits() != before.0[*axis].to_bits());
        let moved = moved
            .map(|axis| (axis.letter().to_string(), step.0[axis]))
            .collect();
        before = step;
        moved
    });
    let restored = |output: &Output| RestoredOutput {
        m: output.m,
        params: output.params.into(),
        program: output.origin.program,
        line: output.origin.line,
    };
    let text = conditions.texts.get(&arrival.target.program);
    LineState {
        program: arrival.target.program,
        line: arrival.target.line,
        occurrence: arrival.occurrence,
        block: text.map_or_else(String::new, |text| text.line(arrival.target.line).to_owned()),
        stack: callers(interpreter).collect(),
        modal: published_modal(interpreter.modal(), &conditions.configured, arrival.tool),
        work: by_letter(work_position(arrival.path.transform(), at).0),
        machine: by_letter(at.0),
        approach: approach.collect(),
        restore: arrival.restore.iter().map(restored).collect(),
        not_restored: arrival.not_restored.iter().map(restored).collect(),
        variables: arrival
            .variables
            .iter()
            .map(|(kind, index, value)| (format!("{kind:?}{index}"), *value))
            .collect(),
    }
}

/// Interprets the loaded program up to a line, and returns the state with which a run from this line begins.
///
/// # Errors
/// Returns an error in these cases: the program does not reach the line; it reaches the line several times and no
/// `occurrence` is given; an alarm stops it before the line; the state at the line is unknown; no run can begin in that
/// state.
pub(crate) fn search(
    shared: &SharedState,
    conditions: &Conditions,
    from: &LineStart,
) -> Result<LineEntry, Refusal> {
    let program = from.program.unwrap_or(conditions.main.number);
    let index = index_of(conditions, program, from.from_line)?;
    let occurrence = if let Some(occurrence) = from.occurrence {
        occurrence
    } else {
        let times = Search::new(shared, conditions, (program, index)).count(from.from_line)?;
        if times > 1 {
            return Err(refused(format!(
                "the program reaches line {} {times} times; choose one with occurrence, 1 to {times}",
                from.from_line
            )));
        }
        1
    };
    let mut search = Search::new(shared, conditions, (program, index));
    search.run_to(occurrence).map_err(|why| match why {
        Why::Ended if search.times > 0 => refused(format!(
            "the program reaches line {} {} times, not {occurrence} times",
            from.from_line, search.times
        )),
        why => why.refusal(from.from_line),
    })?;
    search.into_entry(from, occurrence)
}

/// Returns the index of the first block of a line.
fn index_of(conditions: &Conditions, program: u16, line: u32) -> Result<usize, Refusal> {
    let Some(tree) = conditions.programs.get(&program) else {
        let main = conditions.main.number;
        return Err(refused(format!("program {main} does not call program {program}")));
    };
    let blocks = tree.blocks();
    if let Some(index) = blocks.iter().position(|block| block.line == line) {
        return Ok(index);
    }
    let next = blocks.iter().find(|block| block.line > line);
    let next = next.map_or_else(String::new, |block| {
        format!("; the next line with a block is {}", block.line)
    });
    Err(refused(format!(
        "line {line} of program {program} has no block{next}"
    )))
}

fn refused(text: impl Into<String>) -> Refusal {
    Refusal::new(RefusalCode::LineRefused, text)
}

/// Reason why a search ends before its line.
enum Why {
    /// The program ends before the line.
    Ended,
    /// An alarm stops the program before the line.
    Alarm(Alarm),
    /// A value that determines the path of the program is unknown.
    Unknown(String),
}

impl Why {
    fn refusal(self, line: u32) -> Refusal {
        match self {
            Why::Ended => refused(format!(
                "with the present inputs and values the program does not reach line {line}"
            )),
            Why::Alarm(alarm) => {
                let at = alarm
                    .origin
                    .map_or_else(String::new, |at| format!(" in line {}", at.line));
                refused(format!(
                    "an alarm stops the program{at} before it reaches line {line}: {}: {}",
                    alarm.entry.title, alarm.text
                ))
            }
            Why::Unknown(why) => refused(format!("the state in line {line} cannot be known: {why}")),
        }
    }
}

struct Search<'a> {
    shared: &'a SharedState,
    conditions: &'a Conditions,
    /// Program and block index of the line that is searched for.
    target: (u16, usize),
    /// How many times the interpreter has reached the target block.
    times: u32,
    interpreter: Interpreter,
    path: PathStage,
    segments: Vec<Segment>,
    variables: Variables,
    work_offsets: WorkOffsets,
    tool: Option<u16>,
    /// The last output of each M number before the line, in the order of the program.
    outputs: Vec<Output>,
    /// The first M code whose handler may have set variables.
    handled: Option<Output>,
}

impl<'a> Search<'a> {
    fn new(shared: &'a SharedState, conditions: &'a Conditions, target: (u16, usize)) -> Self {
        let settings = &conditions.configured.settings;
        let mut interpreter = Interpreter::new(settings, conditions.configured.dialect);
        interpreter.start(Arc::clone(&conditions.main.tree), conditions.main.number);
        let mut path = PathStage::new(settings, conditions.at);
        path.set_dry_run(conditions.dry_run);
        Self {
            shared,
            conditions,
            target,
            times: 0,
            interpreter,
            path,
            segments: Vec::new(),
            variables: Variables {
                global: conditions.variables.global.watched_copy(),
                coordinate_system: conditions.variables.coordinate_system.watched_copy(),
            },
            work_offsets: conditions.work_offsets,
            tool: conditions.tool,
            outputs: Vec::new(),
            handled: None,
        }
    }

    /// Returns how many times the program reaches the line until its end, or until its path becomes unknown. Returns
    /// the error if that is zero times.
    fn count(&mut self, line: u32) -> Result<u32, Refusal> {
        let Err(why) = self.run_to(u32::MAX) else {
            return Ok(u32::MAX);
        };
        if self.times > 0 {
            return Ok(self.times);
        }
        Err(why.refusal(line))
    }

    /// Interprets the program up to the given occurrence of the line.
    fn run_to(&mut self, occurrence: u32) -> Result<(), Why> {
        while self.interpreter.steps() < BLOCKS_MAX {
            let item = self.next(occurrence).map_err(|alarm| self.why(alarm))?;
            let done = match item {
                None => return Ok(()),
                Some(Item::Block(block)) => self.path.push(&block, &mut self.segments),
                Some(Item::Output(output)) => self.simulate_output(output),
                Some(item @ Item::Stop(_)) => self.rest(&item),
                Some(Item::Warning(..)) => Ok(()),
                Some(Item::NeedsStandstill(at)) => {
                    let why = format!("line {} reads a captured position", at.line);
                    return Err(Why::Unknown(why));
                }
                Some(Item::End(_)) => return Err(Why::Ended),
            };
            self.segments.clear();
            done.map_err(Why::Alarm)?;
            if self.path.is_skipping() {
                let line = self.last_block().line;
                let why = format!("the skip input decides where the motion of line {line} ends");
                return Err(Why::Unknown(why));
            }
        }
        Err(Why::Unknown(format!(
            "the line is more than {BLOCKS_MAX} blocks away"
        )))
    }

    fn next(&mut self, occurrence: u32) -> Result<Option<Item>, Alarm> {
        let conditions = self.conditions;
        let tool = match self.tool {
            Some(id) => conditions.tools.get(&id).copied(),
            None => Some(Tool::LOST),
        };
        let inputs = Inputs {
            programs: &conditions.programs,
            optional_skip: conditions.optional_skip,
            work_offsets: &self.work_offsets,
            variables: &self.variables,
            tool,
            tools: &conditions.tools,
            captured: None,
            position: Some(self.path.counts_from().0),
        };
        let (target, times) = (self.target, &mut self.times);
        self.interpreter.next_unless(&inputs, |program, index| {
            let is_there = (program, index) == target;
            *times = times.saturating_add(u32::from(is_there));
            is_there && *times == occurrence
        })
    }

    /// Converts an alarm into the reason why the search ends. An alarm about a variable that a handler may have set
    /// becomes [`Why::Unknown`].
    fn why(&self, alarm: Alarm) -> Why {
        let name = alarm.text.split(' ').next().unwrap_or_default();
        match &self.handled {
            Some(output) if *alarm.entry == VALUE_LOST => Why::Unknown(format!(
                "line {} reads {name}, which the handler of M{:02} in line {} may have set",
                alarm.origin.unwrap_or_default().line,
                output.m,
                output.origin.line
            )),
            _ => Why::Alarm(alarm),
        }
    }

    /// Returns the block interpreted last.
    fn last_block(&self) -> Origin {
        self.interpreter.call_stack().last().unwrap_or_default()
    }

    fn settings_of(&self, m: u16) -> MCodeSettings {
        self.shared.machine.m_codes.get(&m).cloned().unwrap_or_default()
    }

    fn simulate_output(&mut self, output: Output) -> Result<(), Alarm> {
        let configured = &self.conditions.configured;
        let settings = self.settings_of(output.m);
        let is_compensating = self.path.is_compensating();
        if !configured.is_issued_at_once(&output, Some(&settings), is_compensating) {
            self.rest(&Item::Output(output))?;
        }
        let selects = settings.stock == Some(Stock::SelectTool);
        if selects && let Ok(id) = stock::selected_tool(output.m, output.params[0]) {
            self.tool = Some(id);
        }
        if self.handled.is_none() && self.is_handled(output.m, &settings) {
            self.handled = Some(output);
            self.variables.global.lose_unwritten();
            self.variables.coordinate_system.lose_unwritten();
        }
        self.outputs.retain(|earlier| earlier.m != output.m);
        self.outputs.push(output);
        Ok(())
    }

    /// Returns true if a client answers this M code, not the runtime.
    fn is_handled(&self, m: u16, settings: &MCodeSettings) -> bool {
        let system = &self.conditions.configured.settings;
        if self.shared.is_handled(system.number, m) {
            return true;
        }
        let is_stock = settings.stock.is_some() || (system.spindle.is_some() && stock::is_spindle_code(m));
        let unhandled = settings.unhandled.unwrap_or(self.shared.machine.unhandled);
        !is_stock && unhandled == UnhandledReaction::Wait
    }

    /// Ends the motion at rest for an item that waits. Returns the alarm if cutter compensation is on, because then the
    /// motion cannot stop.
    fn rest(&mut self, item: &Item) -> Result<(), Alarm> {
        let is_compensating =
            self.path.is_compensating() || self.interpreter.modal().compensation != Compensation::Off;
        if let (true, Some(alarm)) = (is_compensating, rest_refused(item)) {
            return Err(alarm);
        }
        self.path.flush(&mut self.segments);
        Ok(())
    }

    fn into_entry(mut self, from: &LineStart, occurrence: u32) -> Result<LineEntry, Refusal> {
        let line = from.from_line;
        let modal = self.interpreter.modal();
        if self.path.is_compensating() || modal.compensates() {
            let text = format!(
                "line {line} is within cutter compensation; choose a line before its start or after its end"
            );
            return Err(refused(text));
        }
        if modal.fixed_cycle().is_some() {
            let text = format!(
                "line {line} is within a fixed cycle; choose the line of the cycle's code, or a line after \
                 the end of the cycle"
            );
            return Err(refused(text));
        }
        self.path.flush(&mut self.segments);
        let (restore, not_restored) = self.restored();
        let written = |array: &tandem_model::variables::VariableArray, kind: VariableKind| {
            let set: Vec<_> = array
                .written()
                .map(|(index, value)| (kind, index, value))
                .collect();
            set
        };
        let mut variables = written(&self.variables.global, VariableKind::P);
        variables.extend(written(&self.variables.coordinate_system, VariableKind::Q));
        let arrival = LineArrival {
            infeed: self.interpreter.modal().plane().normal(),
            target: Origin {
                program: self.target.0,
                line,
                column: 1,
            },
            occurrence,
            tool: self.tool,
            restore,
            not_restored,
            variables,
            approach: from.approach,
            path: self.path,
        };
        Ok(LineEntry {
            interpreter: self.interpreter,
            arrival,
        })
    }

    /// Returns the last output of each restore group in the order of the settings, and separately the outputs without a
    /// group.
    fn restored(&self) -> (VecDeque<Output>, Vec<Output>) {
        let mut groups: Vec<(String, u16, Output)> = Vec::new();
        let mut others = Vec::new();
        for output in &self.outputs {
            let settings = self.settings_of(output.m);
            let Some((group, order)) = restore(&settings, output.m) else {
                others.push(*output);
                continue;
            };
            groups.retain(|(earlier, ..)| earlier != group);
            groups.push((group.to_owned(), order, *output));
        }
        groups.sort_by_key(|(_, order, _)| *order);
        (groups.into_iter().map(|(.., output)| output).collect(), others)
    }
}

/// Returns the restore group of an M code and the group's position in the order. Returns `None` if a start from a line
/// does not issue this M code again.
fn restore(settings: &MCodeSettings, m: u16) -> Option<(&str, u16)> {
    let group = match &settings.restore_group {
        Some(group) => group.as_str(),
        None if settings.stock == Some(Stock::SelectTool) => "tool",
        None if stock::is_spindle_code(m) => "spindle",
        None => return None,
    };
    let order = match group {
        "tool" => 10,
        "spindle" => 30,
        _ => 20,
    };
    Some((group, settings.restore_order.unwrap_or(order)))
}
