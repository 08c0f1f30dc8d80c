//! A machine over REST and WebSocket.
//!
//! The WebSocket carries messages of the machine, and presences and validation results of handlers. All other
//! requests are HTTP. If an answer is lost, the request is sent again. A request that the machine receives
//! twice has no second effect: a command has an `Idempotency-Key`, a claim or reset has `boot_id` and `seq`,
//! and an input sets a value and does not toggle it.

mod address;
mod session;

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use http_body_util::{BodyExt, Limited};
use hyper_rustls::{HttpsConnector, HttpsConnectorBuilder};
use hyper_util::client::legacy::Client;
use hyper_util::client::legacy::connect::HttpConnector;
use hyper_util::rt::TokioExecutor;
use rustls::ClientConfig;
use tokio::sync::Notify;
use tokio_tungstenite::tungstenite::http;

use crate::error::Error;
use crate::hub::Filter;
use crate::lock::lock;
use crate::port::{BoxFuture, Port};
use crate::transport::client::{Client as TransportClient, Link};
use crate::transport::options::MqttOptions;
use crate::transport::tls::without_authorities;
use crate::types::message::{Message, Payload};
use crate::types::not_after::NotAfter;
use crate::types::output::HandlerPresence;
use crate::types::request::{Answer, Refusal, RefusalCode, Request};
use crate::types::topic::{CsTopic, Topic};
use crate::wire::rest::{Exchange, encode_not_after, read};
use crate::wire::websocket::{self, ClientFrame};

use address::RestAddress;

pub use crate::transport::client::{ANSWER_TIMEOUT, CONNECT_TIMEOUT};

/// Time limit of a command: the time for which the server waits for its end, plus the time for the answer.
pub const COMMAND_DONE_TIMEOUT: Duration = Duration::from_secs(65);

/// Pause before a request is sent again.
const AGAIN_AFTER: Duration = Duration::from_millis(200);

/// Connects to the machine at `http://[[user:]token@]host[:port]`, with TLS `https://...`, and waits until
/// the runtime is online. The second value of the result is the user name.
///
/// # Errors
/// Fails if the address or a TLS file is invalid, or no runtime answers within [`CONNECT_TIMEOUT`].
pub async fn connect(address: &str, options: MqttOptions) -> Result<(Arc<dyn Port>, Option<String>), Error> {
    let mut address = RestAddress::parse(address)?;
    address.user = options.username.or(address.user);
    address.token = options.password.or(address.token);
    let user = address.user.clone();
    let tls = if address.tls {
        options.tls.client_config()
    } else {
        without_authorities()
    };
    let tls = tls.map_err(|reason| Error::Address {
        address: address.shown.clone(),
        reason,
    })?;
    let connector = HttpsConnectorBuilder::new()
        .with_tls_config(tls.clone())
        .https_or_http()
        .enable_http1()
        .build();
    let port = crate::transport::client::connect(RestClient {
        link: Link::new(address.shown.clone()),
        address,
        tls: Arc::new(tls),
        client: Client::builder(TokioExecutor::new()).build(connector),
        state: Mutex::default(),
        refused: Notify::new(),
    });
    Ok((port.await?, user))
}

/// Largest number of bytes of an answer; a longer answer is an error. Reason: the size of the longest program
/// text, and a reserve.
const BODY_MAX: usize = 65 * 1024 * 1024;

/// Largest number of unsent results of validations; a further result is refused.
const VALIDATED_MAX: usize = 10_000;

type HttpClient = Client<HttpsConnector<HttpConnector>, String>;
type BoxError = Box<dyn std::error::Error + Send + Sync>;

/// The client, shared by the port and its connection.
struct RestClient {
    link: Link,
    address: RestAddress,
    /// TLS configuration of the WebSocket; the HTTP client has its own configuration.
    tls: Arc<ClientConfig>,
    client: HttpClient,
    state: Mutex<RestConnectionState>,
    /// Notified if the machine has refused a handler.
    refused: Notify,
}

#[derive(Debug, Default)]
struct RestConnectionState {
    /// Reason why no connection exists.
    trouble: Option<String>,
    /// Handlers of this process with their presence, which is announced on every new connection.
    handlers: BTreeMap<String, HandlerPresence>,
    /// Handlers of this process that have left, with their last presence.
    offline: BTreeMap<String, HandlerPresence>,
    /// Handlers whose presence must be sent on this connection.
    unsent: Vec<String>,
    /// Handlers that the machine has refused, with the refusal.
    refused: BTreeMap<String, Refusal>,
    /// Frames with results of validations that must be sent on this connection.
    validated: Vec<ClientFrame>,
}

impl TransportClient for RestClient {
    fn link(&self) -> &Link {
        &self.link
    }

    fn keep_connected(self: Arc<Self>) -> BoxFuture<'static, ()> {
        Box::pin(session::keep_connected(self))
    }

    fn trouble(&self) -> String {
        let trouble = lock(&self.state).trouble.clone();
        trouble.unwrap_or_else(|| "no runtime answers there".to_owned())
    }

    fn request(
        &self,
        request: Request,
        not_after: Option<NotAfter>,
    ) -> BoxFuture<'_, Result<Answer, Refusal>> {
        Box::pin(self.ask(request, not_after))
    }

    fn read<'a>(&'a self, topic: &'a Topic) -> BoxFuture<'a, Option<Arc<Message>>> {
        Box::pin(async move {
            if let Topic::CoordinateSystem(_, CsTopic::Position) = topic {
                // the WebSocket carries positions only ten times a second; GET returns the positions of the
                // last servo cycle
                if let Some(exchange) = read(topic)
                    && let Ok(Ok((200, _, body))) =
                        tokio::time::timeout(ANSWER_TIMEOUT, self.send(&exchange)).await
                    && let Ok(message) = Message::from_json(topic.clone(), &body)
                {
                    return Some(Arc::new(message));
                }
            }
            self.link.hub.read(topic)
        })
    }
}

impl RestClient {
    async fn ask(&self, request: Request, not_after: Option<NotAfter>) -> Result<Answer, Refusal> {
        let request = match request {
            Request::Handler(id, presence) => return self.announce(id, presence).await,
            Request::ValidateResult(..) => return self.send_validation(request),
            other => other,
        };
        let patience = match &request {
            Request::Command { wait: true, .. } => COMMAND_DONE_TIMEOUT,
            _ => ANSWER_TIMEOUT,
        };
        let exchange = encode_not_after(request, not_after.as_ref())?;
        self.link
            .within(patience, self.repeat_until_answered(&exchange))
            .await
    }

    async fn repeat_until_answered(&self, exchange: &Exchange) -> Result<Answer, Refusal> {
        loop {
            match self.send(exchange).await {
                Ok((status, etag, body)) => return exchange.answer.decode(status, &etag, body),
                Err(error) => {
                    tracing::debug!(%error, path = %exchange.path, "no answer; sending the request again");
                    tokio::time::sleep(AGAIN_AFTER).await;
                }
            }
        }
    }

    /// Sends a request once; returns status, `ETag` and body of the answer.
    async fn send(&self, exchange: &Exchange) -> Result<(u16, String, Vec<u8>), BoxError> {
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
        let etag = response.headers().get(http::header::ETAG);
        let etag = etag
            .and_then(|etag| etag.to_str().ok())
            .unwrap_or_default()
            .to_owned();
        let body = Limited::new(response.into_body(), BODY_MAX).collect().await?;
        Ok((status, etag, body.to_bytes().to_vec()))
    }

    /// Passes the result of a validation to the connection. The machine sends no answer to this result.
    fn send_validation(&self, result: Request) -> Result<Answer, Refusal> {
        let frame = websocket::encode(result)?;
        let mut state = lock(&self.state);
        if !self.link.is_online() || state.validated.len() >= VALIDATED_MAX {
            let text = format!("{} cannot accept a validation result now", self.link.address);
            return Err(Refusal::new(RefusalCode::Unavailable, text));
        }
        state.validated.push(frame);
        drop(state);
        self.link.wake.notify_one();
        Ok(Answer::Done)
    }

    /// Announces a handler on this connection, and waits until the machine publishes its presence.
    async fn announce(&self, id: String, presence: HandlerPresence) -> Result<Answer, Refusal> {
        let topic = Topic::HandlerPresence(id.clone());
        let mut messages = self.link.hub.subscribe(Filter::Topics(vec![topic.clone()]));
        {
            let mut state = lock(&self.state);
            state.refused.remove(&id);
            if presence.online {
                state.handlers.insert(id.clone(), presence.clone());
            } else {
                state.handlers.remove(&id);
                state.offline.insert(id.clone(), presence.clone());
            }
            state.unsent.push(id.clone());
        }
        self.link.wake.notify_one();
        let presence = HandlerPresence {
            take_over: false,
            ..presence
        };
        let is_so = || match self
            .link
            .hub
            .read(&topic)
            .as_deref()
            .map(|message| &message.payload)
        {
            Some(Payload::HandlerPresence(known)) if presence.online => *known == presence,
            Some(Payload::HandlerPresence(known)) => !known.online || known.instance != presence.instance,
            _ => !presence.online,
        };
        let until_so = async {
            while !is_so() {
                let refused = self.refused.notified();
                if let Some(refusal) = lock(&self.state).refused.remove(&id) {
                    return Err(refusal);
                }
                tokio::select! {
                    _ = messages.next() => {}
                    () = refused => {}
                }
            }
            Ok(Answer::Done)
        };
        self.link.within(ANSWER_TIMEOUT, until_so).await
    }
}
