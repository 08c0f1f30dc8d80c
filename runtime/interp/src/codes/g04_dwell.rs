//! G04 Dwell. In its block, F, P and X are times: no axis moves, and the modal feedrate stays (D19).

use tandem_model::flow::Action;
use tandem_syntax::Address;
use tandem_syntax::diagnostics::{DWELL_TWICE, WORD_MISSING};

use super::{Code, Refusal, WordSpec};
use crate::block_words::BlockWords;
use crate::execution::Execution;
use crate::meaning::Role;

const SECONDS_MAX: f64 = 100_000.0;
/// Longest dwell of dialect dgshape, s.
const DWELL_MAX_S: f64 = 3600.0;
const MILLISECONDS_MAX: f64 = 100_000_000.0;

/// G04: a dwell.
pub static G04: Code = Code {
    code: "G04",
    name: "Dwell",
    role: Role::Dwell,
    words: &[
        WordSpec::new(Address::F, "dwell time", "s", 0.0, SECONDS_MAX),
        WordSpec::new(Address::P, "dwell time", "ms", 0.0, MILLISECONDS_MAX),
        WordSpec::new(Address::X, "dwell time", "s", 0.0, SECONDS_MAX),
    ],
    docs: "Rests for the time of F or X in seconds, or of P in milliseconds; if none is written, the time is 0. \
           The spindle and the outputs of the sequence program continue. Only one of the three words is \
           allowed in a block.",
    check: Some(one_time),
    select: dwell,
    ..Code::BASE
};

/// G04 of dialect dgshape, with X or P.
pub static G04_X_P: Code = Code {
    words: &[
        WordSpec::new(Address::X, "dwell time", "s", 0.0, DWELL_MAX_S),
        WordSpec::new(Address::P, "dwell time", "ms", 0.0, DWELL_MAX_S * 1000.0).whole(),
    ],
    docs: "Rests for the time of X, in seconds with a decimal point and in milliseconds without one, or of P \
           in milliseconds, at most one hour.",
    check: Some(just_one_time),
    ..G04
};

fn dwell(execution: &mut Execution<'_>) {
    let words = execution.words;
    let milliseconds = words.get(Address::P).map(|time| time / 1000.0);
    let seconds = words.get(Address::F).or(words.get(Address::X));
    execution.act(Action::Dwell {
        dwell_s: seconds.or(milliseconds).unwrap_or(0.0),
    });
}

fn just_one_time(words: &BlockWords) -> Option<Refusal> {
    let code = words.codes().find(|code| code.role == Role::Dwell)?;
    if words.present.intersection(code.addresses()).is_empty() {
        return Some(Refusal {
            entry: &WORD_MISSING,
            address: Address::G,
            message: format!("{} lacks X or P (dwell time)", code.code),
            help: format!("Write X or P with a time of 0 to {DWELL_MAX_S} s."),
        });
    }
    one_time(words)
}

fn one_time(words: &BlockWords) -> Option<Refusal> {
    let code = words.codes().find(|code| code.role == Role::Dwell)?;
    let mut times = words.present.intersection(code.addresses()).iter();
    let (first, second) = (times.next()?, times.next()?);
    Some(Refusal {
        entry: &DWELL_TWICE,
        address: second,
        message: format!("the dwell has both {} and {}", first.text(), second.text()),
        help: "Keep one of them.".to_owned(),
    })
}
