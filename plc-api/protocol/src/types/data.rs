//! Data that NC programs and sequence programs share: variables, tools, work offsets.

use std::collections::BTreeMap;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::execution::Execution;
use super::output::PendingOutput;
use super::{BootId, CoordinateSystemNumber, Timestamp};

/// Largest number of variables of one read or write; a request for more is refused as `too_large`. Reason: a
/// message stays below 64 KiB.
pub const VARIABLES_AT_ONCE_MAX: usize = 1024;

/// Value of a variable in JSON. Numbers that are not finite are strings: `"NaN"`, `"inf"` and `"-inf"`.
/// Equality compares the bits, so NaN equals NaN: a comparison for changes does not report an unchanged NaN.
#[derive(Debug, Clone, Copy)]
pub struct JsonNumber(pub f64);

impl PartialEq for JsonNumber {
    fn eq(&self, other: &Self) -> bool {
        self.0.to_bits() == other.0.to_bits()
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for JsonNumber {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Number".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({"anyOf": [{"type": "number"}, {"enum": ["NaN", "inf", "-inf"]}]})
    }
}

impl Serialize for JsonNumber {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if self.0.is_finite() {
            serializer.serialize_f64(self.0)
        } else {
            serializer.collect_str(&self.0)
        }
    }
}

impl<'de> Deserialize<'de> for JsonNumber {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum NumberOrWord {
            Number(f64),
            Word(String),
        }
        match NumberOrWord::deserialize(deserializer) {
            Ok(NumberOrWord::Number(value)) => Ok(Self(value)),
            Ok(NumberOrWord::Word(word)) if word == "NaN" => Ok(Self(f64::NAN)),
            Ok(NumberOrWord::Word(word)) if word == "inf" => Ok(Self(f64::INFINITY)),
            Ok(NumberOrWord::Word(word)) if word == "-inf" => Ok(Self(f64::NEG_INFINITY)),
            _ => Err(D::Error::custom(
                "a value is a number, or one of the strings \"NaN\", \"inf\" and \"-inf\"",
            )),
        }
    }
}

/// Largest number of journal lines of one answer.
pub const JOURNAL_LINES_MAX: u32 = 1000;

/// Letter of the variables that are kept after the end of a program (manual 4-3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum VariableKind {
    /// P0 to P32767, common to all coordinate systems.
    P,
    /// Q0 to Q4095, of one coordinate system.
    Q,
}

/// A set of variables with common numbers: P of the machine, or Q of one coordinate system.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum VariableArea {
    /// P, common to all coordinate systems.
    Global,
    /// Q of a coordinate system.
    CoordinateSystem(CoordinateSystemNumber),
}

impl VariableArea {
    /// Returns the area of a letter in a message to the coordinate system `cs`.
    pub fn from_kind(kind: VariableKind, cs: CoordinateSystemNumber) -> Self {
        match kind {
            VariableKind::P => VariableArea::Global,
            VariableKind::Q => VariableArea::CoordinateSystem(cs),
        }
    }

    /// Returns the coordinate system of Q variables, or `None` for P variables.
    pub fn coordinate_system(self) -> Option<CoordinateSystemNumber> {
        match self {
            VariableArea::Global => None,
            VariableArea::CoordinateSystem(cs) => Some(cs),
        }
    }

    /// Returns the letter of the variables.
    pub fn kind(self) -> VariableKind {
        match self {
            VariableArea::Global => VariableKind::P,
            VariableArea::CoordinateSystem(_) => VariableKind::Q,
        }
    }
}

/// Values of consecutive variables, all at the same moment: part of the reply to `variable/get`, and response
/// of `GET /variables/p`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct VariableValues {
    /// Letter of the variables.
    pub kind: VariableKind,
    /// Number of the first variable.
    pub from: u32,
    /// Values of the variables, ascending by number.
    pub values: Vec<JsonNumber>,
}

impl VariableValues {
    /// Creates the values of consecutive variables, starting at `from`.
    pub fn new(kind: VariableKind, from: u32, values: impl IntoIterator<Item = f64>) -> Self {
        let values = values.into_iter().map(JsonNumber).collect();
        Self { kind, from, values }
    }

    /// Returns the values as plain numbers.
    pub fn numbers(&self) -> Vec<f64> {
        self.values.iter().map(|number| number.0).collect()
    }
}

/// Payload of `variables` and `cs/{cs}/variables`: the variables that `[[variables.published]]` of the
/// configuration lists, all at the same moment.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PublishedVariables {
    /// Ranges of consecutive variables, in the order of the configuration. A damaged value (warning 406) is
    /// `"NaN"`.
    pub variables: Vec<VariableValues>,
}

impl PublishedVariables {
    /// Returns the values of `count` variables starting at `from`, or `None` if not all of them are
    /// published.
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

/// A tool of the tool table: the dimensions that G41 to G44 use (D17).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ToolData {
    /// Tool number, from 1.
    pub id: u16,
    /// Radius, mm, 0 or more: the offset of G41 and G42.
    #[serde(default)]
    pub radius: f64,
    /// Length, mm: G43 adds it to Z, G44 subtracts it.
    #[serde(default)]
    pub length: f64,
}

/// The tool table, ascending by number: response of `GET /tools` and payload of `tools`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ToolTable {
    /// Tools of the table.
    pub tools: Vec<ToolData>,
}

/// A change of the tool table, applied completely or not at all: body of `PUT /tools`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ToolChange {
    /// Tools to change or add; tools that are not in this list do not change.
    #[serde(default)]
    pub tools: Vec<ToolData>,
    /// Numbers of tools to remove.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remove: Vec<u16>,
}

/// Work offsets of a coordinate system, mm or degrees: response of `GET /cs/{n}/work_offsets`. As the body of
/// `PUT` on this route the table is a change: offsets and axes that it does not contain do not change. The
/// machine applies the change completely or not at all.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct WorkOffsetTable {
    /// `G54` to `G59`, each with its value by axis letter.
    pub work_offsets: BTreeMap<String, BTreeMap<String, f64>>,
}

/// Work offsets of a coordinate system, mm or degrees: payload of `cs/{cs}/work_offsets`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct WorkOffsetValues {
    /// `G54` to `G59`, each with its value by axis letter.
    pub work_offsets: BTreeMap<String, BTreeMap<String, f64>>,
}

/// Filter for lines of the journal: query of `GET /journal`. A field that is not set accepts every value.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct JournalFilter {
    /// Earliest time, in UTC, such as `2026-11-25` or `2026-11-25T10:00`, or an age, such as `2h` or `30m`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub since: Option<String>,
    /// Time before which the lines were written, in the same format.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub until: Option<String>,
    /// Lines about this coordinate system; 0 for lines about the whole machine.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cs: Option<CoordinateSystemNumber>,
    /// Lines about outputs of this M number, and about stops that it caused.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub m: Option<u16>,
    /// Lines of this user, client or handler.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub user: Option<String>,
    /// Lines of this run: its complete `run_id`, such as `BOOT-1-7`, or `1-7` for the run of this number in
    /// every boot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub run: Option<String>,
}

/// Response of `GET /cs/{n}/last_run`: the last run of a coordinate system in an earlier boot of the runtime. The
/// state was recorded at most 100 ms before that boot ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LastRun {
    /// The boot of the runtime to which the run belongs.
    pub boot_id: BootId,
    /// Id of the run.
    pub run_id: String,
    /// Main program.
    pub program: Option<u16>,
    /// Program that runs, main or subprogram.
    pub running: Option<u16>,
    /// Line of the block whose motion runs, from 1.
    pub line: u32,
    /// State word.
    pub execution: Execution,
    /// Open auxiliary function outputs.
    pub outputs: Vec<PendingOutput>,
    /// Time of this state.
    pub at: Timestamp,
}

impl LastRun {
    /// Returns true if the run has not ended.
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
            assert!(from_value::<JsonNumber>(wrong.clone()).is_err(), "{wrong}");
        }
    }
}
