//! Queue of profiles from the coordinator to the servo.
//!
//! A profile is large, and the queue has room for thousands of them. If the ring contained the profiles, each
//! profile would touch another part of the ring's memory. The memory of the process would then grow for
//! hours, until the first round through the ring is complete. So the ring contains boxes, and used boxes
//! return to the coordinator. The memory is that of the profiles that have waited at the same time. The servo
//! neither allocates nor frees memory.

use rtrb::chunks::ReadChunk;
use rtrb::{Consumer, PeekError, PopError, Producer, PushError, RingBuffer};
use tandem_model::profile::Profile;

/// Number of used boxes that a producer keeps for later profiles; it frees any further boxes. Reason: the
/// coordinator prepares at most this number of profiles in one turn.
const KEPT_MAX: usize = 256;

/// The coordinator's end of a queue.
#[derive(Debug)]
pub struct ProfileProducer {
    ring: Producer<Box<Profile>>,
    used: Consumer<Box<Profile>>,
}

/// The servo's end of a queue.
#[derive(Debug)]
pub struct ProfileConsumer {
    ring: Consumer<Box<Profile>>,
    used: Producer<Box<Profile>>,
}

/// Creates a queue for at most `profiles_max` waiting profiles. A full queue rejects further profiles.
pub fn profile_queue(profiles_max: usize) -> (ProfileProducer, ProfileConsumer) {
    let (ring_in, ring_out) = RingBuffer::new(profiles_max);
    // One slot more: while the consumer uses a box, the producer may allocate another box.
    let (used_in, used_out) = RingBuffer::new(profiles_max + 1);
    let producer = ProfileProducer {
        ring: ring_in,
        used: used_out,
    };
    let consumer = ProfileConsumer {
        ring: ring_out,
        used: used_in,
    };
    (producer, consumer)
}

impl ProfileProducer {
    /// Appends a profile to the queue.
    ///
    /// # Errors
    /// Returns the profile if the queue is full.
    #[expect(clippy::result_large_err, reason = "the caller keeps the profile")]
    pub fn push(&mut self, profile: Profile) -> Result<(), PushError<Profile>> {
        if self.ring.is_full() {
            return Err(PushError::Full(profile));
        }
        let boxed = match self.used.pop() {
            Ok(mut boxed) => {
                *boxed = profile;
                boxed
            }
            Err(PopError::Empty) => Box::new(profile),
        };
        while self.used.slots() > KEPT_MAX {
            drop(self.used.pop());
        }
        self.ring
            .push(boxed)
            .map_err(|PushError::Full(boxed)| PushError::Full(*boxed))
    }

    /// Returns the number of free slots in the queue.
    pub fn slots(&self) -> usize {
        self.ring.slots()
    }

    /// Returns the total number of slots.
    pub fn capacity(&self) -> usize {
        self.ring.buffer().capacity()
    }
}

impl ProfileConsumer {
    /// Returns the profile that has waited longest.
    pub(crate) fn peek(&self) -> Result<&Profile, PeekError> {
        self.ring.peek().map(AsRef::as_ref)
    }

    /// Removes and returns the profile that has waited longest.
    pub(crate) fn pop(&mut self) -> Result<Profile, PopError> {
        let boxed = self.ring.pop()?;
        let profile = Profile::clone(&boxed);
        self.give_back(boxed);
        Ok(profile)
    }

    /// Discards the profile that has waited longest.
    pub(crate) fn discard(&mut self) {
        if let Ok(boxed) = self.ring.pop() {
            self.give_back(boxed);
        }
    }

    /// Returns all waiting profiles, in two parts.
    pub(crate) fn waiting(&mut self) -> Option<ReadChunk<'_, Box<Profile>>> {
        let known = self.ring.slots();
        self.ring.read_chunk(known).ok()
    }

    /// Returns the number of waiting profiles.
    pub(crate) fn slots(&self) -> usize {
        self.ring.slots()
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.ring.is_empty()
    }

    /// Returns the total number of slots.
    pub(crate) fn capacity(&self) -> usize {
        self.ring.buffer().capacity()
    }

    fn give_back(&mut self, boxed: Box<Profile>) {
        // The ring of used boxes has a slot for each box.
        let _ = self.used.push(boxed);
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::testing::dwell;

    #[test]
    fn a_queue_passes_profiles_in_order_and_refuses_more_than_it_has_room_for() {
        let (mut producer, mut consumer) = profile_queue(3);
        for segment in 1..=3 {
            producer.push(dwell(segment)).unwrap();
        }
        let PushError::Full(refused) = producer.push(dwell(4)).unwrap_err();
        assert_eq!((refused.segment, producer.slots(), consumer.slots()), (4, 0, 3));
        assert_eq!(consumer.peek().unwrap().segment, 1);
        consumer.discard();
        assert_eq!(consumer.pop().unwrap().segment, 2);
        producer.push(dwell(4)).unwrap();
        let waiting = consumer.waiting().unwrap();
        let (first, second) = waiting.as_slices();
        let segments: Vec<_> = first
            .iter()
            .chain(second)
            .map(|profile| profile.segment)
            .collect();
        assert_eq!(segments, [3, 4]);
    }

    #[test]
    fn its_memory_is_that_of_profiles_that_wait_at_the_same_time() {
        let (mut producer, mut consumer) = profile_queue(4096);
        let mut places = BTreeSet::new();
        for round in 0..10_000 {
            for n in 0..5 {
                producer.push(dwell(5 * round + n)).unwrap();
            }
            for n in 0..5 {
                places.insert(std::ptr::from_ref(consumer.peek().unwrap()).addr());
                assert_eq!(consumer.pop().unwrap().segment, 5 * round + n);
            }
        }
        // One more than the waiting profiles: a box that is in no ring.
        assert!(places.len() <= 6, "{} places", places.len());
        for n in 0..4096 {
            producer.push(dwell(n)).unwrap();
        }
        for _ in 0..4096 {
            consumer.discard();
        }
        producer.push(dwell(1)).unwrap();
        assert_eq!(producer.used.slots(), KEPT_MAX, "boxes beyond these are freed");
    }
}
