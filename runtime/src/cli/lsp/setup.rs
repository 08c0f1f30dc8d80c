//! Selects the machine and the dialect for a program.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use tandem_interp::{Dialect, dialects};
use tandem_runtime::Machine;

use super::super::read_config;

/// File name of a configuration that is found automatically.
const CONFIG_NAME: &str = "tandem.toml";

/// Options of the command line, and the configurations that have already been read.
pub(super) struct Setup {
    config: Option<PathBuf>,
    dialect: Option<&'static Dialect>,
    known: BTreeMap<PathBuf, CachedConfig>,
}

/// The machine of a configuration file (`None` if the file cannot be read), and the time of the file's last
/// change.
struct CachedConfig {
    changed: Option<SystemTime>,
    machine: Option<Arc<Machine>>,
}

/// Machine and dialect for which a program is checked.
#[derive(Clone)]
pub(super) struct Target {
    pub dialect: &'static Dialect,
    pub machine: Option<Arc<Machine>>,
    /// Path of the machine's configuration.
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

    /// Returns the target of the program at this path. Also returns the problems of its configuration, if
    /// these were not reported before.
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
        let of_machine = || of_machine().unwrap_or_else(dialects::default_dialect);
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
        let known = CachedConfig {
            changed,
            machine: machine.clone(),
        };
        self.known.insert(config.to_owned(), known);
        (machine, wrong)
    }
}
