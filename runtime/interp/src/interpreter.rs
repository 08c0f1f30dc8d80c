//! From the program tree to items for the coordinator: a pull interface, pure.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use tandem_model::alarm::{
    PROGRAM_END_MISSING, PROGRAM_HAS_ERRORS, PROGRAM_NOT_FOUND, STEP_LIMIT, VALUE_NOT_FINITE,
    VALUE_OUT_OF_RANGE,
};
use tandem_model::flow::{Action, Block as FlowBlock, Compensation, Item, MultiBlock, Output, ProgramStop};
use tandem_model::limits::{CALL_DEPTH_MAX, STEPS_WITHOUT_ITEM_MAX};
use tandem_model::settings::{CoordinateSystemSettings, WorkOffsets};
use tandem_model::{Alarm, Diagnostic, Origin};
use tandem_syntax::{Content, NcProgram, diagnostics};

use crate::block_words::BlockWords;
use crate::codes::{ModalGroup, feed_words};
use crate::dialects::{self, Dialect};
use crate::execution::{Draft, Execution, Flow, Limits};
use crate::modal::Modal;

/// Values from outside, read when a block is interpreted (D16).
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a> {
    /// The programs that M98 may call.
    pub programs: &'a BTreeMap<u16, Arc<NcProgram>>,
    /// Block skip inputs: bit `n - 1` for number `n` (D13).
    pub optional_skip: u32,
    /// G54 to G59.
    pub work_offsets: &'a WorkOffsets,
}

/// A program of the nesting and where it stands.
#[derive(Debug)]
struct Frame {
    program: Arc<NcProgram>,
    number: u16,
    /// Index of the block to come.
    next: usize,
    /// How often the program runs again after its M99.
    repeats_left: u16,
    /// The block interpreted last.
    origin: Origin,
}

/// Whether there is anything left to interpret.
#[derive(Debug)]
enum State {
    Running,
    Ended(Origin),
    Failed(Alarm),
}

/// Interprets the program of one coordinate system.
///
/// A block gives its items in this order: warnings, the transform, the motion (or [`Action::None`]), and what its M code
/// gives. An auxiliary output thus follows its block's own motion; the coordinator decides by the M code's setting when
/// it is made (D31, D32). In a block without motion M00, M01, M02 and M30 give nothing before their own item, and M98
/// and M99 give nothing: motions blend across a call.
#[derive(Debug)]
pub struct Interpreter {
    dialect: &'static Dialect,
    limits: Limits,
    start_up: Modal,
    modal: Modal,
    stack: Vec<Frame>,
    words: BlockWords,
    queue: VecDeque<Item>,
    state: State,
}

impl Interpreter {
    /// An interpreter of dialect nj without a program, in the start-up modal state.
    pub fn new(settings: &CoordinateSystemSettings) -> Self {
        Self::with_dialect(settings, dialects::nj())
    }

    /// The same for another dialect.
    pub fn with_dialect(settings: &CoordinateSystemSettings, dialect: &'static Dialect) -> Self {
        let start_up = Modal::start_up(dialect, settings);
        Self {
            dialect,
            limits: Limits::of(settings),
            modal: start_up.clone(),
            start_up,
            stack: Vec::with_capacity(CALL_DEPTH_MAX + 1),
            words: BlockWords::new(dialect),
            queue: VecDeque::with_capacity(4),
            state: State::Ended(Origin::default()),
        }
    }

    /// Begins a program at its head, in the start-up modal state. `number` 0: a program without a number.
    pub fn start(&mut self, program: Arc<NcProgram>, number: u16) {
        self.modal = self.start_up.clone();
        self.queue.clear();
        self.stack.clear();
        self.stack.push(Frame::new(program, number, 1));
        self.state = State::Running;
    }

    /// The next item. After [`Item::End`] and after an alarm the answer repeats until [`Interpreter::start`].
    ///
    /// # Errors
    /// An alarm that stops the coordinate system; nothing of its block has been given out: a value out of its range
    /// (D11) or not finite (D07), a missing program (D12), a missing end, a program with errors, or
    /// [`STEPS_WITHOUT_ITEM_MAX`] blocks without an item.
    pub fn next(&mut self, inputs: &Inputs<'_>) -> Result<Item, Alarm> {
        let mut steps = 0;
        loop {
            if let Some(item) = self.queue.pop_front() {
                return Ok(item);
            }
            match &self.state {
                State::Running => {}
                State::Ended(origin) => return Ok(Item::End(*origin)),
                State::Failed(alarm) => return Err(alarm.clone()),
            }
            steps += 1;
            let step = if steps > STEPS_WITHOUT_ITEM_MAX {
                let text = format!("{STEPS_WITHOUT_ITEM_MAX} blocks have given neither motion nor output");
                Err(Alarm::new(&STEP_LIMIT, text))
            } else {
                self.step(inputs)
            };
            if let Err(alarm) = step {
                self.state = State::Failed(alarm.at(self.origin()));
            }
        }
    }

    /// The modal state after the last interpreted block.
    pub fn modal(&self) -> &Modal {
        &self.modal
    }

    /// Where each program of the nesting stands, the main program first: for a caller the calling block, for the
    /// last one the block interpreted last. It stays after the end until the next start.
    pub fn call_stack(&self) -> impl Iterator<Item = Origin> {
        self.stack.iter().map(|frame| frame.origin)
    }

    /// The block interpreted last.
    fn origin(&self) -> Origin {
        self.stack.last().map(|frame| frame.origin).unwrap_or_default()
    }

    /// Interprets one block; what it gives is in the queue afterwards.
    fn step(&mut self, inputs: &Inputs<'_>) -> Result<(), Alarm> {
        let Some(frame) = self.stack.last_mut() else {
            self.state = State::Ended(Origin::default());
            return Ok(());
        };
        let Some(block) = frame.program.blocks().get(frame.next) else {
            let text = format!(
                "program {} has no block left and no M02, M30 or M99",
                frame.number
            );
            return Err(Alarm::new(&PROGRAM_END_MISSING, text));
        };
        frame.next += 1;
        if block.skip_numbers() & inputs.optional_skip != 0 {
            return Ok(());
        }
        frame.origin = frame.program.origin(block, frame.number);
        if block.has_errors() {
            return Err(Alarm::new(&PROGRAM_HAS_ERRORS, "the block has an error"));
        }
        if let Content::ProgramCode(_) = block.content {
            return Err(Alarm::new(
                &PROGRAM_HAS_ERRORS,
                "program codes are not supported yet",
            ));
        }
        let mut fault = None;
        self.words
            .read(&frame.program, block, self.dialect, false, |found| {
                fault.get_or_insert(found);
            });
        if let Some(fault) = fault {
            return Err(alarm_of(&fault));
        }
        let origin = frame.origin;
        let mut execution = Execution::new(&self.words, &mut self.modal, inputs, &self.limits);
        execute(&mut execution);
        let mut draft = execution.draft;
        if let Some(alarm) = draft.alarm.take() {
            return Err(alarm);
        }
        let flow = draft.flow;
        self.queue_block(draft, origin);
        self.go_on(flow, origin, inputs)
    }

    /// Queues warnings, transform and motion of a block.
    fn queue_block(&mut self, mut draft: Draft, origin: Origin) {
        for text in draft.warnings.drain(..) {
            self.queue.push_back(Item::Warning(origin, text));
        }
        // these end a chain of motions by themselves, or are no more than a way to the next block
        let own_item = !matches!(draft.flow, Flow::Next | Flow::Output { .. });
        let silent = own_item || draft.transform.is_some() || !self.words.any();
        let action = draft.action.take().or((!silent).then_some(Action::None));
        let mut queue = |action, exact_stop_before, exact_stop_after| {
            self.queue.push_back(Item::Block(FlowBlock {
                origin,
                action,
                feed: self.modal.feed(),
                path_control: self.modal.path_control,
                exact_stop_before,
                exact_stop_after,
                multi_block: MultiBlock::Off,
                compensation: Compensation::Off,
            }));
        };
        if let Some(transform) = draft.transform {
            queue(Action::Transform(Box::new(transform)), false, false);
        }
        if let Some(action) = action {
            queue(action, draft.exact_stop_before, draft.exact_stop_after);
        }
    }

    /// Does what the M code of a block says.
    fn go_on(&mut self, flow: Flow, origin: Origin, inputs: &Inputs<'_>) -> Result<(), Alarm> {
        match flow {
            Flow::Next => {}
            Flow::Output { m, params } => self.queue.push_back(Item::Output(Output { origin, m, params })),
            Flow::Stop { optional } => self.queue.push_back(Item::Stop(ProgramStop { origin, optional })),
            Flow::End => self.state = State::Ended(origin),
            Flow::Call { program, times } => return self.call(program, times, origin, inputs),
            Flow::Return => self.leave(origin),
        }
        Ok(())
    }

    fn call(&mut self, number: u16, times: u16, origin: Origin, inputs: &Inputs<'_>) -> Result<(), Alarm> {
        if times == 0 {
            return Ok(());
        }
        // the main program is no call
        if self.stack.len() > CALL_DEPTH_MAX {
            let text =
                format!("the call of program {number} is deeper than {CALL_DEPTH_MAX} and is not made");
            self.queue.push_back(Item::Warning(origin, text));
            return Ok(());
        }
        let Some(program) = inputs.programs.get(&number) else {
            self.queue.clear();
            return Err(Alarm::new(
                &PROGRAM_NOT_FOUND,
                format!("program {number} is not there"),
            ));
        };
        self.stack.push(Frame::new(Arc::clone(program), number, times));
        Ok(())
    }

    /// M99: the next repetition of the call, the caller, or the end of the main program.
    fn leave(&mut self, origin: Origin) {
        let called = self.stack.len() > 1;
        match self.stack.last_mut() {
            Some(frame) if frame.repeats_left > 0 => {
                frame.repeats_left -= 1;
                frame.next = 0;
            }
            Some(_) if called => {
                self.stack.pop();
            }
            _ => self.state = State::Ended(origin),
        }
    }
}

impl Frame {
    fn new(program: Arc<NcProgram>, number: u16, times: u16) -> Self {
        Self {
            program,
            number,
            next: 0,
            repeats_left: times.saturating_sub(1),
            origin: Origin {
                program: number,
                line: 1,
                column: 1,
            },
        }
    }
}

/// Runs the effects of a block: modal codes, feed words, codes that are not modal, motion, M code.
fn execute(execution: &mut Execution<'_>) {
    let words = execution.words();
    for (code, place) in words.g_codes() {
        if code.group != ModalGroup::NonModal {
            execution.modal_mut().remember(code);
            execution.turn_to(*place);
            (code.select)(execution);
        }
    }
    feed_words::take_over(execution);
    for (code, place) in words.g_codes() {
        if code.group == ModalGroup::NonModal {
            execution.turn_to(*place);
            (code.select)(execution);
        }
    }
    if let Some(axis_words) = execution.axis_words()
        && let Some(motion) = execution
            .modal()
            .code(ModalGroup::Motion)
            .and_then(|code| code.motion)
    {
        motion(execution, axis_words);
    }
    if let Some(code) = words.m_code() {
        (code.select)(execution);
    }
}

/// The alarm for what would have been an error at check time.
fn alarm_of(fault: &Diagnostic) -> Alarm {
    let entry = if fault.code == diagnostics::NUMBER_TOO_LARGE.code {
        &VALUE_NOT_FINITE
    } else if fault.code == diagnostics::OUT_OF_RANGE.code {
        &VALUE_OUT_OF_RANGE
    } else {
        &PROGRAM_HAS_ERRORS
    };
    Alarm::new(entry, fault.message.clone())
}

#[cfg(test)]
mod tests {
    use tandem_model::Span;

    use super::*;
    use crate::block_words::judge_value;
    use crate::codes::{AXIS_WORDS, m_auxiliary::AUXILIARY};

    fn alarm_number(spec: &crate::codes::WordSpec, value: f64) -> Option<u16> {
        let mut number = None;
        judge_value(spec, value, Span::default(), &mut |fault| {
            number = Some(alarm_of(&fault).entry.number);
        });
        number
    }

    #[test]
    fn d07_a_value_that_is_not_finite_is_an_alarm() {
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert_eq!(alarm_number(&AXIS_WORDS[0], value), Some(10));
            assert_eq!(alarm_number(&AUXILIARY.words[0], value), Some(10));
        }
    }

    #[test]
    fn d11_a_computed_value_out_of_range_is_an_alarm() {
        assert_eq!(alarm_number(&AXIS_WORDS[0], 1_000_000.0), None);
        assert_eq!(alarm_number(&AXIS_WORDS[0], 1_000_000.1), Some(11));
    }
}
