//! Positions are a stream: of each coordinate system the latest is sent, at an interval.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use plc_api::types::message::Message;
use plc_api::types::topic::{CsTopic, Topic};
use tokio::time::{Interval, MissedTickBehavior};

pub(crate) fn is_position(topic: &Topic) -> bool {
    matches!(topic, Topic::CoordinateSystem(_, CsTopic::Position))
}

/// Ticks with this time between them; a tick that is late holds up the next ones.
pub(crate) fn every(time: Duration) -> Interval {
    let mut interval = tokio::time::interval(time);
    interval.set_missed_tick_behavior(MissedTickBehavior::Delay);
    interval
}

/// The latest position of each coordinate system that has not been sent.
#[derive(Debug)]
pub(crate) struct Positions {
    waiting: BTreeMap<Topic, Arc<Message>>,
    interval: Interval,
}

impl Positions {
    pub(crate) fn new(interval: Duration) -> Self {
        Self {
            waiting: BTreeMap::new(),
            interval: every(interval),
        }
    }

    /// Keeps a position; gives back any other message.
    pub(crate) fn keep(&mut self, message: Arc<Message>) -> Option<Arc<Message>> {
        if is_position(&message.topic) {
            self.waiting.insert(message.topic.clone(), message);
            None
        } else {
            Some(message)
        }
    }

    /// Waits until positions are due. Safe to drop while it waits.
    pub(crate) async fn due(&mut self) -> Vec<Arc<Message>> {
        self.interval.tick().await;
        std::mem::take(&mut self.waiting).into_values().collect()
    }
}
