//! Findings in an NC program, as text, as JSON and as SARIF.

use std::path::Path;
use std::sync::Arc;

use codespan_reporting::diagnostic::{Diagnostic as Rendered, Label};
use codespan_reporting::files::SimpleFile;
use codespan_reporting::term;
use percent_encoding::{AsciiSet, CONTROLS, utf8_percent_encode};
use plc_protocol::types::program::{DiagnosticSeverity, ProgramDiagnostic};
use serde_json::{Value, json};
use tandem_interp::Dialect;
use tandem_model::{Diagnostic, Severity};
use tandem_runtime::program_store::locate;
use tandem_syntax::DIAGNOSTICS;

use super::{print_line, shown};

/// Characters that must be escaped in the path of a URI.
const NOT_IN_A_PATH: &AsciiSet = &CONTROLS
    .add(b' ')
    .add(b'"')
    .add(b'#')
    .add(b'%')
    .add(b'<')
    .add(b'>')
    .add(b'?')
    .add(b'[')
    .add(b'\\')
    .add(b']')
    .add(b'^')
    .add(b'`')
    .add(b'{')
    .add(b'|')
    .add(b'}');

/// Findings of one NC program.
pub(super) struct FileFindings {
    /// Name of the file for display.
    pub file: String,
    /// Text of the program.
    pub source: Arc<str>,
    /// Findings in ascending order of position.
    pub diagnostics: Vec<Diagnostic>,
    /// M codes that the program outputs, in ascending order.
    pub m_codes: Vec<u16>,
    /// Numbers of the programs that this program calls, in ascending order.
    pub programs: Vec<u16>,
}

impl FileFindings {
    /// Creates the findings of the file at this path.
    pub fn new(
        path: &Path,
        source: &Arc<str>,
        mut check: tandem_interp::Check,
        parsed: Vec<Diagnostic>,
    ) -> Self {
        check.diagnostics.extend(parsed);
        check
            .diagnostics
            .sort_by_key(|found| (found.span.start, found.span.end));
        Self {
            file: shown(path),
            source: Arc::clone(source),
            diagnostics: check.diagnostics,
            m_codes: check.m_codes,
            programs: check.programs,
        }
    }

    pub fn has_errors(&self) -> bool {
        self.diagnostics.iter().any(Diagnostic::is_error)
    }

    /// Returns the findings with their lines and columns.
    pub fn located(&self) -> Vec<ProgramDiagnostic> {
        locate(&self.source, &self.diagnostics)
    }

    /// Returns the findings with their lines and columns, each with the name of the file.
    pub fn with_file(&self) -> impl Iterator<Item = Value> {
        self.located().into_iter().map(|found| {
            let mut found = json!(found);
            found["file"] = json!(self.file);
            found
        })
    }

    /// Returns the findings as text, each with its source line, in which the location is underlined.
    pub fn text(&self) -> String {
        let file = SimpleFile::new(&self.file, self.source.as_ref());
        let config = term::Config::default();
        let mut text = String::new();
        for found in &self.diagnostics {
            let rendered = match found.severity {
                Severity::Error => Rendered::error(),
                Severity::Warning => Rendered::warning(),
            };
            let range = found.span.start as usize..found.span.end as usize;
            let rendered = rendered
                .with_code(found.code)
                .with_message(&found.message)
                .with_label(Label::primary((), range))
                .with_note(format!("help: {}", found.help));
            let shown = term::emit_into_string(&config, &file, &rendered)
                .unwrap_or_else(|_| format!("{}: {}: {}", self.file, found.code, found.message));
            text.push_str(shown.trim_end());
            text.push_str("\n\n");
        }
        text
    }

    /// Prints the findings, and lists the M codes and programs that the program uses.
    pub fn print(&self) {
        if let Some(text) = self.text().strip_suffix('\n') {
            print_line(text);
        }
        let found = &self.diagnostics;
        let errors = found.iter().filter(|found| found.is_error()).count();
        let warnings = found.len() - errors;
        let m_codes: Vec<_> = self.m_codes.iter().map(|m| format!("M{m:02}")).collect();
        let programs: Vec<_> = self.programs.iter().map(u16::to_string).collect();
        let or_none = |list: Vec<String>| match list.join(" ") {
            none if none.is_empty() => "none".to_owned(),
            list => list,
        };
        print_line(format!(
            "{}: {}, {}\n  M codes: {}; programs called: {}",
            self.file,
            counted(errors, "error"),
            counted(warnings, "warning"),
            or_none(m_codes),
            or_none(programs)
        ));
    }

    /// Prints the findings of a program in Structured Text, and the M codes that it serves.
    pub fn print_structured_text(&self) {
        if let Some(text) = self.text().strip_suffix('\n') {
            print_line(text);
        }
        let m_codes: Vec<_> = self.m_codes.iter().map(|m| format!("M{m:02}")).collect();
        let serves = if m_codes.is_empty() {
            "none".to_owned()
        } else {
            m_codes.join(" ")
        };
        match self.diagnostics.len() {
            0 => print_line(format!(
                "{}: 0 errors\n  M codes that the program serves: {serves}",
                self.file
            )),
            errors => print_line(format!("{}: {}", self.file, counted(errors, "error"))),
        }
    }

    fn to_json(&self) -> Value {
        json!({
            "file": self.file,
            "diagnostics": self.located(),
            "m_codes": self.m_codes,
            "programs": self.programs,
        })
    }

    /// Returns the findings as SARIF results.
    fn results(&self) -> Vec<Value> {
        let uri = uri(&self.file);
        let result = |found: &ProgramDiagnostic| {
            let level = match found.severity {
                DiagnosticSeverity::Error => "error",
                DiagnosticSeverity::Warning => "warning",
            };
            json!({
                "ruleId": found.code,
                "level": level,
                "message": {"text": format!("{}. {}", found.message, found.help)},
                "locations": [{"physicalLocation": {
                    "artifactLocation": {"uri": uri},
                    "region": {
                        "startLine": found.line,
                        "startColumn": found.column,
                        "endLine": found.end_line,
                        "endColumn": found.end_column,
                    },
                }}],
            })
        };
        self.located().iter().map(result).collect()
    }
}

/// Returns all findings as one JSON object.
pub(super) fn as_json(all: &[FileFindings]) -> Value {
    let files: Vec<Value> = all.iter().map(FileFindings::to_json).collect();
    json!({"files": files})
}

/// Returns all findings as a SARIF 2.1.0 log. `is_whole` is true if every file could be read.
pub(super) fn as_sarif(all: &[FileFindings], is_whole: bool, dialect: &Dialect) -> Value {
    let rule = |entry: &&tandem_syntax::DiagnosticEntry| {
        let (explanation, example) = dialect.explained(entry);
        json!({
            "id": entry.code,
            "shortDescription": {"text": entry.title},
            "fullDescription": {"text": explanation},
            "help": {"text": example},
        })
    };
    json!({
        "$schema": "https://json.schemastore.org/sarif-2.1.0.json",
        "version": "2.1.0",
        "runs": [{
            "tool": {"driver": {
                "name": "tandem",
                "version": env!("CARGO_PKG_VERSION"),
                "informationUri": env!("CARGO_PKG_REPOSITORY"),
                "rules": DIAGNOSTICS.iter().map(rule).collect::<Vec<_>>(),
            }},
            "columnKind": "unicodeCodePoints",
            "invocations": [{"executionSuccessful": is_whole}],
            "results": all.iter().flat_map(FileFindings::results).collect::<Vec<_>>(),
        }],
    })
}

/// Converts a file name to a URI reference.
pub(super) fn uri(file: &str) -> String {
    let path = if cfg!(windows) {
        file.replace('\\', "/")
    } else {
        file.to_owned()
    };
    let path = utf8_percent_encode(&path, NOT_IN_A_PATH).to_string();
    if Path::new(file).is_absolute() {
        return format!("file://{}{path}", if path.starts_with('/') { "" } else { "/" });
    }
    // A colon in the first segment would be read as the end of a URI scheme, so it is escaped.
    path.replace(':', "%3A")
}

fn counted(count: usize, what: &str) -> String {
    let plural = if count == 1 { "" } else { "s" };
    format!("{count} {what}{plural}")
}
