//! The servo cycle over all channels.

use crate::channel::Channel;

/// All channels of the machine, cycled in lock-step.
#[derive(Debug)]
pub struct Servo {
    channels: Vec<Channel>,
    period_s: f64,
    cycles: u64,
}

impl Servo {
    /// The channels in the order of their coordinate systems, at time 0.
    pub fn new(channels: Vec<Channel>, servo_period_s: f64) -> Self {
        Self {
            channels,
            period_s: servo_period_s,
            cycles: 0,
        }
    }

    /// One servo cycle: time goes on by one period and each channel gives its setpoint. True when any channel put
    /// out an event, or is slower for want of more profiles. Never allocates, locks, waits or panics.
    pub fn cycle(&mut self) -> bool {
        self.cycles += 1;
        let time_s = self.time_s();
        let mut events = false;
        for channel in &mut self.channels {
            events |= channel.cycle(time_s);
        }
        events
    }

    /// Lets up to `cycles_max` cycles pass at once that would put out no event: every channel rests, dwells, or moves at
    /// a constant rate of its time base, with motors that follow without lag; its spindle keeps its speed. Gives how
    /// many have passed; the readings show them after the next [`Servo::cycle`]. For simulated time; a controller that
    /// is sent nothing meanwhile ends in the same state, to the last bit, as by as many cycles.
    pub fn pass(&mut self, cycles_max: u64) -> u64 {
        let each = self.channels.iter_mut().map(Channel::cycles_to_pass);
        let cycles = each.fold(cycles_max, u64::min);
        if cycles > 0 {
            for channel in &mut self.channels {
                channel.pass(cycles);
            }
            self.cycles += cycles;
        }
        cycles
    }

    /// Time of the last cycle: cycles times the servo period, s. 0 before the first.
    pub fn time_s(&self) -> f64 {
        self.cycles as f64 * self.period_s
    }

    /// The channel of an index, in the order given to [`Servo::new`].
    ///
    /// # Panics
    /// When there is no such channel.
    pub fn channel(&self, index: usize) -> &Channel {
        &self.channels[index]
    }

    /// All channels, in the order given to [`Servo::new`].
    pub fn channels(&self) -> &[Channel] {
        &self.channels
    }
}
