//! `tandem fmt`: formats NC programs.

use std::fs;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Args;
use tandem_interp::{Check, Dialect, dialects};
use tempfile::NamedTempFile;

use super::findings::FileFindings;
use super::{
    CommandResult, EXIT_FOUND, EXIT_OK, EXIT_UNREADABLE, STANDARD_INPUT, complain, notice_unwritten,
    print_line, read_program, shown,
};

#[derive(Args)]
pub struct FmtArguments {
    /// NC programs; - is standard input, which is written to standard output
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Writes nothing; lists the programs that are not formatted, and ends with exit code 1 if there are any
    #[arg(long)]
    check: bool,
    /// NC dialect of the programs
    #[arg(long, value_parser = dialects::find, default_value = dialects::DEFAULT_NAME)]
    dialect: &'static Dialect,
}

pub(super) fn run(arguments: &FmtArguments) -> u8 {
    let mut code = EXIT_OK;
    for path in &arguments.files {
        code = code.max(lay_out(path, arguments).unwrap_or_else(|error| {
            complain(format!("{error:#}"));
            EXIT_UNREADABLE
        }));
    }
    code
}

fn lay_out(path: &Path, arguments: &FmtArguments) -> CommandResult {
    let text = read_program(path)?;
    anyhow::ensure!(
        !text.contains(char::REPLACEMENT_CHARACTER),
        "{}: not changed; formatting would lose bytes that are not UTF-8. Save the file as UTF-8",
        shown(path)
    );
    let is_filter = path == Path::new(STANDARD_INPUT) && !arguments.check;
    let (result, code) = match tandem_syntax::format(&text, (arguments.dialect.grammar)()) {
        Ok(result) => (Some(result), EXIT_OK),
        Err(found) => {
            let findings = FileFindings::new(path, &text.as_str().into(), Check::default(), found);
            complain(findings.text());
            complain(format!("{}: not changed; correct the errors first", shown(path)));
            (None, EXIT_FOUND)
        }
    };
    let changed = result.as_ref().filter(|result| **result != text);
    if is_filter {
        let result = result.as_ref().unwrap_or(&text);
        notice_unwritten(io::stdout().lock().write_all(result.as_bytes()));
    } else if arguments.check && changed.is_some() {
        print_line(shown(path));
        return Ok(EXIT_FOUND);
    } else if let Some(result) = changed {
        replace(path, result).with_context(|| format!("cannot write {}", shown(path)))?;
    }
    Ok(code)
}

/// Replaces the text of a file atomically: after a failure, the file contains the old or the new text. The
/// file keeps its permissions. If the path is a symbolic link, the link stays and its target is replaced.
fn replace(path: &Path, text: &str) -> io::Result<()> {
    let path = fs::canonicalize(path)?;
    let rights = fs::metadata(&path)?.permissions();
    if rights.readonly() {
        return Err(io::ErrorKind::PermissionDenied.into());
    }
    let mut file = NamedTempFile::new_in(path.parent().unwrap_or(Path::new(".")))?;
    file.write_all(text.as_bytes())?;
    file.as_file().set_permissions(rights)?;
    file.as_file().sync_all()?;
    file.persist(&path)?;
    Ok(())
}
