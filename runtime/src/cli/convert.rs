//! `tandem convert`: converts programs of other controls to dialect nj.

use std::io::Write as _;
use std::path::PathBuf;

use anyhow::{Context, ensure};
use clap::{Args, ValueEnum};
use tandem_interp::dialects::convert::{ConvertedProgram, Settings, Source, convert};
use tandem_model::settings::NcOptions;
use tandem_syntax::is_wide;

use super::{
    CommandResult, EXIT_FOUND, EXIT_OK, complain, notice_unwritten, read_config, read_program, shown,
};

#[derive(Args)]
pub struct ConvertArguments {
    /// NC program; - is standard input
    file: PathBuf,
    /// Language of the program
    #[arg(long, value_enum)]
    from: From,
    /// Dialect of the result
    #[arg(long, value_enum, default_value_t = To::Nj)]
    to: To,
    /// Writes the program into this file instead of to standard output
    #[arg(short, long, value_name = "OUT.nc")]
    output: Option<PathBuf>,
    /// Configuration of the machine that the program was written for; it supplies the settings that the
    /// dialect leaves to the machine
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

#[derive(Clone, Copy, ValueEnum)]
enum From {
    /// Dialect dgshape
    Dgshape,
    /// The common language of FANUC controls and similar ones
    Fanuc,
}

#[derive(Clone, Copy, ValueEnum)]
enum To {
    /// Dialect nj
    Nj,
}

pub(super) fn run(arguments: &ConvertArguments) -> CommandResult {
    let To::Nj = arguments.to;
    let source = match arguments.from {
        From::Dgshape => Source::Dgshape,
        From::Fanuc => Source::Fanuc,
    };
    let settings = match &arguments.config {
        None => Settings::from(&NcOptions::default()),
        Some(path) => {
            let (_, machine) = read_config(Some(path))?;
            let systems = &machine.coordinate_systems;
            let of_source = || {
                let dialect = source.dialect()?;
                systems.iter().find(|system| system.dialect.name == dialect.name)
            };
            let assigned = machine.system_of_program(&arguments.file);
            let system = assigned.or_else(of_source).or(systems.first());
            system.map_or_else(
                || Settings::from(&NcOptions::default()),
                |system| Settings::from(&system.settings),
            )
        }
    };
    let text = read_program(&arguments.file)?;
    ensure!(
        !is_wide(&text),
        "{} is encoded in UTF-16, but programs are read as UTF-8. Save the program as UTF-8",
        shown(&arguments.file)
    );
    let converted = convert(&text, source, settings);
    match &arguments.output {
        None => notice_unwritten(std::io::stdout().lock().write_all(converted.text.as_bytes())),
        Some(path) => {
            let is_same = matches!(
                (path.canonicalize(), arguments.file.canonicalize()),
                (Ok(one), Ok(other)) if one == other
            );
            ensure!(
                !is_same,
                "the result {} would replace the program; name another file",
                path.display()
            );
            std::fs::write(path, &converted.text)
                .with_context(|| format!("cannot write {}", path.display()))?;
        }
    }
    report(&shown(&arguments.file), &converted);
    Ok(if converted.left.is_empty() {
        EXIT_OK
    } else {
        EXIT_FOUND
    })
}

/// Prints the lines that could not be converted, and the assumptions about the control of the source.
fn report(file: &str, converted: &ConvertedProgram) {
    for left in &converted.left {
        let what = if left.is_written {
            "converted, with an error"
        } else {
            "not converted"
        };
        complain(format!(
            "{file}:{}: {what}: {}\n  {}",
            left.line, left.text, left.reason
        ));
    }
    for assumed in &converted.assumptions {
        let lines = match assumed.lines {
            1 => "1 line".to_owned(),
            lines => format!("{lines} lines"),
        };
        complain(format!(
            "{file}:{}: assumed for {lines}: {}",
            assumed.line, assumed.text
        ));
    }
}
