//! A machine as configured: the settings that the stages take.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use plc_api::lock_input::LockRules;
use plc_api::types::CoordinateSystemNumber;
use plc_api::types::alarm_text::AlarmText;
use plc_api::types::data::VariableArea;
use plc_api::types::io::IoDeclarations;
use plc_api::types::m_code::MCodeDeclaration;
use plc_api::types::machine::{Identification, Served};
use plc_api::types::output::{Redelivery, Timing};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tandem_interp::dialect::{MCodeTime, OutputDefault};
use tandem_interp::{Dialect, dialects};
use tandem_model::flow::Output;
use tandem_model::settings::{CoordinateSystemSettings, MotorSettings, NcOptions, Tool, WorkOffsets};

use crate::declared::Declared;
use crate::program_store::{ProgramStore, Signers, TextRules};

/// M codes that the stock sequence program serves where there is a spindle.
const SPINDLE_M_CODES: [u16; 4] = [3, 4, 5, 19];

/// A machine as configured.
#[derive(Debug, Clone)]
pub struct Machine {
    /// MQTT topic level.
    pub name: String,
    /// What its nameplate says.
    pub identification: Identification,
    /// Servo period, microseconds.
    pub servo_period_us: u64,
    /// How late a servo cycle may begin in motion, ms.
    pub servo_late_ms: u64,
    /// How old a presence of the runtime may become, ms.
    pub presence_expires_ms: u64,
    /// Address of its HMI as others reach it.
    pub public_url: Option<String>,
    /// Folder of what is kept; `None`: nothing is kept.
    pub data_dir: Option<PathBuf>,
    /// Motors, ascending by number.
    pub motors: Vec<MotorSettings>,
    /// Coordinate systems, ascending by number.
    pub coordinate_systems: Vec<CoordinateSystem>,
    /// Tools by number (D17).
    pub tools: BTreeMap<u16, Tool>,
    /// M codes that have settings.
    pub m_codes: BTreeMap<u16, MCodeSettings>,
    /// What is said of alarms of sequence programs, by their codes.
    pub alarms: BTreeMap<u16, AlarmText>,
    /// Inputs and outputs of the plant.
    pub io: IoDeclarations,
    /// Time in which a handler may come back that left without an announcement, s.
    pub handler_grace_s: f64,
    /// Variables that are published when they change: the first of each range, and how many, 1024 of an area in all.
    pub published: BTreeMap<VariableArea, Vec<(u32, u32)>>,
    /// What the file of the sequence side says that it serves; none: there is no file.
    pub served: Option<Served>,
    /// What happens to an output of an M code without settings that no handler is registered for.
    pub unhandled: Unhandled,
    /// A program that waits for an output is held while the connection to the MQTT broker is lost.
    pub hold_on_bus_loss: bool,
    /// Whose programs are loaded and called; none: all are. A simulation does not look.
    pub signers: Signers,
    /// Bytes of the texts of all programs together.
    pub programs_bytes_max: usize,
    /// Manual data input is taken.
    pub takes_mdi: bool,
    /// The longest jog that needs no refresh, mm or degrees.
    pub jog_step_max: f64,
}

/// A coordinate system as configured.
#[derive(Debug, Clone)]
pub struct CoordinateSystem {
    /// What the stages need.
    pub settings: CoordinateSystemSettings,
    /// NC dialect of the programs that it runs.
    pub dialect: &'static Dialect,
    /// G54 to G59.
    pub work_offsets: WorkOffsets,
    /// Programs to put into the store.
    pub programs: BTreeMap<u16, ProgramSource>,
    /// Profiles that wait for the servo cycle at the most.
    pub pre_read_blocks: usize,
    /// Outputs open at the same time.
    pub open_outputs_max: usize,
    /// Interlock and start lock: what they are while owners of their sources are not there.
    pub locks: [LockRules; 2],
}

impl CoordinateSystem {
    /// When an output is made whose M code has no setting.
    pub fn default_timing(&self) -> Timing {
        match self.dialect.policy.output {
            OutputDefault::AfterMotion => Timing::AfterMotion,
            OutputDefault::WithMotion => Timing::WithMotion,
        }
    }

    /// When an output is made: as the settings of its M code say, and with parameters `after_motion` (D30), or as the dialect
    /// says.
    pub fn timing(&self, output: &Output, settings: Option<&MCodeSettings>) -> Timing {
        let default = self.default_timing();
        match default {
            Timing::AfterMotion if output.has_params() => Timing::AfterMotion,
            _ => settings.and_then(|settings| settings.timing).unwrap_or(default),
        }
    }

    /// True for an output that is made when its block is interpreted. In a dialect whose M codes act before the motion of
    /// their block that is when the motion has come to it, except for cutter compensation, which cannot wait.
    pub fn is_put_out_at_once(
        &self,
        output: &Output,
        settings: Option<&MCodeSettings>,
        is_compensating: bool,
    ) -> bool {
        let waits = self.dialect.policy.m_code == MCodeTime::BeforeMotion;
        self.timing(output, settings) == Timing::WithMotion && (!waits || is_compensating)
    }

    /// The rules for checking a text for this coordinate system.
    pub fn text_rules(&self) -> TextRules {
        TextRules {
            dialect: self.dialect,
            arc_radius_tolerance_mm: self.settings.motion.arc_radius_tolerance_mm,
            options: self.settings.nc,
        }
    }
}

/// Where a program comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ProgramSource {
    /// A file.
    File(PathBuf),
    /// Text that comes with the configuration.
    Text(&'static str),
}

/// Settings of one M code.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MCodeSettings {
    /// When it is output; `None`: as the dialect says.
    pub timing: Option<Timing>,
    /// What happens when no handler is registered; `None`: as for M codes without settings.
    pub unhandled: Option<Unhandled>,
    /// Time limit of the reset, ms.
    pub timeout_ms: Option<u64>,
    /// What happens with an output that was claimed when its handler was lost.
    pub redelivery: Option<Redelivery>,
    /// What the state shows while it is waited for.
    pub wait_state: Option<String>,
    /// What the stock sequence program does.
    pub stock: Option<Stock>,
    /// How long the stock sequence program takes, s.
    pub simulated_s: f64,
    /// Of which group a start from a line puts out the newest; `None`: as the configuration page says.
    pub restore_group: Option<String>,
    /// Where in the order of these outputs it comes; `None`: as the configuration page says.
    pub restore_order: Option<u16>,
    /// Its name and its parameters.
    pub declared: Option<MCodeDeclaration>,
}

/// What happens to an output that no handler is registered for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Unhandled {
    /// An alarm.
    #[default]
    Alarm,
    /// The program waits.
    Wait,
    /// The stock sequence program resets it.
    AutoReset,
}

/// What the stock sequence program does for an M code.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Stock {
    /// Selects the tool of parameter VA.
    SelectTool,
}

impl Machine {
    /// Servo period.
    pub fn servo_period(&self) -> Duration {
        Duration::from_micros(self.servo_period_us)
    }

    /// Nobody is there to say what the interlocks and start locks are: all of them are off.
    pub fn forget_locks(&mut self) {
        for system in &mut self.coordinate_systems {
            system.locks = Default::default();
        }
    }

    /// Servo cycles that may be left out in motion.
    pub(crate) fn missed_cycles_max(&self) -> u64 {
        (self.servo_late_ms * 1000).div_ceil(self.servo_period_us) - 1
    }

    /// Notes on settings of motors that do less than one might expect, as text for people.
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

    /// What configuration and file of the sequence side declare of M codes in a coordinate system.
    pub fn declared(&self, cs: CoordinateSystemNumber) -> Vec<Declared> {
        let declared = self
            .m_codes
            .values()
            .filter_map(|settings| settings.declared.clone());
        let served = self.served.iter().flat_map(|served| &served.serves);
        let served = served.filter(|one| one.is_in(cs)).map(|one| Declared {
            by: one.by(),
            declaration: one.declaration(),
        });
        declared.map(Declared::in_config).chain(served).collect()
    }

    /// The same in any coordinate system, each once.
    pub fn declared_anywhere(&self) -> Vec<Declared> {
        let mut all: Vec<Declared> = Vec::new();
        for system in &self.coordinate_systems {
            for one in self.declared(system.settings.number) {
                if !all.contains(&one) {
                    all.push(one);
                }
            }
        }
        all
    }

    /// What is known of M codes without handlers that are there, a line each: what they are called and take, and who serves them.
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

    /// True for an M code that is an alarm, as far as the file of the sequence side tells; false without a file.
    pub fn is_unserved(&self, system: &CoordinateSystem, m: u16) -> bool {
        let settings = self.m_codes.get(&m);
        let unhandled = settings.and_then(|settings| settings.unhandled);
        let is_stock = settings.is_some_and(|settings| settings.stock.is_some())
            || Self::stock_m_codes(&system.settings).contains(&m);
        let cs = system.settings.number;
        self.served.as_ref().is_some_and(|served| {
            let mut served = served.serves.iter();
            !is_stock
                && unhandled.unwrap_or(self.unhandled) == Unhandled::Alarm
                && !served.any(|one| one.m == m && one.is_in(cs))
        })
    }

    /// M codes that the stock sequence program serves without settings: those of a spindle where there is one.
    pub fn stock_m_codes(settings: &CoordinateSystemSettings) -> &'static [u16] {
        if settings.spindle.is_some() {
            &SPINDLE_M_CODES
        } else {
            &[]
        }
    }

    /// The rules for checking programs before their coordinate system is known.
    pub fn text_rules(&self) -> TextRules {
        self.text_rules_of(self.dialect())
    }

    /// The same of a dialect: the most that a coordinate system of it allows.
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

    /// An empty store for its programs, in memory.
    pub(crate) fn new_store(&self) -> ProgramStore {
        let all = dialects::names().filter_map(|name| dialects::find(name).ok());
        let rules = all.map(|dialect| self.text_rules_of(dialect)).collect();
        let store = ProgramStore::in_memory(self.text_rules()).with_room(self.programs_bytes_max);
        store.for_dialects(rules, self.is_mixed(), self.signers.clone())
    }

    /// True when coordinate systems have different dialects.
    pub fn is_mixed(&self) -> bool {
        let mut systems = self.coordinate_systems.iter();
        systems.any(|system| system.dialect.name != self.dialect().name)
    }

    /// True for a motor that is an axis or the spindle of a coordinate system.
    fn moves(&self, motor: u16) -> bool {
        let systems = self.coordinate_systems.iter().map(|system| &system.settings);
        let motors = systems.flat_map(|settings| settings.motors.iter().chain([&settings.spindle]));
        motors.flatten().any(|of_system| of_system.number == motor)
    }

    /// The coordinate system whose `programs` name this file; `None` if no coordinate system does.
    pub fn system_of_program(&self, file: &Path) -> Option<&CoordinateSystem> {
        let file = file.canonicalize().ok()?;
        let is_file = |source: &ProgramSource| match source {
            ProgramSource::File(path) => path.canonicalize().is_ok_and(|path| path == file),
            ProgramSource::Text(_) => false,
        };
        let mut systems = self.coordinate_systems.iter();
        systems.find(|system| system.programs.values().any(is_file))
    }

    /// NC dialect of the lowest coordinate system: that of programs of which nothing else is said.
    pub fn dialect(&self) -> &'static Dialect {
        self.coordinate_systems
            .first()
            .map_or_else(dialects::nj, |system| system.dialect)
    }
}
