//! The handlers that are present, and the instance of each. Pure; the runtime and the scripted machine share it.
//!
//! Only one instance of a `handler_id` can be present. A second one is refused unless it takes over, or unless the present one fails to
//! confirm within [`CONFIRM_MAX_S`] that it is alive: its last will may never arrive. An instance that has gone takes nothing from a
//! later one, because its last will may arrive late. One that leaves and says when it will be back keeps its M codes until then.

use std::collections::BTreeMap;
use std::time::SystemTime;

use crate::handshake::taken_text;
use crate::types::CoordinateSystemNumber;
use crate::types::alarm_text::AlarmText;
use crate::types::handler::is_own_instance;
use crate::types::ids::check_client_id;
use crate::types::output::{HandledCode, HandlerPresence};
use crate::types::refusal::{Refusal, RefusalCode};

/// Handlers that are or were there. A further one is refused.
pub const HANDLERS_MAX: usize = 256;

/// Time in which an instance that is there confirms it, when another comes, s.
pub const CONFIRM_MAX_S: f64 = 2.0;

/// M codes that one handler may say it serves: all of them in every coordinate system.
const HANDLED_CODES_MAX: usize = 8 * 192;

/// What a presence has changed.
#[derive(Debug, Clone, PartialEq)]
pub enum Registered {
    /// The handler is there.
    Online {
        /// The instance whose place it has taken, and what that one is told.
        took_over: Option<(HandlerPresence, String)>,
        /// A handler that had gone, and was forgotten for it.
        forgotten: Option<String>,
    },
    /// It was there already, and says so again before its presence is too old.
    Refreshed,
    /// It has gone.
    Offline,
    /// Nothing: it is said of an instance that is not there any more.
    Nothing,
}

/// Handlers by their ids.
#[derive(Debug, Default)]
pub struct HandlerRegistry(BTreeMap<String, Entry>);

/// A handler that is or was there.
#[derive(Debug)]
struct Entry {
    presence: HandlerPresence,
    /// Since when it is there.
    since: SystemTime,
    /// When it was asked whether it still is, and has not confirmed it, seconds since the start.
    asked_s: Option<f64>,
    /// It has left, and said that it comes back.
    away: Option<Away>,
}

/// What a handler that has left serves when it is back.
#[derive(Debug, Clone)]
struct Away {
    handles: Vec<HandledCode>,
    /// When it is back at the latest, seconds since the start.
    until_s: f64,
}

impl HandlerRegistry {
    /// Notes a presence. `now_s`: seconds since the start.
    ///
    /// # Errors
    /// Id or instance are none, it serves too many M codes, another instance is there (`handler_taken`; [`asked`](Self::asked)
    /// says whether that one is to confirm it), or there are too many handlers.
    pub fn set(
        &mut self,
        id: &str,
        presence: &HandlerPresence,
        now: SystemTime,
        now_s: f64,
    ) -> Result<Registered, Refusal> {
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
        let away = self.away_after(id, presence, now_s);
        let there = self.0.get_mut(id).filter(|there| there.presence.online);
        let (mut since, mut took_over) = (now, None);
        match there {
            Some(there) if there.presence == kept && kept.expires_ms.is_some() => {
                there.asked_s = None;
                return Ok(Registered::Refreshed);
            }
            Some(there) if there.presence.instance == presence.instance => since = there.since,
            Some(_) if !presence.online => return Ok(Registered::Nothing),
            Some(there) => {
                let text = there.place_for(id, presence, now_s)?;
                took_over = Some((there.presence.clone(), text));
            }
            None => {}
        }
        let mut forgotten = None;
        if self.0.len() >= HANDLERS_MAX && !self.0.contains_key(id) {
            let gone = self.0.iter().find(|(_, entry)| !entry.presence.online);
            let gone = gone.map(|(id, _)| id.clone()).ok_or_else(|| {
                let text = format!("{HANDLERS_MAX} handlers are connected, which is the limit");
                Refusal::new(RefusalCode::Unavailable, text)
            })?;
            self.0.remove(&gone);
            forgotten = Some(gone);
        }
        let entry = Entry {
            presence: kept,
            since,
            asked_s: None,
            away,
        };
        self.0.insert(id.to_owned(), entry);
        Ok(if presence.online {
            Registered::Online { took_over, forgotten }
        } else {
            Registered::Offline
        })
    }

    /// The instance of a handler that is to confirm that it is still there.
    pub fn asked(&self, id: &str) -> Option<&str> {
        let entry = self.0.get(id).filter(|entry| entry.asked_s.is_some())?;
        entry.presence.instance.as_deref()
    }

    /// All that are or were there.
    pub fn all(&self) -> BTreeMap<String, HandlerPresence> {
        let all = self.0.iter();
        all.map(|(id, entry)| (id.clone(), entry.presence.clone()))
            .collect()
    }

    /// What a handler that is there says of an alarm.
    pub fn alarm_text(&self, code: u16) -> Option<AlarmText> {
        let there = self.0.values().map(|entry| &entry.presence);
        let mut said = there
            .filter(|handler| handler.online)
            .flat_map(|handler| &handler.alarms);
        said.find(|said| said.code == code).cloned()
    }

    /// True while a handler is there.
    pub fn is_online(&self, id: &str) -> bool {
        self.0.get(id).is_some_and(|entry| entry.presence.online)
    }

    /// What a handler serves that leaves and comes back; its last will, which may follow, takes nothing of it away.
    fn away_after(&self, id: &str, presence: &HandlerPresence, now_s: f64) -> Option<Away> {
        let entry = self.0.get(id).filter(|_| !presence.online)?;
        match presence.returns_within_ms {
            Some(ms) if entry.presence.online => Some(Away {
                handles: entry.presence.handles.clone(),
                until_s: now_s + ms as f64 / 1000.0,
            }),
            _ => entry.away.clone(),
        }
    }

    /// When the last handler comes back that serves this M code and has left, seconds since the start.
    pub fn back_s(&self, cs: CoordinateSystemNumber, m: u16, now_s: f64) -> Option<f64> {
        let away = self.0.values().filter_map(|entry| entry.away.as_ref());
        let serve = away.filter(|away| away.handles.contains(&HandledCode { cs, m }) && away.until_s > now_s);
        serve.map(|away| away.until_s).reduce(f64::max)
    }

    /// True when a handler that is there serves this M code.
    pub fn serve(&self, cs: CoordinateSystemNumber, m: u16) -> bool {
        let mut there = self.0.values().map(|entry| &entry.presence);
        there.any(|handler| handler.online && handler.handles.contains(&HandledCode { cs, m }))
    }
}

impl Entry {
    /// Gives its place to another instance; what it is told then.
    fn place_for(&mut self, id: &str, other: &HandlerPresence, now_s: f64) -> Result<String, Refusal> {
        let there = self.presence.instance.as_deref();
        let by = other.instance.as_deref().unwrap_or("that names none");
        if other.take_over {
            return Ok(format!(
                "instance {by} has taken over handler_id {id}: this program is at its end"
            ));
        }
        // a server end knows when the connection of one that it has named itself ends
        let may_be_asked = there.is_some_and(is_own_instance);
        let asked_s = may_be_asked.then(|| *self.asked_s.get_or_insert(now_s));
        if asked_s.is_some_and(|asked_s| now_s - asked_s >= CONFIRM_MAX_S) {
            return Ok(format!(
                "instance {by} has the place of handler_id {id}: this one did not confirm within {CONFIRM_MAX_S} s that it is there"
            ));
        }
        let text = taken_text(id, there, other.instance.as_ref(), &self.since);
        Err(Refusal::new(RefusalCode::HandlerTaken, text))
    }
}

#[cfg(test)]
mod tests {
    use std::time::UNIX_EPOCH;

    use super::*;

    fn presence(online: bool, instance: Option<&str>) -> HandlerPresence {
        HandlerPresence {
            online,
            handles: vec![HandledCode { cs: 1, m: 100 }],
            instance: instance.map(ToOwned::to_owned),
            ..HandlerPresence::default()
        }
    }

    fn set(
        handlers: &mut HandlerRegistry,
        id: &str,
        presence: &HandlerPresence,
    ) -> Result<Registered, Refusal> {
        handlers.set(id, presence, UNIX_EPOCH, 0.0)
    }

    const ONLINE: Result<Registered, Refusal> = Ok(Registered::Online {
        took_over: None,
        forgotten: None,
    });

    #[test]
    fn a_code_is_served_in_its_coordinate_system_while_its_handler_is_there() {
        let mut handlers = HandlerRegistry::default();
        assert_eq!(set(&mut handlers, "gripper", &presence(true, None)), ONLINE);
        assert!(handlers.serve(1, 100));
        assert!(!handlers.serve(2, 100) && !handlers.serve(1, 101));
        let gone = set(&mut handlers, "gripper", &presence(false, None));
        assert_eq!(gone, Ok(Registered::Offline));
        assert!(!handlers.serve(1, 100) && !handlers.is_online("gripper") && !handlers.is_online("x"));
        assert_eq!(handlers.all().len(), 1);
    }

    #[test]
    fn the_codes_of_one_that_comes_back_are_awaited_until_it_is_there_or_its_time_is_over() {
        let mut handlers = HandlerRegistry::default();
        let mut at = |now_s, said: HandlerPresence| handlers.set("cell", &said, UNIX_EPOCH, now_s);
        let leaves = |ms| HandlerPresence {
            returns_within_ms: Some(ms),
            ..HandlerPresence::gone(Some("a".to_owned()))
        };
        for wrong in [
            leaves(0),
            leaves(3_600_001),
            HandlerPresence {
                online: true,
                ..leaves(9)
            },
        ] {
            let refusal = at(0.0, wrong).unwrap_err();
            assert!(refusal.text.contains("1 to 3600000"), "{refusal}");
        }
        at(0.0, presence(true, Some("a"))).unwrap();
        assert_eq!(at(1.0, leaves(5000)), Ok(Registered::Offline));
        at(2.0, HandlerPresence::gone(Some("a".to_owned()))).unwrap();
        assert!(!handlers.serve(1, 100));
        assert_eq!(
            handlers.back_s(1, 100, 2.0),
            Some(6.0),
            "its last will takes nothing away"
        );
        assert_eq!(handlers.back_s(1, 101, 2.0), None);
        assert_eq!(handlers.back_s(1, 100, 6.0), None, "its time is over");
        handlers
            .set("cell", &presence(true, Some("b")), UNIX_EPOCH, 3.0)
            .unwrap();
        assert_eq!(handlers.back_s(1, 100, 3.0), None, "it is back");
        assert!(handlers.serve(1, 100));
    }

    #[test]
    fn a_second_instance_is_refused_in_words_and_the_first_may_come_again() {
        let mut handlers = HandlerRegistry::default();
        set(&mut handlers, "cell", &presence(true, Some("a"))).unwrap();
        for other in [Some("b"), None] {
            let refusal = set(&mut handlers, "cell", &presence(true, other)).unwrap_err();
            assert_eq!(refusal.code, RefusalCode::HandlerTaken);
            for word in ["cell", "instance a", "1970-01-01", "take_over"] {
                assert!(refusal.text.contains(word), "{refusal}");
            }
        }
        assert_eq!(set(&mut handlers, "cell", &presence(true, Some("a"))), ONLINE);
        assert_eq!(set(&mut handlers, "other", &presence(true, Some("b"))), ONLINE);
    }

    #[test]
    fn an_instance_that_has_gone_takes_nothing_from_the_one_that_is_there() {
        let mut handlers = HandlerRegistry::default();
        set(&mut handlers, "cell", &presence(true, Some("a"))).unwrap();
        for other in [Some("b"), None] {
            let said = set(&mut handlers, "cell", &presence(false, other));
            assert_eq!(said, Ok(Registered::Nothing));
            assert!(handlers.is_online("cell"));
        }
        let said = set(&mut handlers, "cell", &presence(false, Some("a")));
        assert_eq!(said, Ok(Registered::Offline));
        assert_eq!(set(&mut handlers, "cell", &presence(true, Some("b"))), ONLINE);
    }

    #[test]
    fn an_instance_that_does_not_confirm_that_it_is_there_gives_its_place_to_the_next() {
        let mut handlers = HandlerRegistry::default();
        let mut at =
            |now_s: f64, instance| handlers.set("cell", &presence(true, Some(instance)), UNIX_EPOCH, now_s);
        at(0.0, "a").unwrap();
        assert!(at(10.0, "b").is_err(), "a is asked");
        assert!(at(11.9, "b").is_err(), "it still has time");
        at(11.95, "a").unwrap();
        assert!(at(12.0, "b").is_err(), "a has confirmed it, and is asked anew");
        assert!(at(13.0, "c").is_err());
        let Ok(Registered::Online {
            took_over: Some((old, text)),
            ..
        }) = at(14.0, "b")
        else {
            panic!("a has not confirmed it");
        };
        assert_eq!(old.instance.as_deref(), Some("a"));
        assert!(text.contains("instance b") && text.contains("2 s"), "{text}");
        assert!(at(14.0, "a").is_err());
    }

    #[test]
    fn a_presence_with_an_age_that_is_said_again_changes_nothing_and_confirms_that_the_instance_is_there() {
        let mut handlers = HandlerRegistry::default();
        let aging = |instance, expires_ms| HandlerPresence {
            expires_ms,
            ..presence(true, Some(instance))
        };
        let mut at = |now_s, said: HandlerPresence| handlers.set("cell", &said, UNIX_EPOCH, now_s);
        assert_eq!(at(0.0, aging("a", Some(900))), ONLINE);
        assert_eq!(at(0.3, aging("a", Some(900))), Ok(Registered::Refreshed));
        assert!(at(0.4, aging("b", None)).is_err());
        assert_eq!(at(2.3, aging("a", Some(900))), Ok(Registered::Refreshed));
        assert!(at(2.5, aging("b", None)).is_err(), "it has confirmed it");
        assert_eq!(at(2.6, aging("a", Some(600))), ONLINE, "another presence");
        assert_eq!(at(2.7, aging("a", None)), ONLINE);
        assert_eq!(at(2.8, aging("a", None)), ONLINE, "without an age as ever");
        for wrong in [0, 299, 3_600_001] {
            let refusal = at(3.0, aging("a", Some(wrong))).unwrap_err();
            assert_eq!(refusal.code, RefusalCode::Invalid);
            assert!(refusal.text.contains("300 to 3600000"), "{refusal}");
        }
    }

    #[test]
    fn only_an_instance_that_names_itself_is_asked() {
        for (instance, asked) in [(Some("a"), Some("a")), (Some("~mqtt-a"), None), (None, None)] {
            let mut handlers = HandlerRegistry::default();
            set(&mut handlers, "cell", &presence(true, instance)).unwrap();
            assert_eq!(handlers.asked("cell"), None);
            set(&mut handlers, "cell", &presence(true, Some("b"))).unwrap_err();
            assert_eq!(handlers.asked("cell"), asked);
            let later = handlers.set("cell", &presence(true, Some("b")), UNIX_EPOCH, 100.0);
            assert_eq!(later.is_ok(), asked.is_some());
        }
    }

    #[test]
    fn one_that_is_to_take_over_takes_the_place_of_the_other() {
        let mut handlers = HandlerRegistry::default();
        set(&mut handlers, "cell", &presence(true, Some("a"))).unwrap();
        let new = HandlerPresence {
            take_over: true,
            ..presence(true, Some("b"))
        };
        let Ok(Registered::Online {
            took_over: Some((old, text)),
            ..
        }) = set(&mut handlers, "cell", &new)
        else {
            panic!("it has not taken over");
        };
        assert_eq!(old.instance.as_deref(), Some("a"));
        assert!(text.contains("instance b") && text.contains("cell"), "{text}");
        let shown = handlers.all()["cell"].clone();
        assert_eq!((shown.instance.as_deref(), shown.take_over), (Some("b"), false));
    }

    #[test]
    fn of_too_many_handlers_one_that_has_gone_is_forgotten_and_one_that_is_there_never() {
        let mut handlers = HandlerRegistry::default();
        for n in 0..HANDLERS_MAX {
            set(&mut handlers, &n.to_string(), &presence(n != 7, None)).unwrap();
        }
        assert_eq!(
            set(&mut handlers, "0", &presence(true, None)),
            ONLINE,
            "known already"
        );
        let forgotten = Some("7".to_owned());
        let said = set(&mut handlers, "a", &presence(true, None));
        assert_eq!(
            said,
            Ok(Registered::Online {
                took_over: None,
                forgotten
            })
        );
        let refusal = set(&mut handlers, "b", &presence(true, None)).unwrap_err();
        assert_eq!(refusal.code, RefusalCode::Unavailable);
    }

    #[test]
    fn an_instance_is_one_level_of_a_topic() {
        let mut handlers = HandlerRegistry::default();
        for wrong in ["", "a/b", &"x".repeat(65)] {
            let refusal = set(&mut handlers, "cell", &presence(true, Some(wrong))).unwrap_err();
            assert_eq!(refusal.code, RefusalCode::Invalid, "{wrong}");
        }
    }
}
