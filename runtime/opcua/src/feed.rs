//! Follows the machine and writes its states to variables.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use opcua::server::SubscriptionCache;
use opcua::types::{DateTime, NodeId, StatusCode, Variant};
use plc_api::Plc;
use plc_protocol::hub::Filter;
use plc_protocol::types::machine::AlarmRecord;
use plc_protocol::types::message::Message;
use plc_protocol::types::topic::{CsTopic, Topic};
use plc_protocol::types::{BootId, CoordinateSystemNumber};
use tokio::sync::mpsc;

use crate::cnc;
use crate::events::FeedEvent;
use crate::instance::unknown;
use crate::machine_tool::{self, Spaces};
use crate::nodes::{Manager, data_value};
use crate::own;
use crate::program::ActiveProgram;
use crate::values::Values;
use crate::view::{Change, View};

/// Time without a position or a heartbeat after which the state of the machine is unknown. Reason: the machine sends
/// both ten times a second.
const SILENCE: Duration = Duration::from_secs(2);

/// Time from the first message of a machine until its states are used: messages from before its silence may arrive
/// until then.
const SETTLING: Duration = Duration::from_millis(300);

/// Period of the check for silence.
const WATCH: Duration = Duration::from_millis(100);

/// Publishes the states of one machine to OPC UA clients.
pub struct MachineFeed {
    pub plc: Plc,
    pub manager: Arc<Manager>,
    pub subscriptions: Arc<SubscriptionCache>,
    pub view: View,
    /// The program of the first coordinate system.
    pub program: ActiveProgram,
    /// Last written values, by path.
    pub written: BTreeMap<String, (NodeId, Result<Variant, StatusCode>)>,
    /// Queue of events for clients.
    pub happened: mpsc::Sender<FeedEvent>,
    /// Alarms for which clients have received an event, by the start of the runtime and their ids.
    pub alarms: BTreeMap<(BootId, u64), AlarmRecord>,
    /// Messages and questions of handlers, by coordinate system.
    pub messages: BTreeMap<CoordinateSystemNumber, String>,
}

impl MachineFeed {
    /// Waits until the machine sends messages, and publishes its whole state.
    pub async fn publish_initial_state(&mut self) {
        self.wait_until_online().await;
        self.publish_all();
    }

    /// Follows the machine; never returns.
    pub async fn follow(mut self) {
        loop {
            self.follow_until_silent().await;
            self.mark_offline();
            self.publish_initial_state().await;
        }
    }

    async fn wait_until_online(&mut self) {
        let mut messages = self.plc.port().subscribe(Filter::All);
        let mut heard: Option<(Instant, Instant)> = None;
        // values from before the subscription do not prove that the machine is online
        while messages.try_next().is_some() {}
        loop {
            if let Ok(message) = tokio::time::timeout(WATCH, messages.next()).await {
                let Some(message) = message else {
                    return std::future::pending().await;
                };
                if is_sign_of_life(&message) {
                    let now = Instant::now();
                    heard = Some((heard.map_or(now, |(since, _)| since), now));
                }
            }
            heard = heard.filter(|(_, last)| last.elapsed() < SILENCE);
            let is_settled = heard.is_some_and(|(since, _)| since.elapsed() >= SETTLING);
            if is_settled && self.plc.is_online().await {
                return;
            }
        }
    }

    /// Reads and publishes the whole current state of the machine.
    fn publish_all(&mut self) {
        let before = std::mem::take(&mut self.view);
        let mut messages = self.plc.port().subscribe(Filter::All);
        // presence comes first, then birth: messages of another start of the runtime are ignored
        while let Some(message) = messages.try_next() {
            self.view.apply_message(&message);
        }
        let shape = |view: &View| {
            (
                view.birth.machine.clone(),
                view.birth.identification.clone(),
                view.birth.coordinate_systems.clone(),
                view.birth.motors.clone(),
            )
        };
        if shape(&before) != shape(&self.view) {
            tracing::info!("another machine answers: its nodes replace the previous ones");
            self.manager.inner().rebuild(&self.manager, &self.view);
            self.written.clear();
        }
        tracing::info!(machine = %self.view.birth.machine, "the machine sends messages");
        let now = DateTime::now();
        self.publish_change(Change::Machine, now);
        for number in self.view.channels.keys().copied().collect::<Vec<_>>() {
            self.publish_change(Change::Channel(number), now);
        }
        self.publish_change(Change::Alarms, now);
    }

    async fn follow_until_silent(&mut self) {
        let mut messages = self.plc.port().subscribe(Filter::All);
        let mut heard = Instant::now();
        loop {
            let message = match tokio::time::timeout(WATCH, messages.next()).await {
                Ok(None) => return,
                Ok(Some(message)) => message,
                Err(_) if heard.elapsed() < SILENCE => continue,
                Err(_) => {
                    tracing::warn!("the machine sends no messages");
                    return;
                }
            };
            if is_sign_of_life(&message) {
                heard = Instant::now();
            }
            let boot = self.view.boot.clone();
            let change = self.view.apply_message(&message);
            if !self.view.presence.online || self.view.boot != boot {
                tracing::warn!("the machine is offline, or was restarted");
                return;
            }
            if let Some(change) = change {
                let at = DateTime::parse_from_rfc3339(&message.ts.0).unwrap_or_else(|_| DateTime::now());
                self.publish_change(change, at);
            }
        }
    }

    /// Writes the values that have changed.
    fn publish_change(&mut self, change: Change, at: DateTime) {
        let mut values = Values::default();
        let spaces = self.manager.inner().spaces();
        // machine values also depend on the coordinate systems and alarms
        machine_tool::machine_values(&self.view, spaces, &mut values);
        self.publish_program(spaces, &mut values);
        match change {
            Change::Machine => {
                cnc::machine_values(&self.view, &mut values);
                own::machine_values(&self.view, &mut values);
            }
            Change::Channel(number) => {
                if let Some((info, channel)) = self.view.channel(number) {
                    cnc::channel_values(info, channel, &mut values);
                    machine_tool::channel_values(info, channel, &mut values);
                    own::channel_values(info, channel, &mut values);
                }
            }
            Change::Alarms => own::alarm_values(&self.view, &mut values),
        }
        let mut changed = Vec::new();
        for (path, value) in values.into_iter() {
            if let Some((id, written)) = self.written.get_mut(&path) {
                if *written != value {
                    changed.push((id.clone(), data_value(&value, at)));
                    *written = value;
                }
            } else if let Some(id) = self.manager.inner().id(&path) {
                changed.push((id.clone(), data_value(&value, at)));
                self.written.insert(path, (id, value));
            } else {
                tracing::error!(path, "there is no such variable");
            }
        }
        self.report_events(change);
        let values = changed.iter().map(|(id, value)| (id, None, value.clone()));
        if let Err(status) = self.manager.set_values(&self.subscriptions, values) {
            tracing::error!(%status, "values were not written");
        }
    }

    /// Writes the program of the first coordinate system, and the transitions that led to its state.
    fn publish_program(&mut self, spaces: Spaces, values: &mut Values) {
        let mut numbers = self.view.birth.coordinate_systems.iter();
        let first = numbers
            .next()
            .and_then(|info| self.view.channels.get(&info.number));
        if let Some(state) = first.and_then(|channel| channel.state.as_ref()) {
            let passed = self.program.follow(state);
            if let Some(known) = self.program.status() {
                for transition in passed {
                    self.report_event(FeedEvent::Transition {
                        transition,
                        program: known.name.clone(),
                        job: known.job.clone(),
                    });
                }
            }
        }
        machine_tool::program_values(&self.program, spaces, values);
    }

    /// Sends events for new, changed and cleared alarms, and for messages and questions of handlers.
    fn report_events(&mut self, change: Change) {
        match (change, &self.view.alarms) {
            (Change::Alarms, Some(active)) => {
                let boot = &self.view.boot;
                let now = active
                    .alarms
                    .iter()
                    .map(|alarm| ((boot.clone(), alarm.id), alarm.clone()));
                let now: BTreeMap<_, _> = now.collect();
                let before = std::mem::replace(&mut self.alarms, now);
                for (id, alarm) in before.iter().filter(|(id, _)| !self.alarms.contains_key(*id)) {
                    self.report_alarm(&id.0, alarm, false);
                }
                for (id, alarm) in self
                    .alarms
                    .iter()
                    .filter(|(id, alarm)| before.get(*id) != Some(*alarm))
                {
                    self.report_alarm(&id.0, alarm, true);
                }
            }
            (Change::Channel(cs), _) => {
                let state = self
                    .view
                    .channels
                    .get(&cs)
                    .and_then(|channel| channel.state.as_ref());
                let said = state.and_then(|state| {
                    let waiting = state.waiting_on.as_ref()?;
                    let question = waiting.question.as_ref().map(|question| &question.text);
                    let text = question.or_else(|| Some(&waiting.progress.as_ref()?.text))?;
                    Some((waiting.m, text.clone()))
                });
                let (m, text) = said.unwrap_or_default();
                let before = self.messages.insert(cs, text.clone());
                if !text.is_empty() && before.as_ref() != Some(&text) {
                    self.report_event(FeedEvent::Message { cs, m, text });
                }
            }
            _ => {}
        }
    }

    fn report_alarm(&self, boot: &BootId, alarm: &AlarmRecord, is_active: bool) {
        self.report_event(FeedEvent::Alarm {
            boot: boot.clone(),
            alarm: alarm.clone(),
            is_active,
        });
    }

    fn report_event(&self, happened: FeedEvent) {
        if let Err(error) = self.happened.try_send(happened) {
            tracing::warn!(%error, "an event is not sent");
        }
    }

    /// Marks all values as unknown, because the machine sends no messages.
    fn mark_offline(&mut self) {
        self.view.forget();
        self.program = ActiveProgram::default();
        let away = unknown(StatusCode::BadNoCommunication);
        let values = self.written.values().map(|(id, _)| (id, None, away.clone()));
        if let Err(status) = self.manager.set_values(&self.subscriptions, values) {
            tracing::error!(%status, "values were not written");
        }
        self.written.clear();
    }
}

/// Returns true for a message that an online machine repeats regularly.
fn is_sign_of_life(message: &Message) -> bool {
    matches!(
        message.topic,
        Topic::Heartbeat | Topic::CoordinateSystem(_, CsTopic::Position)
    )
}
