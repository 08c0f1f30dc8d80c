//! Memory of closed outputs, so that a late claim or reset gets the right answer.

use std::collections::BTreeMap;

use crate::types::output::HandshakeStatus;

/// Closed outputs that are remembered. Reason: a message that is this many outputs late has no sender that waits for
/// it. An older output is answered `stale`, which also means that nothing has changed.
pub const CLOSED_REMEMBERED: usize = 4_096;

/// How an output ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fate {
    Reset,
    /// Cancelled, failed or timed out.
    Ended,
    /// Cancelled while queued: no handler ever saw it.
    NeverMade,
}

#[derive(Debug, Default)]
pub(super) struct ClosedOutputs {
    by_seq: BTreeMap<u64, (u16, Fate)>,
}

impl ClosedOutputs {
    pub(super) fn remember(&mut self, seq: u64, m: u16, fate: Fate) {
        self.by_seq.insert(seq, (m, fate));
        if self.by_seq.len() > CLOSED_REMEMBERED {
            self.by_seq.pop_first();
        }
    }

    /// The answer to a claim or reset of an output of this boot that is not open.
    pub(super) fn answer(&self, seq: u64, m: Option<u16>) -> HandshakeStatus {
        match self.by_seq.get(&seq) {
            Some((closed_m, _)) if m.is_some_and(|m| m != *closed_m) => HandshakeStatus::Unknown,
            Some((_, Fate::Reset)) => HandshakeStatus::Duplicate,
            Some((_, Fate::Ended)) | None => HandshakeStatus::Stale,
            Some((_, Fate::NeverMade)) => HandshakeStatus::Unknown,
        }
    }

    pub(super) fn m(&self, seq: u64) -> Option<u16> {
        self.by_seq.get(&seq).map(|(m, _)| *m)
    }
}
