//! Common part of all clients: a [`Hub`] that a connection fills with messages of the machine, and a [`Port`]
//! that reads from this hub.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use tokio::sync::Notify;

use crate::error::Error;
use crate::hub::{Filter, Hub, Subscription};
use crate::port::{BoxFuture, Port};
use crate::types::BootId;
use crate::types::message::{Message, Payload};
use crate::types::not_after::NotAfter;
use crate::types::request::{Answer, Refusal, RefusalCode, Request};
use crate::types::topic::Topic;

/// Time limit within which a new connection must find the runtime online.
pub const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);

/// Time limit for the answer to a request. After this time the request fails with `no_answer`, and it is
/// unknown whether the request took effect.
pub const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);

/// A connection to a machine, independent of the protocol.
pub(super) struct Link {
    /// The address without user and password.
    pub(super) address: String,
    pub(super) hub: Hub,
    started: Instant,
    /// Notified when a message must be sent, or when the port has been dropped.
    pub(super) wake: Notify,
    closed: AtomicBool,
}

impl Link {
    pub(super) fn new(address: String) -> Self {
        Self {
            address,
            hub: Hub::new(),
            started: Instant::now(),
            wake: Notify::new(),
            closed: AtomicBool::new(false),
        }
    }

    /// Returns true once the port has been dropped.
    pub(super) fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Relaxed)
    }

    pub(super) fn is_online(&self) -> bool {
        let presence = self.hub.read(&Topic::Presence);
        presence
            .is_some_and(|message| matches!(&message.payload, Payload::Presence(presence) if presence.online))
    }

    /// Marks the machine as offline until its next presence, because its known state may be stale.
    pub(super) fn set_offline(&self) {
        let Some(last) = self.hub.read(&Topic::Presence) else {
            return;
        };
        if let Payload::Presence(presence) = &last.payload {
            let mut absent = presence.clone();
            absent.online = false;
            self.hub.publish(Message {
                payload: Payload::Presence(absent),
                ..(*last).clone()
            });
        }
    }

    async fn until_present(&self) {
        let topics = vec![Topic::Presence, Topic::Birth];
        let mut messages = self.hub.subscribe(Filter::Topics(topics));
        while !(self.is_online() && self.hub.read(&Topic::Birth).is_some()) {
            messages.next().await;
        }
    }

    /// Waits for the answer to a request; returns `no_answer` if no answer arrives within `patience`.
    pub(super) async fn within<T>(
        &self,
        patience: Duration,
        answer: impl Future<Output = Result<T, Refusal>>,
    ) -> Result<T, Refusal> {
        let answer = tokio::time::timeout(patience, answer).await;
        answer.unwrap_or_else(|_| Err(self.unanswered(patience)))
    }

    pub(super) fn unanswered(&self, patience: Duration) -> Refusal {
        let text = format!("{} did not answer within {patience:?}", self.address);
        Refusal::new(RefusalCode::NoAnswer, text)
    }
}

/// The part of a client that depends on the protocol.
pub(super) trait Client: Send + Sync + 'static {
    fn link(&self) -> &Link;

    /// Keeps a connection to the machine until the link is closed.
    fn keep_connected(self: Arc<Self>) -> BoxFuture<'static, ()>;

    /// Returns the reason why no runtime is online.
    fn trouble(&self) -> String;

    fn request(
        &self,
        request: Request,
        not_after: Option<NotAfter>,
    ) -> BoxFuture<'_, Result<Answer, Refusal>>;

    fn read<'a>(&'a self, topic: &'a Topic) -> BoxFuture<'a, Option<Arc<Message>>> {
        Box::pin(std::future::ready(self.link().hub.read(topic)))
    }
}

/// Connects, and waits until the runtime is online.
///
/// # Errors
/// Fails if the runtime is not online within [`CONNECT_TIMEOUT`].
pub(super) async fn connect<C: Client>(client: C) -> Result<Arc<dyn Port>, Error> {
    let client = Arc::new(client);
    let port = ClientPort(Arc::clone(&client));
    tokio::spawn(Arc::clone(&client).keep_connected());
    match tokio::time::timeout(CONNECT_TIMEOUT, client.link().until_present()).await {
        Ok(()) => Ok(Arc::new(port)),
        Err(_) => Err(Error::Connect {
            address: client.link().address.clone(),
            reason: client.trouble(),
        }),
    }
}

/// The port over a connection. The connection ends when the port is dropped.
struct ClientPort<C: Client>(Arc<C>);

impl<C: Client> Drop for ClientPort<C> {
    fn drop(&mut self) {
        let link = self.0.link();
        link.closed.store(true, Ordering::Relaxed);
        link.wake.notify_one();
        link.hub.close();
    }
}

impl<C: Client> Port for ClientPort<C> {
    fn boot_id(&self) -> BootId {
        let presence = self.0.link().hub.read(&Topic::Presence);
        presence
            .map(|message| message.boot_id.clone())
            .unwrap_or_default()
    }

    fn read<'a>(&'a self, topic: &'a Topic) -> BoxFuture<'a, Option<Arc<Message>>> {
        self.0.read(topic)
    }

    fn subscribe(&self, filter: Filter) -> Subscription {
        self.0.link().hub.subscribe(filter)
    }

    fn request(&self, request: Request) -> BoxFuture<'_, Result<Answer, Refusal>> {
        self.0.request(request, None)
    }

    fn request_not_after<'a>(
        &'a self,
        not_after: &'a NotAfter,
        _client: Option<&'a str>,
        request: Request,
    ) -> BoxFuture<'a, Result<Answer, Refusal>> {
        self.0.request(request, Some(not_after.clone()))
    }

    fn sleep(&self, duration: Duration) -> BoxFuture<'_, ()> {
        Box::pin(tokio::time::sleep(duration))
    }

    fn now_s(&self) -> f64 {
        self.0.link().started.elapsed().as_secs_f64()
    }
}
