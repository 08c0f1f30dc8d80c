//! A port that adds an age limit to requests.

use std::sync::Arc;
use std::time::Duration;

use plc_protocol::hub::{Filter, Subscription};
use plc_protocol::port::{BoxFuture, Port};
use plc_protocol::types::BootId;
use plc_protocol::types::message::Message;
use plc_protocol::types::not_after::NotAfter;
use plc_protocol::types::request::{Answer, Refusal, Request};
use plc_protocol::types::topic::Topic;

/// A port that sends every request with one and the same age limit.
pub(crate) struct LimitedPort {
    pub port: Arc<dyn Port>,
    pub not_after: NotAfter,
}

impl Port for LimitedPort {
    fn boot_id(&self) -> BootId {
        self.port.boot_id()
    }

    fn read<'a>(&'a self, topic: &'a Topic) -> BoxFuture<'a, Option<Arc<Message>>> {
        self.port.read(topic)
    }

    fn subscribe(&self, filter: Filter) -> Subscription {
        self.port.subscribe(filter)
    }

    fn request(&self, request: Request) -> BoxFuture<'_, Result<Answer, Refusal>> {
        self.port.request_not_after(&self.not_after, None, request)
    }

    fn request_as<'a>(&'a self, client: &'a str, request: Request) -> BoxFuture<'a, Result<Answer, Refusal>> {
        self.port
            .request_not_after(&self.not_after, Some(client), request)
    }

    fn sleep(&self, duration: Duration) -> BoxFuture<'_, ()> {
        self.port.sleep(duration)
    }

    fn now_s(&self) -> f64 {
        self.port.now_s()
    }
}
