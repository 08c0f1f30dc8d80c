//! One connection, packet by packet: whole messages of its client, and whether the client keeps reading.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;

use axum::body::Bytes;
use mqtt5::packet::FixedHeader;
use mqtt5::packet::publish::PublishPacket;
use mqtt5::types::ReasonCode;
use parking_lot::Mutex;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// Bytes of the messages that are on their way to clients that are connected. When there are more, clients that take nothing
/// are closed, and messages of others wait for no room but are refused. What waits in the queues of sessions comes on top.
pub(super) const ON_THE_WAY_BYTES_MAX: usize = 64 * 1024 * 1024;

/// Bytes beside these that are kept for what passes every queue: hold, stop, abort, the end of a jog, and alarms.
const URGENT_BYTES_MAX: usize = 1024 * 1024;

/// Bytes of one such message. Reason: the names in it have at most 192 characters, and an alarm's text is short.
const URGENT_MESSAGE_MAX: usize = 4096;

/// A client to which something is on its way, and which has taken nothing for this long, is closed when there is no room.
const DEAF_AFTER: Duration = Duration::from_secs(1);

/// Kinds of packets, the first four bits.
const PUBLISH: u8 = 3;
const PUBACK: u8 = 4;
const PUBCOMP: u8 = 7;

/// What passes over one connection.
#[derive(Debug)]
pub(super) struct Line {
    passing: Mutex<Passing>,
    /// Cancelled when the broker ends the connection.
    pub(super) ended: CancellationToken,
    /// A DISCONNECT for a client of MQTT 5.
    farewell: Mutex<Vec<u8>>,
}

#[derive(Debug)]
struct Passing {
    /// Version of MQTT that the client speaks.
    version: u8,
    /// Fixed header of the packet that is being read.
    head: Vec<u8>,
    /// Bytes of it that are still to come.
    left: usize,
    is_publish: bool,
    /// The latest PUBLISH that has come, whole once nothing is left.
    publish: Vec<u8>,
    /// Messages of quality 1 and 2 that the client has not acknowledged, and when it last acknowledged one, or had none.
    unacknowledged: u32,
    acknowledged: Instant,
    /// Since when the client does not read what it is sent.
    stalled: Option<Instant>,
}

impl Line {
    pub(super) fn new() -> Self {
        Self {
            passing: Mutex::new(Passing {
                version: 0,
                head: Vec::new(),
                left: 0,
                is_publish: false,
                publish: Vec::new(),
                unacknowledged: 0,
                acknowledged: Instant::now(),
                stalled: None,
            }),
            ended: CancellationToken::new(),
            farewell: Mutex::default(),
        }
    }

    /// The client speaks this version of MQTT.
    pub(super) fn speaks(&self, version: u8) {
        self.passing.lock().version = version;
    }

    /// Notes bytes of the client up to the end of a packet, and returns how many these are: the library is given one packet at a
    /// time, so that the latest PUBLISH is the one of which it tells the guard.
    pub(super) fn read(&self, bytes: &[u8]) -> usize {
        let mut passing = self.passing.lock();
        let mut read = 0;
        while passing.left == 0 && read < bytes.len() {
            let byte = bytes[read];
            read += 1;
            passing.head.push(byte);
            let length = passing.head.len() - 1;
            // a fifth byte of the length is refused by the library
            if length == 0 || byte & 0x80 != 0 && length < 4 {
                continue;
            }
            passing.begin();
            if passing.left == 0 {
                return read;
            }
        }
        let body = passing.left.min(bytes.len() - read);
        let part = &bytes[read..read + body];
        passing.left -= body;
        if passing.is_publish {
            passing.publish.extend_from_slice(part);
        }
        read + body
    }

    /// The latest PUBLISH, which the library has just read. `None` where it is not one that it would have taken.
    pub(super) fn publish(&self) -> Option<PublishPacket> {
        let mut passing = self.passing.lock();
        let version = passing.version;
        let mut packet = Bytes::from(std::mem::take(&mut passing.publish));
        drop(passing);
        let head = FixedHeader::decode(&mut packet).ok()?;
        PublishPacket::decode_body_with_version(&mut packet, &head, version).ok()
    }

    /// A whole packet is being written to the client.
    pub(super) fn write(&self, packet: &[u8]) {
        let is_acknowledged = packet
            .first()
            .is_some_and(|first| first >> 4 == PUBLISH && first & 6 != 0);
        let mut passing = self.passing.lock();
        if is_acknowledged {
            if passing.unacknowledged == 0 {
                passing.acknowledged = Instant::now();
            }
            passing.unacknowledged += 1;
        }
    }

    /// Whether the client reads what is written.
    pub(super) fn stalled(&self, is_stalled: bool) {
        let stalled = &mut self.passing.lock().stalled;
        *stalled = is_stalled.then(|| stalled.unwrap_or_else(Instant::now));
    }

    /// Something is on its way to the client, and it has taken nothing for a while.
    fn is_deaf(&self) -> bool {
        let passing = self.passing.lock();
        let owes = (passing.unacknowledged > 0).then_some(passing.acknowledged);
        [passing.stalled, owes]
            .into_iter()
            .flatten()
            .any(|since| since.elapsed() >= DEAF_AFTER)
    }

    /// Ends the connection; a client of MQTT 5 receives the reason. The library sees the client go, so that its will is published.
    pub(super) fn end(&self, reason: Option<(ReasonCode, &str)>) {
        *self.farewell.lock() = reason.map(disconnect).unwrap_or_default();
        self.ended.cancel();
    }

    /// What is still to be written to the client, once.
    pub(super) fn farewell(&self) -> Vec<u8> {
        std::mem::take(&mut *self.farewell.lock())
    }
}

impl Passing {
    /// The header is whole.
    fn begin(&mut self) {
        let lengths = self.head[1..].iter().enumerate();
        self.left = lengths
            .map(|(place, byte)| usize::from(byte & 0x7f) << (7 * place))
            .sum();
        let kind = self.head[0] >> 4;
        self.is_publish = kind == PUBLISH;
        if self.is_publish {
            self.publish.clone_from(&self.head);
        }
        if kind == PUBACK || kind == PUBCOMP {
            self.unacknowledged = self.unacknowledged.saturating_sub(1);
            self.acknowledged = Instant::now();
        }
        self.head.clear();
    }
}

/// A DISCONNECT packet of MQTT 5 with a reason code and its text.
fn disconnect((code, text): (ReasonCode, &str)) -> Vec<u8> {
    const REASON_STRING: u8 = 0x1f;
    let bytes = u8::try_from(text.len().min(100)).unwrap_or_default();
    let head = [
        0xe0,
        bytes + 5,
        u8::from(code),
        bytes + 3,
        REASON_STRING,
        0,
        bytes,
    ];
    [&head, &text.as_bytes()[..usize::from(bytes)]].concat()
}

/// What is on its way to all clients that are connected.
#[derive(Debug, Default)]
pub(super) struct OnTheWay {
    bytes: Arc<AtomicUsize>,
    lines: Mutex<Vec<Weak<Line>>>,
}

/// A payload that counts until the last client has taken it.
struct Counted {
    payload: Bytes,
    bytes: Arc<AtomicUsize>,
}

impl AsRef<[u8]> for Counted {
    fn as_ref(&self) -> &[u8] {
        &self.payload
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        self.bytes.fetch_sub(self.payload.len(), Ordering::Relaxed);
    }
}

impl OnTheWay {
    pub(super) fn add(&self, line: &Arc<Line>) {
        let mut lines = self.lines.lock();
        lines.retain(|line| line.strong_count() > 0);
        lines.push(Arc::downgrade(line));
    }

    /// The payload as one that counts.
    pub(super) fn count(&self, payload: Bytes) -> Bytes {
        self.bytes.fetch_add(payload.len(), Ordering::Relaxed);
        let bytes = Arc::clone(&self.bytes);
        Bytes::from_owner(Counted { payload, bytes })
    }

    /// Whether there is room for so many bytes of a message that passes every queue.
    pub(super) fn has_room_for_urgent(&self, bytes: usize) -> bool {
        let bytes_max = ON_THE_WAY_BYTES_MAX + URGENT_BYTES_MAX;
        bytes <= URGENT_MESSAGE_MAX && self.bytes.load(Ordering::Relaxed) + bytes <= bytes_max
    }

    /// Whether there is room for so many bytes. Where there is none, clients that take nothing are closed.
    pub(super) fn has_room(&self, bytes: usize) -> bool {
        if self.bytes.load(Ordering::Relaxed) + bytes <= ON_THE_WAY_BYTES_MAX {
            return true;
        }
        for line in self.lines.lock().iter().filter_map(Weak::upgrade) {
            if line.is_deaf() && !line.ended.is_cancelled() {
                // it would not read a DISCONNECT
                line.end(None);
            }
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is read of these bytes, in pieces of this size: the ends of the packets.
    fn ends(line: &Line, bytes: &[u8], piece: usize) -> Vec<usize> {
        let (mut place, mut ends) = (0, Vec::new());
        while place < bytes.len() {
            let read = line.read(&bytes[place..bytes.len().min(place + piece)]);
            assert!(read > 0);
            place += read;
            let passing = line.passing.lock();
            if passing.left == 0 && passing.head.is_empty() {
                ends.push(place);
            }
        }
        ends
    }

    #[test]
    fn packets_pass_one_at_a_time_and_the_latest_publish_is_kept_whole() {
        let publish = [&[0x32, 0x87, 0x01, 0, 1, b'a', 0, 7][..], &[b'x'; 130]].concat();
        let all = [&[0xc0, 0][..], &publish, &[0x40, 2, 0, 7], &[0xc0, 0]].concat();
        for piece in [1, 2, 3, 64, 1000] {
            let line = Line::new();
            line.speaks(4);
            assert_eq!(ends(&line, &all, piece), [2, 140, 144, 146], "pieces of {piece}");
            let kept = line.publish().unwrap();
            assert_eq!((kept.topic_name.as_str(), kept.packet_id), ("a", Some(7)));
            assert_eq!(&kept.payload[..], [b'x'; 130]);
            assert!(line.publish().is_none(), "once");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_client_is_deaf_that_takes_nothing_while_something_is_on_its_way() {
        let line = Line::new();
        let pass = async || tokio::time::advance(DEAF_AFTER).await;
        pass().await;
        assert!(!line.is_deaf(), "nothing is on its way");
        line.write(&[0x32, 0]);
        assert!(!line.is_deaf());
        pass().await;
        assert!(line.is_deaf(), "it does not acknowledge");
        line.read(&[0x40, 2, 0, 7]);
        pass().await;
        assert!(!line.is_deaf());
        line.stalled(true);
        pass().await;
        assert!(line.is_deaf(), "it does not read");
        line.stalled(true);
        assert!(line.is_deaf(), "asked again");
        line.stalled(false);
        assert!(!line.is_deaf());
    }

    #[test]
    fn what_is_on_its_way_counts_until_the_last_one_has_taken_it() {
        let on_the_way = OnTheWay::default();
        let first = on_the_way.count(vec![0; ON_THE_WAY_BYTES_MAX - 10].into());
        let again = first.clone();
        assert!(on_the_way.has_room(10) && !on_the_way.has_room(11));
        drop(first);
        assert!(!on_the_way.has_room(11));
        let more = on_the_way.count(vec![0; 10].into());
        assert!(!on_the_way.has_room(1));
        assert!(on_the_way.has_room_for_urgent(URGENT_MESSAGE_MAX));
        assert!(!on_the_way.has_room_for_urgent(URGENT_MESSAGE_MAX + 1));
        let urgent = on_the_way.count(vec![0; URGENT_BYTES_MAX - 10].into());
        assert!(on_the_way.has_room_for_urgent(10) && !on_the_way.has_room_for_urgent(11));
        drop((again, more, urgent));
        assert!(on_the_way.has_room(ON_THE_WAY_BYTES_MAX));
    }
}
