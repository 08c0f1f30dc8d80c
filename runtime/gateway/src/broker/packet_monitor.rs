//! One connection, packet by packet: whole messages of its client, and whether the client keeps reading.

use std::collections::{BTreeSet, HashMap};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock, Weak};
use std::time::Duration;

use axum::body::Bytes;
use mqtt5::packet::FixedHeader;
use mqtt5::packet::publish::PublishPacket;
use mqtt5::types::ReasonCode;
use parking_lot::Mutex;
use plc_protocol::wire::PAYLOAD_MAX;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::{MQTT_5, PACKET_MAX, UNFINISHED_MAX};
use crate::access::Account;

/// Largest number of message bytes in transit to connected clients. Beyond it, clients that do not read are closed, and
/// messages of other clients are rejected, not delayed. Messages in session queues are not included.
pub(super) const IN_TRANSIT_BYTES_MAX: usize = 64 * 1024 * 1024;

/// Largest share of one user of the token file. Reason: one user leaves room for the messages of all others.
pub(super) const IN_TRANSIT_PER_USER_MAX: usize = IN_TRANSIT_BYTES_MAX / 4;

/// If there is no room, a client with messages in transit that has accepted nothing for this time is closed.
const UNRESPONSIVE_AFTER: Duration = Duration::from_secs(1);

/// Size limit of a CONNECT packet. Reason: the broker reads it before it knows the client. The will in it is a
/// presence, as large as any message of a client at most.
const CONNECT_BYTES_MAX: usize = PAYLOAD_MAX + 4096;

/// Maximum length of the topic of a message, bytes. Reason: the library stores up to 64 topics for each
/// client, as topic aliases of MQTT 5.
const TOPIC_BYTES_MAX: usize = 1024;

/// Size limit of a message without its payload: its topic and its properties. Reason: the broker copies them for each
/// subscriber.
pub(super) const HEAD_BYTES_MAX: usize = 4096;

/// Size limit of a PUBLISH packet of a user of the token file, who publishes requests to the machine only.
pub(super) const USER_PUBLISH_BYTES_MAX: usize = PAYLOAD_MAX + HEAD_BYTES_MAX;

/// Kinds of packets, the first four bits.
const CONNECT: u8 = 1;
const PUBLISH: u8 = 3;
const PUBACK: u8 = 4;
const PUBREL: u8 = 6;
const PUBCOMP: u8 = 7;

/// Packet state of one connection.
#[derive(Debug)]
pub(super) struct PacketMonitor {
    passing: Mutex<PacketState>,
    /// Cancelled when the broker ends the connection.
    pub(super) ended: CancellationToken,
    /// A DISCONNECT for a client of MQTT 5.
    farewell: Mutex<Vec<u8>>,
    client_id: OnceLock<Arc<str>>,
}

#[derive(Debug)]
struct PacketState {
    /// Version of MQTT that the client speaks.
    version: u8,
    /// Fixed header of the packet that is being read.
    head: Vec<u8>,
    /// Remaining bytes of this packet.
    left: usize,
    is_publish: bool,
    is_release: bool,
    /// The first packet has begun.
    has_begun: bool,
    /// Largest number of bytes of a PUBLISH packet after its fixed header.
    publish_max: usize,
    /// Packet id in the PUBREL packet received last.
    release: Vec<u8>,
    /// Packet ids of delivered messages of quality 2 that the client has not released.
    unreleased: UnreleasedIds,
    /// Bytes of the PUBLISH packet received last; the packet is complete if `left` is 0.
    publish: Vec<u8>,
    /// Number of bytes of the PUBLISH packet that was taken last.
    publish_bytes: usize,
    /// Why the broker reads no further from the client.
    refusal: Option<(ReasonCode, &'static str)>,
    /// Number of unacknowledged messages of quality 1 and 2; then when the client last acknowledged one, or had none.
    unacknowledged: u32,
    acknowledged: Instant,
    /// When the client stopped reading.
    stalled: Option<Instant>,
}

impl PacketMonitor {
    pub(super) fn new() -> Self {
        Self {
            passing: Mutex::new(PacketState {
                version: 0,
                head: Vec::new(),
                left: 0,
                is_publish: false,
                is_release: false,
                has_begun: false,
                publish_max: PACKET_MAX,
                release: Vec::new(),
                unreleased: UnreleasedIds::default(),
                publish: Vec::new(),
                publish_bytes: 0,
                refusal: None,
                unacknowledged: 0,
                acknowledged: Instant::now(),
                stalled: None,
            }),
            ended: CancellationToken::new(),
            farewell: Mutex::default(),
            client_id: OnceLock::new(),
        }
    }

    /// Records the client's version of MQTT.
    pub(super) fn set_version(&self, version: u8) {
        self.passing.lock().version = version;
    }

    /// Limits the size of the PUBLISH packets that follow.
    pub(super) fn set_publish_max(&self, bytes: usize) {
        self.passing.lock().publish_max = bytes;
    }

    /// Continues a session, in which these messages are not released yet.
    pub(super) fn resume(&self, unreleased: UnreleasedIds) {
        self.passing.lock().unreleased = unreleased;
    }

    /// Returns the messages of quality 2 that are not released.
    pub(super) fn unreleased(&self) -> UnreleasedIds {
        self.passing.lock().unreleased.clone()
    }

    /// Records the id of the connected client.
    pub(super) fn set_client_id(&self, client_id: Arc<str>) {
        // a client connects once
        let _ = self.client_id.set(client_id);
    }

    /// Returns the id of the client, if it was connected.
    pub(super) fn client_id(&self) -> Option<Arc<str>> {
        self.client_id.get().cloned()
    }

    /// Records received bytes up to the end of a packet and returns their number. The library is given one packet at a
    /// time, so that the latest PUBLISH is the one that it passes to the guard.
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
            passing.start_packet();
            if passing.left == 0 {
                return read;
            }
        }
        let body = passing.left.min(bytes.len() - read);
        let part = &bytes[read..read + body];
        passing.left -= body;
        if passing.is_release {
            let missing = 2 - passing.release.len().min(2);
            passing.release.extend(part.iter().take(missing));
            if let [high, low] = passing.release[..] {
                passing.unreleased.release(u16::from_be_bytes([high, low]));
            }
        }
        if passing.is_publish {
            passing.publish.extend_from_slice(part);
            if topic_bytes(&passing.publish).is_some_and(|bytes| bytes > TOPIC_BYTES_MAX) {
                passing.refusal = Some((ReasonCode::TopicNameInvalid, "a topic has more than 1024 bytes"));
            }
        }
        read + body
    }

    /// Ends the connection if its client has sent a packet beyond a limit, and then returns `true`.
    pub(super) fn end_if_refused(&self) -> bool {
        let passing = self.passing.lock();
        let Some(refusal) = passing.refusal else {
            return false;
        };
        let is_told = passing.version == MQTT_5;
        drop(passing);
        self.close_connection(is_told.then_some(refusal));
        true
    }

    /// Returns the latest PUBLISH, which the library has just read. `None` if the library would have rejected it.
    pub(super) fn publish(&self) -> Option<PublishPacket> {
        let mut passing = self.passing.lock();
        let version = passing.version;
        let mut packet = Bytes::from(std::mem::take(&mut passing.publish));
        passing.publish_bytes = packet.len();
        drop(passing);
        let head = FixedHeader::decode(&mut packet).ok()?;
        PublishPacket::decode_body_with_version(&mut packet, &head, version).ok()
    }

    /// Returns the number of bytes of the PUBLISH returned last without its payload.
    pub(super) fn head_bytes(&self, publish: &PublishPacket) -> usize {
        let passing = self.passing.lock();
        passing.publish_bytes.saturating_sub(publish.payload.len())
    }

    /// Records a complete packet written to the client.
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

    /// Records whether the client has stopped reading.
    pub(super) fn set_stalled(&self, is_stalled: bool) {
        let stalled = &mut self.passing.lock().stalled;
        *stalled = is_stalled.then(|| stalled.unwrap_or_else(Instant::now));
    }

    /// Returns true if messages are in transit to the client and it has accepted nothing for `UNRESPONSIVE_AFTER`.
    fn is_unresponsive(&self) -> bool {
        let passing = self.passing.lock();
        let owes = (passing.unacknowledged > 0).then_some(passing.acknowledged);
        [passing.stalled, owes]
            .into_iter()
            .flatten()
            .any(|since| since.elapsed() >= UNRESPONSIVE_AFTER)
    }

    /// Ends the connection; a client of MQTT 5 receives the reason. To the library the client disconnects, so its will
    /// is published.
    pub(super) fn close_connection(&self, reason: Option<(ReasonCode, &str)>) {
        *self.farewell.lock() = reason.map(disconnect).unwrap_or_default();
        self.ended.cancel();
    }

    /// Takes the bytes that remain to be written to the client.
    pub(super) fn farewell(&self) -> Vec<u8> {
        std::mem::take(&mut *self.farewell.lock())
    }
}

impl PacketState {
    /// Starts a packet, after its header is complete.
    fn start_packet(&mut self) {
        let lengths = self.head[1..].iter().enumerate();
        self.left = lengths
            .map(|(place, byte)| usize::from(byte & 0x7f) << (7 * place))
            .sum();
        let kind = self.head[0] >> 4;
        if kind == CONNECT && self.left > CONNECT_BYTES_MAX {
            self.refusal = Some((ReasonCode::PacketTooLarge, "the CONNECT packet is too large"));
        }
        if !self.has_begun && kind != CONNECT {
            self.refusal = Some((ReasonCode::ProtocolError, "the first packet must be CONNECT"));
        }
        self.has_begun = true;
        if kind == PUBLISH && self.left > self.publish_max {
            self.refusal = Some((ReasonCode::PacketTooLarge, "a PUBLISH packet is too large"));
        }
        self.is_release = kind == PUBREL;
        self.release.clear();
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

/// Returns the topic length of a partly received PUBLISH packet, or `None` until it is known.
fn topic_bytes(publish: &[u8]) -> Option<usize> {
    let lengths = publish.iter().skip(1).take(4);
    let header = 2 + lengths.take_while(|byte| **byte & 0x80 != 0).count();
    let length = publish.get(header..header + 2)?.try_into().ok()?;
    Some(u16::from_be_bytes(length).into())
}

/// Returns a DISCONNECT packet of MQTT 5 with a reason code and its text.
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

/// Packet ids of messages of quality 2 that were delivered, and that their client has not released. A message is
/// delivered when it arrives, so that no message waits in memory for its client. Repetitions have the same id.
#[derive(Debug, Clone, Default)]
pub(super) struct UnreleasedIds(Arc<Mutex<BTreeSet<u16>>>);

/// Delivery of a message of quality 2.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum ExactlyOnce {
    /// The message must be delivered.
    New,
    /// The message was delivered already.
    Repeated,
    /// The session has [`UNFINISHED_MAX`] unreleased messages.
    Full,
}

impl UnreleasedIds {
    /// Records the delivery of a message.
    pub(super) fn deliver(&self, packet_id: u16) -> ExactlyOnce {
        let mut ids = self.0.lock();
        if ids.contains(&packet_id) {
            ExactlyOnce::Repeated
        } else if ids.len() >= usize::from(UNFINISHED_MAX) {
            ExactlyOnce::Full
        } else {
            ids.insert(packet_id);
            ExactlyOnce::New
        }
    }

    fn release(&self, packet_id: u16) {
        self.0.lock().remove(&packet_id);
    }
}

/// Messages in transit to all connected clients.
#[derive(Debug, Default)]
pub(super) struct MessagesInTransit {
    bytes: Arc<AtomicUsize>,
    /// Bytes by the account of the publisher.
    by_account: Mutex<HashMap<Account, Arc<AtomicUsize>>>,
    lines: Mutex<Vec<Weak<PacketMonitor>>>,
}

/// Payload that is in transit until the last client has received it.
struct CountedPayload {
    payload: Bytes,
    /// Number of bytes of the whole message.
    size: usize,
    bytes: Arc<AtomicUsize>,
    of_account: Option<Arc<AtomicUsize>>,
}

impl AsRef<[u8]> for CountedPayload {
    fn as_ref(&self) -> &[u8] {
        &self.payload
    }
}

impl Drop for CountedPayload {
    fn drop(&mut self) {
        self.bytes.fetch_sub(self.size, Ordering::Relaxed);
        if let Some(bytes) = &self.of_account {
            bytes.fetch_sub(self.size, Ordering::Relaxed);
        }
    }
}

impl MessagesInTransit {
    pub(super) fn add(&self, line: &Arc<PacketMonitor>) {
        let mut lines = self.lines.lock();
        lines.retain(|line| line.strong_count() > 0);
        lines.push(Arc::downgrade(line));
    }

    /// Wraps the payload so that its bytes are counted.
    pub(super) fn count(&self, payload: Bytes) -> Bytes {
        self.count_message(payload, 0, None)
    }

    /// Wraps the payload so that the bytes of its whole message are counted, also for its account.
    pub(super) fn count_message(&self, payload: Bytes, head: usize, account: Option<&Account>) -> Bytes {
        let size = payload.len() + head;
        self.bytes.fetch_add(size, Ordering::Relaxed);
        let of_account = account.filter(|account| matches!(account, Account::User(_)));
        let of_account = of_account.map(|account| self.bytes_of(account));
        if let Some(bytes) = &of_account {
            bytes.fetch_add(size, Ordering::Relaxed);
        }
        let bytes = Arc::clone(&self.bytes);
        Bytes::from_owner(CountedPayload {
            payload,
            size,
            bytes,
            of_account,
        })
    }

    /// Returns the number of bytes in transit of an account.
    fn bytes_of(&self, account: &Account) -> Arc<AtomicUsize> {
        let mut by_account = self.by_account.lock();
        by_account.retain(|_, bytes| Arc::strong_count(bytes) > 1);
        Arc::clone(by_account.entry(account.clone()).or_default())
    }

    /// Returns true if there is room for this number of bytes of an account, as [`has_room`](Self::has_room) does.
    pub(super) fn has_room_for(&self, account: &Account, bytes: usize) -> bool {
        let is_in_share = self
            .by_account
            .lock()
            .get(account)
            .is_none_or(|used| used.load(Ordering::Relaxed) + bytes <= IN_TRANSIT_PER_USER_MAX);
        if !is_in_share {
            self.close_unresponsive();
        }
        is_in_share && self.has_room(bytes)
    }

    /// Returns true if there is room for this number of bytes. If there is none, clients that do not read are closed.
    pub(super) fn has_room(&self, bytes: usize) -> bool {
        let has_room = self.bytes.load(Ordering::Relaxed) + bytes <= IN_TRANSIT_BYTES_MAX;
        if !has_room {
            self.close_unresponsive();
        }
        has_room
    }

    fn close_unresponsive(&self) {
        for line in self.lines.lock().iter().filter_map(Weak::upgrade) {
            if line.is_unresponsive() && !line.ended.is_cancelled() {
                // a client that does not read would not receive a DISCONNECT
                line.close_connection(None);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reads the bytes in pieces of this size and returns the ends of the packets.
    fn ends(line: &PacketMonitor, bytes: &[u8], piece: usize) -> Vec<usize> {
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

    /// Returns a connection whose client has sent its CONNECT packet.
    fn begun() -> PacketMonitor {
        let line = PacketMonitor::new();
        assert_eq!(line.read(&[0x10, 0]), 2);
        line
    }

    #[test]
    fn packet_before_connect_is_refused_at_its_header() {
        for kind in [0x30, 0x32, 0x62, 0x82, 0xc0, 0xe0] {
            let line = PacketMonitor::new();
            line.read(&[kind, 0xff, 0xff, 0x3f]);
            assert!(line.end_if_refused(), "{kind:#x}");
        }
        assert!(!begun().end_if_refused());
    }

    #[test]
    fn publish_beyond_the_limit_of_a_user_is_refused_at_its_header() {
        let line = begun();
        line.read(&[0x30, 0x80, 0x80, 0x08]);
        assert!(!line.end_if_refused(), "128 KiB without users");
        let line = begun();
        line.set_publish_max(USER_PUBLISH_BYTES_MAX);
        line.read(&[0x30, 0x80, 0x80, 0x08]);
        assert!(line.end_if_refused());
    }

    #[test]
    fn message_of_quality_2_is_new_once_until_its_release() {
        let line = begun();
        let ids = line.unreleased();
        assert_eq!(ids.deliver(7), ExactlyOnce::New);
        assert_eq!(ids.deliver(7), ExactlyOnce::Repeated);
        for piece in [1, 2, 4] {
            ends(&line, &[0x62, 2, 0, 8], piece);
            assert_eq!(ids.deliver(7), ExactlyOnce::Repeated);
            ends(&line, &[0x62, 2, 0, 7], piece);
            assert_eq!(ids.deliver(7), ExactlyOnce::New, "{piece}");
        }
        for id in 8..7 + UNFINISHED_MAX {
            assert_eq!(ids.deliver(id), ExactlyOnce::New);
        }
        assert_eq!(ids.deliver(9999), ExactlyOnce::Full);
    }

    #[test]
    fn share_of_one_user_leaves_room_for_the_messages_of_others() {
        let in_transit = MessagesInTransit::default();
        let account = |name: &str| Account::User(name.to_owned());
        let (view, operate) = (account("view"), account("operate"));
        let head = 4096;
        let payload = Bytes::from(vec![0; IN_TRANSIT_PER_USER_MAX - head]);
        assert!(in_transit.has_room_for(&view, IN_TRANSIT_PER_USER_MAX));
        let held = in_transit.count_message(payload, head, Some(&view));
        assert!(!in_transit.has_room_for(&view, 1));
        assert!(in_transit.has_room_for(&operate, IN_TRANSIT_PER_USER_MAX));
        drop(held);
        assert!(in_transit.has_room_for(&view, IN_TRANSIT_PER_USER_MAX));
        assert!(in_transit.has_room(IN_TRANSIT_BYTES_MAX), "all was released");
    }

    #[test]
    fn packets_pass_one_at_a_time_and_the_latest_publish_is_kept_whole() {
        let publish = [&[0x32, 0x87, 0x01, 0, 1, b'a', 0, 7][..], &[b'x'; 130]].concat();
        let all = [&[0xc0, 0][..], &publish, &[0x40, 2, 0, 7], &[0xc0, 0]].concat();
        for piece in [1, 2, 3, 64, 1000] {
            let line = begun();
            line.set_version(4);
            assert_eq!(ends(&line, &all, piece), [2, 140, 144, 146], "pieces of {piece}");
            let kept = line.publish().unwrap();
            assert_eq!((kept.topic_name.as_str(), kept.packet_id), ("a", Some(7)));
            assert_eq!(&kept.payload[..], [b'x'; 130]);
            assert!(line.publish().is_none(), "once");
        }
    }

    #[test]
    fn connects_and_topics_beyond_their_limits_end_the_connection() {
        let connect = |bytes: usize| crate::tests::packet(0x10, &[&vec![b'x'; bytes]]);
        let publish = |topic: usize| {
            let length = u16::try_from(topic).unwrap().to_be_bytes();
            crate::tests::packet(0x30, &[&length, &vec![b'a'; topic], b"payload"])
        };
        for (bytes, is_refused) in [
            (connect(CONNECT_BYTES_MAX), false),
            (connect(CONNECT_BYTES_MAX + 1), true),
            (publish(TOPIC_BYTES_MAX), false),
            (publish(TOPIC_BYTES_MAX + 1), true),
        ] {
            for piece in [1, 7, 4096] {
                let line = if bytes[0] == 0x10 {
                    PacketMonitor::new()
                } else {
                    begun()
                };
                line.set_version(MQTT_5);
                ends(&line, &bytes, piece);
                assert_eq!(line.end_if_refused(), is_refused, "{} bytes", bytes.len());
                assert_eq!(line.ended.is_cancelled(), is_refused);
                assert_eq!(line.farewell().is_empty(), !is_refused);
            }
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_client_is_deaf_that_takes_nothing_while_something_is_on_its_way() {
        let line = PacketMonitor::new();
        let pass = async || tokio::time::advance(UNRESPONSIVE_AFTER).await;
        pass().await;
        assert!(!line.is_unresponsive(), "nothing is in transit");
        line.write(&[0x32, 0]);
        assert!(!line.is_unresponsive());
        pass().await;
        assert!(line.is_unresponsive(), "it does not acknowledge");
        line.read(&[0x40, 2, 0, 7]);
        pass().await;
        assert!(!line.is_unresponsive());
        line.set_stalled(true);
        pass().await;
        assert!(line.is_unresponsive(), "it does not read");
        line.set_stalled(true);
        assert!(line.is_unresponsive(), "asked again");
        line.set_stalled(false);
        assert!(!line.is_unresponsive());
    }

    #[test]
    fn what_is_on_its_way_counts_until_the_last_one_has_taken_it() {
        let on_the_way = MessagesInTransit::default();
        let first = on_the_way.count(vec![0; IN_TRANSIT_BYTES_MAX - 10].into());
        let again = first.clone();
        assert!(on_the_way.has_room(10) && !on_the_way.has_room(11));
        drop(first);
        assert!(!on_the_way.has_room(11));
        let more = on_the_way.count(vec![0; 10].into());
        assert!(!on_the_way.has_room(1));
        drop((again, more));
        assert!(on_the_way.has_room(IN_TRANSIT_BYTES_MAX));
    }
}
