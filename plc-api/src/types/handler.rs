//! Handlers: the M codes they serve, the instance that speaks for each, and what they may do twice.

use std::collections::BTreeSet;
use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use super::CoordinateSystemNumber;
use super::alarm_text::{self, AlarmText};
use super::m_code::{MCodeDeclaration, ServedMCode, check_all};
use super::redelivery::Redelivery;
use super::refusal::{Refusal, RefusalCode};

/// Age at which a presence that is not said again counts as gone, ms.
pub const EXPIRES_MS: RangeInclusive<u64> = 300..=3_600_000;

/// Presences within the time of one, so that two may be lost.
pub const REFRESHES: u32 = 3;

/// Time in which a handler that leaves may say that it is back, ms.
pub const RETURNS_WITHIN_MS: RangeInclusive<u64> = 1..=3_600_000;

/// Characters of the id of an instance.
pub const INSTANCE_MAX: usize = 64;

/// Begins the instance that a server end gives to a client that names none: its connection.
pub const CONNECTION_MARK: char = '~';

/// Payload of `handler/{id}/presence`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[allow(clippy::struct_excessive_bools, reason = "they are members of a message")]
pub struct HandlerPresence {
    /// False: the handler has gone, or its connection was lost.
    pub online: bool,
    /// What it handles.
    #[serde(default)]
    pub handles: Vec<HandledCode>,
    /// True when it answers `validate`.
    #[serde(default)]
    pub validates: bool,
    /// Which of the programs that were started with this id: 1 to 64 characters without `/ + # ~`, made at its start and kept
    /// over reconnections. While one is there, another is refused. Without it, the connection counts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
    /// With `online`: takes the place of the instance that is there, which is told so.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub take_over: bool,
    /// With `instance`: it begins with an output as soon as `m_code/pending` names it and this instance as the owner. Where no
    /// other handler serves an M code, the machine then claims each output for it in the step that makes the output, and
    /// no claim is sent (rule H20).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub exclusive: bool,
    /// What it does with an output that was claimed when its handler was lost. The strictest counts of what is said here and in
    /// the configuration of the M code; where neither says anything, it is `ask`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub redelivery: Option<Redelivery>,
    /// What it says of the M codes: their names, the parameters that they take, and what it does with a lost output of each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub m_codes: Vec<MCodeDeclaration>,
    /// What it says of its alarms: remedies and languages.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub alarms: Vec<AlarmText>,
    /// With `online`: it says its presence again well within this time, at best at a third of it, ms, 300 to 3,600,000. When it
    /// does not, it counts as gone, as if its last will had come. Absent: its last will alone says that it has gone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expires_ms: Option<u64>,
    /// Without `online`: it comes back within this time, ms, 1 to 3,600,000. Until then its M codes count as served, and their
    /// outputs wait for it; afterwards as where no handler is registered.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub returns_within_ms: Option<u64>,
    /// With `expires_ms`: counts the connections of this instance. A presence that is the same as before is no news; over a new
    /// connection it is, and unclaimed outputs are published again.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub connection: Option<u64>,
}

impl HandlerPresence {
    /// That an instance has gone.
    pub fn gone(instance: Option<String>) -> Self {
        Self {
            instance,
            ..Self::default()
        }
    }

    /// What it says of an M code that it serves.
    pub fn declaration(&self, cs: CoordinateSystemNumber, m: u16) -> Option<&MCodeDeclaration> {
        let of = |wanted| {
            let mut said = self.m_codes.iter();
            said.find(|said| said.m == m && said.cs == wanted)
        };
        of(Some(cs))
            .or_else(|| of(None))
            .filter(|_| self.handles.contains(&HandledCode { cs, m }))
    }

    /// What it does with an output of an M code that was claimed when its handler was lost; `None`: it says nothing.
    pub fn redelivery_of(&self, cs: CoordinateSystemNumber, m: u16) -> Option<Redelivery> {
        let declared = self.declaration(cs, m).and_then(|said| said.redelivery);
        declared.or(self.redelivery)
    }

    /// The M codes that it serves, ascending, where it is there.
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

    /// Whether it can be sent by a request of HTTP, which belongs to no connection: it names its instance and its age.
    ///
    /// # Errors
    /// What to write.
    pub fn check_registration(&self) -> Result<(), String> {
        let names_itself = self.instance.as_deref().is_some_and(is_own_instance);
        if !names_itself {
            let text = "instance: write a name that the process makes at its start, 1 to 64 characters without / + # ~";
            return Err(text.to_owned());
        }
        if self.online && self.expires_ms.is_none() {
            let text = "expires_ms: write 300 to 3600000, and send this again at a third of that time: nothing else shows that the \
                        handler is there";
            return Err(text.to_owned());
        }
        Ok(())
    }

    /// Whether its instance has a right name, its age a right limit, and what it says of its M codes can be.
    ///
    /// # Errors
    /// `invalid`: what to write.
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

/// How a handler came to be absent. Times are seconds since the start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Departure {
    /// It announced that it is back before this time (`returns_within_ms`).
    Announced {
        /// The time.
        until_s: f64,
    },
    /// Its connection, its process or its presence ended without such an announcement.
    Unannounced {
        /// Until when the grace time lasts.
        until_s: f64,
    },
    /// Another instance took its place.
    TakenOver,
}

impl Departure {
    /// Until when its M codes, outputs and levels wait for it; `None`: another instance has them.
    pub fn until_s(self) -> Option<f64> {
        match self {
            Departure::Announced { until_s } | Departure::Unannounced { until_s } => Some(until_s),
            Departure::TakenOver => None,
        }
    }
}

/// True for an instance that a client has named itself, which outlives its connections.
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

/// What became of a presence.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum HandlerStatus {
    /// The handler serves its M codes.
    Accepted,
    /// It does not; `text` says why, such as that another instance of this id is there.
    Refused,
    /// Another instance of this id has come: the one that is there says its presence again within 2 s, or the other takes its
    /// place.
    Confirm,
    /// Another instance has taken its place: it ends its work, and claims and resets nothing more.
    TakenOver,
}

/// Payload of `handler/{id}/result`: the answer to an `online` presence, a question whether it is still there, or that its place was
/// taken.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct HandlerResult {
    /// Always `presence`.
    pub of: HandlerAct,
    /// Whom it is for.
    #[serde(default)]
    pub instance: Option<String>,
    /// What became of it.
    pub status: HandlerStatus,
    /// With `refused`: machine-readable.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub code: Option<RefusalCode>,
    /// With `refused` and `taken_over`: why, and what to do.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub text: Option<String>,
}

impl HandlerResult {
    /// The presence counts.
    pub fn accepted(instance: Option<String>) -> Self {
        Self {
            of: HandlerAct::Presence,
            instance,
            status: HandlerStatus::Accepted,
            code: None,
            text: None,
        }
    }

    /// The presence does not count.
    pub fn refused(instance: Option<String>, refusal: &Refusal) -> Self {
        Self {
            status: HandlerStatus::Refused,
            code: Some(refusal.code),
            text: Some(refusal.text.clone()),
            ..Self::accepted(instance)
        }
    }

    /// The instance that is there is asked whether it still is.
    pub fn confirm(instance: Option<String>) -> Self {
        Self {
            status: HandlerStatus::Confirm,
            ..Self::accepted(instance)
        }
    }

    /// Another instance has taken the place of this one.
    pub fn taken_over(instance: Option<String>, text: String) -> Self {
        Self {
            status: HandlerStatus::TakenOver,
            text: Some(text),
            ..Self::accepted(instance)
        }
    }
}

/// What a `handler/{id}/result` answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum HandlerAct {
    /// A presence.
    Presence,
}
