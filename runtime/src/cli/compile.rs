//! `tandem compile`: intermediate code, as the manual's appendix A-1 describes it.

use std::path::{Path, PathBuf};

use clap::Args;
use tandem_model::limits::PROGRAM_NUMBER_MAX;
use tandem_runtime::program_store::{header, program_number};
use tandem_syntax::Header;

use super::check::CheckedFile;
use super::{EXIT_FOUND, EXIT_OK, EXIT_UNREADABLE, complain, read_program};

#[derive(Args)]
pub struct Arguments {
    /// NC programs; a file name that is a number tells the header
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Writes each program's code into this folder, as NAME.pmc, instead of to standard output
    #[arg(long, value_name = "DIR")]
    out_dir: Option<PathBuf>,
    /// Writes the header of this main program
    #[arg(long, value_name = "N", conflicts_with = "subprogram", value_parser = clap::value_parser!(u16).range(1..=i64::from(PROGRAM_NUMBER_MAX)))]
    main: Option<u16>,
    /// Writes the header of this subprogram
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=i64::from(PROGRAM_NUMBER_MAX)))]
    subprogram: Option<u16>,
}

pub(super) fn run(arguments: &Arguments) -> u8 {
    if arguments.out_dir.is_none() && arguments.files.len() > 1 {
        complain("several programs need --out-dir");
        return EXIT_UNREADABLE;
    }
    let mut code = EXIT_OK;
    for path in &arguments.files {
        code = code.max(compile(path, arguments));
    }
    code
}

fn compile(path: &Path, arguments: &Arguments) -> u8 {
    let text = match read_program(path) {
        Ok(text) => text,
        Err(text) => {
            complain(text);
            return EXIT_UNREADABLE;
        }
    };
    let checked = CheckedFile::alone(path, text);
    if checked.has_errors() {
        complain(checked.findings());
        complain(format!(
            "{}: not compiled; correct the errors first",
            path.display()
        ));
        return EXIT_FOUND;
    }
    let code = tandem_syntax::compile(checked.tree(), arguments.header(path));
    match write(path, arguments.out_dir.as_deref(), &code) {
        Ok(()) => EXIT_OK,
        Err(text) => {
            complain(text);
            EXIT_UNREADABLE
        }
    }
}

fn write(path: &Path, out_dir: Option<&Path>, code: &str) -> Result<(), String> {
    let Some(folder) = out_dir else {
        super::say(code.trim_end_matches('\n'));
        return Ok(());
    };
    let file = folder
        .join(path.file_stem().unwrap_or_default())
        .with_extension("pmc");
    std::fs::create_dir_all(folder)
        .and_then(|()| std::fs::write(&file, code))
        .map_err(|error| format!("cannot write {}: {error}", file.display()))
}

impl Arguments {
    fn header(&self, path: &Path) -> Header {
        match (self.main, self.subprogram, program_number(path)) {
            (Some(number), ..) => Header::Program(number),
            (None, Some(number), _) => Header::Subprogram(number),
            (None, None, number) => header(number.unwrap_or(1)),
        }
    }
}
