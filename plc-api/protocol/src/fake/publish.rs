//! Messages of the scripted machine.

use super::{FakeMachine, FakePort, boot_id};
use crate::handshake::Effect;
use crate::types::machine::{Birth, CoordinateSystemInfo, Presence};
use crate::types::message::{Message, Payload};
use crate::types::state::{Spindle, Tool};
use crate::types::topic::{CsTopic, Topic};
use crate::types::{CoordinateSystemNumber, Timestamp};

impl FakePort {
    pub(super) fn publish_birth(&self, inner: &mut FakeMachine) {
        let presence = Presence {
            online: true,
            started_at: Timestamp::from_system_time(inner.now().time),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            broker: None,
            expires_ms: None,
            url: None,
        };
        let systems = inner.systems.keys().map(|&number| CoordinateSystemInfo {
            number,
            ..CoordinateSystemInfo::default()
        });
        let birth = Birth {
            machine: "fake".to_owned(),
            coordinate_systems: systems.collect(),
            io: inner.declared_io.clone(),
            ..Birth::default()
        };
        self.publish(inner, Topic::Presence, Payload::Presence(presence));
        self.publish(inner, Topic::Birth, Payload::Birth(birth));
        self.publish_alarms(inner);
        self.publish_all_io(inner);
        self.publish_data(inner);
        for cs in inner.numbers() {
            self.apply_effect(inner, cs, Effect::PendingChanged);
            self.publish(
                inner,
                Topic::cs(cs, CsTopic::Tool),
                Payload::Tool(Tool::default()),
            );
            let spindle = Payload::Spindle(Spindle::default());
            self.publish(inner, Topic::cs(cs, CsTopic::Spindle), spindle);
            self.publish_system(inner, cs);
        }
    }

    /// Publishes variables, tools and work offsets if they have changed.
    pub(super) fn publish_data(&self, inner: &mut FakeMachine) {
        let systems = inner.numbers();
        for (topic, payload) in inner.data.messages(&systems) {
            self.publish_new(inner, topic, payload);
        }
    }

    /// Publishes the state and the inputs of a coordinate system if they have changed.
    pub(super) fn publish_system(&self, inner: &mut FakeMachine, cs: CoordinateSystemNumber) {
        let alarm_count = inner.alarm_count(cs);
        let Some(system) = inner.systems.get_mut(&cs) else {
            return;
        };
        for (topic, payload) in system.follow(alarm_count) {
            self.publish_new(inner, Topic::cs(cs, topic), payload);
        }
    }

    /// Publishes a value if it differs from the last value of its topic, or if that last value is of another
    /// boot.
    pub(super) fn publish_new(&self, inner: &mut FakeMachine, topic: Topic, payload: Payload) {
        let last = self.hub.read(&topic);
        if last.is_none_or(|last| last.payload != payload || last.boot_id != boot_id(inner.boot)) {
            self.publish(inner, topic, payload);
        }
    }

    pub(super) fn publish(&self, inner: &mut FakeMachine, topic: Topic, payload: Payload) {
        inner.rev += 1;
        self.hub.publish(Message {
            rev: topic.is_state().then_some(inner.rev),
            topic,
            boot_id: boot_id(inner.boot),
            ts: Timestamp::from_system_time(inner.now().time),
            payload,
        });
    }
}
