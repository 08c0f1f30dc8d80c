//! Consistency of the stored files of a machine, and the question about inconsistent files.

use serde::{Deserialize, Serialize};

use super::Timestamp;

/// Payload of `stored_data`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct StoredData {
    /// The question that a person must answer; `null` if the stored files are consistent.
    pub question: Option<StoredDataQuestion>,
}

/// Stored files that are inconsistent. Until a person accepts or refuses them, their content is not used, and
/// no program starts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct StoredDataQuestion {
    /// Time of the start of the runtime that found the inconsistent files.
    pub since: Timestamp,
    /// Time of the newest entry of the journal at that start: all data that were stored before this time
    /// should exist. `null` if the journal has no entry.
    pub newest_journal_entry: Option<Timestamp>,
    /// Inconsistencies that were found.
    pub findings: Vec<StoredDataFinding>,
}

impl StoredDataQuestion {
    /// Returns the texts of all findings.
    pub fn texts(&self) -> Vec<String> {
        let findings = self.findings.iter();
        findings.map(|finding| finding.text.clone()).collect()
    }
}

/// A part of the stored data that is inconsistent with the other parts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct StoredDataFinding {
    /// The inconsistent part.
    pub part: StoredDataPart,
    /// Kind of the inconsistency.
    pub fault: StoredDataFault,
    /// Description of the finding, with the files.
    pub text: String,
}

/// A part of the stored data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum StoredDataPart {
    /// Variables, tools, work offsets and tools in spindles.
    Store,
    /// NC programs.
    Programs,
    /// Folders of programs in lists.
    Folders,
    /// The journal.
    Journal,
}

/// Kind of inconsistency of a part of the stored data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum StoredDataFault {
    /// The part is an older copy: other files refer to a newer generation of the part.
    Older,
    /// The part belongs to a machine with another name.
    OtherMachine,
    /// The checksums of the part are missing, damaged or those of another file.
    NotVerified,
}

/// Decision of a person about inconsistent stored files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum StoredDataDecision {
    /// The files are used as they are.
    Accept,
    /// The files are not used; their values are treated as lost.
    Refuse,
}

/// Body of `POST /stored_data/answer`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct StoredDataAnswer {
    /// The decision.
    pub decision: StoredDataDecision,
}
