//! Registry of the handlers that are or were online, with the instance of each handler. The registry has no
//! I/O and no clock; the runtime and the scripted machine use it.
//!
//! Only one instance of a `handler_id` can be online. A second instance is refused, unless it requests the
//! take-over, or unless the online instance does not confirm its presence within [`CONFIRM_MAX_S`]. The
//! confirmation is necessary because the last will of an ended instance may never arrive. A last will may
//! also arrive late; therefore the loss of an instance does not affect a later instance. A handler that
//! leaves keeps its M codes, outputs and levels for the time that it announced. Without an announcement, the
//! handler keeps them for the grace time.

use std::collections::BTreeMap;
use std::time::SystemTime;

use crate::handshake::{handler_in_use_text, unnamed_text};
use crate::types::CoordinateSystemNumber;
use crate::types::alarm_text::AlarmText;
use crate::types::handler::{Departure, is_own_instance};
use crate::types::ids::check_client_id;
use crate::types::m_code::MCodeDeclaration;
use crate::types::output::{HandledCode, HandlerPresence};
use crate::types::refusal::{Refusal, RefusalCode};

/// Largest number of handlers in the registry, online or offline. If all are online, a further handler is
/// refused.
pub const HANDLERS_MAX: usize = 256;

/// Time within which the online instance must confirm its presence after another instance has announced the
/// same handler, s.
pub const CONFIRM_MAX_S: f64 = 2.0;

/// Largest number of M codes of one handler: all M codes in each of 8 coordinate systems.
const HANDLED_CODES_MAX: usize = 8 * 192;

/// An instance of a handler that another instance has replaced.
#[derive(Debug, Clone, PartialEq)]
pub struct DisplacedInstance {
    /// Presence of the replaced instance.
    pub presence: HandlerPresence,
    /// Text of the notification to the replaced instance.
    pub text: String,
    /// `TakenOver` if the other instance requested the take-over, `Unannounced` if the replaced instance did
    /// not confirm its presence.
    pub departure: Departure,
}

/// Effect of a presence message.
#[derive(Debug, Clone, PartialEq)]
pub enum PresenceEffect {
    /// The handler is online.
    Online {
        /// The other instance that this instance has replaced; `None` if no other instance was online.
        took_over: Option<Box<DisplacedInstance>>,
        /// Id of an offline handler that was removed because the registry was full.
        forgotten: Option<String>,
        /// True if the same instance was online before, then offline. The machine then requests another
        /// announcement, so that the instance writes its levels again even if it has not noticed its loss.
        has_returned: bool,
    },
    /// The handler was already online, and renewed its presence before the presence expired.
    Refreshed,
    /// The handler went offline. If the handler was offline already, this is its original departure.
    Offline(Departure),
    /// No effect: the presence concerns an instance that is no longer online.
    Nothing,
}

/// Registry of handlers by their ids.
#[derive(Debug, Default)]
pub struct HandlerRegistry {
    handlers: BTreeMap<String, RegisteredHandler>,
    /// Time within which a handler that left without an announcement may return, s.
    grace_s: f64,
}

/// A handler that is or was online.
#[derive(Debug)]
struct RegisteredHandler {
    presence: HandlerPresence,
    /// Time of day at which the handler came online.
    since: SystemTime,
    /// Time of the pending request to confirm the presence, seconds since the start of the runtime; `None` if
    /// no request is pending.
    asked_s: Option<f64>,
    /// Absence of the handler; `None` while the handler is online.
    absence: Option<Absence>,
    reach: Reach,
}

/// Transport by which a handler receives the request to confirm its presence.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reach {
    /// The handler subscribes to `handler/{id}/result` and receives the request there.
    Subscribed,
    /// The handler registered by an HTTP request and receives no request to confirm. Only the age of its
    /// presence shows whether the handler is online.
    Polling,
}

/// Absence of a handler that has left.
#[derive(Debug, Clone)]
struct Absence {
    /// Last presence of the handler while it was online: the M codes that it serves when it returns, and their
    /// declarations.
    online: HandlerPresence,
    departure: Departure,
}

impl HandlerRegistry {
    /// Creates an empty registry. `grace_s` is the time within which a handler that left without an
    /// announcement may return. `HandlerRegistry::default()` has no grace time.
    pub fn with_grace(grace_s: f64) -> Self {
        Self {
            grace_s,
            ..Self::default()
        }
    }

    /// Records a presence message of a handler that subscribes to its results.
    ///
    /// # Errors
    /// Fails like [`set_over`](Self::set_over).
    pub fn set(
        &mut self,
        id: &str,
        presence: &HandlerPresence,
        now: SystemTime,
        now_s: f64,
    ) -> Result<PresenceEffect, Refusal> {
        self.set_over(Reach::Subscribed, id, presence, (now, now_s))
    }

    /// Records a presence message. The last argument is the current time: the time of day, and the seconds
    /// since the start of the runtime.
    ///
    /// # Errors
    /// Fails if the id or the instance is not valid, if the handler serves too many M codes, or if
    /// [`HANDLERS_MAX`] handlers are online. Fails with `handler_taken` if another instance is online;
    /// [`instance_to_confirm`](Self::instance_to_confirm) returns that instance if it must confirm its
    /// presence.
    pub fn set_over(
        &mut self,
        reach: Reach,
        id: &str,
        presence: &HandlerPresence,
        (now, now_s): (SystemTime, f64),
    ) -> Result<PresenceEffect, Refusal> {
        check_client_id("handler_id", id)?;
        presence.check()?;
        if presence.handles.len().max(presence.m_codes.len()) > HANDLED_CODES_MAX {
            let text = format!("a handler serves at most {HANDLED_CODES_MAX} M codes");
            return Err(Refusal::new(RefusalCode::TooLarge, text));
        }
        let kept = HandlerPresence {
            take_over: false,
            ..presence.clone()
        };
        let absence = self.absence_after(id, presence, now_s);
        let has_returned = self.has_returned(id, presence);
        let unconfirmed = Departure::Unannounced {
            until_s: now_s + self.grace_s,
        };
        let there = self.handlers.get_mut(id).filter(|there| there.presence.online);
        let (mut since, mut took_over) = (now, None);
        match there {
            Some(there) if there.presence == kept && kept.expires_ms.is_some() => {
                there.asked_s = None;
                there.reach = reach;
                return Ok(PresenceEffect::Refreshed);
            }
            Some(there) if there.presence.instance == presence.instance => since = there.since,
            Some(_) if !presence.online => return Ok(PresenceEffect::Nothing),
            Some(there) => {
                took_over = Some(Box::new(DisplacedInstance {
                    text: there.admit_replacement(id, presence, now_s)?,
                    departure: if presence.take_over {
                        Departure::TakenOver
                    } else {
                        unconfirmed
                    },
                    presence: there.presence.clone(),
                }));
            }
            None => {}
        }
        let forgotten = self.make_room(id)?;
        let departure = absence.as_ref().map(|absence| absence.departure);
        let entry = RegisteredHandler {
            presence: kept,
            since,
            asked_s: None,
            absence,
            reach,
        };
        self.handlers.insert(id.to_owned(), entry);
        Ok(match departure {
            Some(departure) => PresenceEffect::Offline(departure),
            None => PresenceEffect::Online {
                took_over,
                forgotten,
                has_returned,
            },
        })
    }

    /// Removes an offline handler if the registry is full and does not contain the handler `id`. Returns the
    /// id of the removed handler.
    ///
    /// # Errors
    /// Fails if all handlers are online.
    fn make_room(&mut self, id: &str) -> Result<Option<String>, Refusal> {
        if self.handlers.len() < HANDLERS_MAX || self.handlers.contains_key(id) {
            return Ok(None);
        }
        let offline = self.handlers.iter().find(|(_, entry)| !entry.presence.online);
        let offline = offline.map(|(id, _)| id.clone()).ok_or_else(|| {
            let text = format!("{HANDLERS_MAX} handlers are connected, which is the limit");
            Refusal::new(RefusalCode::Unavailable, text)
        })?;
        self.handlers.remove(&offline);
        Ok(Some(offline))
    }

    /// Returns true if this presence brings an instance online that was online before and is offline now.
    fn has_returned(&self, id: &str, presence: &HandlerPresence) -> bool {
        let before = self.handlers.get(id).map(|entry| &entry.presence);
        presence.online
            && presence.instance.is_some()
            && before.is_some_and(|before| !before.online && before.instance == presence.instance)
    }

    /// Returns the instance of a handler that must confirm its presence, or `None` if no confirmation is
    /// pending.
    pub fn instance_to_confirm(&self, id: &str) -> Option<&str> {
        let entry = self.handlers.get(id).filter(|entry| entry.asked_s.is_some())?;
        entry.presence.instance.as_deref()
    }

    /// Returns all handlers that are or were online.
    pub fn all(&self) -> BTreeMap<String, HandlerPresence> {
        let all = self.handlers.iter();
        all.map(|(id, entry)| (id.clone(), entry.presence.clone()))
            .collect()
    }

    /// Returns the text that an online handler has declared for an alarm.
    pub fn alarm_text(&self, code: u16) -> Option<AlarmText> {
        let there = self.handlers.values().map(|entry| &entry.presence);
        let mut said = there
            .filter(|handler| handler.online)
            .flat_map(|handler| &handler.alarms);
        said.find(|said| said.code == code).cloned()
    }

    /// Returns true while a handler is online.
    pub fn is_online(&self, id: &str) -> bool {
        self.handlers.get(id).is_some_and(|entry| entry.presence.online)
    }

    /// Validates that a write of a level or of an output comes from the online instance of the handler.
    ///
    /// # Errors
    /// `unavailable` if the handler is offline; `not_allowed` if another instance of the handler is online,
    /// or the write does not name an instance although the presence does.
    pub fn check_writer(&self, id: &str, instance: Option<&String>) -> Result<(), Refusal> {
        let Some(entry) = self.handlers.get(id).filter(|entry| entry.presence.online) else {
            let text = format!("handler {id} is not online: announce its presence before it writes");
            return Err(Refusal::new(RefusalCode::Unavailable, text));
        };
        let online = entry.presence.instance.as_deref();
        match instance {
            None if online.is_some_and(is_own_instance) => {
                Err(Refusal::new(RefusalCode::NotAllowed, unnamed_text(id)))
            }
            Some(named) if online != Some(named) => {
                let text = handler_in_use_text(id, online, Some(named), &entry.since);
                Err(Refusal::new(RefusalCode::NotAllowed, text))
            }
            _ => Ok(()),
        }
    }

    /// Returns the absence of a handler after this presence message, or `None` if the handler is online. If
    /// the handler was absent already, its absence does not change: a last will may follow an announced
    /// departure.
    fn absence_after(&self, id: &str, presence: &HandlerPresence, now_s: f64) -> Option<Absence> {
        if presence.online {
            return None;
        }
        let known = self.handlers.get(id);
        if let Some(absence) = known.and_then(|entry| entry.absence.clone()) {
            return Some(absence);
        }
        let departure = match presence.returns_within_ms {
            Some(ms) => Departure::Announced {
                until_s: now_s + ms as f64 / 1000.0,
            },
            None => Departure::Unannounced {
                until_s: now_s + self.grace_s,
            },
        };
        Some(Absence {
            online: known.map(|entry| entry.presence.clone()).unwrap_or_default(),
            departure,
        })
    }

    /// Returns the latest time until which an absent handler of this M code may return, seconds since the
    /// start of the runtime; `None` if no absent handler of this M code may return.
    pub fn back_s(&self, cs: CoordinateSystemNumber, m: u16, now_s: f64) -> Option<f64> {
        let absent = self.handlers.values().filter_map(|entry| entry.absence.as_ref());
        let serve = absent.filter(|absence| absence.online.handles.contains(&HandledCode { cs, m }));
        let ends = serve.filter_map(|absence| absence.departure.until_s());
        ends.filter(|until_s| *until_s > now_s).reduce(f64::max)
    }

    /// Returns the earliest time after `now_s` at which an absent handler is no longer expected to return,
    /// seconds since the start of the runtime; `None` if no handler is expected to return.
    pub fn next_absence_end_s(&self, now_s: f64) -> Option<f64> {
        let absent = self.handlers.values().filter_map(|entry| entry.absence.as_ref());
        let ends = absent.filter_map(|absence| absence.departure.until_s());
        ends.filter(|until_s| *until_s > now_s).reduce(f64::min)
    }

    /// Returns the declarations of an M code, with the ids of their handlers: handlers that are online, and absent
    /// handlers that may still return.
    pub fn declarations(
        &self,
        cs: CoordinateSystemNumber,
        m: u16,
        now_s: f64,
    ) -> Vec<(String, MCodeDeclaration)> {
        let serving = self.handlers.iter().filter_map(|(id, entry)| {
            let presence = match &entry.absence {
                None => &entry.presence,
                Some(absence) if absence.departure.until_s().is_some_and(|until_s| until_s > now_s) => {
                    &absence.online
                }
                Some(_) => return None,
            };
            Some((id, presence))
        });
        serving
            .filter_map(|(id, presence)| Some((id.clone(), presence.declaration(cs, m)?.clone())))
            .collect()
    }

    /// Returns true if an online handler serves this M code.
    pub fn serve(&self, cs: CoordinateSystemNumber, m: u16) -> bool {
        let mut there = self.handlers.values().map(|entry| &entry.presence);
        there.any(|handler| handler.online && handler.handles.contains(&HandledCode { cs, m }))
    }
}

impl RegisteredHandler {
    /// Decides whether `other` may replace this instance; returns the text of the notification to this
    /// instance.
    fn admit_replacement(
        &mut self,
        id: &str,
        other: &HandlerPresence,
        now_s: f64,
    ) -> Result<String, Refusal> {
        let there = self.presence.instance.as_deref();
        let by = other.instance.as_deref().unwrap_or("that names none");
        if other.take_over {
            return Ok(format!(
                "instance {by} has taken over handler_id {id}: this program must end"
            ));
        }
        // An instance is asked to confirm only if it has named itself. If the server has named it, the server detects
        // the end of its connection.
        let may_be_asked = self.reach == Reach::Subscribed && there.is_some_and(is_own_instance);
        let asked_s = may_be_asked.then(|| *self.asked_s.get_or_insert(now_s));
        if asked_s.is_some_and(|asked_s| now_s - asked_s >= CONFIRM_MAX_S) {
            return Ok(format!(
                "instance {by} has replaced this program as handler_id {id}, because this program did not confirm its presence within {CONFIRM_MAX_S} s"
            ));
        }
        let text = handler_in_use_text(id, there, other.instance.as_ref(), &self.since);
        Err(Refusal::new(RefusalCode::HandlerTaken, text))
    }
}

#[cfg(test)]
mod tests;
