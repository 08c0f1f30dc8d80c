//! Tests of the servers with a port that records its requests and returns the answers of a test.

mod access;
mod authorization;
mod connection_slots;
mod data;
mod foreign_pages;
mod gateway;
mod mqtt;
mod mqtt_backlog;
mod mqtt_refusals;
mod mqtt_socket;
mod mtconnect;
mod programs;
mod rest;
mod rest_refusals;
mod revoked_credentials;
mod senders;
mod threats;
mod unread;
mod unresponsive;
mod urgent;
mod websocket;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use plc_protocol::hub::{Filter, Hub, Subscription};
use plc_protocol::port::{BoxFuture, Port};
use plc_protocol::server::{Origin, ServedPort, ServerNotice, ServoTiming};
use plc_protocol::types::command::{CommandReply, CommandStatus};
use plc_protocol::types::machine::{Birth, CoordinateSystemInfo, Presence};
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::output::{HandledCode, HandlerPresence};
use plc_protocol::types::request::{Answer, Refusal, Request};
use plc_protocol::types::state::{Position, State, Switch};
use plc_protocol::types::topic::{CsTopic, Topic};
use plc_protocol::types::{BootId, Timestamp};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_util::sync::CancellationToken;

use crate::access::http::Access;
use crate::server_state::ServerState;
use crate::{Gateway, GatewaySettings};

type Script = Box<dyn Fn(&Request) -> Result<Answer, Refusal> + Send + Sync>;

/// A port with its own hub.
pub(super) struct StubPort {
    pub(super) hub: Hub,
    pub(super) requests: Mutex<Vec<Request>>,
    origins: Mutex<Vec<Origin>>,
    pub(super) notices: Mutex<Vec<ServerNotice>>,
    pub(super) servo_timing: Mutex<Option<ServoTiming>>,
    pub(super) news: tokio::sync::Notify,
    script: Script,
    /// Requests are taken and never answered.
    pub(super) silent: std::sync::atomic::AtomicBool,
}

impl StubPort {
    /// Commands are accepted, or done when waited for; everything else is done.
    pub(super) fn new() -> Arc<Self> {
        Self::with(|request| {
            Ok(match request {
                Request::Command { meta, wait, .. } => {
                    let status = if *wait {
                        CommandStatus::Done
                    } else {
                        CommandStatus::Accepted
                    };
                    Answer::Command(reply(&meta.command_id, status, "ok"))
                }
                _ => Answer::Done,
            })
        })
    }

    pub(super) fn with(
        script: impl Fn(&Request) -> Result<Answer, Refusal> + Send + Sync + 'static,
    ) -> Arc<Self> {
        let stub = Self {
            hub: Hub::new(),
            requests: Mutex::default(),
            origins: Mutex::default(),
            notices: Mutex::default(),
            servo_timing: Mutex::default(),
            news: tokio::sync::Notify::new(),
            script: Box::new(script),
            silent: false.into(),
        };
        stub.say_presence(1);
        stub.say(
            Topic::Birth,
            Some(1),
            Payload::Birth(Birth {
                machine: "mill-1".into(),
                coordinate_systems: vec![CoordinateSystemInfo {
                    number: 1,
                    ..CoordinateSystemInfo::default()
                }],
                ..Birth::default()
            }),
        );
        stub.say(
            Topic::cs(1, CsTopic::State),
            Some(12),
            Payload::State(State::default()),
        );
        Arc::new(stub)
    }

    pub(super) fn say(&self, topic: Topic, rev: Option<u64>, payload: Payload) {
        self.hub.publish(message(topic, rev, payload));
    }

    pub(super) fn say_presence(&self, rev: u64) {
        let presence = Presence {
            online: true,
            started_at: Timestamp("2026-01-01T00:00:00Z".into()),
            broker: None,
            version: "0.1.0".into(),
            expires_ms: None,
            url: None,
        };
        self.say(Topic::Presence, Some(rev), Payload::Presence(presence));
    }

    pub(super) fn say_dry_run(&self, rev: u64, value: bool) {
        let topic = Topic::cs(1, CsTopic::DryRun);
        self.say(topic, Some(rev), Payload::Switch(Switch { value }));
    }

    pub(super) fn say_position(&self, feedrate: f64) {
        let position = Position {
            feedrate,
            ..Position::default()
        };
        self.say(Topic::cs(1, CsTopic::Position), None, Payload::Position(position));
    }

    /// Reports an online handler that serves M5 in this coordinate system.
    pub(super) fn say_handler(&self, id: &str, cs: u8) {
        let presence = HandlerPresence {
            online: true,
            handles: vec![HandledCode { cs, m: 5 }],
            validates: false,
            ..HandlerPresence::default()
        };
        let topic = Topic::HandlerPresence(id.to_owned());
        self.say(topic, Some(1), Payload::HandlerPresence(presence));
    }

    /// Returns the origin of each request so far.
    pub(super) fn origins(&self) -> Vec<Origin> {
        self.origins.lock().unwrap().clone()
    }

    /// All requests so far.
    pub(super) fn asked(&self) -> Vec<Request> {
        self.requests.lock().unwrap().clone()
    }

    /// The texts of all warnings so far.
    pub(super) fn warnings(&self) -> Vec<String> {
        let told = self.notices.lock().unwrap();
        let warnings = told.iter().filter_map(|notice| match notice {
            ServerNotice::Warning(text) => Some(text.clone()),
            _ => None,
        });
        warnings.collect()
    }

    /// Waits until it was asked something that fits.
    pub(super) async fn asked_for(&self, fits: impl Fn(&Request) -> bool) -> Request {
        within(async {
            loop {
                let news = self.news.notified();
                if let Some(request) = self.asked().into_iter().find(&fits) {
                    return request;
                }
                news.await;
            }
        })
        .await
    }
}

impl Port for StubPort {
    fn boot_id(&self) -> BootId {
        BootId("boot-1".into())
    }

    fn read<'a>(&'a self, topic: &'a Topic) -> BoxFuture<'a, Option<Arc<Message>>> {
        Box::pin(std::future::ready(self.hub.read(topic)))
    }

    fn subscribe(&self, filter: Filter) -> Subscription {
        self.hub.subscribe(filter)
    }

    fn request(&self, request: Request) -> BoxFuture<'_, Result<Answer, Refusal>> {
        let answer = (self.script)(&request);
        self.requests.lock().unwrap().push(request);
        self.news.notify_waiters();
        if self.silent.load(std::sync::atomic::Ordering::Relaxed) {
            return Box::pin(std::future::pending());
        }
        Box::pin(std::future::ready(answer))
    }

    fn sleep(&self, duration: Duration) -> BoxFuture<'_, ()> {
        Box::pin(tokio::time::sleep(duration))
    }

    fn now_s(&self) -> f64 {
        0.0
    }
}

impl ServedPort for StubPort {
    fn request_from(&self, origin: Origin, request: Request) -> BoxFuture<'_, Result<Answer, Refusal>> {
        self.origins.lock().unwrap().push(origin);
        self.request(request)
    }

    fn notice(&self, notice: ServerNotice) {
        self.notices.lock().unwrap().push(notice);
    }

    fn republish(&self) -> BoxFuture<'_, ()> {
        Box::pin(std::future::ready(()))
    }

    fn servo_timing(&self) -> Option<ServoTiming> {
        self.servo_timing.lock().unwrap().clone()
    }
}

pub(super) fn message(topic: Topic, rev: Option<u64>, payload: Payload) -> Message {
    Message {
        topic,
        boot_id: BootId("boot-1".into()),
        ts: Timestamp("2026-01-01T00:00:00Z".into()),
        rev,
        payload,
    }
}

pub(super) fn reply(command_id: &str, status: CommandStatus, code: &str) -> CommandReply {
    CommandReply {
        command_id: command_id.to_owned(),
        status,
        code: code.to_owned(),
        text: "as asked".to_owned(),
        state_rev: 13,
        variables: None,
        lease: None,
        hash: None,
        run_id: None,
        moved: BTreeMap::new(),
    }
}

/// Returns the shared state of the HTTP handlers, as if served at 127.0.0.1:8080.
pub(super) fn shared(port: Arc<StubPort>) -> Arc<ServerState> {
    shared_with(port, None)
}

pub(super) fn shared_with(port: Arc<StubPort>, tokens: Option<Arc<crate::Tokens>>) -> Arc<ServerState> {
    Arc::new(ServerState::new(
        crate::machine::Machine::new(port),
        "127.0.0.1:8080".parse().unwrap(),
        "http",
        crate::server_state::MqttServer {
            host: None,
            port: 1883,
            is_private: false,
        },
        Access::new(
            tokens.map(|tokens| crate::access::Users::new(crate::access::LiveTokens::fixed(tokens), None)),
        ),
        Duration::from_millis(20),
        CancellationToken::new(),
    ))
}

/// A token of each role, and settings with them.
pub(super) struct TestUsers {
    pub(super) settings: GatewaySettings,
    tokens: std::collections::BTreeMap<&'static str, String>,
}

impl TestUsers {
    /// Each user has the name of its role.
    pub(super) fn new() -> Self {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        let mut tokens = std::collections::BTreeMap::new();
        for (word, role) in crate::Role::ALL {
            let new = crate::new_token(word, role, None).unwrap();
            std::io::Write::write_all(&mut file, new.entry.as_bytes()).unwrap();
            tokens.insert(word, new.token);
        }
        let mut settings = settings();
        settings.tokens = Some(Arc::new(crate::Tokens::read(file.path()).unwrap()));
        Self { settings, tokens }
    }

    pub(super) fn token(&self, name: &str) -> &str {
        &self.tokens[name]
    }
}

/// Settings with free ports.
pub(super) fn settings() -> GatewaySettings {
    let mut settings = GatewaySettings {
        http_listen: "127.0.0.1:0".into(),
        position_interval_ms: 20,
        ..GatewaySettings::default()
    };
    settings.mqtt.embedded_listen = Some("127.0.0.1:0".into());
    settings
}

pub(super) async fn start(port: &Arc<StubPort>) -> Gateway {
    start_with(port, settings()).await
}

pub(super) async fn start_with(port: &Arc<StubPort>, settings: GatewaySettings) -> Gateway {
    let port: Arc<dyn ServedPort> = Arc::<StubPort>::clone(port);
    Gateway::start(port, settings).await.unwrap()
}

/// A test that hangs fails instead.
pub(super) async fn within<T>(future: impl Future<Output = T>) -> T {
    tokio::time::timeout(Duration::from_secs(10), future)
        .await
        .expect("within 10 s")
}

/// An MQTT packet of this first byte.
pub(super) fn packet(kind: u8, body: &[&[u8]]) -> Vec<u8> {
    let (mut packet, mut length) = (vec![kind], body.iter().map(|part| part.len()).sum::<usize>());
    loop {
        let more = if length > 127 { 0x80 } else { 0 };
        packet.push(u8::try_from(length % 128).unwrap() | more);
        length /= 128;
        if length == 0 {
            break;
        }
    }
    packet.extend(body.concat());
    packet
}

/// Returns the CONNECT packet of a user over this version of MQTT, with a unique client id.
pub(super) fn connect_packet(version: u8, user: &str, password: &str) -> Vec<u8> {
    static CLIENTS: AtomicU32 = AtomicU32::new(0);
    let id = format!("raw-{}", CLIENTS.fetch_add(1, Ordering::Relaxed));
    let text = |text: &str| [&u16::try_from(text.len()).unwrap().to_be_bytes(), text.as_bytes()].concat();
    let properties: &[u8] = if version == 5 { &[0] } else { &[] };
    let body = [
        text("MQTT"),
        // user name, password, clean session; keep-alive 60 s
        vec![version, 0xc2, 0, 60],
        properties.to_vec(),
        text(&id),
        text(user),
        text(password),
    ];
    packet(0x10, &[&body.concat()])
}

/// An MQTT connection of a user over this version, and the kind and code of the answer to its CONNECT packet.
pub(super) async fn mqtt_as(
    gateway: &Gateway,
    version: u8,
    user: &str,
    password: &str,
) -> (TcpStream, [u8; 2]) {
    let mut stream = TcpStream::connect(gateway.mqtt_addr().unwrap()).await.unwrap();
    let connect = connect_packet(version, user, password);
    stream.write_all(&connect).await.unwrap();
    let mut head = [0; 2];
    within(stream.read_exact(&mut head)).await.unwrap();
    let mut body = vec![0; head[1].into()];
    within(stream.read_exact(&mut body)).await.unwrap();
    (stream, [head[0], body[1]])
}
