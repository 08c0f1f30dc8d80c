//! Invariants of the ledger, which debug builds assert after each change.

use crate::types::output::OutputNotice;

use super::Ledger;
use super::open_output::{OpenOutput, OutputStage, Ownership};

impl Ledger {
    /// Asserts the invariants of the ledger in debug builds.
    pub(super) fn assert_invariants(&self) {
        if !cfg!(debug_assertions) {
            return;
        }
        assert!(
            self.open.len() <= self.open_outputs_max,
            "H8: {} outputs are open, more than {}",
            self.open.len(),
            self.open_outputs_max
        );
        assert!(
            self.open
                .is_sorted_by(|one, next| one.notice.seq < next.notice.seq),
            "H2: the open outputs are not in the order of their sequence numbers"
        );
        for output in &self.open {
            self.assert_output(output);
        }
    }

    fn assert_output(&self, output: &OpenOutput) {
        let notice = &output.notice;
        let seq = notice.seq;
        assert!(
            (1..self.next_seq).contains(&seq) && notice.id.starts_with(&self.id_prefix),
            "H2: output {seq} is not one of this boot"
        );
        assert!(
            self.closed.m(seq).is_none(),
            "H1: output {seq} is open and has ended"
        );
        match &output.stage {
            OutputStage::Queued { .. } => {
                assert!(!was_published(notice), "H9: queued output {seq} was published");
            }
            OutputStage::Issued(issued) => {
                assert!(notice.attempt > 0, "H1: output {seq} was not published");
                assert!(
                    issued.deadline_s.is_none_or(f64::is_finite),
                    "H10: output {seq} has no valid time limit"
                );
                if let Ownership::Unclaimed(unclaimed) = &issued.ownership {
                    let is_lost = unclaimed.lost_owner.is_some();
                    assert!(
                        !is_lost || notice.redelivered,
                        "H11: output {seq} is lost, but not redelivered"
                    );
                }
            }
        }
    }
}

fn was_published(notice: &OutputNotice) -> bool {
    notice.attempt > 0 || notice.redelivered
}
