//! The port: the whole sequence-control interface as one trait.
//!
//! The runtime and each client transport implement this trait, and servers serve any implementation.
//! Therefore a sequence program runs unchanged in the process of the runtime, in another process and in a
//! test.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use crate::hub::{Filter, Subscription};
use crate::types::BootId;
use crate::types::message::Message;
use crate::types::not_after::NotAfter;
use crate::types::refusal::{Refusal, RefusalCode};
use crate::types::request::{Answer, Request, TypedRequest};
use crate::types::topic::Topic;

/// Pause before the repetition of a claim, reset, presence, lock or question that could not be delivered.
pub const RETRY: Duration = Duration::from_secs(1);

/// A boxed future, so that [`Port`] is dyn compatible.
pub type BoxFuture<'a, T> = Pin<Box<dyn Future<Output = T> + Send + 'a>>;

/// The sequence-control interface of one machine.
pub trait Port: Send + Sync + 'static {
    /// Returns the current boot of the runtime.
    fn boot_id(&self) -> BootId;

    /// Returns the current value of a state topic, or `None` if the topic has no value. Positions are those
    /// of the last servo cycle.
    fn read<'a>(&'a self, topic: &'a Topic) -> BoxFuture<'a, Option<Arc<Message>>>;

    /// Subscribes to the topics of the filter: the subscription returns first the current value of each state
    /// topic, then every change.
    fn subscribe(&self, filter: Filter) -> Subscription;

    /// Sends a request. A refusal means that nothing has changed. [`ask`](trait.Port.html#method.ask) returns
    /// a typed answer.
    fn request(&self, request: Request) -> BoxFuture<'_, Result<Answer, Refusal>>;

    /// Sends a request on behalf of a client; the journal records the request under the name of this client.
    /// Client transports ignore the name, because the server knows their client.
    fn request_as<'a>(
        &'a self,
        _client: &'a str,
        request: Request,
    ) -> BoxFuture<'a, Result<Answer, Refusal>> {
        self.request(request)
    }

    /// Sends a request with an age limit. If the request would take effect after this limit, the machine
    /// rejects the request as `expired`. A request that cannot cause a motion is sent without the age limit.
    fn request_not_after<'a>(
        &'a self,
        _not_after: &'a NotAfter,
        _client: Option<&'a str>,
        _request: Request,
    ) -> BoxFuture<'a, Result<Answer, Refusal>> {
        let text = "this connection carries no not_after; send the request without it";
        Box::pin(std::future::ready(Err(Refusal::new(
            RefusalCode::NotSupported,
            text,
        ))))
    }

    /// Sleeps on the port's clock, which is simulated time in a simulation.
    fn sleep(&self, duration: Duration) -> BoxFuture<'_, ()>;

    /// Returns the time of the port's clock, seconds since the start of this clock.
    fn now_s(&self) -> f64;
}

impl dyn Port {
    /// Sends a request, and returns its typed answer. A refusal means that nothing has changed.
    ///
    /// ```
    /// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
    /// use plc_protocol::types::request::typed::Handlers;
    /// let plc = plc_api::fake::FakePort::new([1]).plc();
    /// assert!(plc.port().ask(Handlers).await?.is_empty());
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Returns the refusal of the machine, or `invalid` if the answer has the wrong type, which is a defect
    /// of the port.
    pub async fn ask<R: TypedRequest>(&self, request: R) -> Result<R::Answer, Refusal> {
        Self::answer_of::<R>(self.request(request.into()).await?)
    }

    /// Sends a request on behalf of a client, and returns its typed answer.
    ///
    /// # Errors
    /// Fails as [`ask`](trait.Port.html#method.ask).
    pub async fn ask_as<R: TypedRequest>(&self, client: &str, request: R) -> Result<R::Answer, Refusal> {
        Self::answer_of::<R>(self.request_as(client, request.into()).await?)
    }

    fn answer_of<R: TypedRequest>(answer: Answer) -> Result<R::Answer, Refusal> {
        R::Answer::try_from(answer).map_err(|other| {
            let text = format!("the machine gave an answer of another kind: {other:?}");
            Refusal::new(RefusalCode::Invalid, text)
        })
    }
}
