//! Whether the stored files of a machine fit together, and the question about those that do not.

use serde::{Deserialize, Serialize};

use super::Timestamp;

/// Payload of `stored_data`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct StoredData {
    /// The question that a person must answer; `null`: the stored files fit together.
    pub question: Option<StoredDataQuestion>,
}

/// Stored files that do not fit together. Until a person accepts or refuses them, their content is not used, and no program
/// starts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct StoredDataQuestion {
    /// When the start that found them began.
    pub since: Timestamp,
    /// Time of the newest entry of the journal at that start: what was stored up to then should be there. `null`: the journal
    /// has no entry.
    pub newest_journal_entry: Option<Timestamp>,
    /// What does not fit.
    pub findings: Vec<StoredDataFinding>,
}

impl StoredDataQuestion {
    /// What does not fit, in words.
    pub fn texts(&self) -> Vec<String> {
        let findings = self.findings.iter();
        findings.map(|finding| finding.text.clone()).collect()
    }
}

/// A part of the stored data that does not fit the others.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct StoredDataFinding {
    /// The part.
    pub part: StoredDataPart,
    /// How it does not fit.
    pub fault: StoredDataFault,
    /// The same in words, with the files.
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

/// How a part of the stored data does not fit the others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum StoredDataFault {
    /// It is an older copy: other files know a newer generation of it.
    Older,
    /// It belongs to a machine of another name.
    OtherMachine,
    /// Its checksums are missing, damaged or those of another file.
    NotVerified,
}

/// What a person decides about stored files that do not fit together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum StoredDataDecision {
    /// They are used as they are.
    Accept,
    /// They are not used: their values count as lost.
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
