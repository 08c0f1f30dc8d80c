//! Reports on an open output: progress, checkpoints, questions and their answers.

use super::Ledger;
use super::effect::Now;
use super::identity::Denial;
use super::result::status_of;
use crate::text::cut;
use crate::types::Timestamp;
use crate::types::output::{CheckpointReport, HandshakeStatus, Progress, ProgressReport};
use crate::types::question::{Ask, OperatorAnswer, Question};
use crate::types::refusal::Refusal;

/// Largest number of characters of a progress text; a longer text is cut. Reason: the text is one line of a
/// panel.
pub const PROGRESS_TEXT_MAX: usize = 200;

impl Ledger {
    /// Records the progress that the owner reports (H13). Returns `not_owner` if another sender reports, or
    /// if the output has no owner.
    pub fn progress(&mut self, _now: Now, m: Option<u16>, report: &ProgressReport) -> HandshakeStatus {
        status_of(&self.report(m, report))
    }

    /// Sets the text by which the machine explains why an output waits that no handler serves; `None` removes
    /// the text.
    pub fn set_wait_text(&mut self, seq: u64, text: Option<&str>) {
        let boot_id = self.boot_id.clone();
        // `change` fails if the output is queued or closed; then no handler is awaited, and no text is needed
        let _ = self.change(&boot_id, seq, None, |output, _| {
            output.progress = text.map(|text| Progress {
                text: text.to_owned(),
                percent: None,
            });
            Ok(true)
        });
    }

    pub(super) fn report(&mut self, m: Option<u16>, report: &ProgressReport) -> Result<(), Denial> {
        self.change(&report.boot_id, report.seq, m, |output, since| {
            output.check_owner(since, &report.handler_id, report.instance.as_ref())?;
            let mut text = report.text.clone();
            cut(&mut text, PROGRESS_TEXT_MAX);
            let percent = report.percent.filter(|percent| percent.is_finite());
            output.progress = Some(Progress {
                text,
                percent: percent.map(|percent| percent.clamp(0.0, 100.0)),
            });
            Ok(true)
        })
    }

    /// Stores a checkpoint of the owner. The ledger keeps the checkpoint when the owner is lost (H21).
    pub(super) fn store_checkpoint(
        &mut self,
        m: Option<u16>,
        report: &CheckpointReport,
    ) -> Result<Result<(), Denial>, Refusal> {
        report.check()?;
        Ok(self.change(&report.boot_id, report.seq, m, |output, since| {
            output.check_owner(since, &report.handler_id, report.instance.as_ref())?;
            output.checkpoint = Some(report.checkpoint.clone()).filter(|noted| !noted.is_null());
            Ok(true)
        }))
    }

    /// Records a question of the owner to the operator; the question replaces an earlier question. If the
    /// message has no choices, the owner withdraws the question. If the message has the id of the current
    /// question, nothing changes. Returns `not_owner` for any other sender (H14).
    ///
    /// # Errors
    /// Fails if the text or the choices are out of range.
    pub fn ask(&mut self, now: Now, m: Option<u16>, ask: &Ask) -> Result<HandshakeStatus, Refusal> {
        Ok(status_of(&self.put_question(now, m, ask)?))
    }

    pub(super) fn put_question(
        &mut self,
        now: Now,
        m: Option<u16>,
        ask: &Ask,
    ) -> Result<Result<(), Denial>, Refusal> {
        ask.check()?;
        Ok(self.change(&ask.boot_id, ask.seq, m, |output, since| {
            let claimed = output.check_owner(since, &ask.handler_id, ask.instance.as_ref())?;
            let asked = claimed.question.as_ref();
            let is_asked = asked.is_some_and(|question| question.id == ask.question_id);
            let is_new = is_asked == ask.choices.is_empty();
            if is_new {
                claimed.question = (!is_asked).then(|| Question {
                    id: ask.question_id.clone(),
                    text: ask.text.clone(),
                    choices: ask.choices.clone(),
                    since: Timestamp::from_system_time(now.time),
                    answer: None,
                });
            }
            Ok(is_new)
        }))
    }

    /// Records the answer of an operator to a question. Returns `unknown` if the question or the choice does
    /// not exist, and `duplicate` if the question already has an answer.
    pub fn answer_question(&mut self, _now: Now, m: Option<u16>, answer: &OperatorAnswer) -> HandshakeStatus {
        status_of(&self.take_answer(m, answer))
    }

    pub(super) fn take_answer(&mut self, m: Option<u16>, answer: &OperatorAnswer) -> Result<(), Denial> {
        self.change(&answer.boot_id, answer.seq, m, |output, _| {
            let asked = output.claimed_mut().and_then(|claimed| claimed.question.as_mut());
            let question = asked
                .filter(|question| question.id == answer.question_id)
                .filter(|question| question.choices.contains(&answer.choice))
                .ok_or((HandshakeStatus::Unknown, None))?;
            if question.answer.is_some() {
                return Err((HandshakeStatus::Duplicate, None));
            }
            question.answer = Some(answer.choice.clone());
            Ok(true)
        })
    }
}
