//! Opens the resources that a machine needs before it starts: its data folder, its program store and its hardware.

use std::io;
use std::sync::Arc;

use plc_protocol::types::io::IoDeclarations;
use plc_protocol::types::state::{Execution, Reason};
use plc_protocol::types::stored_data::StoredDataPart;
use plc_protocol::types::{BootId, Timestamp};
use tandem_config::{Machine, ProgramSource};
use tandem_model::alarm::{JOURNAL_DAMAGED, NOT_READ, STORE_DAMAGED};
use tandem_servo::{Hardware, HardwareFactory};
use tandem_store::disk::{DataFolderPart, Disk, DiskPath, Health, Lock, make_folder, tighten, write_whole};
use tandem_store::environment::Environment;
use tandem_store::journal::Event;
use tandem_store::persistence::journal_file::JournalThread;
use tandem_store::persistence::journal_folder::{JOURNAL_FOLDER, Newest, newest};
use tandem_store::persistence::positions::{KeptPositions, rest_positions};
use tandem_store::persistence::{
    Image, InspectedStore, LastRuns, RestoredState, STARTED_FILE, STORE_FILE, Store, StoreCondition,
    forget_outputs, replay_last_runs, restore, restore_outputs,
};
use tandem_store::program_store::signing::read_program_signature;
use tandem_store::program_store::{
    Edit, EditKind, HeldBack, ProgramFindings, ProgramStore, StoredProgram, check_readable, read_text,
};
use tandem_store::stored_data::OpenQuestion;
use tandem_store::stored_data::inspection::Inspection;
use tandem_store::tables::Tables;

use super::StartError;
use crate::coordinate_system::Mailbox;
use crate::data_watch::{DataWatch, list, warn_changed, warn_once, warn_standing};
use crate::shared::SharedState;
use crate::state_writer::{Source, StateWriterThread};

/// Contents of the opened data folder.
pub(super) struct Data {
    environment: Environment,
    folder: DiskPath,
    /// `None` if the store cannot be opened.
    store: Option<Store>,
    image: Image,
    /// Notes for the operator about stored data that are damaged or lost.
    notes: Vec<String>,
    pub journal: JournalThread,
    pub newest: Newest,
    pub health: Arc<Health>,
    /// Parts of the folder that are withheld until an operator answers the question about inconsistent files.
    pub held: HeldBack,
    pub question: OpenQuestion,
    lock: Option<Lock>,
}

/// Threads that watch the data folder and write into it. Dropping this value writes all pending data.
#[derive(Debug)]
pub(super) struct Keepers {
    _watch: DataWatch,
    pub state: StateWriterThread,
    _journal: JournalThread,
    _lock: Option<Lock>,
}

impl Data {
    /// Opens the data folder and creates it if it is missing. Locks the folder, so that no other runtime can open it.
    pub fn open(
        environment: &Environment,
        machine: &Machine,
        boot_id: BootId,
    ) -> Result<Option<Self>, StartError> {
        let Some(folder) = machine.data_dir.as_ref() else {
            return Ok(None);
        };
        let folder = &environment.disk.at(folder);
        let locked = make_folder(folder).and_then(|()| Lock::acquire(folder));
        let lock = locked.map_err(|error| refused(folder, error))?;
        let mut inspection = Inspection::new(folder, &machine.name);
        if inspection.inspected.is_all_lost || inspection.holds_back(StoredDataPart::Store) {
            inspection.inspected.lose(machine.stored().value_names());
        }
        let health = Arc::new(Health::default());
        let journal = folder.join(JOURNAL_FOLDER);
        let since = Timestamp::from_system_time(environment.clock.time_of_day());
        let question = inspection.ask(folder, since, newest(&journal, 0, 1).time());
        let held = HeldBack {
            generations: Arc::clone(&inspection.generations),
            programs: inspection.holds_back(StoredDataPart::Programs),
            folders: inspection.holds_back(StoredDataPart::Folders),
        };
        let inspected = inspection.inspected;
        let (store, aside) = match Store::open(folder, &inspected, &held.generations) {
            Ok((store, aside)) => (Some(store), aside),
            Err(error) if error.kind() == io::ErrorKind::ResourceBusy => return Err(refused(folder, error)),
            refused => {
                health.record_attempt(DataFolderPart::Store, &refused);
                (None, None)
            }
        };
        let mut notes = notes(folder, &inspected, aside.as_ref());
        if inspection.lacks_folders {
            notes.push("programs/folders.json: the file is missing; programs are in no folder".to_owned());
        }
        let image = inspected.image;
        let generations = Arc::clone(&held.generations);
        let of_journal = Arc::clone(&health);
        let (journal, newest) = JournalThread::start(&journal, boot_id, generations, of_journal, environment)
            .map_err(StartError::Thread)?;
        Ok(Some(Self {
            environment: environment.clone(),
            folder: folder.clone(),
            store,
            image,
            notes,
            journal,
            newest,
            health,
            held,
            question,
            lock,
        }))
    }

    /// Restores the stored data. Newer entries of the journal are added to them and written to the store.
    pub fn restore(&mut self, tables: &Tables, io: &IoDeclarations) -> RestoredState {
        let mut restored = restore(tables, &self.image);
        restored.outputs = restore_outputs(io, &self.image);
        let lost = restored.outputs.iter().filter(|(_, last)| last.is_none());
        self.notes.extend(lost.map(|(point, _)| {
            format!("the last value of {point} is lost: inspect the machine, then write or force this output")
        }));
        let lines = &self.newest.lines;
        let mut change = replay_last_runs(tables.coordinate_systems(), &mut restored.last_runs, lines);
        change.values.extend(forget_outputs(io, &self.image));
        change
            .values
            .extend(rest_positions(&self.image, &self.newest.rests));
        let change = change.beyond(&self.image);
        if let (false, Some(store)) = (change.is_empty(), &mut self.store) {
            let written = store.commit(&change);
            self.health.record_attempt(DataFolderPart::Store, &written);
            match written {
                Ok(()) => self.image.take_over(change),
                Err(_) => self.store = None,
            }
        }
        self.notes.extend(self.positions().lost().map(|cs| {
            format!(
                "the motor positions of coordinate system {cs} are lost, so the motors are not homed; a \
                 reset after alarm 208 homes simulated motors"
            )
        }));
        let replayed = &restored.last_runs;
        let lost = restored.lost_runs.iter().filter(|cs| !replayed.contains_key(cs));
        self.notes.extend(lost.map(|cs| {
            format!(
                "the end of the last run in coordinate system {cs} is lost: inspect the machine before a \
                 start"
            )
        }));
        restored
    }

    /// Returns the stored positions of the motors.
    pub fn positions(&self) -> KeptPositions {
        KeptPositions::new(&self.image, &self.newest.rests)
    }

    /// Starts the threads that store changes, and publishes the warnings about the stored data.
    pub fn keep(
        self,
        shared: &Arc<SharedState>,
        mailboxes: &[Arc<Mailbox>],
        last_runs: LastRuns,
    ) -> Result<Keepers, StartError> {
        for note in &self.notes {
            warn_standing(shared, &STORE_DAMAGED, note);
        }
        for warning in self.newest.warnings() {
            warn_once(shared, &JOURNAL_DAMAGED, &warning);
        }
        let folder = self.folder;
        let views = mailboxes.iter();
        let source = Source {
            boot_id: shared.boot_id.clone(),
            clock: shared.clock.clone(),
            tables: Arc::clone(&shared.tables),
            hub: shared.hub.clone(),
            views: views
                .map(|mailbox| (mailbox.number, Arc::clone(&mailbox.view)))
                .collect(),
            settings: (shared.machine.coordinate_systems.iter())
                .map(|system| system.settings.clone())
                .collect(),
            last_runs,
            health: Arc::clone(&shared.health),
            runs: Arc::clone(&shared.runs),
            generations: self.held.generations,
        };
        let threads = &self.environment.threads;
        let state = StateWriterThread::start(folder.clone(), self.store, self.image, source, threads);
        let watch = DataWatch::start(&folder, Arc::clone(shared), threads);
        Ok(Keepers {
            _watch: watch.map_err(StartError::Thread)?,
            state: state.map_err(StartError::Thread)?,
            _journal: self.journal,
            _lock: self.lock,
        })
    }
}

/// Returns the notes for the operator about a damaged or unverified store.
fn notes(folder: &DiskPath, inspected: &InspectedStore, aside: Option<&DiskPath>) -> Vec<String> {
    let path = folder.join(STORE_FILE);
    let mut notes = Vec::new();
    match &inspected.condition {
        StoreCondition::Damaged(how) => {
            let aside = aside.map_or(String::new(), |aside| {
                format!("; the damaged store is kept as {}", aside.display())
            });
            let lost = match inspected.lost.len() {
                0 => "nothing is lost".to_owned(),
                lost => format!("{lost} values are lost, which alarm 406 lists"),
            };
            notes.push(format!("{}: {how}; {lost}{aside}", path.display()));
        }
        StoreCondition::New | StoreCondition::Whole => {}
    }
    if let Some(fault) = &inspected.sums_fault {
        notes.push(format!(
            "the checksum file of {}: {fault}; the values are kept, but not verified",
            path.display()
        ));
    }
    notes
}

fn refused(path: &DiskPath, error: io::Error) -> StartError {
    StartError::DataDir {
        path: path.display().to_string(),
        error,
    }
}

/// Creates the hardware. Simulated drives start at their stored positions.
pub(super) fn bring_up(
    factory: HardwareFactory,
    machine: &Machine,
    kept: &KeptPositions,
) -> Result<Hardware, StartError> {
    let systems = machine.coordinate_systems.iter();
    let mut settings: Vec<_> = systems.map(|system| system.settings.clone()).collect();
    for settings in &mut settings {
        kept.apply(settings);
    }
    let settings: Vec<_> = settings.iter().collect();
    factory(&settings).map_err(StartError::Hardware)
}

pub(super) fn new_boot_id() -> BootId {
    use std::hash::{BuildHasher, Hasher};
    // The standard library creates random hash keys for each process.
    let random = std::collections::hash_map::RandomState::new()
        .build_hasher()
        .finish();
    BootId(format!("{random:016x}"))
}

impl StartError {
    /// Returns an error for each program of the configuration that cannot be put into the store.
    pub fn of_unreadable_programs(machine: &Machine) -> Vec<Self> {
        let systems = machine.coordinate_systems.iter();
        let programs = systems.flat_map(|system| &system.programs);
        let unreadable = programs.filter_map(|(number, source)| {
            let ProgramSource::File(path) = source else {
                return None;
            };
            let error = check_readable(path).err()?;
            Some(Self::Program {
                number: *number,
                path: path.display().to_string(),
                error,
            })
        });
        unreadable.collect()
    }
}

/// Opened program store of a machine, and the findings in its folder.
pub(super) struct Programs {
    pub store: ProgramStore,
    pub findings: ProgramFindings,
    /// State word and reason with which all coordinate systems start.
    pub first_state: (Execution, Option<Reason>),
}

impl Programs {
    /// Opens the program store and puts the programs of the configuration into it. If the folder cannot be written, the
    /// start continues and `health` shows the reason.
    pub fn open(
        disk: &Disk,
        machine: &Machine,
        health: &Health,
        held: &HeldBack,
    ) -> Result<Self, StartError> {
        let mut store = machine.new_store();
        let (mut findings, mut reason) = (ProgramFindings::default(), Reason::NoProgram);
        if let Some(folder) = &machine.data_dir {
            let folder = disk.at(folder);
            let (programs, started) = (folder.join("programs"), folder.join(STARTED_FILE));
            let is_lost = !programs.exists().unwrap_or(true);
            let (found, opened) = store.open_folder(&programs, held);
            health.record_attempt(DataFolderPart::Programs, &opened);
            findings = found;
            findings.lost = (is_lost && started.exists().unwrap_or(false)).then_some(programs);
            reason = mark_started(&started);
        }
        for system in &machine.coordinate_systems {
            for (number, source) in &system.programs {
                let path = match source {
                    ProgramSource::File(path) => path.display().to_string(),
                    ProgramSource::Text(_) => "built in".to_owned(),
                };
                let put = put_program(&store, *number, source, system.dialect.name, health);
                let edit = put.map_err(|error| StartError::Program {
                    number: *number,
                    path,
                    error,
                })?;
                findings.edits.extend(edit);
            }
        }
        Ok(Self {
            store,
            findings,
            first_state: (Execution::Stopped, Some(reason)),
        })
    }
}

/// Reports the findings in the program folder to the operator, by warnings and in the journal.
pub(super) fn report_programs(findings: ProgramFindings, shared: &SharedState) {
    if let Some(text) = list(&findings.not_read) {
        warn_standing(shared, &NOT_READ, &text);
    }
    if let Some(folder) = &findings.lost {
        let text = format!(
            "{}: the folder was missing, and its programs are lost",
            folder.display()
        );
        warn_standing(shared, &STORE_DAMAGED, &text);
    }
    for edit in findings.edits {
        shared.record(0, Event::Program(edit));
    }
    for text in findings.changed {
        warn_changed(shared, &text);
    }
    if findings.without_sum > 0 {
        let text = format!(
            "{} programs had no checksum yet; their present texts are accepted",
            findings.without_sum
        );
        warn_once(shared, &STORE_DAMAGED, &text);
    }
    if let Some(fault) = &findings.folders_fault {
        let text = format!("programs/folders.json: {fault}; programs are in no folder");
        warn_standing(shared, &STORE_DAMAGED, &text);
    }
}

/// Puts a program of the configuration into the store, unless the store has a newer version. If the disk does not
/// accept the program, it is still available in memory. Returns the change, if any.
fn put_program(
    store: &ProgramStore,
    number: u16,
    source: &ProgramSource,
    dialect: &str,
    health: &Health,
) -> io::Result<Option<Edit>> {
    let in_store = store.get(number).is_some() || store.refuse_damaged(number).is_some();
    let (text, signature) = match source {
        ProgramSource::Text(_) if in_store => return Ok(None),
        ProgramSource::Text(text) => ((*text).to_owned(), None),
        ProgramSource::File(path) => {
            let written = std::fs::metadata(path)?.modified()?;
            if in_store && store.written_at(number).is_some_and(|stored| stored >= written) {
                return Ok(None);
            }
            (read_text(path)?, read_program_signature(path)?)
        }
    };
    let rules = store.rules_of(Some(dialect)).map_err(io::Error::other)?;
    let program = || StoredProgram::new(number, &text, rules).signed(signature, store.signers());
    store.check_room(number, text.len())?;
    let old = store.get(number).map(|program| program.checksum().to_owned());
    let written = store.put(program());
    health.record_attempt(DataFolderPart::Programs, &written);
    let is_unchanged = written.as_ref().is_ok_and(|check| check.unchanged);
    if written.is_err() {
        store.keep(program());
    }
    let new = store.get(number).map(|program| program.checksum().to_owned());
    let what = EditKind::Configuration;
    Ok((!is_unchanged).then_some(Edit {
        program: number,
        what,
        old,
        new,
    }))
}

/// Writes a file into the data folder that marks it as used. Returns `RESTARTED` if the file already existed.
fn mark_started(mark: &DiskPath) -> Reason {
    if mark.exists().unwrap_or(false) {
        tighten(mark);
        return Reason::Restarted;
    }
    let marked = write_whole(mark, b"A runtime has been started with this folder.\n");
    if let Err(error) = marked {
        tracing::warn!("{}: {error}", mark.display());
    }
    Reason::NoProgram
}
