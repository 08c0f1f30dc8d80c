//! Changes of programs, as the journal records them.

use serde::{Deserialize, Serialize};

/// What has become of a program.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Edit {
    /// Its number.
    pub program: u16,
    /// What was done.
    pub what: EditKind,
    /// Hash of what was there before; `None`: nothing, or nobody knows.
    #[serde(rename = "old_hash", deserialize_with = "Option::deserialize")]
    pub old: Option<String>,
    /// Hash of what is there now; `None`: nothing.
    #[serde(rename = "new_hash", deserialize_with = "Option::deserialize")]
    pub new: Option<String>,
}

/// How a program has changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EditKind {
    /// A new one was stored.
    Upload,
    /// Another one was stored in its place.
    Replace,
    /// The same was stored once more.
    Unchanged,
    /// It was removed.
    Delete,
    /// Its file was put there, changed or removed outside of the runtime.
    Outside,
    /// It was taken from the file that the configuration names.
    Configuration,
}

impl Edit {
    /// Its file was changed outside of the runtime.
    pub(super) fn outside(program: u16, old: Option<String>, new: Option<&str>) -> Self {
        Self {
            program,
            what: EditKind::Outside,
            old,
            new: new.map(str::to_owned),
        }
    }
}
