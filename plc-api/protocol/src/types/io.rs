//! Inputs and outputs of the plant: readings of its sensors, and commands of sequence programs to its valves.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Deserializer, Serialize};

use super::ids::{check_client_id, is_client_id};
use super::refusal::{Refusal, RefusalCode};

/// Largest number of inputs of a plant, and largest number of outputs. Reason: all declarations are in one
/// message.
pub const IO_MAX: usize = 256;

/// Direction of a signal, from the point of view of sequence programs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum IoSide {
    /// Input from the plant: a contact, a sensor.
    In,
    /// Output of sequence programs: a valve, a lamp.
    Out,
}

impl IoSide {
    /// Both sides.
    pub const ALL: [IoSide; 2] = [IoSide::In, IoSide::Out];

    /// Returns the word for this side in topics and routes: `in` or `out`.
    pub fn wire_name(self) -> &'static str {
        match self {
            IoSide::In => "in",
            IoSide::Out => "out",
        }
    }

    /// Returns the side for the word `in` or `out`, or `None` for another word.
    pub fn of_wire_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|side| side.wire_name() == name)
    }
}

/// One input or output of the plant, by its name. Its text form is the topic, such as `io/in/door_closed`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct IoPoint {
    /// Input or output.
    pub side: IoSide,
    /// Name in the configuration, 1 to 64 characters without `/ + #`.
    pub name: String,
}

impl IoPoint {
    /// Creates an input.
    pub fn input(name: impl Into<String>) -> Self {
        let (side, name) = (IoSide::In, name.into());
        Self { side, name }
    }

    /// Creates an output.
    pub fn output(name: impl Into<String>) -> Self {
        let (side, name) = (IoSide::Out, name.into());
        Self { side, name }
    }

    /// Parses a path such as `in/door_closed`.
    pub(super) fn parse(path: &str) -> Option<Self> {
        let (side, name) = path.split_once('/')?;
        let (side, name) = (IoSide::of_wire_name(side)?, name.to_owned());
        is_client_id(&name).then_some(Self { side, name })
    }
}

impl fmt::Display for IoPoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "io/{}/{}", self.side.wire_name(), self.name)
    }
}

/// The value of an input or output.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(untagged)]
pub enum IoValue {
    /// On or off.
    Bool(bool),
    /// A number in the declared unit.
    Number(f64),
}

impl IoValue {
    /// Returns true if the on/off value is on; false if it is off, and for a number.
    pub fn is_on(self) -> bool {
        self == true
    }

    /// Returns the number, or `None` for an on/off value.
    pub fn as_number(self) -> Option<f64> {
        match self {
            IoValue::Number(number) => Some(number),
            IoValue::Bool(_) => None,
        }
    }

    /// Returns the kind of the value.
    pub fn kind(self) -> IoKind {
        match self {
            IoValue::Bool(_) => IoKind::Bool,
            IoValue::Number(_) => IoKind::Number,
        }
    }
}

impl Default for IoValue {
    fn default() -> Self {
        IoValue::Bool(false)
    }
}

impl fmt::Display for IoValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            IoValue::Bool(value) => value.fmt(f),
            IoValue::Number(value) => value.fmt(f),
        }
    }
}

impl From<bool> for IoValue {
    fn from(value: bool) -> Self {
        IoValue::Bool(value)
    }
}

impl From<f64> for IoValue {
    fn from(value: f64) -> Self {
        IoValue::Number(value)
    }
}

/// Compares an on/off value, as in `value == true`. A number is equal to neither `true` nor `false`.
impl PartialEq<bool> for IoValue {
    fn eq(&self, other: &bool) -> bool {
        matches!(self, IoValue::Bool(value) if value == other)
    }
}

impl PartialEq<f64> for IoValue {
    fn eq(&self, other: &f64) -> bool {
        matches!(self, IoValue::Number(value) if value == other)
    }
}

/// Compares a number, as in `value > 12.5`. An on/off value is neither greater nor less.
impl PartialOrd<f64> for IoValue {
    fn partial_cmp(&self, other: &f64) -> Option<Ordering> {
        self.as_number()?.partial_cmp(other)
    }
}

/// Kind of a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum IoKind {
    /// On or off.
    #[default]
    Bool,
    /// A number with a unit and a range.
    Number,
}

/// The value of an input or output whose owner is lost.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(untagged, expecting = "write true, false, a number or \"keep\"")]
pub enum IoLoss {
    /// A safe value, which also applies at a start of the machine.
    Value(IoValue),
    /// The value that the owner wrote last is kept.
    Keep(KeepWord),
}

impl IoLoss {
    /// The value that the owner wrote last is kept.
    pub const KEEP: Self = IoLoss::Keep(KeepWord::Keep);

    /// Returns the safe value, or `None` if the value that the owner wrote last stays.
    pub fn value(self) -> Option<IoValue> {
        match self {
            IoLoss::Value(value) => Some(value),
            IoLoss::Keep(_) => None,
        }
    }
}

impl Default for IoLoss {
    fn default() -> Self {
        IoLoss::Value(IoValue::default())
    }
}

impl<T: Into<IoValue>> From<T> for IoLoss {
    fn from(value: T) -> Self {
        IoLoss::Value(value.into())
    }
}

/// The word `keep`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum KeepWord {
    /// `keep`
    Keep,
}

/// The value of an output at a start of the machine.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(untagged, expecting = "write true, false, a number or \"last\"")]
pub enum IoStart {
    /// A fixed value.
    Value(IoValue),
    /// The value that was written last before the start.
    Last(LastWord),
}

impl IoStart {
    /// The value that was written last before the start.
    pub const LAST: Self = IoStart::Last(LastWord::Last);
}

impl<T: Into<IoValue>> From<T> for IoStart {
    fn from(value: T) -> Self {
        IoStart::Value(value.into())
    }
}

/// The word `last`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum LastWord {
    /// `last`
    Last,
}

/// Configuration of an input or output.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct IoDeclaration {
    /// On/off or number.
    pub kind: IoKind,
    /// The value while its owner is lost: a safe value, which also applies at a start, or `keep`.
    pub on_loss: IoLoss,
    /// With `on_loss` `keep`: the value at a start of the machine, or `last`, the value that was written last
    /// before the start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_start: Option<IoStart>,
    /// Description for people; empty if the name is sufficient.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub text: String,
    /// Unit of a number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// Lowest allowed number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min: Option<f64>,
    /// Highest allowed number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max: Option<f64>,
}

impl IoDeclaration {
    /// Creates a declaration with this safe value, which determines the kind, without a range.
    pub fn new(on_loss: impl Into<IoValue>) -> Self {
        let on_loss = on_loss.into();
        Self {
            kind: on_loss.kind(),
            on_loss: on_loss.into(),
            ..Self::default()
        }
    }

    /// Sets `on_loss` to `keep`: after a loss of the owner, its last value is kept. `at_start` is the value
    /// at a start of the machine.
    #[must_use]
    pub fn kept(self, at_start: impl Into<IoStart>) -> Self {
        Self {
            on_loss: IoLoss::KEEP,
            at_start: Some(at_start.into()),
            ..self
        }
    }

    /// Returns true if the value that was written last is kept across starts of the machine.
    pub fn keeps_last(&self) -> bool {
        self.at_start == Some(IoStart::LAST)
    }

    /// Returns the value at a start of the machine. If `last` is declared but no value is stored, the value
    /// is off, or the allowed number nearest to 0.
    pub fn first_value(&self) -> IoValue {
        let zero = match self.kind {
            IoKind::Bool => IoValue::Bool(false),
            IoKind::Number => {
                let (low, high) = (self.min.unwrap_or(f64::MIN), self.max.unwrap_or(f64::MAX));
                IoValue::Number(0.0_f64.max(low).min(high))
            }
        };
        match self.at_start {
            Some(IoStart::Value(value)) => value,
            Some(IoStart::Last(_)) => zero,
            None => self.on_loss.value().unwrap_or(zero),
        }
    }

    /// Checks that the input or output can have this value.
    ///
    /// # Errors
    /// Fails if the value is of the other kind or out of range. The error text gives the correct form.
    pub fn check(&self, value: IoValue) -> Result<(), String> {
        match (self.kind, value) {
            (IoKind::Bool, IoValue::Bool(_)) => Ok(()),
            (IoKind::Bool, IoValue::Number(_)) => Err(format!("{value}: write true or false")),
            (IoKind::Number, IoValue::Bool(_)) => Err(format!("{value}: write a number")),
            (IoKind::Number, IoValue::Number(number)) => {
                let (low, high) = (self.min.unwrap_or(f64::MIN), self.max.unwrap_or(f64::MAX));
                if (low..=high).contains(&number) {
                    return Ok(());
                }
                Err(match (self.min, self.max) {
                    (Some(low), Some(high)) => format!("{number}: write {low} to {high}"),
                    (Some(low), None) => format!("{number}: write {low} or more"),
                    (None, Some(high)) => format!("{number}: write {high} or less"),
                    (None, None) => format!("{number}: write a finite number"),
                })
            }
        }
    }
}

/// All inputs and outputs of a plant, as the configuration declares them.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct IoDeclarations {
    /// Inputs by name.
    #[serde(rename = "in", default)]
    pub inputs: BTreeMap<String, IoDeclaration>,
    /// Outputs by name.
    #[serde(rename = "out", default)]
    pub outputs: BTreeMap<String, IoDeclaration>,
}

impl IoDeclarations {
    /// Returns the declarations of one side.
    pub fn on_side(&self, side: IoSide) -> &BTreeMap<String, IoDeclaration> {
        match side {
            IoSide::In => &self.inputs,
            IoSide::Out => &self.outputs,
        }
    }

    /// Returns true for an output whose last value is kept across starts of the machine.
    pub fn keeps_last(&self, point: &IoPoint) -> bool {
        let declared = self.on_side(point.side).get(&point.name);
        declared.is_some_and(IoDeclaration::keeps_last)
    }

    /// Adds a declaration, or replaces the existing one.
    pub fn insert(&mut self, point: IoPoint, declaration: IoDeclaration) {
        let declared = match point.side {
            IoSide::In => &mut self.inputs,
            IoSide::Out => &mut self.outputs,
        };
        declared.insert(point.name, declaration);
    }

    /// Returns all inputs and outputs with their declarations.
    pub fn points(&self) -> impl Iterator<Item = (IoPoint, &IoDeclaration)> {
        IoSide::ALL.into_iter().flat_map(|side| {
            let declared = self.on_side(side).iter();
            declared.map(move |(name, declaration)| {
                let name = name.clone();
                (IoPoint { side, name }, declaration)
            })
        })
    }
}

/// Payload of `io/in/{name}` and `io/out/{name}`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct IoState {
    /// The value in force: the forced value, otherwise the written value.
    pub value: IoValue,
    /// The value that was written last. Before the first write it is the start value; after the loss of the
    /// owner it is the value of `on_loss`.
    pub written: IoValue,
    /// The handler that owns the input or output, because it wrote the value last. While the owner is not
    /// lost, only the owner may write; after a loss of the owner (`lost`), any handler may write. Null if no
    /// handler has written a value since the start: then any handler and any client without presence may
    /// write.
    pub owner: Option<String>,
    /// True once the owner is lost; the value is then that of `on_loss`. The owner of an output is lost if it
    /// left without an announcement and did not return within `grace_ms`, or did not return within the
    /// announced time. The owner of an input is also lost at once if it leaves without an announcement.
    #[serde(default)]
    pub lost: bool,
    /// True if the value that was written last before the start (`at_start = "last"`) is damaged: the
    /// previous value of the output is unknown until a value is written or forced.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub unknown: bool,
    /// The forced value that replaces the written value; null if no value is forced.
    pub forced: Option<IoForced>,
}

/// A forced value that replaces the written value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct IoForced {
    /// The value.
    pub value: IoValue,
    /// User or client that forced the value.
    pub by: String,
}

/// Payload of `io/in/{name}/set` and `io/out/{name}/set`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct IoSet {
    /// The value.
    pub value: IoValue,
    /// The handler that owns the input or output after this message; its presence must be online.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub handler_id: Option<String>,
    /// With `handler_id`: the instance that the presence of the handler names. Required if the presence names
    /// an instance; another instance is refused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
}

/// Payload of `io/in/{name}/force` and `io/out/{name}/force`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct IoForce {
    /// The value that is in force after this message; null ends the forcing, and the written value is in
    /// force again.
    #[serde(deserialize_with = "null_or_value")]
    #[cfg_attr(feature = "schema", schemars(required, schema_with = "value_or_null"))]
    pub value: Option<IoValue>,
    /// Name of the sender, if the machine does not know the user.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub by: Option<String>,
}

impl IoForce {
    /// Validates the name of the user.
    ///
    /// # Errors
    /// Fails if the name is not valid.
    pub(crate) fn check(&self) -> Result<(), Refusal> {
        self.by.as_ref().map_or(Ok(()), |by| check_client_id("by", by))
    }
}

#[cfg(feature = "schema")]
fn value_or_null(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
    let value = generator.subschema_for::<IoValue>();
    schemars::json_schema!({"anyOf": [value, {"type": "null"}]})
}

/// Reads a field that must be present, but may be null.
fn null_or_value<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<IoValue>, D::Error> {
    Option::deserialize(deserializer)
}

impl IoSet {
    /// Validates the id of the handler.
    ///
    /// # Errors
    /// Fails if an id is not valid.
    pub(crate) fn check(&self) -> Result<(), Refusal> {
        let id = self.handler_id.as_ref();
        id.map_or(Ok(()), |id| check_client_id("handler_id", id))
    }
}

/// Creates the refusal of a request about an input or output of the plant.
pub fn refused(code: RefusalCode, point: &IoPoint, why: impl fmt::Display) -> Refusal {
    Refusal::new(code, format!("{point}: {why}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_compares_with_what_is_of_its_kind() {
        let (on, level) = (IoValue::Bool(true), IoValue::Number(12.5));
        assert!(on == true && on != false && on.is_on());
        assert!(level > 12.0 && level == 12.5 && level <= 12.5);
        assert!(on != 1.0 && !(on > 0.0) && !(on < 2.0) && !level.is_on());
    }

    #[test]
    fn a_value_is_of_the_kind_and_in_the_range_of_its_declaration() {
        let level = IoDeclaration {
            min: Some(0.0),
            max: Some(60.0),
            ..IoDeclaration::new(0.0)
        };
        assert_eq!(level.check(60.0.into()), Ok(()));
        for (value, says) in [
            (60.5.into(), "0 to 60"),
            (f64::NAN.into(), "0 to 60"),
            (IoValue::Bool(true), "a number"),
        ] {
            assert!(level.check(value).unwrap_err().contains(says), "{value}");
        }
        assert!(IoDeclaration::new(0.0).check(f64::INFINITY.into()).is_err());
        let contact = IoDeclaration::new(false);
        assert_eq!(contact.check(true.into()), Ok(()));
        assert!(contact.check(1.0.into()).unwrap_err().contains("true or false"));
    }

    #[test]
    fn a_force_says_its_value_or_null_and_leaves_neither_out() {
        let read = |json: &str| {
            serde_json::from_str::<IoForce>(json)
                .ok()
                .map(|force| force.value)
        };
        assert_eq!(read(r#"{"value":true}"#), Some(Some(IoValue::Bool(true))));
        assert_eq!(read(r#"{"value":7}"#), Some(Some(IoValue::Number(7.0))));
        assert_eq!(read(r#"{"value":null}"#), Some(None));
        for wrong in ["{}", r#"{"by":"panel"}"#, r#"{"value":"on"}"#] {
            assert_eq!(read(wrong), None, "{wrong}");
        }
    }
}
