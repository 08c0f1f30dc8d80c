//! `tandem journal`: verifies and shows the journal of a machine, which may be running, or a copy of the
//! journal folder.

use std::path::PathBuf;
use std::time::SystemTime;

use anyhow::Context;
use clap::{Args, Subcommand};
use plc_protocol::types::data::JournalFilter;
use serde_json::{Map, Value};
use tandem_runtime::audit::{self, ChainVerification, DiskPath, LineFilter};

use super::{CommandResult, EXIT_FOUND, EXIT_OK, EXIT_UNREADABLE, complain, print_line, read_config};

/// Minimum number of digits to which a user may shorten a hash.
const HASH_DIGITS_MIN: usize = 16;

/// Number of digits of a complete hash.
const HASH_DIGITS: usize = 64;

/// Fields of a line that have a separate column, or that do not describe the event.
const NO_DETAILS: [&str; 7] = ["ts", "cs", "event", "boot_id", "n", "t_s", "hash"];

#[derive(Args)]
pub struct JournalArguments {
    #[command(subcommand)]
    action: JournalAction,
}

#[derive(Args)]
struct JournalFolderArguments {
    /// Data folder, its journal folder, or a copy of one; default: the folder of the configuration
    folder: Option<PathBuf>,
    /// Configuration file; default: that of the demo machine
    #[arg(long, value_name = "FILE", conflicts_with = "folder")]
    config: Option<PathBuf>,
}

#[derive(Subcommand)]
enum JournalAction {
    /// Checks whether a line was changed, removed, inserted or moved since it was written; the machine may run
    Verify {
        #[command(flatten)]
        place: JournalFolderArguments,
        /// Hash that an earlier verify printed, or at least its first 16 digits: it must still be in the chain
        #[arg(long, value_name = "HASH", value_parser = noted_hash)]
        head: Option<String>,
    },
    /// Shows lines, oldest first; the machine may run
    Show {
        #[command(flatten)]
        place: JournalFolderArguments,
        /// Shows lines from this time on: an age (2h, 30m), or a UTC time (2026-11-25, 2026-11-25T10:00)
        #[arg(long, value_name = "TIME")]
        since: Option<String>,
        /// Shows lines before this time, in the forms of --since
        #[arg(long, value_name = "TIME")]
        until: Option<String>,
        /// Shows only lines of this coordinate system; 0: only lines of the machine
        #[arg(long, value_name = "NUMBER")]
        cs: Option<u8>,
        /// Shows only lines about outputs of this M number, and about program stops by this M number
        #[arg(long, value_name = "NUMBER")]
        m: Option<u16>,
        /// Shows only lines of this user, client or handler
        #[arg(long, value_name = "NAME")]
        user: Option<String>,
        /// Shows only lines of this run, such as BOOT-1-7; without the boot identifier (1-7): of the run with this
        /// number after each start of the runtime
        #[arg(long, value_name = "RUN")]
        run: Option<String>,
        /// Prints one JSON object per line, as stored
        #[arg(long)]
        json: bool,
    },
}

fn noted_hash(text: &str) -> Result<String, String> {
    let is_hash = (HASH_DIGITS_MIN..=HASH_DIGITS).contains(&text.len())
        && text.bytes().all(|digit| digit.is_ascii_hexdigit());
    is_hash.then(|| text.to_owned()).ok_or_else(|| {
        format!("write the {HASH_DIGITS} digits of a hash, or its first {HASH_DIGITS_MIN} or more")
    })
}

impl JournalFolderArguments {
    fn journal(&self) -> anyhow::Result<DiskPath> {
        if let Some(folder) = &self.folder {
            return Ok(audit::journal_folder(&folder.as_path().into()));
        }
        let (_, machine) = read_config(self.config.as_deref())?;
        let folder = machine
            .data_dir
            .context("the machine keeps no journal: it has no data_dir")?;
        Ok(DiskPath::from(folder).join("journal"))
    }
}

pub(super) fn run(arguments: &JournalArguments) -> CommandResult {
    match &arguments.action {
        JournalAction::Verify { place, head } => {
            let folder = place.journal()?;
            let shown = folder.as_path().display().to_string();
            let verified = audit::verify(&folder, head.as_deref());
            Ok(report(&shown, &verified.with_context(|| shown.clone())?))
        }
        JournalAction::Show {
            place,
            since,
            until,
            cs,
            m,
            user,
            run,
            json,
        } => {
            let wanted = JournalFilter {
                since: since.clone(),
                until: until.clone(),
                cs: *cs,
                m: *m,
                user: user.clone(),
                run: run.clone(),
            };
            show(&place.journal()?, &wanted, *json)
        }
    }
}

fn report(shown: &str, verified: &ChainVerification) -> u8 {
    for note in &verified.notes {
        print_line(format!("note: {note}"));
    }
    for found in &verified.breaks {
        let line = found.line.map_or(String::new(), |line| format!(":{line}"));
        print_line(format!(
            "broken: {}{line}: {}; {}",
            found.path.display(),
            found.what,
            found.advice
        ));
    }
    if verified.more > 0 {
        print_line(format!("broken: {} further places", verified.more));
    }
    let (first, last) = (
        verified.first.as_deref().unwrap_or("never"),
        verified.last.as_deref().unwrap_or("never"),
    );
    print_line(format!(
        "{shown}: {} lines of the chain, from {first} to {last}.",
        verified.chained
    ));
    if let Some(head) = verified.head {
        print_line(format!("head: {head}"));
    }
    if verified.is_whole() {
        print_line(
            "The chain is intact. Keep the head in another place: verify --head shows later whether lines \
             have changed.",
        );
        return EXIT_OK;
    }
    print_line(if verified.chained == 0 {
        "Nothing is chained."
    } else {
        "The chain is not intact."
    });
    EXIT_FOUND
}

fn show(folder: &DiskPath, wanted: &JournalFilter, json: bool) -> CommandResult {
    let mut filter = LineFilter::new(wanted, SystemTime::now()).map_err(anyhow::Error::msg)?;
    if !json {
        print_line(format!(
            "{:<24}  {:>2}  {:<12}  WHAT",
            "TIME (UTC)", "CS", "EVENT"
        ));
    }
    let mut show = |line: Value| {
        if json {
            print_line(line);
        } else {
            print_line(row(&line));
        }
    };
    let searched = audit::search(folder, &mut filter, &mut show);
    let left_out = searched.with_context(|| folder.as_path().display().to_string())?;
    if left_out.damaged > 0 {
        complain(format!(
            "{} damaged lines are left out; tandem journal verify names them",
            left_out.damaged
        ));
    }
    for (path, error) in &left_out.unreadable {
        complain(format!("{} cannot be read: {error}", path.display()));
    }
    Ok(if left_out.unreadable.is_empty() {
        EXIT_OK
    } else {
        EXIT_UNREADABLE
    })
}

/// Returns a line of the journal as a row of columns.
fn row(line: &Value) -> String {
    let text = |name: &str| line[name].as_str().unwrap_or_default();
    // Milliseconds are sufficient for a display.
    let time = match text("ts").split_once('.') {
        Some((seconds, part)) => format!("{seconds}.{part:.3}Z"),
        None => text("ts").to_owned(),
    };
    let cs = match line["cs"].as_u64() {
        Some(cs) if cs > 0 => cs.to_string(),
        _ => "-".to_owned(),
    };
    let details = line.as_object().map(details).unwrap_or_default();
    format!("{time:<24}  {cs:>2}  {:<12}  {details}", text("event"))
        .trim_end()
        .to_owned()
}

/// Returns the originator and the details of an event, for example:
/// `user=anna from=10.0.0.7 request="POST /cs/1/start"`.
fn details(line: &Map<String, Value>) -> String {
    let is_detail = |name: &str| !NO_DETAILS.contains(&name);
    let who = ["user", "from", "over"];
    let first = who.iter().filter_map(|name| Some((*name, line.get(*name)?)));
    let others = line.iter().map(|(name, value)| (name.as_str(), value));
    let others = others.filter(|(name, _)| is_detail(name) && !who.contains(name));
    let shown = first.chain(others).filter(|(_, value)| !value.is_null());
    let words: Vec<String> = shown
        .map(|(name, value)| format!("{name}={}", word(value)))
        .collect();
    words.join(" ")
}

/// Returns a value as text; quotes are added only if a text contains spaces, quotes or control characters.
fn word(value: &Value) -> String {
    match value.as_str() {
        Some(text) if !text.is_empty() && text.chars().all(is_plain) => text.to_owned(),
        // Escapes control characters as JSON does, so that none reaches a terminal.
        Some(text) => format!("\"{}\"", text.escape_debug()),
        None => {
            let escaped = |letter: char| match letter {
                control if control.is_control() => control.escape_unicode().to_string(),
                letter => letter.to_string(),
            };
            value.to_string().chars().map(escaped).collect()
        }
    }
}

fn is_plain(letter: char) -> bool {
    letter.is_alphanumeric() || "-_./:+@#*,;()[]".contains(letter)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_line_is_a_row_with_who_first_and_nothing_that_a_terminal_acts_on() {
        let line = json!({
            "boot_id": "b1", "cs": 1, "event": "request", "from": "10.0.0.7", "hash": "00", "n": 7, "over": "rest",
            "request": "POST /cs/1/mdi", "said": "{\"text\":\"\u{1b}[2J\n\"}", "t_s": 0.5,
            "ts": "2026-11-25T10:00:00.123456Z", "user": "anna", "command_id": null,
        });
        assert_eq!(
            row(&line),
            "2026-11-25T10:00:00.123Z   1  request       user=anna from=10.0.0.7 over=rest request=\"POST /cs/1/mdi\" \
             said=\"{\\\"text\\\":\\\"\\u{1b}[2J\\n\\\"}\""
        );
        let boot = json!({"cs": 0, "event": "boot", "version": "0.2.0", "ts": "2026-11-25T10:00:00Z"});
        assert_eq!(
            row(&boot),
            "2026-11-25T10:00:00Z       -  boot          version=0.2.0"
        );
    }

    #[test]
    fn a_noted_hash_has_16_to_64_hexadecimal_digits() {
        for (text, is_right) in [
            ("0123456789abcdef", true),
            ("0123456789ABCDEF0", true),
            ("0123456789abcde", false),
            ("0123456789abcdeg", false),
            (&"a".repeat(64), true),
            (&"a".repeat(65), false),
        ] {
            assert_eq!(noted_hash(text).is_ok(), is_right, "{text}");
        }
    }
}
