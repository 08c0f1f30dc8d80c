//! A start in the middle of a program, and the state in force at that line.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::params::Params;
use super::state::{CallSite, Modal};

/// Start of a run at a line other than the beginning of the loaded program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LineStart {
    /// Line of the first block of the run, from 1.
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    pub from_line: u32,
    /// The program that contains the line, if it is a subprogram; null for the loaded program.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = 9999)))]
    pub program: Option<u16>,
    /// Number of the pass of the program over the line, from 1; required if the program reaches the line more
    /// than once, as in loops and subprograms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    pub occurrence: Option<u32>,
    /// How the axes approach the start of the block.
    #[serde(default)]
    pub approach: Approach,
}

impl LineStart {
    /// Creates a start at a line that the loaded program reaches once, with the approach
    /// [`Approach::PlaneFirst`].
    pub fn line(from_line: u32) -> Self {
        Self {
            from_line,
            program: None,
            occurrence: None,
            approach: Approach::default(),
        }
    }
}

/// Order in which the axes approach the start of a run from a line, each at its maximum speed. The infeed
/// axis is the axis at right angles to the plane in force: Z in G17.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Approach {
    /// All axes except the infeed axis, then the infeed axis.
    #[default]
    PlaneFirst,
    /// The infeed axis, then all others.
    InfeedFirst,
    /// All axes at the same time.
    Direct,
}

/// State in force at the line where a run begins, and the actions of the start before the block of that line.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LineState {
    /// The program that contains the line.
    pub program: u16,
    /// The line.
    pub line: u32,
    /// Number of the pass of the program over the line, from 1.
    pub occurrence: u32,
    /// Text of the line.
    pub block: String,
    /// Calls that lead to the line, the main program first.
    pub stack: Vec<CallSite>,
    /// Codes, feedrate, speed, tool and work offset in force.
    pub modal: Modal,
    /// Start position of the block in work coordinates, by axis letter, mm or degrees.
    pub work: BTreeMap<String, f64>,
    /// Start position of the block in machine coordinates, by axis letter, mm or degrees.
    pub machine: BTreeMap<String, f64>,
    /// Motions from the current position to the start position, in order. Each entry contains axis letters
    /// with machine positions.
    pub approach: Vec<BTreeMap<String, f64>>,
    /// M codes that are issued before the approach, in order.
    pub restore: Vec<RestoredOutput>,
    /// The latest output of each other M code that the program would have issued before the line; these
    /// outputs are not issued.
    pub not_restored: Vec<RestoredOutput>,
    /// P and Q variables that the program sets before the line, by name; the start sets them.
    pub variables: BTreeMap<String, f64>,
}

/// An M code that a program issues before the line at which a run begins.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RestoredOutput {
    /// M number.
    pub m: u16,
    /// Parameters of the M code.
    pub params: Params,
    /// The program that contains the M code.
    pub program: u16,
    /// Line of the M code.
    pub line: u32,
}
