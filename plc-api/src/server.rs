//! Messages between a server (MQTT, REST) and its machine that are not part of the interface; no client sends
//! them.

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
    /// Sends a request on behalf of a user whom the server has authenticated and authorized.
    fn request_from(&self, origin: Origin, request: Request) -> BoxFuture<'_, Result<Answer, Refusal>>;

    /// Receives an event of a server; does not block.
    fn notice(&self, notice: ServerNotice);

    /// Publishes open outputs without an owner again, as redelivered, after a new connection to the broker,
    /// because notices may have been lost. Returns when all are published.
    fn republish(&self) -> BoxFuture<'_, ()>;

    /// Returns the time of day, as in the machine's own messages.
    fn time(&self) -> SystemTime {
        SystemTime::now()
    }

    /// Returns the timing of the servo thread, or `None` in simulated time, which has no servo thread.
    fn servo_timing(&self) -> Option<ServoTiming>;

    /// Returns the supervisor of the tasks of this machine's servers.
    fn supervisor(&self) -> Supervisor {
        Supervisor::default()
    }
}

/// Sender of a request, and its transport.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Origin {
    /// Name of the token; `None` if the server requires no tokens, or an external broker has authenticated
    /// the user.
    pub user: Option<String>,
    /// Address of the sending host, if the server knows it; unknown with an external broker.
    pub from: Option<IpAddr>,
    /// Transport of the request.
    pub over: ServerTransport,
    /// The right that the request required.
    pub right: Right,
    /// Age limit of the request.
    pub not_after: Option<NotAfter>,
}

/// Transport of a request.
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

/// A login or an access that was accepted or refused.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AccessNote {
    /// Kind of the event.
    pub what: AccessKind,
    /// The user; for a refused login, the name that was typed.
    pub user: Option<String>,
    /// Address of the host, if it is known.
    pub from: Option<IpAddr>,
    /// Transport.
    pub over: ServerTransport,
    /// Method and route, or the topic.
    pub request: String,
}

/// Kind of a login or access event.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AccessKind {
    /// A person has logged in.
    Login,
    /// A login was refused, or a token was not valid.
    LoginRefused,
    /// A user requested an action without the right for it.
    Forbidden,
}

/// An event of a server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ServerNotice {
    /// State of the connection to the MQTT broker. Until the first such event, the connection is assumed to
    /// exist.
    BusLink {
        /// True while the connection exists.
        connected: bool,
        /// The external broker.
        broker: Option<BrokerInUse>,
    },
    /// A refusal of the server, which is raised as a warning for the operator. At most 500 characters.
    Warning(String),
    /// A login or an access that was accepted or refused; the journal records a limited number of them.
    Access(AccessNote),
    /// The server does not store retained messages of clients, for this reason; `None` if it has room again.
    NotRetained(Option<String>),
}

/// Timing of the servo thread and of the bus to the drives since their start.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ServoTiming {
    /// Servo period, s.
    pub period_s: f64,
    /// Servo cycles that were not finished when the next one was due, including the omitted ones.
    pub overruns: u64,
    /// Servo cycles that were omitted because the servo was late by more than two periods.
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
    /// Upper bound of each bucket, s, ascending, with its count, which does not include lower buckets. The
    /// last bound is infinite.
    pub buckets: Vec<(f64, u64)>,
    /// Sum of all, s.
    pub sum_s: f64,
    /// The longest, s.
    pub max_s: f64,
}
