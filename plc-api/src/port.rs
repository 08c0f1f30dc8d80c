//! The port: the whole sequence-control interface as one trait.
//!
//! The coordinator implements it, each client transport implements it, and each server end serves any of it. So a
//! sequence program runs unchanged inside the runtime's process, in another process and in a test.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use crate::hub::{Filter, Subscription};
use crate::types::BootId;
use crate::types::message::Message;
use crate::types::refusal::{Refusal, RefusalCode};
use crate::types::request::{Answer, Request, TypedRequest};
use crate::types::topic::Topic;

/// A boxed future, so that [`Port`] can stand behind a pointer.
pub type BoxFuture<'a, T> = Pin<Box<dyn Future<Output = T> + Send + 'a>>;

/// The sequence-control interface of one machine.
pub trait Port: Send + Sync + 'static {
    /// The boot that this port speaks for now.
    fn boot_id(&self) -> BootId;

    /// The value of a state topic now; for positions that of the last servo cycle. `None`: the topic has no value.
    fn read<'a>(&'a self, topic: &'a Topic) -> BoxFuture<'a, Option<Arc<Message>>>;

    /// What is said on the topics of the filter: first the value of each state topic now, then every change.
    fn subscribe(&self, filter: Filter) -> Subscription;

    /// Asks for something. A refusal means that nothing has changed. [`ask`](trait.Port.html#method.ask) gives the answer its type.
    fn request(&self, request: Request) -> BoxFuture<'_, Result<Answer, Refusal>>;

    /// Sleeps on the port's clock, which is simulated time in a simulation.
    fn sleep(&self, duration: Duration) -> BoxFuture<'_, ()>;

    /// Seconds since the start on the port's clock.
    fn now_s(&self) -> f64;
}

impl dyn Port {
    /// Asks for something, and gives the answer that belongs to it. A refusal means that nothing has changed.
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
    /// The refusal; `invalid` where the port answers something else than what was asked, which is a fault of the port.
    pub async fn ask<R: TypedRequest>(&self, request: R) -> Result<R::Answer, Refusal> {
        let answer = self.request(request.into()).await?;
        R::Answer::try_from(answer).map_err(|other| {
            let text = format!("the machine gave an answer of another kind: {other:?}");
            Refusal::new(RefusalCode::Invalid, text)
        })
    }
}
