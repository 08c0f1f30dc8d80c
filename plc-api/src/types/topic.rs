//! Topics: one table of everything that the runtime says, with its path, retain flag and quality of service.

use super::CoordinateSystemNumber;

/// Names one thing that the runtime says. Paths are relative to `{prefix}/tandem/v1/{machine}/`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Topic {
    /// `presence`
    Presence,
    /// `birth`
    Birth,
    /// `alarm/event`
    AlarmEvent,
    /// `alarm/active`
    AlarmActive,
    /// `reply/{client_id}`
    Reply(String),
    /// `handler/{id}/presence`
    HandlerPresence(String),
    /// `cs/{cs}/...`
    CoordinateSystem(CoordinateSystemNumber, CsTopic),
}

/// Every topic of one coordinate system that says a state: variant, path, and variant and type of its payload.
macro_rules! state_topics {
    ($with:ident) => {
        $with! {
            State "state" State(State);
            Program "program" Program(ProgramPlace);
            Position "position" Position(Position);
            Modal "modal" Modal(Modal);
            Pending "m_code/pending" Pending(Pending);
            Captured "captured" Captured(Captured);
            OptionalSkip "input/optional_skip/state" OptionalSkip(OptionalSkip);
            OptionalStop "input/optional_stop/state" Switch(Switch);
            SingleBlock "input/single_block/state" Switch(Switch);
            DryRun "input/dry_run/state" Switch(Switch);
            Interlock "input/interlock/state" Lock(Lock);
            StartLock "input/start_lock/state" Lock(Lock);
            Spindle "spindle/state" Spindle(Spindle);
            Tool "tool/state" Tool(Tool);
            Override "override/state" Override(Overrides);
            Lease "lease/state" Lease(LeaseState);
        }
    };
}
pub(super) use state_topics;

macro_rules! topics {
    ($($name:ident $path:literal $payload:ident($type:ident);)*) => {
        /// A topic of one coordinate system.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum CsTopic {
            $(#[doc = concat!("`", $path, "`")] $name,)*
            /// `m_code/{m}/output`
            Output(u16),
            /// `m_code/{m}/result`
            Result(u16),
            /// `m_code/{m}/cancel`
            Cancel(u16),
            /// `m_code/{m}/validate`
            Validate(u16),
        }

        impl CsTopic {
            /// Topics whose last value is kept and retained, with their paths.
            pub const STATES: [(CsTopic, &'static str); 16] = [$((CsTopic::$name, $path),)*];

            /// Path below the coordinate system's, with `{m}` as its M number.
            fn pattern(self) -> &'static str {
                match self {
                    $(CsTopic::$name => $path,)*
                    CsTopic::Output(_) => "m_code/{m}/output",
                    CsTopic::Result(_) => "m_code/{m}/result",
                    CsTopic::Cancel(_) => "m_code/{m}/cancel",
                    CsTopic::Validate(_) => "m_code/{m}/validate",
                }
            }

            /// Name of the type of its payload.
            pub fn payload_type(self) -> &'static str {
                match self {
                    $(CsTopic::$name => stringify!($type),)*
                    CsTopic::Output(_) => "OutputNotice",
                    CsTopic::Result(_) => "HandshakeResult",
                    CsTopic::Cancel(_) => "Cancel",
                    CsTopic::Validate(_) => "Validate",
                }
            }
        }
    };
}

state_topics!(topics);

impl CsTopic {
    fn path(self) -> String {
        match self {
            CsTopic::Output(m) | CsTopic::Result(m) | CsTopic::Cancel(m) | CsTopic::Validate(m) => {
                self.pattern().replace("{m}", &m.to_string())
            }
            state => state.pattern().to_owned(),
        }
    }

    fn parse(path: &str) -> Option<CsTopic> {
        if let Some((topic, _)) = Self::STATES.iter().find(|(_, state)| *state == path) {
            return Some(*topic);
        }
        let (m, what) = path.strip_prefix("m_code/")?.split_once('/')?;
        let m = m.parse().ok()?;
        match what {
            "output" => Some(CsTopic::Output(m)),
            "result" => Some(CsTopic::Result(m)),
            "cancel" => Some(CsTopic::Cancel(m)),
            "validate" => Some(CsTopic::Validate(m)),
            _ => None,
        }
    }
}

impl Topic {
    /// A topic of a coordinate system.
    pub fn cs(cs: CoordinateSystemNumber, topic: CsTopic) -> Self {
        Topic::CoordinateSystem(cs, topic)
    }

    /// Path below the machine's root.
    pub fn path(&self) -> String {
        match self {
            Topic::Presence => "presence".to_owned(),
            Topic::Birth => "birth".to_owned(),
            Topic::AlarmEvent => "alarm/event".to_owned(),
            Topic::AlarmActive => "alarm/active".to_owned(),
            Topic::Reply(client) => format!("reply/{client}"),
            Topic::HandlerPresence(id) => format!("handler/{id}/presence"),
            Topic::CoordinateSystem(cs, topic) => format!("cs/{cs}/{}", topic.path()),
        }
    }

    /// The topic of a path below the machine's root; `None` for a path that the runtime never publishes, such as
    /// `cs/01/state`: a topic has one path.
    pub fn parse(path: &str) -> Option<Topic> {
        Self::read(path).filter(|topic| topic.path() == path)
    }

    fn read(path: &str) -> Option<Topic> {
        match path {
            "presence" => return Some(Topic::Presence),
            "birth" => return Some(Topic::Birth),
            "alarm/event" => return Some(Topic::AlarmEvent),
            "alarm/active" => return Some(Topic::AlarmActive),
            _ => {}
        }
        let (first, rest) = path.split_once('/')?;
        match first {
            "reply" => Some(Topic::Reply(rest.to_owned())),
            "handler" => Some(Topic::HandlerPresence(rest.strip_suffix("/presence")?.to_owned())),
            "cs" => {
                let (cs, topic) = rest.split_once('/')?;
                Some(Topic::cs(cs.parse().ok()?, CsTopic::parse(topic)?))
            }
            _ => None,
        }
    }

    /// True for topics that say a state: the last value stands for all before it. False for events.
    pub fn is_state(&self) -> bool {
        !matches!(
            self,
            Topic::AlarmEvent
                | Topic::Reply(_)
                | Topic::CoordinateSystem(
                    _,
                    CsTopic::Output(_) | CsTopic::Result(_) | CsTopic::Cancel(_) | CsTopic::Validate(_)
                )
        )
    }

    /// Of an event, the state that it explains: whoever is told of both gets the event before any value of that state
    /// from after it. A `cancel` explains why `m_code/pending` no longer shows an output.
    pub fn explains(&self) -> Option<Topic> {
        match self {
            Topic::CoordinateSystem(cs, CsTopic::Cancel(_)) => Some(Topic::cs(*cs, CsTopic::Pending)),
            _ => None,
        }
    }

    /// Retain flag on MQTT: every state but the position, which is a stream.
    pub fn is_retained(&self) -> bool {
        self.is_state() && !matches!(self, Topic::CoordinateSystem(_, CsTopic::Position))
    }

    /// Quality of service on MQTT: 0 for the position stream, else 1.
    pub fn qos(&self) -> u8 {
        u8::from(!matches!(self, Topic::CoordinateSystem(_, CsTopic::Position)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_topic_is_found_again_by_its_path() {
        let cs_topics = CsTopic::STATES.map(|(topic, _)| topic).into_iter().chain([
            CsTopic::Output(100),
            CsTopic::Result(7),
            CsTopic::Cancel(0),
            CsTopic::Validate(100),
        ]);
        let topics = cs_topics.map(|topic| Topic::cs(2, topic)).chain([
            Topic::Presence,
            Topic::Birth,
            Topic::AlarmEvent,
            Topic::AlarmActive,
            Topic::Reply("hmi-1".into()),
            Topic::HandlerPresence("h".into()),
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
        ] {
            assert_eq!(Topic::parse(other), None, "{other}");
        }
    }

    #[test]
    fn only_state_is_retained_and_only_the_position_stream_has_qos_0() {
        assert!(Topic::cs(1, CsTopic::Pending).is_retained());
        assert!(!Topic::cs(1, CsTopic::Output(3)).is_retained());
        assert!(!Topic::cs(1, CsTopic::Position).is_retained());
        assert_eq!(Topic::cs(1, CsTopic::Position).qos(), 0);
        assert_eq!(Topic::cs(1, CsTopic::State).qos(), 1);
    }
}
