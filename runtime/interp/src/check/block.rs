//! Checks a block of words in one state: finds the faults of the block, and the state after the block.

use tandem_model::Diagnostic;
use tandem_model::limits::{BLOCK_BYTES_MAX, CALL_DEPTH_MAX};
use tandem_model::plane::Plane;
use tandem_model::settings::{ARC_RADIUS_TOLERANCE_MM, CompensationRules};
use tandem_syntax::{Address, Block, Value, Word, block_bytes, diagnostics};

use super::explore::{BlockOutcome, Explorer, Next, returned};
use super::graph::{BlockPosition, Call, CurrentBlock, Decision, Reachability};
use super::state::{Caller, CheckState};
use super::verdict::Weight;
use crate::block_words::{BlockWords, Reading};
use crate::codes::value::validate_value;
use crate::codes::{Code, ModalGroup};
use crate::dialect::Dialect;
use crate::evaluation::{Trust, VariableSource};
use crate::meaning::{ModalValue, MotionKind, Role};
use crate::restrictions;

/// Length in bytes up to which a block cannot exceed the limit of the intermediate code. There, each word of
/// two bytes or more has an extra blank, and numbers and operators of expressions have two.
const LONG_BYTES: u32 = 300;

/// Maximum number of repetitions of a call that are counted; a larger number is treated as unknown.
const REPETITIONS_COUNTED: u16 = 16;

impl Explorer<'_> {
    /// Checks a block of words, and updates the state.
    pub(super) fn block(&mut self, here: CurrentBlock<'_>, state: &mut CheckState) -> BlockOutcome {
        let CurrentBlock { block, .. } = here;
        let before = (block.skip_numbers() != 0).then(|| state.clone());
        self.length(here, state);
        self.read(here, state);
        self.arc_end(here, state);
        follow(self.dialect, &self.words, block, state);
        if let Some(shown) = &mut self.shown {
            follow(self.dialect, &self.words, block, shown);
        }
        self.rest_in_offset(here, state);
        self.cycle_outputs(here);
        self.context_of_words(here, state);
        self.arc_words(here, state);
        if !(state.has_feed && state.has_speed) && self.is_real(here.node) {
            self.feed_and_speed(here, state);
        }
        if self.words.any {
            state.values.pass_time();
        }
        let Some(before) = before else {
            return self.m_code(here, state);
        };
        let step = self.m_code(here, state);
        self.skippable(here, step, before, state)
    }

    /// Returns two states for a block that may be skipped, if the block changes the modal state or the path.
    #[inline(never)]
    fn skippable(
        &self,
        here: CurrentBlock<'_>,
        step: BlockOutcome,
        mut before: CheckState,
        state: &mut CheckState,
    ) -> BlockOutcome {
        let moved = self.words.axis_words;
        before.lose(moved);
        state.lose(moved);
        let is_plain = matches!(step, BlockOutcome::On)
            && before.modal == state.modal
            && before.has_feed == state.has_feed
            && before.has_speed == state.has_speed
            && before.is_open == state.is_open;
        if is_plain {
            state.at_rest = state.at_rest.min(before.at_rest);
            return BlockOutcome::On;
        }
        let on = here.next_position();
        let mut parts = match step {
            BlockOutcome::On => vec![Next {
                place: on,
                state: state.clone(),
                way: Decision::Skip(false),
                kind: Reachability::Real,
            }],
            BlockOutcome::Parts(parts) => parts
                .into_iter()
                .filter(|part| part.kind == Reachability::Real)
                .map(|part| Next {
                    way: Decision::Skip(false),
                    ..part
                })
                .collect(),
        };
        parts.push(Next {
            place: on,
            state: before,
            way: Decision::Skip(true),
            kind: Reachability::Real,
        });
        // if the block ends the program, a run may also end here: the second part makes the next block
        // uncertain
        if parts.len() == 1 {
            parts.push(Next {
                place: on,
                state: parts[0].state.clone(),
                way: Decision::Skip(true),
                kind: Reachability::Real,
            });
        }
        BlockOutcome::Parts(parts)
    }

    /// Reports a block that is too long as a line of the intermediate code (D03).
    fn length(&mut self, here: CurrentBlock<'_>, state: &CheckState) {
        let CurrentBlock { tree, block, .. } = here;
        let span = tree.span(block);
        if span.end - span.start <= LONG_BYTES || block.has_errors() {
            return;
        }
        let cycle = state.modal.fixed_cycle();
        let code = cycle.and_then(|_| state.modal.code(ModalGroup::FixedCycle));
        let code = code.map(|code| code.code);
        if block_bytes(tree, block, code, self.dialect) > BLOCK_BYTES_MAX {
            let finding = diagnostics::BLOCK_TOO_LONG.at(
                span,
                format!("the block's line in the intermediate code is longer than {BLOCK_BYTES_MAX} bytes"),
                "Write the words in several blocks.",
            );
            self.record_finding(here, finding, Weight::Sure);
        }
    }

    /// Reads the words in the given state, and records their faults.
    fn read(&mut self, here: CurrentBlock<'_>, state: &CheckState) {
        let mut found = Vec::new();
        self.read_with(here, state, Trust::Own, &mut found);
        if state.is_open || !self.words.indirect.is_empty() || !found.is_empty() {
            self.classify_findings(here, state, found);
        }
    }

    /// Records the findings, including those that depend on values or modal states that the text does not
    /// fully show.
    #[inline(never)]
    fn classify_findings(&mut self, here: CurrentBlock<'_>, state: &CheckState, mut found: Vec<Diagnostic>) {
        if state.is_open {
            self.read_in_all(here, state, &mut found);
        }
        if !self.words.indirect.is_empty() {
            self.report_ranges(here, state, &mut found);
        }
        let is_doubtful = !self.words.doubtful.is_empty();
        if is_doubtful || !self.calculates(here.node) && !found.is_empty() {
            self.read_by_trust(here, state, &mut found);
        }
        for finding in found {
            self.record_finding(here, finding, Weight::Sure);
        }
    }

    /// Records the findings that depend on calculated values, on the path, or on values that another writer
    /// may have changed. Leaves in `found` the findings that the text alone shows.
    fn read_by_trust(&mut self, here: CurrentBlock<'_>, state: &CheckState, found: &mut Vec<Diagnostic>) {
        if !self.words.doubtful.is_empty() {
            let mut believed = Vec::new();
            self.read_with(here, state, Trust::Believed, &mut believed);
            for finding in believed.into_iter().filter(|finding| !found.contains(finding)) {
                self.record_finding(here, finding, Weight::Doubtful);
            }
        }
        if !self.calculates(here.node) && !found.is_empty() {
            let mut written = Vec::new();
            let shown = self.shown.take();
            let of_text = shown.as_ref().unwrap_or(state);
            self.read_with(here, of_text, Trust::None, &mut written);
            if of_text.is_open && !self.is_real(here.node) {
                self.read_in_all(here, of_text, &mut written);
            }
            self.shown = shown;
            let (sure, calculated) = std::mem::take(found)
                .into_iter()
                .partition(|finding| written.contains(finding));
            *found = sure;
            let calculated: Vec<Diagnostic> = calculated;
            for finding in calculated {
                self.record_finding(here, finding, Weight::Calculated);
            }
        }
        self.read_with(here, state, Trust::Own, &mut Vec::new());
    }

    fn read_with(
        &mut self,
        here: CurrentBlock<'_>,
        state: &CheckState,
        trust: Trust,
        found: &mut Vec<Diagnostic>,
    ) {
        let CurrentBlock { tree, block, .. } = here;
        let reading = Reading {
            dialect: self.dialect,
            modal: &state.modal,
            known: VariableSource::Text {
                values: &state.values,
                trust,
            },
            position: &state.position,
            arc_radius_tolerance_mm: self
                .context
                .arc_radius_tolerance_mm
                .unwrap_or(ARC_RADIUS_TOLERANCE_MM),
            options: &self.context.options,
        };
        self.words
            .read(tree, block, &reading, &mut |finding| found.push(finding));
    }

    /// If the motion or the plane is unknown, adds the faults that occur with every possible motion and
    /// plane.
    fn read_in_all(&mut self, here: CurrentBlock<'_>, state: &CheckState, found: &mut Vec<Diagnostic>) {
        let is_arc = |code: &Code| code.role == Role::Motion(MotionKind::Arc);
        let no_plane = state.modal.in_force.plane.is_none() && self.words.taker.is_some_and(is_arc);
        if !(no_plane || self.words.is_taking_unclear()) {
            return;
        }
        let takers: Vec<Option<&'static Code>> = if self.words.taker.is_some() {
            vec![None]
        } else {
            let all = self.dialect.g_codes.codes.iter().copied();
            let takes = |code: &&Code| {
                code.motion.is_some() && matches!(code.group, ModalGroup::Motion | ModalGroup::FixedCycle)
            };
            all.filter(takes).map(Some).collect()
        };
        let planes: &[Option<Plane>] = match state.modal.in_force.plane {
            Some(_) => &[None],
            None => &[Some(Plane::Xy), Some(Plane::Zx), Some(Plane::Yz)],
        };
        let mut first = None;
        let mut all_wrong = true;
        let mut common: Option<Vec<Diagnostic>> = None;
        for (taker, plane) in takers
            .iter()
            .flat_map(|taker| planes.iter().map(move |plane| (taker, plane)))
        {
            let mut supposed = state.clone();
            if let Some(taker) = taker {
                supposed.modal.remember(taker);
            }
            if let Some(plane) = plane {
                supposed.modal.in_force.set(ModalValue::Plane(*plane));
            }
            let mut wrong = Vec::new();
            self.read_with(here, &supposed, Trust::Own, &mut wrong);
            let is_in = |all: &[Diagnostic], one: &Diagnostic| {
                all.iter()
                    .any(|other| other.code == one.code && other.span.start == one.span.start)
            };
            all_wrong &= wrong.iter().any(Diagnostic::is_error);
            first.get_or_insert_with(|| wrong.clone());
            common = Some(match common {
                None => wrong,
                Some(common) => common.into_iter().filter(|one| is_in(&wrong, one)).collect(),
            });
        }
        self.read_with(here, state, Trust::Own, &mut Vec::new());
        let mut more = common.unwrap_or_default();
        if more.is_empty() && all_wrong {
            // every motion or plane gives a fault, but not the same fault
            more = first.unwrap_or_default();
        }
        let known = |one: &Diagnostic, found: &[Diagnostic]| {
            found
                .iter()
                .any(|other| other.code == one.code && other.span == one.span)
        };
        for finding in more {
            if !known(&finding, found) {
                found.push(finding);
            }
        }
    }

    /// Reports words that are out of range for every possible value of their variable.
    fn report_ranges(&self, here: CurrentBlock<'_>, state: &CheckState, found: &mut Vec<Diagnostic>) {
        let CurrentBlock { tree, block, .. } = here;
        for word in tree.words(block) {
            let Value::Indirection(variable) = word.value() else {
                continue;
            };
            let range = state.values.get(variable);
            let unbounded = range.low.is_infinite() && range.high.is_infinite();
            if range.value().is_some() || range.nan || !range.own || unbounded {
                continue;
            }
            let Some(spec) = self.words.spec(word.address, self.dialect) else {
                continue;
            };
            let outside = |value: f64| !spec.holds(value);
            let (near, far) = if range.low.abs() < range.high.abs() {
                (range.low, range.high)
            } else {
                (range.high, range.low)
            };
            let apart = range.low > spec.max || range.high < spec.min;
            if apart && outside(near) && outside(far) {
                validate_value(spec, near, word.span(), &mut |finding| found.push(finding));
            }
        }
    }

    /// Warns of two consecutive blocks without motion in the plane, in tool-diameter offset without a check
    /// for overcuts.
    fn rest_in_offset(&mut self, here: CurrentBlock<'_>, state: &mut CheckState) {
        let CurrentBlock { tree, block, .. } = here;
        let unchecked = self.dialect.path.compensation == CompensationRules::Unchecked;
        let within = unchecked && state.modal.compensates() && !state.modal.lead_pending;
        let at_rest = state.at_rest;
        state.at_rest = if within && !restrictions::moves_in_plane(&self.words, &state.modal) {
            at_rest.saturating_add(1).min(3)
        } else {
            0
        };
        if state.at_rest == 2 && at_rest == 1 {
            let finding = diagnostics::BLOCKS_AT_REST.at(
                tree.span(block),
                "the second block in a row without a motion along X or Y in tool-diameter offset",
                "Move one of the two blocks.",
            );
            self.record_finding(here, finding, Weight::Sure);
        }
    }

    /// Records the M codes that the fixed cycle of the block outputs.
    fn cycle_outputs(&mut self, here: CurrentBlock<'_>) {
        let Some(taker) = self.words.taker else { return };
        let Some(ModalValue::Cycle(Some(cycle))) = taker.sets else {
            return;
        };
        let starts = self.words.codes().any(|code| code == taker);
        if starts || !self.words.taken.is_empty() {
            for m in cycle.outputs(self.context.has_spindle) {
                self.auxiliary(here, m, true);
            }
        }
    }

    fn auxiliary(&mut self, here: CurrentBlock<'_>, number: u16, needs_settings: bool) {
        let CurrentBlock {
            place, tree, block, ..
        } = here;
        let span = tree.span_of(block, Address::M);
        let first = self.programs[place.program]
            .m_codes
            .entry(number)
            .or_insert((span, needs_settings));
        if span.start < first.0.start {
            *first = (span, needs_settings);
        }
    }

    /// Applies the M code of the block.
    #[inline]
    fn m_code(&mut self, here: CurrentBlock<'_>, state: &mut CheckState) -> BlockOutcome {
        match self.words.m_code() {
            Some(code) => self.apply_m_code(here, code, state),
            None => BlockOutcome::On,
        }
    }

    #[inline(never)]
    fn apply_m_code(
        &mut self,
        here: CurrentBlock<'_>,
        code: &'static Code,
        state: &mut CheckState,
    ) -> BlockOutcome {
        let CurrentBlock { place, .. } = here;
        let after = |kind, state: &CheckState| Next {
            place: BlockPosition {
                block: place.block + 1,
                ..place
            },
            state: state.clone(),
            way: Decision::On,
            kind,
        };
        match code.role {
            Role::Auxiliary => {
                let needs_settings = *code == *self.dialect.auxiliary;
                self.auxiliary(here, self.words.m_number(), needs_settings);
                BlockOutcome::On
            }
            Role::Call => self.call(here, code, state),
            Role::Return if !state.callers.is_empty() => BlockOutcome::Parts(returned(state, place)),
            _ if code.ends() => BlockOutcome::Parts(vec![after(Reachability::Supposed, state)]),
            _ => BlockOutcome::On,
        }
    }

    /// Returns the program number and the number of runs of a call; `None` for a value that is unknown.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the range is tested, and a cast saturates"
    )]
    fn number_and_times(&self, code: &Code) -> (Option<u16>, Option<u16>) {
        let known = |address| {
            let value = self.words.get(address).filter(|value| value.is_finite())?;
            let spec = code.word(address).filter(|word| word.holds(value));
            let is_whole = value.fract().abs() <= 0.0;
            spec.filter(|_| is_whole).map(|_| value as u16)
        };
        let is_repeated = self.words.get(Address::L).is_some();
        let times = if is_repeated { known(Address::L) } else { Some(1) };
        (known(Address::P), times)
    }

    #[inline(never)]
    fn call(&mut self, here: CurrentBlock<'_>, code: &Code, state: &mut CheckState) -> BlockOutcome {
        let CurrentBlock {
            place, tree, block, ..
        } = here;
        let (number, times) = self.number_and_times(code);
        let is_none = |word: &Word| word.address == Address::L && word.whole() == Some(0);
        if tree.words(block).iter().any(is_none) {
            return BlockOutcome::On;
        }
        let of = &mut self.programs[place.program];
        let Some(number) = number else {
            of.calls_any = true;
            state.forget_all();
            return BlockOutcome::On;
        };
        let span = tree.span_of(block, Address::P);
        let call = of.programs.entry(number).or_insert(Call {
            span,
            is_missing: false,
        });
        if span.start < call.span.start {
            call.span = span;
        }
        // the called program is checked even if it is called 0 times
        let program = self.called(number);
        if times == Some(0) {
            return BlockOutcome::On;
        }
        // the checker reports a call in a fixed cycle, and assumes that a G80 is missing before the call
        if state.modal.fixed_cycle().is_some() {
            state.modal.end_cycle(self.dialect);
        }
        if state.callers.len() >= CALL_DEPTH_MAX {
            let text = format!(
                "on one path, the call of program {number} is nested deeper than {CALL_DEPTH_MAX}, and is skipped"
            );
            let help = "Call the program at a lower depth, or write its blocks here.";
            self.record_finding(
                here,
                diagnostics::CALL_TOO_DEEP.at(span, text, help),
                Weight::Sure,
            );
            return BlockOutcome::On;
        }
        let Some(program) = program else {
            let is_missing = self.context.programs.is_some();
            if let Some(call) = self.programs[place.program].programs.get_mut(&number) {
                call.is_missing = is_missing;
            }
            state.forget_all();
            return BlockOutcome::On;
        };
        let mut inside = state.clone();
        let locals = inside.values.enter();
        inside.callers.push(Caller {
            program: place.program,
            block: place.block + 1,
            repetitions: times
                .map(|times| times - 1)
                .filter(|left| *left <= REPETITIONS_COUNTED),
            locals,
        });
        BlockOutcome::Parts(vec![Next {
            place: BlockPosition { program, block: 0 },
            state: inside,
            way: Decision::Called,
            kind: Reachability::Real,
        }])
    }
}

/// Updates the state after a block of words.
#[inline]
fn follow(dialect: &'static Dialect, words: &BlockWords, block: &Block, state: &mut CheckState) {
    restrictions::follow(words, &mut state.modal);
    for code in words.codes() {
        match code.group {
            ModalGroup::NonModal => {}
            ModalGroup::Motion if code.motion.is_some() => {
                state.modal.end_cycle(dialect);
                state.modal.remember(code);
            }
            _ => state.modal.remember(code),
        }
    }
    state.position.follow(words, &state.modal);
    if block.has_errors() {
        state.forget();
    }
}
