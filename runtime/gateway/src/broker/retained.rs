//! Messages that the broker retains, with limits on their number and size. States of the runtime and presences of
//! handlers have separate limits, which other topics cannot use up.

use std::collections::HashMap;
use std::time::Duration;

use parking_lot::Mutex;
use plc_protocol::types::output::HandlerPresence;
use tokio::time::Instant;

/// Bytes of one message in addition to topic and payload.
const OVERHEAD: usize = 256;

/// Time limit within which a client must finish sending a retained message. After this time the message is not kept.
const UNFINISHED_MAX: Duration = Duration::from_mins(1);

/// Kinds of messages, each with separate limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// Presence of a handler.
    Presence,
    /// Any other topic of a client.
    Other,
}

impl Kind {
    /// Returns the largest number of messages of this kind, and of their bytes with their topics.
    pub(super) const fn limits(self) -> (usize, usize) {
        match self {
            Kind::Presence => (2048, 16 * 1024 * 1024),
            Kind::Other => (2048, 32 * 1024 * 1024),
        }
    }

    fn words(self) -> &'static str {
        match self {
            Kind::Presence => "presences of handlers",
            Kind::Other => "other topics",
        }
    }
}

#[derive(Debug)]
struct RetainedEntry {
    kind: Kind,
    bytes: usize,
    /// `None` once it is kept.
    since: Option<Instant>,
    /// When the handler was reported offline. Its presence may then be evicted.
    offline_since: Option<Instant>,
}

/// Retained messages of clients.
#[derive(Debug, Default)]
pub(super) struct RetainedMessages(Mutex<RetainedTable>);

#[derive(Debug, Default)]
struct RetainedTable {
    topics: HashMap<String, RetainedEntry>,
    /// Kind and size of the first message that was not kept since there was last room for all.
    refused: Option<(Kind, usize)>,
    is_reported: bool,
}

impl RetainedTable {
    /// Returns true if the limits of this kind permit a retained message of this size in this topic.
    fn fits(&self, kind: Kind, topic: &str, bytes: usize) -> bool {
        let (count_max, bytes_max) = kind.limits();
        let others = self
            .topics
            .iter()
            .filter(|(name, kept)| kept.kind == kind && *name != topic);
        let (count, sum) = others.fold((0, 0), |(count, sum), (_, kept)| (count + 1, sum + kept.bytes));
        count < count_max && sum + bytes <= bytes_max
    }

    /// Evicts the presence of the handler that went offline first.
    fn evict_presence(&mut self) -> Option<String> {
        let gone = self
            .topics
            .iter()
            .filter_map(|(topic, kept)| Some((kept.offline_since?, topic)));
        let (_, topic) = gone.min()?;
        let topic = topic.clone();
        self.topics.remove(&topic);
        Some(topic)
    }
}

impl RetainedMessages {
    /// Reserves room for a message that is to be kept; an empty message clears its topic. Returns the topic that must
    /// be cleared to make room, if any.
    ///
    /// # Errors
    /// Returns the limit that is reached if there is no room.
    pub(super) fn put(&self, kind: Kind, topic: &str, payload: usize) -> Result<Option<String>, String> {
        let mut table = self.0.lock();
        if payload == 0 {
            table.topics.remove(topic);
            return Ok(None);
        }
        let bytes = bytes(topic, payload);
        let mut clear = None;
        if !table.fits(kind, topic, bytes) {
            table
                .topics
                .retain(|_, kept| kept.since.is_none_or(|since| since.elapsed() < UNFINISHED_MAX));
            if !table.fits(kind, topic, bytes) && kind == Kind::Presence {
                clear = table.evict_presence();
            }
            if !table.fits(kind, topic, bytes) {
                table.refused.get_or_insert((kind, bytes));
                let (count_max, bytes_max) = kind.limits();
                return Err(format!(
                    "the broker's store for {count_max} messages and {} MiB of {} is full; clear topics by \
                     empty retained messages",
                    bytes_max / 1024 / 1024,
                    kind.words()
                ));
            }
        }
        let known = table.topics.get(topic);
        let since = known.is_none_or(|kept| kept.since.is_some()).then(Instant::now);
        let gone = known.and_then(|kept| kept.offline_since);
        let kept = RetainedEntry {
            kind,
            bytes,
            since,
            offline_since: gone,
        };
        table.topics.insert(topic.to_owned(), kept);
        Ok(clear)
    }

    /// Records that a message has been kept, or cleared if it is empty. Returns `true` when there is room again after a
    /// rejection.
    pub(super) fn record_retained(&self, kind: Kind, topic: &str, payload: &[u8]) -> bool {
        let mut table = self.0.lock();
        if payload.is_empty() {
            table.topics.remove(topic);
        } else {
            let bytes = bytes(topic, payload.len());
            let is_gone = kind == Kind::Presence
                && serde_json::from_slice::<HandlerPresence>(payload).is_ok_and(|presence| !presence.online);
            let kept = RetainedEntry {
                kind,
                bytes,
                since: None,
                offline_since: is_gone.then(Instant::now),
            };
            table.topics.insert(topic.to_owned(), kept);
        }
        let has_room = table
            .refused
            .is_some_and(|(kind, bytes)| table.fits(kind, "", bytes));
        if has_room {
            table.refused = None;
            table.is_reported = false;
        }
        has_room
    }

    /// Returns `true` once after the first message that was not kept.
    pub(super) fn is_newly_full(&self) -> bool {
        let mut table = self.0.lock();
        table.refused.is_some() && !std::mem::replace(&mut table.is_reported, true)
    }
}

fn bytes(topic: &str, payload: usize) -> usize {
    topic.len() + payload + OVERHEAD
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn retained_messages_are_bounded_per_kind_and_clearing_one_frees_space() {
        let retained = RetainedMessages::default();
        let large = 255 * 1024;
        let mut kept = 0;
        let refusal = loop {
            match retained.put(Kind::Other, &format!("plant/{kept}"), large) {
                Ok(_) => {
                    retained.record_retained(Kind::Other, &format!("plant/{kept}"), &vec![0; large]);
                }
                Err(text) => break text,
            }
            kept += 1;
        };
        assert_eq!(kept, 128, "32 MiB of 255 KiB and their topics");
        assert!(refusal.contains("32 MiB"), "{refusal}");
        assert!(
            retained.put(Kind::Other, "plant/0", large).is_ok(),
            "in its own place"
        );
        assert!(retained.put(Kind::Presence, "handler/h/presence", 100).is_ok());
        assert!(retained.put(Kind::Other, "plant/5", 0).is_ok());
        assert!(retained.put(Kind::Other, "plant/new", large).is_ok());
        assert!(retained.put(Kind::Other, "plant/newer", large).is_err());
        tokio::time::advance(UNFINISHED_MAX).await;
        let again = retained.put(Kind::Other, "plant/newer", large);
        assert!(again.is_ok(), "an incomplete message occupies no room");
    }

    #[test]
    fn so_many_small_messages_are_kept() {
        let retained = RetainedMessages::default();
        let (count, _) = Kind::Presence.limits();
        for n in 0..count {
            retained.put(Kind::Presence, &n.to_string(), 10).unwrap();
        }
        assert!(retained.put(Kind::Presence, "one more", 10).is_err());
        assert!(retained.put(Kind::Presence, "7", 20).is_ok());
    }

    #[tokio::test(start_paused = true)]
    async fn offline_presences_are_evicted_oldest_first_and_online_ones_stay() {
        let retained = RetainedMessages::default();
        let (count, _) = Kind::Presence.limits();
        for n in 0..count {
            let online = n % 2 == 0;
            let said = format!(r#"{{"online":{online},"handles":[]}}"#);
            assert_eq!(retained.put(Kind::Presence, &n.to_string(), said.len()), Ok(None));
            retained.record_retained(Kind::Presence, &n.to_string(), said.as_bytes());
            tokio::time::advance(Duration::from_millis(1)).await;
        }
        for n in 0..count / 2 {
            let cleared = retained.put(Kind::Presence, &format!("new/{n}"), 30).unwrap();
            assert_eq!(cleared, Some((2 * n + 1).to_string()));
            retained.record_retained(Kind::Presence, &format!("new/{n}"), br#"{"online":true}"#);
        }
        assert!(
            retained.put(Kind::Presence, "one more", 30).is_err(),
            "all are there"
        );
    }

    #[test]
    fn there_is_room_again_when_what_was_refused_would_fit() {
        let retained = RetainedMessages::default();
        let (count, _) = Kind::Other.limits();
        for n in 0..count {
            retained.put(Kind::Other, &n.to_string(), 10).unwrap();
            assert!(!retained.record_retained(Kind::Other, &n.to_string(), b"0123456789"));
        }
        assert!(retained.put(Kind::Other, "one more", 10).is_err());
        assert!(!retained.record_retained(Kind::Other, "7", b"another"));
        assert!(retained.record_retained(Kind::Other, "7", b""), "cleared");
        assert!(!retained.record_retained(Kind::Other, "8", b""), "told once");
    }
}
