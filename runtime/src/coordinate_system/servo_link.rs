//! The task's end of the servo: profiles and controls down, events up.

use std::collections::VecDeque;

use tandem_model::profile::Profile;
use tandem_servo::{ChannelHandle, Control, Event};

/// The channel handle, and what could not be handed over yet.
#[derive(Debug)]
pub(super) struct ServoLink {
    handle: ChannelHandle,
    backlog: VecDeque<Control>,
    epoch: u32,
    /// The segment whose end the servo reported last.
    pub finished_segment: u64,
}

impl ServoLink {
    pub fn new(handle: ChannelHandle) -> Self {
        Self {
            handle,
            backlog: VecDeque::new(),
            epoch: 0,
            finished_segment: 0,
        }
    }

    pub fn next_event(&mut self) -> Option<Event> {
        self.hand_over();
        self.handle.events.pop().ok()
    }

    pub fn control(&mut self, control: Control) {
        self.backlog.push_back(control);
        self.hand_over();
    }

    /// Overrides: only the latest counts, so a flood of them takes one place.
    pub fn set_override(&mut self, feed: f64, rapid: f64) {
        self.backlog
            .retain(|control| !matches!(control, Control::Override { .. }));
        self.control(Control::Override { feed, rapid });
    }

    /// A motor's skip input: only the latest value counts, too.
    pub fn set_skip_input(&mut self, motor: u16, on: bool) {
        self.backlog
            .retain(|control| !matches!(control, Control::SkipInput { motor: other, .. } if *other == motor));
        self.control(Control::SkipInput { motor, on });
    }

    /// Brings the machine to rest, on the path or by the shortest way, and starts a new epoch.
    pub fn stop(&mut self, abort: bool) -> u32 {
        self.epoch += 1;
        let epoch = self.epoch;
        self.control(if abort {
            Control::Abort { epoch }
        } else {
            Control::Stop { epoch }
        });
        epoch
    }

    pub fn epoch(&self) -> u32 {
        self.epoch
    }

    /// True while the servo's queue of controls is full.
    pub fn is_backlogged(&self) -> bool {
        !self.backlog.is_empty()
    }

    /// Moves as many profiles as there is room for.
    pub fn hand_over_profiles(&mut self, ready: &mut VecDeque<Profile>) {
        while let Some(profile) = ready.pop_front() {
            if let Err(rtrb::PushError::Full(profile)) = self.handle.profiles.push(profile) {
                ready.push_front(profile);
                return;
            }
        }
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
