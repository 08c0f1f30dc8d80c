//! The servo cycle over all channels.

use std::panic::{AssertUnwindSafe, catch_unwind};

use tandem_model::settings::CoordinateSystemSettings;

use crate::bus::{BusCounts, Command, Cutoff, CycleResult, DriveBus, Feedback};
use crate::channel::{Channel, ChannelHandle, channel};
use crate::hardware::Hardware;
use crate::motors::Motors;
use crate::spindle::SpindleLink;

/// Longest time in which consecutive frames of the bus may be lost, whatever the bus allows, s. Reason: the
/// alarm must be raised within 100 ms.
const LOST_MAX_S: f64 = 0.09;

/// All channels of the machine, cycled in lock-step, and the bus to their motors.
#[derive(Debug)]
pub struct Servo {
    channels: Vec<Channel>,
    bus: Box<dyn DriveBus>,
    /// Commands, by the motors' places on the bus.
    commands: Box<[Command]>,
    feedback: Box<[Feedback]>,
    counts: BusCounts,
    lost_in_a_row: u32,
    lost_in_a_row_max: u32,
    keeps_speed: bool,
    period_s: f64,
    cycles: u64,
    /// True if a call of the bus has panicked. The bus is then not called again.
    has_bus_failed: bool,
}

impl Servo {
    /// Creates the channels of coordinate systems, in their order, at time 0, and the coordinator's end of
    /// each channel. The number with each coordinate system is the size of its profile queue.
    pub fn new(
        systems: &[(&CoordinateSystemSettings, usize)],
        servo_period_s: f64,
        hardware: Hardware,
    ) -> (Self, Vec<ChannelHandle>) {
        let Hardware {
            bus,
            at_start: mut feedback,
            spindles,
        } = hardware;
        let of_system = |settings: &CoordinateSystemSettings| settings.motors.iter().flatten().count();
        let count = systems.iter().map(|(settings, _)| of_system(settings)).sum();
        feedback.resize(count, Feedback::default());
        let mut places = 0;
        let mut spindles = spindles.into_iter();
        let (channels, handles) = systems
            .iter()
            .map(|(settings, profiles_max)| {
                let motors = Motors::new(settings, places, bus.as_ref(), &feedback);
                places += of_system(settings);
                let spindle = spindles.next().flatten().zip(settings.spindle.as_ref());
                let spindle = spindle.map(|(device, motor)| SpindleLink::new(device, motor));
                channel(settings, *profiles_max, motors, spindle)
            })
            .unzip();
        let at_start = feedback.iter().map(|feedback| Command {
            position: feedback.position,
            ..Command::default()
        });
        let servo = Self {
            channels,
            lost_in_a_row: 0,
            lost_in_a_row_max: bus.lost_in_a_row_max().min(frames(LOST_MAX_S, servo_period_s)),
            keeps_speed: bus.keeps_speed(),
            bus,
            commands: at_start.collect(),
            feedback: feedback.into(),
            counts: BusCounts::default(),
            period_s: servo_period_s,
            cycles: 0,
            has_bus_failed: false,
        };
        (servo, handles)
    }

    /// Creates a servo with simulated hardware.
    pub fn simulated(
        systems: &[(&CoordinateSystemSettings, usize)],
        servo_period_s: f64,
    ) -> (Self, Vec<ChannelHandle>) {
        let settings: Vec<_> = systems.iter().map(|(settings, _)| *settings).collect();
        Self::new(systems, servo_period_s, Hardware::simulated(&settings))
    }

    /// Executes one servo cycle: time advances by one period, each channel gives its setpoint, and the bus
    /// exchanges commands and reports of the motors. Returns true if any channel emitted an event, or was
    /// slowed down by a lack of profiles. It never allocates, locks, waits or panics, if the bus and the
    /// spindles do not.
    pub fn cycle(&mut self) -> bool {
        self.cycles += 1;
        let time_s = self.time_s();
        for channel in &mut self.channels {
            channel.command(time_s, &mut self.commands);
        }
        self.exchange();
        let lost = Some(self.lost_in_a_row).filter(|cycles| *cycles > self.lost_in_a_row_max);
        let mut events = false;
        for channel in &mut self.channels {
            events |= channel.conclude(time_s, &self.feedback, lost);
        }
        events
    }

    /// Executes a cycle after more missed cycles than permitted: moving channels are held on their paths.
    /// Setpoints continue from their last values. Motors that keep their speed brake from it. Any other
    /// motors have stopped meanwhile, and the commanded motion also starts from rest. Returns true as
    /// [`Servo::cycle`] does, or if a channel was in motion.
    pub fn cycle_after_missed(&mut self, missed: u64) -> bool {
        let mut events = false;
        for channel in &mut self.channels {
            events |= channel.hold_after_missed(missed, self.keeps_speed);
        }
        self.cycle() | events
    }

    fn exchange(&mut self) {
        self.bus.heartbeat(self.cycles);
        let result = self.bus.exchange(&self.commands, &mut self.feedback);
        self.lost_in_a_row = match result {
            CycleResult::OnTime => 0,
            CycleResult::Late => {
                self.counts.late += 1;
                0
            }
            CycleResult::Lost => {
                self.counts.lost += 1;
                self.lost_in_a_row.saturating_add(1)
            }
        };
    }

    /// Executes a cycle after the servo has failed: nothing moves, every drive and spindle is commanded to
    /// have no power, and the heartbeat stops. A device that panics again is not called any more. It may
    /// allocate, so a working servo must not call it.
    pub fn power_off(&mut self) {
        let time_s = self.time_s();
        for command in &mut self.commands {
            command.enable = false;
            command.clear_fault = false;
        }
        if !self.has_bus_failed {
            let exchanged = catch_unwind(AssertUnwindSafe(|| {
                self.bus.exchange(&self.commands, &mut self.feedback)
            }));
            self.has_bus_failed = exchanged.is_err();
        }
        for channel in &mut self.channels {
            channel.power_off(time_s);
        }
    }

    /// Returns the function that cuts the power of all drives without the bus.
    pub fn cutoff(&mut self) -> Option<Cutoff> {
        self.bus.cutoff()
    }

    /// Returns the numbers of late and lost exchanges.
    pub fn bus_counts(&self) -> BusCounts {
        self.counts
    }

    /// Returns the number of cycles, at most `cycles_max`, that would emit no event. In these cycles every
    /// channel rests, dwells, or moves at a constant rate of its time base with motors without lag. Its
    /// spindle keeps its speed.
    pub fn cycles_to_pass(&mut self, cycles_max: u64) -> u64 {
        let each = self.channels.iter_mut().map(Channel::cycles_to_pass);
        each.fold(cycles_max, u64::min)
    }

    /// Returns the number of cycles, at most `cycles_max`, that can be passed while each motor keeps its
    /// speed.
    pub fn even_cycles_to_pass(&mut self, cycles_max: u64) -> u64 {
        let each = self.channels.iter_mut().map(Channel::even_cycles);
        each.fold(cycles_max, u64::min)
    }

    /// Passes this number of cycles at once, at most the number that [`Servo::cycles_to_pass`] returns. The
    /// readings show the result after the next [`Servo::cycle`]. It is for simulated time: if nothing is sent
    /// meanwhile, the state equals that after executing the cycles, to the last bit.
    pub fn pass(&mut self, cycles: u64) {
        if cycles == 0 {
            return;
        }
        for channel in &mut self.channels {
            channel.pass(cycles, &mut self.commands);
        }
        self.cycles += cycles;
        self.exchange();
        for channel in &mut self.channels {
            channel.passed(&self.feedback);
        }
    }

    /// Returns the time of the last cycle, s: the number of cycles times the servo period. Returns 0 before
    /// the first cycle.
    pub fn time_s(&self) -> f64 {
        self.cycles as f64 * self.period_s
    }

    /// Returns the channel of an index, in the order given to [`Servo::new`].
    ///
    /// # Panics
    /// Panics if the channel does not exist.
    pub fn channel(&self, index: usize) -> &Channel {
        &self.channels[index]
    }

    /// Returns all channels, in the order given to [`Servo::new`].
    pub fn channels(&self) -> &[Channel] {
        &self.channels
    }
}

/// Returns the number of whole servo periods in a time.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a cast ends at the limits of the type"
)]
fn frames(time_s: f64, period_s: f64) -> u32 {
    (time_s / period_s) as u32
}
