//! A machine over MQTT 3.1.1.
//!
//! The client repeats the message of a request until the request is answered: a claim or reset by its
//! `result`, a command by its `reply`, any other request by the acknowledgement of the broker. Unanswered
//! requests are sent again on each new connection. If the machine receives a request twice, the second
//! message has no effect.

mod address;
mod age;
mod outbox;
mod session;

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use rumqttc::{TlsConfiguration, Transport};
use rustls::ClientConfig;
use tokio::sync::{Notify, oneshot};

use crate::error::Error;
use crate::lock::lock;
use crate::names::unique_name;
use crate::port::{BoxFuture, Port};
use crate::transport::client::{Client, Link};
use crate::transport::options::MqttOptions;
use crate::types::ids::is_client_id;
use crate::types::message::Payload;
use crate::types::not_after::NotAfter;
use crate::types::output::HandlerPresence;
use crate::types::request::{Answer, Refusal, RefusalCode, Request};
use crate::types::topic::{CsTopic, Topic};
use crate::wire::message_sender::MessageSender;
use crate::wire::mqtt::{Until, encode, encode_not_after};

use address::MqttAddress;
use age::MachineAge;
use outbox::{Outbox, Outcome};

pub use crate::transport::client::{ANSWER_TIMEOUT, CONNECT_TIMEOUT};

/// Time limit of a command. Reason: the longest commands are a hold with a long deceleration and the load of
/// a large program.
pub const COMMAND_DONE_TIMEOUT: Duration = Duration::from_mins(1);

/// Largest number of characters of the user name at the beginning of the client id. Reason: a client id has
/// at most 64 characters.
const USER_MAX: usize = 46;

/// Connects to the machine at `mqtt://[user[:password]@]host[:port]/[prefix/]machine`, with TLS
/// `mqtts://...`, and waits until the runtime is online. If the address names several nodes of a broker,
/// `host[:port],host[:port]`, the client uses the first node that answers until the connection to this node
/// is lost. The second value of the result is the user name.
///
/// # Errors
/// Fails if the address or a TLS file is invalid, or the runtime is not online within [`CONNECT_TIMEOUT`].
pub async fn connect(address: &str, options: MqttOptions) -> Result<(Arc<dyn Port>, Option<String>), Error> {
    let mut address = MqttAddress::parse(address)?;
    if let Some(username) = options.username {
        address.credentials = Some((username, options.password.unwrap_or_default()));
    }
    let user = address.credentials.as_ref().map(|(user, _)| user.clone());
    let transport = if address.tls {
        options
            .tls
            .client_config()
            .map(mqtt_over)
            .map_err(|reason| Error::Address {
                address: address.shown.clone(),
                reason,
            })?
    } else {
        Transport::tcp()
    };
    // access rules permit a user only the topics with the name of the user
    let named = user
        .as_deref()
        .filter(|user| is_client_id(user) && user.len() <= USER_MAX);
    let client_id = match named {
        Some(user) => unique_name(&format!("{user}-plc")),
        None => unique_name("plc"),
    };
    let topic_id = named.map_or_else(|| client_id.clone(), ToOwned::to_owned);
    let port = crate::transport::client::connect(MqttClient {
        link: Link::new(address.shown.clone()),
        address,
        transport,
        client_id,
        topic_id,
        presence_expires: options.presence_expires,
        is_connected: Notify::new(),
        state: Mutex::default(),
    });
    Ok((port.await?, user))
}

/// Returns the transport for a connection to a broker over TLS.
pub fn mqtt_over(tls: ClientConfig) -> Transport {
    Transport::tls_with_config(TlsConfiguration::from(tls))
}

/// The client, shared by the port and its connection.
struct MqttClient {
    link: Link,
    address: MqttAddress,
    transport: Transport,
    client_id: String,
    /// Name of the client in its topics: its user name, otherwise its client id.
    topic_id: String,
    presence_expires: Duration,
    is_connected: Notify,
    state: Mutex<MqttConnectionState>,
}

#[derive(Debug, Default)]
struct MqttConnectionState {
    outbox: Outbox,
    connected: bool,
    /// Time since which messages wait without an acknowledgement; `None` if no message waits.
    silent_since: Option<Instant>,
    /// Reason why no connection exists.
    trouble: Option<String>,
    /// Handler and instance that the broker reports as offline if this connection breaks (last will).
    will: Option<(String, Option<String>)>,
    /// True while the handler of the last will is online.
    online: bool,
    /// True if the last will has changed, so that a new connection must announce the new last will.
    reconnect: bool,
    /// The presence that is published periodically.
    repeated_presence: Option<(String, HandlerPresence)>,
    /// Number of connections so far. `repeated_over` is the number of the connection over which the presence
    /// was last published.
    connections: u64,
    repeated_over: u64,
    machine: MachineAge,
}

impl Client for MqttClient {
    fn link(&self) -> &Link {
        &self.link
    }

    fn keep_connected(self: Arc<Self>) -> BoxFuture<'static, ()> {
        Box::pin(session::keep_connected(self))
    }

    fn trouble(&self) -> String {
        let state = lock(&self.state);
        match &state.trouble {
            Some(trouble) => trouble.clone(),
            None if state.connected => format!(
                "the broker answers, but no runtime is online under {}/",
                self.address.root
            ),
            None => "the broker does not answer".to_owned(),
        }
    }

    fn request(
        &self,
        request: Request,
        not_after: Option<NotAfter>,
    ) -> BoxFuture<'_, Result<Answer, Refusal>> {
        Box::pin(self.ask(request, not_after))
    }
}

impl MqttClient {
    /// Sets the last will of the connection to the last will of this handler.
    fn announce(&self, handler_id: &str, presence: &HandlerPresence) -> Result<(), Refusal> {
        let mut state = lock(&self.state);
        let will = Some((handler_id.to_owned(), presence.instance.clone()));
        let is_new = state.will != will;
        if !presence.online {
            state.online &= is_new;
            state
                .repeated_presence
                .take_if(|(id, said)| id == handler_id && said.instance == presence.instance);
            return Ok(());
        }
        if is_new && state.online {
            let text = "this connection serves another sequence program; connect once for each";
            return Err(Refusal::new(RefusalCode::NotSupported, text));
        }
        state.online = true;
        let said = HandlerPresence {
            take_over: false,
            ..presence.clone()
        };
        state.repeated_presence = Some((handler_id.to_owned(), said));
        state.repeated_over = state.connections + u64::from(is_new);
        if is_new {
            state.will = will;
            state.reconnect = true;
            drop(state);
            self.link.wake.notify_one();
        }
        Ok(())
    }

    /// Publishes the presence of the handler again, and returns the receiver of the answer.
    fn refresh(&self) -> Option<oneshot::Receiver<Outcome>> {
        let mut state = lock(&self.state);
        let (id, mut presence) = state.repeated_presence.clone()?;
        if state.connections > state.repeated_over {
            state.repeated_over = state.connections;
            presence.connection = Some(state.connections);
            state.repeated_presence = Some((id.clone(), presence.clone()));
        }
        let outgoing = encode(Request::Handler(id, presence), &self.client_id, |_, _| None).ok()?;
        state.outbox.put(outgoing).ok()
    }

    /// Returns the sender that the topic of a request must name.
    fn speaker(&self, request: &Request) -> MessageSender {
        let said = lock(&self.state).repeated_presence.clone();
        let handler = said.map(|(id, _)| id);
        MessageSender::of_request(request, handler.as_deref(), &self.topic_id)
    }

    async fn ask(&self, mut request: Request, not_after: Option<NotAfter>) -> Result<Answer, Refusal> {
        if let Request::Handlers = request {
            return Ok(Answer::Handlers(self.link.hub.handlers()));
        }
        if let Request::Handler(_, presence) = &mut request
            && presence.online
        {
            let expires_ms = u64::try_from(self.presence_expires.as_millis()).unwrap_or(u64::MAX);
            presence.expires_ms.get_or_insert(expires_ms);
        }
        let m_of = |cs, seq| match &self.link.hub.read(&Topic::cs(cs, CsTopic::Pending))?.payload {
            Payload::Pending(pending) => {
                let open = pending.outputs.iter().find(|output| output.output.seq == seq)?;
                Some(open.output.m)
            }
            _ => None,
        };
        let announced = match &request {
            Request::Handler(id, presence) => Some((id.clone(), presence.clone())),
            _ => None,
        };
        let speaker = self.speaker(&request);
        let mut outgoing = encode_not_after(request, not_after.as_ref(), &self.client_id, m_of)?;
        if announced.is_none() && !outgoing.path.starts_with("client/") {
            outgoing.path = speaker.path(&outgoing.path);
        }
        if let Some((id, presence)) = announced {
            self.announce(&id, &presence)?;
        }
        let patience = match &outgoing.until {
            Until::Reply { done: true, .. } => COMMAND_DONE_TIMEOUT,
            _ => ANSWER_TIMEOUT,
        };
        let end = lock(&self.state).outbox.put(outgoing)?;
        self.link.wake.notify_one();
        let answer = async { end.await.unwrap_or_else(|_| Err(self.link.unanswered(patience))) };
        self.link.within(patience, answer).await
    }
}
