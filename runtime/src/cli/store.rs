//! `tandem store`: inspects and repairs the stored data of a machine while the machine does not run.

use std::fs;
use std::path::PathBuf;

use anyhow::Context;
use clap::{Args, Subcommand};
use tandem_runtime::data_folder::DataFolder;

use super::os_user::os_user;
use super::{CommandResult, EXIT_FOUND, EXIT_OK, complain, print_line, read_config};

#[derive(Args)]
pub struct StoreArguments {
    #[command(subcommand)]
    action: StoreAction,
}

#[derive(Args)]
struct MachineArguments {
    /// Configuration file; default: that of the demo machine
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

#[derive(Subcommand)]
enum StoreAction {
    /// Lists damaged data; changes nothing
    Verify(MachineArguments),
    /// Shows lost values and their values in the last good generation, and restores these with --yes
    Repair {
        #[command(flatten)]
        machine: MachineArguments,
        /// Restores lost values from the last good generation, which is older than the lost values
        #[arg(long)]
        yes: bool,
        /// Accepts the present text of a damaged program
        #[arg(long, value_name = "NUMBER")]
        program: Vec<u16>,
    },
    /// Writes all stored values as JSON
    Export {
        #[command(flatten)]
        machine: MachineArguments,
        /// File to write; default: standard output
        #[arg(short, long, value_name = "FILE")]
        output: Option<PathBuf>,
    },
    /// Imports the values of an exported file; all other values stay unchanged
    Import {
        #[command(flatten)]
        machine: MachineArguments,
        /// File to import
        file: PathBuf,
    },
}

pub(super) fn run(arguments: &StoreArguments) -> CommandResult {
    match &arguments.action {
        StoreAction::Verify(machine) => Ok(verify(&open(machine)?)),
        StoreAction::Repair {
            machine,
            yes,
            program,
        } => repair(&mut open(machine)?, *yes, program),
        StoreAction::Export { machine, output } => export(&open(machine)?, output.as_ref()),
        StoreAction::Import { machine, file } => {
            let shown = file.display();
            let text = fs::read_to_string(file).with_context(|| format!("cannot read {shown}"))?;
            let mut folder = open(machine)?;
            record(&folder, &format!("tandem store import {shown}"));
            let count = folder
                .import(&text)
                .with_context(|| format!("{shown} is not imported"))?;
            print_line(format!("{count} values are imported from {shown}."));
            Ok(EXIT_OK)
        }
    }
}

fn open(machine: &MachineArguments) -> anyhow::Result<DataFolder> {
    let (_, machine) = read_config(machine.config.as_deref())?;
    Ok(DataFolder::open(machine.stored())?)
}

/// Records the user and the command in the journal. If the journal cannot be written, the repair continues.
fn record(folder: &DataFolder, command: &str) {
    if let Err(error) = folder.record(os_user(), command) {
        complain(format!("the journal does not record this command: {error}"));
    }
}

fn verify(folder: &DataFolder) -> u8 {
    let findings = folder.verify();
    for note in &findings.notes {
        print_line(format!("note: {note}"));
    }
    for damage in &findings.damaged {
        print_line(format!("damaged: {damage}"));
    }
    if findings.damaged.is_empty() {
        print_line(format!("{}: nothing is damaged.", folder.path().display()));
        return EXIT_OK;
    }
    print_line("tandem store repair lists the possible repairs.");
    EXIT_FOUND
}

fn repair(folder: &mut DataFolder, yes: bool, programs: &[u16]) -> CommandResult {
    for number in programs {
        record(folder, &format!("tandem store repair --program {number}"));
        let taken = folder.accept_program(*number);
        taken.with_context(|| format!("the file of program {number} is not accepted"))?;
        print_line(format!(
            "program {number} is accepted with its present text; check the program before it runs."
        ));
    }
    let (written, offers) = folder.offers();
    if offers.is_empty() {
        print_line("No value is lost.");
    } else if yes {
        record(folder, "tandem store repair --yes");
        let left = folder.repair().context("there is no good generation")?;
        print_line(
            "Lost values are restored from the last good generation. They are older: check them before \
             anything moves.",
        );
        for what in &left {
            print_line(format!(
                "still lost: {what}; write this value again over REST or in the HMI"
            ));
        }
        return Ok(if left.is_empty() { EXIT_OK } else { EXIT_FOUND });
    } else {
        match &written {
            Some(written) => print_line(format!(
                "Lost values, with their values in the last good generation, of {written}:"
            )),
            None => print_line("Lost values. There is no good generation:"),
        }
        for offer in &offers {
            let older = offer.older.as_deref().unwrap_or("nothing");
            print_line(format!("  {}: {older}", offer.what));
        }
        print_line(
            "--yes restores the older values. A value can also be written again over REST or in the HMI.",
        );
    }
    let damaged: Vec<String> = folder.verify().damaged;
    for damage in damaged.iter().filter(|damage| damage.starts_with("program ")) {
        print_line(format!(
            "  {damage}; store the program again, or accept its present text with --program NUMBER"
        ));
    }
    Ok(if offers.is_empty() && damaged.is_empty() {
        EXIT_OK
    } else {
        EXIT_FOUND
    })
}

fn export(folder: &DataFolder, output: Option<&PathBuf>) -> CommandResult {
    let text = folder.export();
    for offer in folder.offers().1 {
        complain(format!("{} is lost; it is exported as null", offer.what));
    }
    match output {
        Some(path) => fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))?,
        None => print_line(text.trim_end()),
    }
    Ok(EXIT_OK)
}
