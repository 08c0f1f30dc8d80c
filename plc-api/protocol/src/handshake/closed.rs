//! Memory of closed outputs, so that a late claim or reset receives the right answer.

use std::collections::VecDeque;

use crate::types::output::HandshakeStatus;

/// Number of closed outputs that are remembered. Reason: no sender waits for an answer about an output that
/// ended this many outputs ago. If an output is no longer remembered, the answer is `stale`, which also means
/// that nothing has changed.
pub const CLOSED_REMEMBERED: usize = 4_096;

/// How an output ended, as far as the answers to late requests depend on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fate {
    Reset,
    /// Cancelled, failed or timed out.
    Ended,
    /// Cancelled while QUEUED, so that no handler has received the output.
    NeverIssued,
}

#[derive(Debug, Clone, Copy)]
struct ClosedOutput {
    seq: u64,
    m: u16,
    fate: Fate,
}

#[derive(Debug, Default)]
pub(super) struct ClosedOutputs {
    // ascending by seq: outputs end in about the order in which they were issued, so most outputs are
    // appended at the end
    by_seq: VecDeque<ClosedOutput>,
}

impl ClosedOutputs {
    pub(super) fn remember(&mut self, seq: u64, m: u16, fate: Fate) {
        let later = self.by_seq.iter().rev().take_while(|known| known.seq > seq);
        let place = self.by_seq.len() - later.count();
        let before = place.checked_sub(1).and_then(|before| self.by_seq.get(before));
        debug_assert!(
            before.is_none_or(|known| known.seq < seq),
            "output {seq} has ended twice"
        );
        self.by_seq.insert(place, ClosedOutput { seq, m, fate });
        if self.by_seq.len() > CLOSED_REMEMBERED {
            self.by_seq.pop_front();
        }
    }

    /// Returns the answer to a claim or reset of an output of this boot that is not open.
    pub(super) fn answer(&self, seq: u64, m: Option<u16>) -> HandshakeStatus {
        let Some(closed) = self.get(seq) else {
            return HandshakeStatus::Stale;
        };
        match closed.fate {
            _ if m.is_some_and(|m| m != closed.m) => HandshakeStatus::Unknown,
            Fate::Reset => HandshakeStatus::Duplicate,
            Fate::Ended => HandshakeStatus::Stale,
            Fate::NeverIssued => HandshakeStatus::Unknown,
        }
    }

    pub(super) fn m(&self, seq: u64) -> Option<u16> {
        self.get(seq).map(|closed| closed.m)
    }

    fn get(&self, seq: u64) -> Option<&ClosedOutput> {
        let place = self.by_seq.binary_search_by_key(&seq, |closed| closed.seq).ok()?;
        self.by_seq.get(place)
    }
}
