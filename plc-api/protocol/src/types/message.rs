//! A message: topic, envelope and payload.

use serde::Deserialize;

use super::form::MessageEnvelope;
use super::topic::Topic;
use super::{BootId, Timestamp};

pub use super::form::INTERFACE_VERSION;
pub use super::topic::Payload;

/// A message of the runtime on one topic.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    /// Topic of the message.
    pub topic: Topic,
    /// Boot that publishes the message.
    pub boot_id: BootId,
    /// Time of publication.
    pub ts: Timestamp,
    /// For a state: revision, which increases by at least one with each change of that topic.
    pub rev: Option<u64>,
    /// Payload of the message.
    pub payload: Payload,
}

#[derive(Deserialize)]
struct EnvelopeIn {
    #[serde(default)]
    boot_id: BootId,
    #[serde(default)]
    ts: Timestamp,
    rev: Option<u64>,
}

impl Message {
    /// Returns the JSON form: envelope and payload in one object.
    pub fn to_json(&self) -> String {
        let envelope = MessageEnvelope {
            v: INTERFACE_VERSION,
            boot_id: &self.boot_id,
            ts: &self.ts,
            rev: self.rev,
            payload: &self.payload,
        };
        serde_json::to_string(&envelope).unwrap_or_else(|_| "{}".to_owned())
    }

    /// Parses a message of this topic from JSON.
    ///
    /// # Errors
    /// Fails if the text is not JSON, or does not have the form of the topic.
    pub fn from_json(topic: Topic, json: &[u8]) -> Result<Message, serde_json::Error> {
        let envelope: EnvelopeIn = serde_json::from_slice(json)?;
        let payload = topic.payload(json)?;
        Ok(Message {
            topic,
            boot_id: envelope.boot_id,
            ts: envelope.ts,
            rev: envelope.rev,
            payload,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::types::state::Switch;
    use crate::types::topic::CsTopic;

    #[test]
    fn envelope_and_payload_stand_in_one_object() {
        let message = Message {
            topic: Topic::cs(1, CsTopic::OptionalStop),
            boot_id: BootId("b1".into()),
            ts: Timestamp("2026-01-01T00:00:00.000000Z".into()),
            rev: Some(3),
            payload: Payload::Switch(Switch { value: true }),
        };
        let json = message.to_json();
        let value: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!(
            value,
            serde_json::json!({"v": 1, "boot_id": "b1", "ts": "2026-01-01T00:00:00.000000Z", "rev": 3, "value": true})
        );
        assert_eq!(
            Message::from_json(message.topic.clone(), json.as_bytes()).unwrap(),
            message
        );
    }

    #[test]
    fn the_time_of_a_message_and_the_jerk_time_of_modal_are_two_fields() {
        let modal = super::super::state::Modal {
            ts: 50.0,
            ..Default::default()
        };
        let message = Message {
            topic: Topic::cs(1, CsTopic::Modal),
            boot_id: BootId("b1".into()),
            ts: Timestamp("2026-01-01T00:00:00.000000Z".into()),
            rev: Some(1),
            payload: Payload::Modal(modal),
        };
        let json = message.to_json();
        assert_eq!(json.matches("\"ts\":").count(), 1, "{json}");
        assert_eq!(
            Message::from_json(message.topic.clone(), json.as_bytes()).unwrap(),
            message
        );
    }
}
