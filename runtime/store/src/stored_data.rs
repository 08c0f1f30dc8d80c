//! The check whether the files of a data folder are consistent, and the question to a person about inconsistent files.
//!
//! Each sealed line names its machine, its generation and the newest generations of the other parts
//! (`disk/generations.rs`). If a start finds an older copy of a part, or a part of another machine, its content is
//! withheld: it is treated as lost, and a person is asked. No program starts until the question is answered. The
//! withheld data are stored separately: values in `state.unconfirmed.json`, programs in their own files, folders in the
//! question. The question names the generation of the withheld values, so that a copy of other values is not accepted.

pub mod inspection;

use std::io;

use plc_protocol::types::Timestamp;
use plc_protocol::types::stored_data::{
    StoredDataFault, StoredDataFinding, StoredDataPart, StoredDataQuestion,
};
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::disk::{
    DiskPath, Generations, SealedFileKind, read_regular, read_sealed, seal, sync_folder, write_whole,
};
use crate::persistence::{Generation, Image};
use crate::program_store::folder_assignments::FolderByProgram;

/// Name of the file with the question while it is not answered.
const QUESTION_FILE: &str = "question";

/// Name of the file with the withheld values.
const HELD_FILE: &str = "state.unconfirmed.json";

/// Maximum size in bytes of the file with the question. Reason: it contains the folders of all programs.
const QUESTION_BYTES_MAX: u64 = 4 << 20;

/// Content of the file with the question.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct KeptQuestion {
    question: Option<StoredDataQuestion>,
    /// Folders of programs that are withheld.
    #[serde(default)]
    folders: FolderByProgram,
    /// Generation of the withheld values; `None` if none are withheld.
    #[serde(default)]
    values_generation: Option<u64>,
}

/// The question of a data folder, if it is not answered.
#[derive(Debug, Clone, Default)]
pub struct OpenQuestion {
    folder: DiskPath,
    kept: Option<KeptQuestion>,
}

impl OpenQuestion {
    /// Reads the question of the data folder of the machine with this name. A damaged file, and a file of another
    /// machine, is also a question.
    pub fn read(folder: &DiskPath, machine: &str) -> Self {
        let kept = match read_regular(&folder.join(QUESTION_FILE), QUESTION_BYTES_MAX) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(error) => Some(damaged_question(&error.to_string())),
            Ok(bytes) => {
                let mut lines = bytes.split(|byte| *byte == b'\n');
                let kept = lines.find_map(|line| {
                    let (line, seal) = read_sealed(SealedFileKind::Question, line).ok()?;
                    if let Err((_, text)) = seal.check(machine, 0) {
                        return Some(damaged_question(&text));
                    }
                    KeptQuestion::deserialize(&line["kept"]).ok()
                });
                Some(kept.unwrap_or_else(|| damaged_question("it is damaged")))
            }
        };
        Self {
            folder: folder.clone(),
            kept,
        }
    }

    /// Returns a text that describes the decision to make; `None` without a question.
    pub fn text(&self) -> Option<String> {
        let question = self.question()?;
        let findings = question.findings.iter().map(|finding| finding.text.clone());
        let newest = match &question.newest_journal_entry {
            Some(newest) => format!("the newest entry of the journal is from {}", newest.0),
            None => "the journal has no entry".to_owned(),
        };
        Some(format!(
            "{}; {newest}; accept or refuse the files in the HMI or by POST /stored_data/answer",
            findings.collect::<Vec<_>>().join("; ")
        ))
    }

    /// Returns the question; `None` if it is answered.
    pub fn question(&self) -> Option<&StoredDataQuestion> {
        self.kept.as_ref()?.question.as_ref()
    }

    /// Returns the path of the data folder.
    pub fn folder(&self) -> &DiskPath {
        &self.folder
    }

    /// Returns the fault of the store; `None` if no value of the store is withheld.
    pub fn fault_of_store(&self) -> Option<StoredDataFault> {
        let findings = &self.question()?.findings;
        let mut findings = findings.iter();
        let finding = findings.find(|finding| finding.part == StoredDataPart::Store)?;
        Some(finding.fault)
    }

    /// Writes the file with the question.
    fn write(&self, generations: &Generations) -> io::Result<()> {
        let mut line = json!({"n": 1, "kept": self.kept});
        generations.plain_seal(SealedFileKind::Question).put(&mut line);
        let line = seal(&line.to_string());
        write_whole(
            &self.folder.join(QUESTION_FILE),
            format!("{line}\n").repeat(2).as_bytes(),
        )
    }

    /// Returns the withheld values of the store of the machine with this name.
    ///
    /// # Errors
    /// Returns an error if the values cannot be read, belong to another machine, or are not those of the question.
    pub fn held_values(&self, machine: &str) -> io::Result<Image> {
        let path = self.folder.join(HELD_FILE);
        let known = self.kept.as_ref().and_then(|kept| kept.values_generation);
        let read = Generation::read_sealed(&path, SealedFileKind::Withheld).and_then(|read| {
            read.check_seal(machine, known.unwrap_or(0))?;
            Ok(read)
        });
        let named = |error: io::Error| {
            let text = format!(
                "{}: {error}; refuse the files, or restore the original of this file",
                path.display()
            );
            io::Error::new(error.kind(), text)
        };
        let Generation { mut image, lost, .. } = read.map_err(named)?;
        // Values that were lost before stay lost.
        for name in &lost {
            image.lose(name);
        }
        Ok(image)
    }

    /// Returns the withheld folders of programs.
    pub fn held_folders(&self) -> FolderByProgram {
        self.kept
            .as_ref()
            .map(|kept| kept.folders.clone())
            .unwrap_or_default()
    }

    /// Removes the files of the question. The removal is on disk when this method returns.
    ///
    /// # Errors
    /// Returns an error if a disk operation fails.
    pub fn remove_files(&self) -> io::Result<()> {
        for name in [QUESTION_FILE, HELD_FILE] {
            match self.folder.join(name).remove_file() {
                Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
                _ => {}
            }
        }
        sync_folder(&self.folder)
    }
}

fn damaged_question(how: &str) -> KeptQuestion {
    let finding = StoredDataFinding {
        part: StoredDataPart::Store,
        fault: StoredDataFault::NotVerified,
        text: format!("{QUESTION_FILE}: {how}, so it is unknown which files did not fit together"),
    };
    KeptQuestion {
        question: Some(StoredDataQuestion {
            since: Timestamp::default(),
            newest_journal_entry: None,
            findings: vec![finding],
        }),
        folders: FolderByProgram::new(),
        values_generation: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::disk::write_whole_by;

    #[test]
    fn withheld_values_of_another_machine_kind_or_age_are_not_accepted() {
        let folder = tempfile::tempdir().unwrap();
        let path: DiskPath = folder.path().into();
        let (mill, lathe) = (Generations::new("mill"), Generations::new("lathe"));
        let mut image = Image::default();
        image.values.insert("tool/1".to_owned(), b"7".to_vec());
        let write = |of: &Generations, kind, generation| {
            let seal = of.seal(kind, generation);
            write_whole_by(&path.join(HELD_FILE), |out| {
                Generation::write_text(&image, &Timestamp::default(), Some(&seal), out)
            })
            .unwrap();
        };
        let kept = KeptQuestion {
            question: damaged_question("it is damaged").question,
            folders: FolderByProgram::new(),
            values_generation: Some(7),
        };
        let asked = OpenQuestion {
            folder: path.clone(),
            kept: Some(kept),
        };
        asked.write(&mill).unwrap();
        let open = OpenQuestion::read(&path, "mill");
        write(&mill, SealedFileKind::Withheld, 7);
        assert_eq!(open.held_values("mill").unwrap(), image);
        for (of, kind, generation, how) in [
            (
                &mill,
                SealedFileKind::Withheld,
                6,
                "an older copy, of generation 6",
            ),
            (&mill, SealedFileKind::LastGood, 7, "another kind, last_good"),
            (&lathe, SealedFileKind::Withheld, 7, "belongs to machine lathe"),
        ] {
            write(of, kind, generation);
            let error = open.held_values("mill").unwrap_err().to_string();
            assert!(
                error.contains(how) && error.contains("refuse the files"),
                "{error}"
            );
        }
        let foreign = OpenQuestion::read(&path, "lathe");
        let text = foreign.text().unwrap();
        assert!(text.contains("belongs to machine mill"), "{text}");
    }
}
