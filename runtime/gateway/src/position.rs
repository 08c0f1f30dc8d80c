//! Positions are streamed: the latest one of each coordinate system is sent at an interval.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use plc_protocol::types::message::Message;
use plc_protocol::types::topic::{CsTopic, Topic};
use tokio::time::{Interval, MissedTickBehavior};

pub(crate) fn is_position(topic: &Topic) -> bool {
    matches!(topic, Topic::CoordinateSystem(_, CsTopic::Position))
}

/// Ticks at this interval; a late tick delays the next ones.
pub(crate) fn every(time: Duration) -> Interval {
    let mut interval = tokio::time::interval(time);
    interval.set_missed_tick_behavior(MissedTickBehavior::Delay);
    interval
}

/// The latest position of each coordinate system, if it has not been sent.
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

    /// Keeps a position; returns any other message.
    pub(crate) fn keep(&mut self, message: Arc<Message>) -> Option<Arc<Message>> {
        if is_position(&message.topic) {
            self.waiting.insert(message.topic.clone(), message);
            None
        } else {
            Some(message)
        }
    }

    /// Waits until positions are due. Cancel-safe.
    pub(crate) async fn due(&mut self) -> Vec<Arc<Message>> {
        self.interval.tick().await;
        std::mem::take(&mut self.waiting).into_values().collect()
    }
}
