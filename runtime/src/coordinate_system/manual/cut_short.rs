//! Runs by hand (MDI, homing, jog) that end early. Their commands are answered `failed`, with the distance covered and
//! the reason.

use std::collections::BTreeMap;

use tandem_model::settings::MotorKind;
use tandem_model::{AxisSet, AxisVector};

use super::jog::{DISTANCE_MIN, REFRESH_S};
use crate::coordinate_system::CoordinateSystem;
use crate::coordinate_system::commands::pending_commands::{Awaiting, CommandFailure};
use crate::coordinate_system::run::active_run::{ActiveRun, ActiveRunKind, Restores};
use crate::coordinate_system::run::causes::{Cause, EarlyEndCause, JogStop};

/// Rounding of distances in a reply, in steps per mm or degree (1 nm). Reason: sums of floating-point numbers differ in
/// their last digits.
const DIGITS: f64 = 1e6;

/// Data of a run that was ended early, for the time when the machine rests.
#[derive(Debug, Default)]
pub(crate) struct RunRemainder {
    /// `None` unless the commands of the run receive the distance covered.
    pub cut_short: Option<CutShort>,
    /// State to restore after a macro.
    pub restores: Option<Box<Restores>>,
}

/// Run by hand that was ended early.
#[derive(Debug)]
pub(crate) struct CutShort {
    code: &'static str,
    /// Cause of the end, and advice for the operator.
    reason: String,
    from: AxisVector,
    /// Commanded distance of a jog, in mm or degrees.
    distance: Option<f64>,
}

impl CutShort {
    /// Returns `None` for the run of a program, and for a jog without distance that its client ends or no longer
    /// refreshes.
    /// `alarm` is the text of the last alarm.
    pub fn new(run: &ActiveRun, why: EarlyEndCause, alarm: &str) -> Option<Self> {
        let distance = match &run.kind {
            ActiveRunKind::Program => return None,
            ActiveRunKind::Manual | ActiveRunKind::Home => None,
            ActiveRunKind::Jog(jog) => jog.distance,
        };
        let commanded = matches!(
            why,
            EarlyEndCause::JogEnded(JogStop::Commanded | JogStop::NotRefreshed)
        );
        if commanded && distance.is_none() {
            return None;
        }
        let (code, reason) = reason_of(why, alarm);
        Some(Self {
            code,
            reason,
            from: run.from,
            distance,
        })
    }
}

/// Returns code and text of the reason why a run by hand was ended.
fn reason_of(why: EarlyEndCause, alarm: &str) -> (&'static str, String) {
    let (code, text) = match why {
        EarlyEndCause::Stop => ("stop", "a stop command ended the motion"),
        EarlyEndCause::Abort => ("aborted", "an abort command ended the motion"),
        EarlyEndCause::Reset { .. } => ("reset", "a reset ended the motion"),
        EarlyEndCause::Alarm => return ("alarm", format!("alarm {alarm}")),
        EarlyEndCause::JogEnded(JogStop::Commanded) => ("ended", "the end of the jog was commanded"),
        EarlyEndCause::JogEnded(JogStop::NotRefreshed) => {
            let ms = REFRESH_S * 1000.0;
            let text = format!(
                "no refresh arrived within {ms} ms; repeat the jog more often, or move in steps of at most jog_step_max"
            );
            return ("not_refreshed", text);
        }
        EarlyEndCause::JogEnded(JogStop::Held(cause)) => match cause {
            Cause::Operator | Cause::SingleBlock | Cause::WayBackEnded => ("hold", "a hold ended the motion"),
            Cause::Interlock => ("interlock", "the interlock was set"),
            Cause::BusLoss => ("bus_lost", "the connection to the MQTT broker was lost"),
            Cause::ServoLate => ("servo_late", "the servo was late"),
            Cause::ClientLost => ("client_lost", "a client that is watched was lost"),
        },
    };
    (code, text.to_owned())
}

impl CoordinateSystem {
    /// Returns the data of the active run that are used when the machine rests after an early end; empty if no run is
    /// active.
    pub(crate) fn remainder_of_run(&mut self, why: EarlyEndCause) -> RunRemainder {
        let alarm = &self.past.alarm;
        let run = self.state.run_mut();
        run.map_or_else(RunRemainder::default, |run| RunRemainder {
            cut_short: CutShort::new(run, why, alarm),
            restores: run.restores.take(),
        })
    }

    /// Answers the commands of the run by hand that was ended early. Called when the machine rests.
    pub(crate) fn answer_cut_short(&mut self, cut_short: Option<CutShort>) {
        let failure = cut_short.map(|cut| self.failure(cut.code, &cut.reason, cut.from, cut.distance));
        self.answer_run_by_hand(failure.as_ref());
    }

    /// Answers the commands of a run by hand that was not ended early.
    pub(crate) fn answer_completed_run(&mut self, run: &ActiveRun) {
        let failure = self.shortfall(run);
        self.answer_run_by_hand(failure.as_ref());
    }

    fn answer_run_by_hand(&mut self, failure: Option<&CommandFailure>) {
        self.publish_changes();
        self.commands.answer(&self.context, &Awaiting::is_of_run, failure);
    }

    /// Returns a failure if a completed run missed its goal: the distance of a jog, or the touch of a G31.
    fn shortfall(&self, run: &ActiveRun) -> Option<CommandFailure> {
        match &run.kind {
            ActiveRunKind::Program | ActiveRunKind::Home => None,
            ActiveRunKind::Jog(jog) => {
                let distance = jog.distance?;
                let covered = (jog.to[jog.axis] - run.from[jog.axis]).abs();
                let reason = "the axis is at its soft limit; jog it the other way";
                (distance - covered > DISTANCE_MIN)
                    .then(|| self.failure("limit", reason, run.from, Some(distance)))
            }
            ActiveRunKind::Manual => {
                let missed = run.missed_touch?;
                let reason = format!(
                    "the G31 in line {} ended without a touch; check the probe and the searched position",
                    missed.line
                );
                Some(self.failure("no_touch", &reason, run.from, None))
            }
        }
    }

    fn failure(
        &self,
        code: &'static str,
        reason: &str,
        from: AxisVector,
        distance: Option<f64>,
    ) -> CommandFailure {
        let at = self.pipeline.path.position().0;
        let settings = &self.context.configured.settings;
        let (mut moved, mut words) = (BTreeMap::new(), Vec::new());
        let of = distance.map_or_else(String::new, |distance| format!(" of {distance:.3}"));
        for axis in settings.axes().iter() {
            let covered = ((at[axis] - from[axis]) * DIGITS).round() / DIGITS;
            if covered == 0.0 {
                continue;
            }
            let motor = settings.motors[axis.index()].as_ref();
            let is_rotary = motor.is_some_and(|motor| motor.kind == MotorKind::Rotary);
            let unit = if is_rotary { "degrees" } else { "mm" };
            words.push(format!("{} {covered:.3}{of} {unit}", axis.letter()));
            moved.insert(axis.letter(), covered);
        }
        let words = if words.is_empty() {
            "nothing".to_owned()
        } else {
            words.join(", ")
        };
        CommandFailure {
            code,
            text: format!("the motion covered {words}: {reason}"),
            moved,
        }
    }

    /// Notes the line of a G31 that ended without a touch.
    pub(crate) fn note_touch(&mut self, captured: AxisSet) {
        let executing = self.context.view.executing();
        if let Some(run) = self.state.run_mut()
            && captured.is_empty()
        {
            run.missed_touch.get_or_insert(executing);
        }
    }
}
