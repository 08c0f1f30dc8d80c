//! The age limit of a request in its body or payload.

use serde::Deserialize;
use serde_json::{Value, json};

use super::json::json_object;
use super::parameter::Fault;
use super::row::{Body, IncomingRequest, NOT_AFTER, RequestParts, Source};
use crate::types::not_after::NotAfter;

/// Returns true for hold, stop, abort and the end of a jog: no age limit, also no invalid one, prevents them. `args` are
/// the arguments of the command.
pub(super) fn names_urgent(params: &[(&str, &str)], args: impl FnOnce() -> Option<Value>) -> bool {
    let mut params = params.iter();
    match params.find(|(name, _)| *name == "verb") {
        Some((_, "hold" | "stop" | "abort")) => true,
        Some((_, "jog")) => args().is_some_and(|args| args["end"] == true),
        _ => false,
    }
}

/// Returns the arguments of a command in the payload of a message.
pub(super) fn args_of(payload: &[u8]) -> Option<Value> {
    let mut payload: Value = serde_json::from_slice(payload).ok()?;
    payload.get_mut("args").map(Value::take)
}

impl IncomingRequest<'_> {
    /// Returns the age limit that the body or payload contains.
    pub(super) fn not_after(&self) -> Result<Option<NotAfter>, Fault> {
        #[derive(Deserialize)]
        struct AgeLimit {
            not_after: Option<NotAfter>,
        }
        let not_after = match &self.source {
            Source::Command(meta, _) => meta.not_after.clone(),
            _ if !self.not_after_is_apart || self.body.is_empty() => None,
            _ if names_urgent(self.params, || serde_json::from_slice(&self.body).ok()) => None,
            _ => {
                json_object::<AgeLimit>(&self.body)
                    .map_err(Fault::Json)?
                    .not_after
            }
        };
        if let Some(not_after) = &not_after {
            not_after.check().map_err(Fault::Invalid)?;
        }
        Ok(not_after)
    }
}

impl RequestParts {
    /// Adds an age limit to the body and to the payload of a request.
    pub(super) fn limit_age(&mut self, not_after: Option<&NotAfter>) {
        let Some(not_after) = not_after else { return };
        if let Body::Nothing = self.body {
            self.body = Body::Json(json!({}));
        }
        let body = match &mut self.body {
            Body::Json(body) => Some(body),
            Body::Nothing | Body::Text(_) => None,
        };
        for fields in body.into_iter().chain(&mut self.payload) {
            fields[NOT_AFTER] = json!(not_after);
        }
    }
}
