//! Messages between a server (MQTT, REST) and its machine. They are not part of the interface: no client
//! sends them.

use std::net::IpAddr;
use std::time::SystemTime;

use crate::port::{BoxFuture, Port};
use crate::supervisor::Supervisor;
use crate::types::machine::BrokerInUse;
use crate::types::not_after::NotAfter;
use crate::types::request::{Answer, Refusal, Request};
use crate::wire::right::Right;

/// The port of a machine, extended for its servers.
pub trait ServedPort: Port {
    /// Sends a request on behalf of a user whom the server has authenticated and authorized.
    fn request_from(&self, origin: Origin, request: Request) -> BoxFuture<'_, Result<Answer, Refusal>>;

    /// Receives an event of a server. Does not block.
    fn notice(&self, notice: ServerNotice);

    /// Publishes open outputs without an owner again, as redelivered. A server calls this method after a new
    /// connection to the broker, because notices may have been lost. Returns when all outputs are published.
    fn republish(&self) -> BoxFuture<'_, ()>;

    /// Returns the time of day from the clock that the machine uses in its messages.
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
    /// Address of the sending host; `None` if the server does not know the address, as with an external
    /// broker.
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
    /// A request over HTTP.
    Rest,
    /// A request in a frame of the WebSocket.
    WebSocket,
    /// A request over MQTT.
    Mqtt,
    /// A request of a sequence program in the process of the runtime.
    InProcess,
    /// A request of a command at the command line, while the runtime does not run.
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
    /// Transport of the login or the access.
    pub over: ServerTransport,
    /// Method and route of the request, or its topic.
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
        /// The external broker to which the server is connected.
        broker: Option<BrokerInUse>,
    },
    /// A refusal by the server, which the machine raises as a warning for the operator. At most 500
    /// characters.
    Warning(String),
    /// A login or an access that was accepted or refused; the journal records a limited number of them.
    Access(AccessNote),
    /// Reason why the server does not store retained messages of clients; `None` when it stores them again.
    NotRetained(Option<String>),
}

/// Timing of the servo thread and of the bus to the drives since their start.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ServoTiming {
    /// Servo period, s.
    pub period_s: f64,
    /// Number of servo cycles that were not finished when the next cycle was due, including omitted cycles.
    pub overruns: u64,
    /// Number of servo cycles that were omitted because the servo was late by more than two periods.
    pub missed: u64,
    /// Number of exchanges with the drives that ended late.
    pub late_exchanges: u64,
    /// Number of frames to the drives that were lost.
    pub lost_frames: u64,
    /// Delay of the start of each cycle.
    pub lateness: Durations,
    /// Computing time of each cycle.
    pub computing: Durations,
}

/// A histogram of durations.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Durations {
    /// Buckets, ascending by their upper bound, s. The second value is the number of durations in this bucket
    /// only. The last upper bound is infinite.
    pub buckets: Vec<(f64, u64)>,
    /// Sum of all durations, s.
    pub sum_s: f64,
    /// The longest duration, s.
    pub max_s: f64,
}
