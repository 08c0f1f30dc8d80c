//! Whether the files of a data folder fit together, and the question about those that do not.
//!
//! Each sealed line names its machine, its generation and the newest generations of the other parts
//! (`disk/generations.rs`). If a start finds an older copy of a part, or one of another machine, its content is held back:
//! it counts as lost, and a person is asked. No program starts until the question is answered. What was held back is
//! kept beside the store: values in [`HELD_FILE`], programs in their files, folders in the question itself.

pub(crate) mod inspection;

use std::io;
use std::path::{Path, PathBuf};

use plc_api::types::Timestamp;
use plc_api::types::stored_data::{StoredDataFault, StoredDataFinding, StoredDataPart, StoredDataQuestion};
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::disk::{Generations, Kind, fs, read_regular, read_sealed, seal, sync_folder, write_whole};
use crate::program_store::places::FolderByProgram;

/// File with the question, as long as it is open.
const QUESTION_FILE: &str = "question";

/// File with the values that are held back.
const HELD_FILE: &str = "state.unconfirmed.json";

/// Maximum size of the file with the question, bytes. Reason: it contains the folders of all programs.
const QUESTION_BYTES_MAX: u64 = 4 << 20;

/// Content of the file with the question.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct KeptQuestion {
    question: Option<StoredDataQuestion>,
    /// Folders that are held back.
    #[serde(default)]
    folders: FolderByProgram,
}

/// The question of a data folder, if one is open.
#[derive(Debug, Clone, Default)]
pub(crate) struct OpenQuestion {
    folder: PathBuf,
    kept: Option<KeptQuestion>,
}

impl OpenQuestion {
    /// Reads the file of a folder. One that is damaged is a question all the same.
    pub fn read(folder: &Path) -> Self {
        let kept = match read_regular(&folder.join(QUESTION_FILE), QUESTION_BYTES_MAX) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(error) => Some(damaged_question(&error.to_string())),
            Ok(bytes) => {
                let mut lines = bytes.split(|byte| *byte == b'\n');
                let kept = lines.find_map(|line| {
                    let (line, _) = read_sealed(Kind::Question, line).ok()?;
                    KeptQuestion::deserialize(&line["kept"]).ok()
                });
                Some(kept.unwrap_or_else(|| damaged_question("it is damaged")))
            }
        };
        Self {
            folder: folder.to_owned(),
            kept,
        }
    }

    /// What a person must decide, in one text.
    pub fn text(&self) -> Option<String> {
        let question = self.question()?;
        let findings = question.findings.iter().map(|finding| finding.text.clone());
        let newest = match &question.newest_journal_entry {
            Some(newest) => format!("the newest entry of the journal is of {}", newest.0),
            None => "the journal has no entry".to_owned(),
        };
        Some(format!(
            "{}; {newest}; accept or refuse them in the HMI or by POST /stored_data/answer",
            findings.collect::<Vec<_>>().join("; ")
        ))
    }

    pub fn question(&self) -> Option<&StoredDataQuestion> {
        self.kept.as_ref()?.question.as_ref()
    }

    /// The data folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// How the store does not fit; `None`: none of its values is held back.
    pub fn fault_of_store(&self) -> Option<StoredDataFault> {
        let findings = &self.question()?.findings;
        let mut findings = findings.iter();
        let finding = findings.find(|finding| finding.part == StoredDataPart::Store)?;
        Some(finding.fault)
    }

    /// Writes the file of the question.
    fn write(&self, generations: &Generations) -> io::Result<()> {
        let mut line = json!({"n": 1, "kept": self.kept});
        generations.plain_seal(Kind::Question).put(&mut line);
        let line = seal(&line.to_string());
        write_whole(
            &self.folder.join(QUESTION_FILE),
            format!("{line}\n").repeat(2).as_bytes(),
        )
    }

    /// Folders that are held back.
    pub fn held_folders(&self) -> FolderByProgram {
        self.kept
            .as_ref()
            .map(|kept| kept.folders.clone())
            .unwrap_or_default()
    }

    /// Removes the files of the question; on disk when this returns.
    ///
    /// # Errors
    /// The disk refuses.
    pub fn remove_files(&self) -> io::Result<()> {
        for name in [QUESTION_FILE, HELD_FILE] {
            match fs::remove_file(self.folder.join(name)) {
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
    }
}
