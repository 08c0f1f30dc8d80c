//! Messages between a server (MQTT, REST) and its machine that are not part of the interface; no client sends them.

use std::net::IpAddr;
use std::time::SystemTime;

use crate::port::{BoxFuture, Port};
use crate::supervisor::Supervisor;
use crate::types::machine::BrokerInUse;
use crate::types::not_after::NotAfter;
use crate::types::request::{Answer, Refusal, Request};
use crate::wire::right::Right;

/// The port of a machine for its servers.
pub trait ServedPort: Port {
    /// Sends a request on behalf of a user whom the server has identified and judged.
    fn request_from(&self, origin: Origin, request: Request) -> BoxFuture<'_, Result<Answer, Refusal>>;

    /// Receives an event of a server; does not block.
    fn notice(&self, notice: ServerNotice);

    /// The connection to the broker is new, and notices may be lost: open outputs that nobody owns are published again, as redelivered.
    /// Ends when that is done.
    fn republish(&self) -> BoxFuture<'_, ()>;

    /// The time of day, as the machine's own messages have it.
    fn time(&self) -> SystemTime {
        SystemTime::now()
    }

    /// Timing of the servo thread; `None` in simulated time, which has none.
    fn servo_timing(&self) -> Option<ServoTiming>;

    /// Supervises the tasks of a server of this machine.
    fn supervisor(&self) -> Supervisor {
        Supervisor::default()
    }
}

/// Who has made a request, and how it came in.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Origin {
    /// Name of the token; `None`: the server asks for no tokens, or an external broker has let the user in.
    pub user: Option<String>,
    /// Address of the host that it came from, where the server knows it: not behind an external broker.
    pub from: Option<IpAddr>,
    /// How it came in.
    pub over: ServerTransport,
    /// The right that it needed.
    pub right: Right,
    /// Its age limit.
    pub not_after: Option<NotAfter>,
}

/// How a request came in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ServerTransport {
    /// Over HTTP.
    Rest,
    /// In a frame of the WebSocket.
    WebSocket,
    /// Over MQTT.
    Mqtt,
    /// By a sequence program in the process of the runtime.
    InProcess,
    /// By a command at the command line, while the runtime does not run.
    CommandLine,
}

/// Somebody was let in, or was not.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AccessNote {
    /// What it was.
    pub what: AccessKind,
    /// Who: of a refused login the name that was typed.
    pub user: Option<String>,
    /// Address of its host, where it is known.
    pub from: Option<IpAddr>,
    /// How it came in.
    pub over: ServerTransport,
    /// Method and route, or the topic.
    pub request: String,
}

/// How somebody was let in, or was not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AccessKind {
    /// A person has logged in.
    Login,
    /// A login or a token was wrong.
    LoginRefused,
    /// A user may not do what it asked for.
    Forbidden,
}

/// An event of a server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ServerNotice {
    /// State of its connection to the MQTT broker, which counts as connected until the first such event.
    BusLink {
        /// True while it is connected.
        connected: bool,
        /// To which external broker.
        broker: Option<BrokerInUse>,
    },
    /// It refused something, which is raised as a warning for the operator. At most 500 characters.
    Warning(String),
    /// Somebody was let in, or was not; the journal tells a bounded number of them.
    Access(AccessNote),
    /// It does not keep retained messages of clients, for this reason; `None`: it has room again.
    NotKept(Option<String>),
}

/// Timing of the servo thread and of the bus to the drives since their start.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ServoTiming {
    /// Servo period, s.
    pub period_s: f64,
    /// Servo cycles that were not finished when the next one was due; those that were left out are among them.
    pub overruns: u64,
    /// Servo cycles that were left out, since the servo was late by more than two periods.
    pub missed: u64,
    /// Exchanges with the drives that ended late.
    pub late_exchanges: u64,
    /// Frames to the drives that were lost.
    pub lost_frames: u64,
    /// Delay of the start of each cycle.
    pub lateness: Durations,
    /// Computing time of each cycle.
    pub computing: Durations,
}

/// A histogram of durations.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Durations {
    /// Upper bound of each bucket, s, ascending, with its count, which does not include lower buckets. The last bound
    /// is infinite.
    pub buckets: Vec<(f64, u64)>,
    /// Sum of all, s.
    pub sum_s: f64,
    /// The longest, s.
    pub max_s: f64,
}
