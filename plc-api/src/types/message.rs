//! A message: topic, envelope and payload.

use serde::{Deserialize, Serialize};

use super::command::CommandReply;
use super::lease::LeaseState;
use super::machine::{ActiveAlarms, AlarmRecord, Birth, Presence};
use super::output::{Cancel, HandlerPresence, HandshakeResult, OutputNotice, Pending};
use super::question::Validate;
use super::state::{
    Captured, Lock, Modal, OptionalSkip, Overrides, Position, ProgramPlace, Spindle, State, Switch, Tool,
};
use super::topic::{CsTopic, Topic, state_topics};
use super::{BootId, Timestamp};

/// Version of the interface, `v` in every message.
pub const INTERFACE_VERSION: u32 = 1;

/// What the runtime says on one topic.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    /// Where it belongs.
    pub topic: Topic,
    /// The boot that says it.
    pub boot_id: BootId,
    /// When.
    pub ts: Timestamp,
    /// For state: grows by at least one with each change of that topic.
    pub rev: Option<u64>,
    /// What it says.
    pub payload: Payload,
}

/// What a message says, by topic.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
#[allow(
    missing_docs,
    reason = "each variant is the payload type of the same name, documented there"
)]
pub enum Payload {
    Presence(Presence),
    Birth(Birth),
    AlarmEvent(AlarmRecord),
    AlarmActive(ActiveAlarms),
    Reply(CommandReply),
    HandlerPresence(HandlerPresence),
    State(State),
    Program(ProgramPlace),
    Position(Position),
    Modal(Modal),
    Pending(Pending),
    Output(OutputNotice),
    Result(HandshakeResult),
    Cancel(Cancel),
    Validate(Validate),
    Captured(Captured),
    OptionalSkip(OptionalSkip),
    Switch(Switch),
    Lock(Lock),
    Spindle(Spindle),
    Tool(Tool),
    Override(Overrides),
    Lease(LeaseState),
}

#[derive(Serialize)]
struct EnvelopeOut<'a> {
    v: u32,
    boot_id: &'a BootId,
    ts: &'a Timestamp,
    #[serde(skip_serializing_if = "Option::is_none")]
    rev: Option<u64>,
    #[serde(flatten)]
    payload: &'a Payload,
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
    /// The JSON form: envelope and payload in one object.
    pub fn to_json(&self) -> String {
        let envelope = EnvelopeOut {
            v: INTERFACE_VERSION,
            boot_id: &self.boot_id,
            ts: &self.ts,
            rev: self.rev,
            payload: &self.payload,
        };
        serde_json::to_string(&envelope).unwrap_or_else(|_| "{}".to_owned())
    }

    /// Reads the JSON form of a message of this topic.
    ///
    /// # Errors
    /// The text is not JSON, or not of the topic's form.
    pub fn from_json(topic: Topic, json: &[u8]) -> Result<Message, serde_json::Error> {
        let envelope: EnvelopeIn = serde_json::from_slice(json)?;
        let payload = Payload::from_json(&topic, json)?;
        Ok(Message {
            topic,
            boot_id: envelope.boot_id,
            ts: envelope.ts,
            rev: envelope.rev,
            payload,
        })
    }
}

macro_rules! payloads {
    ($($name:ident $path:literal $payload:ident($type:ident);)*) => {
        fn of_coordinate_system(topic: CsTopic, json: &[u8]) -> Result<Payload, serde_json::Error> {
            use serde_json::from_slice;
            Ok(match topic {
                $(CsTopic::$name => Payload::$payload(from_slice::<$type>(json)?),)*
                CsTopic::Output(_) => Payload::Output(from_slice(json)?),
                CsTopic::Result(_) => Payload::Result(from_slice(json)?),
                CsTopic::Cancel(_) => Payload::Cancel(from_slice(json)?),
                CsTopic::Validate(_) => Payload::Validate(from_slice(json)?),
            })
        }
    };
}

state_topics!(payloads);

impl Payload {
    fn from_json(topic: &Topic, json: &[u8]) -> Result<Payload, serde_json::Error> {
        use serde_json::from_slice;
        Ok(match topic {
            Topic::Presence => Payload::Presence(from_slice(json)?),
            Topic::Birth => Payload::Birth(from_slice(json)?),
            Topic::AlarmEvent => Payload::AlarmEvent(from_slice(json)?),
            Topic::AlarmActive => Payload::AlarmActive(from_slice(json)?),
            Topic::Reply(_) => Payload::Reply(from_slice(json)?),
            Topic::HandlerPresence(_) => Payload::HandlerPresence(from_slice(json)?),
            Topic::CoordinateSystem(_, topic) => of_coordinate_system(*topic, json)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
