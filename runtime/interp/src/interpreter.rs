//! Converts the program tree to items, which the coordinator requests one by one. Changes nothing outside
//! except P and Q.

mod alarms;
mod modal_state;

use std::cell::Cell;
use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;

use tandem_model::alarm::{PROGRAM_END_MISSING, PROGRAM_HAS_ERRORS, PROGRAM_NOT_FOUND, STEP_LIMIT};
use tandem_model::flow::{Action, Block as FlowBlock, Item, Output, ProgramStop};
use tandem_model::limits::{CALL_DEPTH_MAX, STEPS_BEFORE_WAIT, STEPS_IN_CHAIN_MAX};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::variables::LOCAL_VARIABLES;
use tandem_model::{Alarm, Origin};
use tandem_syntax::{Block, Content, NcProgram};

use alarms::{alarm_for, value_lost};

use crate::block_words::{BlockWords, Reading};
use crate::codes::{Code, ModalGroup, feed_words};
use crate::dialect::{Dialect, MCodeTime};
use crate::evaluation::{Locals, Scope, VariableSource};
use crate::execution::{Draft, Execution, Flow, Limits};
use crate::fixed_cycles::{Expansion, StepResult};
use crate::inputs::Inputs;
use crate::modal::{Modal, RetainedData};
use crate::text_position::TextPosition;
use crate::{flow, restrictions};

pub use modal_state::ModalState;

/// A program on the call stack, with the place that the interpretation has reached.
#[derive(Debug)]
struct Frame {
    program: Arc<NcProgram>,
    number: u16,
    /// Index of the block to interpret next.
    next: usize,
    /// Number of times that the program runs again after its M99.
    repeats_left: u16,
    /// Place of the block interpreted last.
    origin: Origin,
}

/// State of the interpretation.
#[derive(Debug)]
enum InterpreterState {
    Running,
    Ended(Origin),
    Failed(Alarm),
}

/// Interprets the program of one coordinate system.
///
/// The items of a block come in this order: warnings, the transform, the motion (or [`Action::None`]), and
/// the items of its M code. An auxiliary output thus follows the motion of its block. In a dialect whose M
/// codes take effect before the motion, an output or a stop comes first. The setting of the M code determines
/// when the coordinator issues the output (D31, D32). In a block without motion, M00, M01, M02 and M30 have
/// only their own item; M98 and M99 have [`Action::None`], which ends a chain of blocks (M1c).
/// [`STEPS_IN_CHAIN_MAX`] blocks without an item also end a chain.
#[derive(Debug)]
pub struct Interpreter {
    dialect: &'static Dialect,
    limits: Limits,
    start_up: Modal,
    modal: Modal,
    /// Data that G10, G28 or G92 has set. `None` before the first such code.
    kept: Option<Arc<RetainedData>>,
    stack: Vec<Frame>,
    words: BlockWords,
    queue: VecDeque<Item>,
    /// The fixed cycle that is being expanded, with the place of its block.
    cycle: Option<(Box<Expansion>, Origin)>,
    /// L0 to L255 of each program on the call stack.
    locals: Vec<Locals>,
    /// Number of blocks since the last item that moves, waits or outputs.
    idle_steps: u32,
    /// True if a loop without an item reads P or Q: the program waits until another writer changes P or Q.
    is_waiting: bool,
    /// Numbers of the programs called since the start.
    called: BTreeSet<u16>,
    /// Number of blocks interpreted since the start.
    steps: u64,
    /// The first block that was read for the last item; `None` if no block was read for it.
    began: Option<Origin>,
    /// True before the first block in the start-up state, which selects the work coordinate system.
    opens: bool,
    state: InterpreterState,
}

/// Returns the error text for the call of a program that does not exist.
pub fn not_there(number: u16) -> String {
    format!("program {number} does not exist")
}

impl Interpreter {
    /// Creates an interpreter without a program, in the start-up modal state.
    pub fn new(settings: &CoordinateSystemSettings, dialect: &'static Dialect) -> Self {
        let start_up = Modal::start_up(dialect, settings);
        Self {
            dialect,
            limits: Limits::from_settings(settings),
            modal: start_up.clone(),
            start_up,
            kept: None,
            stack: Vec::with_capacity(CALL_DEPTH_MAX + 1),
            words: BlockWords::new(dialect),
            queue: VecDeque::with_capacity(4),
            cycle: None,
            locals: Vec::with_capacity(CALL_DEPTH_MAX + 1),
            idle_steps: 0,
            is_waiting: false,
            called: BTreeSet::new(),
            steps: 0,
            began: None,
            opens: false,
            state: InterpreterState::Ended(Origin::default()),
        }
    }

    /// Starts a program at its first block, in the start-up modal state. `number` is 0 for a program without a number.
    pub fn start(&mut self, program: Arc<NcProgram>, number: u16) {
        self.reset();
        self.start_in_modal(program, number);
    }

    /// Starts a program at its first block, in the current modal state: each text of manual data input
    /// continues from the state after the last one. The caller must pass the transform to the path stage.
    pub fn start_in_modal(&mut self, program: Arc<NcProgram>, number: u16) {
        self.forget_program();
        self.stack.push(Frame::new(program, number, 1));
        self.locals.push([0.0; LOCAL_VARIABLES]);
        self.state = InterpreterState::Running;
    }

    /// Removes the program, and restores the start-up modal state.
    pub fn reset(&mut self) {
        self.modal = self.start_up.clone();
        self.kept = None;
        self.forget_program();
        self.opens = true;
    }

    fn forget_program(&mut self) {
        self.queue.clear();
        self.cycle = None;
        self.idle_steps = 0;
        self.is_waiting = false;
        self.called.clear();
        self.steps = 0;
        self.stack.clear();
        self.locals.clear();
        self.state = InterpreterState::Ended(Origin::default());
    }

    /// Returns the numbers of the programs that were called since the start, ascending.
    pub fn called(&self) -> impl Iterator<Item = u16> {
        self.called.iter().copied()
    }

    /// Returns true if all items of the last interpreted block have been returned.
    pub fn is_between_blocks(&self) -> bool {
        self.queue.is_empty() && self.cycle.is_none()
    }

    /// Returns the next item. After [`Item::End`] and after an alarm, returns the same result until
    /// [`Interpreter::start`].
    ///
    /// # Errors
    /// Returns an alarm that stops the coordinate system, before any item of the faulty block. Causes are a
    /// value out of its range (D11) or not finite (D07), a lost variable, a missing program (D12), a missing
    /// end, and a program with errors. Another cause is a row of more than `blocks_without_motion_max` blocks
    /// that give no item and read neither P nor Q.
    pub fn next(&mut self, inputs: &Inputs<'_>) -> Result<Item, Alarm> {
        let item = self.next_unless(inputs, |_, _| false)?;
        Ok(item.unwrap_or_else(|| Item::End(self.origin())))
    }

    /// Returns the next item like [`Interpreter::next`], but returns `None` before a block for which
    /// `is_awaited` returns true. The arguments of `is_awaited` are the number of the block's program and the
    /// index of the block in it. If the result is `None`, the block has not been interpreted, and all
    /// preceding items have been returned. `is_awaited` is called once for each block that is interpreted.
    ///
    /// # Errors
    /// Fails like [`Interpreter::next`].
    #[inline]
    pub fn next_unless(
        &mut self,
        inputs: &Inputs<'_>,
        mut is_awaited: impl FnMut(u16, usize) -> bool,
    ) -> Result<Option<Item>, Alarm> {
        self.began = None;
        loop {
            if self.queue.is_empty() {
                self.queue_cycle();
            }
            if let Some(item) = self.queue.pop_front() {
                // an item that moves, waits or outputs resets the count of idle blocks
                if has_effect(&item) {
                    self.idle_steps = 0;
                    self.is_waiting = false;
                }
                return Ok(Some(item));
            }
            match &self.state {
                InterpreterState::Running => {}
                InterpreterState::Ended(origin) => return Ok(Some(Item::End(*origin))),
                InterpreterState::Failed(alarm) => return Err(alarm.clone()),
            }
            if let Some(frame) = self.stack.last()
                && is_awaited(frame.number, frame.next)
            {
                return Ok(None);
            }
            self.idle_steps += 1;
            self.steps += 1;
            let steps_max = self.limits.blocks_without_motion_max;
            let step = if self.idle_steps > steps_max {
                let text = format!("{steps_max} blocks in a row gave neither motion nor output");
                Err(Alarm::new(&STEP_LIMIT, text))
            } else {
                self.step(inputs)
            };
            if let Err(alarm) = step {
                let origin = alarm.origin.unwrap_or_else(|| self.origin());
                self.state = InterpreterState::Failed(alarm.at(origin));
            } else if self.queue.is_empty() && self.idle_steps.is_multiple_of(STEPS_IN_CHAIN_MAX) {
                self.queue_action(Some(Action::None), [false; 2], self.origin());
            }
        }
    }

    /// Returns the number of blocks interpreted since the start of the program, including skipped ones.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Returns the modal state after the last interpreted block.
    pub fn modal(&self) -> &Modal {
        &self.modal
    }

    /// Returns the place reached in each program on the call stack, the main program first. For a caller,
    /// this place is the calling block; for the last program, the block interpreted last. The places remain
    /// after the end until the next start.
    pub fn call_stack(&self) -> impl Iterator<Item = Origin> {
        self.stack.iter().map(|frame| frame.origin)
    }

    /// Returns the first block, including skipped ones, that was read for the last item; `None` if no block
    /// was read for it.
    pub fn began(&self) -> Option<Origin> {
        self.began
    }

    /// Returns the place of the block interpreted last.
    fn origin(&self) -> Origin {
        self.stack.last().map(|frame| frame.origin).unwrap_or_default()
    }

    /// Interprets one block and puts its items into the queue.
    fn step(&mut self, inputs: &Inputs<'_>) -> Result<(), Alarm> {
        let Some(frame) = self.stack.last_mut() else {
            self.state = InterpreterState::Ended(Origin::default());
            return Ok(());
        };
        let Some(block) = frame.program.blocks().get(frame.next) else {
            let ends = self.dialect.names("or", Code::ends);
            let text = format!("program {} has no block left and no {ends}", frame.number);
            return Err(Alarm::new(&PROGRAM_END_MISSING, text));
        };
        let origin = frame.program.origin(block, frame.number);
        self.began.get_or_insert(origin);
        if block.skip_numbers() & inputs.optional_skip != 0 {
            frame.next += 1;
            return Ok(());
        }
        let block = *block;
        frame.origin = origin;
        if block.has_errors() {
            return Err(Alarm::new(&PROGRAM_HAS_ERRORS, "the block has an error"));
        }
        if inputs.captured.is_none() && flow::reads_captured_position(&frame.program, &block) {
            self.queue.push_back(Item::NeedsStandstill(origin));
            return Ok(());
        }
        frame.next += 1;
        if let Content::ProgramCode(_) = block.content {
            return self.program_code(&block, origin, inputs);
        }
        self.g_code_block(&block, origin, inputs)
    }

    /// Interprets a program code.
    #[inline(never)]
    fn program_code(&mut self, block: &Block, origin: Origin, inputs: &Inputs<'_>) -> Result<(), Alarm> {
        let (Some(frame), Some(locals)) = (self.stack.last_mut(), self.locals.last_mut()) else {
            return Ok(());
        };
        flow::run(&frame.program, block, &mut frame.next, locals, inputs)
            .map_err(|variable| value_lost(variable).at(origin))?;
        let may_wait = self.is_waiting || self.idle_steps > STEPS_BEFORE_WAIT;
        if may_wait && flow::reads_shared(&frame.program, block) {
            self.is_waiting = true;
            self.idle_steps = 0;
            self.queue_action(Some(Action::None), [false; 2], origin);
        }
        Ok(())
    }

    /// Interprets a block of words.
    fn g_code_block(&mut self, block: &Block, origin: Origin, inputs: &Inputs<'_>) -> Result<(), Alarm> {
        let (Some(frame), Some(locals)) = (self.stack.last_mut(), self.locals.last()) else {
            return Ok(());
        };
        let (mut fault, lost) = (None, Cell::new(None));
        // the position is unknown here: only the path stage calculates it
        let position = TextPosition::unknown();
        let reading = Reading {
            dialect: self.dialect,
            modal: &self.modal,
            known: VariableSource::Run(Scope {
                locals,
                variables: inputs.variables,
                captured: inputs.captured.as_ref(),
                lost: &lost,
            }),
            position: &position,
            arc_radius_tolerance_mm: self.limits.arc_radius_tolerance_mm,
            options: &self.limits.options,
        };
        self.words.read(&frame.program, block, &reading, &mut |found| {
            if found.is_error() {
                fault.get_or_insert(found);
            }
        });
        if let Some(variable) = lost.get() {
            return Err(value_lost(variable).at(origin));
        }
        if let Some(fault) = fault {
            let word = frame.program.origin_within(block, fault.span.start, frame.number);
            return Err(alarm_for(&fault).at(word));
        }
        let may_wait = inputs.position.is_none();
        let before = may_wait.then(|| (self.modal.clone(), self.kept.clone()));
        let mut draft = Draft::default();
        let opens = std::mem::take(&mut self.opens);
        execute(&mut Execution {
            dialect: self.dialect,
            words: &self.words,
            modal: &mut self.modal,
            kept: &mut self.kept,
            inputs,
            limits: &self.limits,
            place: 0,
            opens,
            draft: &mut draft,
        });
        if draft.needs_position
            && let Some(before) = before
        {
            (self.modal, self.kept) = before;
            self.opens = opens;
            frame.next -= 1;
            self.queue.push_back(Item::NeedsStandstill(origin));
            return Ok(());
        }
        if let Some(alarm) = draft.alarm.take() {
            return Err(alarm);
        }
        let flow = draft.flow;
        let may_be_first = matches!(flow, Flow::Output { .. } | Flow::Stop { .. });
        if may_be_first && self.dialect.policy.m_code == MCodeTime::BeforeMotion {
            self.execute_m_code(flow, origin, inputs)?;
            self.queue_block(&mut draft, origin);
            return Ok(());
        }
        self.queue_block(&mut draft, origin);
        self.execute_m_code(flow, origin, inputs)
    }

    /// Queues the next item of the fixed cycle that is being expanded.
    fn queue_cycle(&mut self) {
        let Some((cycle, origin)) = &mut self.cycle else {
            return;
        };
        let origin = *origin;
        match cycle.advance() {
            Some(StepResult::Motion(action)) => self.queue_action(Some(action), [false; 2], origin),
            Some(StepResult::Output(m)) => self.queue.push_back(Item::Output(Output {
                origin,
                m,
                params: [None; 8],
            })),
            None => self.cycle = None,
        }
    }

    /// Queues the warnings, the transform and the motion of a block.
    fn queue_block(&mut self, draft: &mut Draft, origin: Origin) {
        for text in draft.warnings.drain(..) {
            self.queue.push_back(Item::Warning(origin, text));
        }
        // the item of a stop or an end also ends a chain of motions
        let own_item = match draft.flow {
            Flow::Stop { .. } | Flow::End => true,
            Flow::Return => self.stack.len() == 1,
            Flow::Next | Flow::Output { .. } | Flow::Call { .. } => false,
        };
        let cycle = draft.cycle.take();
        let silent = own_item || draft.transforms || cycle.is_some() || !self.words.any;
        let action = draft.action.take().or((!silent).then_some(Action::None));
        let transform = draft
            .transforms
            .then(|| Action::Transform(Box::new(self.modal.transform)));
        let stops = draft.exact_stops;
        // G09 acts on the motion of the block, or on the transform if the block has no motion.
        let stops_of_transform = if action.is_some() { [false; 2] } else { stops };
        if draft.transform_after {
            self.queue_action(action, stops, origin);
            self.queue_action(transform, stops_of_transform, origin);
        } else {
            self.queue_action(transform, stops_of_transform, origin);
            self.queue_action(action, stops, origin);
        }
        self.cycle = cycle.map(|cycle| (cycle, origin));
    }

    /// Queues a block with the modal state. `stops` are the exact stops before and after the block.
    fn queue_action(&mut self, action: Option<Action>, stops: [bool; 2], origin: Origin) {
        let Some(action) = action else { return };
        let [exact_stop_before, exact_stop_after] = stops;
        self.queue.push_back(Item::Block(FlowBlock {
            origin,
            action,
            feed: self.modal.feed(),
            unit: self.modal.in_force.unit.unwrap_or_default(),
            feedrate_deg_min: self.modal.feedrate_deg_min,
            path_control: self.modal.path_control(),
            exact_stop_before,
            exact_stop_after,
            multi_block: self.modal.multi_block(),
            compensation: self.modal.compensation,
        }));
    }

    /// Executes the M code of a block.
    fn execute_m_code(&mut self, flow: Flow, origin: Origin, inputs: &Inputs<'_>) -> Result<(), Alarm> {
        match flow {
            Flow::Next => {}
            Flow::Output { m, params } => self.queue.push_back(Item::Output(Output { origin, m, params })),
            Flow::Stop { optional } => self.queue.push_back(Item::Stop(ProgramStop { origin, optional })),
            Flow::End => self.state = InterpreterState::Ended(origin),
            Flow::Call { program, times } => return self.call(program, times, origin, inputs),
            Flow::Return => self.leave(origin),
        }
        Ok(())
    }

    fn call(&mut self, number: u16, times: u16, origin: Origin, inputs: &Inputs<'_>) -> Result<(), Alarm> {
        if times == 0 {
            return Ok(());
        }
        // the main program is on the stack, but is not a call
        if self.stack.len() > CALL_DEPTH_MAX {
            let text =
                format!("the call of program {number} is nested deeper than {CALL_DEPTH_MAX} and is skipped");
            self.queue.push_back(Item::Warning(origin, text));
            return Ok(());
        }
        let Some(program) = inputs.programs.get(&number) else {
            self.queue.clear();
            return Err(Alarm::new(&PROGRAM_NOT_FOUND, not_there(number)));
        };
        self.called.insert(number);
        self.stack.push(Frame::new(Arc::clone(program), number, times));
        self.locals.push([0.0; LOCAL_VARIABLES]);
        Ok(())
    }

    /// Executes M99: repeats the called program, continues with the caller, or ends the main program.
    fn leave(&mut self, origin: Origin) {
        let called = self.stack.len() > 1;
        match self.stack.last_mut() {
            Some(frame) if frame.repeats_left > 0 => {
                frame.repeats_left -= 1;
                frame.next = 0;
                if let Some(locals) = self.locals.last_mut() {
                    *locals = [0.0; LOCAL_VARIABLES];
                }
            }
            Some(_) if called => {
                self.stack.pop();
                self.locals.pop();
            }
            _ => self.state = InterpreterState::Ended(origin),
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

/// Applies the effects of a block in order: modal codes, feed words, codes that are not modal, motion, M
/// code.
fn execute(execution: &mut Execution<'_>) {
    let words = execution.words;
    let modal_codes = || {
        words
            .g_codes()
            .iter()
            .filter(|(code, _)| code.group != ModalGroup::NonModal)
    };
    restrictions::follow(words, execution.modal);
    if execution.opens {
        select_start_up_offset(execution);
    }
    // all modal codes become active before the first of them takes effect: words may be in any order (D02)
    for (code, _) in modal_codes() {
        if code.group == ModalGroup::Motion {
            execution.modal.end_cycle(execution.dialect);
        }
        execution.modal.remember(code);
    }
    for (code, place) in modal_codes() {
        execution.place = *place;
        (code.select)(execution);
    }
    feed_words::store_feed_words(execution);
    for (code, place) in words.g_codes() {
        if code.group == ModalGroup::NonModal {
            execution.place = *place;
            (code.select)(execution);
        }
    }
    let taker = execution.modal.taker();
    let starts_cycle = taker.is_some_and(|taker| {
        taker.group == ModalGroup::FixedCycle && words.codes().any(|code| code == taker)
    });
    if (starts_cycle || !words.taken.is_empty())
        && let Some(motion) = taker.and_then(|taker| taker.motion)
    {
        let axis_words = execution.axis_words();
        motion(execution, axis_words);
    }
    if let Some(code) = words.m_code() {
        (code.select)(execution);
    }
}

/// Selects the work coordinate system that is active in the start-up state.
fn select_start_up_offset(execution: &mut Execution<'_>) {
    let group = |code: &&&Code| code.group == ModalGroup::WorkCoordinates;
    if let Some(code) = execution.dialect.start_up.iter().find(group) {
        (code.select)(execution);
    }
}

/// Returns true for items that move, wait or output.
fn has_effect(item: &Item) -> bool {
    match item {
        Item::Block(block) => !matches!(
            block.action,
            Action::None | Action::Transform(_) | Action::ThreadAhead(_)
        ),
        Item::Output(_) | Item::Stop(_) => true,
        Item::NeedsStandstill(_) | Item::Warning(..) | Item::End(_) => false,
    }
}

#[cfg(test)]
mod tests;
