//! The coordinate system's connection to the servo: profiles and controls are sent, events are received.

use std::collections::VecDeque;

use tandem_model::MachinePosition;
use tandem_model::profile::{PathPlace, Profile, TimeBase};
use tandem_servo::{ChannelHandle, Control, Event, ProfileProducer, Splice, profile_queue};

use super::pipeline::Pipeline;

/// Channel handle, and the data that could not be handed over yet.
#[derive(Debug)]
pub(super) struct ServoLink {
    handle: ChannelHandle,
    backlog: VecDeque<Control>,
    /// Profiles of plans that the servo has not answered yet.
    spliced: VecDeque<ProfileProducer>,
    epoch: u32,
    /// The override that scales the motion begun last.
    pub started: Option<TimeBase>,
    /// True after a failure of the servo: no control is sent, and no event arrives.
    has_failed: bool,
    /// The last segment whose end the servo has reported.
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

    /// Notes a failure of the servo; returns true the first time.
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

    /// Sends the overrides: only the latest values matter, so many changes need only one slot.
    pub fn set_override(&mut self, feed: f64, rapid: f64) {
        self.backlog
            .retain(|control| !matches!(control, Control::Override { .. }));
        self.control(Control::Override { feed, rapid });
    }

    /// Sends a motor's skip input: here too, only the latest value matters.
    pub fn set_skip_input(&mut self, motor: u16, on: bool) {
        self.backlog
            .retain(|control| !matches!(control, Control::SkipInput { motor: other, .. } if *other == motor));
        self.control(Control::SkipInput { motor, on });
    }

    /// Stops the machine, on the path or by the shortest way, and starts a new epoch.
    pub fn stop(&mut self, epoch: u32, abort: bool) {
        self.epoch = epoch;
        self.control(if abort {
            Control::Abort { epoch }
        } else {
            Control::Stop { epoch }
        });
    }

    /// Works as [`ServoLink::stop`], but before all waiting controls, which are dropped. Relies on no state that a
    /// fault could have left incomplete.
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

    /// Returns true while the servo's queue of controls is full.
    pub fn is_backlogged(&self) -> bool {
        !self.backlog.is_empty()
    }

    /// Hands over as many profiles as there is room for.
    pub fn hand_over_profiles(&mut self, ready: &mut VecDeque<Profile>) {
        fill(&mut self.handle.profiles, ready);
    }

    /// Returns a point of the planned motion, at least `ahead_s` of plan time ahead of the current position.
    pub fn point_ahead(&self, ahead_s: f64, pipeline: &Pipeline) -> Option<PathPlace> {
        let reading = self.handle.readings.read();
        let from = PathPlace {
            segment: reading.segment,
            plan_s: reading.plan_s,
        };
        pipeline.planner.place_ahead(from, ahead_s)
    }

    /// Replaces the profiles handed over, from a point on or from the rest position, by these: as many as there is room
    /// for. [`Event::Spliced`] is the answer.
    pub fn splice(&mut self, at: Option<PathPlace>, profiles: &mut VecDeque<Profile>) {
        let (mut producer, consumer) = profile_queue(self.handle.profiles.capacity());
        fill(&mut producer, profiles);
        let splice = Splice {
            at,
            profiles: consumer,
        };
        // There is room: a second splice is sent only at rest, and no third one before both are answered.
        let _ = self.handle.splices.push(splice);
        self.spliced.push_back(producer);
        self.control(Control::Splice);
    }

    /// Processes the answer to a splice: the servo reads the new profiles from now on, or discards them.
    pub fn on_spliced(&mut self, taken: bool) {
        if let Some(producer) = self.spliced.pop_front()
            && taken
        {
            self.handle.profiles = producer;
        }
        // Dropped here, because the servo thread must not free memory.
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

// A profile is large, so no profile is moved while the queue is full.
fn fill(queue: &mut ProfileProducer, profiles: &mut VecDeque<Profile>) {
    let count = queue.slots().min(profiles.len());
    for profile in profiles.drain(..count) {
        // the servo only makes room
        let _ = queue.push(profile);
    }
}
