//! The machine, from the point of view of a sequence program.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use futures_util::FutureExt;
use plc_protocol::alarm::Alarm;
use plc_protocol::error::{Error, Result};
use plc_protocol::names::unique_name;
use plc_protocol::port::{BoxFuture, Port};
#[cfg(any(feature = "mqtt", feature = "rest"))]
use plc_protocol::transport::options::MqttOptions;
use plc_protocol::types::BootId;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::command::CommandMeta;
use plc_protocol::types::data::JournalFilter;
use plc_protocol::types::io::{IoPoint, IoValue};
use plc_protocol::types::lock::LockSet;
use plc_protocol::types::machine::{AlarmRaise, AlarmRecord};
use plc_protocol::types::message::Payload;
use plc_protocol::types::not_after::{NOT_AFTER_MS, NotAfter};
use plc_protocol::types::program::ProgramInfo;
use plc_protocol::types::refusal::{Refusal, RefusalCode};
use plc_protocol::types::request::typed::{Journal, Programs, RaiseAlarm, SkipInput};
use plc_protocol::types::request::{Request, TypedRequest};
use plc_protocol::types::topic::Topic;

use crate::levels::{Levels, LockKind};
use crate::limited_port::LimitedPort;

/// A machine: one runtime with its coordinate systems. Cloning gives another handle to the same machine.
///
/// ```
/// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
/// let plc = plc_api::fake::FakePort::new([1]).plc();
/// plc.coordinate_system(1).select_tool(3).await?;
/// assert_eq!(plc.coordinate_system(1).tool().await?.id, 3);
/// # Ok(()) }
/// ```
#[derive(Clone)]
pub struct Plc {
    port: Arc<dyn Port>,
    client_id: Arc<str>,
    /// Id of the handler in whose name requests are sent; `None` before a handler is named.
    handler_id: Option<Arc<str>>,
    user: Option<Arc<str>>,
    commands: Arc<AtomicU64>,
    /// Interlocks, start locks, and inputs and outputs of the plant that this program has set.
    levels: Arc<Levels>,
    /// The tokio runtime that drives the connection; `None` for a machine in this process.
    runtime: Option<tokio::runtime::Handle>,
}

impl std::fmt::Debug for Plc {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Plc")
            .field("client_id", &self.client_id)
            .finish_non_exhaustive()
    }
}

impl Plc {
    /// Creates a handle to a machine in this process. `port` is the port of the machine, such as
    /// `runtime.port()`.
    pub fn in_process(port: Arc<dyn Port>) -> Self {
        Self {
            port,
            client_id: unique_name("plc").into(),
            handler_id: None,
            user: None,
            commands: Arc::default(),
            levels: Arc::default(),
            runtime: None,
        }
    }

    /// Creates a handle to a machine over a connection that the current tokio runtime drives.
    #[cfg(any(feature = "mqtt", feature = "rest"))]
    fn connected(port: Arc<dyn Port>, user: Option<String>) -> Self {
        Self {
            user: user.map(Into::into),
            runtime: tokio::runtime::Handle::try_current().ok(),
            ..Self::in_process(port)
        }
    }

    /// Connects to the machine at an address. Over MQTT (feature `mqtt`):
    /// `mqtt://[user:password@]host[:port]/[prefix/]machine`, with TLS `mqtts://...`; the default port is
    /// 1883, with TLS 8883. Over REST and WebSocket (feature `rest`): `http://[[user:]token@]host[:port]`;
    /// the default port is 80.
    ///
    /// If a broker has several nodes, write `host[:port],host[:port]`: the first node that answers is used
    /// until its connection is lost.
    ///
    /// The token of a handler is valid only for the name of its user. Therefore a program without a
    /// [`handler_id`](crate::SequenceProgram::handler_id) uses the user name of the address, if the address
    /// has a user name.
    ///
    /// Waits up to 10 s for the runtime. If the connection is lost later, it is restored automatically,
    /// without a time limit.
    ///
    /// # Errors
    /// Fails if the address is invalid, no broker answers, the broker refuses the user, or no runtime is
    /// online under the name of the machine.
    #[cfg_attr(
        not(any(feature = "mqtt", feature = "rest")),
        expect(clippy::unused_async, reason = "only transports wait")
    )]
    pub async fn connect(address: &str) -> Result<Self> {
        let wrong = |reason: &str| Error::Address {
            address: address.to_owned(),
            reason: reason.to_owned(),
        };
        match address.split_once("://") {
            #[cfg(feature = "mqtt")]
            Some(("mqtt" | "mqtts", _)) => Self::connect_with(address, MqttOptions::default()).await,
            #[cfg(not(feature = "mqtt"))]
            Some(("mqtt" | "mqtts", _)) => Err(without_feature(address, "mqtt")),
            #[cfg(feature = "rest")]
            Some(("http" | "https", _)) => Self::connect_with(address, MqttOptions::default()).await,
            #[cfg(not(feature = "rest"))]
            Some(("http" | "https", _)) => Err(without_feature(address, "rest")),
            _ => Err(wrong("write mqtt://host:port/machine or http://host:port")),
        }
    }

    /// Connects as [`Plc::connect`] does, with a user, a password and TLS files, which an address should not
    /// contain.
    ///
    /// # Errors
    /// Fails as [`Plc::connect`], and if a TLS file cannot be used; the error names the file.
    #[cfg(any(feature = "mqtt", feature = "rest"))]
    pub async fn connect_with(address: &str, options: MqttOptions) -> Result<Self> {
        let (port, user) = match address.split_once("://") {
            #[cfg(feature = "rest")]
            Some(("http" | "https", _)) => plc_protocol::transport::rest::connect(address, options).await?,
            #[cfg(feature = "mqtt")]
            _ => plc_protocol::transport::mqtt::connect(address, options).await?,
            #[cfg(not(feature = "mqtt"))]
            _ => {
                return Err(Error::Address {
                    address: address.to_owned(),
                    reason: "write https://host:port".to_owned(),
                });
            }
        };
        Ok(Self::connected(port, user))
    }

    /// Returns the default name of a sequence program: the user name, because a token is valid only for that
    /// name.
    pub(crate) fn default_handler_id(&self) -> String {
        let user = self.user.as_deref().map(ToOwned::to_owned);
        user.unwrap_or_else(|| unique_name("handler"))
    }

    /// Returns the port of this machine, for requests that have no method in this crate.
    pub fn port(&self) -> &Arc<dyn Port> {
        &self.port
    }

    /// Returns a handle for a request that a person makes at this moment, such as by pressing a button. A
    /// request of this handle expires 1 s after the newest heartbeat that this program has received: the
    /// machine then rejects the request as `expired`. Take a new handle for each press of a button. Handlers
    /// of M codes do not need such a handle, because an output causes their requests.
    ///
    /// ```
    /// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
    /// # let fake = plc_api::fake::FakePort::new([1]);
    /// # let plc = fake.plc();
    /// use plc_api::types::request::RefusalCode;
    /// let pressed = plc.for_person().await?;
    /// fake.advance(std::time::Duration::from_millis(1001)).await;
    /// let late = pressed.coordinate_system(1).reset().await;
    /// assert!(matches!(late, Err(plc_api::Error::Refused(refusal)) if refusal.code == RefusalCode::Expired));
    /// plc.for_person().await?.coordinate_system(1).reset().await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Fails if no heartbeat of the machine has been received.
    pub async fn for_person(&self) -> Result<Self> {
        self.within(Duration::from_millis(NOT_AFTER_MS)).await
    }

    /// Returns a handle as [`for_person`](Self::for_person) does, but its requests expire after `limit`
    /// instead of 1 s. The machine accepts a `limit` of at most 60 s.
    ///
    /// # Errors
    /// Fails as [`Plc::for_person`].
    pub async fn within(&self, limit: Duration) -> Result<Self> {
        let message = self.port.read(&Topic::Heartbeat).await;
        let Some((boot_id, Payload::Heartbeat(heartbeat))) = message
            .as_deref()
            .map(|message| (message.boot_id.clone(), &message.payload))
        else {
            let text = "no heartbeat of the machine has been received, so the request cannot have an age limit; try again";
            return Err(Refusal::new(RefusalCode::Unavailable, text).into());
        };
        Ok(self.not_after(NotAfter {
            boot_id,
            heartbeat: heartbeat.cycle,
            within_ms: u64::try_from(limit.as_millis()).unwrap_or(u64::MAX),
        }))
    }

    /// Returns a handle whose requests carry this age limit. Use the handle in a program that forwards
    /// requests of a user, with the heartbeat that the program has shown to this user.
    #[must_use]
    pub fn not_after(&self, not_after: NotAfter) -> Self {
        Self {
            port: Arc::new(LimitedPort {
                port: Arc::clone(&self.port),
                not_after,
            }),
            ..self.clone()
        }
    }

    /// Returns the programs in the store, ascending by number.
    ///
    /// # Errors
    /// Fails if the machine refuses the request, or the transport does not carry programs.
    pub async fn programs(&self) -> Result<Vec<ProgramInfo>> {
        self.request(Programs).await
    }

    /// Returns the active alarms and warnings, in the order in which they were raised. A reset of a
    /// coordinate system clears the alarms of this coordinate system and those of the whole machine (`cs` is
    /// `None`). [`CoordinateSystem::acknowledge_alarm`](crate::CoordinateSystem::acknowledge_alarm) records
    /// that an operator has seen an alarm.
    ///
    /// ```
    /// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
    /// # let fake = plc_api::fake::FakePort::new([1]);
    /// # let plc = fake.plc();
    /// # fake.raise(1, plc_api::Alarm::user(7, "the door is open"));
    /// let alarms = plc.alarms().await?;
    /// assert_eq!((alarms[0].number, alarms[0].text.as_str()), (10_007, "the door is open"));
    /// plc.coordinate_system(1).acknowledge_alarm(alarms[0].id).await?;
    /// assert!(plc.alarms().await?[0].acknowledged_by.is_some());
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Fails if the machine has not published alarms yet.
    pub async fn alarms(&self) -> Result<Vec<AlarmRecord>> {
        let said = self.port.read(&Topic::AlarmActive).await;
        match said.as_deref().map(|message| &message.payload) {
            Some(Payload::AlarmActive(active)) => Ok(active.alarms.clone()),
            _ => Err(Refusal::new(RefusalCode::NotFound, "the machine has not published alarms yet").into()),
        }
    }

    /// Raises an alarm of the whole machine: every coordinate system stops, and all open outputs are
    /// cancelled. The alarm stays active until any coordinate system is reset; each coordinate system stays
    /// STOPPED until its own reset. To stop one coordinate system only, use
    /// [`CoordinateSystem::raise_alarm`](crate::CoordinateSystem::raise_alarm). A handler that returns `Err`
    /// stops the NC program that issued its output.
    ///
    /// ```
    /// # use plc_api::{Alarm, Execution};
    /// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
    /// let plc = plc_api::fake::FakePort::new([1, 2]).plc();
    /// plc.raise_alarm(Alarm::user(20, "the air pressure is low")).await?;
    /// assert_eq!(plc.coordinate_system(2).state().await?.execution, Execution::Stopped);
    /// assert_eq!(plc.alarms().await?[0].cs, None);
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Fails if the alarm was not created by [`Alarm::user`] or has no text, or if the machine cannot be
    /// reached.
    pub async fn raise_alarm(&self, alarm: Alarm) -> Result<()> {
        self.raise(None, alarm).await
    }

    pub(crate) async fn raise(&self, cs: Option<CoordinateSystemNumber>, alarm: Alarm) -> Result<()> {
        let Some(code) = alarm.user_code() else {
            let text = format!(
                "alarm {} is an alarm of the runtime; make it by Alarm::user",
                alarm.number
            );
            return Err(Refusal::new(RefusalCode::Invalid, text).into());
        };
        let text = alarm.text;
        self.request(RaiseAlarm(AlarmRaise { cs, code, text })).await
    }

    /// Returns lines of the journal in the order of time: skips the `from` newest lines, then returns the
    /// newest `count` of the rest (1 to 1000). Each line is a JSON object with `ts`, `t_s` (seconds since the
    /// start of the runtime), `cs`, `event`, and the fields of the event. Available in process and over REST.
    ///
    /// # Errors
    /// Fails if `count` is out of its range, the machine keeps no journal or cannot read it, or the transport
    /// is MQTT.
    pub async fn journal(&self, from: u32, count: u32) -> Result<Vec<serde_json::Value>> {
        let filter = JournalFilter::default();
        self.request(Journal { from, count, filter }).await
    }

    /// Sets the skip input of a motor, by its CNC motor number. The input keeps its value until it is set
    /// again. The transmission is not real time: G31 captures the position at the time when the servo
    /// receives the input.
    ///
    /// # Errors
    /// Fails if no axis has such a motor, or the machine cannot be reached.
    pub async fn set_skip_input(&self, motor: u16, value: bool) -> Result<()> {
        self.request(SkipInput(motor, value)).await
    }

    /// Returns true if the runtime is online. Over a broker, the runtime is treated as offline after its last
    /// will, or if it has not renewed its presence before the presence expires. Without a connection to the
    /// broker, the last known value is returned.
    pub async fn is_online(&self) -> bool {
        let presence = self.port.read(&Topic::Presence).await;
        presence.is_some_and(|message| matches!(&message.payload, Payload::Presence(said) if said.online))
    }

    /// Sleeps on the machine's clock, which is simulated time in a simulation. Handlers must use no other
    /// sleep.
    pub async fn sleep(&self, duration: Duration) {
        self.port.sleep(duration).await;
    }

    /// Returns the time of the machine's clock, seconds since the start of this clock.
    pub fn now_s(&self) -> f64 {
        self.port.now_s()
    }

    pub(crate) fn user(&self) -> Option<&str> {
        self.user.as_deref()
    }

    /// Returns a handle to the same machine that sends requests in the name of a handler. The first handler
    /// also owns the locks that this program has set.
    pub(crate) fn of_handler(&self, handler_id: &str) -> Self {
        let levels = if self.levels.has_owner() {
            Arc::default()
        } else {
            Arc::clone(&self.levels)
        };
        Self {
            handler_id: Some(handler_id.into()),
            levels,
            ..self.clone()
        }
    }

    /// Sets a source of an interlock or start lock in the name of this handle.
    pub(crate) async fn set_lock(
        &self,
        cs: CoordinateSystemNumber,
        kind: LockKind,
        set: LockSet,
    ) -> Result<()> {
        self.levels.set((&*self.port, self.name()), cs, kind, set).await
    }

    /// Writes an input or output of the plant in the name of this handle.
    pub(crate) async fn set_io(&self, point: IoPoint, value: IoValue) -> Result<()> {
        self.levels.set_io((&*self.port, self.name()), point, value).await
    }

    /// Writes all levels again, after this boot of the machine has accepted the presence.
    pub(crate) async fn write_levels(&self, boot: &BootId) {
        self.levels.write_all((&*self.port, self.name()), boot).await;
    }

    pub(crate) fn levels(&self) -> &Levels {
        &self.levels
    }

    /// Returns the name under which the journal records requests.
    pub(crate) fn name(&self) -> &str {
        self.handler_id.as_deref().unwrap_or(&self.client_id)
    }

    pub(crate) fn client_id(&self) -> &str {
        &self.client_id
    }

    pub(crate) async fn request<R: TypedRequest>(&self, request: R) -> Result<R::Answer> {
        Ok(self.port.ask_as(self.name(), request).await?)
    }

    /// Creates the metadata of a new command: the ids of the command and of its client.
    pub(crate) fn command_meta(&self) -> CommandMeta {
        let number = self.commands.fetch_add(1, Ordering::Relaxed);
        CommandMeta {
            command_id: format!("{}-{number}", self.client_id),
            client_id: self.client_id.to_string(),
            ..CommandMeta::default()
        }
    }

    /// Sends a request of a destructor, by [`Plc::do_without_waiting`].
    pub(crate) fn send_without_waiting(&self, request: impl Into<Request>, what_if_not: &'static str) {
        let (port, request) = (Arc::clone(&self.port), request.into());
        self.do_without_waiting(async move {
            if let Err(refusal) = port.request(request).await {
                tracing::debug!(%refusal, "{what_if_not}");
            }
        });
    }

    /// Runs the work of a destructor. If the machine answers without waiting, the work ends within this call;
    /// otherwise a task runs the work. Outside of a tokio runtime, the tokio runtime of the connection runs
    /// the task.
    pub(crate) fn do_without_waiting(&self, work: impl Future<Output = ()> + Send + 'static) {
        let here = tokio::runtime::Handle::try_current().ok();
        let mut work: BoxFuture<'static, ()> = Box::pin(work);
        // work over a connection needs the clock of a tokio runtime
        if (here.is_some() || self.runtime.is_none()) && (&mut work).now_or_never().is_some() {
            return;
        }
        if let Some(runtime) = here.or_else(|| self.runtime.clone()) {
            runtime.spawn(work);
        }
    }
}

/// Returns the error of an address that needs a feature which this build does not contain.
#[cfg(not(all(feature = "mqtt", feature = "rest")))]
fn without_feature(address: &str, feature: &'static str) -> Error {
    // the text before @ may contain a password
    let (scheme, rest) = address.split_once("://").unwrap_or_default();
    let host = rest.rsplit_once('@').map_or(rest, |(_, host)| host);
    Error::Feature {
        address: format!("{scheme}://{host}"),
        feature,
    }
}
