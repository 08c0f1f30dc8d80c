//! All explained words, from every enumeration that explains its words.

use super::command::CommandStatus;
use super::execution::{Execution, Reason};
use super::explained::ExplainedWord;
use super::output::{CancelReason, HandshakeStatus, OutputState};
use super::refusal::RefusalCode;
use super::run::RunEndedHow;
use super::state::Transition;

/// Returns all explained words.
pub fn words() -> impl Iterator<Item = &'static ExplainedWord> {
    let all = [
        Execution::EXPLAINED,
        Transition::EXPLAINED,
        Reason::EXPLAINED,
        RefusalCode::EXPLAINED,
        OutputState::EXPLAINED,
        HandshakeStatus::EXPLAINED,
        CancelReason::EXPLAINED,
        RunEndedHow::EXPLAINED,
        CommandStatus::EXPLAINED,
    ];
    all.into_iter().flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_word_has_a_meaning_and_a_way_on_and_is_one_of_its_kind() {
        let mut seen = std::collections::BTreeSet::new();
        for word in words() {
            assert!(word.meaning.trim().len() > 5 && word.way_on.len() > 5, "{word:?}");
            assert!(seen.insert((word.of, word.word)), "{word:?}");
        }
        assert!(seen.len() > 50, "{}", seen.len());
    }
}
