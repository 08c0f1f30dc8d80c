//! A machine as its configuration describes it: the settings for the stages.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use plc_protocol::lock_input::LockRules;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::alarm_text::AlarmText;
use plc_protocol::types::data::VariableArea;
use plc_protocol::types::io::IoDeclarations;
use plc_protocol::types::m_code::MCodeDeclaration;
use plc_protocol::types::machine::{Identification, ServedMCodesFile};
use plc_protocol::types::output::{Redelivery, Timing};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tandem_interp::dialect::{MCodeTime, OutputDefault};
use tandem_interp::{Dialect, dialects};
use tandem_model::flow::Output;
use tandem_model::settings::{CoordinateSystemSettings, MotorSettings, NcOptions, Tool, WorkOffsets};
use tandem_store::data_folder::StoredMachine;
use tandem_store::program_store::{ProgramStore, Signers, TextRules};
use tandem_store::tables::TableSettings;

use crate::declared::SourcedDeclaration;

/// M codes that the stock sequence program serves in a coordinate system with a spindle.
const SPINDLE_M_CODES: [u16; 4] = [3, 4, 5, 19];

/// A machine as its configuration describes it.
#[derive(Debug, Clone)]
pub struct Machine {
    /// Name of the machine, used as MQTT topic level.
    pub name: String,
    /// Identification shown on the nameplate.
    pub identification: Identification,
    /// Servo period, microseconds.
    pub servo_period_us: u64,
    /// Maximum delay of the start of a servo cycle while motors move, ms.
    pub servo_late_ms: u64,
    /// Age at which a presence of the runtime expires, ms.
    pub presence_expires_ms: u64,
    /// Address under which other computers reach the HMI of the machine.
    pub public_url: Option<String>,
    /// Folder for persistent data; `None` if no data are stored.
    pub data_dir: Option<PathBuf>,
    /// Motors in ascending order of their numbers.
    pub motors: Vec<MotorSettings>,
    /// Coordinate systems in ascending order of their numbers.
    pub coordinate_systems: Vec<ConfiguredSystem>,
    /// Tools by number (D17).
    pub tools: BTreeMap<u16, Tool>,
    /// M codes that have settings.
    pub m_codes: BTreeMap<u16, MCodeSettings>,
    /// Texts for the alarms of sequence programs, by their codes.
    pub alarms: BTreeMap<u16, AlarmText>,
    /// Inputs and outputs of the plant.
    pub io: IoDeclarations,
    /// Time in which a handler may return after it was lost without an announcement, s.
    pub handler_grace_s: f64,
    /// Variables that are published when they change, as ranges (first, length); at most 1024 variables for each area.
    pub published: BTreeMap<VariableArea, Vec<(u32, u32)>>,
    /// Content of the file that describes the M codes of the sequence programs; `None` if the configuration
    /// names no file.
    pub served: Option<ServedMCodesFile>,
    /// Reaction to an output of an M code without settings if no handler is registered for it.
    pub unhandled: UnhandledReaction,
    /// True if a program that waits for an output is held while the connection to the MQTT broker is lost.
    pub hold_on_bus_loss: bool,
    /// Signers whose programs may be loaded and called; if there are none, programs need no signature. A
    /// simulation does not check signatures.
    pub signers: Signers,
    /// Maximum size of the texts of all programs together, bytes.
    pub programs_bytes_max: usize,
    /// True if the machine accepts manual data input (MDI).
    pub takes_mdi: bool,
    /// Maximum length of a jog that needs no refresh, mm or degrees.
    pub jog_step_max: f64,
}

/// A coordinate system as the configuration describes it.
#[derive(Debug, Clone)]
pub struct ConfiguredSystem {
    /// Settings for the stages.
    pub settings: CoordinateSystemSettings,
    /// NC dialect of the programs that this coordinate system runs.
    pub dialect: &'static Dialect,
    /// Work offsets G54 to G59.
    pub work_offsets: WorkOffsets,
    /// Programs to load into the program store, by number.
    pub programs: BTreeMap<u16, ProgramSource>,
    /// Maximum number of profiles that wait for the servo cycle.
    pub pre_read_blocks: usize,
    /// Maximum number of outputs that are pending at the same time.
    pub open_outputs_max: usize,
    /// Values of the interlock and the start lock while the owners of their sources are offline.
    pub locks: [LockRules; 2],
}

impl ConfiguredSystem {
    /// Returns the time at which an output is issued, relative to the motion, if its M code has no setting.
    pub fn default_timing(&self) -> Timing {
        match self.dialect.policy.output {
            OutputDefault::AfterMotion => Timing::AfterMotion,
            OutputDefault::WithMotion => Timing::WithMotion,
        }
    }

    /// Returns the time at which an output is issued, relative to the motion. In a dialect with the default
    /// `after_motion`, outputs with parameters use it (D30). Otherwise the M code's setting applies, or the
    /// dialect's default.
    pub fn timing(&self, output: &Output, settings: Option<&MCodeSettings>) -> Timing {
        let default = self.default_timing();
        match default {
            Timing::AfterMotion if output.has_params() => Timing::AfterMotion,
            _ => settings.and_then(|settings| settings.timing).unwrap_or(default),
        }
    }

    /// Returns true if an output is issued when its block is interpreted. If the dialect issues M codes
    /// before the motion of their block, the output waits until the motion reaches the block. In cutter
    /// compensation this is not possible, so the output does not wait.
    pub fn is_issued_at_once(
        &self,
        output: &Output,
        settings: Option<&MCodeSettings>,
        is_compensating: bool,
    ) -> bool {
        let waits = self.dialect.policy.m_code == MCodeTime::BeforeMotion;
        self.timing(output, settings) == Timing::WithMotion && (!waits || is_compensating)
    }

    /// Returns the rules for checking a program text for this coordinate system.
    pub fn text_rules(&self) -> TextRules {
        TextRules {
            dialect: self.dialect,
            arc_radius_tolerance_mm: self.settings.motion.arc_radius_tolerance_mm,
            options: self.settings.nc,
        }
    }
}

/// Source of a program.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ProgramSource {
    /// A file with the text.
    File(PathBuf),
    /// A text that is part of the configuration.
    Text(&'static str),
}

/// Settings of one M code.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MCodeSettings {
    /// Time at which the output is issued, relative to the motion; default: the time of the dialect.
    pub timing: Option<Timing>,
    /// Reaction if no handler is registered; default: the reaction for M codes without settings.
    pub unhandled: Option<UnhandledReaction>,
    /// Time limit from the output to the reset, ms.
    pub timeout_ms: Option<u64>,
    /// Action for an output that was claimed when its handler was lost.
    pub redelivery: Option<Redelivery>,
    /// State that is shown while the program waits for this M code.
    pub wait_state: Option<String>,
    /// Action of the stock sequence program for this M code.
    pub stock: Option<Stock>,
    /// Time that the stock sequence program needs for this M code, s.
    pub simulated_s: f64,
    /// Group of M codes; a start from a line issues the newest one of each group. The configuration page
    /// describes the default.
    pub restore_group: Option<String>,
    /// Order in which a start from a line issues these M codes, lowest first. The configuration page
    /// describes the default.
    pub restore_order: Option<u16>,
    /// Declared name and parameters of the M code.
    pub declared: Option<MCodeDeclaration>,
}

/// Reaction to an output for which no handler is registered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum UnhandledReaction {
    /// Raises an alarm.
    #[default]
    Alarm,
    /// Makes the program wait.
    Wait,
    /// Lets the stock sequence program reset the output.
    AutoReset,
}

/// Action of the stock sequence program for an M code.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Stock {
    /// Selects the tool of parameter VA.
    SelectTool,
}

impl Machine {
    /// Returns the servo period.
    pub fn servo_period(&self) -> Duration {
        Duration::from_micros(self.servo_period_us)
    }

    /// Turns off all interlocks and start locks, because no sequence program runs that could set them.
    pub fn forget_locks(&mut self) {
        for system in &mut self.coordinate_systems {
            system.locks = Default::default();
        }
    }

    /// Returns the maximum number of consecutive servo cycles that may be missed while motors move.
    pub fn missed_cycles_max(&self) -> u64 {
        (self.servo_late_ms * 1000).div_ceil(self.servo_period_us) - 1
    }

    /// Returns notes on motor settings that have less effect than a user may expect, as text.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        for motor in &self.motors {
            let place = format!("[[motor]] number = {}", motor.number);
            if !self.moves(motor.number) {
                notes.push(format!("{place}: no coordinate system has it"));
            }
            if let Some(jerk) = motor.max_jerk {
                notes.push(format!(
                    "{place}: max_jerk = {jerk} bounds G00, G28, G30, G31 and, with G500, feed motion; with G501, feed motion has the jerk of ta, td and ts"
                ));
            }
            let velocity = ("max_velocity", motor.max_velocity);
            let acceleration = ("max_acceleration", motor.max_acceleration);
            for (key, value, (limit, most)) in [
                ("rapid_velocity", motor.rapid_velocity, velocity),
                ("skip_velocity", motor.skip_velocity, velocity),
                ("rapid_acceleration", motor.rapid_acceleration, acceleration),
            ] {
                if value > most {
                    notes.push(format!(
                        "{place}: {key} = {value} is above {limit} = {most}, which bounds blocks with F alone"
                    ));
                }
            }
        }
        notes
    }

    /// Returns the declarations of M codes for a coordinate system, from the configuration and from the file
    /// that describes the sequence programs.
    pub fn declared(&self, cs: CoordinateSystemNumber) -> Vec<SourcedDeclaration> {
        let declared = self
            .m_codes
            .values()
            .filter_map(|settings| settings.declared.clone());
        let served = self.served.iter().flat_map(|served| &served.serves);
        let served = served.filter(|one| one.is_in(cs)).map(|one| SourcedDeclaration {
            by: one.by(),
            declaration: one.declaration(),
        });
        declared
            .map(SourcedDeclaration::in_config)
            .chain(served)
            .collect()
    }

    /// Returns the declarations of M codes of all coordinate systems, without duplicates.
    pub fn declared_anywhere(&self) -> Vec<SourcedDeclaration> {
        let mut all: Vec<SourcedDeclaration> = Vec::new();
        for system in &self.coordinate_systems {
            for one in self.declared(system.settings.number) {
                if !all.contains(&one) {
                    all.push(one);
                }
            }
        }
        all
    }

    /// Returns one line for each M code that is known while no handler is online: its declaration and the
    /// origin of the declaration.
    pub fn served_text(&self) -> Vec<String> {
        let served = self.served.iter().flat_map(|served| &served.serves);
        let served = served.map(|one| format!("{}: served by {}", one.declaration().text(), one.by()));
        let declared = self
            .m_codes
            .values()
            .filter_map(|settings| settings.declared.as_ref());
        let declared =
            declared.map(|declared| format!("{}: declared in [m_code.{}]", declared.text(), declared.m));
        declared.chain(served).collect()
    }

    /// Returns true if the file that describes the sequence programs shows that an M code raises an alarm.
    /// Returns false if the configuration names no such file.
    pub fn is_unserved(&self, system: &ConfiguredSystem, m: u16) -> bool {
        let settings = self.m_codes.get(&m);
        let unhandled = settings.and_then(|settings| settings.unhandled);
        let is_stock = settings.is_some_and(|settings| settings.stock.is_some())
            || Self::stock_m_codes(&system.settings).contains(&m);
        let cs = system.settings.number;
        self.served.as_ref().is_some_and(|served| {
            let mut served = served.serves.iter();
            !is_stock
                && unhandled.unwrap_or(self.unhandled) == UnhandledReaction::Alarm
                && !served.any(|one| one.m == m && one.is_in(cs))
        })
    }

    /// Returns the M codes that the stock sequence program serves without settings: those of the spindle if
    /// the coordinate system has one, otherwise none.
    pub fn stock_m_codes(settings: &CoordinateSystemSettings) -> &'static [u16] {
        if settings.spindle.is_some() {
            &SPINDLE_M_CODES
        } else {
            &[]
        }
    }

    /// Returns the rules for checking programs whose coordinate system is not known yet.
    pub fn text_rules(&self) -> TextRules {
        self.text_rules_of(self.dialect())
    }

    /// Returns the rules for checking programs of a dialect, with the widest limits of the coordinate systems
    /// with this dialect.
    pub fn text_rules_of(&self, dialect: &'static Dialect) -> TextRules {
        let systems = || {
            let systems = self.coordinate_systems.iter();
            systems.filter(|system| system.dialect.name == dialect.name)
        };
        let tolerances = systems().map(|system| system.settings.motion.arc_radius_tolerance_mm);
        TextRules {
            dialect,
            arc_radius_tolerance_mm: tolerances.reduce(f64::max).unwrap_or(0.01),
            options: systems()
                .next()
                .map_or_else(NcOptions::default, |system| system.settings.nc),
        }
    }

    /// Creates an empty program store in memory.
    pub fn new_store(&self) -> ProgramStore {
        let all = dialects::names().filter_map(|name| dialects::find(name).ok());
        let rules = all.map(|dialect| self.text_rules_of(dialect)).collect();
        let store = ProgramStore::in_memory(self.text_rules()).with_room(self.programs_bytes_max);
        store.for_dialects(rules, self.is_mixed(), self.signers.clone())
    }

    /// Returns true if the coordinate systems have different dialects.
    pub fn is_mixed(&self) -> bool {
        let mut systems = self.coordinate_systems.iter();
        systems.any(|system| system.dialect.name != self.dialect().name)
    }

    /// Returns the settings of the machine that its tables depend on.
    pub fn table_settings(&self) -> TableSettings {
        let systems = || self.coordinate_systems.iter();
        let number = |system: &ConfiguredSystem| system.settings.number;
        TableSettings {
            tools: self.tools.clone(),
            axes: systems()
                .map(|system| (number(system), system.settings.axes()))
                .collect(),
            work_offsets: systems()
                .map(|system| (number(system), system.work_offsets))
                .collect(),
        }
    }

    /// Returns the settings of the machine that its stored data depend on.
    pub fn stored(&self) -> StoredMachine {
        let outputs = self.io.points().map(|(point, _)| point);
        let kept = outputs.filter(|point| self.io.keeps_last(point));
        StoredMachine {
            name: self.name.clone(),
            data_dir: self.data_dir.clone(),
            tables: self.table_settings(),
            kept_outputs: kept.map(|point| point.to_string()).collect(),
            dialect: self.dialect().name,
            is_mixed: self.is_mixed(),
            programs_bytes_max: self.programs_bytes_max,
            signers: self.signers.clone(),
        }
    }

    /// Returns true if a motor is an axis or the spindle of a coordinate system.
    fn moves(&self, motor: u16) -> bool {
        let systems = self.coordinate_systems.iter().map(|system| &system.settings);
        let motors = systems.flat_map(|settings| settings.motors.iter().chain([&settings.spindle]));
        motors.flatten().any(|of_system| of_system.number == motor)
    }

    /// Returns the coordinate system whose `programs` name this file; `None` if no coordinate system names
    /// it.
    pub fn system_of_program(&self, file: &Path) -> Option<&ConfiguredSystem> {
        let file = file.canonicalize().ok()?;
        let is_file = |source: &ProgramSource| match source {
            ProgramSource::File(path) => path.canonicalize().is_ok_and(|path| path == file),
            ProgramSource::Text(_) => false,
        };
        let mut systems = self.coordinate_systems.iter();
        systems.find(|system| system.programs.values().any(is_file))
    }

    /// Returns the NC dialect of the coordinate system with the lowest number, which is the default for
    /// programs.
    pub fn dialect(&self) -> &'static Dialect {
        self.coordinate_systems
            .first()
            .map_or_else(dialects::default_dialect, |system| system.dialect)
    }
}
