//! Topics: one table of all published messages, each with its path, route, payload and explanation.

use serde::Serialize;

use super::CoordinateSystemNumber;
use super::command::CommandReply;
use super::data::{PublishedVariables, ToolTable, WorkOffsetValues};
use super::form::{Form, MessageEnvelope};
use super::handler::{HandlerPresence, HandlerResult};
use super::heartbeat::Heartbeat;
use super::io::{IoPoint, IoSide, IoState};
use super::lease::LeaseState;
use super::machine::{ActiveAlarms, AlarmRecord, Birth, Presence};
use super::output::{Cancel, HandshakeResult, OutputNotice, Pending};
use super::question::Validate;
use super::run::{RunState, TimeLeft};
use super::start::StartConditions;
use super::state::{
    CapturedPositions, Lock, Modal, OptionalSkip, Overrides, Position, ProgramLocation, Spindle, State,
    Switch, Tool,
};
use super::stored_data::StoredData;

/// Identifies one topic of the runtime. Paths are relative to `{prefix}/tandem/v1/{machine}/`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum Topic {
    /// `presence`
    Presence,
    /// `birth`
    Birth,
    /// `heartbeat`
    Heartbeat,
    /// `alarm/event`
    AlarmEvent,
    /// `alarm/active`
    AlarmActive,
    /// `reply/{client_id}`
    Reply(String),
    /// `handler/{id}/presence`
    HandlerPresence(String),
    /// `handler/{id}/result`
    HandlerResult(String),
    /// `io/in/{name}` and `io/out/{name}`
    Io(IoPoint),
    /// `variables`
    Variables,
    /// `tools`
    Tools,
    /// `stored_data`
    StoredData,
    /// `cs/{cs}/...`
    CoordinateSystem(CoordinateSystemNumber, CsTopic),
}

/// Payload of a message, by topic.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
#[allow(
    missing_docs,
    reason = "each variant is the payload type of the same name, documented there"
)]
#[non_exhaustive]
pub enum Payload {
    Presence(Presence),
    Birth(Birth),
    Heartbeat(Heartbeat),
    AlarmEvent(AlarmRecord),
    AlarmActive(ActiveAlarms),
    Reply(CommandReply),
    HandlerPresence(HandlerPresence),
    HandlerResult(HandlerResult),
    Io(IoState),
    Variables(PublishedVariables),
    Tools(ToolTable),
    StoredData(StoredData),
    WorkOffsets(WorkOffsetValues),
    State(State),
    Program(ProgramLocation),
    Position(Position),
    Modal(Modal),
    Pending(Pending),
    Output(OutputNotice),
    Result(HandshakeResult),
    Cancel(Cancel),
    Validate(Validate),
    Captured(CapturedPositions),
    OptionalSkip(OptionalSkip),
    Switch(Switch),
    Lock(Lock),
    Spindle(Spindle),
    Tool(Tool),
    Override(Overrides),
    Lease(LeaseState),
    Run(RunState),
    TimeLeft(TimeLeft),
    StartConditions(StartConditions),
}

/// Topics of one coordinate system: each with its path, the variant and type of its payload, and its
/// description. A state also has a REST route, which is empty if a separate request reads the state. An event
/// also has the M number of an output.
macro_rules! cs_topics {
    (
        states {$($state:ident $path:literal $route:literal $payload:ident($type:ident) $says:literal;)*}
        events {$($event:ident $event_path:literal $event_payload:ident($event_type:ident) $event_says:literal;)*}
    ) => {
        /// A topic of one coordinate system.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[non_exhaustive]
        pub enum CsTopic {
            $(#[doc = concat!("`", $path, "`")] $state,)*
            $(#[doc = concat!("`m_code/{m}/", $event_path, "`")] $event(u16),)*
        }

        impl CsTopic {
            /// State topics, whose last value is kept and retained, with their paths.
            pub const STATES: [(CsTopic, &'static str); 21] = [$((CsTopic::$state, $path),)*];

            /// Returns the path below that of the coordinate system.
            fn path(self) -> String {
                match self {
                    $(CsTopic::$state => $path.to_owned(),)*
                    $(CsTopic::$event(m) => format!("m_code/{m}/{}", $event_path),)*
                }
            }

            fn parse(path: &str) -> Option<CsTopic> {
                if let Some((topic, _)) = Self::STATES.iter().find(|(_, state)| *state == path) {
                    return Some(*topic);
                }
                let (m, what) = path.strip_prefix("m_code/")?.split_once('/')?;
                let m = m.parse().ok()?;
                match what {
                    $($event_path => Some(CsTopic::$event(m)),)*
                    _ => None,
                }
            }

            /// Returns the route, below `/api/v1`, whose answer is the last message of this state, or `None`.
            pub fn route(self) -> Option<&'static str> {
                match self {
                    $(CsTopic::$state => Some(concat!("/cs/{cs}/", $route)).filter(|_| !$route.is_empty()),)*
                    $(CsTopic::$event(_) => None,)*
                }
            }

            /// Returns the description of the topic in one sentence.
            pub fn summary(self) -> &'static str {
                match self {
                    $(CsTopic::$state => $says,)*
                    $(CsTopic::$event(_) => $event_says,)*
                }
            }

            /// Returns the form of the messages of this topic.
            pub fn form(self) -> Form {
                match self {
                    $(CsTopic::$state => Form::for_type::<MessageEnvelope<'static, $type>>(),)*
                    $(CsTopic::$event(_) => Form::for_type::<MessageEnvelope<'static, $event_type>>(),)*
                }
            }

            /// Returns all event topics of this M code, one for each kind of event.
            pub fn events(m: u16) -> impl Iterator<Item = CsTopic> {
                [$(CsTopic::$event(m)),*].into_iter()
            }

            fn is_event(self) -> bool {
                matches!(self, $(CsTopic::$event(_))|*)
            }

            fn payload(self, json: &[u8]) -> Result<Payload, serde_json::Error> {
                Ok(match self {
                    $(CsTopic::$state => Payload::$payload(serde_json::from_slice(json)?),)*
                    $(CsTopic::$event(_) => Payload::$event_payload(serde_json::from_slice(json)?),)*
                })
            }
        }
    };
}

cs_topics! {
    states {
        State "state" "state" State(State)
            "State of a coordinate system: state word, reason, awaited output, program, inputs; its ETag is the revision for If-Match.";
        Program "program" "program" Program(ProgramLocation)
            "Place in the program: line whose motion runs, call stack; published at most 5 times a second.";
        Position "position" "position" Position(Position)
            "Positions of the last servo cycle, distance to go and feedrate; published 10 times a second, also at rest.";
        Modal "modal" "modal" Modal(Modal)
            "Modal state: G codes, F, S, ta, td; the jerk time is ts_ms, because ts is the time of every message.";
        Pending "m_code/pending" "m_codes" Pending(Pending)
            "Open auxiliary function outputs, with parameters, state and owner.";
        Captured "captured" "captured" Captured(CapturedPositions)
            "Positions captured by the last G31.";
        OptionalSkip "input/optional_skip/state" "inputs/optional_skip" OptionalSkip(OptionalSkip)
            "Optional block skips.";
        OptionalStop "input/optional_stop/state" "inputs/optional_stop" Switch(Switch)
            "The optional stop input.";
        SingleBlock "input/single_block/state" "inputs/single_block" Switch(Switch)
            "The single block input.";
        DryRun "input/dry_run/state" "inputs/dry_run" Switch(Switch)
            "The dry run input.";
        Interlock "input/interlock/state" "inputs/interlock" Lock(Lock)
            "The interlock input.";
        StartLock "input/start_lock/state" "inputs/start_lock" Lock(Lock)
            "The start lock input.";
        Spindle "spindle/state" "spindle" Spindle(Spindle)
            "The spindle.";
        Tool "tool/state" "tool" Tool(Tool)
            "The tool in the spindle.";
        Override "override/state" "overrides" Override(Overrides)
            "Overrides, percent.";
        Lease "lease/state" "lease" Lease(LeaseState)
            "Holder of the control lease; all fields are null while the lease is free.";
        Run "run" "run" Run(RunState)
            "The run of the loaded program that is in progress, or the last run that ended: parts, kind of the end, waits and alarms.";
        TimeLeft "time_left" "time_left" TimeLeft(TimeLeft)
            "Remaining time of the running program, and its completed share; once a second.";
        StartConditions "start_conditions" "start_conditions" StartConditions(StartConditions)
            "Obstacles that prevent a start of the loaded program, or would end its run by an alarm; empty if a start runs the program.";
        Variables "variables" "variables" Variables(PublishedVariables)
            "The Q variables that the configuration names in [[variables.published]], whenever one of them has changed; at most 10 times a second.";
        WorkOffsets "work_offsets" "" WorkOffsets(WorkOffsetValues)
            "Work offsets, whenever one of them has changed.";
    }
    events {
        Output "output" Output(OutputNotice)
            "An output of an M code is issued, or published again.";
        Result "result" Result(HandshakeResult)
            "Result of a claim or reset, or the reason why another message about an output is rejected; `of` names the kind of message.";
        Cancel "cancel" Cancel(Cancel)
            "An output is cancelled, with the reason.";
        Validate "validate" Validate(Validate)
            "Asks handlers at a program load whether the M code may be issued with these parameters.";
    }
}

impl Topic {
    /// Creates a topic of a coordinate system.
    pub fn cs(cs: CoordinateSystemNumber, topic: CsTopic) -> Self {
        Topic::CoordinateSystem(cs, topic)
    }

    /// Returns the description of the topic in one sentence.
    pub fn summary(&self) -> &'static str {
        match self {
            Topic::Presence => "Whether the runtime is online, its version and the time of its start.",
            Topic::Birth => "Description of the machine: coordinate systems, axes, motors, M codes, limits.",
            Topic::Heartbeat => {
                "Published 10 times a second while the servo runs; not published while the servo is stopped."
            }
            Topic::AlarmEvent => {
                "An alarm is raised, with program and line, or an alarm is acknowledged or cleared."
            }
            Topic::AlarmActive => "Active alarms.",
            Topic::Reply(_) => "Status of a command: accepted, done, failed, or rejected with a reason.",
            Topic::HandlerPresence(_) => "Presence of a handler, with the M codes that it serves.",
            Topic::HandlerResult(_) => {
                "Whether the presence of a handler is accepted, or another instance is online or has replaced it."
            }
            Topic::Io(point) => match point.side {
                IoSide::In => {
                    "An input of the plant: value of a sensor, owner, and whether the value is forced."
                }
                IoSide::Out => {
                    "An output of the plant: value that sequence programs command, owner, and whether the value is forced."
                }
            },
            Topic::Variables => {
                "The P variables that the configuration names in [[variables.published]], whenever one of them has changed; at most 10 times a second."
            }
            Topic::Tools => "The tool table, whenever it has changed.",
            Topic::StoredData => {
                "Whether the stored files are consistent, and the question about inconsistent files."
            }
            Topic::CoordinateSystem(_, topic) => topic.summary(),
        }
    }

    /// Returns the form of the messages of this topic.
    pub fn form(&self) -> Form {
        match self {
            Topic::Presence => Form::for_type::<MessageEnvelope<'static, Presence>>(),
            Topic::Birth => Form::for_type::<MessageEnvelope<'static, Birth>>(),
            Topic::Heartbeat => Form::for_type::<MessageEnvelope<'static, Heartbeat>>(),
            Topic::AlarmEvent => Form::for_type::<MessageEnvelope<'static, AlarmRecord>>(),
            Topic::AlarmActive => Form::for_type::<MessageEnvelope<'static, ActiveAlarms>>(),
            Topic::Reply(_) => Form::for_type::<MessageEnvelope<'static, CommandReply>>(),
            Topic::HandlerPresence(_) => Form::for_type::<MessageEnvelope<'static, HandlerPresence>>(),
            Topic::HandlerResult(_) => Form::for_type::<MessageEnvelope<'static, HandlerResult>>(),
            Topic::Io(_) => Form::for_type::<MessageEnvelope<'static, IoState>>(),
            Topic::Variables => Form::for_type::<MessageEnvelope<'static, PublishedVariables>>(),
            Topic::Tools => Form::for_type::<MessageEnvelope<'static, ToolTable>>(),
            Topic::StoredData => Form::for_type::<MessageEnvelope<'static, StoredData>>(),
            Topic::CoordinateSystem(_, topic) => topic.form(),
        }
    }

    /// Parses the payload of a message of this topic.
    pub(super) fn payload(&self, json: &[u8]) -> Result<Payload, serde_json::Error> {
        use serde_json::from_slice;
        Ok(match self {
            Topic::Presence => Payload::Presence(from_slice(json)?),
            Topic::Birth => Payload::Birth(from_slice(json)?),
            Topic::Heartbeat => Payload::Heartbeat(from_slice(json)?),
            Topic::AlarmEvent => Payload::AlarmEvent(from_slice(json)?),
            Topic::AlarmActive => Payload::AlarmActive(from_slice(json)?),
            Topic::Reply(_) => Payload::Reply(from_slice(json)?),
            Topic::HandlerPresence(_) => Payload::HandlerPresence(from_slice(json)?),
            Topic::HandlerResult(_) => Payload::HandlerResult(from_slice(json)?),
            Topic::Io(_) => Payload::Io(from_slice(json)?),
            Topic::Variables => Payload::Variables(from_slice(json)?),
            Topic::Tools => Payload::Tools(from_slice(json)?),
            Topic::StoredData => Payload::StoredData(from_slice(json)?),
            Topic::CoordinateSystem(_, topic) => topic.payload(json)?,
        })
    }

    /// Returns the path below the machine's root.
    pub fn path(&self) -> String {
        match self {
            Topic::Presence => "presence".to_owned(),
            Topic::Birth => "birth".to_owned(),
            Topic::Heartbeat => "heartbeat".to_owned(),
            Topic::AlarmEvent => "alarm/event".to_owned(),
            Topic::AlarmActive => "alarm/active".to_owned(),
            Topic::Reply(client) => format!("reply/{client}"),
            Topic::HandlerPresence(id) => format!("handler/{id}/presence"),
            Topic::HandlerResult(id) => format!("handler/{id}/result"),
            Topic::Io(point) => point.to_string(),
            Topic::Variables => "variables".to_owned(),
            Topic::Tools => "tools".to_owned(),
            Topic::StoredData => "stored_data".to_owned(),
            Topic::CoordinateSystem(cs, topic) => format!("cs/{cs}/{}", topic.path()),
        }
    }

    /// Returns the topic of a path below the machine's root, or `None` for a path that the runtime never
    /// publishes, such as `cs/01/state`: each topic has exactly one path.
    pub fn parse(path: &str) -> Option<Topic> {
        Self::read(path).filter(|topic| topic.path() == path)
    }

    fn read(path: &str) -> Option<Topic> {
        match path {
            "presence" => return Some(Topic::Presence),
            "birth" => return Some(Topic::Birth),
            "heartbeat" => return Some(Topic::Heartbeat),
            "alarm/event" => return Some(Topic::AlarmEvent),
            "alarm/active" => return Some(Topic::AlarmActive),
            "variables" => return Some(Topic::Variables),
            "tools" => return Some(Topic::Tools),
            "stored_data" => return Some(Topic::StoredData),
            _ => {}
        }
        let (first, rest) = path.split_once('/')?;
        match first {
            "reply" => Some(Topic::Reply(rest.to_owned())),
            "handler" => {
                let (id, what) = rest.rsplit_once('/')?;
                match what {
                    "presence" => Some(Topic::HandlerPresence(id.to_owned())),
                    "result" => Some(Topic::HandlerResult(id.to_owned())),
                    _ => None,
                }
            }
            "io" => IoPoint::parse(rest).map(Topic::Io),
            "cs" => {
                let (cs, topic) = rest.split_once('/')?;
                Some(Topic::cs(cs.parse().ok()?, CsTopic::parse(topic)?))
            }
            _ => None,
        }
    }

    /// Returns true for topics of a state: the last value replaces all previous ones. Returns false for
    /// events.
    pub fn is_state(&self) -> bool {
        match self {
            Topic::AlarmEvent | Topic::Reply(_) | Topic::HandlerResult(_) => false,
            Topic::CoordinateSystem(_, topic) => !topic.is_event(),
            _ => true,
        }
    }

    /// Returns the state whose change an event explains. A client that subscribes to both receives the event
    /// before any later value of that state. A `cancel` explains why `m_code/pending` no longer shows an
    /// output.
    pub fn explains(&self) -> Option<Topic> {
        match self {
            Topic::CoordinateSystem(cs, CsTopic::Cancel(_)) => Some(Topic::cs(*cs, CsTopic::Pending)),
            _ => None,
        }
    }

    /// Returns true for topics that are published continuously, so that the loss of a single message does no
    /// harm.
    fn is_stream(&self) -> bool {
        matches!(
            self,
            Topic::Heartbeat | Topic::CoordinateSystem(_, CsTopic::Position)
        )
    }

    /// Returns the retain flag on MQTT: true for every state except the position and the heartbeat, which are
    /// streams.
    pub fn is_retained(&self) -> bool {
        self.is_state() && !self.is_stream()
    }

    /// Returns the quality of service on MQTT: 0 for streams, otherwise 1.
    pub fn qos(&self) -> u8 {
        u8::from(!self.is_stream())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_topic_is_found_again_by_its_path() {
        let cs_topics = CsTopic::STATES.map(|(topic, _)| topic).into_iter();
        let cs_topics = cs_topics.chain(CsTopic::events(0)).chain(CsTopic::events(100));
        let topics = cs_topics.map(|topic| Topic::cs(2, topic)).chain([
            Topic::Presence,
            Topic::Birth,
            Topic::Heartbeat,
            Topic::AlarmEvent,
            Topic::AlarmActive,
            Topic::Reply("hmi-1".into()),
            Topic::HandlerPresence("h".into()),
            Topic::HandlerResult("h".into()),
            Topic::Io(IoPoint::input("door_closed")),
            Topic::Io(IoPoint::output("lamp")),
            Topic::Variables,
            Topic::Tools,
            Topic::StoredData,
        ]);
        for topic in topics {
            assert_eq!(Topic::parse(&topic.path()), Some(topic));
        }
    }

    #[test]
    fn a_topic_has_one_path() {
        for other in [
            "cs/01/state",
            "cs/+1/state",
            "cs/1/m_code/0100/output",
            "cs/1/m_code/+100/cancel",
            "io/lamp",
            "io/in/a/b",
            "io/both/lamp",
            "io/in/",
        ] {
            assert_eq!(Topic::parse(other), None, "{other}");
        }
    }

    #[test]
    fn only_state_is_retained_and_only_streams_have_qos_0() {
        assert!(Topic::cs(1, CsTopic::Pending).is_retained());
        assert!(!Topic::cs(1, CsTopic::Output(3)).is_retained());
        assert!(!Topic::cs(1, CsTopic::Position).is_retained());
        assert_eq!(Topic::cs(1, CsTopic::Position).qos(), 0);
        assert!(!Topic::Heartbeat.is_retained());
        assert_eq!(Topic::Heartbeat.qos(), 0);
        assert_eq!(Topic::cs(1, CsTopic::State).qos(), 1);
    }
}
