//! The known state of the machine: the last message of each topic that clients can see.

use std::collections::BTreeMap;

use plc_protocol::types::machine::{ActiveAlarms, Birth, CoordinateSystemInfo, MotorInfo, Presence};
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::output::Pending;
use plc_protocol::types::run::RunState;
use plc_protocol::types::state::{
    Modal, OptionalSkip, Overrides, Position, ProgramLocation, Spindle, State, Tool,
};
use plc_protocol::types::topic::Topic;
use plc_protocol::types::{BootId, CoordinateSystemNumber};

/// The state of a machine.
#[derive(Debug, Clone, Default)]
pub struct View {
    pub presence: Presence,
    /// Start of the runtime whose messages are used.
    pub boot: BootId,
    pub birth: Birth,
    pub channels: BTreeMap<CoordinateSystemNumber, Channel>,
    pub alarms: Option<ActiveAlarms>,
}

/// A coordinate system. A value is unknown until the machine has sent it after its last silence.
#[derive(Debug, Clone, Default)]
pub struct Channel {
    pub state: Option<State>,
    pub place: Option<ProgramLocation>,
    pub position: Option<Position>,
    /// The position before `position`.
    pub position_before: Option<Position>,
    pub modal: Option<Modal>,
    pub pending: Option<Pending>,
    pub overrides: Option<Overrides>,
    pub spindle: Option<Spindle>,
    /// The spindle state before `spindle`.
    pub spindle_before: Option<Spindle>,
    pub tool: Option<Tool>,
    pub optional_skip: Option<OptionalSkip>,
    pub run: Option<RunState>,
}

/// Part of the state that a message has changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Change {
    /// The machine as a whole.
    Machine,
    /// A coordinate system.
    Channel(CoordinateSystemNumber),
    /// The alarms.
    Alarms,
}

impl View {
    /// Applies a message. A state from before the last start of the runtime is ignored.
    pub fn apply_message(&mut self, message: &Message) -> Option<Change> {
        if let Payload::Presence(presence) = &message.payload {
            if presence.online && self.boot != message.boot_id {
                self.forget();
                self.boot = message.boot_id.clone();
            }
            self.presence = presence.clone();
            return Some(Change::Machine);
        }
        if message.boot_id != self.boot {
            return None;
        }
        match (&message.topic, &message.payload) {
            (_, Payload::Birth(birth)) => {
                self.birth = birth.clone();
                Some(Change::Machine)
            }
            (_, Payload::AlarmActive(alarms)) => {
                self.alarms = Some(alarms.clone());
                Some(Change::Alarms)
            }
            (Topic::CoordinateSystem(cs, _), payload) => {
                let channel = self.channels.entry(*cs).or_default();
                channel.apply_payload(payload).then_some(Change::Channel(*cs))
            }
            _ => None,
        }
    }

    /// Discards the state of a machine that no longer sends messages.
    pub fn forget(&mut self) {
        self.channels.clear();
        self.alarms = None;
    }

    pub fn motor(&self, number: u16) -> Option<&MotorInfo> {
        self.birth.motors.iter().find(|motor| motor.number == number)
    }

    /// Returns a coordinate system with its description.
    pub fn channel(&self, number: CoordinateSystemNumber) -> Option<(&CoordinateSystemInfo, &Channel)> {
        static NOTHING: Channel = Channel::UNKNOWN;
        let mut systems = self.birth.coordinate_systems.iter();
        let info = systems.find(|info| info.number == number)?;
        Some((info, self.channels.get(&number).unwrap_or(&NOTHING)))
    }
}

impl Channel {
    const UNKNOWN: Self = Self {
        state: None,
        place: None,
        position: None,
        position_before: None,
        modal: None,
        pending: None,
        overrides: None,
        spindle: None,
        spindle_before: None,
        tool: None,
        optional_skip: None,
        run: None,
    };

    fn apply_payload(&mut self, payload: &Payload) -> bool {
        match payload {
            Payload::State(said) => self.state = Some(said.clone()),
            Payload::Program(said) => self.place = Some(said.clone()),
            Payload::Position(said) => self.position_before = self.position.replace(said.clone()),
            Payload::Modal(said) => self.modal = Some(said.clone()),
            Payload::Pending(said) => self.pending = Some(said.clone()),
            Payload::Override(said) => self.overrides = Some(*said),
            Payload::Spindle(said) => self.spindle_before = self.spindle.replace(*said),
            Payload::Tool(said) => self.tool = Some(*said),
            Payload::OptionalSkip(said) => self.optional_skip = Some(said.clone()),
            Payload::Run(said) => self.run = Some(said.clone()),
            _ => return false,
        }
        true
    }
}
