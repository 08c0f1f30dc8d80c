//! Data that NC programs and sequence programs share: variables, tools, work offsets.

use std::collections::BTreeMap;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::execution::Execution;
use super::output::PendingOutput;
use super::{BootId, CoordinateSystemNumber, Timestamp};

/// Variables of one read or write at the most; more are refused as `too_large`. Reason: a message stays below 64 KiB.
pub const VARIABLES_AT_ONCE_MAX: usize = 1024;

/// A number of a variable in JSON, which may be none: `"NaN"`, `"inf"` and `"-inf"` are strings there. One equals another of the
/// same bits, so that NaN equals itself: of values that are compared to find what has changed, it has not.
#[derive(Debug, Clone, Copy)]
pub struct Number(pub f64);

impl PartialEq for Number {
    fn eq(&self, other: &Self) -> bool {
        self.0.to_bits() == other.0.to_bits()
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for Number {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Number".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({"anyOf": [{"type": "number"}, {"enum": ["NaN", "inf", "-inf"]}]})
    }
}

impl Serialize for Number {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if self.0.is_finite() {
            serializer.serialize_f64(self.0)
        } else {
            serializer.collect_str(&self.0)
        }
    }
}

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Written {
            Number(f64),
            Word(String),
        }
        match Written::deserialize(deserializer) {
            Ok(Written::Number(value)) => Ok(Self(value)),
            Ok(Written::Word(word)) if word == "NaN" => Ok(Self(f64::NAN)),
            Ok(Written::Word(word)) if word == "inf" => Ok(Self(f64::INFINITY)),
            Ok(Written::Word(word)) if word == "-inf" => Ok(Self(f64::NEG_INFINITY)),
            _ => Err(D::Error::custom(
                "a value is a number, or one of the strings \"NaN\", \"inf\" and \"-inf\"",
            )),
        }
    }
}

/// Lines of the journal of one answer at the most.
pub const JOURNAL_LINES_MAX: u32 = 1000;

/// Letter of the variables that outlive a program (manual 4-3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum VariableKind {
    /// P0 to P32767, the same for all coordinate systems.
    P,
    /// Q0 to Q4095, of one coordinate system.
    Q,
}

/// Variables that lie together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum VariableArea {
    /// P, the same for all coordinate systems.
    Global,
    /// Q of a coordinate system.
    CoordinateSystem(CoordinateSystemNumber),
}

impl VariableArea {
    /// The area that a letter names where a coordinate system is spoken of.
    pub fn of(kind: VariableKind, cs: CoordinateSystemNumber) -> Self {
        match kind {
            VariableKind::P => VariableArea::Global,
            VariableKind::Q => VariableArea::CoordinateSystem(cs),
        }
    }

    /// The coordinate system of Q variables; `None`: those of the machine.
    pub fn coordinate_system(self) -> Option<CoordinateSystemNumber> {
        match self {
            VariableArea::Global => None,
            VariableArea::CoordinateSystem(cs) => Some(cs),
        }
    }

    /// The letter of its variables.
    pub fn kind(self) -> VariableKind {
        match self {
            VariableArea::Global => VariableKind::P,
            VariableArea::CoordinateSystem(_) => VariableKind::Q,
        }
    }
}

/// Values of variables in a row, as they were at one moment: in the reply to `variable/get`, and of
/// `GET /variables/p`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct VariableValues {
    /// Their letter.
    pub kind: VariableKind,
    /// Number of the first.
    pub from: u32,
    /// Their values, ascending by number.
    pub values: Vec<Number>,
}

impl VariableValues {
    /// Values of variables from `from` on.
    pub fn new(kind: VariableKind, from: u32, values: impl IntoIterator<Item = f64>) -> Self {
        let values = values.into_iter().map(Number).collect();
        Self { kind, from, values }
    }

    /// The values as plain numbers.
    pub fn numbers(&self) -> Vec<f64> {
        self.values.iter().map(|number| number.0).collect()
    }
}

/// The variables that the configuration names in `[[variables.published]]`, as they were at one moment: of the topics `variables` and
/// `cs/{cs}/variables`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PublishedVariables {
    /// Variables in a row, in the order of the configuration. One whose value is damaged (warning 406) is `"NaN"`.
    pub variables: Vec<VariableValues>,
}

impl PublishedVariables {
    /// Values of `count` variables from `from` on; `None`: not all of them are published.
    pub fn values(&self, from: u32, count: u32) -> Option<Vec<f64>> {
        let numbers = from..from.checked_add(count)?;
        numbers.map(|number| self.value(number)).collect()
    }

    fn value(&self, number: u32) -> Option<f64> {
        let mut rows = self.variables.iter();
        rows.find_map(|row| row.values.get(number.checked_sub(row.from)? as usize))
            .map(|number| number.0)
    }
}

/// A tool of the table: what G41 to G44 take (D17).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ToolData {
    /// Tool number, from 1.
    pub id: u16,
    /// Radius, mm, 0 or more: the offset of G41 and G42.
    #[serde(default)]
    pub radius: f64,
    /// Length, mm: G43 adds it to Z, G44 takes it away.
    #[serde(default)]
    pub length: f64,
}

/// The tool table, ascending by number: of `GET /tools`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ToolTable {
    /// Its tools.
    pub tools: Vec<ToolData>,
}

/// A change of the tool table, carried out as a whole or not at all: body of `PUT /tools`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ToolChange {
    /// Tools to set, new ones among them; those not named stay.
    #[serde(default)]
    pub tools: Vec<ToolData>,
    /// Numbers of tools to take out.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remove: Vec<u16>,
}

/// Work offsets of a coordinate system, mm or degrees: of `GET /cs/{n}/work_offsets`. As a change, the body of `PUT`
/// there, offsets and axes that it does not name stay, and it is carried out as a whole or not at all.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct WorkOffsetTable {
    /// `G54` to `G59`, each with its value by axis letter.
    pub work_offsets: BTreeMap<String, BTreeMap<String, f64>>,
}

/// Work offsets of a coordinate system, mm or degrees: of the topic `cs/{cs}/work_offsets`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct WorkOffsetValues {
    /// `G54` to `G59`, each with its value by axis letter.
    pub work_offsets: BTreeMap<String, BTreeMap<String, f64>>,
}

/// Which lines of the journal are read: of `GET /journal`. What is not named may be anything.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct JournalFilter {
    /// From this time on: in UTC, such as `2026-11-25` or `2026-11-25T10:00`, or how long ago, such as `2h` or `30m`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub since: Option<String>,
    /// Before this time, written in the same way.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub until: Option<String>,
    /// Of this coordinate system; 0: of the machine.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cs: Option<CoordinateSystemNumber>,
    /// Of outputs of this M number, and of stops by it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub m: Option<u16>,
    /// Of this user, client or handler.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub user: Option<String>,
    /// Of this run: its `run_id` `BOOT-1-7`, or `1-7` of every start of the runtime.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub run: Option<String>,
}

/// How the last run of a coordinate system stood when an earlier start of the runtime ended, at most 100 ms before that:
/// of `GET /cs/{n}/last_run`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LastRun {
    /// The start of the runtime that the run belongs to.
    pub boot_id: BootId,
    /// Names the run within that start.
    pub run_id: String,
    /// Main program.
    pub program: Option<u16>,
    /// Program that runs, main or subprogram.
    pub running: Option<u16>,
    /// Line whose motion runs, from 1.
    pub line: u32,
    /// State word.
    pub execution: Execution,
    /// Auxiliary function outputs that are open.
    pub outputs: Vec<PendingOutput>,
    /// When this was so.
    pub at: Timestamp,
}

impl LastRun {
    /// True when the run has not come to an end.
    pub fn is_under_way(&self) -> bool {
        !matches!(
            self.execution,
            Execution::Ready | Execution::Stopped | Execution::ProgramCompleted
        )
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{from_value, json, to_value};

    use super::*;

    #[test]
    fn what_is_no_number_is_a_string_in_json_and_comes_back() {
        let values = [1.5, f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
        let written = to_value(VariableValues::new(VariableKind::P, 3, values)).unwrap();
        assert_eq!(
            written,
            json!({"kind": "P", "from": 3, "values": [1.5, "NaN", "inf", "-inf"]})
        );
        let read: VariableValues = from_value(written).unwrap();
        assert!(read.numbers()[1].is_nan());
        assert_eq!(read.numbers()[2..], [f64::INFINITY, f64::NEG_INFINITY]);
        for wrong in [json!("12"), json!(null), json!(true), json!([1])] {
            assert!(from_value::<Number>(wrong.clone()).is_err(), "{wrong}");
        }
    }
}
