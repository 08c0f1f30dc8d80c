//! Assumptions about the control of a FANUC program: words whose effect depends on the kind of control or on its
//! parameters are converted by the most common meaning, and each such meaning is reported.

use std::collections::BTreeMap;

use tandem_syntax::{Address, Word};

use super::block::BEFORE_MOTION;
use super::state::POSITIONS;

/// Assumption about the control that the source was written for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ConversionAssumption {
    /// First line of the source to which the assumption applies, from 1.
    pub line: u32,
    /// Number of lines to which the assumption applies.
    pub lines: u32,
    /// The assumed meaning, the other possible meaning, and how to correct the source.
    pub text: String,
}

/// Kind of assumption. Each kind is reported once for each program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum AssumptionKind {
    /// Lengths and angles without a decimal point.
    Lengths,
    /// Times without a decimal point in P.
    Milliseconds,
    /// Order of an M code and the motion of its block.
    MCodes,
    /// Path of a rapid motion of several axes.
    RapidPath,
}

impl AssumptionKind {
    fn text(self) -> String {
        match self {
            AssumptionKind::Lengths => "numbers without a decimal point are read in mm, inches or degrees. A control without calculator input reads them in its least increment, where X1000 is 1 mm. Write a decimal point in each of them.".to_owned(),
            AssumptionKind::Milliseconds => "P of a dwell without a decimal point is read in milliseconds. LinuxCNC, grbl and Mach read it in seconds. Write a decimal point for seconds.".to_owned(),
            AssumptionKind::MCodes => {
                let before = BEFORE_MOTION.map(|m| format!("M{m:02}")).join(", ");
                format!("M codes are executed at rest: {before} before the motion of their block, all others after it. The control of the source may execute them at another time or during the motion. Check their order and the time that they take.")
            }
            AssumptionKind::RapidPath => "a rapid motion of several axes moves each axis at its own speed, not on a straight line. A control with linear rapid positioning moves on the line. Check that the path is free, or write a block for each axis.".to_owned(),
        }
    }
}

/// Assumptions of a conversion, each with its first line and the number of its lines.
#[derive(Debug, Default)]
pub(super) struct Assumptions(BTreeMap<AssumptionKind, (u32, u32)>);

impl Assumptions {
    /// Adds the assumptions with which these words of a line became these blocks of nj.
    pub fn add_line(&mut self, line: u32, words: &[Word], blocks: &[String]) {
        for (kind, applies) in [
            (AssumptionKind::Lengths, has_whole_length(words)),
            (AssumptionKind::Milliseconds, has_whole_dwell(words)),
            (AssumptionKind::MCodes, has_m_code_with_motion(words)),
            (
                AssumptionKind::RapidPath,
                blocks.iter().any(|block| is_rapid_of_several_axes(block)),
            ),
        ] {
            if applies {
                self.0.entry(kind).or_insert((line, 0)).1 += 1;
            }
        }
    }

    /// Returns the assumptions, ascending by their first line.
    pub fn report(self) -> Vec<ConversionAssumption> {
        let mut all: Vec<_> = self
            .0
            .into_iter()
            .map(|(kind, (line, lines))| ConversionAssumption {
                line,
                lines,
                text: kind.text(),
            })
            .collect();
        all.sort_by_key(|assumption| assumption.line);
        all
    }
}

/// Codes in whose blocks axis words are no motion.
const NO_MOTION: [u32; 6] = [4, 10, 51, 52, 68, 92];

/// Codes in whose blocks R or Q is no length.
const NO_LENGTH: [u32; 3] = [4, 10, 65];

/// M codes whose order is the same on every control: ends, stops and calls come after the motion.
const SAME_ORDER: [u32; 6] = [0, 1, 2, 30, 98, 99];

fn has_code(words: &[Word], address: Address, is_meant: impl Fn(u32) -> bool) -> bool {
    let mut words = words.iter();
    words.any(|word| word.address == address && word.whole().is_some_and(&is_meant))
}

fn is_whole_value(word: &Word) -> bool {
    word.is_whole() && word.number().is_some_and(|value| value != 0.0)
}

fn has_whole_length(words: &[Word]) -> bool {
    const LENGTHS: [Address; 6] = [
        Address::I,
        Address::J,
        Address::K,
        Address::R,
        Address::Q,
        Address::A,
    ];
    let is_holes = |word: &Word| word.address == Address::K && has_code(words, Address::G, |g| g > 72);
    let mut lengths = words
        .iter()
        .filter(|word| POSITIONS.contains(&word.address) || LENGTHS.contains(&word.address));
    !has_code(words, Address::G, |g| NO_LENGTH.contains(&g))
        && lengths.any(|word| is_whole_value(word) && !is_holes(word))
}

fn has_whole_dwell(words: &[Word]) -> bool {
    let dwells = has_code(words, Address::G, |g| g == 4 || (73..=89).contains(&g));
    let mut words = words.iter();
    dwells && words.any(|word| word.address == Address::P && is_whole_value(word))
}

fn has_m_code_with_motion(words: &[Word]) -> bool {
    let moves = words.iter().any(|word| POSITIONS.contains(&word.address))
        && !has_code(words, Address::G, |g| NO_MOTION.contains(&g));
    moves && has_code(words, Address::M, |m| !SAME_ORDER.contains(&m))
}

/// Returns true if a block of nj moves several axes at rapid speed. A block without the code of its motion may do so.
fn is_rapid_of_several_axes(block: &str) -> bool {
    let words = || block.split_whitespace();
    let count = |letters: &[char]| words().filter(|word| word.starts_with(letters)).count();
    let has = |codes: &[&str]| words().any(|word| codes.contains(&word));
    let is_rapid = has(&["G00", "G28", "G30", "G53"]) || !words().any(|word| word.starts_with("G0"));
    if has(&["G74", "G84"]) {
        return count(&['X', 'Y']) > 1;
    }
    let is_set = has(&["G51", "G52", "G68"]);
    is_rapid && !is_set && count(&['X', 'Y', 'Z', 'A']) > 1
}
