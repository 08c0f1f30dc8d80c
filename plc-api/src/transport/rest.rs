//! A machine over REST and WebSocket.
//!
//! The WebSocket carries what the machine says into a [`Hub`], which handlers this process serves, and what they say of
//! programs to be loaded; all other requests go over REST. A request whose answer got lost is sent again, and the machine takes it twice without harm: a command
//! carries its `Idempotency-Key`, a claim or reset its `boot_id` and `seq`, and an input is a value and no toggle.

mod address;
mod session;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use http_body_util::{BodyExt, Limited};
use hyper_util::client::legacy::Client;
use hyper_util::client::legacy::connect::HttpConnector;
use hyper_util::rt::TokioExecutor;
use tokio::sync::Notify;
use tokio_tungstenite::tungstenite::http;

use crate::error::Error;
use crate::hub::{Filter, Hub, Subscription};
use crate::lock::lock;
use crate::port::{BoxFuture, Port};
use crate::types::BootId;
use crate::types::message::{Message, Payload};
use crate::types::output::HandlerPresence;
use crate::types::request::{Answer, Refusal, RefusalCode, Request};
use crate::types::topic::{CsTopic, Topic};
use crate::wire::rest::{Exchange, encode, read};
use crate::wire::websocket::{self, ClientFrame};

use address::Address;

/// How long [`connect`] waits for the runtime.
pub const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);

/// How long a request waits for its answer; then it is refused as `unavailable`, and may have counted or not.
pub const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);

/// How long a command waits until it is done: as long as the server waits, and an answer's time.
pub const COMMAND_DONE_TIMEOUT: Duration = Duration::from_secs(65);

/// Pause before a request whose answer got lost is sent again.
const AGAIN_AFTER: Duration = Duration::from_millis(200);

/// Connects to the machine at `http://[[user:]token@]host[:port]`, and waits until it is present. The second value is
/// the user's name.
///
/// # Errors
/// The address is wrong, or no runtime answers there within [`CONNECT_TIMEOUT`].
pub async fn connect(address: &str) -> Result<(Arc<dyn Port>, Option<String>), Error> {
    let shared = Arc::new(Shared {
        address: Address::parse(address)?,
        client: Client::builder(TokioExecutor::new()).build_http(),
        hub: Hub::new(),
        started: Instant::now(),
        state: Mutex::default(),
        wake: Notify::new(),
        refused: Notify::new(),
        closed: AtomicBool::new(false),
    });
    let port = RestPort {
        shared: Arc::clone(&shared),
    };
    tokio::spawn(session::keep_connected(Arc::clone(&shared)));
    match tokio::time::timeout(CONNECT_TIMEOUT, shared.until_present()).await {
        Ok(()) => Ok((Arc::new(port), shared.address.user.clone())),
        Err(_) => Err(shared.not_present()),
    }
}

/// An answer that is longer is none: the longest text of a program, and some room.
const BODY_MAX: usize = 65 * 1024 * 1024;

/// Results of validations that wait for the connection; more are refused.
const VALIDATED_MAX: usize = 10_000;

type HttpClient = Client<HttpConnector, String>;
type BoxError = Box<dyn std::error::Error + Send + Sync>;

/// What the port and its connection share.
#[derive(Debug)]
struct Shared {
    address: Address,
    client: HttpClient,
    hub: Hub,
    started: Instant,
    state: Mutex<ConnectionState>,
    /// Handlers have changed, or the port is closed.
    wake: Notify,
    /// A handler has been refused.
    refused: Notify,
    closed: AtomicBool,
}

#[derive(Debug, Default)]
struct ConnectionState {
    /// Why there is no connection.
    trouble: Option<String>,
    /// Handlers that this process serves: said on every new connection.
    handlers: BTreeMap<String, HandlerPresence>,
    /// Handlers whose presence is to be said on this connection.
    unsaid: Vec<String>,
    /// Handlers that the machine does not take, and why.
    refused: BTreeMap<String, String>,
    /// Frames with results of validations, to be said on this connection.
    validated: Vec<ClientFrame>,
}

impl Shared {
    fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Relaxed)
    }

    fn is_online(&self) -> bool {
        self.hub
            .read(&Topic::Presence)
            .is_some_and(|message| matches!(&message.payload, Payload::Presence(presence) if presence.online))
    }

    async fn until_present(&self) {
        let mut said = self
            .hub
            .subscribe(Filter::Topics(vec![Topic::Presence, Topic::Birth]));
        while !(self.is_online() && self.hub.read(&Topic::Birth).is_some()) {
            said.next().await;
        }
    }

    fn not_present(&self) -> Error {
        let trouble = lock(&self.state).trouble.clone();
        Error::Connect {
            address: self.address.shown.clone(),
            reason: trouble.unwrap_or_else(|| "no runtime answers there".to_owned()),
        }
    }

    async fn ask(&self, request: Request) -> Result<Answer, Refusal> {
        let request = match request {
            Request::Handler(id, presence) => return self.announce(id, presence).await,
            Request::ValidateResult(..) => return self.validated(request),
            other => other,
        };
        let patience = match &request {
            Request::Command { wait: true, .. } => COMMAND_DONE_TIMEOUT,
            _ => ANSWER_TIMEOUT,
        };
        let exchange = encode(request)?;
        match tokio::time::timeout(patience, self.exchanged(&exchange)).await {
            Ok(answer) => answer,
            Err(_) => Err(self.unanswered(patience)),
        }
    }

    fn unanswered(&self, patience: Duration) -> Refusal {
        let text = format!("{} did not answer within {patience:?}", self.address.shown);
        Refusal::new(RefusalCode::Unavailable, text)
    }

    /// Sends it until there is an answer.
    async fn exchanged(&self, exchange: &Exchange) -> Result<Answer, Refusal> {
        loop {
            match self.send(exchange).await {
                Ok((status, body)) => return exchange.answer.decode(status, &body),
                Err(error) => {
                    tracing::debug!(%error, path = %exchange.path, "no answer; asking again");
                    tokio::time::sleep(AGAIN_AFTER).await;
                }
            }
        }
    }

    async fn send(&self, exchange: &Exchange) -> Result<(u16, String), BoxError> {
        let url = format!("{}{}", self.address.http, exchange.path);
        let mut request = http::Request::builder().method(exchange.method).uri(url);
        if let Some(token) = &self.address.token {
            request = request.header(http::header::AUTHORIZATION, format!("Bearer {token}"));
        }
        for (name, value) in &exchange.headers {
            request = request.header(*name, value);
        }
        let response = self
            .client
            .request(request.body(exchange.body.clone().unwrap_or_default())?)
            .await?;
        let status = response.status().as_u16();
        let body = Limited::new(response.into_body(), BODY_MAX).collect().await?;
        Ok((status, String::from_utf8(body.to_bytes().to_vec())?))
    }

    /// Hands the result of a validation to the connection. The machine waits for it, and does not answer.
    fn validated(&self, result: Request) -> Result<Answer, Refusal> {
        let frame = websocket::encode(result)?;
        let mut state = lock(&self.state);
        if !self.is_online() || state.validated.len() >= VALIDATED_MAX {
            let text = format!("{} takes no result of a validation now", self.address.shown);
            return Err(Refusal::new(RefusalCode::Unavailable, text));
        }
        state.validated.push(frame);
        drop(state);
        self.wake.notify_one();
        Ok(Answer::Done)
    }

    /// The connection speaks for this handler from now on; done when the machine has said so.
    async fn announce(&self, id: String, presence: HandlerPresence) -> Result<Answer, Refusal> {
        let topic = Topic::HandlerPresence(id.clone());
        let mut said = self.hub.subscribe(Filter::Topics(vec![topic.clone()]));
        {
            let mut state = lock(&self.state);
            state.refused.remove(&id);
            if presence.online {
                state.handlers.insert(id.clone(), presence.clone());
            } else {
                state.handlers.remove(&id);
            }
            state.unsaid.push(id.clone());
        }
        self.wake.notify_one();
        let is_so = || match self.hub.read(&topic).as_deref().map(|message| &message.payload) {
            Some(Payload::HandlerPresence(known)) => *known == presence,
            _ => !presence.online,
        };
        let until_so = async {
            while !is_so() {
                let refused = self.refused.notified();
                if let Some(text) = lock(&self.state).refused.remove(&id) {
                    return Err(Refusal::new(RefusalCode::Invalid, text));
                }
                tokio::select! {
                    _ = said.next() => {}
                    () = refused => {}
                }
            }
            Ok(Answer::Done)
        };
        match tokio::time::timeout(ANSWER_TIMEOUT, until_so).await {
            Ok(answer) => answer,
            Err(_) => Err(self.unanswered(ANSWER_TIMEOUT)),
        }
    }
}

/// The port over a connection; the connection ends with it.
#[derive(Debug)]
struct RestPort {
    shared: Arc<Shared>,
}

impl Drop for RestPort {
    fn drop(&mut self) {
        self.shared.closed.store(true, Ordering::Relaxed);
        self.shared.wake.notify_one();
        self.shared.hub.close();
    }
}

impl Port for RestPort {
    fn boot_id(&self) -> BootId {
        let presence = self.shared.hub.read(&Topic::Presence);
        presence
            .map(|message| message.boot_id.clone())
            .unwrap_or_default()
    }

    fn read<'a>(&'a self, topic: &'a Topic) -> BoxFuture<'a, Option<Arc<Message>>> {
        Box::pin(async move {
            if let Topic::CoordinateSystem(_, CsTopic::Position) = topic {
                // The WebSocket brings positions ten times a second; a GET gives the last servo cycle's.
                if let Some(exchange) = read(topic)
                    && let Ok(Ok((200, body))) =
                        tokio::time::timeout(ANSWER_TIMEOUT, self.shared.send(&exchange)).await
                    && let Ok(message) = Message::from_json(topic.clone(), body.as_bytes())
                {
                    return Some(Arc::new(message));
                }
            }
            self.shared.hub.read(topic)
        })
    }

    fn subscribe(&self, filter: Filter) -> Subscription {
        self.shared.hub.subscribe(filter)
    }

    fn request(&self, request: Request) -> BoxFuture<'_, Result<Answer, Refusal>> {
        Box::pin(self.shared.ask(request))
    }

    fn sleep(&self, duration: Duration) -> BoxFuture<'_, ()> {
        Box::pin(tokio::time::sleep(duration))
    }

    fn now_s(&self) -> f64 {
        self.shared.started.elapsed().as_secs_f64()
    }
}
