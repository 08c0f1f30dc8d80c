//! Words of one block, sorted: the codes, the code that takes each word, and the values. The rules of a
//! single block are checked only here: the checker lists violations, and the interpreter raises an alarm.

use tandem_model::limits::M_CODE_MAX;
use tandem_model::settings::{MCodeSet, NcOptions};
use tandem_model::{Diagnostic, Span};
use tandem_syntax::{Address, AddressSet, Block, NcProgram, Value, Variable, Word, diagnostics};

use crate::codes::value::validate_value;
use crate::codes::{AXIS_ADDRESSES, Code, ModalGroup, Refusal, WordSpec, tenths};
use crate::dialect::{Dialect, GroupConflict, Numbers, OtherMCodes};
use crate::evaluation::{Trust, VariableSource};
use crate::meaning::{InForce, Role};
use crate::modal::Modal;
use crate::text_position::TextPosition;
use crate::{numbers, restrictions};

/// Addresses other than axes whose words arcs and fixed cycles take.
const MOTION_WORDS: AddressSet =
    AddressSet::from_addresses(&[Address::I, Address::J, Address::K, Address::R, Address::P]);

/// Maximum number of G codes in a block: one of each modal group, G09, and one other code that is not modal.
const G_CODES_MAX: usize = ModalGroup::COUNT + 1;

/// Addresses VA to VH: the parameters of M codes.
const PARAMETERS: AddressSet = AddressSet::from_addresses(&[
    Address::Va,
    Address::Vb,
    Address::Vc,
    Address::Vd,
    Address::Ve,
    Address::Vf,
    Address::Vg,
    Address::Vh,
]);

/// Words of one block, with the codes that take them.
#[derive(Debug)]
pub struct BlockWords {
    /// Addresses of the words in the block, except G, M and N.
    pub present: AddressSet,
    values: [f64; Address::COUNT],
    g_codes: [(&'static Code, usize); G_CODES_MAX],
    g_count: usize,
    m_code: Option<(&'static Code, u16)>,
    /// Addresses that the codes of the block take, motions and fixed cycles excepted.
    pub own: AddressSet,
    /// Addresses of the axis words that the active motion or fixed cycle takes.
    pub axis_words: AddressSet,
    /// Index of the first axis word among the words of the block.
    pub first_axis_place: Option<usize>,
    /// The motion or fixed cycle that takes words of the block. `None` if it is unknown, or if another code
    /// of the block takes axis words.
    pub(crate) taker: Option<&'static Code>,
    /// Addresses that `taker` can take, kept from block to block because `taker` rarely changes.
    taker_addresses: AddressSet,
    /// Addresses of the words of the block that `taker` takes.
    pub(crate) taken: AddressSet,
    /// Addresses of malformed words, whose value is NaN.
    refused: AddressSet,
    /// Addresses of words with a variable in place of a number.
    pub(crate) indirect: AddressSet,
    /// Addresses of words with a variable whose value the text does not show.
    unknown: AddressSet,
    /// Addresses of words with a variable that another writer may have changed after the program wrote it.
    pub(crate) doubtful: AddressSet,
    /// True if a code of the block is unknown; a word that no other code takes may belong to the unknown
    /// code.
    unknown_code: bool,
    /// True if the block has a word other than its block number (N).
    pub any: bool,
}

/// Data that the reading of a block needs, in addition to the block.
#[derive(Clone, Copy)]
pub(crate) struct Reading<'a> {
    /// Dialect of the program.
    pub(crate) dialect: &'static Dialect,
    /// Modal state before the block. If this state has no motion code, the code that takes axis words is
    /// unknown.
    pub(crate) modal: &'a Modal,
    /// Source of the values of variables in words such as `X[L12]`.
    pub(crate) known: VariableSource<'a>,
    /// Position at the start of the block; NaN for each axis whose position the text does not show.
    pub(crate) position: &'a TextPosition,
    /// Amount by which the radius R of an arc may be smaller than half the chord, mm (D26).
    pub(crate) arc_radius_tolerance_mm: f64,
    /// Settings that select how numbers are read.
    pub(crate) options: &'a NcOptions,
}

impl BlockWords {
    pub(crate) fn new(dialect: &Dialect) -> Self {
        Self {
            present: AddressSet::EMPTY,
            values: [0.0; Address::COUNT],
            g_codes: [(dialect.g_codes.codes[0], 0); G_CODES_MAX],
            g_count: 0,
            m_code: None,
            own: AddressSet::EMPTY,
            axis_words: AddressSet::EMPTY,
            first_axis_place: None,
            taker: None,
            taker_addresses: AddressSet::EMPTY,
            taken: AddressSet::EMPTY,
            refused: AddressSet::EMPTY,
            indirect: AddressSet::EMPTY,
            unknown: AddressSet::EMPTY,
            doubtful: AddressSet::EMPTY,
            unknown_code: false,
            any: false,
        }
    }

    /// Returns the value of a word, or `None` if the block has no such word. A variable of unknown value
    /// gives NaN.
    pub fn get(&self, address: Address) -> Option<f64> {
        self.present
            .contains(address)
            .then(|| self.values[address as usize])
    }

    /// Returns the G codes in the order of the text, each with the index of its word in the block.
    pub fn g_codes(&self) -> &[(&'static Code, usize)] {
        &self.g_codes[..self.g_count]
    }

    /// Returns the G codes without the indices of their words.
    pub(crate) fn codes(&self) -> impl Iterator<Item = &'static Code> {
        self.g_codes().iter().map(|(code, _)| *code)
    }

    /// Returns the M code of the block.
    pub fn m_code(&self) -> Option<&'static Code> {
        self.m_code.map(|(code, _)| code)
    }

    /// Returns the number of the M code; 0 if the block has no M code.
    pub fn m_number(&self) -> u16 {
        self.m_code.map_or(0, |(_, number)| number)
    }

    /// Returns true if the block has a word with one of the addresses VA to VH.
    pub(crate) fn has_parameters(&self) -> bool {
        !self.present.intersection(PARAMETERS).is_empty()
    }

    /// Returns the modal values that the G codes and the M code of the block set.
    pub(crate) fn sets(&self) -> InForce {
        let mut sets = InForce::default();
        for value in self.codes().chain(self.m_code()).filter_map(|code| code.sets) {
            sets.set(value);
        }
        sets
    }

    /// Reads a block and reports each fault to `fault`.
    pub(crate) fn read(
        &mut self,
        program: &NcProgram,
        block: &Block,
        with: &Reading<'_>,
        fault: &mut dyn FnMut(Diagnostic),
    ) {
        self.present = AddressSet::EMPTY;
        self.g_count = 0;
        self.m_code = None;
        self.first_axis_place = None;
        self.refused = AddressSet::EMPTY;
        self.indirect = AddressSet::EMPTY;
        self.unknown = AddressSet::EMPTY;
        self.doubtful = AddressSet::EMPTY;
        self.unknown_code = false;
        self.any = false;
        let words = program.words(block);
        for (place, word) in words.iter().enumerate() {
            match word.address {
                Address::G => self.g_word(word, place, with.dialect, fault),
                Address::M => self.m_word(word, with.dialect, with.options.m_codes, fault),
                Address::N => numbers::validate_whole_number(word, fault),
                _ => self.value_word(word, place, &with.known, fault),
            }
        }
        self.take_words(program, block, with.modal, fault);
        if with.dialect.policy.numbers == Numbers::Counted {
            self.count_increments(words, with, fault);
        }
        for word in words {
            if !matches!(word.address, Address::G | Address::M | Address::N) {
                self.validate_word(word, with, fault);
            }
        }
        if !block.has_errors() {
            self.validate_codes(program, block, with, fault);
        }
    }

    #[inline(never)]
    fn g_word(&mut self, word: &Word, place: usize, dialect: &Dialect, fault: &mut dyn FnMut(Diagnostic)) {
        self.any = true;
        let known = numbers::code_number(word)
            .map(|value| tenths(value).and_then(|tenths| dialect.g_codes.find(tenths)));
        match known {
            Some(Some(code)) => self.add_g_code(code, word, place, dialect.policy.rivals, fault),
            Some(None) => {
                self.unknown_code = true;
                let name = format!("G{}", word.number().unwrap_or_default());
                let help = (dialect.grammar)().foreign(&name, "");
                fault(diagnostics::G_UNKNOWN.at(
                    word.span(),
                    format!("there is no {name}"),
                    help.unwrap_or_else(|| "Write a G code of the dialect.".to_owned()),
                ));
            }
            None => {
                self.unknown_code = true;
                let example = dialect.start_up.first().map_or("", |code| code.code);
                fault(numbers::constant_needed(word, "a constant", example));
            }
        }
    }

    fn add_g_code(
        &mut self,
        code: &'static Code,
        word: &Word,
        place: usize,
        rivals: GroupConflict,
        fault: &mut dyn FnMut(Diagnostic),
    ) {
        if rivals == GroupConflict::LastHolds && code.group != ModalGroup::NonModal {
            let before = self.codes().position(|other| other.group == code.group);
            if let Some(before) = before {
                self.g_codes[before] = (code, place);
                return;
            }
        }
        let rival = self.codes().find(|other| {
            let exclusive = code.group != ModalGroup::NonModal
                || *other == code
                || !(code.words.is_empty() || other.words.is_empty());
            other.group == code.group && exclusive
        });
        match rival {
            None if self.g_count < G_CODES_MAX => {
                self.g_codes[self.g_count] = (code, place);
                self.g_count += 1;
            }
            _ => {
                let other = rival.map_or("another code", |other| other.code);
                fault(diagnostics::GROUP_TWICE.at(
                    word.span(),
                    format!(
                        "{} and {other} of modal group {} ({}) are in one block",
                        code.code,
                        code.group.number(),
                        code.group.text()
                    ),
                    "Write them in blocks of their own.",
                ));
            }
        }
    }

    #[inline(never)]
    fn m_word(
        &mut self,
        word: &Word,
        dialect: &'static Dialect,
        declared: MCodeSet,
        fault: &mut dyn FnMut(Diagnostic),
    ) {
        self.any = true;
        let Some(number) = word.whole() else {
            self.unknown_code = true;
            let example = dialect.m_code(Role::End).map_or("", |code| code.code);
            fault(numbers::constant_needed(word, "a whole number", example));
            return;
        };
        if self.m_code.is_some() {
            fault(diagnostics::M_TWICE.at(
                word.span(),
                format!("M{number:02} is the second M code of the block"),
                "Write it in a block of its own.",
            ));
            return;
        }
        if number > u32::from(M_CODE_MAX) {
            self.unknown_code = true;
            fault(diagnostics::M_UNKNOWN.at(
                word.span(),
                format!("there is no M{number}"),
                format!("M codes are M0 to M{M_CODE_MAX}."),
            ));
            return;
        }
        let number = u16::try_from(number).unwrap_or(M_CODE_MAX);
        let code = dialect.m_codes.find(number * 10).unwrap_or(dialect.auxiliary);
        self.m_code = Some((code, number));
        let listed = *code != *dialect.auxiliary;
        if !listed && dialect.policy.other_m_codes == OtherMCodes::Declared && !declared.contains(number) {
            fault(diagnostics::M_UNKNOWN.at(
                word.span(),
                format!("M{number:02} is not in the list of M codes"),
                dialect.unlisted_help(number),
            ));
        }
    }

    fn value_word(
        &mut self,
        word: &Word,
        place: usize,
        known: &VariableSource<'_>,
        fault: &mut dyn FnMut(Diagnostic),
    ) {
        self.any = true;
        if self.present.contains(word.address) {
            fault(repeated_word(word));
            return;
        }
        if AXIS_ADDRESSES.contains(word.address) && self.first_axis_place.is_none() {
            self.first_axis_place = Some(place);
        }
        self.present.insert(word.address);
        self.values[word.address as usize] = match word.value() {
            Value::Number(value) => value,
            Value::Indirection(variable) => self.variable_value(word.address, variable, known),
        };
    }

    /// Returns the value of the variable in a word. If the text does not show the value, records that and
    /// returns NaN.
    #[inline(never)]
    fn variable_value(&mut self, address: Address, variable: Variable, known: &VariableSource<'_>) -> f64 {
        let (range, trust) = match known {
            VariableSource::Run(scope) => return scope.variable(variable),
            VariableSource::Text { values, trust } => (values.get(variable), *trust),
        };
        self.indirect.insert(address);
        let value = range.value();
        if value.is_some() && !range.own {
            self.doubtful.insert(address);
        }
        let least = if range.own { Trust::Own } else { Trust::Believed };
        value.filter(|_| trust >= least).unwrap_or_else(|| {
            self.unknown.insert(address);
            f64::NAN
        })
    }

    /// Converts numbers that count increments to values, and checks their form. A malformed number becomes
    /// NaN.
    #[inline(never)]
    fn count_increments(&mut self, words: &[Word], with: &Reading<'_>, fault: &mut dyn FnMut(Diagnostic)) {
        let unit = self.sets().unit.or(with.modal.in_force.unit).unwrap_or_default();
        let mut counted = AddressSet::EMPTY;
        for word in words {
            if word.address == Address::N {
                numbers::validate_block_number(word, fault);
            }
            let Some(spec) = self.spec(word.address, with.dialect) else {
                continue;
            };
            if counted.contains(word.address) || self.unknown_code {
                continue;
            }
            counted.insert(word.address);
            if numbers::validate_written_form(spec, word, unit, fault) {
                let value = self.values[word.address as usize];
                self.values[word.address as usize] =
                    numbers::convert_written_value(value, spec, word, unit, with.options);
            } else {
                self.refused.insert(word.address);
                self.values[word.address as usize] = f64::NAN;
            }
        }
    }

    /// Assigns the words of the block to the codes that take them, and reports a word that two codes take.
    fn take_words(
        &mut self,
        program: &NcProgram,
        block: &Block,
        modal: &Modal,
        fault: &mut dyn FnMut(Diagnostic),
    ) {
        let (own, shared) = if self.has_codes() {
            self.own_words()
        } else {
            (AddressSet::EMPTY, AddressSet::EMPTY)
        };
        self.own = own;
        let free = own.intersection(AXIS_ADDRESSES).is_empty();
        self.set_taker(if free { self.taker_in_force(modal) } else { None });
        self.axis_words = if free {
            self.present.intersection(AXIS_ADDRESSES)
        } else {
            AddressSet::EMPTY
        };
        self.taken = self.taker_addresses.intersection(self.present).without(own);
        for address in shared.intersection(self.present).iter() {
            fault(shared_word(program.span_of(block, address), address));
        }
    }

    /// Returns the addresses that the codes of the block take, without motion and fixed cycle, and those that
    /// two codes take.
    #[inline(never)]
    fn own_words(&self) -> (AddressSet, AddressSet) {
        let mut own = AddressSet::EMPTY;
        let mut shared = AddressSet::EMPTY;
        for code in self.codes_with_words() {
            shared = shared.union(own.intersection(code.addresses()));
            own = own.union(code.addresses());
        }
        (own, shared)
    }

    fn set_taker(&mut self, taker: Option<&'static Code>) {
        let same = match (self.taker, taker) {
            (Some(before), Some(taker)) => std::ptr::eq(before, taker),
            (before, taker) => before.is_none() && taker.is_none(),
        };
        if !same {
            self.taker = taker;
            self.taker_addresses = taker.map_or(AddressSet::EMPTY, Code::addresses);
        }
    }

    /// Returns the motion or fixed cycle that takes axis words. A motion code in the block ends a fixed
    /// cycle.
    fn taker_in_force(&self, modal: &Modal) -> Option<&'static Code> {
        let of = |group| self.codes().find(|code| code.group == group);
        of(ModalGroup::Motion).or_else(|| match of(ModalGroup::FixedCycle) {
            Some(cycle) if cycle.motion.is_some() => Some(cycle),
            Some(_) => modal.code(ModalGroup::Motion),
            None => modal.taker(),
        })
    }

    /// Returns the description of a word of this block, from the code that takes the word.
    #[inline]
    pub(crate) fn spec(&self, address: Address, dialect: &Dialect) -> Option<&'static WordSpec> {
        if self.taken.contains(address) {
            self.taker.and_then(|taker| taker.word(address))
        } else {
            self.spec_of_rest(address, dialect)
        }
    }

    /// Returns the description of a word that neither a motion nor a fixed cycle takes.
    #[inline(never)]
    fn spec_of_rest(&self, address: Address, dialect: &Dialect) -> Option<&'static WordSpec> {
        if self.own.contains(address) {
            return self.codes_with_words().find_map(|code| code.word(address));
        }
        if AXIS_ADDRESSES.contains(address) && (self.taker.is_some() || self.axis_words.is_empty()) {
            return None;
        }
        dialect.modal_words.get(address)
    }

    /// Checks that a code takes the word, and that the value of the word is in its range.
    fn validate_word(&self, word: &Word, with: &Reading<'_>, fault: &mut dyn FnMut(Diagnostic)) {
        let dialect = with.dialect;
        let Some(spec) = self.spec(word.address, dialect) else {
            self.report_untaken_word(word, dialect, fault);
            return;
        };
        let is_known = !self.unknown.contains(word.address);
        let known = || self.get(word.address).filter(|_| is_known);
        let counted = match with.dialect.policy.numbers {
            Numbers::AsWritten => word.number(),
            Numbers::Counted => word.number().and(self.get(word.address)),
        };
        let Some(value) = counted.or_else(known) else {
            return;
        };
        let may_differ = self.unknown_code && !dialect.modal_words.is_feed_word(word.address);
        let has_least = word.address == Address::F && dialect.policy.least_feedrate(with.options) > 0.0;
        if may_differ || has_least || self.refused.contains(word.address) {
            // an unknown code may give the word another range; an F below the least feedrate is raised, not
            // rejected
            return;
        }
        validate_value(spec, value, word.span(), fault);
    }

    /// Reports a word that no code takes.
    #[cold]
    fn report_untaken_word(&self, word: &Word, dialect: &Dialect, fault: &mut dyn FnMut(Diagnostic)) {
        let name = word.address.text();
        if self.m_code.is_some() && PARAMETERS.contains(word.address) {
            fault(diagnostics::PARAMETERS_REFUSED.at(
                word.span(),
                format!("M{:02} takes no parameter {name}", self.m_number()),
                "Remove the parameter.",
            ));
        } else if !(self.unknown_code || self.may_be_taken(word.address)) {
            fault(diagnostics::WORD_NOT_TAKEN.at(
                word.span(),
                format!("no code of the block takes {name}"),
                dialect.untaken_help(word.address),
            ));
        }
    }

    /// Returns true if a motion or fixed cycle that the text does not show may take a word with this address.
    fn may_be_taken(&self, address: Address) -> bool {
        self.taker.is_none()
            && self.own.intersection(AXIS_ADDRESSES).is_empty()
            && MOTION_WORDS.contains(address)
    }

    /// Returns true if a word of the block cannot be checked, because the code that takes the word is
    /// unknown.
    pub(crate) fn is_taking_unclear(&self) -> bool {
        let rest = self.present.without(self.own).intersection(MOTION_WORDS);
        rest.iter().any(|address| self.may_be_taken(address))
    }

    /// Checks the words that each code requires, and the combinations of codes that are not allowed.
    fn validate_codes(
        &self,
        program: &NcProgram,
        block: &Block,
        with: &Reading<'_>,
        fault: &mut dyn FnMut(Diagnostic),
    ) {
        if self.has_codes() {
            self.validate_own_words(program, block, fault);
        }
        if let Some(refusal) = restrictions::find(self, with) {
            fault(at_word(program, block, refusal));
        }
    }

    /// Checks that the words of each code are complete, and runs the own check of each code.
    #[inline(never)]
    fn validate_own_words(&self, program: &NcProgram, block: &Block, fault: &mut dyn FnMut(Diagnostic)) {
        for code in self.codes_with_words() {
            for word in code.words {
                if word.required && !self.present.contains(word.address) {
                    let name = word.address.text();
                    fault(diagnostics::WORD_MISSING.at(
                        program.span(block),
                        format!("{} lacks {name} ({})", code.code, word.meaning),
                        format!("Write {name} with a value of {}.", word.range_text()),
                    ));
                }
            }
            if let Some(refusal) = code.check.and_then(|check| check(self)) {
                fault(at_word(program, block, refusal));
            }
        }
    }

    /// Returns true if the block has a G or M code.
    pub(crate) fn has_codes(&self) -> bool {
        self.g_count > 0 || self.m_code.is_some()
    }

    /// Returns the codes of the block that take words, motions and fixed cycles excepted.
    fn codes_with_words(&self) -> impl Iterator<Item = &'static Code> {
        self.codes().chain(self.m_code()).filter(|code| {
            !code.words.is_empty() && !matches!(code.group, ModalGroup::Motion | ModalGroup::FixedCycle)
        })
    }
}

#[cold]
fn repeated_word(word: &Word) -> Diagnostic {
    let name = word.address.text();
    diagnostics::WORD_TWICE.at(
        word.span(),
        format!("{name} appears twice in the block"),
        format!("Keep one {name}, or write another block."),
    )
}

#[cold]
fn shared_word(span: Span, address: Address) -> Diagnostic {
    diagnostics::WORD_SHARED.at(
        span,
        format!("two codes of the block take {}", address.text()),
        "Write the codes in blocks of their own.",
    )
}

/// Converts a refusal to a diagnostic at the refused word, or at the block if the block has no such word.
fn at_word(program: &NcProgram, block: &Block, refusal: Refusal) -> Diagnostic {
    let span = program.span_of(block, refusal.address);
    refusal.entry.at(span, refusal.message, refusal.help)
}
