//! `tandem compile`: writes the intermediate code that the manual's appendix A-1 describes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;
use tandem_interp::{CheckContext, Dialect, check_source, dialects};
use tandem_model::limits::PROGRAM_NUMBER_MAX;
use tandem_runtime::program_store::{header, program_number};
use tandem_syntax::Header;

use super::findings::FileFindings;
use super::{CommandResult, EXIT_FOUND, EXIT_OK, EXIT_UNREADABLE, complain, read_program, shown};

#[derive(Args)]
pub struct CompileArguments {
    /// NC programs; the header is derived from a file name that is a number; - is standard input
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Writes each program's code into this folder, as NAME.pmc, instead of to standard output
    #[arg(long, value_name = "DIR")]
    out_dir: Option<PathBuf>,
    /// Writes the header of a main program with this number
    #[arg(long, value_name = "N", conflicts_with = "subprogram", value_parser = clap::value_parser!(u16).range(1..=i64::from(PROGRAM_NUMBER_MAX)))]
    main: Option<u16>,
    /// Writes the header of a subprogram with this number
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=i64::from(PROGRAM_NUMBER_MAX)))]
    subprogram: Option<u16>,
    /// NC dialect of the programs
    #[arg(long, value_parser = dialects::find, default_value = dialects::DEFAULT_NAME)]
    dialect: &'static Dialect,
}

pub(super) fn run(arguments: &CompileArguments) -> CommandResult {
    arguments.check()?;
    let mut code = EXIT_OK;
    for path in &arguments.files {
        code = code.max(compile(path, arguments).unwrap_or_else(|error| {
            complain(format!("{error:#}"));
            EXIT_UNREADABLE
        }));
    }
    Ok(code)
}

fn compile(path: &Path, arguments: &CompileArguments) -> CommandResult {
    let (tree, check) = check_source(read_program(path)?, arguments.dialect, &CheckContext::default());
    let findings = FileFindings::new(path, tree.source(), check, Vec::new());
    if findings.has_errors() {
        complain(findings.text());
        complain(format!("{}: not compiled; correct the errors first", shown(path)));
        return Ok(EXIT_FOUND);
    }
    let code = tandem_syntax::compile(&tree, arguments.header(path), arguments.dialect);
    match &arguments.out_dir {
        None => super::print_line(code.trim_end_matches('\n')),
        Some(folder) => {
            let file = result(path, folder);
            std::fs::create_dir_all(folder)
                .and_then(|()| std::fs::write(&file, code))
                .with_context(|| format!("cannot write {}", file.display()))?;
        }
    }
    Ok(EXIT_OK)
}

/// Returns the path of the file for the code of a program: NAME.pmc in the folder.
fn result(path: &Path, folder: &Path) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(".pmc");
    folder.join(name)
}

fn is_same_file(one: &Path, other: &Path) -> bool {
    matches!((one.canonicalize(), other.canonicalize()), (Ok(one), Ok(other)) if one == other)
}

impl CompileArguments {
    /// Checks the arguments before the command writes any file.
    fn check(&self) -> anyhow::Result<()> {
        if self.files.len() > 1 {
            if self.out_dir.is_none() {
                bail!("several programs need --out-dir");
            }
            let header = [("--main", self.main), ("--subprogram", self.subprogram)];
            if let Some((flag, _)) = header.iter().find(|(_, number)| number.is_some()) {
                bail!("{flag} is for one program; compile one program at a time with this option");
            }
        }
        let Some(folder) = &self.out_dir else {
            return Ok(());
        };
        let mut results = BTreeMap::new();
        for path in &self.files {
            let result = result(path, folder);
            let shown = result.display();
            if is_same_file(&result, path) {
                bail!("the result {shown} would replace the program; name another --out-dir");
            }
            if let Some(other) = results.insert(result.clone(), path) {
                bail!(
                    "{} and {} would both be written to {shown}; compile them into two folders",
                    other.display(),
                    path.display()
                );
            }
        }
        Ok(())
    }

    fn header(&self, path: &Path) -> Header {
        match (self.main, self.subprogram, program_number(path)) {
            (Some(number), ..) => Header::Program(number),
            (None, Some(number), _) => Header::Subprogram(number),
            (None, None, number) => header(number.unwrap_or(1)),
        }
    }
}
