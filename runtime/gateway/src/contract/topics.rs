//! Topics on which the runtime receives MQTT requests. The topics on which only the runtime publishes are in
//! [`Topic`](plc_protocol::types::topic::Topic).

use plc_protocol::wire::ROWS;
use plc_protocol::wire::message_sender::MessageSender;
use plc_protocol::wire::right::Right;
use plc_protocol::wire::row::InboundTopic;

/// Returns every incoming topic, with the right that its sender needs.
pub(crate) fn inbound_topics() -> impl Iterator<Item = (&'static InboundTopic, Right)> {
    ROWS.iter()
        .filter_map(|row| Some((row.topic.as_ref()?, row.right)))
}

/// Returns the topic of a path below the root, with its right; the levels of its sender are removed.
pub(crate) fn inbound(path: &str) -> Option<(&'static InboundTopic, Right)> {
    let (_, path) = MessageSender::split(path);
    inbound_topics().find(|(topic, _)| topic.fits(path))
}

/// Returns the filters of all incoming topics, below the root.
pub(crate) fn inbound_filters() -> impl Iterator<Item = String> {
    let unnamed = inbound_topics().map(|(topic, _)| topic.filter());
    unnamed.chain(MessageSender::FILTERS.map(ToOwned::to_owned))
}

/// Returns true for a path of incoming commands, claims and settings, which must not be retained. Presence of handlers
/// is also incoming, but is retained.
pub(crate) fn is_inbound(path: &str) -> bool {
    inbound(path).is_some_and(|(topic, _)| !topic.retained)
}

#[cfg(test)]
mod tests {
    use super::is_inbound;

    #[test]
    fn only_what_must_not_be_retained_is_inbound() {
        for path in [
            "cs/1/command/start",
            "cs/1/input/dry_run/set",
            "cs/2/m_code/5/reset",
            "motor/1/skip_input/set",
            "client/panel/cs/1/command/start",
            "handler/clamp/cs/1/m_code/5/claim",
        ] {
            assert!(is_inbound(path), "{path}");
        }
        for path in [
            "cs/1/state",
            "handler/h/presence",
            "presence",
            "cs/1/input/dry_run/state",
            "cs/1/command",
            "cs/1/command/start/x",
        ] {
            assert!(!is_inbound(path), "{path}");
        }
    }
}
