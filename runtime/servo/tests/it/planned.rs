//! A machine that runs a plan, and switches to other plans.

use std::collections::VecDeque;

use tandem_model::profile::{Law, Pace, PacePiece, PathPlace, Profile};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_motion::Planner;
use tandem_servo::{Control, Event, Splice, profile_queue};

use crate::look_ahead::{BlockDistance, Feeds, Watch, push};
use crate::rig::{Rig, is_finished};

/// A machine that runs planned profiles, and accepts new plans.
pub struct Machine {
    pub rig: Rig,
    pub planner: Planner,
    pub watch: Watch,
    pub events: Vec<Event>,
    /// The first plan.
    pub profiles: Vec<Profile>,
    held_at: PathPlace,
}

impl Machine {
    pub fn new(settings: &CoordinateSystemSettings, ways: &[BlockDistance], feeds: impl Into<Feeds>) -> Self {
        let mut planner = Planner::new(settings);
        let mut out = VecDeque::new();
        push(&mut planner, ways, feeds, &mut out);
        Self::of(settings, planner, out)
    }

    /// Creates a machine that runs the output of a planner.
    pub fn of(settings: &CoordinateSystemSettings, planner: Planner, out: VecDeque<Profile>) -> Self {
        let mut rig = Rig::with_room(settings, 100_000);
        let profiles: Vec<Profile> = out.into();
        for profile in &profiles {
            rig.push(profile.clone());
        }
        Self {
            rig,
            planner,
            watch: Watch::new(),
            events: Vec::new(),
            profiles,
            held_at: PathPlace {
                segment: 0,
                plan_s: 0.0,
            },
        }
    }

    pub fn cycles(&mut self, n: u32) {
        for _ in 0..n {
            self.events.extend(self.watch.cycle(&mut self.rig));
        }
    }

    pub fn splice(&mut self, at: Option<PathPlace>, profiles: VecDeque<Profile>) {
        let (mut ring, consumer) = profile_queue(100_000);
        for profile in profiles {
            ring.push(profile).unwrap();
        }
        let splice = Splice {
            at,
            profiles: consumer,
        };
        self.rig.handle.splices.push(splice).unwrap();
        self.rig.control(Control::Splice);
    }

    /// Runs until a splice is taken or rejected.
    pub fn settled(&mut self) -> Option<bool> {
        let spliced = self.events.iter().rev().find_map(|event| match event {
            Event::Spliced { taken } => Some(*taken),
            _ => None,
        });
        if spliced.is_some() {
            self.events
                .retain(|event| !matches!(event, Event::Spliced { .. }));
            drop(self.rig.handle.unread.pop());
        }
        spliced
    }

    pub fn place(&self) -> PathPlace {
        let reading = self.rig.reading();
        PathPlace {
            segment: reading.segment,
            plan_s: reading.plan_s,
        }
    }

    pub fn hold(&mut self) -> PathPlace {
        self.rig.control(Control::Hold);
        for _ in 0..100_000 {
            self.cycles(1);
            let held = self.events.iter().find_map(|event| match event {
                Event::Held { at } => Some(*at),
                _ => None,
            });
            if let Some(at) = held {
                self.events.retain(|event| !matches!(event, Event::Held { .. }));
                self.held_at = at;
                return at;
            }
        }
        panic!("not at rest")
    }

    /// Returns the position of the last feed hold.
    pub fn held_at(&self) -> PathPlace {
        self.held_at
    }

    pub fn until_finished(&mut self, last: u64) {
        for _ in 0..400_000 {
            self.cycles(1);
            if self.events.iter().any(is_finished(last)) {
                return;
            }
        }
        panic!("never finished");
    }

    /// Returns the distance between the commanded position and the path of its block, at the plan time in the
    /// readings.
    pub fn off_the_path(&self) -> f64 {
        let place = self.place();
        let block = self
            .profiles
            .iter()
            .find(|profile| profile.segment == place.segment);
        let Some(block) = block.filter(|_| place.plan_s.is_finite()) else {
            return 0.0;
        };
        let Law::Paced { .. } = &block.law else {
            let off = block.position(place.plan_s).minus(self.rig.position());
            return off.orthogonal_length();
        };
        let mut law = block.law.clone();
        if let Law::Paced { pace, .. } = &mut law {
            // As planned without look-ahead, the rate is 1.
            let piece = PacePiece {
                rate: 1.0,
                ..PacePiece::default()
            };
            *pace = Pace::new([piece], f64::INFINITY, 1.0, 0);
        }
        let programmed = Profile {
            law,
            duration_s: f64::INFINITY,
            ..block.clone()
        };
        let off = programmed.position(place.plan_s).minus(self.rig.position());
        off.orthogonal_length()
    }
}
