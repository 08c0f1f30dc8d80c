//! A machine as configured: the settings for the stages.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use plc_api::lock_input::LockRules;
use plc_api::types::CoordinateSystemNumber;
use plc_api::types::alarm_text::AlarmText;
use plc_api::types::data::VariableArea;
use plc_api::types::io::IoDeclarations;
use plc_api::types::m_code::MCodeDeclaration;
use plc_api::types::machine::{Identification, ServedMCodesFile};
use plc_api::types::output::{Redelivery, Timing};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tandem_interp::dialect::{MCodeTime, OutputDefault};
use tandem_interp::{Dialect, dialects};
use tandem_model::flow::Output;
use tandem_model::settings::{CoordinateSystemSettings, MotorSettings, NcOptions, Tool, WorkOffsets};

use crate::declared::SourcedDeclaration;
use crate::program_store::{ProgramStore, Signers, TextRules};

/// M codes that the stock sequence program serves if there is a spindle.
const SPINDLE_M_CODES: [u16; 4] = [3, 4, 5, 19];

/// A machine as configured.
#[derive(Debug, Clone)]
pub struct Machine {
    /// Name of the machine, used as MQTT topic level.
    pub name: String,
    /// Identification shown on the nameplate.
    pub identification: Identification,
    /// Servo period, microseconds.
    pub servo_period_us: u64,
    /// Greatest delay of the start of a servo cycle in motion, ms.
    pub servo_late_ms: u64,
    /// Age at which a presence of the runtime expires, ms.
    pub presence_expires_ms: u64,
    /// Address under which other computers reach its HMI.
    pub public_url: Option<String>,
    /// Folder for persistent data; without it, no data are stored.
    pub data_dir: Option<PathBuf>,
    /// Motors, ascending by number.
    pub motors: Vec<MotorSettings>,
    /// Coordinate systems, ascending by number.
    pub coordinate_systems: Vec<ConfiguredSystem>,
    /// Tools by number (D17).
    pub tools: BTreeMap<u16, Tool>,
    /// M codes that have settings.
    pub m_codes: BTreeMap<u16, MCodeSettings>,
    /// Texts for the alarms of sequence programs, by their codes.
    pub alarms: BTreeMap<u16, AlarmText>,
    /// Inputs and outputs of the plant.
    pub io: IoDeclarations,
    /// Time in which a handler that was lost without an announcement may return, s.
    pub handler_grace_s: f64,
    /// Variables that are published when they change, as ranges (first, length); at most 1024 variables for each area.
    pub published: BTreeMap<VariableArea, Vec<(u32, u32)>>,
    /// Content of the file of the sequence side, if there is one.
    pub served: Option<ServedMCodesFile>,
    /// Reaction to an output of an M code without settings if no handler is registered for it.
    pub unhandled: UnhandledReaction,
    /// A program that waits for an output is held while the connection to the MQTT broker is lost.
    pub hold_on_bus_loss: bool,
    /// Signers whose programs may be loaded and called; empty: no signature is needed. A simulation does not check
    /// signatures.
    pub signers: Signers,
    /// Largest size of the texts of all programs together, bytes.
    pub programs_bytes_max: usize,
    /// Manual data input is accepted.
    pub takes_mdi: bool,
    /// The longest jog that needs no refresh, mm or degrees.
    pub jog_step_max: f64,
}

/// A coordinate system as configured.
#[derive(Debug, Clone)]
pub struct ConfiguredSystem {
    /// Settings for the stages.
    pub settings: CoordinateSystemSettings,
    /// NC dialect of the programs that it runs.
    pub dialect: &'static Dialect,
    /// G54 to G59.
    pub work_offsets: WorkOffsets,
    /// Programs to load into the store.
    pub programs: BTreeMap<u16, ProgramSource>,
    /// Largest number of profiles that wait for the servo cycle.
    pub pre_read_blocks: usize,
    /// Largest number of outputs that are pending at the same time.
    pub open_outputs_max: usize,
    /// Values of the interlock and the start lock while the owners of their sources are offline.
    pub locks: [LockRules; 2],
}

impl ConfiguredSystem {
    /// Returns the time at which an output is issued if its M code has no setting.
    pub fn default_timing(&self) -> Timing {
        match self.dialect.policy.output {
            OutputDefault::AfterMotion => Timing::AfterMotion,
            OutputDefault::WithMotion => Timing::WithMotion,
        }
    }

    /// Returns the time at which an output is issued: from the settings of its M code, `after_motion` if it has
    /// parameters (D30), otherwise from the dialect.
    pub fn timing(&self, output: &Output, settings: Option<&MCodeSettings>) -> Timing {
        let default = self.default_timing();
        match default {
            Timing::AfterMotion if output.has_params() => Timing::AfterMotion,
            _ => settings.and_then(|settings| settings.timing).unwrap_or(default),
        }
    }

    /// Returns true for an output that is issued when its block is interpreted. In a dialect whose M codes act before
    /// the motion of their block, this happens when the motion has reached the block; outputs in cutter compensation
    /// cannot wait for that.
    pub fn is_issued_at_once(
        &self,
        output: &Output,
        settings: Option<&MCodeSettings>,
        is_compensating: bool,
    ) -> bool {
        let waits = self.dialect.policy.m_code == MCodeTime::BeforeMotion;
        self.timing(output, settings) == Timing::WithMotion && (!waits || is_compensating)
    }

    /// Returns the rules for checking a text for this coordinate system.
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
    /// A file.
    File(PathBuf),
    /// Text that is part of the configuration.
    Text(&'static str),
}

/// Settings of one M code.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MCodeSettings {
    /// Time of the output; default: that of the dialect.
    pub timing: Option<Timing>,
    /// Reaction if no handler is registered; default: that of M codes without settings.
    pub unhandled: Option<UnhandledReaction>,
    /// Time limit of the reset, ms.
    pub timeout_ms: Option<u64>,
    /// Action for an output that was claimed when its handler was lost.
    pub redelivery: Option<Redelivery>,
    /// State shown while the program waits for it.
    pub wait_state: Option<String>,
    /// Action of the stock sequence program.
    pub stock: Option<Stock>,
    /// Time that the stock sequence program takes, s.
    pub simulated_s: f64,
    /// Group of which a start from a line issues the newest M code; the configuration page describes the default.
    pub restore_group: Option<String>,
    /// Position among these outputs; the configuration page describes the default.
    pub restore_order: Option<u16>,
    /// Its name and its parameters.
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
    /// Lets the stock sequence program reset it.
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

    /// Turns all interlocks and start locks off, because no sequence program is running that could set them.
    pub fn forget_locks(&mut self) {
        for system in &mut self.coordinate_systems {
            system.locks = Default::default();
        }
    }

    /// Returns the number of servo cycles that may be missed in motion.
    pub(crate) fn missed_cycles_max(&self) -> u64 {
        (self.servo_late_ms * 1000).div_ceil(self.servo_period_us) - 1
    }

    /// Returns notes on motor settings that have less effect than expected, as text for people.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        for motor in &self.motors {
            let place = format!("[[motor]] number = {}", motor.number);
            if !self.moves(motor.number) {
                notes.push(format!("{place}: no coordinate system has it"));
            }
            if let Some(jerk) = motor.max_jerk {
                notes.push(format!(
                    "{place}: max_jerk = {jerk} bounds G00, G28, G30, G31 and, with G500, long lines and arcs and the ramps between them; elsewhere F has the jerk of ta, td and ts, or steps within max_acceleration"
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

    /// Returns the declarations of M codes of a coordinate system, from the configuration and the file of the sequence
    /// side.
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

    /// Returns one line for each M code that is known without an online handler: its declaration and its origin.
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

    /// Returns true for an M code that raises an alarm according to the file of the sequence side; false without this
    /// file.
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

    /// Returns the M codes that the stock sequence program serves without settings: those of the spindle, if there is
    /// one.
    pub fn stock_m_codes(settings: &CoordinateSystemSettings) -> &'static [u16] {
        if settings.spindle.is_some() {
            &SPINDLE_M_CODES
        } else {
            &[]
        }
    }

    /// Returns the rules for checking programs before their coordinate system is known.
    pub fn text_rules(&self) -> TextRules {
        self.text_rules_of(self.dialect())
    }

    /// Returns these rules for a dialect, with the widest limits of its coordinate systems.
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
    pub(crate) fn new_store(&self) -> ProgramStore {
        let all = dialects::names().filter_map(|name| dialects::find(name).ok());
        let rules = all.map(|dialect| self.text_rules_of(dialect)).collect();
        let store = ProgramStore::in_memory(self.text_rules()).with_room(self.programs_bytes_max);
        store.for_dialects(rules, self.is_mixed(), self.signers.clone())
    }

    /// Returns true if coordinate systems have different dialects.
    pub fn is_mixed(&self) -> bool {
        let mut systems = self.coordinate_systems.iter();
        systems.any(|system| system.dialect.name != self.dialect().name)
    }

    /// Returns true for a motor that is an axis or the spindle of a coordinate system.
    fn moves(&self, motor: u16) -> bool {
        let systems = self.coordinate_systems.iter().map(|system| &system.settings);
        let motors = systems.flat_map(|settings| settings.motors.iter().chain([&settings.spindle]));
        motors.flatten().any(|of_system| of_system.number == motor)
    }

    /// Returns the coordinate system whose `programs` name this file, or `None`.
    pub fn system_of_program(&self, file: &Path) -> Option<&ConfiguredSystem> {
        let file = file.canonicalize().ok()?;
        let is_file = |source: &ProgramSource| match source {
            ProgramSource::File(path) => path.canonicalize().is_ok_and(|path| path == file),
            ProgramSource::Text(_) => false,
        };
        let mut systems = self.coordinate_systems.iter();
        systems.find(|system| system.programs.values().any(is_file))
    }

    /// Returns the NC dialect of the lowest coordinate system: the default for programs without other information.
    pub fn dialect(&self) -> &'static Dialect {
        self.coordinate_systems
            .first()
            .map_or_else(dialects::default_dialect, |system| system.dialect)
    }
}
