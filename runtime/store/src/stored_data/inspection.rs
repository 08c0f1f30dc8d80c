//! Inspects a data folder at a start, before the start changes any file, and determines the parts to hold
//! back.

use std::sync::Arc;

use plc_protocol::types::Timestamp;
use plc_protocol::types::stored_data::{
    StoredDataFault, StoredDataFinding, StoredDataPart, StoredDataQuestion,
};

use super::{HELD_FILE, OpenQuestion, QUESTION_FILE};
use crate::disk::{
    Checksums, DiskPath, Generations, PartGenerations, Seal, SealMismatch, SealedFileKind, StoredPart,
    write_whole_by,
};
use crate::persistence::journal_folder::JOURNAL_FOLDER;
use crate::persistence::{
    GENERATION_FILE, Generation, Image, InspectedStore, STORE_FILE, StoreCondition, anchor_seal,
    inspect_expected_store,
};
use crate::program_store::folder::read_checksums as program_sums;
use crate::program_store::folder_assignments::{FolderAssignmentsRead, FolderByProgram, PLACES_FILE};
use crate::program_store::program_number;

/// Result of inspecting a data folder at a start, before the start changes any file.
#[derive(Debug)]
pub struct Inspection {
    /// The inspected store.
    pub inspected: InspectedStore,
    /// Generations of all parts.
    pub generations: Arc<Generations>,
    /// Files that are inconsistent with the others.
    pub findings: Vec<StoredDataFinding>,
    /// Values of the store that are held back until a person confirms them.
    held: Option<Image>,
    held_folders: FolderByProgram,
    /// True if the file with the folders of programs existed and is now missing.
    pub lacks_folders: bool,
}

/// The parts of the data folder other than the store, as read from disk.
struct Others {
    sums: Checksums,
    places: FolderAssignmentsRead,
    anchor: Option<Seal>,
    has_programs: bool,
}

/// Returns true if the folder contains at least one program file.
fn has_program(folder: &DiskPath) -> bool {
    let entries = folder.list_folder().unwrap_or_default();
    entries
        .iter()
        .any(|entry| program_number(entry.as_path()).is_some())
}

impl Others {
    fn read(folder: &DiskPath) -> Self {
        let programs = folder.join("programs");
        Self {
            sums: program_sums(&programs),
            places: FolderAssignmentsRead::read(&programs),
            anchor: anchor_seal(&folder.join(JOURNAL_FOLDER)),
            has_programs: has_program(&programs),
        }
    }

    /// Returns the seals of these parts, which describe the state on disk.
    fn seals(&self) -> impl Iterator<Item = &Seal> {
        [
            self.sums.seal.as_ref(),
            self.places.seal.as_ref(),
            self.anchor.as_ref(),
        ]
        .into_iter()
        .flatten()
    }
}

fn merge<'a>(seals: impl Iterator<Item = &'a Seal>) -> PartGenerations {
    let mut known = PartGenerations::new();
    for (part, generation) in seals.flat_map(|seal| &seal.known) {
        let newest = known.entry(*part).or_default();
        *newest = (*newest).max(*generation);
    }
    known
}

impl Inspection {
    /// Inspects the data folder of the machine with this name; does not change any file.
    pub fn new(folder: &DiskPath, machine: &str) -> Self {
        let others = Others::read(folder);
        let mut inspected =
            inspect_expected_store(folder, merge(others.seals()).contains_key(&StoredPart::Store));
        let of_store = [inspected.store_seal.clone(), inspected.sums_seal.clone()];
        let known = merge(others.seals().chain(of_store.iter().flatten()));
        let look = PartComparison {
            machine,
            known: &known,
            folder,
        };
        let mut findings = Vec::new();
        findings.extend(look.at_store(&inspected));
        findings.extend(look.at_programs(&others));
        findings.extend(look.at_folders(&others.places));
        findings.extend(look.at(StoredPart::Journal, others.anchor.as_ref()));
        let mut held = None;
        if let Some(finding) = findings
            .iter()
            .find(|finding| finding.part == StoredDataPart::Store)
        {
            held = Some(inspected.image.clone());
            inspected.hold_back(finding.text.clone());
        }
        let holds_folders = findings
            .iter()
            .any(|finding| finding.part == StoredDataPart::Folders);
        let lacks_folders = others.places.seal.is_none()
            && others.places.fault.is_none()
            && known.contains_key(&StoredPart::Folders);
        let generations = Generations::new(machine);
        generations.learn(&known);
        let own = others.seals().chain(of_store.iter().flatten());
        own.for_each(|seal| generations.learn_own(seal));
        Self {
            inspected,
            generations: Arc::new(generations),
            held,
            held_folders: if holds_folders {
                others.places.by_number
            } else {
                FolderByProgram::new()
            },
            findings,
            lacks_folders,
        }
    }

    /// Returns true if this part is held back until a person confirms it.
    pub fn holds_back(&self, part: StoredDataPart) -> bool {
        self.findings.iter().any(|finding| finding.part == part)
    }

    /// Returns the question about this folder to a person. It combines the findings of this start with those
    /// of an earlier pending question. A new question is written with the held-back data before any file of
    /// the folder is changed. If the disk operation fails, this start asks the question nevertheless.
    pub fn ask(&self, folder: &DiskPath, since: Timestamp, newest: Option<Timestamp>) -> OpenQuestion {
        let before = OpenQuestion::read(folder, self.generations.machine());
        if self.findings.is_empty() {
            return before;
        }
        let mut kept = before.kept.unwrap_or_default();
        kept.folders.extend(self.held_folders.clone());
        let mut findings = self.findings.clone();
        let old = kept.question.take().map(|question| question.findings);
        findings.extend(old.into_iter().flatten());
        findings.sort_by_key(|finding| finding.part);
        findings.dedup_by_key(|finding| finding.part);
        let held = self.held.as_ref().map_or(Ok(()), |held| {
            let generation = self.generations.next();
            kept.values_generation = Some(generation);
            let seal = self.generations.seal(SealedFileKind::Withheld, generation);
            write_whole_by(&folder.join(HELD_FILE), |out| {
                Generation::write_text(held, &since, Some(&seal), out)
            })
        });
        kept.question = Some(StoredDataQuestion {
            since,
            newest_journal_entry: newest,
            findings,
        });
        let open = OpenQuestion {
            folder: folder.clone(),
            kept: Some(kept),
        };
        if let Err(error) = held.and_then(|()| open.write(&self.generations)) {
            tracing::error!("{}: {error}", folder.join(QUESTION_FILE).display());
        }
        open
    }
}

/// The machine, generations and folder with which each part is compared.
struct PartComparison<'a> {
    machine: &'a str,
    known: &'a PartGenerations,
    folder: &'a DiskPath,
}

impl PartComparison<'_> {
    fn at_store(&self, inspected: &InspectedStore) -> Option<StoredDataFinding> {
        let is_believed = match inspected.condition {
            StoreCondition::New => false,
            StoreCondition::Whole => true,
            StoreCondition::Damaged(_) => inspected.image.names().len() > inspected.lost.len(),
        };
        is_believed
            .then(|| self.at(StoredPart::Store, inspected.seal()))
            .flatten()
    }

    fn at_programs(&self, others: &Others) -> Option<StoredDataFinding> {
        let is_known = self.known.contains_key(&StoredPart::Programs);
        match others.sums.fault().filter(|_| is_known && others.has_programs) {
            Some(fault) => Some(StoredDataFinding {
                part: StoredDataPart::Programs,
                fault: StoredDataFault::NotVerified,
                text: format!(
                    "{}: {fault}, so the programs in this folder cannot be verified",
                    self.path(StoredPart::Programs)
                ),
            }),
            None => self.at(StoredPart::Programs, others.sums.seal.as_ref()),
        }
    }

    fn at_folders(&self, places: &FolderAssignmentsRead) -> Option<StoredDataFinding> {
        let seal = places.seal.as_ref()?;
        self.at(StoredPart::Folders, Some(seal))
    }

    /// Compares a part with the generation that the other parts record about it.
    fn at(&self, part: StoredPart, seal: Option<&Seal>) -> Option<StoredDataFinding> {
        let seal = seal?;
        let (known, path) = (self.known.get(&part).copied().unwrap_or(0), self.path(part));
        let (mismatch, text) = seal.check(self.machine, known).err()?;
        let fault = match mismatch {
            SealMismatch::OtherMachine => StoredDataFault::OtherMachine,
            SealMismatch::Older => StoredDataFault::Older,
        };
        let part = part.public();
        let text = format!("{path}: {text}");
        Some(StoredDataFinding { part, fault, text })
    }

    fn path(&self, part: StoredPart) -> String {
        let name = match part {
            StoredPart::Store => STORE_FILE.to_owned(),
            StoredPart::Programs => "programs/sums".to_owned(),
            StoredPart::Folders => format!("programs/{PLACES_FILE}"),
            StoredPart::Journal => format!("{JOURNAL_FOLDER}/anchor"),
            StoredPart::LastGood => GENERATION_FILE.to_owned(),
        };
        self.folder.join(name).display().to_string()
    }
}

impl StoredPart {
    fn public(self) -> StoredDataPart {
        match self {
            StoredPart::Store | StoredPart::LastGood => StoredDataPart::Store,
            StoredPart::Programs => StoredDataPart::Programs,
            StoredPart::Folders => StoredDataPart::Folders,
            StoredPart::Journal => StoredDataPart::Journal,
        }
    }
}
