//! `tandem st`: checks and runs sequence programs in Structured Text.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use clap::Args;
use plc_api::{MqttOptions, Plc, SequenceProgram, TlsFiles};
use tandem_structured_text::Program;

use super::findings::{FileFindings, as_json};
use super::serve::{ProcessSignal, Signals};
use super::{CommandResult, EXIT_FOUND, EXIT_OK, complain, print_line, read_program, shown};

#[derive(Args)]
pub struct StArguments {
    /// Program in Structured Text of IEC 61131-3 (a subset: tandem explain ST012); - is standard input
    file: PathBuf,
    /// Only checks the program (default without --run)
    #[arg(long, conflicts_with = "run")]
    check: bool,
    /// Runs the program if it has no errors. After Ctrl-C the program accepts no further M code and completes
    /// the pending ones; a second Ctrl-C ends it at once
    #[arg(long, requires = "connect")]
    run: bool,
    #[arg(
        long,
        value_name = "ADDRESS",
        requires = "run",
        help = "Machine for --run: mqtt://[user:token@]host[:port]/[prefix/]machine or \
                http://[user:token@]host[:port], with TLS mqtts:// or https://"
    )]
    connect: Option<String>,
    /// Time from one scan to the next, ms
    #[arg(long, value_name = "MS", default_value = "10", value_parser = clap::value_parser!(u64).range(1..=60_000))]
    period_ms: u64,
    /// Name of the sequence program at the machine; default: the user, or a generated name
    #[arg(long, value_name = "ID", requires = "run")]
    handler_id: Option<String>,
    /// Replaces a connected program with the same name
    #[arg(long, requires = "handler_id")]
    take_over: bool,
    /// User of the machine; do not write it into the address
    #[arg(long, value_name = "NAME", requires = "token_file")]
    user: Option<String>,
    /// File with the token of the user that --user names
    #[arg(long, value_name = "FILE", requires = "user")]
    token_file: Option<PathBuf>,
    /// Certificate authorities for verifying the machine's certificate, PEM; default: those of the system
    #[arg(long, value_name = "FILE", requires = "run")]
    ca_file: Option<PathBuf>,
    /// Prints findings as text for people, or as JSON in the format of tandem check
    #[arg(long, value_enum, default_value = "text", conflicts_with = "run")]
    format: StFormat,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum StFormat {
    Text,
    Json,
}

pub(super) fn run(arguments: &StArguments) -> CommandResult {
    let source = read_program(&arguments.file)?;
    let (program, findings) = compiled(&arguments.file, source);
    let is_right = program.is_some();
    if arguments.run {
        let Some(program) = program else {
            complain(findings.text().trim_end());
            return Ok(EXIT_FOUND);
        };
        super::log::start();
        return run_program(arguments, program);
    }
    match arguments.format {
        StFormat::Json => print_line(as_json(&[findings])),
        StFormat::Text => findings.print_structured_text(),
    }
    Ok(if is_right { EXIT_OK } else { EXIT_FOUND })
}

/// Returns the findings of a program, and the compiled program if it has no errors.
fn compiled(path: &Path, source: String) -> (Option<Program>, FileFindings) {
    let file = shown(path);
    let (program, diagnostics) = match Program::compile(&file, &source) {
        Ok(program) => (Some(program), Vec::new()),
        Err(diagnostics) => (None, diagnostics),
    };
    let mut m_codes: Vec<u16> = program
        .iter()
        .flat_map(Program::m_codes)
        .map(|(_, m)| m)
        .collect();
    m_codes.sort_unstable();
    m_codes.dedup();
    let source = Arc::from(source);
    let findings = FileFindings {
        file,
        source,
        diagnostics,
        m_codes,
        programs: Vec::new(),
    };
    (program, findings)
}

fn run_program(arguments: &StArguments, program: Program) -> CommandResult {
    let address = arguments.connect.as_deref().unwrap_or_default();
    let password = match &arguments.token_file {
        None => None,
        Some(file) => {
            let token =
                std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
            Some(token.trim().to_owned())
        }
    };
    let options = MqttOptions {
        username: arguments.user.clone(),
        password,
        tls: TlsFiles {
            ca_file: arguments.ca_file.clone(),
            ..TlsFiles::default()
        },
        ..MqttOptions::default()
    };
    let mut sequence = program.sequence_program(Duration::from_millis(arguments.period_ms));
    if let Some(id) = &arguments.handler_id {
        sequence = sequence.handler_id(id);
    }
    if arguments.take_over {
        sequence = sequence.take_over();
    }
    tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()?
        .block_on(serve(address, options, sequence))?;
    Ok(EXIT_OK)
}

async fn serve(address: &str, options: MqttOptions, sequence: SequenceProgram) -> anyhow::Result<()> {
    let mut signals = Signals::listen()?;
    let plc = Plc::connect_with(address, options).await?;
    print_line("The program runs. Ctrl-C ends it.");
    let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
    let mut stop = Some(stop);
    let mut running = Box::pin(sequence.run_until(&plc, stopped));
    loop {
        tokio::select! {
            ended = &mut running => return Ok(ended?),
            received = signals.received() => match (received, stop.take()) {
                (ProcessSignal::HangUp, kept) => stop = kept,
                (ProcessSignal::Stop, Some(first)) => {
                    // The receiver is the sequence program, which is still running.
                    let _ = first.send(());
                    print_line(
                        "The program accepts no further M code and ends after the pending ones. Ctrl-C ends \
                         it at once.",
                    );
                }
                (ProcessSignal::Stop, None) => return Ok(()),
            },
        }
    }
}
