//! Conditions that prevent a start. They are published on each change, so that screens, tiles of other machines and
//! Start buttons show the same list.

use std::sync::Arc;

use plc_protocol::lock_input::LockInput;
use plc_protocol::types::command::{CommandMeta, Verb};
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::request::Refusal;
use plc_protocol::types::start::{StartConditions, StartObstacle, StartObstacleKind};
use plc_protocol::types::topic::CsTopic;
use tandem_config::UnhandledReaction;
use tandem_store::program_store::StoredProgram;

use crate::coordinate_system::CoordinateSystem;
use crate::coordinate_system::publish::view::Prediction;

/// The start conditions published last, and the inputs from which they were computed.
#[derive(Debug, Default)]
pub(crate) struct PublishedStart {
    inputs: Option<StartInputs>,
    /// Time in s since the start at which the next absent handler is no longer expected to return.
    absence_ends_s: Option<f64>,
    conditions: Option<StartConditions>,
    /// Program number that was checked last, number of program changes in the store then, and reason for a refusal.
    checked: Option<(u16, u64, Option<String>)>,
}

/// Inputs of the start conditions. Equal inputs give equal conditions, so they are computed only after a change.
#[derive(Debug)]
struct StartInputs {
    state: Option<Arc<Message>>,
    locks: [Option<String>; 2],
    fence: Option<u64>,
    prediction: Option<Arc<Prediction>>,
    /// Number of program changes in the store.
    changes: u64,
    /// Open question about stored files.
    stored_data: Option<String>,
}

impl StartInputs {
    fn is_same(&self, other: &Self) -> bool {
        let is_same_state = match (&self.state, &other.state) {
            (Some(one), Some(other)) => Arc::ptr_eq(one, other),
            (one, other) => one.is_none() && other.is_none(),
        };
        let is_same_prediction = match (&self.prediction, &other.prediction) {
            (Some(one), Some(other)) => Arc::ptr_eq(one, other),
            (one, other) => one.is_none() && other.is_none(),
        };
        let others = |inputs: &Self| (inputs.fence, inputs.changes);
        is_same_state
            && is_same_prediction
            && others(self) == others(other)
            && self.locks == other.locks
            && self.stored_data == other.stored_data
    }
}

impl CoordinateSystem {
    /// Discards the computed conditions when a handler came online or was lost, because the served M codes may differ.
    pub(crate) fn forget_start_conditions(&mut self) {
        self.published.start.inputs = None;
        self.published.start.checked = None;
    }

    /// Returns the time in s since the start at which the start conditions change because an absent handler has not
    /// returned.
    pub(crate) fn start_conditions_due_s(&self) -> Option<f64> {
        self.published.start.absence_ends_s
    }

    /// Publishes the conditions that prevent a start, if they have changed.
    pub(crate) fn publish_start_conditions(&mut self) {
        let now_s = self.context.now_s() + 1e-9;
        if (self.published.start.absence_ends_s).is_some_and(|ends_s| ends_s <= now_s) {
            self.forget_start_conditions();
        }
        let lock = |lock: &LockInput| lock.is_on().then(|| lock.text());
        let inputs = StartInputs {
            state: self.published.state.clone(),
            locks: [lock(&self.inputs.interlock), lock(&self.inputs.start_lock)],
            fence: self.lease.held().map(|lease| lease.fence),
            prediction: self.context.view.prediction(),
            changes: self.context.shared.store.changes(),
            stored_data: self.context.shared.stored_data.lock().text(),
        };
        let last = self.published.start.inputs.as_ref();
        if last.is_some_and(|last| last.is_same(&inputs)) {
            return;
        }
        self.published.start.inputs = Some(inputs);
        self.published.start.absence_ends_s = self.context.shared.next_absence_end_s();
        let conditions = StartConditions {
            obstacles: self.obstacles(),
        };
        if self.published.start.conditions.as_ref() != Some(&conditions) {
            self.context.publish(
                CsTopic::StartConditions,
                Payload::StartConditions(conditions.clone()),
            );
            self.published.start.conditions = Some(conditions);
        }
    }

    fn obstacles(&mut self) -> Vec<StartObstacle> {
        if !self.state.is_idle() {
            let text = "a run is active; wait for its end, or stop it";
            return vec![StartObstacle::refusing(StartObstacleKind::Running, text)];
        }
        let mut obstacles = Vec::new();
        let mut refusing = |kind, judged: Result<(), Refusal>, detail: String| {
            if let Err(refusal) = judged {
                obstacles.push(StartObstacle {
                    detail,
                    ..StartObstacle::refusing(kind, refusal.text)
                });
            }
        };
        let situation = self.situation();
        let kind = match (situation.alarm_active, situation.program_loaded) {
            (true, _) => StartObstacleKind::Alarm,
            (false, false) => StartObstacleKind::NoProgram,
            (false, true) => StartObstacleKind::Reset,
        };
        refusing(kind, situation.check_allowed(Verb::Start), String::new());
        let [interlock, start_lock] = [&self.inputs.interlock, &self.inputs.start_lock].map(LockInput::text);
        refusing(StartObstacleKind::Interlock, self.check_interlock(), interlock);
        refusing(
            StartObstacleKind::StartLock,
            self.check_start_lock(Verb::Start),
            start_lock,
        );
        let leased = self.authorize_by_lease(Verb::Start, &CommandMeta::default());
        let holder = self.lease.held().map(|lease| lease.holder.clone());
        refusing(StartObstacleKind::Lease, leased, holder.unwrap_or_default());
        if let Some(main) = self.main_program() {
            if let Some(text) = self.refusal_of(&main) {
                let detail = text.clone();
                obstacles.push(StartObstacle {
                    detail,
                    ..StartObstacle::refusing(StartObstacleKind::Program, text)
                });
            } else {
                obstacles.extend(self.unhandled(&main));
                obstacles.extend(self.predicted(&main));
            }
        }
        obstacles
    }

    /// Returns the reason why the loaded program cannot run, if any.
    fn refusal_of(&mut self, main: &Arc<StoredProgram>) -> Option<String> {
        let changes = self.context.shared.store.changes();
        let known = self.published.start.checked.as_ref();
        let known = known.filter(|(number, then, _)| (*number, *then) == (main.number, changes));
        let checked = if let Some((_, _, why)) = known {
            why.clone()
        } else {
            let why = self.context.check_called(main).err().map(|refusal| refusal.text);
            self.published.start.checked = Some((main.number, changes, why.clone()));
            why
        };
        let loaded = || self.context.check_loaded(main.number, &self.commands.texts);
        checked.or_else(|| loaded().err().map(|refusal| refusal.text))
    }

    /// Returns the M codes of the program that would raise an alarm because no handler is online for them.
    fn unhandled(&self, main: &Arc<StoredProgram>) -> Option<StartObstacle> {
        let settings = &self.context.configured.settings;
        let raises = |m: &u16| {
            let of_code = self.context.m_code(*m).and_then(|settings| settings.unhandled);
            let unhandled = of_code.unwrap_or(self.context.shared.machine.unhandled);
            unhandled == UnhandledReaction::Alarm && !self.context.is_served(*m)
        };
        let mut m_codes: Vec<u16> = (self.context.texts_of(main.number).values())
            .flat_map(|program| program.check_in(settings).m_codes.clone())
            .filter(raises)
            .collect();
        m_codes.sort_unstable();
        m_codes.dedup();
        if m_codes.is_empty() {
            return None;
        }
        let names = m_codes.iter().map(|m| format!("M{m:02}"));
        let text = format!(
            "no handler is online for {}; start the handler, otherwise an alarm ends the run at this M code",
            names.collect::<Vec<_>>().join(", ")
        );
        Some(StartObstacle {
            refuses: false,
            m_codes,
            ..StartObstacle::refusing(StartObstacleKind::MCode, text)
        })
    }

    /// Returns the alarm with which the rehearsal of this program ended, if it did.
    fn predicted(&self, main: &StoredProgram) -> Option<StartObstacle> {
        let prediction = self.context.view.prediction()?;
        (prediction.hash == main.checksum()).then(|| prediction.obstacle.clone())
    }
}

#[cfg(test)]
mod tests;
