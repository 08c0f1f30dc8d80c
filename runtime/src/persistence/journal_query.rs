//! Finds lines in a journal. Memory is bounded by the journal's size on disk, or by one line if each line is
//! passed on.

use std::collections::VecDeque;
use std::io;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::chain::{Ending, ParsedJournalLine, entry};
use super::journal_reader::{open, read_lines};
use crate::journal::LineFilter;

/// Lines and files that a search could not read.
#[derive(Debug, Default)]
pub struct LeftOut {
    /// Number of damaged lines.
    pub damaged: u64,
    /// Files that cannot be read, with the reason.
    pub unreadable: Vec<(PathBuf, io::Error)>,
}

/// Passes each line that a filter accepts to `each`, the oldest first.
///
/// # Errors
/// Returns an error if the folder does not exist.
pub fn search(folder: &Path, filter: &mut LineFilter, each: &mut dyn FnMut(Value)) -> io::Result<LeftOut> {
    let mut left_out = LeftOut::default();
    left_out.unreadable = read_lines(
        open(folder)?,
        &mut |_, ending, line| match (ending, entry(line)) {
            (Ending::Whole, ParsedJournalLine::Linked(value, ..) | ParsedJournalLine::Unlinked(value)) => {
                if filter.takes(&value) {
                    each(value);
                }
            }
            // the last line may still be incomplete
            (Ending::Cut, _) => {}
            _ => left_out.damaged += 1,
        },
    );
    Ok(left_out)
}

/// Returns the newest `count` lines that a filter accepts, after leaving out the `from` newest of them.
pub(crate) fn newest_of(folder: &Path, filter: &mut LineFilter, from: usize, count: usize) -> Vec<Value> {
    // kept as text, which needs much less memory
    let (mut newest, wanted) = (VecDeque::new(), from.saturating_add(count));
    let searched = search(folder, filter, &mut |line| {
        if newest.len() >= wanted {
            newest.pop_front();
        }
        newest.push_back(line.to_string());
    });
    if let Err(error) = searched {
        tracing::debug!("{}: {error}", folder.display());
    }
    newest.truncate(newest.len().saturating_sub(from));
    let lines = newest.iter().map(|line| serde_json::from_str(line));
    lines.filter_map(Result::ok).collect()
}
