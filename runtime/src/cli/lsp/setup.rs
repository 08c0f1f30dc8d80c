//! Which machine and dialect a program is for.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use tandem_interp::{Dialect, dialects};
use tandem_runtime::Machine;

use super::super::read_config;

/// The name of a configuration that is found by itself.
const CONFIG_NAME: &str = "tandem.toml";

/// What the command line says, and the configurations that have been read.
pub(super) struct Setup {
    config: Option<PathBuf>,
    dialect: Option<&'static Dialect>,
    known: BTreeMap<PathBuf, Known>,
}

/// A configuration as it was at a time; `None`: it cannot be read.
struct Known {
    changed: Option<SystemTime>,
    machine: Option<Arc<Machine>>,
}

/// What a program is for.
#[derive(Clone)]
pub(super) struct Target {
    pub dialect: &'static Dialect,
    pub machine: Option<Arc<Machine>>,
    /// The configuration of the machine.
    pub config: Option<PathBuf>,
}

impl Setup {
    pub fn new(config: Option<PathBuf>, dialect: Option<&'static Dialect>) -> Self {
        Self {
            config,
            dialect,
            known: BTreeMap::new(),
        }
    }

    /// What the program of this path is for, and what is wrong with its configuration where that has not been said.
    pub fn target(&mut self, program: &Path) -> (Target, Option<String>) {
        let config = self.config.clone().or_else(|| {
            let folders = program.ancestors().skip(1);
            folders
                .map(|folder| folder.join(CONFIG_NAME))
                .find(|path| path.is_file())
        });
        let (machine, wrong) = config
            .as_ref()
            .map_or((None, None), |config| self.machine(config));
        let of_machine = || {
            let machine = machine.as_deref()?;
            let assigned = machine.system_of_program(program);
            Some(assigned.map_or_else(|| machine.dialect(), |system| system.dialect))
        };
        let of_machine = || of_machine().unwrap_or_else(dialects::nj);
        let dialect = self.dialect.unwrap_or_else(of_machine);
        let config = config.filter(|_| machine.is_some());
        (
            Target {
                dialect,
                machine,
                config,
            },
            wrong,
        )
    }

    fn machine(&mut self, config: &Path) -> (Option<Arc<Machine>>, Option<String>) {
        let changed = std::fs::metadata(config).and_then(|found| found.modified()).ok();
        if let Some(known) = self.known.get(config).filter(|known| known.changed == changed) {
            return (known.machine.clone(), None);
        }
        let (machine, wrong) = match read_config(Some(config)) {
            Ok((_, machine)) => (Some(Arc::new(machine)), None),
            Err(error) => (None, Some(format!("{error:#}"))),
        };
        let known = Known {
            changed,
            machine: machine.clone(),
        };
        self.known.insert(config.to_owned(), known);
        (machine, wrong)
    }
}
