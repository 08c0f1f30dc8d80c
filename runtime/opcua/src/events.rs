//! Alarms and messages of the machine, as events.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use opcua::nodes::Event;
use opcua::server::{EventField, SubscriptionCache};
use opcua::types::{
    AttributeId, ByteString, DateTime, LocalizedText, NodeId, NumericRange, ObjectTypeId, QualifiedName,
    StatusCode, UAString, Variant,
};
use plc_api::Plc;
use plc_api::types::BootId;
use plc_api::types::machine::{AlarmRecord, AlarmSeverity};
use plc_api::types::request::typed::Explain;
use tokio::sync::mpsc;

use crate::cnc;

/// Events that wait to be told; more are dropped, and the log says so. Reason: each state is a variable, too.
pub const WAITING_MAX: usize = 1000;

/// How long an explanation is waited for.
const EXPLAIN_TIMEOUT: Duration = Duration::from_secs(2);

/// What has happened.
#[derive(Debug)]
pub enum Happened {
    /// An alarm was raised, acknowledged or cleared; `is_active` says whether it is there.
    Alarm {
        boot: BootId,
        alarm: AlarmRecord,
        is_active: bool,
    },
    /// A handler says or asks something.
    Message { cs: u8, text: String },
}

/// What the events are of.
pub struct Ids {
    /// `CncAlarmType`.
    pub alarm_type: NodeId,
    /// `CncMessageType`.
    pub message_type: NodeId,
    /// Index of the namespace of this server.
    pub own: u16,
}

/// Tells events in the order in which they happened, for ever.
pub async fn tell(
    mut happened: mpsc::Receiver<Happened>,
    plc: Plc,
    subscriptions: Arc<SubscriptionCache>,
    ids: Ids,
) {
    let mut explained: BTreeMap<u16, String> = BTreeMap::new();
    let mut count: u64 = 0;
    let interface = NodeId::new(ids.own, cnc::INTERFACE);
    while let Some(happened) = happened.recv().await {
        count += 1;
        let event = match happened {
            Happened::Alarm {
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
                alarm_event(&ids, count, &boot, &alarm, is_active, help)
            }
            Happened::Message { cs, text } => message_event(&ids, count, cs, &text),
        };
        // clients of the Server object get the event as well
        subscriptions.notify_events(std::iter::once((&event as &dyn Event, &interface)));
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
pub struct Told {
    type_id: NodeId,
    time: DateTime,
    /// Of an alarm.
    condition: Option<NodeId>,
    fields: BTreeMap<&'static str, Variant>,
}

fn told(
    type_id: &NodeId,
    count: u64,
    time: DateTime,
    source: (NodeId, String),
    text: &str,
    severity: u16,
) -> Told {
    let (node, name) = source;
    let fields = [
        ("EventId", ByteString::from(count.to_be_bytes().to_vec()).into()),
        ("EventType", type_id.clone().into()),
        ("SourceNode", node.into()),
        ("SourceName", UAString::from(name).into()),
        ("Time", time.into()),
        ("ReceiveTime", DateTime::now().into()),
        ("Message", LocalizedText::from(text).into()),
        ("Severity", severity.into()),
    ];
    Told {
        type_id: type_id.clone(),
        time,
        condition: None,
        fields: fields.into(),
    }
}

/// Where something has happened: a coordinate system, or the machine.
fn source(ids: &Ids, cs: Option<u8>) -> (NodeId, String) {
    match cs {
        Some(cs) => {
            let path = format!("{}/CncChannelList/cs{cs}", cnc::INTERFACE);
            (NodeId::new(ids.own, path), format!("cs{cs}"))
        }
        None => (NodeId::new(ids.own, cnc::INTERFACE), "machine".to_owned()),
    }
}

fn alarm_event(
    ids: &Ids,
    count: u64,
    boot: &BootId,
    alarm: &AlarmRecord,
    is_active: bool,
    help: String,
) -> Told {
    // OPC 10000-5, 6.4.2: 801 to 1000 is high, 201 to 400 medium low
    let severity = match alarm.severity {
        AlarmSeverity::Alarm => 900,
        AlarmSeverity::Warning => 300,
    };
    let raised = DateTime::parse_from_rfc3339(&alarm.raised_at.0).unwrap_or_else(|_| DateTime::now());
    let is_new = is_active && alarm.acknowledged_by.is_none();
    let time = if is_new { raised } else { DateTime::now() };
    let mut event = told(
        &ids.alarm_type,
        count,
        time,
        source(ids, alarm.cs),
        &alarm.text,
        severity,
    );
    event.condition = Some(NodeId::new(
        ids.own,
        format!("{}/Alarms/{boot}-{}", cnc::INTERFACE, alarm.id),
    ));
    event
        .fields
        .extend(condition_fields(alarm, is_active, severity, time));
    event.fields.extend([
        ("AlarmIdentifier", UAString::from(alarm.number.to_string()).into()),
        ("AuxParameters", place(alarm).into()),
        ("HelpSource", UAString::from(help).into()),
    ]);
    event
}

/// Where an alarm belongs, and what to do.
fn place(alarm: &AlarmRecord) -> Vec<UAString> {
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

fn message_event(ids: &Ids, count: u64, cs: u8, text: &str) -> Told {
    told(
        &ids.message_type,
        count,
        DateTime::now(),
        source(ids, Some(cs)),
        text,
        100,
    )
}

impl Event for Told {
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

impl EventField for Told {
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
