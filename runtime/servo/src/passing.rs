//! Simulated time skips cycles without an event. A position is a closed form of profile time, and in these
//! cycles profile time advances at a constant rate. So the result of the skipped cycles is known exactly, to
//! the last bit.

use tandem_model::AxisVector;
use tandem_model::flow::Path;
use tandem_model::profile::{Law, Profile};

use crate::bus::{Command, Feedback};
use crate::channel::{Channel, Hold};
use crate::rest::PathToRest;

/// Number of periods before the end of a profile that are never skipped, because of rounding and the cycle
/// that ends the profile.
const BEFORE_END: f64 = 2.0;

/// Number of cycles after a ramp that are always excluded from even motion. After these cycles, differences
/// of positions up to the third are constant.
const EVEN_CYCLES: f64 = 4.0;

/// Rounds down to whole cycles. Returns 0 for negative values and NaN.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a cast ends at the limits of the type"
)]
fn whole(cycles: f64) -> u64 {
    cycles as u64
}

impl Channel {
    /// Returns the number of further cycles that emit no event if no profile or control arrives. They change
    /// only the time, the angle of the spindle, and the position in the running profile.
    pub(crate) fn cycles_to_pass(&mut self) -> u64 {
        let is_steady = self.spindle_is_steady() && self.hold != Hold::ComingToRest;
        if self.reported || !self.controls.is_empty() || !is_steady {
            return 0;
        }
        let rests = self.velocity == AxisVector::ZERO && self.motors.has_settled();
        if self.is_idle() {
            return if rests { u64::MAX } else { 0 };
        }
        let is_old = |profile: &Profile| profile.epoch < self.epoch;
        let ends_or_drops = self.braking.is_some()
            || self.stopping.is_some()
            || self.splice.is_some()
            || self.thread.is_some()
            || self.ended_cycles.is_some()
            || self.profiles.peek().is_ok_and(is_old);
        match &self.current {
            Some(_) if ends_or_drops => 0,
            Some(_) if self.hold == Hold::AtRest && rests && self.time.rate() == 0.0 => u64::MAX,
            Some(_) => self.cycles_before_end(rests),
            None => 0,
        }
    }

    /// Returns in how many of these cycles each motor keeps the speed of the last few cycles: at rest, and
    /// between the ramps of a line.
    pub(crate) fn even_cycles(&mut self) -> u64 {
        let cycles = self.cycles_to_pass();
        let step_s = self.time.rate() * self.period_s;
        match self.current.as_ref().map(|profile| &profile.law) {
            None | Some(Law::Rest { .. }) => cycles,
            Some(_) if step_s == 0.0 => cycles,
            Some(Law::Ramped { block, .. }) if matches!(block.path, Path::Line { .. }) => {
                let even_from_s = block.start.duration_s() - block.begun_s + EVEN_CYCLES * step_s;
                let even_to_s = block.plan_s - block.stop.duration_s();
                let now_s = self.time.now_s();
                if now_s < even_from_s {
                    return 0;
                }
                cycles.min(whole((even_to_s - now_s) / step_s))
            }
            Some(_) => 0,
        }
    }

    /// Returns the number of cycles that a profile runs at a constant rate before its end.
    fn cycles_before_end(&mut self, rests: bool) -> u64 {
        if self.hold == Hold::AtRest {
            return 0;
        }
        let Some(profile) = &self.current else { return 0 };
        let follows = match &profile.law {
            Law::Skip { .. } | Law::Tap { .. } => false,
            Law::Rest { .. } => rests,
            _ => self.motors.are_ideal(),
        };
        let rate = self.time.rate();
        if !follows || rate <= 0.0 || rate.to_bits() != self.override_of(profile).to_bits() {
            return 0;
        }
        let last_s = profile.duration_s - BEFORE_END * rate * self.period_s;
        let cycles = whole((last_s - self.time.now_s()) / (rate * self.period_s));
        let way = PathToRest::new(profile, last_s, self.hold_slope, self.period_s);
        if cycles > 0 && way.is_steady(&mut self.profiles, rate) {
            cycles
        } else {
            0
        }
    }

    /// Writes the motors' commands of the last of these cycles. The caller passes at most the number that
    /// [`Channel::cycles_to_pass`] returned.
    pub(crate) fn pass(&mut self, cycles: u64, commands: &mut [Command]) {
        self.tracer.skip(cycles);
        if self.velocity == AxisVector::ZERO {
            self.still_cycles = self.still_cycles.saturating_add(cycles);
        }
        if !self.spindle_rests() {
            for _ in 0..cycles {
                self.cycle_spindle();
            }
        }
        if let Some(profile) = &self.current {
            self.time.pass(cycles);
            let step_s = self.time.rate() * self.period_s;
            let [now, one, two] =
                [0.0, 1.0, 2.0].map(|steps| profile.position(self.time.now_s() - steps * step_s));
            self.setpoint = now;
            self.history.replace([one, two]);
        }
        self.motors
            .command(self.setpoint, self.for_all_drives(), commands);
    }

    /// Processes the motors' reports of the last of the cycles.
    pub(crate) fn passed(&mut self, feedback: &[Feedback]) {
        self.motors.take_feedback(feedback);
    }
}
