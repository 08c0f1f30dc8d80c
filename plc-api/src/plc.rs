//! A machine as a sequence program sees it.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use futures_util::FutureExt;

use crate::alarm::Alarm;
use crate::error::{Error, Result};
use crate::names::unique_name;
use crate::port::{BoxFuture, Port};
#[cfg(feature = "mqtt")]
use crate::transport::mqtt::MqttOptions;
use crate::types::CoordinateSystemNumber;
use crate::types::command::CommandMeta;
use crate::types::machine::{AlarmRaise, AlarmRecord};
use crate::types::message::Payload;
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
    user: Option<Arc<str>>,
    commands: Arc<AtomicU64>,
    /// Where its connection lives.
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
            user: None,
            commands: Arc::default(),
            runtime: None,
        }
    }

    /// A machine behind a connection that this tokio runtime keeps.
    #[cfg(any(feature = "mqtt", feature = "rest"))]
    fn connected(port: Arc<dyn Port>, user: Option<String>) -> Self {
        Self {
            user: user.map(Into::into),
            runtime: tokio::runtime::Handle::try_current().ok(),
            ..Self::in_process(port)
        }
    }

    /// A machine at an address. Over MQTT (feature `mqtt`): `mqtt://host:port/machine`, with a topic prefix
    /// `mqtt://host:port/prefix/machine`, with a user `mqtt://user:password@host:port/machine`, with TLS
    /// `mqtts://host:port/machine`; the port is 1883, or 8883 with TLS, where none is named. Over REST and WebSocket
    /// (feature `rest`): `http://host:port`, with a user `http://user:token@host:port`, or with the token alone; the port is
    /// 80 where none is named. A handler's token speaks in the name of its user only: a program without a
    /// [`handler_id`](crate::SequenceProgram::handler_id) takes the user's name where the address has it.
    /// Waits up to 10 s until the runtime is present there; after that the connection is made again by itself for ever.
    ///
    /// # Errors
    /// The address is not one, no broker answers there, it refuses the user, or no runtime is online under that name.
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
            Some(("mqtt" | "mqtts", _)) => Err(wrong("plc-api was built without its feature mqtt")),
            #[cfg(feature = "rest")]
            Some(("http", _)) => {
                let (port, user) = crate::transport::rest::connect(address).await?;
                Ok(Self::connected(port, user))
            }
            #[cfg(not(feature = "rest"))]
            Some(("http", _)) => Err(wrong("plc-api was built without its feature rest")),
            Some(("https", _)) => Err(wrong("REST is served without TLS, use http:// or a tunnel")),
            _ => Err(wrong("write mqtt://host:port/machine or http://host:port")),
        }
    }

    /// The same with what an address should not hold: user and password, and the files of TLS.
    ///
    /// # Errors
    /// As [`Plc::connect`]; a file of TLS that cannot be used is named.
    #[cfg(feature = "mqtt")]
    pub async fn connect_with(address: &str, options: MqttOptions) -> Result<Self> {
        let (port, user) = crate::transport::mqtt::connect(address, options).await?;
        Ok(Self::connected(port, user))
    }

    /// Name of a sequence program that chose none: that of its user, since a token speaks in its own name only.
    pub(crate) fn default_handler_id(&self) -> String {
        let user = self.user.as_deref().map(ToOwned::to_owned);
        user.unwrap_or_else(|| unique_name("handler"))
    }

    /// The port under this machine, for requests that have no method here.
    pub fn port(&self) -> &Arc<dyn Port> {
        &self.port
    }

    /// Programs of the store, ascending.
    ///
    /// # Errors
    /// A refusal, such as over a transport that does not carry programs.
    pub async fn programs(&self) -> Result<Vec<ProgramInfo>> {
        self.request(Programs).await
    }

    /// Alarms and warnings that stand, in the order in which they were raised. A reset of its coordinate system clears
    /// an alarm, a reset of any coordinate system one of the whole machine (`cs` is `None`);
    /// [`CoordinateSystem::acknowledge_alarm`](crate::CoordinateSystem::acknowledge_alarm) notes that somebody has seen it.
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
    /// The machine has not said it yet.
    pub async fn alarms(&self) -> Result<Vec<AlarmRecord>> {
        let said = self.port.read(&Topic::AlarmActive).await;
        match said.as_deref().map(|message| &message.payload) {
            Some(Payload::AlarmActive(active)) => Ok(active.alarms.clone()),
            _ => Err(Refusal::new(RefusalCode::NotFound, "the machine has not said its alarms yet").into()),
        }
    }

    /// Raises an alarm of the whole machine: every coordinate system stops, and its open outputs are cancelled. It
    /// stands until a coordinate system is reset; each of them stays STOPPED until its own reset. One coordinate system
    /// alone is stopped by [`CoordinateSystem::raise_alarm`](crate::CoordinateSystem::raise_alarm), the program of an output by the `Err` of its handler.
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
    /// The alarm is not one of [`Alarm::user`] or has no text, or the machine cannot be reached.
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

    /// The newest `count` lines of the journal, 1 to 1000, but for the `from` newest, in the order of time: JSON objects
    /// with `ts`, `t_s` (seconds since the start of the runtime), `cs`, `event`, and what belongs to the event. In
    /// process and over REST.
    ///
    /// # Errors
    /// A count out of its range; the machine keeps no journal, or cannot read it; over MQTT.
    pub async fn journal(&self, from: u32, count: u32) -> Result<Vec<serde_json::Value>> {
        self.request(Journal { from, count }).await
    }

    /// Sets the skip input of a motor, by its CNC motor number; it keeps the value until it is set again. Not real time:
    /// what G31 captures is where the motor is when the servo hears of it.
    ///
    /// # Errors
    /// No axis has such a motor, or the machine cannot be reached.
    pub async fn set_skip_input(&self, motor: u16, value: bool) -> Result<()> {
        self.request(SkipInput(motor, value)).await
    }

    /// Sleeps on the machine's clock: simulated time in a simulation. Handlers sleep by this and nothing else.
    pub async fn sleep(&self, duration: Duration) {
        self.port.sleep(duration).await;
    }

    /// Seconds since the start on the machine's clock.
    pub fn now_s(&self) -> f64 {
        self.port.now_s()
    }

    /// The user of its connection.
    pub(crate) fn user(&self) -> Option<&str> {
        self.user.as_deref()
    }

    pub(crate) fn client_id(&self) -> &str {
        &self.client_id
    }

    pub(crate) async fn request<R: TypedRequest>(&self, request: R) -> Result<R::Answer> {
        Ok(self.port.ask(request).await?)
    }

    /// A fresh command id, and whose command it is.
    pub(crate) fn command_meta(&self) -> CommandMeta {
        let number = self.commands.fetch_add(1, Ordering::Relaxed);
        CommandMeta {
            command_id: format!("{}-{number}", self.client_id),
            client_id: self.client_id.to_string(),
            ..CommandMeta::default()
        }
    }

    /// Sends a request from a destructor: at once where the machine takes it at once, else from a task. Without a tokio
    /// runtime around it, such as behind its end, only the connection's own runtime could still send it.
    pub(crate) fn send_without_waiting(&self, request: impl Into<Request>, what_if_not: &'static str) {
        let here = tokio::runtime::Handle::try_current().ok();
        let (port, request) = (Arc::clone(&self.port), request.into());
        let mut sent: BoxFuture<'static, ()> = Box::pin(async move {
            if let Err(refusal) = port.request(request).await {
                tracing::debug!(%refusal, "{what_if_not}");
            }
        });
        // a connection needs the clock of a runtime
        if (here.is_some() || self.runtime.is_none()) && (&mut sent).now_or_never().is_some() {
            return;
        }
        if let Some(runtime) = here.or_else(|| self.runtime.clone()) {
            runtime.spawn(sent);
        }
    }
}
