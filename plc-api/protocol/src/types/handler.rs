//! Handlers: the M codes they serve, their instances, and what happens to their outputs after a loss.

use std::collections::BTreeSet;
use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use super::CoordinateSystemNumber;
use super::alarm_text::{self, AlarmText};
use super::m_code::{MCodeDeclaration, ServedMCode, check_all};
use super::redelivery::Redelivery;
use super::refusal::{Refusal, RefusalCode};

/// Range of `expires_ms`: age at which a presence that is not repeated expires, ms.
pub const EXPIRES_MS: RangeInclusive<u64> = 300..=3_600_000;

/// Number of presences that a handler publishes within `expires_ms`, so that two of them may be lost.
pub const REFRESHES: u32 = 3;

/// Range of `returns_within_ms`: announced time within which a handler that leaves returns, ms.
pub const RETURNS_WITHIN_MS: RangeInclusive<u64> = 1..=3_600_000;

/// Largest number of characters of an instance name.
pub const INSTANCE_MAX: usize = 64;

/// First character of an instance name that a server assigns to a client without an instance name. The other
/// characters identify the connection.
pub const CONNECTION_MARK: char = '~';

/// Payload of `handler/{id}/presence`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[allow(clippy::struct_excessive_bools, reason = "they are members of a message")]
pub struct HandlerPresence {
    /// False if the handler has left or its connection was lost.
    pub online: bool,
    /// M codes that the handler serves.
    #[serde(default)]
    pub handles: Vec<HandledCode>,
    /// True if the handler answers `validate`.
    #[serde(default)]
    pub validates: bool,
    /// Identifies one process among all that were started with this handler id: 1 to 64 characters without
    /// `/ + # ~`, made at the start of the process and kept across reconnections. While one instance is online,
    /// another instance is refused. Without this field, the connection identifies the instance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
    /// With `online`: this instance replaces the instance that is online, which is notified.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub take_over: bool,
    /// With `instance`: the handler begins work on an output as soon as `m_code/pending` shows this instance
    /// as the owner of the output. If no other handler serves the M code, the machine claims each output for
    /// this instance in the step that issues the output, and no claim is sent (rule H20).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub exclusive: bool,
    /// Treatment of an output that was claimed when its handler was lost. The stricter of this value and the
    /// value in the configuration of the M code applies; if neither is set, `ask` applies.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub redelivery: Option<Redelivery>,
    /// Declarations of the M codes: their names, their parameters, and the treatment of their outputs after a
    /// loss of the handler.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub m_codes: Vec<MCodeDeclaration>,
    /// Texts of the handler's alarms: remedies and languages.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub alarms: Vec<AlarmText>,
    /// With `online`: validity of this presence, ms, 300 to 3,600,000. The handler repeats its presence well
    /// within this time, preferably at a third of it. Otherwise the handler is treated as offline, as if its
    /// last will had been received. Without this field, only the last will reports that the handler has left.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expires_ms: Option<u64>,
    /// With `online` false: the handler will return within this time, ms, 1 to 3,600,000. Until then its M
    /// codes are treated as served, and their outputs wait for the handler; afterwards the M codes are
    /// treated as if no handler were registered.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub returns_within_ms: Option<u64>,
    /// With `expires_ms`: number of this connection among those of the instance. An unchanged presence that
    /// is repeated over the same connection has no effect. After a presence over a new connection, unclaimed
    /// outputs are published again.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub connection: Option<u64>,
}

impl HandlerPresence {
    /// Creates the presence of an instance that has left.
    pub fn offline(instance: Option<String>) -> Self {
        Self {
            instance,
            ..Self::default()
        }
    }

    /// Returns the declaration of an M code that the handler serves.
    pub fn declaration(&self, cs: CoordinateSystemNumber, m: u16) -> Option<&MCodeDeclaration> {
        let of = |wanted| {
            let mut said = self.m_codes.iter();
            said.find(|said| said.m == m && said.cs == wanted)
        };
        of(Some(cs))
            .or_else(|| of(None))
            .filter(|_| self.handles.contains(&HandledCode { cs, m }))
    }

    /// Returns the declared treatment of a claimed output of an M code after the loss of the handler, or
    /// `None` if the handler declares none.
    pub fn redelivery_of(&self, cs: CoordinateSystemNumber, m: u16) -> Option<Redelivery> {
        let declared = self.declaration(cs, m).and_then(|said| said.redelivery);
        declared.or(self.redelivery)
    }

    /// Returns the M codes that the handler serves, ascending; empty if the handler is offline.
    pub fn served(&self, handler_id: &str) -> Vec<ServedMCode> {
        let handled = self.handles.iter().filter(|_| self.online);
        let handled: BTreeSet<_> = handled.map(|code| (code.m, code.cs)).collect();
        let mut all: Vec<ServedMCode> = Vec::new();
        for (m, cs) in handled {
            let declared = self.declaration(cs, m);
            let name = declared.and_then(|declared| declared.name.clone());
            let params = declared.and_then(|declared| declared.params.clone());
            let mut of_m = all.iter_mut().rev().take_while(|one| one.m == m);
            match of_m.find(|one| one.name == name && one.params == params) {
                Some(same) => same.cs.push(cs),
                None => all.push(ServedMCode {
                    m,
                    cs: vec![cs],
                    handler_id: Some(handler_id.to_owned()),
                    name,
                    params,
                }),
            }
        }
        all
    }

    /// Checks that the presence can be sent by an HTTP request, which has no connection: the presence must
    /// name its instance and its validity.
    ///
    /// # Errors
    /// Fails if `instance` is missing or a name that a server assigned, or if `online` is true without
    /// `expires_ms`. The error text gives the correct form.
    pub fn check_registration(&self) -> Result<(), String> {
        let names_itself = self.instance.as_deref().is_some_and(is_own_instance);
        if !names_itself {
            let text = "instance: write a name that the process makes at its start, 1 to 64 characters without / + # ~";
            return Err(text.to_owned());
        }
        if self.online && self.expires_ms.is_none() {
            let text = "expires_ms: write 300 to 3600000, and send the presence again at a third of that time, because only the \
                        presence shows that the handler is online";
            return Err(text.to_owned());
        }
        Ok(())
    }

    /// Validates the instance name, the times, and the declarations of M codes and alarms.
    ///
    /// # Errors
    /// Fails with `invalid` or `too_large` if one of them is not allowed. The error text gives the correct
    /// form.
    pub fn check(&self) -> Result<(), Refusal> {
        let (least, most) = (*EXPIRES_MS.start(), *EXPIRES_MS.end());
        if let Some(wrong) = self.expires_ms.filter(|ms| !EXPIRES_MS.contains(ms)) {
            let text = format!("expires_ms {wrong}: write {least} to {most}");
            return Err(Refusal::new(RefusalCode::Invalid, text));
        }
        if let Some(wrong) = self.returns_within_ms {
            let (least, most) = (*RETURNS_WITHIN_MS.start(), *RETURNS_WITHIN_MS.end());
            if self.online || !RETURNS_WITHIN_MS.contains(&wrong) {
                let text = format!("returns_within_ms {wrong}: write {least} to {most}, with online false");
                return Err(Refusal::new(RefusalCode::Invalid, text));
            }
        }
        let is_right = |instance: &String| {
            !instance.is_empty()
                && instance.chars().nth(INSTANCE_MAX).is_none()
                && !instance.contains(['/', '+', '#', '\0'])
        };
        if self.instance.as_ref().is_none_or(is_right) {
            alarm_text::check_all(&self.alarms)?;
            return check_all(&self.m_codes);
        }
        let text = format!("instance: write 1 to {INSTANCE_MAX} characters without / + # ~");
        Err(Refusal::new(RefusalCode::Invalid, text))
    }
}

/// Kind of a handler's departure. Times are seconds since the start of the runtime.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Departure {
    /// The handler announced that it returns before this time (`returns_within_ms`).
    Announced {
        /// The announced time.
        until_s: f64,
    },
    /// The handler announced no return: its connection or process ended, or its presence expired.
    Unannounced {
        /// End of the time for which the machine waits for the handler.
        until_s: f64,
    },
    /// Another instance replaced the handler.
    TakenOver,
}

impl Departure {
    /// Returns the time until which the M codes, outputs and levels of the handler wait for its return, or
    /// `None` if another instance has taken them over.
    pub fn until_s(self) -> Option<f64> {
        match self {
            Departure::Announced { until_s } | Departure::Unannounced { until_s } => Some(until_s),
            Departure::TakenOver => None,
        }
    }
}

/// Returns true for an instance name that the client itself chose; such a name stays the same over several
/// connections.
pub fn is_own_instance(instance: &str) -> bool {
    !instance.starts_with(CONNECTION_MARK)
}

/// One M code that a handler serves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct HandledCode {
    /// Coordinate system.
    pub cs: u8,
    /// M number.
    pub m: u16,
}

/// Status in the answer to a presence.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum HandlerStatus {
    /// The handler serves its M codes.
    Accepted,
    /// The handler does not serve its M codes; `text` gives the reason, such as another online instance of
    /// this id.
    Refused,
    /// Another instance of this id requests to come online. The online instance must repeat its presence
    /// within 2 s; otherwise the other instance replaces it.
    Confirm,
    /// Another instance has replaced this instance, which must end its work and send no further claims and
    /// resets.
    TakenOver,
}

/// Payload of `handler/{id}/result`: the answer to an `online` presence, a request to confirm that the
/// instance is still online, or the notice that another instance has replaced it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct HandlerResult {
    /// Always `presence`.
    pub of: HandlerAct,
    /// Instance to which the message is addressed.
    #[serde(default)]
    pub instance: Option<String>,
    /// Result of the presence.
    pub status: HandlerStatus,
    /// With `refused`: machine-readable reason.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub code: Option<RefusalCode>,
    /// With `refused` and `taken_over`: the reason and the remedy.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub text: Option<String>,
}

impl HandlerResult {
    /// Creates the answer to an accepted presence.
    pub fn accepted(instance: Option<String>) -> Self {
        Self {
            of: HandlerAct::Presence,
            instance,
            status: HandlerStatus::Accepted,
            code: None,
            text: None,
        }
    }

    /// Creates the answer to a refused presence.
    pub fn refused(instance: Option<String>, refusal: &Refusal) -> Self {
        Self {
            status: HandlerStatus::Refused,
            code: Some(refusal.code),
            text: Some(refusal.text.clone()),
            ..Self::accepted(instance)
        }
    }

    /// Creates the request to the online instance to confirm that it is still online.
    pub fn confirm(instance: Option<String>) -> Self {
        Self {
            status: HandlerStatus::Confirm,
            ..Self::accepted(instance)
        }
    }

    /// Creates the notice that another instance has replaced this one.
    pub fn taken_over(instance: Option<String>, text: String) -> Self {
        Self {
            status: HandlerStatus::TakenOver,
            text: Some(text),
            ..Self::accepted(instance)
        }
    }
}

/// Message that a `handler/{id}/result` answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum HandlerAct {
    /// A presence.
    Presence,
}
