//! Requests that come in while many messages wait for the broker.

use std::sync::atomic::AtomicUsize;

use rumqttc::{LastWill, Publish, QoS};

use super::*;
use crate::mqtt::{self, BrokerStamp, Connect, MqttEnd, Version, Wire};

/// Events that are queued when the broker becomes available.
const BACKLOG: usize = 1000;

/// A broker that accepts all messages, and delivers one command after the first message.
pub(super) struct Eager {
    published: Arc<AtomicUsize>,
    connects_at: Option<tokio::time::Instant>,
    delivered: bool,
}

/// How many messages such a broker has taken.
struct CountingConnector(Arc<AtomicUsize>);

impl Connect for CountingConnector {
    type Wire = Eager;

    fn open(&self, _: usize, _: &str, _: Option<LastWill>, _: Version) -> Eager {
        Eager {
            published: Arc::clone(&self.0),
            // simulated time passes when nothing else is to be done: the backlog waits by then
            connects_at: Some(tokio::time::Instant::now() + Duration::from_secs(1)),
            delivered: false,
        }
    }
}

impl Wire for Eager {
    async fn next(&mut self) -> Result<mqtt::Event, mqtt::ConnectionLoss> {
        if let Some(at) = self.connects_at {
            tokio::time::sleep_until(at).await;
            self.connects_at = None;
            return Ok(mqtt::Event::Connected { packet_max: 1 << 20 });
        }
        if self.delivered || self.published.load(Ordering::Relaxed) == 0 {
            std::future::pending::<()>().await;
        }
        self.delivered = true;
        let payload = r#"{"command_id":"c-1","client_id":"hmi"}"#;
        Ok(mqtt::Event::Published {
            publish: Publish::new("tandem/v1/mill-1/cs/1/command/stop", QoS::AtLeastOnce, payload),
            named: BrokerStamp::default(),
        })
    }

    fn subscribe(&self, _: impl Iterator<Item = String>) -> bool {
        true
    }

    fn publish(&self, _: String, _: u8, _: bool, _: String, _: Option<u32>) -> bool {
        self.published.fetch_add(1, Ordering::Relaxed);
        true
    }

    fn disconnect(&self) -> bool {
        true
    }
}

#[tokio::test(start_paused = true)]
async fn a_request_does_not_wait_for_a_backlog_of_events() {
    let published = Arc::new(AtomicUsize::new(0));
    let (before, at_request) = (Arc::clone(&published), Arc::new(AtomicUsize::new(0)));
    let seen = Arc::clone(&at_request);
    let port = StubPort::with(move |request| {
        if let Request::Command { meta, .. } = request {
            seen.store(before.load(Ordering::Relaxed), Ordering::Relaxed);
            return Ok(Answer::Command(reply(
                &meta.command_id,
                CommandStatus::Done,
                "ok",
            )));
        }
        Ok(Answer::Done)
    });
    let settings = GatewaySettings {
        machine: "mill-1".into(),
        ..GatewaySettings::default()
    };
    let end = MqttEnd::over(port.clone(), &settings, CountingConnector(Arc::clone(&published)));
    tokio::task::yield_now().await;
    for number in 0..BACKLOG {
        let reply = reply(&number.to_string(), CommandStatus::Done, "ok");
        port.say(Topic::Reply("hmi".into()), None, Payload::Reply(reply));
    }
    while at_request.load(Ordering::Relaxed) == 0 {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    // one round may be sent before the command arrives, and another while the five other sources have their turn
    let before = at_request.load(Ordering::Relaxed);
    assert!(
        before <= 64 * 6,
        "{before} of {BACKLOG} messages were sent before"
    );
    while published.load(Ordering::Relaxed) < BACKLOG {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    end.crash();
}
