//! The order in which messages arrived: at the embedded broker, or over the connection to an external one.
//!
//! Hold, stop and abort overtake messages that have not reached the runtime yet. A command to move that arrived before
//! one of them must not take effect after it.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::command::Verb;
use plc_protocol::wire::message_sender::MessageSender;
use plc_protocol::wire::row::number;
use serde::Deserialize as _;
use serde::de::IntoDeserializer as _;
use serde::de::value::{Error as ValueError, StrDeserializer};
use tokio::sync::Notify;

/// User properties in which the embedded broker gives the number of a message in the order of arrival, and marks an
/// urgent request that it has passed to the machine. Those written by a client are removed.
pub(crate) const ARRIVAL: &str = "x-tandem-arrival";
pub(crate) const EXECUTED: &str = "x-tandem-executed";

/// Longest time that a hold, stop or abort waits for commands to move that arrived before it. Reason: the order of arrival is kept
/// unless a flood delays the commands, and 20 ms are far below the 250 ms within which a stop is accepted.
pub(crate) const ORDER_WAIT_MAX: Duration = Duration::from_millis(20);

/// Arrival numbers of one coordinate system.
#[derive(Debug, Default)]
struct Numbers {
    /// The newest command to move that has arrived.
    moving: AtomicU64,
    /// The newest command to move that the machine has received.
    received: AtomicU64,
    /// The newest hold, stop or abort.
    halting: AtomicU64,
}

/// Counts arrivals, and remembers the newest commands of each coordinate system.
#[derive(Debug)]
pub(crate) struct Arrivals {
    count: AtomicU64,
    systems: Box<[Numbers]>,
    on_received: Notify,
}

impl Default for Arrivals {
    fn default() -> Self {
        let systems = 0..=CoordinateSystemNumber::MAX;
        Self {
            count: AtomicU64::new(0),
            systems: systems.map(|_| Numbers::default()).collect(),
            on_received: Notify::new(),
        }
    }
}

impl Arrivals {
    /// Returns the number of a message that arrives now; larger than all before.
    pub(crate) fn next(&self) -> u64 {
        self.count.fetch_add(1, Ordering::SeqCst) + 1
    }

    /// Returns the number of a command to move a coordinate system, which arrives now.
    pub(crate) fn next_moving(&self, cs: CoordinateSystemNumber) -> u64 {
        let number = self.next();
        self.numbers(cs).moving.fetch_max(number, Ordering::SeqCst);
        number
    }

    /// Notes that the machine has received a command to move.
    pub(crate) fn receive(&self, cs: CoordinateSystemNumber, number: u64) {
        self.numbers(cs).received.fetch_max(number, Ordering::SeqCst);
        self.on_received.notify_waiters();
    }

    /// Waits for commands to move that have arrived, for at most [`ORDER_WAIT_MAX`].
    pub(crate) async fn keep_order(&self, cs: CoordinateSystemNumber) {
        let numbers = self.numbers(cs);
        let moving = numbers.moving.load(Ordering::SeqCst);
        let received = async {
            loop {
                let received = self.on_received.notified();
                if numbers.received.load(Ordering::SeqCst) >= moving {
                    return;
                }
                received.await;
            }
        };
        let _ = tokio::time::timeout(ORDER_WAIT_MAX, received).await;
    }

    /// Notes that a hold, stop or abort of a coordinate system overtakes all messages that arrived before this number.
    pub(crate) fn overtake(&self, cs: CoordinateSystemNumber, number: u64) {
        self.numbers(cs).halting.fetch_max(number, Ordering::SeqCst);
    }

    /// Returns true if a hold, stop or abort that arrived later has overtaken the message with this number.
    pub(crate) fn is_overtaken(&self, cs: CoordinateSystemNumber, number: u64) -> bool {
        number < self.numbers(cs).halting.load(Ordering::SeqCst)
    }

    fn numbers(&self, cs: CoordinateSystemNumber) -> &Numbers {
        &self.systems[usize::from(cs)]
    }
}

/// Returns the coordinate system and the verb of a command's path.
pub(crate) fn command_of(path: &str) -> Option<(CoordinateSystemNumber, Verb)> {
    let mut levels = path.rsplit('/');
    let verb: StrDeserializer<'_, ValueError> = levels.next()?.into_deserializer();
    let verb = Verb::deserialize(verb).ok()?;
    let is_command = levels.next()? == "command";
    let cs = number(levels.next()?)?;
    (is_command && levels.next()? == "cs").then_some((cs, verb))
}

/// Returns true for a path on which an urgent request may arrive; its payload decides.
pub(crate) fn may_be_urgent(path: &str) -> bool {
    let is_command = |(_, verb): (_, Verb)| verb.is_urgent() || verb == Verb::Jog;
    MessageSender::split(path).1 == "alarm/raise" || command_of(path).is_some_and(is_command)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_that_arrived_before_a_stop_of_their_system_are_overtaken() {
        let arrivals = Arrivals::default();
        let before = arrivals.next();
        assert!(!arrivals.is_overtaken(1, before));
        arrivals.overtake(1, arrivals.next());
        assert!(arrivals.is_overtaken(1, before));
        assert!(!arrivals.is_overtaken(2, before), "another coordinate system");
        assert!(!arrivals.is_overtaken(1, arrivals.next()), "it arrived later");
    }

    #[tokio::test(start_paused = true)]
    async fn a_stop_waits_20_ms_at_most_for_moves_that_arrived_before_it() {
        let arrivals = Arrivals::default();
        let begun = tokio::time::Instant::now();
        arrivals.keep_order(1).await;
        assert_eq!(begun.elapsed(), Duration::ZERO);
        let number = arrivals.next_moving(1);
        arrivals.keep_order(2).await;
        assert_eq!(begun.elapsed(), Duration::ZERO, "another coordinate system");
        arrivals.keep_order(1).await;
        assert_eq!(begun.elapsed(), ORDER_WAIT_MAX);
        let receiving = async {
            tokio::time::sleep(Duration::from_millis(5)).await;
            arrivals.receive(1, number);
        };
        tokio::join!(arrivals.keep_order(1), receiving);
        assert_eq!(begun.elapsed(), ORDER_WAIT_MAX + Duration::from_millis(5));
    }

    #[test]
    fn alarms_of_named_senders_may_be_urgent_as_others_are() {
        for (path, expected) in [
            ("alarm/raise", true),
            ("handler/clamp/alarm/raise", true),
            ("client/panel/alarm/raise", true),
            ("client/panel/cs/1/command/stop", true),
            ("handler/clamp/cs/1/command/abort", true),
            ("client/panel/cs/1/command/start", false),
            ("handler/clamp/presence", false),
            ("alarm/active", false),
        ] {
            assert_eq!(may_be_urgent(path), expected, "{path}");
        }
    }
}
