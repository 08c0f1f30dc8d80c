//! One coordinate system's part of the servo cycle.

use std::sync::Arc;

use rtrb::{Consumer, Producer, RingBuffer};
use tandem_model::profile::Profile;
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{AxisVector, Origin};

use crate::control::{Control, Event};
use crate::readings::{Reading, Readings};

/// Controls that may wait for one channel; the ring refuses more. A cycle takes up to 16 of them.
pub const CONTROLS_MAX: usize = 64;

/// Events that may wait to be read.
pub const EVENTS_MAX: usize = 1024;

/// The servo's end of a coordinate system.
#[derive(Debug)]
pub struct Channel {
    profiles: Consumer<Profile>,
    controls: Consumer<Control>,
    events: Producer<Event>,
    readings: Arc<Readings>,
    setpoint: AxisVector,
    current: Option<Profile>,
}

/// The coordinator's end of a coordinate system.
#[derive(Debug)]
pub struct ChannelHandle {
    /// Profiles to run, in order.
    pub profiles: Producer<Profile>,
    /// Commands to the channel.
    pub controls: Producer<Control>,
    /// What happened; read them after each cycle that returned true.
    pub events: Consumer<Event>,
    /// The last cycle's values.
    pub readings: Arc<Readings>,
}

/// Both ends of a coordinate system with simulated drives, at rest at machine position 0. At most `profiles_max`
/// profiles wait in the ring; it refuses more.
pub fn channel(settings: &CoordinateSystemSettings, profiles_max: usize) -> (Channel, ChannelHandle) {
    let _ = settings;
    let (profiles_in, profiles) = RingBuffer::new(profiles_max);
    let (controls_in, controls) = RingBuffer::new(CONTROLS_MAX);
    let (events, events_out) = RingBuffer::new(EVENTS_MAX);
    let readings = Arc::new(Readings::default());
    let handle = ChannelHandle {
        profiles: profiles_in,
        controls: controls_in,
        events: events_out,
        readings: readings.clone(),
    };
    let channel = Channel {
        profiles,
        controls,
        events,
        readings,
        setpoint: AxisVector::ZERO,
        current: None,
    };
    (channel, handle)
}

impl Channel {
    pub(crate) fn cycle(&mut self, time_s: f64) -> bool {
        while self.controls.pop().is_ok() {}
        let mut event = false;
        if let Ok(profile) = self.profiles.pop() {
            self.setpoint = profile.end();
            let segment = profile.segment;
            event = self.events.push(Event::Finished { segment, time_s }).is_ok();
        }
        self.readings.write(&Reading::default());
        event
    }

    /// The commanded position of the last cycle.
    pub fn setpoint(&self) -> AxisVector {
        self.setpoint
    }

    /// True when there is nothing to do: no profile waits or runs, the command is at rest, nothing brakes.
    pub fn is_idle(&self) -> bool {
        self.current.is_none() && self.profiles.is_empty()
    }

    /// Where the running block comes from.
    pub fn executing(&self) -> Option<Origin> {
        self.current.as_ref().map(|profile| profile.origin)
    }

    /// Profiles that wait in the ring.
    pub fn profiles_waiting(&self) -> usize {
        self.profiles.slots()
    }
}
