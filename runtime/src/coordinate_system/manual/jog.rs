//! Jogging: one axis moves while refreshes of its client arrive, or by a given distance. Limits of the motor and soft
//! limits apply.

use std::sync::Arc;

use plc_protocol::types::command::{Command, CommandMeta, Verb};
use plc_protocol::types::request::{Refusal, RefusalCode};
use tandem_model::Origin;
use tandem_store::program_store::StoredProgram;

use crate::command_memory::{CommandContent, CommandLookup, memory_is_full};
use crate::coordinate_system::CoordinateSystem;
use crate::coordinate_system::commands::pending_commands::DeferredCommand;
use crate::coordinate_system::run::active_run::{ActiveRun, ActiveRunKind, Jog};
use crate::coordinate_system::run::causes::{EarlyEndCause, JogStop};
use crate::coordinate_system::run::run_state::{Phase, Then};

/// Time in s after the last refresh at which a jog stops, because its client may be lost.
pub(crate) const REFRESH_S: f64 = 0.2;

/// End point of a jog on an axis without soft limit, in mm or degrees: the largest value of a program word.
const DISTANCE_MAX: f64 = 1_000_000.0;

/// Distance in mm or degrees below which a jog is not a motion.
pub(crate) const DISTANCE_MIN: f64 = 1e-9;

impl CoordinateSystem {
    pub(crate) fn prepare_jog(
        &self,
        axis: char,
        velocity: f64,
        distance: Option<f64>,
        refresh_id: &str,
    ) -> Result<ActiveRun, Refusal> {
        let axis = self.axis_of(axis)?;
        let wrong = |text: String| Err(Refusal::new(RefusalCode::Invalid, text));
        if !velocity.is_finite() || velocity == 0.0 {
            return wrong(format!("velocity {velocity}: write mm/min or deg/min, not 0"));
        }
        if let Some(distance) = distance.filter(|distance| !(DISTANCE_MIN..=DISTANCE_MAX).contains(distance))
        {
            return wrong(format!(
                "distance {distance}: write more than 0, at most {DISTANCE_MAX}"
            ));
        }
        if self.past.jogs.has_ended(refresh_id, self.context.now_s()) {
            let text = format!("the jog {refresh_id:.64} has ended; begin a new one with another refresh_id");
            return Err(Refusal::new(RefusalCode::NotAllowed, text));
        }
        let mut settings = self.context.configured.settings.clone();
        let Some(motor) = settings.motors.get_mut(axis.index()).and_then(Option::as_mut) else {
            return wrong(format!("axis {} has no motor", axis.letter()));
        };
        motor.rapid_velocity = (velocity.abs() / 60.0).min(motor.max_velocity);
        motor.rapid_acceleration = motor.rapid_acceleration.min(motor.max_acceleration);
        let limits = motor.soft_limits;
        let from = self.pipeline.path.position().0;
        let way = distance.unwrap_or(DISTANCE_MAX).copysign(velocity);
        let wanted = from[axis] + way;
        let end = match limits {
            Some([_, high]) if velocity > 0.0 => wanted.min(high),
            Some([low, _]) => wanted.max(low),
            None => wanted,
        };
        if (end - from[axis]) * velocity.signum() < DISTANCE_MIN {
            let text = format!("axis {} is at its soft limit; jog the other way", axis.letter());
            return Err(Refusal::new(RefusalCode::NotAllowed, text));
        }
        let mut to = from;
        to[axis] = end;
        let is_step = distance.is_some_and(|distance| distance <= self.context.shared.machine.jog_step_max);
        let jog = Jog {
            refresh_id: refresh_id.to_owned(),
            axis,
            distance,
            until_s: (!is_step).then(|| self.context.now_s() + REFRESH_S),
            to,
            settings: Arc::new(settings),
        };
        let nothing = Arc::new(StoredProgram::manual(
            "",
            self.context.configured.text_rules(),
            false,
        ));
        Ok(self.new_run(ActiveRunKind::Jog(jog), nothing, &self.context.shared.store.all()))
    }

    /// Stores a command that begins a jog in the command memory. Refreshes are not stored, because they would fill the
    /// memory.
    pub(crate) fn remember_jog(&self, command: &DeferredCommand) -> Result<(), Refusal> {
        if !matches!(command.command, Command::Jog { .. }) {
            return Ok(());
        }
        let asked = CommandContent::command(self.context.number, &command.command, &command.meta.client_id);
        match self.context.shared.recall(&command.meta.memory, asked) {
            CommandLookup::Full => Err(memory_is_full()),
            _ => Ok(()),
        }
    }

    /// Plans the motion of a new jog and returns the next phase of its run.
    pub(crate) fn start_jog(&mut self, jog: &Jog) -> Phase {
        match self.pipeline.jog(&jog.settings, jog.to) {
            Ok(()) => Phase::Standstill(Then::End(Origin::default())),
            Err(alarm) => Phase::Standstill(Then::Alarm(alarm)),
        }
    }

    /// Returns the active jog if its client gave it this name.
    fn running_jog(&mut self, refresh_id: &str) -> Option<&mut Jog> {
        match &mut self.state.run_mut()?.kind {
            ActiveRunKind::Jog(jog) if jog.refresh_id == refresh_id => Some(jog),
            _ => None,
        }
    }

    /// Refuses a refresh if it is under another lease, or if its time limit (`not_after`) has passed.
    fn authorize_refresh(&self, meta: &CommandMeta) -> Result<(), Refusal> {
        self.context.shared.check_not_after(meta.not_after.as_ref())?;
        self.authorize_by_lease(Verb::Jog, meta)
    }

    /// Returns true if the command needs no run: it refreshes the active jog, or ends a jog that is not active.
    pub(crate) fn needs_no_run(&mut self, command: &Command, meta: &CommandMeta) -> bool {
        let until_s = self.context.now_s() + REFRESH_S;
        match command {
            Command::Jog { refresh_id, .. } if self.authorize_refresh(meta).is_ok() => self
                .running_jog(refresh_id)
                .map(|jog| jog.until_s = jog.until_s.map(|_| until_s))
                .is_some(),
            Command::JogEnd { refresh_id } if self.running_jog(refresh_id).is_none() => {
                self.past
                    .jogs
                    .mark_ended(&meta.memory.user, refresh_id, self.context.now_s());
                true
            }
            _ => false,
        }
    }

    /// Returns the time in s at which the active jog stops if no refresh arrives.
    pub(crate) fn jog_until_s(&self) -> Option<f64> {
        match &self.state.run()?.kind {
            ActiveRunKind::Jog(jog) => jog.until_s,
            _ => None,
        }
    }

    /// Stops a jog whose refreshes have ended, with the motor's highest deceleration.
    pub(crate) fn expire_jog(&mut self, now_s: f64) {
        if self.jog_until_s().is_some_and(|until_s| until_s <= now_s + 1e-9) {
            self.end_run(EarlyEndCause::JogEnded(JogStop::NotRefreshed));
        }
    }
}
