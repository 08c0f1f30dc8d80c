//! Alarms and messages of the machine, as events.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use opcua::nodes::{Event, ObjectType};
use opcua::server::address_space::AddressSpace;
use opcua::server::{EventField, SubscriptionCache};
use opcua::types::{
    AttributeId, ByteString, DateTime, LocalizedText, NodeId, NumericRange, ObjectTypeId, QualifiedName,
    ReferenceTypeId, StatusCode, UAString, Variant,
};
use plc_api::Plc;
use plc_protocol::types::BootId;
use plc_protocol::types::machine::{AlarmRecord, AlarmSeverity};
use plc_protocol::types::request::typed::Explain;
use tokio::sync::mpsc;

use crate::cnc;
use crate::machine_tool::{MACHINE, MESSAGES, PROGRAM};
use crate::program::Transition;

/// Largest number of events that wait to be sent; further events are dropped and logged. Reason: each state is also a
/// variable.
pub const WAITING_MAX: usize = 1000;

/// Severity of events that are not faults.
const MESSAGE_SEVERITY: u16 = 100;

/// Time limit for the explanation of an alarm.
const EXPLAIN_TIMEOUT: Duration = Duration::from_secs(2);

/// An event of the machine.
#[derive(Debug)]
pub enum FeedEvent {
    /// An alarm was raised, acknowledged or cleared; `is_active` is true while it is active.
    Alarm {
        boot: BootId,
        alarm: AlarmRecord,
        is_active: bool,
    },
    /// The handler of an M code shows a message or asks a question.
    Message { cs: u8, m: u16, text: String },
    /// The active program has changed its state.
    Transition {
        transition: Transition,
        /// Program name, and the run that the program belongs to.
        program: String,
        job: String,
    },
}

/// Indices of the namespaces used by events.
#[derive(Debug, Clone, Copy)]
pub struct Ids {
    pub cnc: u16,
    pub machine_tool: u16,
    /// Namespace of this server.
    pub own: u16,
}

/// Event types of this server, because those of the machine tool are abstract: path, name, and super type.
const TYPES: [(&str, &str, u32); 2] = [
    ("Types/MessageEventType", "MessageEventType", 35),
    (
        "Types/ProgramTransitionEventType",
        "ProgramTransitionEventType",
        17,
    ),
];

/// Builds the event types of this server.
pub fn build_types(space: &mut AddressSpace, ids: Ids) {
    for (path, name, super_type) in TYPES {
        let id = NodeId::new(ids.own, path);
        let node = ObjectType::new(&id, QualifiedName::new(ids.own, name), name, false);
        space.insert::<_, NodeId>(node, None);
        let super_type = NodeId::new(ids.machine_tool, super_type);
        space.insert_reference(&super_type, &id, ReferenceTypeId::HasSubtype);
    }
}

/// Sends events to clients in the order in which they happened; never returns.
pub async fn send_events(
    mut happened: mpsc::Receiver<FeedEvent>,
    plc: Plc,
    subscriptions: Arc<SubscriptionCache>,
    ids: Ids,
) {
    let mut explained: BTreeMap<u16, String> = BTreeMap::new();
    let mut count: u64 = 0;
    while let Some(happened) = happened.recv().await {
        // each causes at most two events
        count += 2;
        let events = match happened {
            FeedEvent::Alarm {
                boot,
                alarm,
                is_active,
            } => {
                let known = explained.get(&alarm.number).cloned();
                let help = match known {
                    Some(known) => known,
                    None => explain(&plc, alarm.number).await,
                };
                if !help.is_empty() {
                    explained.insert(alarm.number, help.clone());
                }
                let of_alarm = AlarmOccurrence {
                    boot: &boot,
                    alarm: &alarm,
                    is_active,
                };
                vec![
                    cnc_alarm(ids, count, of_alarm, help),
                    alert(ids, count + 1, of_alarm),
                ]
            }
            FeedEvent::Message { cs, m, text } => {
                vec![
                    cnc_message(ids, count, cs, &text),
                    message(ids, count + 1, (cs, m), &text),
                ]
            }
            FeedEvent::Transition {
                transition,
                program,
                job,
            } => vec![program_transition(ids, count, transition, program, job)],
        };
        // clients of the Server object get the events as well
        let events = events.iter().map(|event| (event as &dyn Event, &event.notifier));
        subscriptions.notify_events(events);
    }
}

async fn explain(plc: &Plc, number: u16) -> String {
    let asked = plc.port().ask(Explain(number.to_string()));
    match tokio::time::timeout(EXPLAIN_TIMEOUT, asked).await {
        Ok(Ok(explanation)) => explanation.text,
        _ => String::new(),
    }
}

/// An event, by the names of its fields.
pub struct MachineEvent {
    type_id: NodeId,
    /// The object whose clients receive it.
    notifier: NodeId,
    time: DateTime,
    /// Condition of an alarm.
    condition: Option<NodeId>,
    fields: BTreeMap<&'static str, Variant>,
}

/// Fields common to all events.
struct Base<'a> {
    type_id: NodeId,
    notifier: NodeId,
    time: DateTime,
    source: (NodeId, String),
    text: &'a str,
    severity: u16,
}

fn event(count: u64, base: Base<'_>) -> MachineEvent {
    let (node, name) = base.source;
    let fields = [
        ("EventId", ByteString::from(count.to_be_bytes().to_vec()).into()),
        ("EventType", base.type_id.clone().into()),
        ("SourceNode", node.into()),
        ("SourceName", UAString::from(name).into()),
        ("Time", base.time.into()),
        ("ReceiveTime", DateTime::now().into()),
        ("Message", LocalizedText::from(base.text).into()),
        ("Severity", base.severity.into()),
    ];
    MachineEvent {
        type_id: base.type_id,
        notifier: base.notifier,
        time: base.time,
        condition: None,
        fields: fields.into(),
    }
}

/// Returns the source of an event: a coordinate system, or the machine.
fn source(ids: Ids, systems: &str, machine: &str, cs: Option<u8>) -> (NodeId, String) {
    match cs {
        Some(cs) => (
            NodeId::new(ids.own, format!("{systems}/cs{cs}")),
            format!("cs{cs}"),
        ),
        None => (NodeId::new(ids.own, machine), "machine".to_owned()),
    }
}

fn cnc_source(ids: Ids, cs: Option<u8>) -> (NodeId, String) {
    source(
        ids,
        &format!("{}/CncChannelList", cnc::INTERFACE),
        cnc::INTERFACE,
        cs,
    )
}

fn machine_tool_source(ids: Ids, cs: Option<u8>) -> (NodeId, String) {
    source(ids, &format!("{MACHINE}/Monitoring"), MACHINE, cs)
}

/// An alarm with its start of the runtime, and whether it is active.
#[derive(Clone, Copy)]
struct AlarmOccurrence<'a> {
    boot: &'a BootId,
    alarm: &'a AlarmRecord,
    is_active: bool,
}

impl AlarmOccurrence<'_> {
    /// Returns an event of the alarm with this type, for the clients of an object, from a source.
    fn event(
        self,
        ids: Ids,
        count: u64,
        type_id: NodeId,
        notifier: &str,
        source: (NodeId, String),
    ) -> MachineEvent {
        let Self {
            boot,
            alarm,
            is_active,
        } = self;
        // OPC 10000-5, 6.4.2: 801 to 1000 is high, 201 to 400 medium low
        let severity = match alarm.severity {
            AlarmSeverity::Warning => 300,
            _ => 900,
        };
        let raised = DateTime::parse_from_rfc3339(&alarm.raised_at.0).unwrap_or_else(|_| DateTime::now());
        let is_new = is_active && alarm.acknowledged_by.is_none();
        let time = if is_new { raised } else { DateTime::now() };
        let base = Base {
            type_id,
            notifier: NodeId::new(ids.own, notifier),
            time,
            source,
            text: &alarm.text,
            severity,
        };
        let mut event = event(count, base);
        let condition = format!("{notifier}/Alarms/{boot}-{}", alarm.id);
        event.condition = Some(NodeId::new(ids.own, condition));
        event
            .fields
            .extend(condition_fields(alarm, is_active, severity, time));
        event
    }
}

/// Returns the event of an alarm in OPC 40502.
fn cnc_alarm(ids: Ids, count: u64, of_alarm: AlarmOccurrence<'_>, help: String) -> MachineEvent {
    let alarm = of_alarm.alarm;
    let type_id = NodeId::new(ids.cnc, 1006);
    let mut event = of_alarm.event(ids, count, type_id, cnc::INTERFACE, cnc_source(ids, alarm.cs));
    event.fields.extend([
        ("AlarmIdentifier", UAString::from(alarm.number.to_string()).into()),
        ("AuxParameters", alarm_location(alarm).into()),
        ("HelpSource", UAString::from(help).into()),
    ]);
    event
}

/// Returns the event of an alarm in OPC 40501.
fn alert(ids: Ids, count: u64, of_alarm: AlarmOccurrence<'_>) -> MachineEvent {
    let alarm = of_alarm.alarm;
    let type_id = NodeId::new(ids.machine_tool, 39);
    let mut event = of_alarm.event(ids, count, type_id, MESSAGES, machine_tool_source(ids, alarm.cs));
    let code = UAString::from(alarm.number.to_string());
    event.fields.insert("ErrorCode", code.into());
    event
}

/// Returns the location of an alarm, and its remedy.
fn alarm_location(alarm: &AlarmRecord) -> Vec<UAString> {
    let place = [
        ("remedy", alarm.remedy.clone()),
        ("program", alarm.program.map(|program| program.to_string())),
        ("line", alarm.line.map(|line| line.to_string())),
        ("column", alarm.column.map(|column| column.to_string())),
        ("acknowledged_by", alarm.acknowledged_by.clone()),
    ];
    let said = place
        .into_iter()
        .filter_map(|(name, value)| Some(format!("{name}={}", value?)));
    said.map(UAString::from).collect()
}

/// Fields of `AlarmConditionType` and of the types above it (OPC 10000-9).
fn condition_fields(
    alarm: &AlarmRecord,
    is_active: bool,
    severity: u16,
    time: DateTime,
) -> [(&'static str, Variant); 21] {
    let is_acknowledged = alarm.acknowledged_by.is_some();
    let state = |is_so: bool, yes: &str, no: &str| LocalizedText::from(if is_so { yes } else { no });
    let none = NodeId::null();
    let user = alarm.acknowledged_by.clone().unwrap_or_default();
    [
        ("ConditionName", UAString::from(alarm.number.to_string()).into()),
        (
            "ConditionClassId",
            NodeId::from(ObjectTypeId::ProcessConditionClassType).into(),
        ),
        ("ConditionClassName", LocalizedText::from("Process").into()),
        ("BranchId", none.clone().into()),
        ("Retain", is_active.into()),
        ("EnabledState", LocalizedText::from("Enabled").into()),
        ("EnabledState/Id", true.into()),
        ("Quality", StatusCode::Good.into()),
        ("Quality/SourceTimestamp", time.into()),
        ("LastSeverity", severity.into()),
        ("LastSeverity/SourceTimestamp", time.into()),
        ("Comment", LocalizedText::from("").into()),
        ("Comment/SourceTimestamp", time.into()),
        ("ClientUserId", UAString::from(user).into()),
        (
            "AckedState",
            state(is_acknowledged, "Acknowledged", "Unacknowledged").into(),
        ),
        ("AckedState/Id", is_acknowledged.into()),
        ("ActiveState", state(is_active, "Active", "Inactive").into()),
        ("ActiveState/Id", is_active.into()),
        ("InputNode", none.clone().into()),
        ("NormalState", none.into()),
        ("SuppressedOrShelved", false.into()),
    ]
}

/// Returns the event of a handler's message in OPC 40502.
fn cnc_message(ids: Ids, count: u64, cs: u8, text: &str) -> MachineEvent {
    let base = Base {
        type_id: NodeId::new(ids.cnc, 1011),
        notifier: NodeId::new(ids.own, cnc::INTERFACE),
        time: DateTime::now(),
        source: cnc_source(ids, Some(cs)),
        text,
        severity: MESSAGE_SEVERITY,
    };
    event(count, base)
}

/// Returns the event of a handler's message in OPC 40501.
fn message(ids: Ids, count: u64, (cs, m): (u8, u16), text: &str) -> MachineEvent {
    let base = Base {
        type_id: NodeId::new(ids.own, TYPES[0].0),
        notifier: NodeId::new(ids.own, MESSAGES),
        time: DateTime::now(),
        source: machine_tool_source(ids, Some(cs)),
        text,
        severity: MESSAGE_SEVERITY,
    };
    let mut event = event(count, base);
    event
        .fields
        .insert("Identifier", UAString::from(format!("M{m}")).into());
    event
}

/// Returns the event of a transition of the active program.
fn program_transition(
    ids: Ids,
    count: u64,
    transition: Transition,
    program: String,
    job: String,
) -> MachineEvent {
    let state_machine = format!("{PROGRAM}/State");
    let text = format!("{} to {}", transition.from.name(), transition.to.name());
    let base = Base {
        type_id: NodeId::new(ids.own, TYPES[1].0),
        notifier: NodeId::new(ids.own, state_machine.as_str()),
        time: DateTime::now(),
        source: (NodeId::new(ids.own, state_machine.as_str()), "State".to_owned()),
        text: &text,
        severity: MESSAGE_SEVERITY,
    };
    let mut event = event(count, base);
    let node = |node: u32| Variant::from(NodeId::new(ids.machine_tool, node));
    let (from, to) = (transition.from, transition.to);
    event.fields.extend([
        ("Transition", LocalizedText::from(transition.name).into()),
        ("Transition/Id", node(transition.node)),
        ("FromState", LocalizedText::from(from.name()).into()),
        ("FromState/Id", node(from.node())),
        ("ToState", LocalizedText::from(to.name()).into()),
        ("ToState/Id", node(to.node())),
        ("Name", UAString::from(program).into()),
        ("JobIdentifier", UAString::from(job).into()),
    ]);
    event
}

impl Event for MachineEvent {
    fn get_field(
        &self,
        _: &NodeId,
        attribute: AttributeId,
        range: &NumericRange,
        path: &[QualifiedName],
    ) -> Variant {
        self.get_value(attribute, range, path)
    }

    fn time(&self) -> &DateTime {
        &self.time
    }

    fn event_type_id(&self) -> &NodeId {
        &self.type_id
    }
}

impl EventField for MachineEvent {
    fn get_value(&self, attribute: AttributeId, range: &NumericRange, path: &[QualifiedName]) -> Variant {
        match (attribute, path) {
            // the identifier of a condition (OPC 10000-9, 5.5.2.13)
            (AttributeId::NodeId, []) => self.condition.clone().map_or(Variant::Empty, Variant::from),
            (AttributeId::Value, path) => {
                let name: Vec<&str> = path.iter().map(|name| name.name.as_ref()).collect();
                let value = self.fields.get(name.join("/").as_str()).cloned();
                value
                    .unwrap_or_default()
                    .range_of_owned(range)
                    .unwrap_or_default()
            }
            _ => Variant::Empty,
        }
    }
}
