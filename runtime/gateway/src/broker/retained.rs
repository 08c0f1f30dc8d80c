//! What the broker keeps for later subscribers, in messages and bytes. States of the runtime and presences of handlers have
//! places of their own, which nobody else can fill.

use std::collections::HashMap;
use std::time::Duration;

use parking_lot::Mutex;
use tokio::time::Instant;

/// Bytes of one message besides topic and payload.
const OVERHEAD: usize = 256;

/// A message that is to be kept and was not within this time never will be: its client did not finish sending it.
const UNFINISHED_MAX: Duration = Duration::from_mins(1);

/// Kinds of messages, each with places of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// Presence of a handler.
    Presence,
    /// Any other topic of a client.
    Other,
}

impl Kind {
    /// Messages, and bytes with their topics.
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
struct Kept {
    kind: Kind,
    bytes: usize,
    /// `None` once it is kept.
    since: Option<Instant>,
}

/// Retained messages of clients, by topic.
#[derive(Debug, Default)]
pub(super) struct Retained(Mutex<HashMap<String, Kept>>);

impl Retained {
    /// A message is to be kept, or its topic to be cleared where it is empty.
    ///
    /// # Errors
    /// There is no place for it; which limit it is.
    pub(super) fn put(&self, kind: Kind, topic: &str, payload: usize) -> Result<(), String> {
        let mut topics = self.0.lock();
        if payload == 0 {
            topics.remove(topic);
            return Ok(());
        }
        let bytes = bytes(topic, payload);
        let (count_max, bytes_max) = kind.limits();
        let is_full = |topics: &HashMap<String, Kept>| {
            let others = topics
                .iter()
                .filter(|(name, kept)| kept.kind == kind && *name != topic);
            let (count, sum) = others.fold((0, 0), |(count, sum), (_, kept)| (count + 1, sum + kept.bytes));
            count >= count_max || sum + bytes > bytes_max
        };
        if is_full(&topics) {
            topics.retain(|_, kept| kept.since.is_none_or(|since| since.elapsed() < UNFINISHED_MAX));
            if is_full(&topics) {
                return Err(format!(
                    "the broker keeps {count_max} messages and {} MiB of {}, and they are full; clear topics by empty retained messages",
                    bytes_max / 1024 / 1024,
                    kind.words()
                ));
            }
        }
        let is_kept = topics.get(topic).is_some_and(|kept| kept.since.is_none());
        let since = (!is_kept).then(Instant::now);
        topics.insert(topic.to_owned(), Kept { kind, bytes, since });
        Ok(())
    }

    /// A message has been kept, or cleared where it is empty.
    pub(super) fn kept(&self, kind: Kind, topic: &str, payload: usize) {
        let mut topics = self.0.lock();
        if payload == 0 {
            topics.remove(topic);
        } else {
            let bytes = bytes(topic, payload);
            let since = None;
            topics.insert(topic.to_owned(), Kept { kind, bytes, since });
        }
    }
}

fn bytes(topic: &str, payload: usize) -> usize {
    topic.len() + payload + OVERHEAD
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn retained_messages_are_bounded_in_number_and_bytes_by_kind_and_cleared_ones_make_room() {
        let retained = Retained::default();
        let large = 255 * 1024;
        let mut kept = 0;
        let refusal = loop {
            match retained.put(Kind::Other, &format!("plant/{kept}"), large) {
                Ok(()) => retained.kept(Kind::Other, &format!("plant/{kept}"), large),
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
        assert!(again.is_ok(), "what was never sent to its end holds no place");
    }

    #[test]
    fn so_many_small_messages_are_kept() {
        let retained = Retained::default();
        let (count, _) = Kind::Presence.limits();
        for n in 0..count {
            retained.put(Kind::Presence, &n.to_string(), 10).unwrap();
        }
        assert!(retained.put(Kind::Presence, "one more", 10).is_err());
        assert!(retained.put(Kind::Presence, "7", 20).is_ok());
    }
}
