//! Converts messages of the machine into observations.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use std::sync::Arc;

use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::data::ToolData;
use plc_protocol::types::io::{IoPoint, IoState};
use plc_protocol::types::machine::{AlarmRecord, AlarmSeverity};
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::run::Run;
use plc_protocol::types::state::Execution;
use plc_protocol::types::state::{Position, ProgramLocation, RunKind, State};
use plc_protocol::types::topic::Topic;

use crate::buffer::{ActiveAlarm, BUFFER_SIZE, Buffer, Value};
use crate::device::{Category, Device, axis_id, item_id, path_id};
use crate::documents::asset_id;
use crate::{AgentSettings, Version};

/// A device with its observations.
#[derive(Debug)]
pub struct DeviceFeed {
    pub device: Device,
    pub buffer: Buffer,
    version: Version,
    /// Index of a data item by its id.
    items: BTreeMap<String, usize>,
    /// Parts of each coordinate system.
    parts: BTreeMap<CoordinateSystemNumber, Parts>,
    /// The input that is on while the emergency stop is not pressed.
    emergency_stop: Option<IoPoint>,
    /// The tool table when it was last read.
    tools: Option<Vec<ToolData>>,
    /// Active alarms, by condition.
    alarms: BTreeMap<usize, BTreeSet<u16>>,
}

/// Parts that were completed since the agent was started.
#[derive(Debug)]
struct Parts {
    /// Run whose parts are counted.
    run: Option<String>,
    /// Number of its parts that are already counted.
    done: u32,
    count: u64,
}

impl DeviceFeed {
    /// Creates a feed in which only the constant values are known.
    pub fn new(device: Device, settings: &AgentSettings, timestamp: &Arc<str>) -> Self {
        let buffer = Buffer::new(device.items.len(), BUFFER_SIZE, timestamp);
        let items = device.items.iter().enumerate();
        let items: BTreeMap<String, usize> = items.map(|(index, item)| (item.id.clone(), index)).collect();
        let mut feed = Self {
            buffer,
            version: settings.version,
            items,
            parts: BTreeMap::new(),
            emergency_stop: settings.emergency_stop.as_deref().map(IoPoint::input),
            tools: None,
            alarms: BTreeMap::new(),
            device,
        };
        feed.observe_text("dev", "AVAILABILITY", None, "AVAILABLE", timestamp);
        for index in 0..feed.device.items.len() {
            let item = &feed.device.items[index];
            let component = &feed.device.components[item.component];
            let is_spindle = component.name.starts_with('S');
            match (item.category, item.kind) {
                (Category::Condition, _) => feed.observe(index, Value::Normal(None), timestamp),
                (_, "ROTARY_MODE") => {
                    let mode = if is_spindle { "SPINDLE" } else { "INDEX" };
                    feed.observe(index, Value::Text(mode.into()), timestamp);
                }
                _ => {}
            }
        }
        feed
    }

    /// Applies a message. Returns true if there are new observations.
    pub fn apply_message(&mut self, message: &Message) -> bool {
        let before = self.buffer.next();
        let at: Arc<str> = message.ts.0.as_str().into();
        match (&message.topic, &message.payload) {
            (_, Payload::AlarmActive(active)) => self.alarms(&active.alarms, &at),
            (Topic::Io(point), Payload::Io(state)) if Some(point) == self.emergency_stop.as_ref() => {
                self.emergency_stop(state, &at);
            }
            (Topic::CoordinateSystem(cs, _), payload) => self.of_system(*cs, payload, &at),
            _ => {}
        }
        self.buffer.next() != before
    }

    fn of_system(&mut self, cs: CoordinateSystemNumber, payload: &Payload, at: &Arc<str>) {
        let path = path_id(cs);
        match payload {
            Payload::State(state) => self.state(cs, state, at),
            Payload::Run(state) => self.run(cs, state.run.as_ref(), at),
            Payload::Program(place) => self.observe_location(&path, place, at),
            Payload::Position(position) => self.position(cs, position, at),
            Payload::Override(overrides) => {
                let kind = "PATH_FEEDRATE_OVERRIDE";
                self.observe_text(&path, kind, Some("PROGRAMMED"), overrides.feed, at);
                self.observe_text(&path, kind, Some("RAPID"), overrides.rapid, at);
                let spindle = axis_id(cs, "S");
                self.observe_text(&spindle, "ROTARY_VELOCITY_OVERRIDE", None, overrides.spindle, at);
            }
            Payload::Tool(tool) => {
                self.observe_text(&path, "TOOL_NUMBER", None, tool.id, at);
                self.observe_text(&path, "TOOL_ASSET_ID", None, format!("T{}", tool.id), at);
            }
            Payload::Modal(modal) => {
                // MTConnect counts work offsets from 1: 1 is G54
                let offset = modal
                    .work_offset
                    .as_deref()
                    .and_then(|code| code.strip_prefix('G')?.parse::<u32>().ok());
                match offset.and_then(|code| code.checked_sub(53)) {
                    Some(number) => self.observe_text(&path, "WORK_OFFSET", None, number, at),
                    None => self.unavailable(&path, "WORK_OFFSET", at),
                }
            }
            Payload::Spindle(spindle) => {
                let axis = axis_id(cs, "S");
                self.observe_text(
                    &axis,
                    "ROTARY_VELOCITY",
                    Some("COMMANDED"),
                    rounded(spindle.rpm),
                    at,
                );
            }
            _ => {}
        }
    }

    fn state(&mut self, cs: CoordinateSystemNumber, state: &State, at: &Arc<str>) {
        let path = path_id(cs);
        self.observe_text(&path, "EXECUTION", None, self.execution(state.execution), at);
        let mode = match state.run_kind {
            Some(RunKind::Mdi) => "MANUAL_DATA_INPUT",
            Some(RunKind::Jog | RunKind::Home) => "MANUAL",
            _ => "AUTOMATIC",
        };
        self.observe_text(&path, "CONTROLLER_MODE", None, mode, at);
        match &state.waiting_on {
            Some(_) => self.observe_text(
                &path,
                "WAIT_STATE",
                None,
                wait_state(state.wait_state.as_deref()),
                at,
            ),
            None => self.unavailable(&path, "WAIT_STATE", at),
        }
        for (sub_type, is_on) in [
            ("DRY_RUN", state.dry_run),
            ("SINGLE_BLOCK", state.single_block),
            ("OPTIONAL_STOP", state.optional_stop),
        ] {
            let word = if is_on { "ON" } else { "OFF" };
            self.observe_text(&path, "CONTROLLER_MODE_OVERRIDE", Some(sub_type), word, at);
        }
        match state.program {
            Some(number) => self.observe_text(&path, "PROGRAM", Some("MAIN"), number, at),
            None => self.unavailable_of(&path, "PROGRAM", Some("MAIN"), at),
        }
        let said = state.waiting_on.as_ref().and_then(|waiting| {
            let question = waiting.question.as_ref().map(|question| question.text.clone());
            question.or_else(|| Some(waiting.progress.as_ref()?.text.clone()))
        });
        match said.filter(|text| !text.is_empty()) {
            Some(text) => self.observe_text(&path, "MESSAGE", None, text, at),
            None => self.unavailable(&path, "MESSAGE", at),
        }
    }

    /// Counts completed parts, without those completed before the agent was started.
    fn run(&mut self, cs: CoordinateSystemNumber, run: Option<&Run>, at: &Arc<str>) {
        let id = run.map(|run| run.id.clone());
        let done = run.map_or(0, |run| run.parts_done);
        let parts = self.parts.entry(cs).or_insert_with(|| Parts {
            run: id.clone(),
            done,
            count: 0,
        });
        let before = if parts.run == id { parts.done } else { 0 };
        parts.count += u64::from(done.saturating_sub(before));
        (parts.run, parts.done) = (id, done);
        let (path, count) = (path_id(cs), parts.count);
        self.observe_text(&path, "PART_COUNT", None, count, at);
        let Some(run) = run else {
            self.unavailable_of(&path, "PART_COUNT", Some("TARGET"), at);
            self.unavailable_of(&path, "PART_COUNT", Some("REMAINING"), at);
            return;
        };
        let left = run.parts.saturating_sub(run.parts_done);
        self.observe_text(&path, "PART_COUNT", Some("TARGET"), run.parts, at);
        self.observe_text(&path, "PART_COUNT", Some("REMAINING"), left, at);
    }

    /// Observes the emergency stop; its state is unknown until the input is written.
    fn emergency_stop(&mut self, state: &IoState, at: &Arc<str>) {
        let component = "ctl";
        if state.lost && state.forced.is_none() {
            return self.unavailable(component, "EMERGENCY_STOP", at);
        }
        let word = if state.value.is_on() { "ARMED" } else { "TRIGGERED" };
        self.observe_text(component, "EMERGENCY_STOP", None, word, at);
    }

    /// Compares the tool table with the last one. Returns true if there are new observations.
    pub fn tools(&mut self, now: &[ToolData], at: &Arc<str>) -> bool {
        let Some(before) = self.tools.replace(now.to_vec()) else {
            return false;
        };
        let next = self.buffer.next();
        for tool in now.iter().filter(|tool| !before.contains(tool)) {
            self.report_asset_again("ASSET_CHANGED", &asset_id(tool.id), at);
        }
        for tool in before
            .iter()
            .filter(|tool| now.iter().all(|now| now.id != tool.id))
        {
            self.report_asset_again("ASSET_REMOVED", &asset_id(tool.id), at);
        }
        self.buffer.next() != next
    }

    /// Reports an asset again when it has changed again, although the value is the same.
    fn report_asset_again(&mut self, kind: &str, asset: &str, at: &Arc<str>) {
        if let Some(item) = self.items.get(&item_id("dev", kind, None)).copied() {
            self.buffer.observe(item, Value::Text(asset.into()), at);
        }
    }

    fn execution(&self, execution: Execution) -> &'static str {
        match execution {
            Execution::Ready => "READY",
            Execution::Active => "ACTIVE",
            // older readers do not know this word
            Execution::Wait if self.version < Version::V2_7 => "ACTIVE",
            Execution::Wait => "WAIT",
            Execution::FeedHold => "FEED_HOLD",
            Execution::Interrupted => "INTERRUPTED",
            Execution::ProgramStopped => "PROGRAM_STOPPED",
            Execution::OptionalStop => "OPTIONAL_STOP",
            Execution::ProgramCompleted => "PROGRAM_COMPLETED",
            Execution::Stopped => "STOPPED",
        }
    }

    fn observe_location(&mut self, path: &str, place: &ProgramLocation, at: &Arc<str>) {
        let Some(number) = place.number else {
            for (kind, sub_type) in [
                ("PROGRAM", Some("ACTIVE")),
                ("LINE_NUMBER", Some("ABSOLUTE")),
                ("BLOCK", None),
            ] {
                self.unavailable_of(path, kind, sub_type, at);
            }
            return;
        };
        self.observe_text(path, "PROGRAM", Some("ACTIVE"), number, at);
        self.observe_text(path, "LINE_NUMBER", Some("ABSOLUTE"), place.line, at);
        self.observe_text(path, "BLOCK", None, &place.block, at);
        self.observe_text(path, "PROGRAM_NEST_LEVEL", None, place.nest_level, at);
    }

    fn position(&mut self, cs: CoordinateSystemNumber, position: &Position, at: &Arc<str>) {
        for (sub_type, by_letter) in [("ACTUAL", &position.actual), ("COMMANDED", &position.machine)] {
            for (letter, value) in by_letter {
                let axis = axis_id(cs, letter);
                self.observe_text(&axis, "POSITION", Some(sub_type), rounded(*value), at);
                self.observe_text(&axis, "ANGLE", Some(sub_type), rounded(*value), at);
            }
        }
        let path = path_id(cs);
        let value = |letter: &str| position.actual.get(letter).copied().unwrap_or_default();
        let at_point = ["X", "Y", "Z"]
            .map(|letter| rounded(value(letter)).to_string())
            .join(" ");
        self.observe_text(&path, "PATH_POSITION", Some("ACTUAL"), at_point, at);
        self.observe_text(
            &path,
            "PATH_FEEDRATE",
            Some("ACTUAL"),
            rounded(position.feedrate / 60.0),
            at,
        );
        let spindle = axis_id(cs, "S");
        self.observe_text(
            &spindle,
            "ROTARY_VELOCITY",
            Some("ACTUAL"),
            rounded(position.spindle_rpm),
            at,
        );
    }

    /// Updates the conditions from all active alarms.
    fn alarms(&mut self, active: &[AlarmRecord], at: &Arc<str>) {
        let mut now: BTreeMap<usize, BTreeMap<u16, &AlarmRecord>> = BTreeMap::new();
        for alarm in active {
            if let Some(condition) = self.condition_of(alarm) {
                now.entry(condition).or_default().insert(alarm.number, alarm);
            }
        }
        let gone = std::mem::take(&mut self.alarms);
        for (condition, codes) in &gone {
            let left = now.get(condition);
            for code in codes
                .iter()
                .filter(|code| left.is_none_or(|left| !left.contains_key(code)))
            {
                let code = left.map(|_| *code);
                self.buffer.observe(*condition, Value::Normal(code), at);
            }
        }
        for (condition, alarms) in &now {
            let known = gone.get(condition);
            for (code, alarm) in alarms
                .iter()
                .filter(|(code, _)| known.is_none_or(|known| !known.contains(code)))
            {
                let active = ActiveAlarm {
                    is_fault: alarm.severity == AlarmSeverity::Alarm,
                    native_code: *code,
                    text: alarm.text.clone(),
                };
                self.buffer
                    .observe(*condition, Value::Active(Arc::new(active)), at);
            }
            self.alarms.insert(*condition, alarms.keys().copied().collect());
        }
    }

    /// Returns the condition that an alarm belongs to, by its number.
    fn condition_of(&self, alarm: &AlarmRecord) -> Option<usize> {
        let component = alarm.cs.map_or_else(|| "ctl".to_owned(), path_id);
        let kind = match alarm.number {
            _ if alarm.cs.is_none() => "SYSTEM",
            1..100 | 300..400 | 10_000.. => "LOGIC_PROGRAM",
            100..300 => "MOTION_PROGRAM",
            _ => "SYSTEM",
        };
        self.items.get(&item_id(&component, kind, None)).copied()
    }

    fn observe_text(
        &mut self,
        component: &str,
        kind: &str,
        sub_type: Option<&str>,
        value: impl Display,
        at: &Arc<str>,
    ) {
        if let Some(item) = self.items.get(&item_id(component, kind, sub_type)).copied() {
            self.observe(item, Value::Text(value.to_string().into()), at);
        }
    }

    fn unavailable(&mut self, component: &str, kind: &str, at: &Arc<str>) {
        self.unavailable_of(component, kind, None, at);
    }

    fn unavailable_of(&mut self, component: &str, kind: &str, sub_type: Option<&str>, at: &Arc<str>) {
        if let Some(item) = self.items.get(&item_id(component, kind, sub_type)).copied() {
            self.observe(item, Value::Unavailable, at);
        }
    }

    /// Adds an observation, unless its value is already known.
    fn observe(&mut self, item: usize, value: Value, at: &Arc<str>) {
        if self
            .buffer
            .latest(item)
            .last()
            .is_none_or(|latest| latest.value != value)
        {
            self.buffer.observe(item, value, at);
        }
    }
}

/// Rounds to a millionth, so that rounding errors of the servo are not reported as changes.
fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6 + 0.0
}

/// Returns the standard's word for the cause of a wait; words of the machine builder that are not among them mean
/// another process.
fn wait_state(word: Option<&str>) -> &str {
    const WORDS: [&str; 6] = [
        "PART_LOAD",
        "PART_UNLOAD",
        "TOOL_LOAD",
        "TOOL_UNLOAD",
        "MATERIAL_LOAD",
        "MATERIAL_UNLOAD",
    ];
    word.filter(|word| WORDS.contains(word))
        .unwrap_or("SECONDARY_PROCESS")
}
