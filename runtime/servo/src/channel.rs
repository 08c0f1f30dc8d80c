//! The channel of one coordinate system: the end in the servo, and the end in the coordinator.

use std::sync::Arc;

use rtrb::{Consumer, Producer, RingBuffer};
use tandem_model::flow::TapLeg;
use tandem_model::profile::{Law, PathPlace, Profile, TimeBase};
use tandem_model::settings::{CoordinateSystemSettings, LowOverride};
use tandem_model::{AxisVector, MachinePosition, Origin};

use crate::brake::Brake;
use crate::control::{Control, Event};
use crate::motors::Motors;
use crate::path_time::{PathTime, slope};
use crate::power::Power;
use crate::profile_queue::{ProfileConsumer, ProfileProducer, profile_queue};
use crate::readings::{Reading, Readings};
use crate::setpoint_history::History;
use crate::skip::SkipRun;
use crate::spindle::{Orientation, SpindleLink, SpindleState};
use crate::splice::{SPLICES_MAX, Splice};
use crate::trace::{Cycle, Trace, Tracer};

/// Maximum number of pending controls of one channel; the ring rejects further controls. A cycle takes at
/// most 16 controls.
pub const CONTROLS_MAX: usize = 64;

/// Maximum number of unread events. If fewer than 9 slots are free, the channel takes no control and starts
/// no profile from rest, and joints without a stop emit no event. So no event of a stop, a hold or a fault is
/// ever lost.
pub const EVENTS_MAX: usize = 1024;

/// The end of a coordinate system in the servo.
#[expect(clippy::struct_excessive_bools, reason = "each is a state of its own")]
#[derive(Debug)]
pub struct Channel {
    pub(crate) profiles: ProfileConsumer,
    pub(crate) controls: Consumer<Control>,
    pub(crate) events: Producer<Event>,
    pub(crate) splices: Consumer<Splice>,
    pub(crate) unread: Producer<ProfileConsumer>,
    pub(crate) readings: Arc<Readings>,
    pub(crate) tracer: Tracer,
    pub(crate) period_s: f64,
    /// Largest change of the time base per second towards the override.
    pub(crate) override_slope: f64,
    /// Largest change of the time base per second towards the override in a G500 chain. Infinite if only the motors
    /// limit it.
    pub(crate) paced_override_slope: f64,
    /// Largest change of the time base per second towards rest.
    pub(crate) hold_slope: f64,
    pub(crate) feed_override: f64,
    pub(crate) rapid_override: f64,
    pub(crate) time: PathTime,
    /// The profile that runs, or that waits at its end point until its motors are in position.
    pub(crate) current: Option<Profile>,
    /// Number of cycles since the current profile gave its end point.
    pub(crate) ended_cycles: Option<u64>,
    /// The motors that have turned back in the running G31.
    pub(crate) skip: SkipRun,
    pub(crate) braking: Option<Brake>,
    /// Epoch of a stop or abort that is in progress.
    pub(crate) stopping: Option<u32>,
    /// Oldest epoch whose profiles may run.
    pub(crate) epoch: u32,
    pub(crate) hold: Hold,
    /// True if the hold also acts in a thread.
    pub(crate) holds_in_thread: bool,
    /// Number of cycles since setpoints last moved; `u64::MAX` if they have not moved yet.
    pub(crate) still_cycles: u64,
    /// The last started move in a thread, from the start of the move in to the end of the move out, including
    /// dwell and waits. During this time the spindle follows, and feed hold waits unless it acts in phase.
    /// `None` if the tool is out of the hole.
    pub(crate) thread: Option<TapLeg>,
    /// The plan to which the motion will switch.
    pub(crate) splice: Option<Splice>,
    pub(crate) faulted: bool,
    pub(crate) power: Power,
    /// Number of consecutive lost frames, if it exceeds the permitted number.
    pub(crate) bus_lost: Option<u32>,
    pub(crate) setpoint: AxisVector,
    pub(crate) history: History,
    /// Change of the setpoint in the last cycle, units per second.
    pub(crate) velocity: AxisVector,
    pub(crate) motors: Motors,
    pub(crate) spindle: Option<SpindleLink>,
    /// Plan time at which the motion left the last block, s: the end of the block, or infinite if the motion
    /// passed the end. 0 before the first block.
    pub(crate) left_at_s: f64,
    /// Origin of the block to which the setpoint belongs.
    pub(crate) executing: Option<Origin>,
    /// Override that scales the block to which the setpoint belongs.
    pub(crate) time_base: Option<TimeBase>,
    pub(crate) last_segment: u64,
    /// True if an event was emitted in this cycle.
    pub(crate) reported: bool,
    /// True if nothing moves in this cycle, and no motion is pending.
    pub(crate) rests: bool,
}

/// State of feed hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Hold {
    Off,
    /// The hold will begin at the end of the block.
    AfterBlock,
    /// The hold is commanded; [`Event::Held`] follows.
    ComingToRest,
    /// [`Event::Held`] was emitted.
    AtRest,
}

impl Hold {
    /// Returns true while the commanded motion decelerates to rest or is at rest.
    pub(crate) fn holds(self) -> bool {
        matches!(self, Hold::ComingToRest | Hold::AtRest)
    }
}

/// The end of a coordinate system in the coordinator.
#[derive(Debug)]
pub struct ChannelHandle {
    /// Profiles to run, in order.
    pub profiles: ProfileProducer,
    /// Commands to the channel.
    pub controls: Producer<Control>,
    /// Plans that will replace the running plan: one at a time, each before its [`Control::Splice`].
    pub splices: Producer<Splice>,
    /// Queues that the servo no longer reads, and that the coordinator must drop: one for each
    /// [`Event::Spliced`].
    pub unread: Consumer<ProfileConsumer>,
    /// Events of the channel. The coordinator must read them after each cycle that returned true.
    pub events: Consumer<Event>,
    /// Values of the last cycle.
    pub readings: Arc<Readings>,
    /// Samples of the last minute.
    pub trace: Arc<Trace>,
}

/// Creates both ends of a coordinate system with these motors, at rest at their actual positions. The queue
/// holds at most `profiles_max` profiles and rejects further profiles.
pub(crate) fn channel(
    settings: &CoordinateSystemSettings,
    profiles_max: usize,
    motors: Motors,
    spindle: Option<SpindleLink>,
) -> (Channel, ChannelHandle) {
    let (profiles_in, profiles) = profile_queue(profiles_max);
    let (controls_in, controls) = RingBuffer::new(CONTROLS_MAX);
    let (events, events_out) = RingBuffer::new(EVENTS_MAX);
    let (splices_in, splices) = RingBuffer::new(SPLICES_MAX);
    let (unread, unread_out) = RingBuffer::new(SPLICES_MAX);
    let at = motors.actual();
    let readings = readings_at_rest(&motors);
    let tracer = Tracer::new(settings.axes(), settings.servo_period_s);
    let handle = ChannelHandle {
        profiles: profiles_in,
        controls: controls_in,
        splices: splices_in,
        unread: unread_out,
        events: events_out,
        readings: readings.clone(),
        trace: tracer.trace(),
    };
    let channel = Channel {
        profiles,
        controls,
        events,
        splices,
        unread,
        readings,
        tracer,
        period_s: settings.servo_period_s,
        override_slope: slope(settings.override_slew_ms),
        paced_override_slope: paced_override_slope(settings),
        hold_slope: slope(settings.hold_slew_ms),
        feed_override: 1.0,
        rapid_override: 1.0,
        time: PathTime::new(settings.servo_period_s),
        current: None,
        ended_cycles: None,
        skip: SkipRun::default(),
        braking: None,
        stopping: None,
        epoch: 0,
        hold: Hold::Off,
        holds_in_thread: false,
        still_cycles: u64::MAX,
        thread: None,
        splice: None,
        faulted: false,
        power: Power::Off,
        bus_lost: None,
        setpoint: at,
        history: History::at_rest(at),
        velocity: AxisVector::ZERO,
        motors,
        spindle,
        left_at_s: f64::INFINITY,
        executing: None,
        time_base: None,
        last_segment: 0,
        reported: false,
        rests: false,
    };
    (channel, handle)
}

/// Creates the readings of motors at rest.
fn readings_at_rest(motors: &Motors) -> Arc<Readings> {
    let readings = Arc::new(Readings::default());
    readings.write(&Reading {
        commanded: MachinePosition(motors.actual()),
        actual: MachinePosition(motors.actual()),
        homed: motors.homed(),
        ..Reading::default()
    });
    readings
}

/// Returns the largest change of the override factor per second in a G500 chain.
fn paced_override_slope(settings: &CoordinateSystemSettings) -> f64 {
    match settings.motion.low_override {
        LowOverride::Replan => f64::INFINITY,
        LowOverride::TimeBase => slope(settings.override_slew_ms),
    }
}

impl Channel {
    /// Returns the commanded position of the last cycle, mm or degrees from the machine's zero.
    pub fn setpoint(&self) -> AxisVector {
        self.setpoint
    }

    /// Returns the angle of the spindle in the last cycle, degrees, 0 to below 360, clockwise positive.
    /// Returns 0 if the channel has no spindle.
    pub fn spindle_deg(&self) -> f64 {
        self.spindle_state().angle_deg
    }

    /// Returns true if the channel has no spindle, or if further cycles of the spindle change nothing.
    pub(crate) fn spindle_rests(&self) -> bool {
        self.spindle.as_ref().is_none_or(SpindleLink::is_at_rest)
    }

    /// Returns true if further cycles change at most the angle of the spindle.
    pub(crate) fn spindle_is_steady(&self) -> bool {
        (self.spindle.as_ref()).is_none_or(|spindle| spindle.is_steady() && self.thread.is_none())
    }

    fn spindle_state(&self) -> SpindleState {
        self.spindle
            .as_ref()
            .map_or(SpindleState::default(), SpindleLink::state)
    }

    /// Returns true if the channel is idle: no profile or control is pending, and no profile runs or waits
    /// for its motors. Also, nothing brakes, no drive is being enabled, and the spindle is not being
    /// oriented. The spindle may turn.
    pub fn is_idle(&self) -> bool {
        self.current.is_none()
            && self.braking.is_none()
            && self.stopping.is_none()
            && self.profiles.is_empty()
            && self.controls.is_empty()
            && !self.power.is_enabling()
            && !self.spindle.as_ref().is_some_and(SpindleLink::is_busy)
    }

    /// Returns the origin of the block to which the last setpoint belongs, including its end point and the
    /// wait for its motors. Returns `None` if no block runs, and while an abort brakes.
    pub fn executing(&self) -> Option<Origin> {
        self.executing
    }

    /// Returns true if the last cycle emitted an event, or was slowed down by a lack of profiles.
    pub fn has_reported(&self) -> bool {
        self.reported
    }

    /// Returns the override that scales the block of [`Channel::executing`]: [`TimeBase::Rapid`] for G00,
    /// G28, G30, G53 and G31.
    pub fn time_base(&self) -> Option<TimeBase> {
        self.time_base
    }

    /// Returns the number of the segment that runs or ran last; 0 before the first.
    pub fn segment(&self) -> u64 {
        self.last_segment
    }

    /// Returns the number of profiles that wait in the ring, including profiles of an old epoch.
    pub fn profiles_waiting(&self) -> usize {
        self.profiles.slots()
    }

    /// Returns the position on the path of the last cycle's setpoint.
    pub(crate) fn place(&self) -> PathPlace {
        let plan_s = match &self.current {
            None => self.left_at_s,
            Some(profile) if self.ended_cycles.is_none() => profile.plan_time(self.time.now_s()),
            Some(profile) => match &profile.law {
                Law::Paced { pace, .. } if pace.is_backward() => pace.ends_s,
                Law::Motors { stretch, .. } | Law::Rest { stretch, .. } => stretch.to_s,
                _ => f64::INFINITY,
            },
        };
        PathPlace {
            segment: self.last_segment,
            plan_s,
        }
    }

    /// Returns the commanded speed along X, Y, Z, mm/min. If X, Y, Z rest, returns the speed along the other
    /// axes, deg/min.
    fn feedrate_mm_min(&self) -> f64 {
        let orthogonal = self.velocity.orthogonal_length();
        let speed = if orthogonal > 0.0 {
            orthogonal
        } else {
            self.velocity.rotary_length()
        };
        speed * 60.0
    }

    /// Writes a sample to the trace if one is due.
    pub(crate) fn keep_trace(&mut self, time_s: f64) {
        if let Some(acceleration) = self.tracer.see(self.velocity) {
            let cycle = Cycle {
                time_s,
                feedrate_mm_min: self.feedrate_mm_min(),
                spindle_rpm: self.spindle_state().rpm,
                commanded: self.setpoint,
                actual: self.motors.actual(),
                velocity: self.velocity,
            };
            self.tracer.keep(&cycle, acceleration);
        }
    }

    pub(crate) fn publish(&self, time_s: f64) {
        let running = self.current.as_ref();
        let spindle = self.spindle_state();
        let moving_rate = if self.current.is_some() && self.ended_cycles.is_none() {
            self.time.rate()
        } else {
            0.0
        };
        self.readings.write(&Reading {
            time_s,
            commanded: MachinePosition(self.setpoint),
            actual: MachinePosition(self.motors.actual()),
            homed: self.motors.homed(),
            distance_to_go: running.map_or(AxisVector::ZERO, |profile| profile.target().minus(self.setpoint)),
            feedrate_mm_min: self.feedrate_mm_min(),
            rate: moving_rate,
            segment: self.last_segment,
            plan_s: self.place().plan_s,
            executing: self.executing,
            held: self.hold.holds(),
            spindle_rpm: spindle.rpm,
            spindle_deg: spindle.angle_deg,
            oriented: spindle.orientation == Orientation::Reached,
        });
    }
}
