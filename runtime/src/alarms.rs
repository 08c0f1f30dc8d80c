//! Active alarms and the history of alarms. Pure; `shared` publishes them.

use std::collections::{BTreeMap, VecDeque};

use plc_protocol::types::machine::{ActiveAlarms, AlarmRecord, AlarmSeverity};
use plc_protocol::types::{CoordinateSystemNumber, Timestamp};
use tandem_model::alarm::{ALARMS, After, AlarmEntry, FAULT_LASTS, RUNTIME_FAULT};

/// Maximum number of alarms in the history. Further alarms drop the oldest.
pub const ALARM_HISTORY_MAX: usize = 1000;

/// Maximum number of active alarms of one coordinate system, and also of the whole machine. Further alarms are only
/// published as events and entered in the history. Reason: all active alarms are one message.
pub const ALARMS_ACTIVE_MAX: usize = 24;

/// Active alarms and alarm history of a machine.
#[derive(Debug, Default)]
pub(crate) struct Alarms {
    last_id: u64,
    active: Vec<AlarmRecord>,
    /// Ids, by number, of warnings that stay active until their cause ends. A reset does not clear them.
    conditions: BTreeMap<u16, u64>,
    history: VecDeque<AlarmRecord>,
}

/// Result of raising an alarm.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum RaiseOutcome {
    /// The alarm was not active before.
    New(AlarmRecord),
    /// The alarm was already active and is not raised again.
    Active(AlarmRecord),
}

impl Alarms {
    /// Raises an alarm or a warning, unless an identical alarm is active. With `is_active` the alarm stays active until
    /// it is cleared; otherwise it appears only in the history.
    pub fn raise(&mut self, record: AlarmRecord, is_active: bool, at: Timestamp) -> RaiseOutcome {
        if let Some(same) = self.active.iter().find(|active| is_same_alarm(active, &record)) {
            return RaiseOutcome::Active(same.clone());
        }
        self.last_id += 1;
        let entry = ALARMS.iter().find(|entry| entry.number == record.number);
        let record = AlarmRecord {
            remedy: entry.map(|entry| entry.remedy.to_owned()).or(record.remedy),
            id: self.last_id,
            raised_at: at,
            ..record
        };
        self.history.push_back(record.clone());
        if self.history.len() > ALARM_HISTORY_MAX {
            self.history.pop_front();
        }
        let of_same = self.active.iter().filter(|active| active.cs == record.cs);
        let is_unlimited = is_until_restart(&record) || is_internal_fault(&record);
        if is_active && (of_same.count() < ALARMS_ACTIVE_MAX || is_unlimited) {
            self.active.push(record.clone());
        }
        RaiseOutcome::New(record)
    }

    /// Raises a warning of the whole machine that stays active until `text` is `None`. Returns the records that have
    /// changed.
    pub fn update_standing_warning(
        &mut self,
        entry: &AlarmEntry,
        text: Option<&str>,
        at: &Timestamp,
    ) -> Vec<AlarmRecord> {
        let text = text.map(|text| format!("{}: {text}", entry.title));
        let standing = self.conditions.get(&entry.number).copied();
        let place = self.active.iter().position(|alarm| Some(alarm.id) == standing);
        if place.map(|place| &self.active[place].text) == text.as_ref() {
            return Vec::new();
        }
        let mut changed = Vec::new();
        if let Some(place) = place {
            let mut record = self.active.remove(place);
            record.cleared_at = Some(at.clone());
            self.update_history(&record);
            self.conditions.remove(&entry.number);
            changed.push(record);
        }
        if let Some(text) = text {
            let record = AlarmRecord {
                severity: AlarmSeverity::Warning,
                number: entry.number,
                text,
                ..AlarmRecord::default()
            };
            if let RaiseOutcome::New(record) = self.raise(record, true, at.clone()) {
                self.conditions.insert(entry.number, record.id);
                if self.active.last().is_none_or(|last| last.id != record.id) {
                    // the limit for other alarms does not apply to this warning
                    self.active.push(record.clone());
                }
                changed.push(record);
            }
        }
        changed
    }

    /// Clears the alarms of a coordinate system and those of the whole machine, and returns them. Alarms that only a
    /// restart of the runtime clears stay active.
    pub fn clear(&mut self, cs: CoordinateSystemNumber, at: &Timestamp) -> Vec<AlarmRecord> {
        let stands = |id| self.conditions.values().any(|standing| *standing == id);
        let is_cleared = |alarm: &mut AlarmRecord| {
            alarm.cs.is_none_or(|of| of == cs) && !stands(alarm.id) && !is_until_restart(alarm)
        };
        let mut cleared: Vec<_> = self.active.extract_if(.., is_cleared).collect();
        for record in &mut cleared {
            record.cleared_at = Some(at.clone());
            self.update_history(record);
        }
        cleared
    }

    /// Records the user that has acknowledged an active alarm. Returns `None` if no active alarm has this id.
    pub fn acknowledge(&mut self, id: u64, by: &str) -> Option<AlarmRecord> {
        let record = self.active.iter_mut().find(|alarm| alarm.id == id)?;
        record.acknowledged_by = Some(by.to_owned());
        let record = record.clone();
        self.update_history(&record);
        Some(record)
    }

    /// Returns the payload of `alarm/active`.
    pub fn active(&self) -> ActiveAlarms {
        ActiveAlarms {
            alarms: self.active.clone(),
        }
    }

    /// Returns true if an alarm with this number is active in this coordinate system.
    pub fn is_active(&self, number: u16, cs: CoordinateSystemNumber) -> bool {
        let mut active = self.active.iter();
        active.any(|alarm| alarm.number == number && alarm.cs == Some(cs))
    }

    /// Returns the number of active alarms of a coordinate system and of the whole machine. Warnings do not count.
    pub fn count(&self, cs: CoordinateSystemNumber) -> u32 {
        let of_cs = |alarm: &&AlarmRecord| {
            alarm.severity == AlarmSeverity::Alarm && alarm.cs.is_none_or(|number| number == cs)
        };
        u32::try_from(self.active.iter().filter(of_cs).count()).unwrap_or(u32::MAX)
    }

    /// Returns the alarms and warnings of the history, the oldest first.
    pub fn history(&self) -> Vec<AlarmRecord> {
        self.history.iter().cloned().collect()
    }

    fn update_history(&mut self, record: &AlarmRecord) {
        if let Some(place) = self.history.iter_mut().find(|other| other.id == record.id) {
            *place = record.clone();
        }
    }
}

/// Returns true for an alarm that only a restart of the runtime clears.
fn is_until_restart(record: &AlarmRecord) -> bool {
    let mut entries = ALARMS.iter();
    entries.any(|entry| entry.number == record.number && entry.after == After::Restart)
}

/// Returns true for the alarm of an internal fault. The limit of active alarms does not apply to it: each of the two
/// numbers is raised once before a reset, and the reset recovers the coordinate system only while it is active.
fn is_internal_fault(record: &AlarmRecord) -> bool {
    [RUNTIME_FAULT.number, FAULT_LASTS.number].contains(&record.number)
}

fn is_same_alarm(a: &AlarmRecord, b: &AlarmRecord) -> bool {
    (a.severity, a.number, &a.text) == (b.severity, b.number, &b.text)
        && (a.cs, a.program, a.line, a.column) == (b.cs, b.program, b.line, b.column)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(second: u32) -> Timestamp {
        Timestamp(format!("2026-01-01T00:00:{second:02}.000000Z"))
    }

    fn alarm(cs: Option<CoordinateSystemNumber>, text: &str) -> AlarmRecord {
        AlarmRecord {
            severity: AlarmSeverity::Alarm,
            number: 10_001,
            text: text.to_owned(),
            cs,
            ..AlarmRecord::default()
        }
    }

    fn raise(alarms: &mut Alarms, record: AlarmRecord, is_active: bool) -> AlarmRecord {
        match alarms.raise(record, is_active, at(1)) {
            RaiseOutcome::New(record) => record,
            RaiseOutcome::Active(record) => panic!("{record:?} is active"),
        }
    }

    #[test]
    fn active_alarm_is_not_raised_again_and_a_cleared_one_is() {
        let mut alarms = Alarms::default();
        let first = raise(&mut alarms, alarm(Some(1), "air"), true);
        assert_eq!(
            alarms.raise(alarm(Some(1), "air"), true, at(2)),
            RaiseOutcome::Active(first.clone())
        );
        assert_eq!(raise(&mut alarms, alarm(Some(2), "air"), true).id, 2);
        assert_eq!(raise(&mut alarms, alarm(Some(1), "oil"), true).id, 3);
        alarms.clear(1, &at(3));
        assert_eq!(raise(&mut alarms, alarm(Some(1), "air"), true).id, 4);
        assert_eq!(alarms.history().len(), 4);
    }

    #[test]
    fn reset_clears_own_and_global_alarms_and_history_records_the_time() {
        let mut alarms = Alarms::default();
        for cs in [Some(1), Some(2), None] {
            raise(&mut alarms, alarm(cs, "air"), true);
        }
        let cleared: Vec<_> = alarms.clear(2, &at(9)).iter().map(|alarm| alarm.cs).collect();
        assert_eq!(cleared, [Some(2), None]);
        assert_eq!((alarms.count(1), alarms.count(2)), (1, 0));
        let cleared_at: Vec<_> = alarms
            .history()
            .into_iter()
            .map(|alarm| alarm.cleared_at)
            .collect();
        assert_eq!(cleared_at, [None, Some(at(9)), Some(at(9))]);
    }

    #[test]
    fn warnings_are_no_alarms_and_what_is_not_active_is_in_the_history_only() {
        let mut alarms = Alarms::default();
        let warning = AlarmRecord {
            severity: AlarmSeverity::Warning,
            ..alarm(Some(1), "restarted")
        };
        let warning = raise(&mut alarms, warning, true);
        raise(&mut alarms, alarm(None, "slow"), false);
        assert_eq!((alarms.count(1), alarms.history().len()), (0, 2));
        assert_eq!(alarms.active().alarms, [warning]);
    }

    #[test]
    fn an_active_alarm_is_acknowledged_by_name_and_no_other() {
        let mut alarms = Alarms::default();
        let id = raise(&mut alarms, alarm(Some(1), "air"), true).id;
        assert_eq!(alarms.acknowledge(id + 1, "hmi-1"), None);
        let record = alarms.acknowledge(id, "hmi-1").unwrap();
        assert_eq!(record.acknowledged_by.as_deref(), Some("hmi-1"));
        assert_eq!(
            (alarms.active().alarms, alarms.history()),
            (vec![record.clone()], vec![record])
        );
        alarms.clear(1, &at(2));
        assert_eq!(alarms.acknowledge(id, "hmi-1"), None);
    }

    #[test]
    fn condition_warning_survives_resets_until_the_condition_ends() {
        let (mut alarms, entry) = (Alarms::default(), &tandem_model::alarm::STORE_FAILED);
        let texts = |alarms: &Alarms| -> Vec<String> {
            alarms
                .active()
                .alarms
                .into_iter()
                .map(|alarm| alarm.text)
                .collect()
        };
        for n in 0..=ALARMS_ACTIVE_MAX {
            raise(&mut alarms, alarm(None, &n.to_string()), true);
        }
        assert_eq!(
            alarms.update_standing_warning(entry, Some("full"), &at(1)).len(),
            1
        );
        assert_eq!(alarms.update_standing_warning(entry, Some("full"), &at(2)), []);
        alarms.clear(1, &at(3));
        assert_eq!(
            texts(&alarms),
            ["Variables, tools and offsets cannot be stored: full"]
        );
        let changed = alarms.update_standing_warning(entry, Some("gone"), &at(4));
        assert_eq!(changed.len(), 2);
        assert_eq!((changed[0].cleared_at.clone(), alarms.count(1)), (Some(at(4)), 0));
        assert_eq!(
            texts(&alarms),
            ["Variables, tools and offsets cannot be stored: gone"]
        );
        assert_eq!(
            alarms.update_standing_warning(entry, None, &at(5))[0].cleared_at,
            Some(at(5))
        );
        assert_eq!(
            (
                texts(&alarms),
                alarms.update_standing_warning(entry, None, &at(6))
            ),
            (Vec::new(), Vec::new())
        );
    }

    #[test]
    fn each_coordinate_system_has_24_active_alarms_and_the_history_1000() {
        let mut alarms = Alarms::default();
        for n in 0..=ALARM_HISTORY_MAX {
            raise(&mut alarms, alarm(Some(1), &n.to_string()), true);
        }
        assert_eq!((alarms.count(1), alarms.history().len()), (24, 1000));
        assert_eq!(alarms.active().alarms[0].text, "0", "the oldest are active");
        assert_eq!(alarms.history()[0].text, "1", "the oldest is dropped");
        raise(&mut alarms, alarm(Some(2), "air"), true);
        assert_eq!(alarms.count(2), 1);
    }
}
