//! MTConnect of a machine (read only): an agent with the requests `probe`, `current`, `sample` and `assets` (MTConnect
//! part 1, 1.7 to 2.7), and an SHDR adapter for an agent of another manufacturer.
//!
//! It depends on `plc_protocol` only, and reads the same data of a machine as every client: [`Agent::start`] reads its
//! birth, follows its messages, and keeps the last [`BUFFER_SIZE`] observations. [`Agent::router`] answers over HTTP.

mod buffer;
mod device;
mod documents;
mod feed;
mod filter;
mod http;
mod shdr;
#[cfg(test)]
mod tests;

use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use axum::Router;
use parking_lot::Mutex;
use plc_protocol::hub::{Filter, Subscription};
use plc_protocol::port::Port;
use plc_protocol::supervisor::Supervisor;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::io::IoPoint;
use plc_protocol::types::machine::Birth;
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::request::typed;
use plc_protocol::types::topic::{CsTopic, Topic};
use schemars::JsonSchema;
use serde::Deserialize;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

pub use buffer::BUFFER_SIZE;
use device::Device;
use documents::Head;
use feed::DeviceFeed;

/// Version of the standard that documents follow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Deserialize, JsonSchema)]
pub enum Version {
    /// 1.7.
    #[serde(rename = "1.7")]
    V1_7,
    /// 2.0.
    #[serde(rename = "2.0")]
    V2_0,
    /// MTConnect 2.3.
    #[default]
    #[serde(rename = "2.3")]
    V2_3,
    /// 2.7.
    #[serde(rename = "2.7")]
    V2_7,
}

impl Version {
    /// Returns the version as written in namespaces.
    pub fn text(self) -> &'static str {
        match self {
            Version::V1_7 => "1.7",
            Version::V2_0 => "2.0",
            Version::V2_3 => "2.3",
            Version::V2_7 => "2.7",
        }
    }

    /// Returns the version as written in the header of a document.
    fn header(self) -> &'static str {
        match self {
            Version::V1_7 => "1.7.0.0",
            Version::V2_0 => "2.0.0.0",
            Version::V2_3 => "2.3.0.0",
            Version::V2_7 => "2.7.0.0",
        }
    }
}

/// Settings of an agent.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct AgentSettings {
    /// Version of the standard for its documents.
    pub version: Version,
    /// Name of the input that is on while the emergency stop is not pressed; `None` if the machine has no such input.
    pub emergency_stop: Option<String>,
}

/// Period at which the tool table is read. Reason: the machine does not report changes of it.
const TOOLS_EVERY: Duration = Duration::from_secs(1);

/// The agent of one machine. Clones are handles to the same one.
#[derive(Debug, Clone)]
pub struct Agent {
    inner: Arc<Inner>,
}

struct Inner {
    port: Arc<dyn Port>,
    version: Version,
    instance_id: u64,
    /// Time of the start, as RFC 3339.
    began: Arc<str>,
    feed: Mutex<DeviceFeed>,
    /// Topics whose last message is stored.
    observed: Vec<Topic>,
    /// Sequence number of the next observation.
    news: watch::Sender<u64>,
    stop: CancellationToken,
    supervisor: Supervisor,
}

impl std::fmt::Debug for Inner {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Inner")
            .field("version", &self.version)
            .finish_non_exhaustive()
    }
}

impl Agent {
    /// Starts to observe a machine, until `stop`. The instance id is the time of the start in milliseconds, so it
    /// differs after each boot. After a fault in one of its tasks, `supervisor` reports the fault and restarts the
    /// task.
    pub async fn start(
        port: Arc<dyn Port>,
        settings: AgentSettings,
        stop: CancellationToken,
        supervisor: Supervisor,
    ) -> Self {
        // subscribed first, so that no message is lost in the meantime
        let said = port.subscribe(Filter::All);
        let birth = match port
            .read(&Topic::Birth)
            .await
            .map(|message| message.payload.clone())
        {
            Some(Payload::Birth(birth)) => birth,
            _ => Birth::default(),
        };
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let timestamp: Arc<str> = now().into();
        let numbers = birth.coordinate_systems.iter().map(|system| system.number);
        let input = settings.emergency_stop.clone();
        let input = input.map(IoPoint::input).map(Topic::Io);
        let agent = Self {
            inner: Arc::new(Inner {
                feed: Mutex::new(DeviceFeed::new(Device::from_birth(&birth), &settings, &timestamp)),
                began: timestamp,
                version: settings.version,
                instance_id: u64::try_from(since.as_millis()).unwrap_or_default(),
                observed: topics(numbers).into_iter().chain(input).collect(),
                news: watch::Sender::new(0),
                stop,
                port,
                supervisor,
            }),
        };
        agent.read_all().await;
        let supervisor = &agent.inner.supervisor;
        let (observer, mut first) = (agent.clone(), Some(said));
        let observing = move || observer.clone().observe(first.take());
        tokio::spawn(supervisor.restarted("observer of MTConnect", observing));
        let observer = agent.clone();
        let watching = move || observer.clone().watch_tools();
        tokio::spawn(supervisor.restarted("tools of MTConnect", watching));
        agent
    }

    /// Reads the current state.
    async fn read_all(&self) {
        for topic in &self.inner.observed {
            if let Some(message) = self.inner.port.read(topic).await {
                self.apply_message(&message);
            }
        }
    }

    fn apply_message(&self, message: &Message) {
        let mut feed = self.inner.feed.lock();
        if feed.apply_message(message) {
            self.inner.news.send_replace(feed.buffer.next());
        }
    }

    /// Processes messages until the agent ends. Without a subscription, it subscribes and reads the current state
    /// first.
    async fn observe(self, said: Option<Subscription>) {
        let mut said = if let Some(said) = said {
            said
        } else {
            let said = self.inner.port.subscribe(Filter::All);
            self.read_all().await;
            said
        };
        loop {
            let message = tokio::select! {
                biased;
                () = self.inner.stop.cancelled() => return,
                message = said.next() => message,
            };
            let Some(message) = message else { return };
            self.apply_message(&message);
        }
    }

    /// Observes changes of the tool table until the agent ends.
    async fn watch_tools(self) {
        loop {
            if let Ok(table) = self.inner.port.ask(typed::Tools).await {
                let mut feed = self.inner.feed.lock();
                if feed.tools(&table.tools, &now().into()) {
                    self.inner.news.send_replace(feed.buffer.next());
                }
            }
            if !self.sleep(TOOLS_EVERY).await {
                return;
            }
        }
    }

    /// Returns the routes of its requests.
    pub fn router(&self) -> Router {
        http::router(self.clone())
    }

    /// Serves readers of SHDR in a separate task until the agent ends.
    pub fn serve_shdr(&self, listener: TcpListener) {
        let (agent, listener) = (self.clone(), Arc::new(listener));
        let serving = move || shdr::serve(Arc::clone(&listener), agent.clone());
        tokio::spawn(self.inner.supervisor.restarted("adapter of MTConnect", serving));
    }

    fn head(&self) -> Head {
        Head {
            version: self.inner.version,
            model_change_time: self.inner.began.to_string(),
            sender: "tandem".to_owned(),
            instance_id: self.inner.instance_id,
            creation_time: now(),
        }
    }

    fn is_device(&self, name: &str) -> bool {
        let feed = self.inner.feed.lock();
        name == feed.device.name || name == feed.device.uuid
    }

    /// Sleeps; returns false if the agent ends.
    async fn sleep(&self, duration: Duration) -> bool {
        tokio::select! {
            () = self.inner.stop.cancelled() => false,
            () = tokio::time::sleep(duration) => true,
        }
    }
}

/// Returns the topics that are read at the start.
fn topics(numbers: impl Iterator<Item = CoordinateSystemNumber>) -> Vec<Topic> {
    const OF_SYSTEM: [CsTopic; 8] = [
        CsTopic::State,
        CsTopic::Program,
        CsTopic::Position,
        CsTopic::Modal,
        CsTopic::Override,
        CsTopic::Tool,
        CsTopic::Spindle,
        CsTopic::Run,
    ];
    let of_systems = numbers.flat_map(|cs| OF_SYSTEM.map(|topic| Topic::cs(cs, topic)));
    of_systems.chain([Topic::AlarmActive]).collect()
}

/// Returns the time of day as RFC 3339.
fn now() -> String {
    humantime::format_rfc3339_millis(SystemTime::now()).to_string()
}
