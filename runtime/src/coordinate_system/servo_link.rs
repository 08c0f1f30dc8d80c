//! The coordinate system's connection to the servo: sends profiles and controls, and receives events.

use std::collections::VecDeque;

use tandem_model::MachinePosition;
use tandem_model::profile::{PathPlace, Profile, TimeBase};
use tandem_servo::{ChannelHandle, Control, Event, ProfileProducer, Splice, profile_queue};

use super::run::pipeline::Pipeline;

/// Handle of the servo channel, and controls that wait because the servo's queue is full.
#[derive(Debug)]
pub(crate) struct ServoLink {
    handle: ChannelHandle,
    backlog: VecDeque<Control>,
    /// Profile queues of the new plans that the servo has neither accepted nor refused yet.
    spliced: VecDeque<ProfileProducer>,
    epoch: u32,
    /// Override that scales the motion that started last.
    pub started: Option<TimeBase>,
    /// True after a failure of the servo: the link sends no controls and returns no events.
    has_failed: bool,
    /// Number of the last segment whose end the servo has reported.
    pub finished_segment: u64,
}

impl ServoLink {
    pub fn new(handle: ChannelHandle) -> Self {
        Self {
            handle,
            backlog: VecDeque::new(),
            spliced: VecDeque::new(),
            epoch: 0,
            started: None,
            has_failed: false,
            finished_segment: 0,
        }
    }

    pub fn next_event(&mut self) -> Option<Event> {
        self.hand_over();
        self.handle.events.pop().ok().filter(|_| !self.has_failed)
    }

    /// Notes a failure of the servo. Returns true on the first call.
    pub fn fail(&mut self) -> bool {
        self.backlog.clear();
        !std::mem::replace(&mut self.has_failed, true)
    }

    pub fn control(&mut self, control: Control) {
        if self.has_failed {
            return;
        }
        self.backlog.push_back(control);
        self.hand_over();
    }

    /// Sends the overrides. Replaces waiting overrides, so that many changes need only one slot of the queue.
    pub fn set_override(&mut self, feed: f64, rapid: f64) {
        self.backlog
            .retain(|control| !matches!(control, Control::Override { .. }));
        self.control(Control::Override { feed, rapid });
    }

    /// Sends the skip input of a motor. Replaces a waiting value of the same motor.
    pub fn set_skip_input(&mut self, motor: u16, on: bool) {
        self.backlog
            .retain(|control| !matches!(control, Control::SkipInput { motor: other, .. } if *other == motor));
        self.control(Control::SkipInput { motor, on });
    }

    /// Stops the machine on the path, or with `abort` by the shortest path, and starts a new epoch.
    pub fn stop(&mut self, epoch: u32, abort: bool) {
        self.epoch = epoch;
        self.control(if abort {
            Control::Abort { epoch }
        } else {
            Control::Stop { epoch }
        });
    }

    /// Works as [`ServoLink::stop`], but discards all waiting controls first. Relies on no state that a fault could
    /// have left incomplete.
    pub fn stop_at_once(&mut self, abort: bool) {
        self.backlog.clear();
        self.stop(self.epoch.saturating_add(1), abort);
    }

    /// Returns the commanded position of the last servo cycle.
    pub fn commanded(&self) -> MachinePosition {
        self.handle.readings.read().commanded
    }

    pub fn epoch(&self) -> u32 {
        self.epoch
    }

    /// Returns true while controls wait because the servo's queue of controls is full.
    pub fn is_backlogged(&self) -> bool {
        !self.backlog.is_empty()
    }

    /// Moves profiles from `ready` into the servo's queue until the queue is full.
    pub fn hand_over_profiles(&mut self, ready: &mut VecDeque<Profile>) {
        fill(&mut self.handle.profiles, ready);
    }

    /// Returns a point of the planned motion that is at least `ahead_s` of plan time ahead of the current position.
    pub fn point_ahead(&self, ahead_s: f64, pipeline: &Pipeline) -> Option<PathPlace> {
        let reading = self.handle.readings.read();
        let from = PathPlace {
            segment: reading.segment,
            plan_s: reading.plan_s,
        };
        pipeline.planner.place_ahead(from, ahead_s)
    }

    /// Replaces the profiles in the servo's queue by `profiles`, as many as the queue holds: from the point `at` on, or
    /// from the rest position. The servo answers with [`Event::Spliced`].
    pub fn splice(&mut self, at: Option<PathPlace>, profiles: &mut VecDeque<Profile>) {
        let (mut producer, consumer) = profile_queue(self.handle.profiles.capacity());
        fill(&mut producer, profiles);
        let splice = Splice {
            at,
            profiles: consumer,
        };
        // The ring has a free slot: a second splice is sent only at rest, and no third one before both are answered.
        let _ = self.handle.splices.push(splice);
        self.spliced.push_back(producer);
        self.control(Control::Splice);
    }

    /// Processes the servo's answer to a splice: the servo uses the new profiles from now on, or has discarded them.
    pub fn on_spliced(&mut self, taken: bool) {
        if let Some(producer) = self.spliced.pop_front()
            && taken
        {
            self.handle.profiles = producer;
        }
        // The unused queue is dropped here, because the servo thread must not free memory.
        let _ = self.handle.unread.pop();
    }

    fn hand_over(&mut self) {
        while let Some(control) = self.backlog.pop_front() {
            if let Err(rtrb::PushError::Full(control)) = self.handle.controls.push(control) {
                self.backlog.push_front(control);
                return;
            }
        }
    }
}

// Profiles are large, so none is moved while the queue is full.
fn fill(queue: &mut ProfileProducer, profiles: &mut VecDeque<Profile>) {
    let count = queue.slots().min(profiles.len());
    for profile in profiles.drain(..count) {
        // cannot fail: the servo only frees slots
        let _ = queue.push(profile);
    }
}
