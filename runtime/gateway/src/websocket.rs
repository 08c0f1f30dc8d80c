//! WebSocket `/api/v1/ws`: the messages of the topics that a client names, as on MQTT.
//!
//! The client sends `{"subscribe": ["cs/1/state", "cs/1/m_code/+/output"]}` and `{"unsubscribe": [...]}`; `+`
//! matches one level and a last `#` all levels below. The client receives `{"topic": "cs/1/state", "v": 1, ...}`:
//! first the full value of each state, then every change. The hub limits the queue: a slow reader receives only
//! the latest values.
//! `{"handler": {"id", "online", "handles", "validates"}}` is the presence of a handler that the client serves;
//! the presence ends with the connection.
//! `{"validate_result": {"cs", "m", "request_id", "handler_id", "ok", "text"}}` answers a `validate` message. Both
//! need the rights for the topics of these names. Invalid and rejected messages are answered with
//! `{"error": "..."}`.

use std::collections::{BTreeMap, BTreeSet};
use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::State;
use axum::extract::ws::{CloseFrame, Message as Frame, Utf8Bytes, WebSocket, WebSocketUpgrade, close_code};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Extension, Router};
use plc_protocol::hub::Filter;
use plc_protocol::server::ServerTransport;
use plc_protocol::types::message::Message;
use plc_protocol::types::request::{Refusal, RefusalCode, Request};
use plc_protocol::types::topic::Topic;
use plc_protocol::wire::row::ParsedRequest;
use plc_protocol::wire::websocket::{
    ClientFrame, PING_INTERVAL, SILENCE_MAX, error_frame, message_frame, refusal_frame,
};
use plc_protocol::wire::{PAYLOAD_MAX, json_object};
use tokio::time::{Instant, MissedTickBehavior};

use crate::access::http::WEBSOCKET_PROTOCOL;
use crate::access::topics::may_subscribe;
use crate::access::{Account, AuthenticatedUser, CloseReason, User};
use crate::account_slots::AccountLimits;
use crate::machine::{Caller, Machine};
use crate::position::Positions;
use crate::problem::Problem;
use crate::server::Peer;
use crate::server_state::{ServerState, WEBSOCKET_LIMITS};
use crate::socket_limits::{self, ControlFrames, TOO_MANY_CONTROL_FRAMES};

/// Largest number of patterns of one client; more are refused.
const PATTERNS_MAX: usize = 256;

/// Largest number of bytes of one pattern; a longer one is refused. Reason: no topic is longer.
const PATTERN_BYTES_MAX: usize = 256;

/// Largest number of handlers that one client serves; more are refused.
const HANDLERS_MAX: usize = 16;

/// A message that cannot be handed to the client's connection within this time ends it.
const SEND_MAX: Duration = Duration::from_secs(30);

pub(crate) fn routes() -> Router<Arc<ServerState>> {
    Router::new().route("/ws", get(upgrade))
}

async fn upgrade(
    State(shared): State<Arc<ServerState>>,
    Extension(shown): Extension<AuthenticatedUser>,
    peer: Option<Extension<Peer>>,
    upgrade: Result<WebSocketUpgrade, axum::extract::ws::rejection::WebSocketUpgradeRejection>,
) -> Response {
    let upgrade = match upgrade {
        Ok(upgrade) => upgrade,
        Err(refusal) => {
            return Problem::new(refusal.status(), "no_websocket", refusal.body_text()).into_response();
        }
    };
    let from = peer.map(|Extension(peer)| peer.address);
    let account = Account::new(&shown.user, from);
    let Some(permit) = shared.websockets.acquire(&shown.user, account) else {
        let AccountLimits { all, of_user, .. } = WEBSOCKET_LIMITS;
        let text =
            format!("the limit of {all} open WebSockets ({of_user} of one user) is reached; close one");
        return Problem::new(StatusCode::SERVICE_UNAVAILABLE, "unavailable", text).into_response();
    };
    let tasks = shared.tasks.clone();
    socket_limits::limit(upgrade, PAYLOAD_MAX)
        .protocols([WEBSOCKET_PROTOCOL])
        .on_upgrade(move |socket| {
            tasks.track_future(async move {
                shared.metrics.websockets.inc();
                WebSocketClient::new(&shared, shown.user.clone(), from)
                    .run(socket, &shown)
                    .await;
                shared.metrics.websockets.dec();
                drop(permit);
            })
        })
}

/// One connection.
struct WebSocketClient {
    shared: Arc<ServerState>,
    user: User,
    from: Option<IpAddr>,
    patterns: BTreeSet<String>,
    // last value of every state, so that a later subscription starts with the full value
    states: BTreeMap<Topic, Arc<Message>>,
    positions: Positions,
    /// Handlers that go offline when the connection ends, with their instances.
    handlers: BTreeMap<String, Option<String>>,
    /// Names the connection.
    name: String,
}

/// The connection cannot be used any more.
struct ClosedSocket;

impl WebSocketClient {
    fn new(shared: &Arc<ServerState>, user: User, from: Option<IpAddr>) -> Self {
        Self {
            shared: Arc::clone(shared),
            user,
            from,
            patterns: BTreeSet::new(),
            states: BTreeMap::new(),
            positions: Positions::new(shared.position_interval),
            handlers: BTreeMap::new(),
            name: shared.next_connection(),
        }
    }

    async fn run(mut self, mut socket: WebSocket, shown: &AuthenticatedUser) {
        let shared = Arc::clone(&self.shared);
        let close = tokio::select! {
            () = shared.stop.cancelled() => Some((close_code::AWAY, "the runtime stops")),
            ended = wait_until_invalid(&shared, shown) => Some((close_code::POLICY, ended.text())),
            result = self.serve(&mut socket) => result.ok(),
        };
        for (id, instance) in std::mem::take(&mut self.handlers) {
            let gone = Machine::offline_report(id, instance, ServerTransport::WebSocket);
            // fails if the runtime is stopping
            let _ = self.shared.machine.execute_request(gone).await;
        }
        if let Some((code, reason)) = close {
            let frame = Frame::Close(Some(CloseFrame {
                code,
                reason: Utf8Bytes::from_static(reason),
            }));
            let _ = send(&mut socket, frame).await;
        }
    }

    /// Serves until the client disconnects, or until the server ends the connection and returns the code and the
    /// reason.
    async fn serve(&mut self, socket: &mut WebSocket) -> Result<(u16, &'static str), ClosedSocket> {
        let mut subscription = self.shared.machine.subscribe(Filter::All);
        let mut ping = tokio::time::interval(PING_INTERVAL);
        ping.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut heard = Instant::now();
        let control = ControlFrames::new();
        loop {
            tokio::select! {
                message = subscription.next() => match message {
                    Some(message) => self.put(socket, message).await?,
                    None => return Ok((close_code::AWAY, "the runtime stops")),
                },
                positions = self.positions.due() => for position in positions {
                    self.send_if_wanted(socket, &position).await?;
                },
                frame = socket.recv() => {
                    heard = Instant::now();
                    if let Some(Ok(frame)) = &frame
                        && !control.admit(frame)
                    {
                        return Ok((close_code::POLICY, TOO_MANY_CONTROL_FRAMES));
                    }
                    match frame {
                        Some(Ok(Frame::Text(text))) => {
                            let wait = self.on_frame(socket, &text).await?;
                            tokio::time::sleep(wait).await;
                        }
                        Some(Ok(Frame::Binary(_))) => {
                            send_text(socket, error_frame("send JSON as text, not as a binary message")).await?;
                        }
                        Some(Ok(Frame::Ping(_) | Frame::Pong(_))) => {}
                        Some(Ok(Frame::Close(_)) | Err(_)) | None => return Err(ClosedSocket),
                    }
                }
                _ = ping.tick() => {
                    if heard.elapsed() > SILENCE_MAX {
                        return Err(ClosedSocket);
                    }
                    send(socket, Frame::Ping(Vec::new().into())).await?;
                }
            }
        }
    }

    async fn put(&mut self, socket: &mut WebSocket, message: Arc<Message>) -> Result<(), ClosedSocket> {
        if message.topic.is_state() {
            self.states.insert(message.topic.clone(), Arc::clone(&message));
        }
        match self.positions.keep(message) {
            Some(message) => self.send_if_wanted(socket, &message).await,
            None => Ok(()),
        }
    }

    async fn send_if_wanted(&self, socket: &mut WebSocket, message: &Message) -> Result<(), ClosedSocket> {
        let path = message.topic.path();
        if self
            .patterns
            .iter()
            .any(|pattern| rumqttc::matches(&path, pattern))
        {
            send_text(socket, message_frame(&path, message)).await?;
        }
        Ok(())
    }

    /// Executes a frame. Returns how long the client must wait before the next one.
    async fn on_frame(&mut self, socket: &mut WebSocket, text: &str) -> Result<Duration, ClosedSocket> {
        let mut bytes = text.len();
        let mut frame: ClientFrame = match json_object(text.as_bytes()) {
            Ok(frame) => frame,
            Err(error) => {
                let text = format!("write {{\"subscribe\": [\"cs/1/state\"]}} or unsubscribe: {error}");
                send_text(socket, error_frame(&text)).await?;
                return Ok(self.shared.access.count_bytes(&self.user, bytes as u64));
            }
        };
        for pattern in &frame.unsubscribe {
            self.patterns.remove(pattern);
        }
        let mut new = Vec::new();
        for pattern in std::mem::take(&mut frame.subscribe) {
            let refusal = if !may_subscribe(&self.user) {
                format!("role {} may not subscribe", self.user.role().name())
            } else if pattern.len() > PATTERN_BYTES_MAX {
                format!("a subscription has at most {PATTERN_BYTES_MAX} bytes; shorten it, or use #")
            } else if !is_known(&pattern) {
                format!("there is no topic {pattern}; write one such as cs/1/state, or with wildcards cs/1/#")
            } else if self.patterns.len() == PATTERNS_MAX && !self.patterns.contains(&pattern) {
                format!(
                    "the limit of {PATTERNS_MAX} subscriptions for one connection is reached; unsubscribe \
                     some, or use #"
                )
            } else {
                self.patterns.insert(pattern.clone());
                new.push(pattern);
                continue;
            };
            send_text(socket, error_frame(&refusal)).await?;
        }
        for mut request in frame.requests() {
            request.identify(&self.name);
            if let Err(refusal) = self.execute_request(request).await {
                send_text(socket, refusal_frame(&refusal)).await?;
            }
        }
        for message in self.states.values() {
            let path = message.topic.path();
            if new.iter().any(|pattern| rumqttc::matches(&path, pattern)) {
                let text = message_frame(&path, message);
                bytes += text.len();
                send_text(socket, text).await?;
            }
        }
        Ok(self.shared.access.count_bytes(&self.user, bytes as u64))
    }

    /// Executes the request of a frame. The rejection of a handler contains its presence, by which the client
    /// identifies it.
    async fn execute_request(&mut self, parsed: ParsedRequest) -> Result<(), Refusal> {
        let handler = match parsed.request() {
            Request::Handler(id, presence) => Some((id.clone(), presence.online, presence.instance.clone())),
            _ => None,
        };
        if let Some((id, true, _)) = &handler
            && !self.handlers.contains_key(id)
            && self.handlers.len() == HANDLERS_MAX
        {
            let text = format!("the limit of {HANDLERS_MAX} handlers for one connection is reached");
            return Err(Refusal::new(RefusalCode::Unavailable, text));
        }
        let machine = &self.shared.machine;
        let caller = Caller {
            user: &self.user,
            from: self.from,
            over: ServerTransport::WebSocket,
        };
        let answered = match machine.authorize_request(caller, parsed).await {
            Ok(authorized) => machine.execute_request(authorized).await.map(drop),
            Err(refusal) => Err(refusal),
        };
        answered.map_err(|refusal| match &handler {
            Some((id, ..)) => {
                let text = format!("{}: {refusal}", Topic::HandlerPresence(id.clone()).path());
                Refusal { text, ..refusal }
            }
            None => refusal,
        })?;
        match handler {
            Some((id, true, instance)) => self.handlers.insert(id, instance),
            Some((id, false, _)) => self.handlers.remove(&id),
            None => None,
        };
        Ok(())
    }
}

/// Waits until the credentials of a user are no longer valid.
async fn wait_until_invalid(shared: &ServerState, shown: &AuthenticatedUser) -> CloseReason {
    match shared.access.users() {
        Some(users) => users.wait_until_invalid(shown).await,
        None => std::future::pending().await,
    }
}

/// Hands a frame to the connection, which may be slow, within [`SEND_MAX`].
async fn send(socket: &mut WebSocket, frame: Frame) -> Result<(), ClosedSocket> {
    match tokio::time::timeout(SEND_MAX, socket.send(frame)).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) | Err(_) => Err(ClosedSocket),
    }
}

async fn send_text(socket: &mut WebSocket, text: String) -> Result<(), ClosedSocket> {
    send(socket, Frame::Text(text.into())).await
}

/// Returns true for a topic that the runtime publishes, and for a filter with wildcards that can match one: no topic of
/// the runtime has an empty level, although MQTT allows it.
fn is_known(filter: &str) -> bool {
    if rumqttc::has_wildcards(filter) {
        rumqttc::valid_filter(filter) && filter.split('/').all(|level| !level.is_empty())
    } else {
        Topic::parse(filter).is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_match_as_on_mqtt() {
        for (pattern, path, expected) in [
            ("cs/1/state", "cs/1/state", true),
            ("cs/1/state", "cs/2/state", false),
            ("cs/+/state", "cs/2/state", true),
            ("cs/1/#", "cs/1/m_code/5/output", true),
            ("cs/1/#", "cs/2/state", false),
            ("#", "presence", true),
            ("cs/1/+", "cs/1/m_code/pending", false),
            ("cs/1/m_code/+/output", "cs/1/m_code/7/output", true),
            ("cs/1", "cs/1/state", false),
        ] {
            assert_eq!(rumqttc::matches(path, pattern), expected, "{pattern} {path}");
        }
    }

    #[test]
    fn a_topic_that_does_not_exist_is_not_known() {
        for pattern in ["cs/1/state", "presence", "cs/1/#", "#", "cs/+/m_code/+/output"] {
            assert!(is_known(pattern), "{pattern}");
        }
        for pattern in [
            "cs/1/stat",
            "",
            "cs/#/state",
            "cs/1+/state",
            "cs//#",
            "cs/300/state",
        ] {
            assert!(!is_known(pattern), "{pattern}");
        }
    }
}
