//! Changes of programs in the form in which the journal records them.

use serde::{Deserialize, Serialize};

/// A change of a program.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Edit {
    /// Number of the program.
    pub program: u16,
    /// Kind of the change.
    pub what: EditKind,
    /// Hash of the previous program; `None` if no program existed or its hash is unknown.
    #[serde(rename = "old_hash", deserialize_with = "Option::deserialize")]
    pub old: Option<String>,
    /// Hash of the new program; `None` if no program exists now.
    #[serde(rename = "new_hash", deserialize_with = "Option::deserialize")]
    pub new: Option<String>,
}

/// Kind of a program change.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EditKind {
    /// A new program was stored.
    Upload,
    /// A different program replaced the previous one.
    Replace,
    /// An identical program was stored again.
    Unchanged,
    /// The program was removed.
    Delete,
    /// The file was added, changed or removed outside of the runtime.
    Outside,
    /// The program was read from the file that the configuration names.
    Configuration,
}

impl Edit {
    /// Creates the record for a change of a program's file outside of the runtime.
    pub(super) fn outside(program: u16, old: Option<String>, new: Option<&str>) -> Self {
        Self {
            program,
            what: EditKind::Outside,
            old,
            new: new.map(str::to_owned),
        }
    }
}
