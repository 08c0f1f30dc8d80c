//! State of the other machines, with limits, because any client can publish under their names. Pure; the time is a
//! parameter.

use std::collections::BTreeMap;
use std::time::Duration;

use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::machine::{ActiveAlarms, AlarmRecord, Presence};
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::output::PendingOutput;
use plc_protocol::types::run::TimeLeft;
use plc_protocol::types::start::StartConditions;
use plc_protocol::types::state::State;
use plc_protocol::types::topic::{CsTopic, Topic};
use plc_protocol::wire::machines::{CoordinateSystemSeen, MachineLink, MachineSeen};
use tokio::time::Instant;

use crate::exposed_settings::is_origin;
use crate::settings::is_machine_name;

/// Largest number of machines. Reason: each has a tile on one page.
const MACHINES_MAX: usize = 256;
/// Largest number of coordinate systems of a machine. Reason: no machine has more.
const SYSTEMS_MAX: usize = 8;
/// Largest number of bytes of the messages kept for one machine. A message beyond this limit is ignored.
const MACHINE_BYTES_MAX: usize = 128 * 1024;
/// Largest number of reported alarms of a machine: the newest ones.
const ALARMS_MAX: usize = 4;
/// Longest age of a presence.
const EXPIRES_MAX: Duration = Duration::from_hours(24);

/// The other machines by name.
#[derive(Debug)]
pub(super) struct Registry {
    own: String,
    machines: BTreeMap<String, PeerMachine>,
}

/// Data received from one machine.
#[derive(Debug, Default)]
struct PeerMachine {
    presence: Option<(Presence, Instant)>,
    /// When its newest heartbeat arrived.
    beat_at: Option<Instant>,
    alarms: ActiveAlarms,
    systems: BTreeMap<CoordinateSystemNumber, System>,
    /// Bytes of the messages by topic.
    bytes: BTreeMap<Topic, usize>,
}

#[derive(Debug, Default)]
struct System {
    state: Option<State>,
    outputs: Vec<PendingOutput>,
    time_left: TimeLeft,
    start: Option<StartConditions>,
}

impl Registry {
    /// Creates a registry that ignores the machine of this name, which is this one.
    pub(super) fn new(own: &str) -> Self {
        Self {
            own: own.to_owned(),
            machines: BTreeMap::new(),
        }
    }

    /// Removes all machines.
    pub(super) fn clear(&mut self) {
        self.machines.clear();
    }

    /// Stores a message of a machine. Ignores messages outside the interface and beyond the limits.
    pub(super) fn store_message(&mut self, machine: &str, path: &str, payload: &[u8], now: Instant) {
        let Some(topic) = Topic::parse(path).filter(is_read) else {
            return;
        };
        if machine == self.own || !is_machine_name(machine) {
            return;
        }
        if payload.is_empty() && topic == Topic::Presence {
            self.machines.remove(machine);
            return;
        }
        if !self.machines.contains_key(machine) && !self.makes_room(now) {
            return;
        }
        let heard = self.machines.entry(machine.to_owned()).or_default();
        heard.forget(&topic);
        if heard.fits(&topic, payload.len())
            && let Ok(message) = Message::from_json(topic, payload)
        {
            heard.store_message(message, payload.len(), now);
        }
    }

    /// Makes room for one more machine, if necessary by removing the first one that is not online. Returns `false`
    /// without room.
    fn makes_room(&mut self, now: Instant) -> bool {
        if self.machines.len() < MACHINES_MAX {
            return true;
        }
        let is_away = |heard: &PeerMachine| heard.link(now) != Some(MachineLink::Online);
        let mut away = self.machines.iter().filter(|(_, heard)| is_away(heard));
        let Some(name) = away.next().map(|(name, _)| name.clone()) else {
            return false;
        };
        self.machines.remove(&name);
        true
    }

    /// Returns the machines that have published a presence, ascending by name.
    pub(super) fn machines(&self, now: Instant) -> Vec<MachineSeen> {
        let machines = self.machines.iter();
        machines
            .filter_map(|(name, heard)| heard.seen(name, now))
            .collect()
    }
}

/// Returns true if this is one of the topics that are read.
fn is_read(topic: &Topic) -> bool {
    use CsTopic::{Pending, StartConditions, State, TimeLeft};
    matches!(
        topic,
        Topic::Presence
            | Topic::Heartbeat
            | Topic::AlarmActive
            | Topic::CoordinateSystem(_, State | Pending | StartConditions | TimeLeft)
    )
}

impl PeerMachine {
    /// Returns true if a message of this size is within the limits.
    fn fits(&self, topic: &Topic, bytes: usize) -> bool {
        let system_fits = match topic {
            Topic::CoordinateSystem(cs, _) => {
                self.systems.contains_key(cs) || self.systems.len() < SYSTEMS_MAX
            }
            _ => true,
        };
        system_fits && self.bytes.values().sum::<usize>() + bytes <= MACHINE_BYTES_MAX
    }

    /// Discards the earlier message of this topic.
    fn forget(&mut self, topic: &Topic) {
        self.bytes.remove(topic);
        match topic {
            Topic::AlarmActive => self.alarms = ActiveAlarms::default(),
            Topic::CoordinateSystem(cs, topic) => {
                if let Some(system) = self.systems.get_mut(cs) {
                    match topic {
                        CsTopic::State => system.state = None,
                        CsTopic::Pending => system.outputs.clear(),
                        CsTopic::TimeLeft => system.time_left = TimeLeft::default(),
                        CsTopic::StartConditions => system.start = None,
                        _ => {}
                    }
                }
            }
            _ => {}
        }
    }

    fn store_message(&mut self, message: Message, bytes: usize, now: Instant) {
        let cs = match message.topic {
            Topic::CoordinateSystem(cs, _) => cs,
            _ => 0,
        };
        match message.payload {
            Payload::Presence(presence) => self.presence = Some((presence, now)),
            Payload::AlarmActive(alarms) => self.alarms = alarms,
            Payload::Heartbeat(_) => self.beat_at = Some(now),
            of_system => self.systems.entry(cs).or_default().store_payload(of_system),
        }
        self.bytes.insert(message.topic, bytes);
    }

    /// Returns whether the machine is online. `None` if it has not published a presence.
    fn link(&self, now: Instant) -> Option<MachineLink> {
        let (presence, heard) = self.presence.as_ref()?;
        let expires = presence.expires_ms.map(Duration::from_millis);
        let is_old = expires.is_some_and(|expires| now >= *heard + expires.min(EXPIRES_MAX));
        Some(match presence.online {
            false => MachineLink::Offline,
            true if is_old => MachineLink::Silent,
            true => MachineLink::Online,
        })
    }

    fn seen(&self, name: &str, now: Instant) -> Option<MachineSeen> {
        let link = self.link(now)?;
        let (presence, _) = self.presence.as_ref()?;
        let alarms = &self.alarms.alarms;
        let newest: Vec<AlarmRecord> = alarms.iter().rev().take(ALARMS_MAX).rev().cloned().collect();
        Some(MachineSeen {
            machine: name.to_owned(),
            link,
            age_ms: self.beat_at.map(|beat_at| age_ms(now - beat_at)),
            url: presence.url.clone().filter(|url| is_origin(url)),
            alarm_count: u32::try_from(alarms.len()).unwrap_or(u32::MAX),
            alarms: newest,
            coordinate_systems: self.systems.iter().map(|(cs, system)| system.seen(*cs)).collect(),
        })
    }
}

fn age_ms(age: Duration) -> u64 {
    u64::try_from(age.as_millis()).unwrap_or(u64::MAX)
}

impl System {
    fn store_payload(&mut self, payload: Payload) {
        match payload {
            Payload::State(state) => self.state = Some(state),
            Payload::Pending(pending) => self.outputs = pending.outputs,
            Payload::TimeLeft(time_left) => self.time_left = time_left,
            Payload::StartConditions(conditions) => self.start = Some(conditions),
            _ => {}
        }
    }

    fn seen(&self, number: CoordinateSystemNumber) -> CoordinateSystemSeen {
        let waits = self.state.as_ref().and_then(|state| state.waiting_on.as_ref());
        let output = waits.and_then(|waits| self.outputs.iter().find(|open| open.output.seq == waits.seq));
        // discards a remaining time of another run
        let run_id = self.state.as_ref().and_then(|state| state.run_id.as_ref());
        let is_of_run = run_id.is_some() && self.time_left.run_id.as_ref() == run_id;
        let finite = |value: Option<f64>| value.filter(|value| is_of_run && value.is_finite());
        CoordinateSystemSeen {
            number,
            state: self.state.clone(),
            waiting_on: output.cloned(),
            left_s: finite(self.time_left.left_s),
            progress: finite(self.time_left.progress),
            start_conditions: self.start.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    const PRESENCE: &str =
        r#"{"online":true,"started_at":"2026-01-01T00:00:00Z","version":"1","expires_ms":900}"#;

    fn store_json(registry: &mut Registry, machine: &str, path: &str, payload: &str, now: Instant) {
        registry.store_message(machine, path, payload.as_bytes(), now);
    }

    fn state(program: u16) -> String {
        let state = State {
            program: Some(program),
            run_id: Some("r-1".into()),
            ..State::default()
        };
        serde_json::to_string(&state).unwrap()
    }

    #[test]
    fn machine_is_listed_after_its_presence_and_silent_when_it_expires() {
        let (mut registry, now) = (Registry::new("mill-1"), Instant::now());
        store_json(&mut registry, "mill-2", "cs/1/state", &state(7), now);
        assert_eq!(
            registry.machines(now),
            [],
            "unknown whether the machine is online"
        );
        store_json(&mut registry, "mill-2", "presence", PRESENCE, now);
        let told = registry.machines(now + Duration::from_millis(899));
        assert_eq!(
            (told[0].machine.as_str(), told[0].link),
            ("mill-2", MachineLink::Online)
        );
        let state = told[0].coordinate_systems[0].state.as_ref().unwrap();
        assert_eq!(state.program, Some(7));
        let later = now + Duration::from_millis(900);
        assert_eq!(registry.machines(later)[0].link, MachineLink::Silent);
        store_json(
            &mut registry,
            "mill-2",
            "presence",
            &PRESENCE.replace("true", "false"),
            later,
        );
        assert_eq!(registry.machines(later)[0].link, MachineLink::Offline);
        store_json(&mut registry, "mill-2", "presence", "", later);
        assert_eq!(registry.machines(later), [], "its presence was taken away");
    }

    #[test]
    fn the_age_of_a_machine_is_that_of_its_newest_heartbeat() {
        let (mut registry, now) = (Registry::new("mill-1"), Instant::now());
        store_json(&mut registry, "mill-2", "presence", PRESENCE, now);
        assert_eq!(registry.machines(now)[0].age_ms, None);
        for cycle in 1..=3 {
            let at = now + Duration::from_millis(100 * cycle);
            let heartbeat = json!({ "cycle": cycle }).to_string();
            store_json(&mut registry, "mill-2", "heartbeat", &heartbeat, at);
        }
        let later = now + Duration::from_millis(850);
        assert_eq!(registry.machines(later)[0].age_ms, Some(550));
    }

    #[test]
    fn this_machine_and_what_is_no_name_of_one_are_passed_over() {
        let (mut registry, now) = (Registry::new("mill-1"), Instant::now());
        for name in ["mill-1", "", "Mill", "mill 2", "<b>", &"m".repeat(33)] {
            store_json(&mut registry, name, "presence", PRESENCE, now);
        }
        store_json(&mut registry, "mill-2", "presence", "{\"online\":}", now);
        store_json(&mut registry, "mill-3", "presence", "[1]", now);
        assert_eq!(registry.machines(now), []);
    }

    #[test]
    fn an_address_that_is_no_origin_is_none() {
        let (mut registry, now) = (Registry::new("mill-1"), Instant::now());
        for (url, told) in [
            ("http://mill-2:8080", Some("http://mill-2:8080")),
            ("javascript:alert(1)", None),
            ("http://mill-2:8080/path", None),
        ] {
            let presence = PRESENCE.replace("\"version\"", &format!("\"url\":\"{url}\",\"version\""));
            store_json(&mut registry, "mill-2", "presence", &presence, now);
            assert_eq!(registry.machines(now)[0].url.as_deref(), told, "{url}");
        }
    }

    #[test]
    fn machines_coordinate_systems_alarms_and_bytes_are_bounded() {
        let (mut registry, now) = (Registry::new("mill-1"), Instant::now());
        for n in 0..MACHINES_MAX + 10 {
            store_json(&mut registry, &format!("m{n}"), "presence", PRESENCE, now);
        }
        assert_eq!(registry.machines(now).len(), MACHINES_MAX);
        let later = now + Duration::from_secs(1);
        store_json(&mut registry, "new", "presence", PRESENCE, later);
        let told = registry.machines(later);
        assert_eq!(told.len(), MACHINES_MAX, "a silent machine was evicted");
        assert!(told.iter().any(|seen| seen.machine == "new"));

        for cs in 1..=20 {
            store_json(&mut registry, "new", &format!("cs/{cs}/state"), &state(cs), later);
        }
        let alarms = vec![AlarmRecord::default(); 50];
        let alarms = serde_json::to_string(&ActiveAlarms { alarms }).unwrap();
        store_json(&mut registry, "new", "alarm/active", &alarms, later);
        let find = |registry: &Registry| {
            let mut told = registry.machines(later).into_iter();
            told.find(|seen| seen.machine == "new").unwrap()
        };
        let seen = find(&registry);
        assert_eq!(seen.coordinate_systems.len(), SYSTEMS_MAX);
        assert_eq!((seen.alarm_count, seen.alarms.len()), (50, ALARMS_MAX));

        let long = format!("{{\"alarms\":[]{}}}", " ".repeat(MACHINE_BYTES_MAX));
        store_json(&mut registry, "new", "alarm/active", &long, later);
        assert_eq!(find(&registry).alarm_count, 0, "neither it nor what it replaces");
    }

    #[test]
    fn the_output_that_is_waited_for_is_told_with_the_time_left() {
        let (mut registry, now) = (Registry::new("mill-1"), Instant::now());
        let waiting = state(7).replace(
            "\"waiting_on\":null",
            r#""waiting_on":{"m":12,"seq":3,"since":"2026-01-01T00:00:00Z"}"#,
        );
        let output = |seq: u64| {
            json!({"id": "", "seq": seq, "run_id": "r", "m": 12, "params": {}, "timing": "after_motion", "program": 7, "line": 3,
                "attempt": 1, "redelivered": false, "state": "OUTPUT", "handler_id": null, "since": "2026-01-01T00:00:00Z"})
        };
        let pending = json!({"outputs": [output(2), output(3)]}).to_string();
        store_json(&mut registry, "mill-2", "presence", PRESENCE, now);
        store_json(&mut registry, "mill-2", "cs/1/m_code/pending", &pending, now);
        store_json(&mut registry, "mill-2", "cs/1/state", &waiting, now);
        for (run_id, left) in [
            ("r-1", (Some(12.5), Some(0.25))),
            ("r-0", (None, None)),
            ("", (None, None)),
        ] {
            let time_left = json!({"run_id": run_id, "left_s": 12.5, "progress": 0.25}).to_string();
            store_json(&mut registry, "mill-2", "cs/1/time_left", &time_left, now);
            let seen = &registry.machines(now)[0].coordinate_systems[0];
            assert_eq!(seen.waiting_on.as_ref().map(|open| open.output.seq), Some(3));
            assert_eq!((seen.left_s, seen.progress), left, "{run_id}");
        }
    }
}
