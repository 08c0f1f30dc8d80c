//! The machine, from the point of view of a sequence program.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use futures_util::FutureExt;

use crate::alarm::Alarm;
use crate::error::{Error, Result};
use crate::levels::{Levels, LockKind};
use crate::limited_port::LimitedPort;
use crate::names::unique_name;
use crate::port::{BoxFuture, Port};
#[cfg(any(feature = "mqtt", feature = "rest"))]
use crate::transport::options::MqttOptions;
use crate::types::BootId;
use crate::types::CoordinateSystemNumber;
use crate::types::command::CommandMeta;
use crate::types::data::JournalFilter;
use crate::types::io::{IoPoint, IoValue};
use crate::types::lock::LockSet;
use crate::types::machine::{AlarmRaise, AlarmRecord};
use crate::types::message::Payload;
use crate::types::not_after::{NOT_AFTER_MS, NotAfter};
use crate::types::program::ProgramInfo;
use crate::types::refusal::{Refusal, RefusalCode};
use crate::types::request::typed::{Journal, Programs, RaiseAlarm, SkipInput};
use crate::types::request::{Request, TypedRequest};
use crate::types::topic::Topic;

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
    /// The handler in whose name it asks.
    handler_id: Option<Arc<str>>,
    user: Option<Arc<str>>,
    commands: Arc<AtomicU64>,
    /// Interlocks, start locks, and inputs and outputs of the plant that it has set.
    levels: Arc<Levels>,
    /// The runtime that drives its connection.
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
    /// A machine in this process, such as `runtime.port()`.
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

    /// A machine behind a connection that the current tokio runtime drives.
    #[cfg(any(feature = "mqtt", feature = "rest"))]
    fn connected(port: Arc<dyn Port>, user: Option<String>) -> Self {
        Self {
            user: user.map(Into::into),
            runtime: tokio::runtime::Handle::try_current().ok(),
            ..Self::in_process(port)
        }
    }

    /// A machine at an address. Over MQTT (feature `mqtt`): `mqtt://[user:password@]host[:port]/[prefix/]machine`, with
    /// TLS `mqtts://...`; the default port is 1883, with TLS 8883. Over REST and WebSocket (feature `rest`):
    /// `http://[[user:]token@]host[:port]`; the default port is 80. Of several nodes of a broker,
    /// `host[:port],host[:port]`, the first that answers is used until it is lost. The token of a handler is valid for its user's name
    /// only: a program without a [`handler_id`](crate::SequenceProgram::handler_id) takes the user's name if the
    /// address has one. Waits up to 10 s for the runtime; later it reconnects by itself, without limit.
    ///
    /// # Errors
    /// The address is wrong, no broker answers, it refuses the user, or no runtime is online under that name.
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
            Some(("mqtt" | "mqtts", _)) => Err(Error::without_feature(address, "mqtt")),
            #[cfg(feature = "rest")]
            Some(("http" | "https", _)) => Self::connect_with(address, MqttOptions::default()).await,
            #[cfg(not(feature = "rest"))]
            Some(("http" | "https", _)) => Err(Error::without_feature(address, "rest")),
            _ => Err(wrong("write mqtt://host:port/machine or http://host:port")),
        }
    }

    /// [`Plc::connect`] with user, password and TLS files, which an address should not contain.
    ///
    /// # Errors
    /// As [`Plc::connect`]; a TLS file cannot be used, and is named.
    #[cfg(any(feature = "mqtt", feature = "rest"))]
    pub async fn connect_with(address: &str, options: MqttOptions) -> Result<Self> {
        let (port, user) = match address.split_once("://") {
            #[cfg(feature = "rest")]
            Some(("http" | "https", _)) => crate::transport::rest::connect(address, options).await?,
            #[cfg(feature = "mqtt")]
            _ => crate::transport::mqtt::connect(address, options).await?,
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

    /// Default name of a sequence program: its user, since a token is valid for that name only.
    pub(crate) fn default_handler_id(&self) -> String {
        let user = self.user.as_deref().map(ToOwned::to_owned);
        user.unwrap_or_else(|| unique_name("handler"))
    }

    /// The port of this machine, for requests that have no method here.
    pub fn port(&self) -> &Arc<dyn Port> {
        &self.port
    }

    /// Returns a handle for what a person has requested just now. Its requests expire 1 s after the newest heartbeat that this
    /// program has received: the machine then rejects them as `expired`, however long they were under way. Take a new
    /// handle for each press of a button. Sequence programs need none: what a handler does follows from an output.
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
    /// No heartbeat has been received.
    pub async fn for_person(&self) -> Result<Self> {
        self.within(Duration::from_millis(NOT_AFTER_MS)).await
    }

    /// Like the method above, with another time limit of at most 60 s.
    ///
    /// # Errors
    /// As [`Plc::for_person`].
    pub async fn within(&self, limit: Duration) -> Result<Self> {
        let message = self.port.read(&Topic::Heartbeat).await;
        let Some((boot_id, Payload::Heartbeat(heartbeat))) = message
            .as_deref()
            .map(|message| (message.boot_id.clone(), &message.payload))
        else {
            let text = "no heartbeat of the machine has been received, so the request cannot be limited in age; try again";
            return Err(Refusal::new(RefusalCode::Unavailable, text).into());
        };
        Ok(self.not_after(NotAfter {
            boot_id,
            heartbeat: heartbeat.cycle,
            within_ms: u64::try_from(limit.as_millis()).unwrap_or(u64::MAX),
        }))
    }

    /// Returns a handle whose requests carry this age limit, for a program that passes on the heartbeat that its user has seen.
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

    /// Programs in the store, ascending.
    ///
    /// # Errors
    /// A refusal, such as over a transport that does not carry programs.
    pub async fn programs(&self) -> Result<Vec<ProgramInfo>> {
        self.request(Programs).await
    }

    /// Active alarms and warnings, in the order in which they were raised. A reset of its coordinate system clears an
    /// alarm; a reset of any coordinate system clears one of the whole machine (`cs` is `None`).
    /// [`CoordinateSystem::acknowledge_alarm`](crate::CoordinateSystem::acknowledge_alarm) records that somebody has
    /// seen it.
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
    /// The machine has not published its alarms yet.
    pub async fn alarms(&self) -> Result<Vec<AlarmRecord>> {
        let said = self.port.read(&Topic::AlarmActive).await;
        match said.as_deref().map(|message| &message.payload) {
            Some(Payload::AlarmActive(active)) => Ok(active.alarms.clone()),
            _ => Err(Refusal::new(RefusalCode::NotFound, "the machine has not said its alarms yet").into()),
        }
    }

    /// Raises an alarm of the whole machine: every coordinate system stops, and its open outputs are cancelled. It
    /// stays active until a coordinate system is reset; each of them stays STOPPED until its own reset.
    /// [`CoordinateSystem::raise_alarm`](crate::CoordinateSystem::raise_alarm) stops one coordinate system, the `Err`
    /// of a handler the program of its output.
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
    /// The alarm was not made by [`Alarm::user`] or has no text, or the machine cannot be reached.
    pub async fn raise_alarm(&self, alarm: Alarm) -> Result<()> {
        self.raise(None, alarm).await
    }

    pub(crate) async fn raise(&self, cs: Option<CoordinateSystemNumber>, alarm: Alarm) -> Result<()> {
        let Some(code) = alarm.user_code() else {
            let text = format!(
                "alarm {} is one of the runtime's; make it by Alarm::user",
                alarm.number
            );
            return Err(Refusal::new(RefusalCode::Invalid, text).into());
        };
        let text = alarm.text;
        self.request(RaiseAlarm(AlarmRaise { cs, code, text })).await
    }

    /// Lines of the journal in the order of time: the newest `count`, 1 to 1000, after skipping the `from` newest. Each
    /// is a JSON object with `ts`, `t_s` (seconds since the start of the runtime), `cs`, `event`, and the fields of the
    /// event. Available in process and over REST.
    ///
    /// # Errors
    /// `count` is out of its range; the machine keeps no journal, or cannot read it; the transport is MQTT.
    pub async fn journal(&self, from: u32, count: u32) -> Result<Vec<serde_json::Value>> {
        let filter = JournalFilter::default();
        self.request(Journal { from, count, filter }).await
    }

    /// Sets the skip input of a motor, by its CNC motor number; it keeps its value until it is set again. This is not
    /// real time: G31 captures the position at which the servo receives the input.
    ///
    /// # Errors
    /// No axis has such a motor, or the machine cannot be reached.
    pub async fn set_skip_input(&self, motor: u16, value: bool) -> Result<()> {
        self.request(SkipInput(motor, value)).await
    }

    /// Returns whether the runtime is online. Over a broker it is treated as offline after its last will, or if it has
    /// not repeated its presence before the presence expires. Without a connection to the broker, the answer is the
    /// last known one.
    pub async fn is_online(&self) -> bool {
        let presence = self.port.read(&Topic::Presence).await;
        presence.is_some_and(|message| matches!(&message.payload, Payload::Presence(said) if said.online))
    }

    /// Sleeps on the machine's clock: simulated time in a simulation. Handlers use no other sleep.
    pub async fn sleep(&self, duration: Duration) {
        self.port.sleep(duration).await;
    }

    /// Seconds since the start on the machine's clock.
    pub fn now_s(&self) -> f64 {
        self.port.now_s()
    }

    pub(crate) fn user(&self) -> Option<&str> {
        self.user.as_deref()
    }

    /// Returns the same machine, in the name of a handler. The first handler also owns the locks that this program has
    /// set.
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

    /// Sets a source of an interlock or start lock.
    pub(crate) async fn set_lock(
        &self,
        cs: CoordinateSystemNumber,
        kind: LockKind,
        set: LockSet,
    ) -> Result<()> {
        self.levels.set((&*self.port, self.name()), cs, kind, set).await
    }

    /// Writes an input or output of the plant.
    pub(crate) async fn set_io(&self, point: IoPoint, value: IoValue) -> Result<()> {
        self.levels.set_io((&*self.port, self.name()), point, value).await
    }

    /// Writes again what was set: the presence has been announced at this start of the machine.
    pub(crate) async fn write_levels(&self, boot: &BootId) {
        self.levels.write_all((&*self.port, self.name()), boot).await;
    }

    pub(crate) fn levels(&self) -> &Levels {
        &self.levels
    }

    /// The name under which the journal records requests.
    pub(crate) fn name(&self) -> &str {
        self.handler_id.as_deref().unwrap_or(&self.client_id)
    }

    pub(crate) fn client_id(&self) -> &str {
        &self.client_id
    }

    pub(crate) async fn request<R: TypedRequest>(&self, request: R) -> Result<R::Answer> {
        Ok(self.port.ask_as(self.name(), request).await?)
    }

    /// Identifies a new command and its client.
    pub(crate) fn command_meta(&self) -> CommandMeta {
        let number = self.commands.fetch_add(1, Ordering::Relaxed);
        CommandMeta {
            command_id: format!("{}-{number}", self.client_id),
            client_id: self.client_id.to_string(),
            ..CommandMeta::default()
        }
    }

    /// Sends a request from a destructor: [`Plc::do_without_waiting`].
    pub(crate) fn send_without_waiting(&self, request: impl Into<Request>, what_if_not: &'static str) {
        let (port, request) = (Arc::clone(&self.port), request.into());
        self.do_without_waiting(async move {
            if let Err(refusal) = port.request(request).await {
                tracing::debug!(%refusal, "{what_if_not}");
            }
        });
    }

    /// Does what a destructor wants done: directly if the machine answers without waiting, else in a task. Outside of a
    /// tokio runtime, or after its end, only the connection's own runtime can still do it.
    pub(crate) fn do_without_waiting(&self, work: impl Future<Output = ()> + Send + 'static) {
        let here = tokio::runtime::Handle::try_current().ok();
        let mut work: BoxFuture<'static, ()> = Box::pin(work);
        // a connection needs the clock of a runtime
        if (here.is_some() || self.runtime.is_none()) && (&mut work).now_or_never().is_some() {
            return;
        }
        if let Some(runtime) = here.or_else(|| self.runtime.clone()) {
            runtime.spawn(work);
        }
    }
}
