//! Determines which copy of a stored file is the newest. All files of a data folder share one sequence of
//! generations.
//!
//! Each change of a file gets the next generation. A sealed line contains its own generation and, for each
//! part, the newest generation that was on disk before the line was written. At a start, the lines of the
//! other parts show whether a part is an older copy. A kill or a power cut between two writes never looks
//! like an older copy, because a line names only generations that are already on disk.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Part of the data folder whose files are written together, with one generation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StoredPart {
    /// Variables, tools, offsets and runs, with the checksum file of the store.
    Store,
    /// The checksums of programs.
    Programs,
    /// The folders in which lists show the programs.
    Folders,
    /// The anchor of the journal.
    Journal,
    /// The last good generation of the stored values.
    LastGood,
}

impl StoredPart {
    /// All parts, in the order of their names.
    pub const ALL: [StoredPart; 5] = [
        StoredPart::Store,
        StoredPart::Programs,
        StoredPart::Folders,
        StoredPart::Journal,
        StoredPart::LastGood,
    ];
}

/// Newest generation of each part; a part without a generation has no entry.
pub type PartGenerations = BTreeMap<StoredPart, u64>;

/// Kind of file to which a sealed line belongs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SealedFileKind {
    /// A record of the store.
    Store,
    /// The checksum file of the store.
    StoreSums,
    /// The checksum file of the programs.
    ProgramSums,
    /// The assignments of programs to folders.
    Folders,
    /// The anchor of the journal.
    Anchor,
    /// A line of the journal.
    Journal,
    /// The ring of the journal, which holds lines written ahead.
    Ahead,
    /// The question about stored files.
    Question,
    /// The last good generation of the stored values.
    LastGood,
    /// Values that are withheld until a person decides.
    Withheld,
}

/// Seal of a line: its kind, machine and generation.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Seal {
    /// Kind of the file that contains the line.
    pub kind: SealedFileKind,
    /// Name of the machine that wrote the line.
    pub machine: String,
    /// Generation of the part to which the file belongs.
    pub generation: u64,
    /// Generation of each part that was on disk before the line was written.
    #[serde(default, skip_serializing_if = "PartGenerations::is_empty")]
    pub known: PartGenerations,
}

/// Reason why a sealed file does not belong to the other files of its folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SealMismatch {
    /// Another machine wrote the file.
    OtherMachine,
    /// The file is an older copy.
    Older,
}

/// Name of the field that contains the seal of a line.
pub(super) const SEAL: &str = "seal";

impl Seal {
    /// Adds this seal to a line.
    pub fn put(&self, line: &mut Value) {
        line[SEAL] = json!(self);
    }

    /// Checks that this machine wrote the file, and that the file is not older than the generation that other files
    /// name.
    ///
    /// # Errors
    /// Returns the mismatch and its description.
    pub fn check(&self, machine: &str, known: u64) -> Result<(), (SealMismatch, String)> {
        if self.machine != machine {
            let text = format!(
                "the file belongs to machine {}, but this is machine {machine}",
                self.machine
            );
            return Err((SealMismatch::OtherMachine, text));
        }
        if self.generation < known {
            let text = format!(
                "the file is an older copy, of generation {}; other files name generation {known}",
                self.generation
            );
            return Err((SealMismatch::Older, text));
        }
        Ok(())
    }
}

/// Generations of the data folder that the runtime has opened.
#[derive(Debug, Default)]
pub struct Generations {
    machine: String,
    last: AtomicU64,
    on_disk: [AtomicU64; StoredPart::ALL.len()],
}

impl Generations {
    /// Creates the generations of a new data folder of this machine.
    pub fn new(machine: &str) -> Self {
        Self {
            machine: machine.to_owned(),
            ..Self::default()
        }
    }

    /// Returns the name of the machine.
    pub fn machine(&self) -> &str {
        &self.machine
    }

    /// Records generations read from disk; the next generation is greater than all of them.
    pub fn learn(&self, read: &PartGenerations) {
        for (part, generation) in read {
            self.note_on_disk(*part, *generation);
            self.last.fetch_max(*generation, Ordering::AcqRel);
        }
    }

    /// Records the generation of a line read from disk.
    pub fn learn_own(&self, seal: &Seal) {
        let part = match seal.kind {
            SealedFileKind::Store | SealedFileKind::StoreSums => StoredPart::Store,
            SealedFileKind::ProgramSums => StoredPart::Programs,
            SealedFileKind::Folders => StoredPart::Folders,
            SealedFileKind::Anchor => StoredPart::Journal,
            SealedFileKind::LastGood => StoredPart::LastGood,
            SealedFileKind::Journal
            | SealedFileKind::Ahead
            | SealedFileKind::Question
            | SealedFileKind::Withheld => return,
        };
        self.learn(&[(part, seal.generation)].into());
    }

    /// Takes the next generation, for a change that is about to be written.
    pub fn next(&self) -> u64 {
        self.last.fetch_add(1, Ordering::AcqRel) + 1
    }

    /// Returns the generation of the last change.
    pub fn last(&self) -> u64 {
        self.last.load(Ordering::Acquire)
    }

    /// Records that this generation of a part is on disk; later lines of other parts name it.
    pub fn note_on_disk(&self, part: StoredPart, generation: u64) {
        self.on_disk[part as usize].fetch_max(generation, Ordering::AcqRel);
    }

    /// Returns the newest generation on disk of each part.
    pub fn on_disk(&self) -> PartGenerations {
        let read = StoredPart::ALL.map(|part| (part, self.on_disk[part as usize].load(Ordering::Acquire)));
        read.into_iter()
            .filter(|(_, generation)| *generation > 0)
            .collect()
    }

    /// Returns the seal for a line of this generation.
    pub fn seal(&self, kind: SealedFileKind, generation: u64) -> Seal {
        Seal {
            kind,
            machine: self.machine.clone(),
            generation,
            known: self.on_disk(),
        }
    }

    /// Returns the seal for a line that names no generations of other parts.
    pub fn plain_seal(&self, kind: SealedFileKind) -> Seal {
        Seal {
            known: PartGenerations::new(),
            ..self.seal(kind, self.last())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_names_what_was_on_disk_before_it_and_no_later_generation() {
        let generations = Generations::new("mill");
        generations.learn(&[(StoredPart::Store, 7), (StoredPart::Journal, 9)].into());
        let first = generations.next();
        assert_eq!(first, 10, "greater than all generations that were read");
        let seal = generations.seal(SealedFileKind::ProgramSums, first);
        assert_eq!(
            seal.known,
            [(StoredPart::Store, 7), (StoredPart::Journal, 9)].into(),
            "programs are not on disk yet"
        );
        generations.note_on_disk(StoredPart::Programs, first);
        let next = generations.seal(SealedFileKind::StoreSums, generations.next());
        assert_eq!(next.known[&StoredPart::Programs], 10);
        assert_eq!(
            generations.plain_seal(SealedFileKind::Journal).known,
            PartGenerations::new()
        );
    }
}
