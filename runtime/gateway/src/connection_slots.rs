//! Connection slots: their number, and which connection is evicted when none is free.
//!
//! A connection is a stranger until its client is authenticated. A new connection first evicts strangers: the oldest
//! one of the host with the most strangers. If there are none, it evicts idle connections of known clients. So hosts
//! without a token cannot block the server, and a new connection always has a slot in which to show its token.

use std::collections::HashMap;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use parking_lot::Mutex;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// Limits of open connections.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct SlotLimits {
    /// All connections.
    pub(crate) all: usize,
    /// Connections of one host. Reason: one host must not take all slots. The loopback may.
    pub(crate) of_one: usize,
    /// Connections of strangers.
    pub(crate) unauthenticated: usize,
    /// Connections of known clients: fewer than all, so that slots for strangers remain.
    pub(crate) known: usize,
}

impl SlotLimits {
    /// Scales the limits to the available files, relative to those that all listeners want, but never below eight
    /// connections.
    pub(crate) fn scaled(self, files: u64, wanted: u64) -> Self {
        let files = usize::try_from(files.min(wanted)).unwrap_or(usize::MAX);
        let wanted = usize::try_from(wanted).unwrap_or(usize::MAX).max(1);
        let scale = |count: usize, least: usize| (count * files / wanted).max(least);
        Self {
            all: scale(self.all, 8),
            of_one: scale(self.of_one, 4),
            unauthenticated: scale(self.unauthenticated, 6),
            known: scale(self.known, 6),
        }
    }
}

/// Returns the host of an address. One host can use any number of IPv6 addresses, all with the same first 64 bits.
pub(crate) fn host_of(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(v6) if !v6.is_loopback() => Ipv6Addr::from_bits(v6.to_bits() >> 64 << 64).into(),
        other => other,
    }
}

/// Connection slots of one listener.
#[derive(Debug)]
pub(crate) struct ConnectionSlots {
    limits: SlotLimits,
    begun: Instant,
    table: Mutex<SlotTable>,
}

#[derive(Debug, Default)]
struct SlotTable {
    /// Number of the latest connection.
    latest: u64,
    open: HashMap<u64, OpenConnection>,
}

#[derive(Debug)]
struct OpenConnection {
    host: IpAddr,
    is_known: bool,
    /// Pending requests of the connection.
    busy: u32,
    /// When bytes were last transferred, in ms since the start of the listener.
    moved_ms: Arc<AtomicU64>,
    leave: CancellationToken,
}

/// Connection slot; it becomes free when this is dropped.
#[derive(Debug)]
pub(crate) struct ConnectionSlot {
    number: u64,
    slots: Arc<ConnectionSlots>,
    moved_ms: Arc<AtomicU64>,
    leave: CancellationToken,
}

/// Pending request of a connection, which is not evicted meanwhile.
#[derive(Debug)]
pub(crate) struct PendingUse(Arc<ConnectionSlot>);

impl ConnectionSlots {
    pub(crate) fn new(limits: SlotLimits) -> Arc<Self> {
        Arc::new(Self {
            limits,
            begun: Instant::now(),
            table: Mutex::default(),
        })
    }

    /// Takes a slot for a new connection, if necessary by eviction. Returns `None` if its host can have none.
    pub(crate) fn acquire_slot(self: &Arc<Self>, address: IpAddr) -> Option<ConnectionSlot> {
        let host = host_of(address);
        let (moved_ms, leave) = (Arc::new(AtomicU64::new(self.now_ms())), CancellationToken::new());
        let mut table = self.table.lock();
        let of_host = |open: &OpenConnection| open.host == host;
        if !host.is_loopback() && table.count(of_host) >= self.limits.of_one && !table.evict_one(of_host) {
            return None;
        }
        let is_stranger = |open: &OpenConnection| !open.is_known;
        let is_full =
            table.open.len() >= self.limits.all || table.count(is_stranger) >= self.limits.unauthenticated;
        if is_full && !table.evict_one(is_stranger) {
            return None;
        }
        table.latest += 1;
        let number = table.latest;
        let open = OpenConnection {
            host,
            is_known: false,
            busy: 0,
            moved_ms: Arc::clone(&moved_ms),
            leave: leave.clone(),
        };
        table.open.insert(number, open);
        Some(ConnectionSlot {
            number,
            slots: Arc::clone(self),
            moved_ms,
            leave,
        })
    }

    fn now_ms(&self) -> u64 {
        u64::try_from(self.begun.elapsed().as_millis()).unwrap_or(u64::MAX)
    }
}

impl SlotTable {
    fn count(&self, fits: impl Fn(&OpenConnection) -> bool) -> usize {
        self.open.values().filter(|open| fits(open)).count()
    }

    /// Evicts one of the connections that `fits` accepts. Returns `false` if none may be evicted.
    fn evict_one(&mut self, fits: impl Fn(&OpenConnection) -> bool) -> bool {
        let mut strangers: HashMap<IpAddr, usize> = HashMap::new();
        for open in self.open.values().filter(|open| !open.is_known) {
            *strangers.entry(open.host).or_default() += 1;
        }
        let may_go = |(_, open): &(&u64, &OpenConnection)| open.busy == 0 && fits(open);
        let chosen = self.open.iter().filter(may_go).min_by_key(|(number, open)| {
            if open.is_known {
                (true, 0, open.moved_ms.load(Ordering::Relaxed), **number)
            } else {
                let of_host = strangers.get(&open.host).copied().unwrap_or(0);
                (false, usize::MAX - of_host, 0, **number)
            }
        });
        let Some(number) = chosen.map(|(number, _)| *number) else {
            return false;
        };
        if let Some(open) = self.open.remove(&number) {
            open.leave.cancel();
        }
        true
    }
}

impl ConnectionSlot {
    /// Marks the client as authenticated. Returns `false` if the slots of known clients are used up, so that it stays a
    /// stranger, and if it was evicted.
    ///
    /// `reserved` slots of known clients are kept for other clients.
    pub(crate) fn mark_known(&self, reserved: usize) -> bool {
        let mut table = self.slots.table.lock();
        match table.open.get(&self.number) {
            None => return false,
            Some(open) if open.is_known => return true,
            Some(_) => {}
        }
        let is_known = |open: &OpenConnection| open.is_known;
        let reserved = reserved.min(self.slots.limits.known / 2);
        let is_full = table.count(is_known) + reserved >= self.slots.limits.known;
        if is_full && !table.evict_one(is_known) {
            return false;
        }
        if let Some(open) = table.open.get_mut(&self.number) {
            open.is_known = true;
        }
        true
    }

    /// Returns true if the client is authenticated.
    pub(crate) fn is_known(&self) -> bool {
        let table = self.slots.table.lock();
        table.open.get(&self.number).is_some_and(|open| open.is_known)
    }

    /// Protects the connection from eviction while the result exists. Returns `None` if it was already evicted.
    pub(crate) fn protect_while_pending(self: &Arc<Self>) -> Option<PendingUse> {
        let mut table = self.slots.table.lock();
        table.open.get_mut(&self.number)?.busy += 1;
        Some(PendingUse(Arc::clone(self)))
    }

    /// Protects the connection from eviction permanently.
    pub(crate) fn protect_permanently(&self) {
        if let Some(open) = self.slots.table.lock().open.get_mut(&self.number) {
            open.busy += 1;
        }
    }

    /// Records that bytes were transferred.
    pub(crate) fn record_transfer(&self) {
        self.moved_ms.store(self.slots.now_ms(), Ordering::Relaxed);
    }

    /// Returns the limit of known connections.
    pub(crate) fn known_max(&self) -> usize {
        self.slots.limits.known
    }

    /// Returns the token that is cancelled when the connection is evicted.
    pub(crate) fn eviction_token(&self) -> CancellationToken {
        self.leave.clone()
    }
}

impl Drop for ConnectionSlot {
    fn drop(&mut self) {
        self.slots.table.lock().open.remove(&self.number);
    }
}

impl Drop for PendingUse {
    fn drop(&mut self) {
        self.0.record_transfer();
        if let Some(open) = self.0.slots.table.lock().open.get_mut(&self.0.number) {
            open.busy -= 1;
        }
    }
}

/// Delay before a listener accepts again after the system had no file descriptor for it.
pub(crate) const ACCEPT_RETRY: Duration = Duration::from_millis(100);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::server::{RESERVED, SLOT_LIMITS};

    impl ConnectionSlots {
        /// Returns the numbers of open connections and of known ones.
        pub(crate) fn counts(&self) -> (usize, usize) {
            let table = self.table.lock();
            (table.open.len(), table.count(|open| open.is_known))
        }
    }

    const LIMITS: SlotLimits = SlotLimits {
        all: 8,
        of_one: 4,
        unauthenticated: 6,
        known: 6,
    };

    fn host(last: u8) -> IpAddr {
        [10, 0, 0, last].into()
    }

    fn evicted(places: &[ConnectionSlot]) -> Vec<usize> {
        let gone = places.iter().enumerate();
        gone.filter(|(_, place)| place.leave.is_cancelled())
            .map(|(n, _)| n)
            .collect()
    }

    #[tokio::test]
    async fn strangers_give_way_and_those_of_the_host_with_the_most_first() {
        let places = ConnectionSlots::new(LIMITS);
        let other = places.acquire_slot(host(1)).unwrap();
        let mut of_attacker: Vec<_> = (0..4).map(|_| places.acquire_slot(host(2)).unwrap()).collect();
        assert_eq!(evicted(&of_attacker), [0; 0]);
        of_attacker.push(places.acquire_slot(host(2)).unwrap());
        assert_eq!(
            evicted(&of_attacker),
            [0],
            "one host has a limit, and its oldest connection is evicted"
        );
        let third = places.acquire_slot(host(3)).unwrap();
        let _fourth = places.acquire_slot(host(4)).unwrap();
        assert_eq!(evicted(&of_attacker), [0, 1], "beyond all strangers");
        assert!(!other.leave.is_cancelled() && !third.leave.is_cancelled());
        assert!(other.mark_known(0));
        assert!(!of_attacker[0].mark_known(0));
        drop((of_attacker, other, third));
        assert_eq!(places.counts(), (1, 0));
    }

    #[tokio::test]
    async fn the_last_32_known_slots_of_http_are_for_users_who_may_operate() {
        let slots = ConnectionSlots::new(SLOT_LIMITS);
        let mut busy = Vec::new();
        // a connection with a pending request is not evicted
        let mut take = |reserved| {
            let slot = Arc::new(slots.acquire_slot(Ipv6Addr::LOCALHOST.into()).unwrap());
            let is_known = slot.mark_known(reserved);
            let pending = is_known.then(|| slot.protect_while_pending()).flatten();
            busy.extend(pending);
            is_known
        };
        let viewers = (0..300).take_while(|_| take(RESERVED)).count();
        assert_eq!(viewers, 192);
        let operators = (0..300).take_while(|_| take(0)).count();
        assert_eq!(operators, 32);
        assert_eq!(
            SLOT_LIMITS.all - viewers - operators,
            32,
            "slots for hold, stop and abort"
        );
    }

    #[tokio::test(start_paused = true)]
    async fn known_ones_give_way_last_and_only_while_they_are_idle() {
        let places = ConnectionSlots::new(LIMITS);
        let local = IpAddr::from([127, 0, 0, 1]);
        let known: Vec<_> = (0..6)
            .map(|_| {
                let place = Arc::new(places.acquire_slot(local).unwrap());
                assert!(place.mark_known(0));
                place
            })
            .collect();
        tokio::time::advance(Duration::from_secs(1)).await;
        known[0].record_transfer();
        let busy = known[1].protect_while_pending().unwrap();
        let next = places.acquire_slot(local).unwrap();
        assert_eq!(places.counts(), (7, 6));
        assert!(next.mark_known(0));
        assert!(
            known[2].leave.is_cancelled(),
            "the connection that was idle longest"
        );
        let all: Vec<_> = known
            .iter()
            .filter_map(ConnectionSlot::protect_while_pending)
            .collect();
        assert_eq!(all.len(), 5);
        let next = Arc::new(next);
        let _busy_too = next.protect_while_pending().unwrap();
        let late = places.acquire_slot(local).unwrap();
        assert!(!late.mark_known(0), "it may still be served as a stranger");
        drop((busy, all));
        assert!(late.mark_known(0));
    }

    #[tokio::test]
    async fn ipv6_host_is_its_first_64_bits_and_mapped_ipv4_equals_ipv4() {
        let of = |address: &str| host_of(address.parse().unwrap());
        assert_eq!(of("2001:db8:1:2::1"), of("2001:db8:1:2:ffff::9"));
        assert_ne!(of("2001:db8:1:2::1"), of("2001:db8:1:3::1"));
        assert_eq!(of("::ffff:10.0.0.1"), of("10.0.0.1"));
        assert_ne!(of("::ffff:10.0.0.1"), of("::ffff:10.0.0.2"));
        assert!(of("::1").is_loopback() && of("::ffff:127.0.0.1").is_loopback());
        let places = ConnectionSlots::new(LIMITS);
        let of_one: Vec<_> = (0..5)
            .map(|n| {
                let place = places
                    .acquire_slot(format!("2001:db8::{n}").parse().unwrap())
                    .unwrap();
                assert!(place.mark_known(0));
                Arc::new(place)
            })
            .collect();
        assert_eq!(places.counts(), (4, 4), "the idle connection was evicted");
        let _busy: Vec<_> = of_one
            .iter()
            .filter_map(ConnectionSlot::protect_while_pending)
            .collect();
        assert!(places.acquire_slot("2001:db8::ffff".parse().unwrap()).is_none());
        assert!(places.acquire_slot("2001:db8:0:1::".parse().unwrap()).is_some());
    }
}
