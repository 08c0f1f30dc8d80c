//! The connection to the broker, with reconnection.

use std::time::{Duration, Instant};

use rumqttc::{
    AsyncClient, Event, EventLoop, LastWill, MqttOptions, Outgoing as Sent, Packet, Publish, QoS,
    SubscribeFilter,
};

use serde_json::json;

use crate::lock::lock;
use crate::types::handler::REFRESHES;
use crate::types::message::{Message, Payload};
use crate::types::output::HandlerPresence;
use crate::types::topic::{CsTopic, Topic};

use super::super::BROKER_SILENCE_MAX;
use super::super::backoff::Backoff;
use super::MqttClient;

/// Largest number of bytes of one packet, sent or received. Reason: this is many times the size of 64 open
/// outputs with long texts.
const PACKET_MAX: usize = 1 << 20;

/// Largest number of messages that wait in the client library; further messages wait in the outbox.
const LIBRARY_QUEUE: usize = 64;

const KEEP_ALIVE: Duration = Duration::from_secs(5);

/// Longest interval between two checks whether the presence of the machine has expired.
const WATCH: Duration = Duration::from_millis(100);

/// Topics of a machine to which the client subscribes, below the root of the machine, other than `reply`.
const FILTERS: [&str; 22] = [
    "presence",
    "birth",
    "heartbeat",
    "alarm/event",
    "alarm/active",
    "handler/+/presence",
    "handler/+/result",
    "io/+/+",
    "variables",
    "tools",
    "stored_data",
    "cs/+/+",
    "cs/+/m_code/pending",
    "cs/+/m_code/+/output",
    "cs/+/m_code/+/result",
    "cs/+/m_code/+/cancel",
    "cs/+/m_code/+/validate",
    "cs/+/input/+/state",
    "cs/+/spindle/state",
    "cs/+/tool/state",
    "cs/+/override/state",
    "cs/+/lease/state",
];

pub(super) async fn keep_connected(shared: std::sync::Arc<MqttClient>) {
    let mut backoff = Backoff::default();
    let nodes = &shared.address.nodes;
    let (mut node, mut failures) = (0, 0_usize);
    while !shared.link.is_closed() {
        let (client, mut events) = AsyncClient::new(options(&shared, &nodes[node]), LIBRARY_QUEUE);
        events.network_options.set_tcp_nodelay(true);
        {
            let mut state = lock(&shared.state);
            state.outbox.new_connection();
            state.silent_since = None;
        }
        let mut connected = false;
        tokio::select! {
            () = receive(&shared, &client, &mut events, &mut connected) => {}
            () = send(&shared, &client) => {}
            () = republish_presence(&shared) => {}
            () = watch_machine(&shared) => {}
            () = watch_broker(&shared) => {}
        }
        let must_reconnect = {
            let mut state = lock(&shared.state);
            state.connected = false;
            state.machine.pause();
            std::mem::take(&mut state.reconnect)
        };
        if connected {
            backoff.reset();
            failures = 0;
        }
        if must_reconnect {
            continue;
        }
        // tries one node after the other, and waits after each round and after each lost connection
        failures += 1;
        node = (node + 1) % nodes.len();
        if connected || failures.is_multiple_of(nodes.len()) {
            backoff.wait().await;
        }
    }
}

fn options(shared: &MqttClient, (host, port): &(String, u16)) -> MqttOptions {
    let address = &shared.address;
    let mut options = MqttOptions::new(shared.client_id.clone(), host.clone(), *port);
    options
        .set_transport(shared.transport.clone())
        .set_clean_session(true)
        .set_keep_alive(KEEP_ALIVE)
        .set_max_packet_size(PACKET_MAX, PACKET_MAX);
    if let Some((user, password)) = &address.credentials {
        options.set_credentials(user.clone(), password.clone());
    }
    if let Some((handler_id, instance)) = &lock(&shared.state).will {
        let topic = format!("{}/handler/{handler_id}/presence", address.root);
        let gone = json!(HandlerPresence::offline(instance.clone())).to_string();
        options.set_last_will(LastWill::new(topic, gone, QoS::AtLeastOnce, true));
    }
    options
}

async fn receive(shared: &MqttClient, client: &AsyncClient, events: &mut EventLoop, connected: &mut bool) {
    loop {
        match events.poll().await {
            Ok(Event::Incoming(Packet::ConnAck(_))) => {
                *connected = true;
                if let Err(error) = subscribe(shared, client) {
                    tracing::warn!(%error, "subscribing failed; connecting again");
                    return;
                }
                let mut state = lock(&shared.state);
                state.connected = true;
                state.connections += 1;
                state.machine.restart_age(Instant::now());
                state.trouble = None;
                drop(state);
                shared.link.wake.notify_one();
                shared.is_connected.notify_one();
                tracing::info!(address = %shared.link.address, "connected");
            }
            Ok(Event::Incoming(Packet::Publish(publish))) => {
                on_publish(shared, &publish);
            }
            Ok(Event::Incoming(Packet::PubAck(ack))) => {
                let mut state = lock(&shared.state);
                state.outbox.on_acknowledgement(ack.pkid);
                state.silent_since = state.outbox.awaits_acknowledgement().then(Instant::now);
                drop(state);
                // the library can accept more messages now
                shared.link.wake.notify_one();
            }
            Ok(Event::Outgoing(Sent::Publish(packet))) => {
                let mut state = lock(&shared.state);
                state.outbox.on_packet_id(packet);
                state.silent_since.get_or_insert_with(Instant::now);
                drop(state);
                shared.link.wake.notify_one();
            }
            Ok(Event::Outgoing(Sent::Subscribe(_))) => {
                let mut state = lock(&shared.state);
                state.silent_since.get_or_insert_with(Instant::now);
            }
            Ok(Event::Incoming(Packet::SubAck(_))) => {
                let mut state = lock(&shared.state);
                state.silent_since = state.outbox.awaits_acknowledgement().then(Instant::now);
            }
            Ok(Event::Outgoing(Sent::Disconnect)) => return,
            Ok(_) => {}
            Err(error) => {
                if *connected {
                    tracing::warn!(%error, address = %shared.link.address, "connection lost");
                }
                lock(&shared.state).trouble = Some(error.to_string());
                return;
            }
        }
    }
}

fn subscribe(shared: &MqttClient, client: &AsyncClient) -> Result<(), rumqttc::ClientError> {
    let root = &shared.address.root;
    let filters = FILTERS.iter().map(|filter| format!("{root}/{filter}"));
    let reply = format!("{root}/reply/{}", shared.client_id);
    let all = filters.chain([reply]);
    client.try_subscribe_many(all.map(|path| SubscribeFilter::new(path, QoS::AtLeastOnce)))
}

/// Passes the messages of the outbox to the library while a connection exists.
async fn send(shared: &MqttClient, client: &AsyncClient) {
    loop {
        shared.link.wake.notified().await;
        if lock(&shared.state).reconnect || shared.link.is_closed() {
            if client.try_disconnect().is_err() {
                return;
            }
            // `receive` ends once the disconnect has been sent
            std::future::pending::<()>().await;
        }
        let mut state = lock(&shared.state);
        if !state.connected {
            continue;
        }
        let root = &shared.address.root;
        state.outbox.send(|outgoing| {
            let path = format!("{root}/{}", outgoing.path);
            let payload = outgoing.payload.clone();
            client
                .try_publish(path, QoS::AtLeastOnce, outgoing.retain, payload)
                .is_ok()
        });
    }
}

/// Publishes the presence of the handler periodically, before it expires, and at once on a new connection.
async fn republish_presence(shared: &MqttClient) {
    let every = shared.presence_expires / REFRESHES;
    shared.is_connected.notified().await;
    loop {
        let begun = Instant::now();
        if let Some(end) = shared.refresh() {
            shared.link.wake.notify_one();
            if let Ok(Ok(Err(refusal))) = tokio::time::timeout(every, end).await {
                tracing::warn!(%refusal, "the machine did not accept the renewed presence of the handler");
            }
        }
        tokio::time::sleep(every.saturating_sub(begun.elapsed())).await;
    }
}

/// Returns when messages wait and the broker has acknowledged none of them for [`BROKER_SILENCE_MAX`].
async fn watch_broker(shared: &MqttClient) {
    loop {
        let since = lock(&shared.state).silent_since;
        let left = since.map_or(BROKER_SILENCE_MAX, |since| {
            BROKER_SILENCE_MAX.saturating_sub(since.elapsed())
        });
        if left.is_zero() {
            break;
        }
        tokio::time::sleep(left).await;
    }
    let text = format!(
        "the broker has acknowledged nothing for {} s",
        BROKER_SILENCE_MAX.as_secs()
    );
    tracing::warn!(address = %shared.link.address, "{text}: connecting again");
    lock(&shared.state).trouble = Some(text);
}

/// Marks the machine as offline when its presence has expired.
async fn watch_machine(shared: &MqttClient) {
    loop {
        let end = lock(&shared.state).machine.expires_at();
        let now = Instant::now();
        tokio::time::sleep(end.map_or(WATCH, |end| end.saturating_duration_since(now).min(WATCH))).await;
        if lock(&shared.state).machine.take_expiry(Instant::now()) {
            tracing::warn!(address = %shared.link.address, "the machine has not renewed its presence in time: it is treated as offline");
            shared.link.set_offline();
        }
    }
}

/// Passes a message to the hub and to the requests that wait for it.
fn on_publish(shared: &MqttClient, publish: &Publish) {
    let (path, payload) = (&*publish.topic, &*publish.payload);
    let Some(topic) = path
        .strip_prefix(&shared.address.root)
        .and_then(|path| path.strip_prefix('/'))
        .and_then(Topic::parse)
    else {
        return;
    };
    if payload.is_empty() {
        // an empty payload clears a retained value
        shared.link.hub.forget(&topic);
        return;
    }
    let message = match Message::from_json(topic, payload) {
        Ok(message) => message,
        Err(error) => {
            tracing::warn!(%error, path, "a message does not have the form of its topic");
            return;
        }
    };
    if let Payload::Presence(presence) = &message.payload {
        let mut state = lock(&shared.state);
        if state
            .machine
            .record_presence(presence, publish.retain, Instant::now())
        {
            // a separated part of a cluster may have lost messages meanwhile: connect again, read and publish
            // everything again
            state.reconnect = true;
            shared.link.wake.notify_one();
        }
    }
    shared.link.hub.publish(message.clone());
    let cs = match &message.topic {
        Topic::CoordinateSystem(cs, _) => *cs,
        _ => 0,
    };
    let pending = shared.link.hub.read(&Topic::cs(cs, CsTopic::Pending));
    let is_open = |seq| match pending.as_deref().map(|message| &message.payload) {
        Some(Payload::Pending(pending)) => pending.outputs.iter().any(|output| output.output.seq == seq),
        _ => false,
    };
    lock(&shared.state).outbox.on_message(&message, is_open);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::types::io::IoPoint;
    use crate::types::topic::{CsTopic, Topic};

    #[test]
    fn every_state_is_subscribed() {
        let of_the_machine = [
            Topic::Presence,
            Topic::Birth,
            Topic::Heartbeat,
            Topic::AlarmActive,
            Topic::HandlerPresence("clamp".to_owned()),
            Topic::Io(IoPoint::input("door")),
            Topic::Variables,
            Topic::Tools,
            Topic::StoredData,
        ];
        let states = CsTopic::STATES.map(|(topic, _)| Topic::cs(1, topic));
        for topic in states.into_iter().chain(of_the_machine) {
            assert!(topic.is_state());
            let path = topic.path();
            assert!(
                FILTERS.iter().any(|filter| rumqttc::matches(&path, filter)),
                "{path}"
            );
        }
    }
}
