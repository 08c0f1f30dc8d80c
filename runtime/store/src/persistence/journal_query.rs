//! Finds lines in a journal. If the caller keeps no lines, memory is bounded by one line, otherwise by the
//! journal's size on disk.

use std::collections::VecDeque;
use std::io;
use std::path::PathBuf;

use serde_json::Value;

use super::chain::{Ending, parse_line};
use super::journal_reader::{open, read_lines};
use crate::disk::DiskPath;
use crate::journal::LineFilter;

/// Damaged lines and unreadable files of a search.
#[derive(Debug, Default)]
pub struct LeftOut {
    /// Number of damaged lines.
    pub damaged: u64,
    /// Files that cannot be read, each with the reason.
    pub unreadable: Vec<(PathBuf, io::Error)>,
}

/// Passes each line that the filter accepts to `each`, oldest line first.
///
/// # Errors
/// Returns an error if the folder does not exist.
pub fn search(
    folder: &DiskPath,
    filter: &mut LineFilter,
    each: &mut dyn FnMut(Value),
) -> io::Result<LeftOut> {
    let mut left_out = LeftOut::default();
    left_out.unreadable = read_lines(
        open(folder)?,
        &mut |_, ending, line| match (ending, parse_line(line)) {
            (Ending::Whole, Some(line)) => {
                if filter.takes(&line.value) {
                    each(line.value);
                }
            }
            // A runtime may still be writing the last line.
            (Ending::Cut, _) => {}
            _ => left_out.damaged += 1,
        },
    );
    Ok(left_out)
}

/// Returns the newest `count` lines that the filter accepts, after skipping the `from` newest of them.
pub fn newest_of(folder: &DiskPath, filter: &mut LineFilter, from: usize, count: usize) -> Vec<Value> {
    // Lines are kept as text, which needs much less memory than parsed lines.
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
