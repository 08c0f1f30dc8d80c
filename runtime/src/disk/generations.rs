//! Determines which copy of a stored file is the newest: one sequence of generations for all files of a data folder.
//!
//! Each change of a file takes the next generation. A sealed line contains its own generation and, for each part, the
//! newest generation that was on disk before the line was written. At a start an older copy of a part is recognized by
//! the lines of the others. A kill or a power cut between two writes is never taken for an older copy,
//! because a line names only generations that are already on disk.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Part of the data folder whose files are written together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum StoredPart {
    /// Variables, tools, offsets and runs, with their checksums.
    Store,
    /// The checksums of programs.
    Programs,
    /// The folders of programs in lists.
    Folders,
    /// The anchor of the journal.
    Journal,
}

impl StoredPart {
    pub const ALL: [StoredPart; 4] = [
        StoredPart::Store,
        StoredPart::Programs,
        StoredPart::Folders,
        StoredPart::Journal,
    ];
}

/// Generation of each part; a part without an entry has none.
pub(crate) type PartGenerations = BTreeMap<StoredPart, u64>;

/// Kind of file to which a sealed line belongs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum SealedFileKind {
    /// A record of the store.
    Store,
    StoreSums,
    ProgramSums,
    Folders,
    Anchor,
    Journal,
    /// The ring of the journal.
    Ahead,
    /// The question about stored files.
    Question,
}

/// Identification of a sealed line.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Seal {
    pub kind: SealedFileKind,
    /// Name of the machine.
    pub machine: String,
    pub generation: u64,
    /// Generations on disk before the line was written.
    #[serde(default, skip_serializing_if = "PartGenerations::is_empty")]
    pub known: PartGenerations,
}

/// Field of a line that contains its seal.
pub(super) const SEAL: &str = "seal";

impl Seal {
    /// Adds the seal to a line.
    pub fn put(&self, line: &mut Value) {
        line[SEAL] = json!(self);
    }
}

/// The generations of a data folder that is open.
#[derive(Debug, Default)]
pub(crate) struct Generations {
    machine: String,
    last: AtomicU64,
    on_disk: [AtomicU64; StoredPart::ALL.len()],
}

impl Generations {
    pub fn new(machine: &str) -> Self {
        Self {
            machine: machine.to_owned(),
            ..Self::default()
        }
    }

    /// Name of the machine.
    pub fn machine(&self) -> &str {
        &self.machine
    }

    /// Adopts generations that were read; later generations are greater than all of them.
    pub fn learn(&self, read: &PartGenerations) {
        for (part, generation) in read {
            self.note_on_disk(*part, *generation);
            self.last.fetch_max(*generation, Ordering::AcqRel);
        }
    }

    /// Adopts the generation of a line that was read.
    pub fn learn_own(&self, seal: &Seal) {
        let part = match seal.kind {
            SealedFileKind::Store | SealedFileKind::StoreSums => StoredPart::Store,
            SealedFileKind::ProgramSums => StoredPart::Programs,
            SealedFileKind::Folders => StoredPart::Folders,
            SealedFileKind::Anchor => StoredPart::Journal,
            SealedFileKind::Journal | SealedFileKind::Ahead | SealedFileKind::Question => return,
        };
        self.learn(&[(part, seal.generation)].into());
    }

    /// Returns the generation of the next change.
    pub fn next(&self) -> u64 {
        self.last.fetch_add(1, Ordering::AcqRel) + 1
    }

    /// Returns the generation of the last change.
    pub fn last(&self) -> u64 {
        self.last.load(Ordering::Acquire)
    }

    /// Records that a part of this generation is on disk: later lines of other parts name it.
    pub fn note_on_disk(&self, part: StoredPart, generation: u64) {
        self.on_disk[part as usize].fetch_max(generation, Ordering::AcqRel);
    }

    /// Returns the generations on disk.
    pub fn on_disk(&self) -> PartGenerations {
        let read = StoredPart::ALL.map(|part| (part, self.on_disk[part as usize].load(Ordering::Acquire)));
        read.into_iter()
            .filter(|(_, generation)| *generation > 0)
            .collect()
    }

    /// Returns the seal of a line of this generation.
    pub fn seal(&self, kind: SealedFileKind, generation: u64) -> Seal {
        Seal {
            kind,
            machine: self.machine.clone(),
            generation,
            known: self.on_disk(),
        }
    }

    /// Returns the seal of a line that records no generations of other parts.
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
