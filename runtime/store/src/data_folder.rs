//! The data folder of a stopped machine. `tandem store` verifies, repairs, exports and imports this folder.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use plc_protocol::server::ServerTransport;
use plc_protocol::types::program::SignatureState;
use plc_protocol::types::stored_data::StoredDataPart;
use plc_protocol::types::{CoordinateSystemNumber, Timestamp};
use tandem_model::lost::is_lost;

use crate::clock::Clock;
use crate::disk::{DiskPath, Generations, Lock};
use crate::journal::{Event, Line};
use crate::persistence::journal_file::append_line;
use crate::persistence::journal_folder::{JOURNAL_FOLDER, newest};
use crate::persistence::journal_reader::damage;
use crate::persistence::positions::POSITION;
use crate::persistence::{
    Generation, Image, InspectedStore, PAGE_VARIABLES, STORE_FILE, Store, StoreCondition, inspect_store,
    page_name, pages, restore,
};
use crate::program_store::Signers;
use crate::program_store::folder::{Opening, ProgramFileState, ProgramFolder, scan_folder};
use crate::program_store::folder_assignments::{FolderAssignmentsRead, PLACES_FILE};
use crate::stored_data::OpenQuestion;
use crate::stored_data::inspection::Inspection;
use crate::tables::{LOST_VALUE, TableSettings, Tables, value_key};

/// Settings of a machine on which its stored data depend.
#[derive(Debug, Clone)]
pub struct StoredMachine {
    /// Name of the machine. Each sealed line of its files contains this name.
    pub name: String,
    /// The data folder; `None` if the machine stores no data.
    pub data_dir: Option<PathBuf>,
    /// Configured tools, axes and work offsets.
    pub tables: TableSettings,
    /// Names of the outputs whose last values are stored.
    pub kept_outputs: Vec<String>,
    /// Name of the dialect of the programs that name none.
    pub dialect: &'static str,
    /// True if the coordinate systems have several dialects.
    pub is_mixed: bool,
    /// Maximum size of all programs, bytes.
    pub programs_bytes_max: usize,
    /// Keys that sign programs.
    pub signers: Signers,
}

impl StoredMachine {
    /// Returns the names of all values that the store of the machine contains.
    pub fn value_names(&self) -> Vec<String> {
        let tables = Tables::new(self.tables.clone());
        let mut names: Vec<String> = (0..pages(&tables.global()))
            .map(|place| page_name(0, place))
            .collect();
        for cs in tables.coordinate_systems() {
            let array = tables.variables(cs).coordinate_system;
            names.extend((0..pages(&array)).map(|place| page_name(cs, place)));
            names.extend(["tool", "last_run", POSITION].map(|what| value_key(what, cs)));
        }
        names.extend(tables.kept(&tables.read().clone()).into_keys());
        names.extend(self.kept_outputs.iter().cloned());
        names
    }
}

/// An opened data folder. It is locked, so that no runtime can use it.
#[derive(Debug)]
pub struct DataFolder {
    path: DiskPath,
    clock: Clock,
    machine: StoredMachine,
    inspected: InspectedStore,
    inspection: Inspection,
    _lock: Option<Lock>,
}

/// Findings in a data folder.
#[derive(Debug, Default)]
pub struct DataFolderFindings {
    /// Descriptions of damage, each with its location.
    pub damaged: Vec<String>,
    /// Notes that do not describe damage.
    pub notes: Vec<String>,
}

/// A lost value and its replacement in the last good generation.
#[derive(Debug)]
pub struct Offer {
    /// Description of the value.
    pub what: String,
    /// Value in the last good generation; `None` if that generation does not contain the value.
    pub older: Option<String>,
}

impl DataFolder {
    /// Opens and inspects the data folder of a machine.
    ///
    /// # Errors
    /// Returns an error if the folder does not exist, or if a runtime is using it.
    pub fn open(machine: StoredMachine) -> io::Result<Self> {
        let missing = || {
            io::Error::new(
                io::ErrorKind::NotFound,
                "the machine stores no data: it has no data_dir",
            )
        };
        let path: DiskPath = machine.data_dir.clone().ok_or_else(missing)?.into();
        let named = |error: io::Error| io::Error::new(error.kind(), format!("{}: {error}", path.display()));
        path.metadata().map_err(named)?;
        let lock = Lock::acquire(&path).map_err(named)?;
        let inspection = Inspection::new(&path, &machine.name);
        let mut inspected = inspection.inspected.clone();
        if inspected.is_all_lost || inspection.holds_back(StoredDataPart::Store) {
            inspected.lose(machine.value_names());
        }
        Ok(Self {
            path,
            clock: Clock::real(),
            machine,
            inspected,
            inspection,
            _lock: lock,
        })
    }

    /// Writes a journal line with the user and the command that change this folder. Does nothing without a journal.
    ///
    /// # Errors
    /// Returns an error if a disk operation fails.
    pub fn record(&self, user: Option<String>, command: &str) -> io::Result<()> {
        self.ask();
        self.append_request(user, command).map(drop)
    }

    /// Writes the question about inconsistent files to disk. This must come before a change, because the change would
    /// hide the inconsistency.
    fn ask(&self) -> OpenQuestion {
        let newest = newest(&self.path.join(JOURNAL_FOLDER), 0, 1).time();
        self.inspection.ask(&self.path, self.time_of_day(), newest)
    }

    fn time_of_day(&self) -> Timestamp {
        Timestamp::from_system_time(self.clock.time_of_day())
    }

    /// Writes a journal line with the user and the command into a machine's data folder. Returns false without a
    /// journal.
    ///
    /// # Errors
    /// Returns an error if a runtime is using the folder, or if a disk operation fails.
    pub fn record_in(machine: &StoredMachine, user: Option<String>, command: &str) -> io::Result<bool> {
        let path: Option<DiskPath> = machine.data_dir.clone().map(DiskPath::from);
        let Some(path) = path.filter(is_folder) else {
            return Ok(false);
        };
        let folder = Self {
            _lock: Lock::acquire(&path)?,
            inspection: Inspection::new(&path, &machine.name),
            inspected: inspect_store(&path),
            path,
            clock: Clock::real(),
            machine: machine.clone(),
        };
        folder.ask();
        folder.append_request(user, command)
    }

    /// Verifies all stored data without changing anything.
    pub fn verify(&self) -> DataFolderFindings {
        let mut findings = DataFolderFindings::default();
        let store = self.path.join(STORE_FILE);
        match &self.inspected.condition {
            StoreCondition::Damaged(how) => findings.damaged.push(format!("{}: {how}", store.display())),
            StoreCondition::New | StoreCondition::Whole => {}
        }
        if let Some(fault) = &self.inspected.sums_fault {
            findings.damaged.push(format!(
                "the checksum file of {}: {fault}; the values are kept, but not verified",
                store.display()
            ));
        }
        let others = self.inspection.findings.iter();
        let others = others.filter(|finding| finding.part != StoredDataPart::Store);
        findings
            .damaged
            .extend(others.map(|finding| finding.text.clone()));
        if let Some(text) = OpenQuestion::read(&self.path, &self.machine.name).text() {
            findings.damaged.push(format!("a question is open: {text}"));
        }
        let places = FolderAssignmentsRead::read(&self.programs());
        let folders = self
            .inspection
            .lacks_folders
            .then(|| "the file is missing".to_owned());
        if let Some(fault) = places.fault.or(folders) {
            findings.damaged.push(format!("programs/{PLACES_FILE}: {fault}"));
        }
        let lost = lost_in(&self.inspected.image);
        findings
            .damaged
            .extend(lost.into_values().map(|what| format!("{what}: lost")));
        if let Err(error) = self.last_good()
            && error.kind() != io::ErrorKind::NotFound
        {
            findings.damaged.push(error.to_string());
        }
        self.verify_programs(&mut findings);
        let journal = damage(&self.path.join(JOURNAL_FOLDER));
        findings.damaged.extend(journal.warnings());
        findings
    }

    fn verify_programs(&self, findings: &mut DataFolderFindings) {
        let looked = match scan_folder(
            &self.programs(),
            self.machine.is_mixed,
            self.machine.programs_bytes_max,
        ) {
            Ok(looked) => looked,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return,
            Err(error) => {
                return findings
                    .damaged
                    .push(format!("{}: {error}", self.programs().display()));
            }
        };
        for (number, found) in looked.programs {
            let signature = looked.signatures.get(&number);
            if let ProgramFileState::Stored(bytes) | ProgramFileState::FromOutside(bytes, ..) = &found
                && let Some(state) = self.machine.signers.verify_signature(bytes, signature)
                && let Some(why) = signature_fault(state)
            {
                findings
                    .notes
                    .push(format!("program {number}: {why}, so it is not loaded"));
            }
            match found {
                ProgramFileState::Stored(_) => {}
                ProgramFileState::FromOutside(_, how, _) => {
                    findings.notes.push(format!("program {number}: {how}"));
                }
                ProgramFileState::Damaged(how) => findings.damaged.push(format!("program {number}: {how}")),
            }
        }
        let gone = looked.gone.into_iter();
        findings
            .damaged
            .extend(gone.map(|(number, _)| format!("program {number}: its file is missing")));
        findings.notes.extend(looked.not_read);
    }

    fn programs(&self) -> DiskPath {
        self.path.join("programs")
    }

    /// Returns the stored values as a document that [`DataFolder::import`] accepts.
    pub fn export(&self) -> String {
        Generation::text(&self.inspected.image, &self.time_of_day())
    }

    fn last_good(&self) -> io::Result<Generation> {
        let read = Generation::read(&self.path, &self.inspection.generations);
        read.map_err(|error| io::Error::new(error.kind(), format!("the last good generation: {error}")))
    }

    /// Returns every lost value with its value in the last good generation, and the time of that generation.
    pub fn offers(&self) -> (Option<String>, Vec<Offer>) {
        let generation = self.last_good().ok();
        let lost = lost_in(&self.inspected.image).into_iter();
        let offers = lost.map(|(name, what)| Offer {
            what,
            older: generation
                .as_ref()
                .and_then(|generation| older(generation, &name)),
        });
        let written = generation.as_ref().map(|generation| generation.written.0.clone());
        (written, offers.collect())
    }

    /// Restores lost values from the last good generation. Returns the values that are still lost.
    ///
    /// # Errors
    /// Returns an error if a disk operation fails, or if no good generation exists.
    pub fn repair(&mut self) -> io::Result<Vec<String>> {
        let generation = self.last_good()?;
        let mut change = Image::default();
        for name in lost_in(&self.inspected.image).into_keys() {
            if let Some(page) = self.inspected.image.page(&name) {
                let Some(older) = generation.image.page(&name) else {
                    continue;
                };
                let mut page = page.clone();
                for (bits, older) in page.0.iter_mut().zip(older.0) {
                    if is_lost(f64::from_bits(*bits)) {
                        *bits = older;
                    }
                }
                change.take_record(&name, &page.to_bytes());
            } else if let Some(value) = generation.image.values.get(&name) {
                change.values.insert(name, value.clone());
            }
        }
        self.write(change)?;
        Ok(lost_in(&self.inspected.image).into_values().collect())
    }

    /// Imports the values of a document; all other values stay. Returns the number of imported values.
    ///
    /// # Errors
    /// Returns an error if the document is invalid or a disk operation fails. Then no value has changed.
    pub fn import(&mut self, text: &str) -> io::Result<usize> {
        let Image { pages, mut values } = Generation::of_text(text, false)?.image;
        // motor positions apply only to the machine that exported them
        values.retain(|name, _| !name.starts_with(&format!("{POSITION}/")));
        let (tables, count) = (
            Tables::new(self.machine.tables.clone()),
            pages.len() + values.len(),
        );
        let mut change = Image {
            values,
            ..Image::default()
        };
        let restored = restore(&tables, &change);
        if !restored.lost_runs.is_empty() || !tables.lost().is_empty() {
            let text = format!("values of unknown form: {}", tables.lost().join("; "));
            return Err(io::Error::new(io::ErrorKind::InvalidData, text));
        }
        for (key, mut page) in pages {
            // a variable that the document marks as lost keeps its current value
            let now = self
                .inspected
                .image
                .pages
                .get(&key)
                .map_or([0; PAGE_VARIABLES], |page| page.0);
            for (bits, now) in page.0.iter_mut().zip(now) {
                if is_lost(f64::from_bits(*bits)) {
                    *bits = now;
                }
            }
            change.pages.insert(key, page);
        }
        self.write(change)?;
        Ok(count)
    }

    /// Accepts the current text of a program file that was damaged or changed outside of the runtime.
    ///
    /// # Errors
    /// Returns an error if the file does not exist, or if a disk operation fails.
    pub fn accept_program(&self, number: u16) -> io::Result<()> {
        self.ask();
        let opening = Opening {
            dialect: self.machine.dialect,
            is_mixed: self.machine.is_mixed,
            bytes_max: self.machine.programs_bytes_max,
            generations: Arc::clone(&self.inspection.generations),
            holds_back: self.inspection.holds_back(StoredDataPart::Programs),
        };
        let (mut folder, _) = ProgramFolder::open(&self.programs(), &opening)?;
        folder.accept(number).map(drop)
    }

    fn write(&mut self, change: Image) -> io::Result<()> {
        self.ask();
        let (mut store, _) = Store::open(&self.path, &self.inspected, &self.inspection.generations)?;
        store.commit(&change)?;
        self.inspected.image.take_over(change);
        drop(store);
        // inspects the store again, as the next start will do
        self.inspected = inspect_store(&self.path);
        Ok(())
    }

    /// Returns the path of the data folder.
    pub fn path(&self) -> &Path {
        self.path.as_path()
    }

    /// Writes a journal line with the user and the command. Returns false without a journal.
    fn append_request(&self, user: Option<String>, command: &str) -> io::Result<bool> {
        let journal = self.path.join(JOURNAL_FOLDER);
        if !is_folder(&journal) {
            return Ok(false);
        }
        let event = Event::Request {
            user,
            from: None,
            over: ServerTransport::CommandLine,
            request: command.to_owned(),
            said: None,
            command_id: None,
        };
        let line = Line {
            t_s: 0.0,
            cs: 0,
            event,
        };
        let generations: Arc<Generations> = Arc::clone(&self.inspection.generations);
        append_line(&journal, generations, &self.clock, &line)?;
        Ok(true)
    }
}

fn is_folder(path: &DiskPath) -> bool {
    path.metadata().is_ok_and(|metadata| metadata.is_folder())
}

fn signature_fault(state: SignatureState) -> Option<&'static str> {
    match state {
        SignatureState::Valid => None,
        SignatureState::Missing => Some("it is not signed"),
        SignatureState::Wrong => Some("its signature belongs to none of the keys, or to another text"),
    }
}

fn older(generation: &Generation, name: &str) -> Option<String> {
    if let Some(page) = generation.image.page(name) {
        let values = page.0.iter().map(|bits| f64::from_bits(*bits));
        let set = values.filter(|value| *value != 0.0).count();
        return Some(format!("{set} of {} values are not 0", page.0.len()));
    }
    let bytes = generation.image.values.get(name)?;
    let value: serde_json::Value = serde_json::from_slice(bytes).ok()?;
    Some(value.get("now").unwrap_or(&value).to_string())
}

/// Returns the description of each lost value of an image, by the name of the value.
fn lost_in(image: &Image) -> BTreeMap<String, String> {
    let mut lost = BTreeMap::new();
    for name in image.names() {
        if let Some(page) = image.page(&name) {
            let count = page
                .0
                .iter()
                .filter(|bits| is_lost(f64::from_bits(**bits)))
                .count();
            if count > 0 {
                let words = in_words(&name);
                let what = if count == page.0.len() {
                    words
                } else {
                    format!("{count} of {words}")
                };
                lost.insert(name, what);
            }
        } else if let Some(bytes) = image.values.get(&name) {
            let value: serde_json::Value = serde_json::from_slice(bytes).unwrap_or_default();
            let has_lost_axis =
                name.starts_with("work_offset/") && value["now"].as_object().is_some_and(has_null);
            if bytes == LOST_VALUE || has_lost_axis {
                lost.insert(name.clone(), in_words(&name));
            }
        }
    }
    lost
}

fn has_null(axes: &serde_json::Map<String, serde_json::Value>) -> bool {
    axes.values().any(serde_json::Value::is_null)
}

/// Returns the description of a value with this name, such as `P384 to P511`.
fn in_words(name: &str) -> String {
    let parts: Vec<&str> = name.split('/').collect();
    let of = |cs: &str| match cs.parse::<CoordinateSystemNumber>() {
        Ok(cs) => format!(" of coordinate system {cs}"),
        Err(_) => String::new(),
    };
    let range = |letter: &str, place: &str, of: String| {
        let first = place.parse::<usize>().unwrap_or(0) * PAGE_VARIABLES;
        format!("{letter}{first} to {letter}{}{of}", first + PAGE_VARIABLES - 1)
    };
    match parts[..] {
        ["p", place] => range("P", place, String::new()),
        ["q", cs, place] => range("Q", place, of(cs)),
        ["tool_data", id] => format!("tool {id}"),
        ["work_offset", cs, offset] => format!("{offset}{}", of(cs)),
        ["tool", cs] => format!("the tool in the spindle{}", of(cs)),
        ["position", cs] => format!("the motor positions{}", of(cs)),
        ["last_run", cs] => format!("the last run{}", of(cs)),
        _ => name.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_value_has_words() {
        for (name, words) in [
            ("p/3", "P384 to P511"),
            ("q/2/0", "Q0 to Q127 of coordinate system 2"),
            ("tool_data/19", "tool 19"),
            ("work_offset/1/G54", "G54 of coordinate system 1"),
            ("tool/1", "the tool in the spindle of coordinate system 1"),
            ("last_run/2", "the last run of coordinate system 2"),
            ("other", "other"),
        ] {
            assert_eq!(in_words(name), words);
        }
    }
}
