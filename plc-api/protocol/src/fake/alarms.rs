//! Alarms of the scripted machine.

use super::{FakeMachine, FakePort};
use crate::alarm::Alarm;
use crate::handshake::OutputOutcome;
use crate::lock::lock;
use crate::types::machine::{ActiveAlarms, AlarmRaise, AlarmRecord};
use crate::types::message::Payload;
use crate::types::output::CancelReason;
use crate::types::request::{Refusal, RefusalCode};
use crate::types::topic::Topic;
use crate::types::{CoordinateSystemNumber, Timestamp};

/// Number of the alarm for an output that timed out; a machine uses the same number (D36).
const TIMED_OUT: u16 = 301;

/// Returns the alarm that a failed output or an output that timed out raises; `None` for any other outcome.
pub(super) fn alarm_for_outcome(m: u16, how: &OutputOutcome) -> Option<Alarm> {
    match how {
        OutputOutcome::Failed { alarm } => Some(alarm.clone()),
        OutputOutcome::TimedOut => Some(Alarm {
            number: TIMED_OUT,
            text: format!("M{m:02} was not reset within its time limit"),
        }),
        OutputOutcome::Reset | OutputOutcome::Cancelled(_) => None,
    }
}

impl FakePort {
    /// Raises an alarm. An alarm of one coordinate system ends the run of this coordinate system; an alarm of
    /// the whole machine ends all runs.
    pub(super) fn raise_alarm(
        &self,
        inner: &mut FakeMachine,
        cs: Option<CoordinateSystemNumber>,
        alarm: Alarm,
    ) {
        let record = AlarmRecord {
            id: inner.alarms.len() as u64 + 1,
            number: alarm.number,
            text: alarm.text,
            cs,
            program: cs.and_then(|cs| inner.systems.get(&cs).map(super::System::program)),
            raised_at: Timestamp::from_system_time(inner.now().time),
            ..AlarmRecord::default()
        };
        inner.alarms.push(record.clone());
        self.publish(inner, Topic::AlarmEvent, Payload::AlarmEvent(record));
        self.publish_alarms(inner);
        let mut stopped = inner.numbers();
        stopped.retain(|of| cs.is_none_or(|cs| cs == *of));
        for cs in stopped {
            self.end_run(inner, cs, CancelReason::Alarm);
            self.publish_system(inner, cs);
        }
    }

    /// Raises an alarm on request of a client.
    ///
    /// # Errors
    /// Fails if the coordinate system does not exist, or if the code or the text of the alarm is out of
    /// range.
    pub(super) fn on_raise(&self, raise: &AlarmRaise) -> Result<(), Refusal> {
        let alarm = raise.alarm()?;
        let mut inner = lock(&self.inner);
        if let Some(cs) = raise.cs {
            inner.system(cs)?;
        }
        self.raise_alarm(&mut inner, raise.cs, alarm);
        Ok(())
    }

    pub(super) fn clear_alarms(&self, inner: &mut FakeMachine, cs: CoordinateSystemNumber) {
        let cleared_at = Timestamp::from_system_time(inner.now().time);
        let mut cleared = Vec::new();
        for alarm in &mut inner.alarms {
            if alarm.cleared_at.is_none() && alarm.cs.is_none_or(|of| of == cs) {
                alarm.cleared_at = Some(cleared_at.clone());
                cleared.push(alarm.clone());
            }
        }
        if cleared.is_empty() {
            return;
        }
        for alarm in cleared {
            self.publish(inner, Topic::AlarmEvent, Payload::AlarmEvent(alarm));
        }
        self.publish_alarms(inner);
        for cs in inner.numbers() {
            self.publish_system(inner, cs);
        }
    }

    /// Acknowledges an active alarm.
    ///
    /// # Errors
    /// Fails if no active alarm has this id.
    pub(super) fn acknowledge(&self, inner: &mut FakeMachine, id: u64, by: &str) -> Result<(), Refusal> {
        let mut active = inner.alarms.iter_mut().filter(|alarm| alarm.cleared_at.is_none());
        let Some(alarm) = active.find(|alarm| alarm.id == id) else {
            let text = format!("there is no active alarm {id}");
            return Err(Refusal::new(RefusalCode::NotFound, text));
        };
        alarm.acknowledged_by = Some(by.to_owned());
        self.publish_alarms(inner);
        Ok(())
    }

    pub(super) fn publish_alarms(&self, inner: &mut FakeMachine) {
        let active = inner.alarms.iter().filter(|alarm| alarm.cleared_at.is_none());
        let alarms = active.cloned().collect();
        self.publish(
            inner,
            Topic::AlarmActive,
            Payload::AlarmActive(ActiveAlarms { alarms }),
        );
    }
}
