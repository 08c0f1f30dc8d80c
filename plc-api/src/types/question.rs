//! Questions of handlers to the operator, and checks of parameters when a program is loaded.

use serde::{Deserialize, Serialize};

use super::params::Params;
use super::refusal::{Refusal, RefusalCode};
use super::{BootId, Timestamp};

/// Characters of a question: it is one or two lines of a panel.
pub const QUESTION_TEXT_MAX: usize = 200;

/// Choices of a question: they are buttons of a panel.
pub const CHOICES_MAX: usize = 8;

/// Characters of a choice.
pub const CHOICE_TEXT_MAX: usize = 40;

/// Characters of a question's id.
pub const QUESTION_ID_MAX: usize = 64;

/// A question that a handler asks the operator, as it stands with its output in `m_code/pending`, and in `state` while
/// the program waits for that output and the question has no answer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Question {
    /// Names the question; an answer names it, too.
    pub id: String,
    /// What is asked, 1 to 200 characters.
    pub text: String,
    /// What can be answered: 1 to 8 texts of 1 to 40 characters, each once.
    pub choices: Vec<String>,
    /// Since when.
    pub since: Timestamp,
    /// What was answered.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub answer: Option<String>,
}

/// Payload of `m_code/{m}/ask`: the owner of an output asks the operator. Without choices it takes the question back.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Ask {
    /// Boot that made the output.
    pub boot_id: BootId,
    /// Sequence number of the output.
    pub seq: u64,
    /// The owner.
    pub handler_id: String,
    /// Which of the programs that were started with this `handler_id`: the id that it has made at its start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
    /// Names the question, 1 to 64 characters; asked again with the same id it is the same question.
    pub question_id: String,
    /// What is asked.
    #[serde(default)]
    pub text: String,
    /// What can be answered; none takes the question back.
    #[serde(default)]
    pub choices: Vec<String>,
}

impl Ask {
    /// Whether text and choices are within their limits.
    ///
    /// # Errors
    /// What is wrong, and what to write.
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
/// It is too long, or a choice is empty, too long or there twice.
pub(crate) fn check_question(text: &str, choices: &[String]) -> Result<(), Refusal> {
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
            return invalid(format!("the choice {choice:?} stands twice"));
        }
    }
    Ok(())
}

/// Payload of `m_code/{m}/answer`: an operator answers a question.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct OperatorAnswer {
    /// Boot that made the output.
    pub boot_id: BootId,
    /// Sequence number of the output.
    pub seq: u64,
    /// Which question.
    pub question_id: String,
    /// One of its choices.
    pub choice: String,
    /// Who answers, for the journal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub client_id: Option<String>,
}

/// Payload of `m_code/{m}/validate`: may this M code be put out with these parameters? Asked when a program is loaded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Validate {
    /// Names the request; the result names it, too.
    pub request_id: String,
    /// Program number.
    pub program: u16,
    /// Line of the source file, from 1.
    pub line: u32,
    /// VA to VH as written.
    pub params: Params,
}

/// Payload of `m_code/{m}/validate_result`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ValidateResult {
    /// Of the request.
    pub request_id: String,
    /// Who answers.
    pub handler_id: String,
    /// False: the program is not loaded.
    pub ok: bool,
    /// With `ok` false: why.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub text: Option<String>,
}

fn within(text: &str, most: usize) -> bool {
    (1..=most).contains(&text.chars().count())
}

fn invalid(text: String) -> Result<(), Refusal> {
    Err(Refusal::new(RefusalCode::Invalid, text))
}
