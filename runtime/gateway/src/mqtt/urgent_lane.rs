//! The lane of urgent requests through the embedded broker: hold, stop, abort, the end of a jog and alarms.
//!
//! The broker recognizes an urgent request when it arrives, and passes it to the machine from the connection's own task. So it
//! shares no queue, no room and no rate with other messages, whatever its quality of service. Its replies have a subscription of
//! their own, and are published directly.

use std::future::poll_fn;
use std::sync::Arc;
use std::task::Poll;

use mqtt5::QoS;
use mqtt5::broker::router::MessageRouter;
use mqtt5::packet::publish::PublishPacket;
use plc_protocol::hub::{Filter, Subscription};
use plc_protocol::port::BoxFuture;
use plc_protocol::types::message::Message;
use plc_protocol::types::request::Refusal;
use plc_protocol::wire::mqtt::sender;
use plc_protocol::wire::row::ParsedRequest;
use tokio::time::Instant;
use tracing::warn;

use super::dispatch::{authorize, rejection};
use super::urgent_replies::{Reader, UrgentReplies};
use crate::access::Account;
use crate::arrivals::Arrivals;
use crate::machine::Machine;
use crate::metrics::Metrics;
use crate::publisher::Publisher;
use crate::urgent_slots::{ExecuteUrgent, UrgentKind, UrgentSlots};

/// Takes urgent requests from the embedded broker.
pub(crate) struct UrgentLane {
    machine: Machine,
    metrics: Arc<Metrics>,
    router: Arc<MessageRouter>,
    arrivals: Arc<Arrivals>,
    slots: UrgentSlots,
    replies: Arc<UrgentReplies>,
    /// Root of all topics, with its last slash.
    root: String,
}

impl std::fmt::Debug for UrgentLane {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("UrgentLane").finish_non_exhaustive()
    }
}

impl UrgentLane {
    pub(super) fn new(
        machine: Machine,
        metrics: Arc<Metrics>,
        (router, arrivals): (Arc<MessageRouter>, Arc<Arrivals>),
        replies: Arc<UrgentReplies>,
        root: String,
    ) -> Self {
        Self {
            machine,
            metrics,
            router,
            arrivals,
            slots: UrgentSlots::default(),
            replies,
            root,
        }
    }

    /// Passes an urgent request to the machine. Returns when the machine has it; the answer follows later. Waits only for an
    /// earlier request of the same account, kind and coordinate system, and up to 20 ms for commands to move that arrived before.
    async fn execute_urgent(self: Arc<Self>, publisher: Publisher, account: Account, parsed: ParsedRequest) {
        let Some((cs, kind)) = UrgentKind::of_request(parsed.request()) else {
            return;
        };
        self.metrics.mqtt_received.inc();
        let slot = self.slots.enter(account, (cs, kind)).await;
        let sent_by =
            sender(parsed.request()).map(|(cs, meta)| (cs, meta.client_id.clone(), meta.command_id.clone()));
        let authorized = match authorize(&self.machine, publisher, parsed).await {
            Ok(authorized) => authorized,
            Err(refusal) => {
                self.metrics.mqtt_refused.inc();
                if let Some((cs, client_id, command_id)) = sent_by {
                    let reply = rejection(&self.machine, cs, (client_id, command_id), refusal).await;
                    self.publish(&reply).await;
                } else {
                    warn!("MQTT request refused: {refusal}");
                }
                return;
            }
        };
        if kind.is_verb() {
            self.arrivals.keep_order(cs).await;
            self.arrivals.overtake(cs, self.arrivals.next());
        }
        if let Some((_, client_id, command_id)) = &sent_by {
            self.replies.await_replies(client_id, command_id);
        }
        let machine = self.machine.clone();
        let has_reply = sent_by.is_some();
        let asking = async move {
            let answered: Result<_, Refusal> = machine.execute_request(authorized).await;
            // the port itself replies to a command
            if let Err(refusal) = answered
                && !has_reply
            {
                warn!("MQTT request refused: {refusal}");
            }
            drop(slot);
        };
        let supervisor = self.machine.supervisor();
        let mut asking = Box::pin(supervisor.contained("urgent request over MQTT", asking));
        let begun = poll_fn(|context| Poll::Ready(asking.as_mut().poll(context))).await;
        if begun.is_pending() {
            tokio::spawn(asking); // with its supervisor
        }
    }

    /// Publishes the replies to urgent commands until the port closes.
    pub(super) async fn publish_replies(self: Arc<Self>, mut replies: Subscription) {
        while let Some(message) = replies.next().await {
            if self.replies.is_urgent(&message, Reader::Lane) {
                self.publish(&message).await;
            }
        }
    }

    /// Returns the subscription for [`UrgentLane::publish_replies`].
    pub(super) fn subscribe(&self) -> Subscription {
        self.machine.subscribe(Filter::Replies)
    }

    /// Publishes a message without waiting for slow subscribers.
    async fn publish(&self, message: &Message) {
        let topic = format!("{}{}", self.root, message.topic.path());
        let publish = PublishPacket::new(topic, message.to_json(), QoS::AtLeastOnce);
        self.metrics.mqtt_published.inc();
        self.router
            .route_message_with_deadline(&publish, None, Instant::now())
            .await;
    }
}

impl ExecuteUrgent for UrgentLane {
    fn execute(
        self: Arc<Self>,
        publisher: Publisher,
        account: Account,
        parsed: ParsedRequest,
    ) -> BoxFuture<'static, ()> {
        Box::pin(self.execute_urgent(publisher, account, parsed))
    }
}
