//! JSON Schemas of all messages and bodies, from the types that the tables name.

use std::collections::BTreeSet;
use std::sync::LazyLock;

use plc_protocol::types::command::CommandMeta;
use plc_protocol::types::form::{Form, MessageEnvelope};
use plc_protocol::wire::ROWS;
use plc_protocol::wire::problem::Problem;
use plc_protocol::wire::route::{Content, Route};
use plc_protocol::wire::row::InboundTopic;
use plc_protocol::wire::websocket::{ClientFrame, ErrorFrame, FrameTopic};
use schemars::generate::SchemaSettings;
use serde_json::{Map, Value, json};

use super::outbound::outbound;
use super::routes::{ROUTES, Serves};

/// Schemas by name.
pub(super) type Schemas = Map<String, Value>;

impl Serves {
    /// Returns true if the body may carry an age limit.
    pub(super) fn takes_not_after(self) -> bool {
        matches!(self, Serves::Request(row) if row.takes_not_after)
    }
}

/// Direction of a message: it determines which fields are optional.
#[derive(Clone, Copy, PartialEq)]
enum Direction {
    Out,
    In,
}

/// Returns every schema that the tables name, with those within them.
pub(super) fn all() -> Schemas {
    let mut all = incoming();
    for (name, schema) in outgoing() {
        // a field that is optional in requests is always present in responses
        all.entry(name).or_insert(schema);
    }
    all
}

fn incoming() -> Schemas {
    let (mut all, mut limited) = (Schemas::new(), BTreeSet::new());
    for (route, serves) in ROUTES.values().flatten() {
        if let Content::Json(form) = route.body {
            let (name, schema) = body_of(route, form, serves.takes_not_after());
            put(&mut all, &name, &schema);
            within(&mut all, form, Direction::In);
            if serves.takes_not_after() {
                limited.insert(name);
            }
        }
    }
    for row in &ROWS {
        let Some(topic) = &row.topic else { continue };
        let (name, schema) = payload_of(topic);
        put(&mut all, &name, &schema);
        within(&mut all, topic.form, Direction::In);
        if topic.envelope.is_empty() && row.takes_not_after {
            limited.insert(name);
        }
    }
    within(&mut all, Form::for_type::<CommandMeta>(), Direction::In);
    named(&mut all, Form::for_type::<ClientFrame>(), Direction::In);
    let not_after =
        schema_of(Form::for_type::<CommandMeta>(), Direction::In).0["properties"]["not_after"].clone();
    for name in &limited {
        add_not_after(&mut all, name, &not_after);
    }
    all
}

/// Adds the age limit to an object, or to each alternative of a schema.
fn add_not_after(all: &mut Schemas, name: &str, not_after: &Value) {
    let schema = &mut all[name];
    if let Some(properties) = schema.get_mut("properties").and_then(Value::as_object_mut) {
        properties.insert("not_after".to_owned(), not_after.clone());
        return;
    }
    let choices = schema["anyOf"].as_array().cloned().unwrap_or_default();
    if choices.is_empty() && schema["additionalProperties"] == false {
        schema["properties"] = json!({"not_after": not_after});
    }
    for choice in choices {
        let reference = choice["$ref"].as_str().unwrap();
        add_not_after(all, reference.rsplit('/').next().unwrap(), not_after);
    }
}

/// Names of the schemas that the server and the runtime send.
static SENT_SCHEMAS: LazyLock<BTreeSet<String>> =
    LazyLock::new(|| outgoing().into_iter().map(|(name, _)| name).collect());

/// Schemas of the messages that the server and the runtime send.
pub(super) fn outgoing() -> Schemas {
    let mut all = Schemas::new();
    let of_routes = ROUTES.values().flatten().flat_map(|(route, _)| route.answers());
    let of_routes = of_routes.filter_map(|(_, content)| match content {
        Content::Json(form) => Some(form),
        _ => None,
    });
    let of_topics = outbound().into_iter().map(|topic| topic.form());
    for form in of_routes.chain(of_topics) {
        named(&mut all, form, Direction::Out);
    }
    named(&mut all, Form::for_type::<Problem>(), Direction::Out);
    named(&mut all, Form::for_type::<ErrorFrame>(), Direction::Out);
    named(
        &mut all,
        Form::for_type::<MessageEnvelope<'static, FrameTopic>>(),
        Direction::Out,
    );
    let message = &mut all["WebSocketMessage"];
    message["description"] =
        "The message of the topic, with its path in front; see the topic's channel for the other fields."
            .into();
    message["additionalProperties"] = true.into();
    all
}

/// Returns name and schema of a route's body: for a command, the arguments of its verb, without those in the path. A
/// body that may carry an age limit is no response, so it has a separate name.
pub(super) fn body_of(route: &Route, form: Form, takes_not_after: bool) -> (String, Value) {
    let (mut name, mut schema) = ((form.name)().into_owned(), schema_of(form, Direction::In).0);
    if takes_not_after && SENT_SCHEMAS.contains(&name) {
        name += "Change";
    }
    let verb = route.fixed().find(|(name, _)| *name == "verb");
    if let Some((_, verb)) = verb
        && let Some(variants) = schema["oneOf"].as_array()
    {
        let mut variants = variants.iter().map(|variant| &variant["properties"][verb]);
        schema = variants.find(|args| !args.is_null()).unwrap().clone();
        name = format!("{}Args", camel_case(verb));
    }
    let in_path: Vec<_> = route.names().collect();
    let Some(properties) = schema.get_mut("properties").and_then(Value::as_object_mut) else {
        return (name, schema);
    };
    let before = properties.len();
    properties.retain(|property, _| !in_path.contains(&property.as_str()));
    if properties.len() < before {
        let is_left = |property: &Value| !in_path.contains(&property.as_str().unwrap());
        schema["required"].as_array_mut().unwrap().retain(is_left);
        name = format!("{}Body", camel_case(route.pattern.rsplit('/').next().unwrap()));
    }
    (name, schema)
}

/// Returns the name and schema of a topic's payload, with its envelope.
pub(super) fn payload_of(topic: &InboundTopic) -> (String, Value) {
    let (name, mut schema) = (
        (topic.form.name)().into_owned(),
        schema_of(topic.form, Direction::In).0,
    );
    if topic.envelope.is_empty() {
        return (name, schema);
    }
    let meta = schema_of(Form::for_type::<CommandMeta>(), Direction::In).0;
    let mut required = schema["required"].as_array().cloned().unwrap_or_default();
    for field in topic.envelope {
        schema["properties"][*field] = meta["properties"][*field].clone();
    }
    let needed = meta["required"].as_array().unwrap().iter();
    required.extend(
        needed
            .filter(|name| topic.envelope.contains(&name.as_str().unwrap()))
            .cloned(),
    );
    schema["required"] = required.into();
    (format!("{name}Message"), schema)
}

fn camel_case(word: &str) -> String {
    let words = word.split('_').map(|word| word[..1].to_uppercase() + &word[1..]);
    words.collect()
}

pub(super) fn reference(name: &str) -> Value {
    json!({"$ref": format!("#/components/schemas/{name}")})
}

/// Returns the schema of a form by its name, and those within it.
fn named(all: &mut Schemas, form: Form, way: Direction) {
    let name = (form.name)().into_owned();
    put(all, &name, &schema_of(form, way).0);
    within(all, form, way);
}

fn within(all: &mut Schemas, form: Form, way: Direction) {
    for (name, schema) in schema_of(form, way).1 {
        put(all, &name, &schema);
    }
}

/// Returns the schema of a form, and of the types within it.
fn schema_of(form: Form, way: Direction) -> (Value, Schemas) {
    let settings = SchemaSettings::draft2020_12().with(|settings| {
        settings.definitions_path = "/components/schemas".into();
        settings.meta_schema = None;
    });
    let settings = match way {
        Direction::Out => settings.for_serialize(),
        Direction::In => settings.for_deserialize(),
    };
    let mut generator = settings.into_generator();
    let schema = (form.schema)(&mut generator).to_value();
    (schema, generator.take_definitions(true))
}

/// Adds a schema under a name. Panics if the name already has another schema.
fn put(all: &mut Schemas, name: &str, schema: &Value) {
    let kept = all.entry(name).or_insert_with(|| schema.clone());
    assert_eq!(kept, schema, "two schemas of the name {name}");
}
