//! What is opened before a machine starts: its data folder, its program store and its hardware.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use plc_api::types::BootId;
use plc_api::types::state::{Execution, Reason};
use tandem_servo::{Hardware, HardwareFactory};

use super::StartError;
use crate::config::{Machine, ProgramSource};
use crate::coordinate_system::Mailbox;
use crate::persistence::journal_file::{JOURNAL_FOLDER, JournalThread, newest};
use crate::persistence::{
    Image, LastRuns, REPLAYED_LINES_MAX, Restored, Source, StateWriterThread, Store, replay_last_runs,
    restore,
};
use crate::program_store::{ProgramStore, check_readable, read_text};
use crate::shared::Shared;
use crate::tables::Tables;

/// What is kept in the data folder, opened.
pub(super) struct Data {
    path: PathBuf,
    store: Store,
    image: Image,
    pub journal: JournalThread,
}

impl Data {
    /// Opens the data folder, which is made if it is missing; no other runtime has it open then.
    pub fn open(machine: &Machine) -> Result<Option<Self>, StartError> {
        let Some(folder) = &machine.data_dir else {
            return Ok(None);
        };
        let path = folder.join("state.redb");
        let open = || {
            std::fs::create_dir_all(folder)?;
            let store = Store::open(&path)?;
            let image = store.load()?;
            let journal = JournalThread::start(&folder.join(JOURNAL_FOLDER))?;
            Ok((store, image, journal))
        };
        let (store, image, journal) = open().map_err(|error| refused(folder, error))?;
        Ok(Some(Self {
            path,
            store,
            image,
            journal,
        }))
    }

    /// What was kept, and what the journal adds to it, which is then kept, too.
    pub fn restore(&mut self, tables: &Tables) -> Result<Restored, StartError> {
        self.replay(tables).map_err(|error| refused(&self.path, error))
    }

    fn replay(&mut self, tables: &Tables) -> io::Result<Restored> {
        let mut restored = restore(tables, &self.image)?;
        let lines = newest(&self.path.with_file_name(JOURNAL_FOLDER), 0, REPLAYED_LINES_MAX)?;
        let change = replay_last_runs(tables.coordinate_systems(), &mut restored.last_runs, &lines);
        if !change.is_empty() {
            self.store.commit(&change)?;
            self.image.take_over(change);
        }
        Ok(restored)
    }

    /// Begins to keep what changes.
    pub fn keep(
        self,
        shared: &Arc<Shared>,
        mailboxes: &[Arc<Mailbox>],
        last_runs: LastRuns,
    ) -> Result<(StateWriterThread, JournalThread), StartError> {
        let warned = Arc::clone(shared);
        let views = mailboxes.iter();
        let source = Source {
            boot_id: shared.boot_id.clone(),
            clock: shared.clock.clone(),
            tables: Arc::clone(&shared.tables),
            hub: shared.hub.clone(),
            views: views
                .map(|mailbox| (mailbox.number, Arc::clone(&mailbox.view)))
                .collect(),
            last_runs,
            warn: Box::new(move |warning| {
                warned.raise(warning);
            }),
        };
        let thread = StateWriterThread::start(self.path, self.store, self.image, source);
        Ok((thread.map_err(StartError::Thread)?, self.journal))
    }
}

fn refused(path: &Path, error: io::Error) -> StartError {
    StartError::DataDir {
        path: path.display().to_string(),
        error,
    }
}

pub(super) fn bring_up(factory: HardwareFactory, machine: &Machine) -> Result<Hardware, StartError> {
    let systems = machine.coordinate_systems.iter();
    let settings: Vec<_> = systems.map(|system| &system.settings).collect();
    factory(&settings).map_err(StartError::Hardware)
}

pub(super) fn new_boot_id() -> BootId {
    use std::hash::{BuildHasher, Hasher};
    // The standard library's hash keys are random for each process.
    let random = std::collections::hash_map::RandomState::new()
        .build_hasher()
        .finish();
    BootId(format!("{random:016x}"))
}

impl Machine {
    /// The programs of the configuration that cannot be put into the store, each with why.
    pub fn unreadable_programs(&self) -> Vec<StartError> {
        let systems = self.coordinate_systems.iter();
        let programs = systems.flat_map(|system| &system.programs);
        let unreadable = programs.filter_map(|(number, source)| {
            let ProgramSource::File(path) = source else {
                return None;
            };
            let error = check_readable(path).err()?;
            Some(StartError::Program {
                number: *number,
                path: path.display().to_string(),
                error,
            })
        });
        unreadable.collect()
    }
}

/// Opens the store and puts the configuration's programs into it; gives the state in which coordinate systems begin.
pub(super) fn open_store(
    machine: &Machine,
) -> Result<(ProgramStore, (Execution, Option<Reason>)), StartError> {
    let (store, reason) = match &machine.data_dir {
        None => (ProgramStore::in_memory(machine.text_rules()), Reason::NoProgram),
        Some(folder) => {
            let opened = ProgramStore::open(&folder.join("programs"), machine.text_rules());
            let store = opened.map_err(|error| refused(folder, error))?;
            let reason = mark_started(&folder.join("started")).map_err(|error| refused(folder, error))?;
            (store, reason)
        }
    };
    for system in &machine.coordinate_systems {
        for (number, source) in &system.programs {
            let path = match source {
                ProgramSource::File(path) => path.display().to_string(),
                ProgramSource::Text(_) => "built in".to_owned(),
            };
            put_program(&store, *number, source).map_err(|error| StartError::Program {
                number: *number,
                path,
                error,
            })?;
        }
    }
    Ok((store, (Execution::Stopped, Some(reason))))
}

/// The newer of the two wins: the configuration's file, or what was written to the store since.
fn put_program(store: &ProgramStore, number: u16, source: &ProgramSource) -> io::Result<()> {
    let in_store = store.get(number).is_some();
    match source {
        ProgramSource::Text(_) if in_store => {}
        ProgramSource::Text(text) => {
            store.write(number, text)?;
        }
        ProgramSource::File(path) => {
            let written = std::fs::metadata(path)?.modified()?;
            if !in_store || store.written_at(number).is_none_or(|stored| stored < written) {
                store.write(number, &read_text(path)?)?;
            }
        }
    }
    Ok(())
}

/// Leaves a mark in the data folder; the reason says whether it was there before.
fn mark_started(mark: &Path) -> io::Result<Reason> {
    if mark.exists() {
        return Ok(Reason::Restarted);
    }
    std::fs::write(mark, "A runtime has been started with this folder.\n")?;
    Ok(Reason::NoProgram)
}
