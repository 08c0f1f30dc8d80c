//! A machine over MQTT 3.1.1.
//!
//! What the machine says goes into a [`Hub`]; requests are messages that are sent until their end is known: the
//! `result` of a claim or reset, the `reply` of a command, the broker's acknowledgement of anything else. Everything
//! open is sent again on each new connection; the machine takes each of them twice without harm.

mod address;
mod outbox;
mod session;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use rumqttc::Transport;
use tokio::sync::Notify;

use crate::error::Error;
use crate::hub::{Filter, Hub, Subscription};
use crate::lock::lock;
use crate::names::unique_name;
use crate::port::{BoxFuture, Port};
use crate::transport::tls::TlsFiles;
use crate::types::BootId;
use crate::types::message::{Message, Payload};
use crate::types::request::{Answer, Refusal, RefusalCode, Request};
use crate::types::topic::{CsTopic, Topic};
use crate::wire::mqtt::{Until, encode};

use address::Address;
use outbox::Outbox;

/// How long [`connect`] waits for the runtime.
pub const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);

/// How long a request waits for its end; then it is refused as `unavailable`, and may have counted or not.
pub const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);

/// How long a command waits until it is done: the longest is a hold in a long deceleration or a load of a large program.
pub const COMMAND_DONE_TIMEOUT: Duration = Duration::from_mins(1);

/// What an address does not say, or should not: a command line is read by others.
#[derive(Clone, Default)]
pub struct MqttOptions {
    /// User name; goes before one in the address.
    pub username: Option<String>,
    /// The user's password, such as a token.
    pub password: Option<String>,
    /// For `mqtts://`: whom to trust, and who we are.
    pub tls: TlsFiles,
}

impl std::fmt::Debug for MqttOptions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("MqttOptions")
            .field("username", &self.username)
            .field("password", &self.password.as_ref().map(|_| "hidden"))
            .field("tls", &self.tls)
            .finish()
    }
}

/// Connects to the machine at `mqtt://[user[:password]@]host[:port]/[prefix/]machine`, with TLS `mqtts://...`, and
/// waits until it is present. The second value is the user's name.
///
/// # Errors
/// The address or a TLS file is wrong, or the runtime is not online there within [`CONNECT_TIMEOUT`].
pub async fn connect(address: &str, options: MqttOptions) -> Result<(Arc<dyn Port>, Option<String>), Error> {
    let mut address = Address::parse(address)?;
    if let Some(username) = options.username {
        address.credentials = Some((username, options.password.unwrap_or_default()));
    }
    let user = address.credentials.as_ref().map(|(user, _)| user.clone());
    let transport = if address.tls {
        options.tls.transport().map_err(|reason| Error::Address {
            address: address.shown.clone(),
            reason,
        })?
    } else {
        Transport::tcp()
    };
    let shared = Arc::new(Shared {
        address,
        transport,
        client_id: unique_name("plc"),
        hub: Hub::new(),
        started: Instant::now(),
        state: Mutex::default(),
        wake: Notify::new(),
        closed: AtomicBool::new(false),
    });
    let port = MqttPort {
        shared: Arc::clone(&shared),
    };
    tokio::spawn(session::keep_connected(Arc::clone(&shared)));
    match tokio::time::timeout(CONNECT_TIMEOUT, shared.until_present()).await {
        Ok(()) => Ok((Arc::new(port), user)),
        Err(_) => Err(shared.not_present()),
    }
}

/// What the port and its connection share.
struct Shared {
    address: Address,
    transport: Transport,
    client_id: String,
    hub: Hub,
    started: Instant,
    state: Mutex<ConnectionState>,
    wake: Notify,
    closed: AtomicBool,
}

impl std::fmt::Debug for Shared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Shared")
            .field("address", &self.address)
            .finish_non_exhaustive()
    }
}

#[derive(Debug, Default)]
struct ConnectionState {
    outbox: Outbox,
    connected: bool,
    /// Why there is no connection.
    trouble: Option<String>,
    /// Handler whose absence the broker tells when this connection breaks.
    will: Option<String>,
    /// True while that handler is there.
    online: bool,
    /// The will has changed: it counts from the next connection on.
    reconnect: bool,
}

impl ConnectionState {
    fn take_reconnect(&mut self) -> bool {
        std::mem::take(&mut self.reconnect)
    }
}

impl Shared {
    fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Relaxed)
    }

    async fn until_present(&self) {
        let mut said = self
            .hub
            .subscribe(Filter::Topics(vec![Topic::Presence, Topic::Birth]));
        loop {
            let online = self.hub.read(&Topic::Presence).is_some_and(
                |message| matches!(&message.payload, Payload::Presence(presence) if presence.online),
            );
            if online && self.hub.read(&Topic::Birth).is_some() {
                return;
            }
            said.next().await;
        }
    }

    fn not_present(&self) -> Error {
        let state = lock(&self.state);
        let reason = match &state.trouble {
            Some(trouble) => trouble.clone(),
            None if state.connected => format!(
                "the broker answers, but no runtime is online under {}/",
                self.address.root
            ),
            None => "the broker does not answer".to_owned(),
        };
        Error::Connect {
            address: self.address.shown.clone(),
            reason,
        }
    }

    /// The connection's last will shall speak for this handler.
    fn announce(&self, handler_id: &str, online: bool) -> Result<(), Refusal> {
        let mut state = lock(&self.state);
        let is_new = state.will.as_deref() != Some(handler_id);
        if !online {
            state.online &= is_new;
            return Ok(());
        }
        if is_new && state.online {
            let text = "this connection serves another sequence program; connect once for each";
            return Err(Refusal::new(RefusalCode::NotSupported, text));
        }
        state.online = true;
        if is_new {
            state.will = Some(handler_id.to_owned());
            state.reconnect = true;
            drop(state);
            self.wake.notify_one();
        }
        Ok(())
    }

    async fn ask(&self, request: Request) -> Result<Answer, Refusal> {
        if let Request::Handlers = request {
            return Ok(Answer::Handlers(self.handlers()));
        }
        let m_of = |cs, seq| match &self.hub.read(&Topic::cs(cs, CsTopic::Pending))?.payload {
            Payload::Pending(pending) => {
                let open = pending.outputs.iter().find(|output| output.output.seq == seq)?;
                Some(open.output.m)
            }
            _ => None,
        };
        let announced = match &request {
            Request::Handler(id, presence) => Some((id.clone(), presence.online)),
            _ => None,
        };
        let outgoing = encode(request, &self.client_id, m_of)?;
        if let Some((id, online)) = announced {
            self.announce(&id, online)?;
        }
        let patience = match &outgoing.until {
            Until::Reply { done: true, .. } => COMMAND_DONE_TIMEOUT,
            _ => ANSWER_TIMEOUT,
        };
        let (id, end) = lock(&self.state).outbox.put(outgoing)?;
        let _entry = Forget { shared: self, id };
        self.wake.notify_one();
        if let Ok(Ok(outcome)) = tokio::time::timeout(patience, end).await {
            return outcome;
        }
        let text = format!("{} did not answer within {patience:?}", self.address.shown);
        Err(Refusal::new(RefusalCode::Unavailable, text))
    }

    fn handlers(&self) -> BTreeMap<String, crate::types::output::HandlerPresence> {
        let states = self.hub.states();
        let handlers = states
            .iter()
            .filter_map(|message| match (&message.topic, &message.payload) {
                (Topic::HandlerPresence(id), Payload::HandlerPresence(presence)) => {
                    Some((id.clone(), presence.clone()))
                }
                _ => None,
            });
        handlers.collect()
    }
}

/// Takes a message out of the outbox when nobody waits for its end any more.
struct Forget<'a> {
    shared: &'a Shared,
    id: u64,
}

impl Drop for Forget<'_> {
    fn drop(&mut self) {
        lock(&self.shared.state).outbox.forget(self.id);
    }
}

/// The port over a connection; the connection ends with it.
#[derive(Debug)]
struct MqttPort {
    shared: Arc<Shared>,
}

impl Drop for MqttPort {
    fn drop(&mut self) {
        self.shared.closed.store(true, Ordering::Relaxed);
        self.shared.wake.notify_one();
        self.shared.hub.close();
    }
}

impl Port for MqttPort {
    fn boot_id(&self) -> BootId {
        let presence = self.shared.hub.read(&Topic::Presence);
        presence
            .map(|message| message.boot_id.clone())
            .unwrap_or_default()
    }

    fn read<'a>(&'a self, topic: &'a Topic) -> BoxFuture<'a, Option<Arc<Message>>> {
        Box::pin(std::future::ready(self.shared.hub.read(topic)))
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
