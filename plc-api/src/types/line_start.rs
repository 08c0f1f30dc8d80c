//! A start in the middle of a program, and the state in force at that line.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::params::Params;
use super::state::{CallSite, Modal};

/// Where a run begins that does not begin at the head of the loaded program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LineStart {
    /// Line of its first block, from 1.
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    pub from_line: u32,
    /// The program that has the line, where that is a subprogram; null: the loaded one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = 9999)))]
    pub program: Option<u16>,
    /// How many times the program comes to the line, that time included, from 1; needed where it comes there more than once, in
    /// loops and subprograms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    pub occurrence: Option<u32>,
    /// How the axes come to where the block begins.
    #[serde(default)]
    pub approach: Approach,
}

impl LineStart {
    /// The line of the loaded program, which comes there once, and an approach in the plane first.
    pub fn line(from_line: u32) -> Self {
        Self {
            from_line,
            program: None,
            occurrence: None,
            approach: Approach::default(),
        }
    }
}

/// In which order axes go to where a run from a line begins, each as fast as it may. The infeed axis is the one at right
/// angles to the plane in force: Z in G17.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Approach {
    /// All axes but the infeed axis, then that.
    #[default]
    PlaneFirst,
    /// The infeed axis, then all others.
    InfeedFirst,
    /// All axes at the same time.
    Direct,
}

/// What is in force where a run from a line begins, and what such a start does before it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LineState {
    /// The program that has the line.
    pub program: u16,
    /// The line.
    pub line: u32,
    /// Which time it is that the program comes there, from 1.
    pub occurrence: u32,
    /// Text of the line.
    pub block: String,
    /// Calls that lead there, the main program first.
    pub stack: Vec<CallSite>,
    /// Codes, feedrate, speed, tool and work offset in force.
    pub modal: Modal,
    /// Where the block begins, in work coordinates by axis letter, mm or degrees.
    pub work: BTreeMap<String, f64>,
    /// The same in machine coordinates.
    pub machine: BTreeMap<String, f64>,
    /// Motions from where the axes are now to there, in order: axes with their machine positions.
    pub approach: Vec<BTreeMap<String, f64>>,
    /// M codes that are put out before the approach, in order.
    pub restore: Vec<RestoredOutput>,
    /// The newest of each other M code that the program would have put out before, which is not put out.
    pub not_restored: Vec<RestoredOutput>,
    /// P and Q that the program sets on its way there, by name; the start sets them.
    pub variables: BTreeMap<String, f64>,
}

/// An M code that a program puts out before the line that a run begins at.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RestoredOutput {
    /// M number.
    pub m: u16,
    /// Its parameters.
    pub params: Params,
    /// The program that has it.
    pub program: u16,
    /// Its line.
    pub line: u32,
}
