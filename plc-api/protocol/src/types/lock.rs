//! Interlock and start lock: inputs that are on as long as at least one of their sources is on.

use serde::{Deserialize, Serialize};

use super::ids::{CLIENT_ID_MAX, check_client_id, is_client_id};
use super::refusal::{Refusal, RefusalCode};

/// Name of the source that a message sets if the message contains no source.
pub const DEFAULT_SOURCE: &str = "default";

/// Largest number of characters of the reason of a lock. Reason: the text is one line of a panel.
pub const LOCK_TEXT_MAX: usize = 500;

/// Payload of `input/interlock/state` and `input/start_lock/state`: an input with the reasons why it is on.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Lock {
    /// On as long as at least one source is on.
    pub value: bool,
    /// Reasons, as given by the sources that are on.
    #[serde(default)]
    pub text: String,
    /// Sources of the input by name: those of the configuration, those that are on, and those that have an
    /// owner.
    #[serde(default)]
    pub sources: Vec<LockSource>,
}

/// One source of an interlock or start lock.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LockSource {
    /// Name of the source; `default` if the message that set it named no source.
    pub source: String,
    /// On or off.
    pub value: bool,
    /// Reason, as given by the source.
    #[serde(default)]
    pub text: String,
    /// The handler that owns the source: while the owner is not lost, only this handler and an operator
    /// (`force`) may clear the source. Null if a client without presence has set the source; any such client
    /// may clear it. Also null, with `lost`, for a source of the configuration that has had no owner since
    /// the start.
    pub handler_id: Option<String>,
    /// True once the owner of the source is lost, and for a source of the configuration until its first owner
    /// sets the source. While true, the value is that of `on_loss`.
    #[serde(default)]
    pub lost: bool,
    /// The operator who set the source instead of its owner, until the owner writes the source again.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub forced_by: Option<String>,
}

/// Payload that sets one source of an interlock or start lock.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LockSet {
    /// On or off.
    pub value: bool,
    /// Reason, in words for the operator, at most 500 characters.
    #[serde(default)]
    pub text: String,
    /// Name of the source, 1 to 64 characters without `/ + #`; `default` if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
    /// The handler that owns the source after this message; its presence must be online. With `force`: the
    /// name of the operator.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub handler_id: Option<String>,
    /// With `handler_id`: the instance that the presence of the handler names. Required if the presence names
    /// an instance; another instance is refused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
    /// True for an operator's message: it is accepted for any owner of the source, and the source shows the
    /// name of the operator.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force: Option<bool>,
}

impl LockSet {
    /// Creates a message for the source `default` of clients without presence.
    pub fn new(value: bool, text: impl Into<String>) -> Self {
        Self {
            value,
            text: text.into(),
            ..Self::default()
        }
    }

    /// Sets the name of the source.
    #[must_use]
    pub fn of_source(mut self, source: impl Into<String>) -> Self {
        self.source = Some(source.into());
        self
    }

    /// Returns the name of the source.
    pub fn source(&self) -> &str {
        self.source.as_deref().unwrap_or(DEFAULT_SOURCE)
    }

    pub(crate) fn is_forced(&self) -> bool {
        self.force == Some(true)
    }

    /// Validates the source, the id of the handler and the text.
    ///
    /// # Errors
    /// Fails if a name is not valid, or the text is too long.
    pub(crate) fn check(&self) -> Result<(), Refusal> {
        if !is_client_id(self.source()) {
            let text = format!("source: write 1 to {CLIENT_ID_MAX} characters without / + #");
            return Err(Refusal::new(RefusalCode::Invalid, text));
        }
        if let Some(id) = &self.handler_id {
            check_client_id("handler_id", id)?;
        }
        if self.text.chars().count() > LOCK_TEXT_MAX {
            let text = format!("text: write at most {LOCK_TEXT_MAX} characters");
            return Err(Refusal::new(RefusalCode::Invalid, text));
        }
        Ok(())
    }
}

/// Value of a source after the loss of its owner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum OnLoss {
    /// The value that the owner set last; off at a start of the machine.
    #[default]
    Keep,
    /// On.
    On,
    /// Off.
    Off,
}
