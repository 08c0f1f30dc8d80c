//! Programs of the store, and the findings of a check.

use serde::{Deserialize, Serialize};

/// Bytes of one program's text; more are refused as `too_large`.
pub const PROGRAM_BYTES_MAX: usize = 64 * 1024 * 1024;

/// One program of the store.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ProgramInfo {
    /// Program number, 1 to 9999.
    pub number: u16,
    /// First comment of the text, for lists.
    pub title: String,
    /// Size of the text.
    pub bytes: u64,
    /// Errors that checking finds.
    pub errors: u32,
    /// Warnings that checking finds.
    pub warnings: u32,
    /// Which program this is: SHA-256 of the bytes of its file, which are those of the text as it was sent, 64 hexadecimal
    /// digits.
    #[serde(default)]
    pub hash: String,
    /// Its signature; null on a machine without `[programs] signed_by`, which looks at none.
    #[serde(default)]
    pub signature: Option<SignatureState>,
    /// NC dialect that it is written in: only coordinate systems of this dialect load it.
    #[serde(default)]
    pub dialect: String,
    /// Number that the text itself gives it, in dialects that have one there (`O12345678`); it is not `number`, by which it is
    /// stored, loaded and called.
    #[serde(default)]
    pub o_number: Option<u32>,
    /// The folder that it lies in among others, such as `parts/left`; empty: in none. For lists: it is loaded and called by
    /// its number.
    #[serde(default)]
    pub folder: String,
}

/// Characters of the name of a folder, with those above it.
pub const FOLDER_CHARS_MAX: usize = 120;

/// Folders within each other.
pub const FOLDER_DEPTH_MAX: usize = 8;

/// Where a program lies among others.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ProgramFolder {
    /// Names of folders within each other, such as `parts/left`; empty: in none. Up to 120 characters, 8 names.
    pub folder: String,
}

impl ProgramFolder {
    /// The same as it is kept: without spaces around names.
    ///
    /// # Errors
    /// What to write, as a text: it is too long or too deep, or a name is empty, `.` or `..`, or holds a control character or a backslash.
    pub fn checked(&self) -> Result<Self, String> {
        let names: Vec<&str> = self.folder.split('/').map(str::trim).collect();
        let is_name = |name: &&str| {
            !matches!(*name, "" | "." | "..") && !name.chars().any(|char| char.is_control() || char == '\\')
        };
        let folder = names.join("/");
        let fits = folder.chars().count() <= FOLDER_CHARS_MAX && names.len() <= FOLDER_DEPTH_MAX;
        if folder.is_empty() || fits && names.iter().all(is_name) {
            return Ok(Self { folder });
        }
        Err(format!(
            "folder {:.200?}: write names with / between them, such as parts/left, at most {FOLDER_DEPTH_MAX} names and \
             {FOLDER_CHARS_MAX} characters",
            self.folder
        ))
    }
}

/// What is known of the signature of a program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum SignatureState {
    /// One of the keys of the configuration has signed these bytes.
    Valid,
    /// There is none.
    Missing,
    /// There is one, and none of the keys has made it for these bytes.
    Wrong,
}

/// A program with what tells it from others.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ProgramText {
    /// The text.
    pub text: String,
    /// As in [`ProgramInfo::hash`].
    pub hash: String,
}

/// What checking says of a program.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ProgramCheck {
    /// True when the program is new in the store (of a write).
    #[serde(skip)]
    pub created: bool,
    /// Findings in the order of their places.
    pub diagnostics: Vec<ProgramDiagnostic>,
    /// M codes that the program puts out, ascending.
    pub m_codes: Vec<u16>,
    /// Programs that it calls, ascending.
    pub programs: Vec<u16>,
    /// As in [`ProgramInfo::hash`].
    #[serde(default)]
    pub hash: String,
    /// True when the same program was there already, and nothing has changed (of a write).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub unchanged: bool,
    /// As in [`ProgramInfo::signature`].
    #[serde(default)]
    pub signature: Option<SignatureState>,
    /// As in [`ProgramInfo::dialect`].
    #[serde(default)]
    pub dialect: String,
    /// As in [`ProgramInfo::o_number`].
    #[serde(default)]
    pub o_number: Option<u32>,
}

/// One finding.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ProgramDiagnostic {
    /// `E0123` or `W0123`.
    pub code: String,
    /// Error or warning.
    pub severity: DiagnosticSeverity,
    /// From 1.
    pub line: u32,
    /// In characters, from 1.
    pub column: u32,
    /// Line of the end.
    pub end_line: u32,
    /// Column after the last character.
    pub end_column: u32,
    /// What is wrong.
    pub message: String,
    /// What to write instead.
    pub help: String,
}

/// Error or warning.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum DiagnosticSeverity {
    /// The program cannot run.
    Error,
    /// The text deserves a look.
    Warning,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checked(folder: &str) -> Option<String> {
        let folder = ProgramFolder {
            folder: folder.to_owned(),
        };
        folder.checked().ok().map(|folder| folder.folder)
    }

    #[test]
    fn a_folder_is_names_within_each_other_up_to_the_limits() {
        assert_eq!(checked(" parts / left ").as_deref(), Some("parts/left"));
        assert_eq!(checked("").as_deref(), Some(""));
        for wrong in ["/", "a//b", "a/", "..", "a/./b", "a\\b", "a\nb"] {
            assert_eq!(checked(wrong), None, "{wrong:?}");
        }
        let deep = ["a"; FOLDER_DEPTH_MAX].join("/");
        assert_eq!(checked(&deep), Some(deep.clone()));
        assert_eq!(checked(&format!("{deep}/a")), None);
        let long = "a".repeat(FOLDER_CHARS_MAX);
        assert_eq!(checked(&long), Some(long.clone()));
        assert_eq!(checked(&format!("{long}a")), None);
    }
}
