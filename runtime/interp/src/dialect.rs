//! Definition of a dialect: a grammar, a list of codes, words, and defaults.

use tandem_model::settings::{NcOptions, PathRules};
use tandem_syntax::{Address, AddressSet, CodeRole, Codes, Grammar};

use crate::codes::usual_outputs::{USUAL_OUTPUTS, UsualOutput};
use crate::codes::{Code, CodeTable, WordSpec, tenths};
use crate::dialects::texts::Texts;
use crate::meaning::{ModalValue, Role};
use crate::restrictions::Restriction;

/// A dialect of the NC language: all properties in which dialects differ (D50).
#[derive(Debug, Clone)]
pub struct Dialect {
    /// Name of the dialect in the configuration.
    pub name: &'static str,
    /// Grammar with which the parser reads programs of the dialect.
    pub grammar: fn() -> &'static Grammar,
    /// All G codes of the dialect.
    pub g_codes: CodeTable,
    /// M codes that the runtime handles itself.
    pub m_codes: CodeTable,
    /// The code for all M codes that are not in `m_codes`.
    pub auxiliary: &'static Code,
    /// Words that need no code in their block.
    pub modal_words: ModalWords,
    /// Codes that are active at start-up.
    pub start_up: &'static [&'static Code],
    /// The code that ends a fixed cycle, such as G80. It also becomes active if a motion code ends the cycle.
    /// `None` in a dialect without fixed cycles.
    pub cycle_cancel: Option<&'static Code>,
    /// Codes of a block that moves axes from their present positions to their first reference points. The
    /// axis words follow these codes.
    pub home: &'static str,
    /// Word that ends each block of the intermediate code (D43).
    pub block_end: &'static str,
    /// Choices for programs that different controls interpret differently.
    pub policy: Policy,
    /// Rules of the dialect for the path stage.
    pub path: PathRules,
    /// Combinations that are not allowed in a block. Only the first restriction that a block violates is
    /// reported.
    pub restrictions: &'static [Restriction],
    /// Texts of this dialect for codes and diagnostics that several dialects share.
    pub texts: &'static Texts,
}

/// Choices of a dialect for programs that different controls interpret differently.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Policy {
    /// Handling of two codes of one modal group in a block.
    pub rivals: GroupConflict,
    /// Time at which the M code of a block takes effect.
    pub m_code: MCodeTime,
    /// Meaning of the numbers in words.
    pub numbers: Numbers,
    /// Meaning of the S word.
    pub spindle_word: SpindleWord,
    /// Handling of M codes that the dialect does not list.
    pub other_m_codes: OtherMCodes,
    /// Time of an output if the configuration has no setting for its M code.
    pub output: OutputDefault,
    /// Meaning of an arc whose end is not on its circle.
    pub spiral: Spiral,
    /// True if an F below the machine's least feedrate is replaced by that feedrate.
    pub has_least_feedrate: bool,
}

impl Policy {
    /// Choices of dialect nj.
    pub const NJ: Self = Self {
        rivals: GroupConflict::Refused,
        m_code: MCodeTime::BehindMotion,
        numbers: Numbers::AsWritten,
        spindle_word: SpindleWord::Speed,
        other_m_codes: OtherMCodes::Output,
        output: OutputDefault::AfterMotion,
        spiral: Spiral::Meant,
        has_least_feedrate: false,
    };

    /// Returns the least feedrate, mm/min; 0 if the dialect has no least feedrate.
    pub(crate) fn least_feedrate(self, options: &NcOptions) -> f64 {
        if self.has_least_feedrate {
            options.min_feedrate_mm_min
        } else {
            0.0
        }
    }
}

/// Meaning of the S word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SpindleWord {
    /// Spindle speed, r/min; a value above the maximum speed is an alarm.
    Speed,
    /// Number of a speed code if below 100, otherwise a spindle speed; the speed is limited to the range of
    /// the spindle.
    SpeedOrCode,
}

/// Handling of M codes that the dialect does not list.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OtherMCodes {
    /// Each such M code is an output.
    Output,
    /// An M code with settings in the configuration is an output; an M code without settings is an error.
    Declared,
}

/// Time of an output if the configuration has no setting for its M code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OutputDefault {
    /// The output is issued after the motion, and the program waits for the reset of the output.
    AfterMotion,
    /// The output is issued with the motion of its block, also if it has parameters; the program continues.
    WithMotion,
}

/// Meaning of an arc whose end is not on its circle. The motion is always a spiral (D26).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spiral {
    /// The program intends the spiral: the check reports nothing.
    Meant,
    /// The arc is a fault of the program: the check reports a warning.
    Doubted,
}

/// Handling of two codes of one modal group in a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GroupConflict {
    /// The second code is an error.
    Refused,
    /// The last code applies.
    LastHolds,
}

/// Time at which an M code that stops the program or makes an output takes effect. An end or a call always
/// takes effect after the motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MCodeTime {
    /// The M code takes effect after the motion of its block.
    BehindMotion,
    /// The M code takes effect before the motion of its block.
    BeforeMotion,
}

/// Meaning of the numbers in words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Numbers {
    /// A number has its written value.
    AsWritten,
    /// A number without a decimal point counts least increments, unless a setting selects another reading.
    /// The numbers in the text have their own ranges (manual dgshape, 1-5 and 2-1).
    Counted,
}

impl Dialect {
    /// Returns the code with this letter (G or M) and number. An M code outside of the dialect's table is an
    /// output.
    pub fn code(&self, letter: Address, number: f64) -> Option<&'static Code> {
        let listed = |table: &CodeTable| tenths(number).and_then(|tenths| table.find(tenths));
        match letter {
            Address::G => listed(&self.g_codes),
            Address::M => listed(&self.m_codes).or(Some(self.auxiliary)),
            _ => None,
        }
    }

    /// Returns the description of an M code that the manual names as a usual output, but that the dialect
    /// does not list.
    pub fn usual_output(&self, m: u16) -> Option<&'static UsualOutput> {
        self.usual_outputs().iter().find(|usual| usual.m == m)
    }

    /// Returns the M codes that the manual names as usual outputs, but that the dialect does not list.
    pub fn usual_outputs(&self) -> &'static [UsualOutput] {
        match self.policy.other_m_codes {
            OtherMCodes::Output => USUAL_OUTPUTS,
            OtherMCodes::Declared => &[],
        }
    }

    /// Returns the first G code of the dialect that sets a modal value.
    pub fn that_sets(&self, value: ModalValue) -> Option<&'static Code> {
        let mut codes = self.g_codes.codes.iter().copied();
        codes.find(|code| code.sets == Some(value))
    }

    /// Returns the last code of [`Dialect::home`].
    pub fn home_code(&self) -> Option<&'static Code> {
        let name = self.home.rsplit(' ').next();
        let mut codes = self.g_codes.codes.iter().copied();
        codes.find(|code| Some(code.code) == name)
    }

    /// Returns true if programs can set ramp times; otherwise only the limits of the motors determine ramps.
    pub fn has_ramp_times(&self) -> bool {
        self.modal_words.get(Address::Ta).is_some()
    }

    /// Returns the last M code of the dialect that has this role.
    pub fn m_code(&self, role: Role) -> Option<&'static Code> {
        let mut codes = self.m_codes.codes.iter().rev().copied();
        codes.find(|code| code.role == role)
    }

    /// Returns the help for an M code that the dialect does not list.
    pub(crate) fn unlisted_help(&self, number: u16) -> String {
        let foreign = (self.grammar)().foreign(&format!("M{number}"), "");
        foreign
            .unwrap_or_else(|| format!("Add [m_code.{number}] to the configuration, or correct the number."))
    }

    /// Returns the help for a word that no code of its block takes.
    pub(crate) fn untaken_help(&self, address: Address) -> String {
        let name = address.text();
        let takers = self.names("or", |code| WordSpec::addresses(code.words).contains(address));
        match takers.as_str() {
            "" => format!("Remove {name}."),
            takers => format!("Remove {name}, or write {takers} with it."),
        }
    }

    /// Returns the names of the codes for which `is_meant` returns true, as a [`list`]: `G01, G02 or G03`.
    pub(crate) fn names(&self, last: &str, is_meant: impl Fn(&Code) -> bool) -> String {
        let codes = self.g_codes.codes.iter().chain(self.m_codes.codes);
        let names: Vec<&str> = codes
            .filter(|code| is_meant(code))
            .map(|code| code.code)
            .collect();
        list(&names, last)
    }
}

/// Returns names as a list with `last` before the last name: `X, Y and Z`.
pub(crate) fn list(names: &[&str], last: &str) -> String {
    match names.split_last() {
        Some((end, rest)) if !rest.is_empty() => format!("{} {last} {end}", rest.join(", ")),
        _ => names.concat(),
    }
}

impl Codes for Dialect {
    fn role(&self, letter: Address, number: f64) -> CodeRole {
        let table = match letter {
            Address::G => &self.g_codes,
            _ => &self.m_codes,
        };
        let Some(code) = tenths(number).and_then(|tenths| table.find(tenths)) else {
            return CodeRole::Other;
        };
        match (code.role, code.sets) {
            (Role::Return, _) => CodeRole::Return,
            (Role::Motion(_), _) | (_, Some(ModalValue::Cycle(None))) => CodeRole::CycleEnd,
            (_, Some(ModalValue::Cycle(Some(_)))) => CodeRole::CycleBegin,
            _ => CodeRole::Other,
        }
    }

    fn cycle_start(&self) -> String {
        self.cycle_cancel
            .map_or_else(String::new, |code| format!("{}.001", code.code))
    }

    fn block_end(&self) -> &'static str {
        self.block_end
    }
}

/// Words that need no code in their block: axis words of the active motion, and feed words.
#[derive(Debug, Clone)]
pub struct ModalWords {
    specs: [Option<&'static WordSpec>; Address::COUNT],
    feed_words: AddressSet,
}

impl ModalWords {
    /// Creates modal words from these axis words and feed words.
    pub const fn new(axis_words: &'static [WordSpec], feed_words: &'static [WordSpec]) -> Self {
        let mut specs = [None; Address::COUNT];
        let lists = [axis_words, feed_words];
        let mut list = 0;
        while list < lists.len() {
            let mut i = 0;
            while i < lists[list].len() {
                specs[lists[list][i].address as usize] = Some(&lists[list][i]);
                i += 1;
            }
            list += 1;
        }
        Self {
            specs,
            feed_words: WordSpec::addresses(feed_words),
        }
    }

    /// Returns the description of a modal word with this address.
    pub fn get(&self, address: Address) -> Option<&'static WordSpec> {
        self.specs[address as usize]
    }

    /// Returns true for the feed words F, S, ta, td and ts.
    pub fn is_feed_word(&self, address: Address) -> bool {
        self.feed_words.contains(address)
    }
}
