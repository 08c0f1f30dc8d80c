//! Programs of the store, and the findings of a check.

use serde::{Deserialize, Serialize};

/// Largest size of the text of one program, bytes; a larger text is refused as `too_large`.
pub const PROGRAM_BYTES_MAX: usize = 64 * 1024 * 1024;

/// One program of the store.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ProgramInfo {
    /// Program number, 1 to 9999.
    pub number: u16,
    /// First comment of the text, for display in lists.
    pub title: String,
    /// Size of the text, bytes.
    pub bytes: u64,
    /// Number of errors found by the check.
    pub errors: u32,
    /// Number of warnings found by the check.
    pub warnings: u32,
    /// Hash of the text: SHA-256 of the bytes of its file, which are the bytes of the text as sent, 64
    /// hexadecimal digits.
    #[serde(default)]
    pub hash: String,
    /// State of the signature; null on a machine without `[programs] signed_by`, which checks no signatures.
    #[serde(default)]
    pub signature: Option<SignatureState>,
    /// NC dialect of the text: only coordinate systems of this dialect load it.
    #[serde(default)]
    pub dialect: String,
    /// Number in the text, in dialects whose text contains a number (`O12345678`). The program is stored,
    /// loaded and called under `number`, not under this number.
    #[serde(default)]
    pub o_number: Option<u32>,
    /// Folder of the program in lists, such as `parts/left`; empty for none. The program is loaded and called
    /// by its number.
    #[serde(default)]
    pub folder: String,
}

/// Largest number of characters of a folder name, including the folders above it.
pub const FOLDER_CHARS_MAX: usize = 120;

/// Largest depth of nested folders.
pub const FOLDER_DEPTH_MAX: usize = 8;

/// Folder of a program.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ProgramFolder {
    /// Names of nested folders, such as `parts/left`; empty for none. Up to 120 characters, 8 names.
    pub folder: String,
}

impl ProgramFolder {
    /// Returns the folder in the form that is stored: without spaces around names.
    ///
    /// # Errors
    /// Fails if the folder is too long or too deep, or a name is empty, `.` or `..`, or contains a control
    /// character or a backslash. The error text gives the correct form.
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

/// State of a program's signature.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum SignatureState {
    /// One of the configured keys has signed these bytes.
    Valid,
    /// The program has no signature.
    Missing,
    /// The program has a signature, but none of the configured keys made it for these bytes.
    Wrong,
}

/// Text of a program, with its hash.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ProgramText {
    /// The text.
    pub text: String,
    /// Hash of the text, as in [`ProgramInfo::hash`].
    pub hash: String,
}

/// Result of a check of a program.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ProgramCheck {
    /// For a write: true if the store did not contain the program before.
    #[serde(skip)]
    pub created: bool,
    /// Findings in the order of the text.
    pub diagnostics: Vec<ProgramDiagnostic>,
    /// M codes that the program issues, ascending.
    pub m_codes: Vec<u16>,
    /// Programs that the program calls, ascending.
    pub programs: Vec<u16>,
    /// Hash of the text, as in [`ProgramInfo::hash`].
    #[serde(default)]
    pub hash: String,
    /// For a write: true if the same text was already stored, so that nothing has changed.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub unchanged: bool,
    /// State of the signature, as in [`ProgramInfo::signature`].
    #[serde(default)]
    pub signature: Option<SignatureState>,
    /// NC dialect of the text, as in [`ProgramInfo::dialect`].
    #[serde(default)]
    pub dialect: String,
    /// Number in the text, as in [`ProgramInfo::o_number`].
    #[serde(default)]
    pub o_number: Option<u32>,
}

/// One finding of a check.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ProgramDiagnostic {
    /// Code of the finding, such as `E0123` for an error or `W0123` for a warning.
    pub code: String,
    /// Error or warning.
    pub severity: DiagnosticSeverity,
    /// First line of the finding, from 1.
    pub line: u32,
    /// Column of the first character of the finding, from 1.
    pub column: u32,
    /// Last line of the finding.
    pub end_line: u32,
    /// Column after the last character of the finding.
    pub end_column: u32,
    /// Description of the finding.
    pub message: String,
    /// Suggested change of the text.
    pub help: String,
}

/// Severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum DiagnosticSeverity {
    /// The program cannot run.
    Error,
    /// The program can run, but the text should be reviewed.
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
