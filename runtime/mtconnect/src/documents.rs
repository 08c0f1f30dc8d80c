//! Writer of the standard's documents as XML.

use std::io::Cursor;

use plc_protocol::types::data::ToolTable;
use quick_xml::Writer;
use quick_xml::events::{BytesDecl, BytesEnd, BytesStart, BytesText, Event};

use crate::Version;
use crate::buffer::{BUFFER_SIZE, Observation, Value};
use crate::device::{Category, Device};

/// Largest number of assets.
const ASSET_BUFFER_SIZE: usize = 65_536;

/// Data for the header of each document.
#[derive(Debug, Clone)]
pub struct Head {
    pub version: Version,
    /// Name of the sender.
    pub sender: String,
    /// Identifier of this start of the agent.
    pub instance_id: u64,
    /// Time since which the device model is unchanged, as RFC 3339.
    pub model_change_time: String,
    /// Current time, as RFC 3339.
    pub creation_time: String,
}

/// Sequence numbers of a streams document.
#[derive(Debug, Clone, Copy)]
pub struct Sequences {
    pub first: u64,
    pub last: u64,
    pub next: u64,
}

/// Writer of XML elements. It writes to memory, so writing does not fail.
struct Xml(Writer<Cursor<Vec<u8>>>);

type Attributes<'a> = &'a [(&'a str, &'a str)];

impl Xml {
    /// Begins a document of a kind, with its header.
    fn document(kind: &str, head: &Head, more: Attributes<'_>) -> Self {
        let mut xml = Self(Writer::new(Cursor::new(Vec::new())));
        xml.write(Event::Decl(BytesDecl::new("1.0", Some("UTF-8"), None)));
        let version = head.version.text();
        let space = format!("urn:mtconnect.org:MTConnect{kind}:{version}");
        let location = format!("{space} http://schemas.mtconnect.org/schemas/MTConnect{kind}_{version}.xsd");
        xml.open(
            &format!("MTConnect{kind}"),
            &[
                ("xmlns", &space),
                ("xmlns:xsi", "http://www.w3.org/2001/XMLSchema-instance"),
                ("xsi:schemaLocation", &location),
            ],
        );
        let (instance_id, size) = (head.instance_id.to_string(), BUFFER_SIZE.to_string());
        let mut attributes = vec![
            ("creationTime", head.creation_time.as_str()),
            ("sender", &head.sender),
            ("instanceId", &instance_id),
            ("version", head.version.header()),
        ];
        if kind != "Assets" {
            attributes.push(("bufferSize", &size));
        }
        if kind != "Error" || head.version >= Version::V2_7 {
            attributes.push(("deviceModelChangeTime", &head.model_change_time));
        }
        attributes.extend(more);
        xml.empty("Header", &attributes);
        xml
    }

    fn write(&mut self, event: Event<'_>) {
        // writing to memory does not fail
        let _ = self.0.write_event(event);
    }

    fn start<'a>(name: &'a str, attributes: Attributes<'_>) -> BytesStart<'a> {
        let mut start = BytesStart::new(name);
        for (key, value) in attributes {
            start.push_attribute((*key, *value));
        }
        start
    }

    fn open(&mut self, name: &str, attributes: Attributes<'_>) {
        self.write(Event::Start(Self::start(name, attributes)));
    }

    fn close(&mut self, name: &str) {
        self.write(Event::End(BytesEnd::new(name)));
    }

    fn empty(&mut self, name: &str, attributes: Attributes<'_>) {
        self.write(Event::Empty(Self::start(name, attributes)));
    }

    fn text(&mut self, name: &str, attributes: Attributes<'_>, text: &str) {
        self.open(name, attributes);
        // characters that XML 1.0 cannot represent
        let text: String = text
            .chars()
            .map(|c| {
                if c < ' ' && !"\t\n\r".contains(c) {
                    '\u{fffd}'
                } else {
                    c
                }
            })
            .collect();
        self.write(Event::Text(BytesText::new(&text)));
        self.close(name);
    }

    fn finish_document(mut self, kind: &str) -> String {
        self.close(&format!("MTConnect{kind}"));
        String::from_utf8(self.0.into_inner().into_inner()).unwrap_or_default()
    }
}

/// Returns the components and data items of the device.
pub fn devices(head: &Head, device: &Device, asset_count: usize) -> String {
    let (size, count) = (ASSET_BUFFER_SIZE.to_string(), asset_count.to_string());
    let mut xml = Xml::document(
        "Devices",
        head,
        &[("assetBufferSize", &size), ("assetCount", &count)],
    );
    xml.open("Devices", &[]);
    agent(&mut xml, head, device);
    component(&mut xml, device, 0);
    xml.close("Devices");
    xml.finish_document("Devices")
}

/// Writes the agent as a device; it is always available.
fn agent(xml: &mut Xml, head: &Head, device: &Device) {
    let uuid = format!("{}-agent", device.uuid);
    let version = head.version.text();
    xml.open(
        "Agent",
        &[
            ("id", "agent"),
            ("name", "agent"),
            ("uuid", &uuid),
            ("mtconnectVersion", version),
        ],
    );
    xml.open("DataItems", &[]);
    xml.empty(
        "DataItem",
        &[
            ("category", "EVENT"),
            ("id", "agent_availability"),
            ("type", "AVAILABILITY"),
        ],
    );
    xml.close("DataItems");
    xml.close("Agent");
}

fn component(xml: &mut Xml, device: &Device, index: usize) {
    let this = &device.components[index];
    let mut attributes = vec![("id", this.id.as_str()), ("name", &this.name)];
    if this.parent.is_none() {
        attributes.push(("uuid", &device.uuid));
    }
    xml.open(this.element, &attributes);
    if this.parent.is_none() {
        let plate = &device.identification;
        let known = [
            ("manufacturer", &plate.manufacturer),
            ("model", &plate.model),
            ("serialNumber", &plate.serial_number),
            ("station", &plate.location),
        ];
        let known: Vec<(&str, &str)> = known
            .into_iter()
            .filter_map(|(name, value)| Some((name, value.as_deref()?)))
            .collect();
        xml.text("Description", &known, "A machine with a Tandem runtime");
    }
    let items = device.items.iter().filter(|item| item.component == index);
    let mut is_first = true;
    for item in items {
        if std::mem::take(&mut is_first) {
            xml.open("DataItems", &[]);
        }
        let mut attributes = vec![
            ("category", item.category.name()),
            ("id", item.id.as_str()),
            ("type", item.kind),
        ];
        attributes.extend(item.sub_type.map(|sub_type| ("subType", sub_type)));
        attributes.extend(item.units.map(|units| ("units", units)));
        attributes.extend(
            item.coordinates
                .map(|coordinates| ("coordinateSystem", coordinates)),
        );
        xml.empty("DataItem", &attributes);
    }
    if !is_first {
        xml.close("DataItems");
    }
    let parts = device
        .components
        .iter()
        .enumerate()
        .filter(|(_, part)| part.parent == Some(index));
    let mut is_first = true;
    for (part, _) in parts {
        if std::mem::take(&mut is_first) {
            xml.open("Components", &[]);
        }
        component(xml, device, part);
    }
    if !is_first {
        xml.close("Components");
    }
    xml.close(this.element);
}

/// Returns the observations, by component and category.
pub fn streams(head: &Head, device: &Device, sequences: Sequences, observations: &[Observation]) -> String {
    let Sequences { first, last, next } = sequences;
    let (first, last, next) = (first.to_string(), last.to_string(), next.to_string());
    let more = [
        ("nextSequence", next.as_str()),
        ("firstSequence", &first),
        ("lastSequence", &last),
    ];
    let mut xml = Xml::document("Streams", head, &more);
    xml.open("Streams", &[]);
    xml.open("DeviceStream", &[("name", &device.name), ("uuid", &device.uuid)]);
    for (index, component) in device.components.iter().enumerate() {
        let of_component = |one: &&Observation| device.items[one.item].component == index;
        let here: Vec<&Observation> = observations.iter().filter(of_component).collect();
        if here.is_empty() {
            continue;
        }
        let attributes = [
            ("component", component.element),
            ("name", component.name.as_str()),
            ("componentId", component.id.as_str()),
        ];
        xml.open("ComponentStream", &attributes);
        for (category, element) in [
            (Category::Sample, "Samples"),
            (Category::Event, "Events"),
            (Category::Condition, "Condition"),
        ] {
            let mut of_category = here
                .iter()
                .filter(|one| device.items[one.item].category == category)
                .peekable();
            if of_category.peek().is_none() {
                continue;
            }
            xml.open(element, &[]);
            of_category.for_each(|one| observed(&mut xml, head.version, device, one));
            xml.close(element);
        }
        xml.close("ComponentStream");
    }
    xml.close("DeviceStream");
    xml.close("Streams");
    xml.finish_document("Streams")
}

fn observed(xml: &mut Xml, version: Version, device: &Device, one: &Observation) {
    let item = &device.items[one.item];
    let sequence = one.sequence.to_string();
    let mut attributes = vec![
        ("dataItemId", item.id.as_str()),
        ("sequence", &sequence),
        ("timestamp", &one.timestamp),
    ];
    if item.category != Category::Condition {
        attributes.extend(item.sub_type.map(|sub_type| ("subType", sub_type)));
        if item.kind.starts_with("ASSET_") {
            attributes.push(("assetType", "CuttingTool"));
        }
        let text = match &one.value {
            Value::Text(text) => text,
            _ => "UNAVAILABLE",
        };
        return xml.text(&item.element(), &attributes, text);
    }
    attributes.push(("type", item.kind));
    match &one.value {
        Value::Active(alarm) => {
            let code = alarm.native_code.to_string();
            attributes.push(("nativeCode", &code));
            // older versions distinguish active alarms of a condition by their native codes only
            if version >= Version::V2_3 {
                attributes.push(("conditionId", &code));
            }
            xml.text(
                if alarm.is_fault { "Fault" } else { "Warning" },
                &attributes,
                &alarm.text,
            );
        }
        Value::Normal(code) => {
            let code = code.map(|code| code.to_string());
            attributes.extend(code.as_deref().map(|code| ("nativeCode", code)));
            xml.empty("Normal", &attributes);
        }
        Value::Unavailable | Value::Text(_) => xml.empty("Unavailable", &attributes),
    }
}

/// Reason why a request is rejected.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ErrorKind {
    /// Name of the parameter of the query.
    OutOfRange(&'static str),
    InvalidRequest,
    InvalidXPath,
    NoDevice,
    /// Id of the asset.
    AssetNotFound(String),
    Unsupported,
}

impl ErrorKind {
    /// Returns its code, and its element name since 2.6.
    fn words(&self) -> (&'static str, &'static str) {
        match self {
            ErrorKind::OutOfRange(_) => ("OUT_OF_RANGE", "OutOfRange"),
            ErrorKind::InvalidRequest => ("INVALID_REQUEST", "InvalidRequest"),
            ErrorKind::InvalidXPath => ("INVALID_PATH", "InvalidXPath"),
            ErrorKind::NoDevice => ("NO_DEVICE", "NoDevice"),
            ErrorKind::AssetNotFound(_) => ("ASSET_NOT_FOUND", "AssetNotFound"),
            ErrorKind::Unsupported => ("UNSUPPORTED", "Unsupported"),
        }
    }
}

/// Returns the document that reports why a request is rejected.
pub fn error(head: &Head, kind: &ErrorKind, uri: &str, text: &str) -> String {
    let (code, element) = kind.words();
    let mut xml = Xml::document("Error", head, &[]);
    xml.open("Errors", &[]);
    if head.version < Version::V2_7 {
        xml.text("Error", &[("errorCode", code)], text);
    } else {
        xml.open(element, &[]);
        match kind {
            ErrorKind::OutOfRange(parameter) => xml.empty("QueryParameter", &[("name", parameter)]),
            ErrorKind::AssetNotFound(id) => xml.text("AssetId", &[], id),
            _ => {}
        }
        xml.text("URI", &[], uri);
        xml.text("ErrorMessage", &[], text);
        xml.close(element);
    }
    xml.close("Errors");
    xml.finish_document("Error")
}

/// Returns the id of a tool as an asset.
pub fn asset_id(tool: u16) -> String {
    format!("T{tool}")
}

/// Returns tools as assets.
pub fn assets(head: &Head, device: &Device, tools: &ToolTable, is_wanted: &dyn Fn(&str) -> bool) -> String {
    let size = ASSET_BUFFER_SIZE.to_string();
    let count = tools.tools.len().to_string();
    let mut xml = Xml::document(
        "Assets",
        head,
        &[("assetBufferSize", &size), ("assetCount", &count)],
    );
    xml.open("Assets", &[]);
    for tool in &tools.tools {
        let id = asset_id(tool.id);
        if !is_wanted(&id) {
            continue;
        }
        let number = tool.id.to_string();
        let attributes = [
            ("assetId", id.as_str()),
            ("timestamp", &head.creation_time),
            ("deviceUuid", &device.uuid),
            ("serialNumber", &number),
            ("toolId", &number),
        ];
        xml.open("CuttingTool", &attributes);
        xml.open("CuttingToolLifeCycle", &[]);
        xml.open("CutterStatus", &[]);
        xml.text("Status", &[], "AVAILABLE");
        xml.close("CutterStatus");
        xml.text("ProgramToolNumber", &[], &number);
        xml.open("Measurements", &[]);
        let diameter = (2.0 * tool.radius).to_string();
        xml.text(
            "CuttingDiameterMax",
            &[("code", "DC"), ("units", "MILLIMETER")],
            &diameter,
        );
        xml.text(
            "FunctionalLength",
            &[("code", "LF"), ("units", "MILLIMETER")],
            &tool.length.to_string(),
        );
        xml.close("Measurements");
        xml.close("CuttingToolLifeCycle");
        xml.close("CuttingTool");
    }
    xml.close("Assets");
    xml.finish_document("Assets")
}
