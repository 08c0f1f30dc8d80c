//! One servo cycle of one channel: controls, setpoints, feedback, in-position check, events, readings.
//!
//! Order within a cycle: The channel takes controls. The running profile advances, or the next profile gives
//! its start point. The bus exchanges commands and feedback of all channels. Events report the profiles that
//! have stopped. So in one cycle a profile gives its end point and, with an ideal drive, is in position. The
//! next profile gives its start point in the following cycle (M1c).

use tandem_model::flow::TapLeg;
use tandem_model::profile::{Law, Profile, TimeBase};
use tandem_model::{Axis, AxisVector, MachinePosition, Origin};

use crate::bus::{Command, Feedback};
use crate::channel::{Channel, Hold};
use crate::control::{Control, Event, Fault};
use crate::jerk_slew::has_jerk_limit;
use crate::motors::first_jump;
use crate::rest::{self, PathToRest};
use crate::setpoint_history::History;
use crate::skip::SkipRun;
use crate::spindle::ThreadStep;
use crate::splice::APPROACH;

/// Number of controls that the channel takes in one cycle; further controls wait for the next cycle.
const CONTROLS_PER_CYCLE: usize = 16;

/// Number of profiles of an old epoch that the channel discards in one cycle. This limits the time of the
/// cycle.
const DROPS_PER_CYCLE: usize = 64;

/// Number of profiles that the motion passes without a stop in one cycle. This limits the time of the cycle;
/// a chain of shorter blocks is slower than F. Look-ahead plans far fewer profiles for a period: up to 192
/// blocks, or some hundred profiles of one steep corner.
const JOINTS_PER_CYCLE: usize = 4096;

/// Number of free slots of the event ring that must exist before the channel starts an action with events.
/// All of `Started`, `Captured`, `Finished` or `Fault`, `Late`, `Held`, `Stopped`, `Spliced`, `Oriented` and
/// `SpindleReached` may be pending at once.
const EVENTS_RESERVE: usize = 9;

/// Share of a servo period: if less time is left, a profile has ended. The rest is rounding.
const END_TOLERANCE: f64 = 1e-6;

impl Channel {
    /// Executes the first half of a servo cycle at this time: writes the commands of the motors.
    pub(crate) fn command(&mut self, time_s: f64, commands: &mut [Command]) {
        self.rests = self.stays_at_rest();
        if self.rests {
            self.still_cycles = self.still_cycles.saturating_add(1);
            self.history = History::at_rest(self.setpoint);
        } else {
            self.move_on(time_s);
            self.motors
                .command(self.setpoint, self.for_all_drives(), commands);
        }
    }

    fn move_on(&mut self, time_s: f64) {
        self.reported = false;
        let before = self.setpoint;
        self.take_controls();
        self.drop_older();
        if let Some(brake) = &mut self.braking {
            let (position, at_rest) = brake.cycle(self.period_s);
            self.setpoint = position;
            if at_rest {
                self.braking = None;
            }
        } else if self.current.is_some() {
            self.advance_profile(time_s);
        } else {
            self.start_from_rest(time_s);
        }
        self.history.push(before);
        self.executing = self.current.as_ref().map(|profile| profile.origin);
        self.time_base = self.current.as_ref().map(|profile| profile.law.time_base());
        self.velocity = self.setpoint.minus(before).scaled(1.0 / self.period_s);
        self.still_cycles = if self.velocity == AxisVector::ZERO {
            self.still_cycles.saturating_add(1)
        } else {
            0
        };
        self.turn_spindle();
    }

    /// Executes the second half of a servo cycle: processes the reports of the motors. Returns true if the
    /// cycle emitted an event, or was slowed down by a lack of profiles. `bus_lost` is the number of
    /// consecutive lost frames, if it exceeds the permitted number.
    pub(crate) fn conclude(&mut self, time_s: f64, feedback: &[Feedback], bus_lost: Option<u32>) -> bool {
        self.motors.take_feedback(feedback);
        self.keep_trace(time_s);
        self.bus_lost = bus_lost;
        if !self.is_as_commanded() {
            self.rests = false;
            self.watch_drives();
        }
        if !self.rests {
            self.check_skip_inputs();
            self.check_in_position(time_s);
            self.report_rest();
        }
        // also at rest, because its drive may fail, and before its first command
        self.cycle_spindle();
        if self.rests {
            if self.motors.has_settled() {
                self.readings.write_time(time_s);
            } else {
                self.publish(time_s);
            }
            return false;
        }
        self.publish(time_s);
        self.reported
    }

    /// Returns true if the channel only exchanges data with the drives: nothing moves, and no motion or
    /// control is pending.
    fn stays_at_rest(&self) -> bool {
        // A channel at rest stays at rest until a profile or a control arrives.
        self.profiles.is_empty()
            && self.controls.is_empty()
            && self.motors.has_settled()
            && (self.rests || self.has_come_to_rest())
    }

    fn has_come_to_rest(&self) -> bool {
        self.is_idle()
            && !self.reported
            && self.executing.is_none()
            && self.hold != Hold::ComingToRest
            && self.velocity == AxisVector::ZERO
            && self.spindle_rests()
            && self.thread.is_none()
    }

    /// Turns the spindle in step with the motion of a thread, including dwell and deceleration.
    fn turn_spindle(&mut self) {
        let (Some(spindle), Some(_)) = (&mut self.spindle, self.thread) else {
            return;
        };
        let t_s = match self.ended_cycles {
            Some(_) => f64::INFINITY,
            None => self.time.now_s(),
        };
        let profile = self.current.as_ref();
        let revolutions = profile.and_then(|profile| profile.spindle_revolutions(t_s));
        spindle.follow(ThreadStep::Turn(revolutions));
    }

    fn take_controls(&mut self) {
        for _ in 0..CONTROLS_PER_CYCLE {
            if self.events.slots() < EVENTS_RESERVE {
                return;
            }
            let Ok(control) = self.controls.pop() else { return };
            self.obey(control);
        }
    }

    fn obey(&mut self, control: Control) {
        match control {
            Control::Hold | Control::HoldAfterBlock(_) if self.stopping.is_some() || self.hold.holds() => {}
            Control::Hold => self.hold = Hold::ComingToRest,
            Control::HoldInPhase => self.hold_in_phase(),
            Control::HoldAfterBlock(true) => self.hold = Hold::AfterBlock,
            Control::HoldAfterBlock(false) | Control::Resume => self.end_hold(),
            Control::Stop { epoch } => self.stopping = self.stopping.max(Some(epoch)),
            Control::Abort { epoch } => {
                self.stopping = self.stopping.max(Some(epoch));
                if self.braking.is_none() {
                    self.begin_braking();
                    self.leave_thread(true);
                    self.abandon_profile();
                }
            }
            Control::Override { feed, rapid } => {
                if feed.is_finite() {
                    self.feed_override = feed.clamp(0.0, 2.0);
                }
                if rapid.is_finite() {
                    self.rapid_override = rapid.clamp(0.0, 1.0);
                }
            }
            Control::ResetDrives => self.ask_for_reset(),
            Control::Splice => self.take_splice(),
            Control::SkipInput { motor, on } => self.motors.set_skip_input(motor, on),
            Control::Spindle { direction, rpm } => match &mut self.spindle {
                Some(spindle) => spindle.command(direction, rpm),
                None => self.report_event(Event::Fault(Fault::SpindleMissing)),
            },
            Control::AwaitSpindle { id, within } => match &mut self.spindle {
                Some(spindle) => spindle.await_target(id, within),
                None => self.report_event(Event::Fault(Fault::SpindleMissing)),
            },
        }
    }

    fn drop_older(&mut self) {
        for _ in 0..DROPS_PER_CYCLE {
            match self.profiles.peek() {
                Ok(profile) if profile.epoch < self.epoch => self.profiles.discard(),
                _ => return,
            }
        }
    }

    /// Starts the next profile from rest if this is allowed. The start point of the profile is the setpoint.
    fn start_from_rest(&mut self, time_s: f64) {
        if self.is_held() || self.faulted || self.stopping.is_some() || self.events.slots() < EVENTS_RESERVE {
            return;
        }
        if !self.may_begin() || !self.has_next() || !self.has_power() || !self.has_spindle() {
            return;
        }
        let Ok(profile) = self.profiles.pop() else { return };
        if let Some((axis, jump)) = first_jump(&profile, self.setpoint) {
            let motor = self.motors.number(axis);
            self.fail(Fault::PositionJump { motor, axis, jump });
            return;
        }
        if let Law::Tap { leg, .. } = &profile.law
            && let Err(fault) = self.enter_thread(*leg)
        {
            self.fail(fault);
            return;
        }
        // From rest no slew is needed: the time base starts at the override, or at the largest rate from
        // which the motion can stop again.
        let wanted = self.override_of(&profile);
        let way = PathToRest::new(&profile, 0.0, self.hold_slope, self.period_s);
        let factor = way.target(&mut self.profiles, 0.0, wanted);
        let factor = factor.filter(|_| profile.begins_at_its_rate());
        self.time.start_profile(factor.unwrap_or(0.0), 0.0);
        self.last_segment = profile.segment;
        self.report_event(Event::Started {
            segment: profile.segment,
            origin: profile.origin,
            base: profile.law.time_base(),
            time_s,
        });
        self.current = Some(profile);
        self.ended_cycles = None;
        self.skip = SkipRun::default();
        self.sample(time_s, 0.0);
    }

    /// Returns true if the next profile is not a move in a thread, or if the spindle's drive has power to
    /// follow this move.
    fn has_spindle(&mut self) -> bool {
        match (self.profiles.peek().map(|next| &next.law), &mut self.spindle) {
            (Ok(Law::Tap { .. }), Some(spindle)) => spindle.has_power(),
            _ => true,
        }
    }

    /// Makes the spindle follow the motion from now on. At the start of a thread the spindle must be at rest.
    fn enter_thread(&mut self, leg: TapLeg) -> Result<(), Fault> {
        if let Some(spindle) = &mut self.spindle {
            if leg == TapLeg::In && !spindle.rests() {
                let rpm = spindle.state().rpm;
                return Err(Fault::SpindleTurns { rpm });
            }
            spindle.follow(ThreadStep::Begin);
        }
        self.thread = Some(leg);
        Ok(())
    }

    /// Ends the following of the spindle. The spindle is at rest, or with `brakes` decelerates to rest.
    pub(crate) fn leave_thread(&mut self, brakes: bool) {
        if self.thread.take().is_some()
            && let Some(spindle) = &mut self.spindle
        {
            spindle.follow(ThreadStep::End { brakes });
        }
    }

    /// Returns true if a chain may begin: if it can stop within the queued profiles, or if at least half of
    /// the ring is full. Reason for the second condition: further profiles may only arrive after the chain
    /// moves.
    fn may_begin(&mut self) -> bool {
        2 * self.profiles.slots() >= self.profiles.capacity()
            || rest::is_known(
                &mut self.profiles,
                self.feed_override,
                self.hold_slope,
                self.period_s,
            )
    }

    /// Returns true if a profile of a current epoch waits.
    fn has_next(&self) -> bool {
        self.profiles
            .peek()
            .is_ok_and(|profile| profile.epoch >= self.epoch)
    }

    /// Makes the next profile the current profile, if a profile waits.
    fn take_next(&mut self) {
        self.current = None;
        // The profile is moved directly from the ring, because it is large.
        if self.has_next()
            && let Ok(profile) = self.profiles.pop()
        {
            self.current = Some(profile);
        }
    }

    /// Advances the running profile by one cycle of its time base.
    fn advance_profile(&mut self, time_s: f64) {
        if let Some(cycles) = &mut self.ended_cycles {
            *cycles += 1;
            return;
        }
        let Some(profile) = &self.current else { return };
        let rate = self.time.rate();
        let held = self.is_held() || self.stopping.is_some();
        let wanted = if held { 0.0 } else { self.override_of(profile) };
        let way = PathToRest::new(profile, self.time.now_s(), self.hold_slope, self.period_s);
        let allowed = way.target(&mut self.profiles, rate, wanted);
        if allowed != Some(wanted) {
            // The coordinator then checks whether the ring has room for more profiles.
            self.reported = true;
            // The queued profiles take less time than the reserve, and a full ring accepts no further profile.
            // Run one block per cycle; a block is too short to affect any motor.
            if rate == 0.0 && allowed == Some(0.0) && self.has_next() {
                let end_s = profile.duration_s;
                self.time.carry_over(end_s);
                return self.sample(time_s, end_s);
            }
        }
        let (target, slope) = match allowed {
            None => (0.0, way.slope),
            Some(target) if held => (target, self.hold_slope),
            Some(target) => match &profile.law {
                Law::Paced { .. } => (target, self.paced_override_slope),
                _ => (target, self.override_slope),
            },
        };
        // If the motion needs all known profiles to come to rest, only the accelerations limit its stop.
        let is_soft = allowed.is_some() && has_jerk_limit(profile);
        let slope = match &profile.law {
            // Nothing moves, so no slew is needed: a dwell stops and continues at once.
            Law::Rest { .. } => f64::INFINITY,
            Law::Tap {
                rate, revolutions, ..
            } => {
                let rpm = rate * revolutions * 60.0;
                let spindle = self.spindle.as_ref().map(|spindle| spindle.steepest_slope(rpm));
                slope.min(spindle.unwrap_or(f64::INFINITY))
            }
            Law::Paced { pace, .. } => {
                let slope = slope / pace.feed_override;
                slope.min(self.room_to(target))
            }
            Law::Motors { .. } | Law::Skip { .. } => slope.min(self.room_to(target)),
            // If the motion needs all known profiles to come to rest, it must not slow down later.
            Law::Ramped { .. } if allowed.is_some() && target.total_cmp(&rate).is_ne() => {
                slope.min(self.room_on_ramps(target))
            }
            Law::Ramped { .. } => slope,
        };
        let t_s = if is_soft && self.limits_slew(target) {
            let factor = self.factor_within_jerk(target, slope);
            self.time.step(factor)
        } else {
            self.time.advance(target, slope)
        };
        self.sample(time_s, t_s);
    }

    /// Returns true if feed hold acts. In a thread, only [`Control::HoldInPhase`] acts.
    fn is_held(&self) -> bool {
        self.hold.holds() && self.may_hold()
    }

    fn may_hold(&self) -> bool {
        self.thread.is_none() || self.holds_in_thread
    }

    /// Begins a feed hold that also acts in a thread.
    pub(crate) fn hold_in_phase(&mut self) {
        self.hold = Hold::ComingToRest;
        self.holds_in_thread = true;
        self.rests = false;
    }

    fn end_hold(&mut self) {
        self.hold = Hold::Off;
        self.holds_in_thread = false;
    }

    /// Sets the setpoint at a profile time. After the end of a profile without a stop, the setpoint is within
    /// the next profile.
    fn sample(&mut self, time_s: f64, t_s: f64) {
        let mut t_s = t_s;
        for _ in 0..JOINTS_PER_CYCLE {
            let Some(profile) = &self.current else { return };
            if let Some(joint) = self.joint(profile)
                && t_s >= joint.at_s
                && self.switch_over(joint, t_s - joint.at_s)
            {
                t_s = self.time.now_s();
                continue;
            }
            let Some(profile) = &self.current else { return };
            let left_s = self.skip.duration_s(profile) - t_s;
            let is_last = || !profile.exact_stop && !self.has_next();
            if left_s > END_TOLERANCE * self.period_s || (left_s > 0.0 && is_last()) {
                let position = self.skip.position(profile, t_s);
                self.move_to(position);
                return;
            }
            let end = self.skip.end_position(profile);
            if profile.exact_stop {
                self.setpoint = end;
                self.ended_cycles = Some(0);
                return;
            }
            let (segment, before) = (profile.segment, profile.origin);
            self.take_next();
            let Some(next) = &self.current else {
                self.report_joint(Event::Finished { segment, time_s });
                self.setpoint = end;
                return self.brake_for(Fault::RanOut { segment });
            };
            let (next_segment, origin, base) = (next.segment, next.origin, next.law.time_base());
            self.hold_after_block(before, Some(origin));
            self.setpoint = end;
            // A block may have several profiles.
            if next_segment != segment {
                self.report_joint(Event::Finished { segment, time_s });
                self.last_segment = next_segment;
                self.report_joint(Event::Started {
                    segment: next_segment,
                    origin,
                    base,
                    time_s,
                });
            }
            t_s = -left_s;
            self.time.carry_over(t_s);
        }
        // The remaining time is discarded. If it were added later, the motion would jump.
        self.time.carry_over(0.0);
    }

    /// Sets the setpoint. A position that is not a number is never commanded: the channel stops with
    /// a fault.
    fn move_to(&mut self, position: AxisVector) {
        let not_finite = Axis::ALL.into_iter().find(|&axis| !position[axis].is_finite());
        if let Some(axis) = not_finite {
            let (motor, jump) = (self.motors.number(axis), position[axis]);
            self.fail(Fault::PositionJump { motor, axis, jump });
        } else {
            self.setpoint = position;
        }
    }

    /// Returns the override of a profile. For a paced profile, returns the share of the override for which
    /// its pace was planned, which is the largest that the motors allow.
    pub(crate) fn override_of(&self, profile: &Profile) -> f64 {
        match (profile.law.time_base(), &profile.law) {
            (_, Law::Paced { pace, .. }) => {
                let share = (self.feed_override / pace.feed_override).min(1.0);
                if self.splice.is_some() {
                    share * APPROACH
                } else {
                    share
                }
            }
            (TimeBase::Feed, _) => self.feed_override,
            (TimeBase::Rapid, _) => self.rapid_override,
            (TimeBase::Fixed, _) => 1.0,
        }
    }

    /// Turns back the motors of a G31 whose input has switched on; they brake from the next cycle on. A motor
    /// that is beyond its threshold at the start stays there.
    fn check_skip_inputs(&mut self) {
        let Some(profile) = &self.current else { return };
        if !matches!(profile.law, Law::Skip { .. }) {
            return;
        }
        let t_s = self.time.now_s();
        for axis in Axis::ALL {
            if !self.skip.seeks(profile, axis) {
                continue;
            }
            if let Some((captured, limits)) = self.motors.skip(axis, t_s == 0.0) {
                self.skip.turn_back(profile, axis, t_s, captured, limits);
                self.ended_cycles = None;
            }
        }
    }

    fn check_in_position(&mut self, time_s: f64) {
        let (Some(cycles), Some(profile)) = (self.ended_cycles, &self.current) else {
            return;
        };
        let (segment, origin) = (profile.segment, profile.origin);
        let is_skip = matches!(profile.law, Law::Skip { .. });
        let waited_s = cycles as f64 * self.period_s;
        match self.motors.in_position(self.setpoint, waited_s) {
            Ok(true) => {}
            Ok(false) => return,
            Err(fault) => return self.fail(fault),
        }
        if is_skip {
            self.report_event(Event::Captured {
                segment,
                position: MachinePosition(self.setpoint),
                captured: self.skip.captured(),
            });
        }
        if self.thread == Some(TapLeg::Out) {
            self.leave_thread(false);
        }
        self.abandon_profile();
        self.report_event(Event::Finished { segment, time_s });
        let next = self.profiles.peek().ok().map(|next| next.origin);
        self.hold_after_block(origin, next);
    }

    /// Begins a feed hold between two profiles if a hold at the end of this block was commanded.
    fn hold_after_block(&mut self, ended: Origin, next: Option<Origin>) {
        if self.hold == Hold::AfterBlock && next != Some(ended) {
            self.hold = Hold::ComingToRest;
        }
    }

    /// Reports that feed hold or a stop has brought the commanded motion to rest.
    fn report_rest(&mut self) {
        let resting = self.time.rate() == 0.0 || self.ended_cycles.is_some();
        if self.braking.is_some() || (self.current.is_some() && !resting) {
            return;
        }
        if let Some(epoch) = self.stopping.take() {
            self.abandon_splice();
            self.epoch = self.epoch.max(epoch);
            self.abandon_profile();
            self.leave_thread(false);
            self.end_hold();
            self.faulted = false;
            self.reset_drives();
            self.report_event(Event::Stopped {
                epoch,
                position: MachinePosition(self.setpoint),
            });
        } else if self.hold == Hold::ComingToRest && self.may_hold() {
            self.hold = Hold::AtRest;
            self.report_event(Event::Held { at: self.place() });
        }
    }

    pub(crate) fn fail(&mut self, fault: Fault) {
        self.abandon_profile();
        self.leave_thread(false);
        self.faulted = true;
        self.report_event(Event::Fault(fault));
    }

    /// Abandons the current profile, which has ended or will not continue.
    pub(crate) fn abandon_profile(&mut self) {
        self.left_at_s = self.place().plan_s;
        self.current = None;
        self.ended_cycles = None;
    }

    /// Emits an event. [`EVENTS_RESERVE`] ensures that the ring has room.
    pub(crate) fn report_event(&mut self, event: Event) {
        self.reported |= self.events.push(event).is_ok();
    }

    /// Emits an event at a joint. The motion cannot wait at a joint, so the channel omits the event if the
    /// ring has less room than the reserve.
    pub(crate) fn report_joint(&mut self, event: Event) {
        if self.events.slots() >= EVENTS_RESERVE {
            self.report_event(event);
        }
    }
}
