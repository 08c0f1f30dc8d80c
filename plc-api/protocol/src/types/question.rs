//! Questions of handlers to the operator, and checks of parameters when a program is loaded.

use serde::{Deserialize, Serialize};

use super::params::Params;
use super::refusal::{Refusal, RefusalCode};
use super::{BootId, Timestamp};

/// Largest number of characters of a question. Reason: a question takes one or two lines of a panel.
pub const QUESTION_TEXT_MAX: usize = 200;

/// Largest number of choices of a question. Reason: the choices are buttons of a panel.
pub const CHOICES_MAX: usize = 8;

/// Largest number of characters of a choice.
pub const CHOICE_TEXT_MAX: usize = 40;

/// Largest number of characters of a question's id.
pub const QUESTION_ID_MAX: usize = 64;

/// A question that a handler asks the operator. `m_code/pending` shows the question with its output. `state`
/// shows the question while the program waits for that output and the question has no answer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Question {
    /// Id of the question; its answer contains the same id.
    pub id: String,
    /// Text of the question, 1 to 200 characters.
    pub text: String,
    /// Possible answers: 1 to 8 different texts of 1 to 40 characters.
    pub choices: Vec<String>,
    /// Time at which the question was asked.
    pub since: Timestamp,
    /// The answer; absent until the operator has answered.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub answer: Option<String>,
}

/// Payload of `m_code/{m}/ask`: the owner of an output asks the operator a question. Without choices the
/// message withdraws the question.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Ask {
    /// Boot that issued the output.
    pub boot_id: BootId,
    /// Sequence number of the output.
    pub seq: u64,
    /// The owner of the output.
    pub handler_id: String,
    /// Identifies one process among all that were started with this `handler_id`: the id that the process
    /// made at its start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
    /// Id of the question, 1 to 64 characters. A message with the same id repeats the same question.
    pub question_id: String,
    /// Text of the question.
    #[serde(default)]
    pub text: String,
    /// Possible answers; an empty list withdraws the question.
    #[serde(default)]
    pub choices: Vec<String>,
}

impl Ask {
    /// Validates the id, the text and the choices.
    ///
    /// # Errors
    /// Fails if one of them is out of its limits. The error text gives the fault and the correct form.
    pub fn check(&self) -> Result<(), Refusal> {
        if !within(&self.question_id, QUESTION_ID_MAX) {
            return invalid(format!("question_id: write 1 to {QUESTION_ID_MAX} characters"));
        }
        if self.choices.is_empty() {
            return Ok(());
        }
        check_question(&self.text, &self.choices)
    }
}

/// Checks a question with its choices.
///
/// # Errors
/// Fails if the question is empty or too long, has too many choices, or a choice is empty, too long or
/// repeated.
pub fn check_question(text: &str, choices: &[String]) -> Result<(), Refusal> {
    if !within(text, QUESTION_TEXT_MAX) {
        return invalid(format!("a question has 1 to {QUESTION_TEXT_MAX} characters"));
    }
    if choices.len() > CHOICES_MAX {
        return invalid(format!("a question has at most {CHOICES_MAX} choices"));
    }
    for (place, choice) in choices.iter().enumerate() {
        if !within(choice, CHOICE_TEXT_MAX) {
            return invalid(format!("a choice has 1 to {CHOICE_TEXT_MAX} characters"));
        }
        if choices.iter().skip(place + 1).any(|other| other == choice) {
            return invalid(format!("the choice {choice:?} occurs twice"));
        }
    }
    Ok(())
}

/// Payload of `m_code/{m}/answer`: an operator answers a question.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct OperatorAnswer {
    /// Boot that issued the output.
    pub boot_id: BootId,
    /// Sequence number of the output.
    pub seq: u64,
    /// Id of the question.
    pub question_id: String,
    /// One of the choices of the question.
    pub choice: String,
    /// Sender of the answer, for the journal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub client_id: Option<String>,
}

/// Payload of `m_code/{m}/validate`: asks, when a program is loaded, whether this M code may be issued with
/// these parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Validate {
    /// Id of the request; its result contains the same id.
    pub request_id: String,
    /// Program number.
    pub program: u16,
    /// Line of the source file, from 1.
    pub line: u32,
    /// Parameters VA to VH as written in the program.
    pub params: Params,
}

/// Payload of `m_code/{m}/validate_result`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ValidateResult {
    /// Id of the request that this result answers.
    pub request_id: String,
    /// Handler that answers.
    pub handler_id: String,
    /// True if the M code may be issued; if false, the program is not loaded.
    pub ok: bool,
    /// With `ok` false: the reason.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub text: Option<String>,
}

fn within(text: &str, most: usize) -> bool {
    (1..=most).contains(&text.chars().count())
}

fn invalid(text: String) -> Result<(), Refusal> {
    Err(Refusal::new(RefusalCode::Invalid, text))
}
