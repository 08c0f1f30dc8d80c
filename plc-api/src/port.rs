//! The port: the whole sequence-control interface as one trait.
//!
//! The runtime and each client transport implement it, and servers serve any implementation. So a sequence program runs
//! unchanged in the runtime's process, in another process and in a test.

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

/// Pause before a claim, reset, presence, lock or question that could not be delivered is sent again.
pub(crate) const RETRY: Duration = Duration::from_secs(1);

/// A boxed future, so that [`Port`] is dyn compatible.
pub type BoxFuture<'a, T> = Pin<Box<dyn Future<Output = T> + Send + 'a>>;

/// The sequence-control interface of one machine.
pub trait Port: Send + Sync + 'static {
    /// The current boot of the runtime.
    fn boot_id(&self) -> BootId;

    /// The current value of a state topic; positions are those of the last servo cycle. `None`: no value.
    fn read<'a>(&'a self, topic: &'a Topic) -> BoxFuture<'a, Option<Arc<Message>>>;

    /// Messages of the topics of the filter: first the current value of each state topic, then every change.
    fn subscribe(&self, filter: Filter) -> Subscription;

    /// Sends a request. A refusal means that nothing has changed. [`ask`](trait.Port.html#method.ask) returns a typed
    /// answer.
    fn request(&self, request: Request) -> BoxFuture<'_, Result<Answer, Refusal>>;

    /// The same on behalf of a client, by whose name the journal tells of it. Transports know their client themselves.
    fn request_as<'a>(
        &'a self,
        _client: &'a str,
        request: Request,
    ) -> BoxFuture<'a, Result<Answer, Refusal>> {
        self.request(request)
    }

    /// The same with an age limit: the machine rejects it as `expired` if it would take effect later. A request after which
    /// nothing can move is sent without it.
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

    /// Seconds since the start on the port's clock.
    fn now_s(&self) -> f64;
}

impl dyn Port {
    /// Sends a request, and returns its typed answer. A refusal means that nothing has changed.
    ///
    /// ```
    /// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
    /// use plc_api::types::request::typed::Handlers;
    /// let plc = plc_api::fake::FakePort::new([1]).plc();
    /// assert!(plc.port().ask(Handlers).await?.is_empty());
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// The refusal; `invalid` if the answer is of the wrong type, which is a defect of the port.
    pub async fn ask<R: TypedRequest>(&self, request: R) -> Result<R::Answer, Refusal> {
        Self::answer_of::<R>(self.request(request.into()).await?)
    }

    /// The same on behalf of a client.
    ///
    /// # Errors
    /// As [`ask`](trait.Port.html#method.ask).
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
