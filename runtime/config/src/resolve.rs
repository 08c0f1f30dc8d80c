//! Converts configuration values into the settings of the stages, and reports all errors together.

mod alarm;
mod coordinate_system;
mod dgshape;
mod hmi;
mod identification;
mod input;
mod io;
mod motor;
mod mqtt;
mod variables;

use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::Path;

use plc_protocol::types::io::{IoDeclarations, IoKind};
use plc_protocol::types::m_code::RUNTIME_M_CODES;
use plc_protocol::types::m_code::{DeclaredParams, MCodeDeclaration, ParamDeclaration, ParamLetter};
use plc_protocol::types::machine::ServedMCodesFile;
use schemars::{JsonSchema, Schema, schema_for};
use serde::Serialize;
use tandem_model::limits::{COORDINATE_SYSTEMS_MAX, M_CODE_MAX, PROGRAM_NUMBER_MAX};
use tandem_model::settings::{MotorSettings, Tool};
use tandem_store::program_store::{Signers, read_text};
use tandem_store::tables::TOOLS_MAX;

use super::machine::{ConfiguredSystem, MCodeSettings, Machine, ProgramSource, UnhandledReaction};
use super::reference::range;
use super::text::Problems;
use super::{Config, ConfigError, CoordinateSystemConfig, MachineConfig, OnBusLoss, ToolConfig};

/// Maximum number of characters of a `wait_state`.
const WAIT_STATE_MAX: usize = 64;

/// A table of the configuration that is being checked, and the list of problems.
struct TableCheck<'a, 'b> {
    problems: &'a mut Problems<'b>,
    /// Path of the table, such as `motor.0`.
    path: String,
    /// Name of the table, with which the text of each problem begins.
    name: String,
}

impl TableCheck<'_, '_> {
    /// Adds a problem of a key in this table.
    fn problem(&mut self, key: &str, text: impl Display) {
        let path = format!("{}.{key}", self.path);
        self.problems.add(&path, format!("{}{text}", self.name));
    }

    /// Adds a problem for each number outside the range of its key, except for the keys in `elsewhere`.
    fn check_ranges<T: JsonSchema + Serialize>(&mut self, table: &T, elsewhere: &[&str]) {
        let schema = schema_for!(T);
        let keys = toml::Table::try_from(table).unwrap_or_else(|error| {
            self.problem("", error);
            toml::Table::new()
        });
        for (key, value) in keys.iter().filter(|(key, _)| !elsewhere.contains(&key.as_str())) {
            let values = value
                .as_array()
                .map_or(std::slice::from_ref(value), Vec::as_slice);
            for value in values {
                if let Some(number) = value
                    .as_float()
                    .or(value.as_integer().map(|number| number as f64))
                {
                    self.check_range(&schema, key, number);
                }
            }
        }
    }

    fn check_range(&mut self, schema: &Schema, key: &str, number: f64) {
        let of_key = schema
            .get("properties")
            .and_then(|properties| properties.get(key));
        let (low, high) = of_key.map_or((f64::NEG_INFINITY, f64::INFINITY), range);
        if !(low..=high).contains(&number) {
            self.problem(key, format!("{key} = {number}: write {low} to {high}"));
        }
    }
}

impl TableCheck<'_, '_> {
    /// Returns the parameters of an M code by their letters, and adds the problems in them.
    fn params(&mut self, params: &BTreeMap<String, ParamDeclaration>) -> DeclaredParams {
        let mut declared = DeclaredParams::new();
        for (name, param) in params {
            let mut letters = ParamLetter::ALL.into_iter();
            match letters.find(|letter| letter.to_string() == *name) {
                Some(letter) => drop(declared.insert(letter, param.clone())),
                None => self.problem(
                    &format!("params.{name}"),
                    format!("params: {name}: write VA to VH"),
                ),
            }
        }
        declared
    }
}

impl<'b> Problems<'b> {
    fn check_table(&mut self, path: impl Into<String>, name: impl Into<String>) -> TableCheck<'_, 'b> {
        TableCheck {
            problems: self,
            path: path.into(),
            name: name.into(),
        }
    }
}

impl Config {
    /// Returns the machine that this configuration describes.
    ///
    /// # Errors
    /// Returns an error that lists all invalid values and all values that do not fit together.
    pub fn resolve(&self) -> Result<Machine, ConfigError> {
        let mut problems = Problems::new(&self.places);
        let machine = self.resolve_into(&mut problems);
        if problems.is_empty() {
            Ok(machine)
        } else {
            Err(problems.into_error())
        }
    }

    /// Returns the machine that this configuration describes. The machine is only valid if no problems were
    /// added.
    pub(super) fn resolve_into(&self, problems: &mut Problems<'_>) -> Machine {
        self.machine
            .check(&mut problems.check_table("machine", "[machine] "));
        self.mqtt.check(&mut problems.check_table("mqtt", "[mqtt] "));
        self.input.check(&self.coordinate_system, problems);
        let identification = self.identification(problems);
        let io = self.io.declarations(problems);
        self.check_mtconnect(&io, problems);
        problems
            .check_table("programs", "[programs] ")
            .check_ranges(&self.programs, &[]);
        problems
            .check_table("handlers", "[handlers] ")
            .check_ranges(&self.handlers, &[]);
        let signers = self.signers(problems);
        let tools = self.tools(problems);
        let motors = self.motors(problems);
        let m_codes = self.m_codes(problems);
        let alarms = alarm::alarm_texts(&self.alarm, problems);
        let served = self.served(problems);
        let published = self.variables.published(&self.coordinate_system, problems);
        let coordinate_systems = self.coordinate_systems(&motors, &m_codes, problems);
        self.check_hmi(&coordinate_systems, problems);
        Machine {
            name: self.machine.name.clone(),
            identification,
            servo_period_us: self.machine.servo_period_us,
            servo_late_ms: self.machine.servo_late_ms,
            presence_expires_ms: self.machine.presence_expires_ms,
            public_url: self.http.public_url.clone(),
            data_dir: Some(self.base_dir.join(&self.machine.data_dir)),
            motors: motors.into_values().collect(),
            coordinate_systems,
            tools,
            m_codes,
            alarms,
            io,
            handler_grace_s: self.handlers.grace_ms as f64 / 1000.0,
            published,
            served,
            unhandled: UnhandledReaction::Alarm,
            programs_bytes_max: self.programs.total_max_mib << 20,
            takes_mdi: self.programs.mdi.unwrap_or(signers.is_none()),
            jog_step_max: self.hmi.jog_step_max,
            signers,
            hold_on_bus_loss: self.mqtt.on_bus_loss == OnBusLoss::HoldAtWait,
        }
    }

    fn check_mtconnect(&self, io: &IoDeclarations, problems: &mut Problems<'_>) {
        let Some(name) = self
            .mtconnect
            .as_ref()
            .and_then(|mtconnect| mtconnect.emergency_stop.as_ref())
        else {
            return;
        };
        let declared = io.inputs.get(name);
        if declared.is_none_or(|declared| declared.kind != IoKind::Bool) {
            let text = format!(
                "[mtconnect] emergency_stop = \"{name:.40}\": there is no on/off input with this name; \
                 write [io.in.{name:.40}]"
            );
            problems.add("mtconnect.emergency_stop", text);
        }
    }

    /// Reads the file that describes the M codes of the sequence programs.
    fn served(&self, problems: &mut Problems<'_>) -> Option<ServedMCodesFile> {
        let path = self.base_dir.join(self.machine.served.as_ref()?);
        let read = read_served(&path);
        if let Err(why) = &read {
            let path = path.display();
            let text = format!(
                "[machine] served = \"{path}\": {why}; write the file with SequenceProgram::served, or \
                 remove the key"
            );
            problems.add("machine.served", text);
        }
        read.ok()
    }

    fn signers(&self, problems: &mut Problems<'_>) -> Signers {
        let read = Signers::read(&self.programs.signed_by, &self.base_dir);
        read.unwrap_or_else(|(place, why)| {
            let path = format!("programs.signed_by.{place}");
            problems.add(&path, format!("[programs] signed_by: {why}"));
            Signers::default()
        })
    }

    fn tools(&self, problems: &mut Problems<'_>) -> BTreeMap<u16, Tool> {
        let mut tools = BTreeMap::new();
        for (index, config) in self.tool.iter().enumerate() {
            let ToolConfig { id, radius, length } = *config;
            let mut checked = problems.check_table(format!("tool.{index}"), format!("[[tool]] id = {id}: "));
            if id == 0 {
                checked.problem("id", "tools count from 1");
            }
            if tools.insert(id, Tool { length, radius }).is_some() {
                checked.problem("id", "the id is listed twice");
            }
            checked.check_ranges(config, &["id"]);
        }
        if self.tool.len() > TOOLS_MAX {
            problems.add("tool", format!("[[tool]]: the table holds {TOOLS_MAX} tools"));
        }
        tools
    }

    fn m_codes(&self, problems: &mut Problems<'_>) -> BTreeMap<u16, MCodeSettings> {
        let mut m_codes = BTreeMap::new();
        for (key, config) in &self.m_code {
            let path = format!("m_code.{key}");
            let mut of_table = problems.check_table(path.as_str(), format!("[m_code.{key}]: "));
            let Some(m) = key.parse::<u16>().ok().filter(|m| *m <= M_CODE_MAX) else {
                of_table.problem("", format!("write an M code, 0 to {M_CODE_MAX}"));
                continue;
            };
            if m.to_string() != *key {
                of_table.problem("", format!("write [m_code.{m}]"));
            }
            if RUNTIME_M_CODES.contains(&m) {
                let text =
                    format!("the runtime handles M{m:02} itself, so this table has no effect; remove it");
                of_table.problem("", text);
            }
            let mut checked = problems.check_table(path, format!("[m_code.{key}] "));
            checked.check_ranges(config, &[]);
            if let Some(word) = &config.wait_state
                && (!(1..=WAIT_STATE_MAX).contains(&word.chars().count()) || word.contains(char::is_control))
            {
                let text = format!("wait_state: write a word of 1 to {WAIT_STATE_MAX} characters");
                checked.problem("wait_state", text);
            }
            if let Some(group) = &config.restore_group
                && (!(1..=WAIT_STATE_MAX).contains(&group.chars().count())
                    || group.contains(char::is_control))
            {
                let text = format!("restore_group: write a word of 1 to {WAIT_STATE_MAX} characters");
                checked.problem("restore_group", text);
            }
            let declared = MCodeDeclaration {
                m,
                cs: None,
                name: config.name.clone(),
                params: config.params.as_ref().map(|params| checked.params(params)),
                redelivery: None,
            };
            if let Err(mistake) = declared.mistake() {
                checked.problem("", mistake);
            }
            let is_declared = declared.name.is_some() || declared.params.is_some();
            let settings = MCodeSettings {
                declared: is_declared.then_some(declared),
                timing: config.timing,
                unhandled: config.unhandled,
                timeout_ms: config.timeout_ms,
                redelivery: config.redelivery,
                wait_state: config.wait_state.clone(),
                stock: config.stock,
                simulated_s: config.simulated_ms / 1000.0,
                restore_group: config.restore_group.clone(),
                restore_order: config.restore_order,
            };
            m_codes.insert(m, settings);
        }
        m_codes
    }

    fn coordinate_systems(
        &self,
        motors: &BTreeMap<u16, MotorSettings>,
        m_codes: &BTreeMap<u16, MCodeSettings>,
        problems: &mut Problems<'_>,
    ) -> Vec<ConfiguredSystem> {
        if self.coordinate_system.is_empty() || self.coordinate_system.len() > COORDINATE_SYSTEMS_MAX {
            let text = format!("write 1 to {COORDINATE_SYSTEMS_MAX} [[coordinate_system]] tables");
            problems.add("coordinate_system", text);
        }
        let skips = self.simulated_skips(motors, problems);
        let rounds = self.simulated_rounds(problems);
        let mut taken = BTreeMap::new();
        let mut systems = BTreeMap::new();
        for (index, config) in self.coordinate_system.iter().enumerate() {
            let path = format!("coordinate_system.{index}");
            let name = format!("[[coordinate_system]] number = {}: ", config.number);
            let mut checked = problems.check_table(path, name);
            if config.number == 0 {
                checked.problem("number", "coordinate systems are numbered from 1");
            }
            checked.check_ranges(config, &["number"]);
            for motor in config.axes.values().copied().chain(config.spindle) {
                if let Some(other) = taken.insert(motor, config.number) {
                    let text = format!("motor {motor} already belongs to coordinate system {other}");
                    checked.problem("axes", text);
                }
            }
            let declared = m_codes.keys().copied().collect();
            let period_us = self.machine.servo_period_us;
            let system = ConfiguredSystem {
                settings: config.settings(motors, period_us, (&skips, &rounds), declared, &mut checked),
                dialect: config.dialect,
                work_offsets: config.work_offsets(&mut checked),
                programs: self.programs(config, &mut checked),
                pre_read_blocks: config.pre_read_blocks,
                open_outputs_max: config.open_outputs_max,
                locks: self.input.rules(config.number),
            };
            if systems.insert(config.number, system).is_some() {
                checked.problem("number", "the number is listed twice");
            }
        }
        systems.into_values().collect()
    }

    fn programs(
        &self,
        config: &CoordinateSystemConfig,
        checked: &mut TableCheck<'_, '_>,
    ) -> BTreeMap<u16, ProgramSource> {
        let mut programs = BTreeMap::new();
        for (key, path) in &config.programs {
            let mut problem =
                |text: String| checked.problem(&format!("programs.{key}"), format!("programs: {key}{text}"));
            let number = key.parse::<u16>().ok();
            let Some(number) = number.filter(|n| (1..=PROGRAM_NUMBER_MAX).contains(n)) else {
                problem(format!(
                    " is not a program number; write 1 to {PROGRAM_NUMBER_MAX}"
                ));
                continue;
            };
            if number.to_string() != *key {
                problem(format!(": write {number}"));
            }
            let others = self.coordinate_system.iter();
            let mut elsewhere = others
                .take_while(|other| other.number != config.number)
                .filter_map(|other| Some((other.dialect.name, other.programs.get(key)?)));
            let is_same =
                |(dialect, other): &(&str, &String)| *other == path && *dialect == config.dialect.name;
            if let Some((dialect, other)) = elsewhere.find(|other| !is_same(other)) {
                problem(format!(
                    " = \"{path}\": coordinate systems share the numbers, and {key} is \"{other}\" of dialect {dialect} in another one"
                ));
            }
            let source = match self.embedded_programs.get(path.as_str()) {
                Some(text) => ProgramSource::Text(text),
                None => ProgramSource::File(self.base_dir.join(path)),
            };
            programs.insert(number, source);
        }
        programs
    }
}

fn read_served(path: &Path) -> Result<ServedMCodesFile, String> {
    let text = read_text(path).map_err(|error| error.to_string())?;
    let served: ServedMCodesFile = serde_json::from_str(&text).map_err(|error| error.to_string())?;
    let mistake = served
        .serves
        .iter()
        .find_map(|one| one.declaration().mistake().err());
    mistake.map_or(Ok(served), Err)
}

impl MachineConfig {
    fn check(&self, checked: &mut TableCheck<'_, '_>) {
        let name = &self.name;
        let good = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        if name.is_empty() || name.len() > 32 || !name.chars().all(good) {
            let text = format!("name = \"{name}\": write 1 to 32 lower-case letters, digits and hyphens");
            checked.problem("name", text);
        }
        let schema = schema_for!(Self);
        checked.check_range(&schema, "servo_period_us", self.servo_period_us as f64);
        checked.check_range(&schema, "servo_late_ms", self.servo_late_ms as f64);
        checked.check_range(&schema, "presence_expires_ms", self.presence_expires_ms as f64);
        if self.data_dir.as_os_str().is_empty() {
            checked.problem("data_dir", "data_dir = \"\": write the name of a folder");
        }
    }
}

#[cfg(test)]
mod tests {

    use tandem_interp::dialects;
    use tandem_model::settings::{CompensationFeed, MotionOptions, Overcut, Unit};

    use super::*;

    #[test]
    fn everything_that_does_not_fit_is_said_at_once() {
        let text = "[machine]\nname = \"Mill 1\"\n[[coordinate_system]]\nnumber = 1\naxes = { X = 7, Q = 7 }\nspindle = 9\n";
        let error = Config::from_toml(text, "")
            .unwrap()
            .resolve()
            .unwrap_err()
            .to_string();
        for part in [
            "name = \"Mill 1\"",
            "there is no [[motor]] 7",
            "Q is not an axis",
            "spindle = 9",
            "motor 7 already belongs",
        ] {
            assert!(error.contains(part), "{part} is missing in {error}");
        }
    }

    #[test]
    fn parameters_of_an_m_code_are_va_to_vh_and_their_bounds_fit() {
        let text = "[[motor]]\nnumber = 1\nkind = \"linear\"\nmax_velocity = 5\nmax_acceleration = 5\n\
                    [[coordinate_system]]\nnumber = 1\naxes = { X = 1 }\n[m_code.12]\nname = \"clamp\"\n";
        let machine = |params: &str| {
            Config::from_toml(&format!("{text}{params}\n"), "")
                .unwrap()
                .resolve()
        };
        let declared = machine("params.VB = { name = \"force\", unit = \"kN\", max = 20 }").unwrap();
        let declared = declared.m_codes[&12].declared.clone().unwrap();
        assert_eq!(declared.text(), "M12 clamp VB (force, 20 kN or less)");
        for (params, why) in [
            (
                "params.VX = {}",
                "line 11, column 8: [m_code.12] params: VX: write VA to VH",
            ),
            ("params.VA = { min = 2, max = 1 }", "M12 VA: min 2 is above max 1"),
        ] {
            let refused = machine(params).unwrap_err().to_string();
            assert!(refused.contains(why), "{why} is missing in {refused}");
        }
    }

    #[test]
    fn keys_left_out_have_their_defaults() {
        let text = "[[motor]]\nnumber = 1\nkind = \"linear\"\nmax_velocity = 500.0\nmax_acceleration = 5000.0\n[[coordinate_system]]\nnumber = 1\naxes = { X = 1 }\n";
        let machine = Config::from_toml(text, "").unwrap().resolve().unwrap();
        let system = &machine.coordinate_systems[0];
        let motor = &machine.motors[0];
        assert_eq!(
            (motor.rapid_velocity, motor.skip_velocity, motor.in_position),
            (500.0, 50.0, 0.01)
        );
        assert_eq!(
            (
                system.settings.max_feedrate_mm_min,
                system.settings.default_feedrate_mm_min
            ),
            (10_000.0, 0.0)
        );
        assert_eq!(system.open_outputs_max, 64);
        assert_eq!(machine.unhandled, UnhandledReaction::Alarm);
    }

    fn of_coordinate_systems(tables: &[&str]) -> Result<Machine, ConfigError> {
        let of_one = |(index, table): (usize, &&str)| {
            let n = index + 1;
            format!(
                "[[motor]]\nnumber = {n}\nkind = \"linear\"\nmax_velocity = 5.0\nmax_acceleration = 5.0\n\
                 [[coordinate_system]]\nnumber = {n}\naxes = {{ X = {n} }}\n{table}\n"
            )
        };
        let text: String = tables.iter().enumerate().map(of_one).collect();
        Config::from_toml(&text, "")?.resolve()
    }

    #[test]
    fn a_dialect_is_found_by_its_name() {
        let machine = of_coordinate_systems(&["dialect = \"nj\""]).unwrap();
        assert_eq!(machine.coordinate_systems[0].dialect.name, "nj");
        for (name, why) in [
            ("iso", "there is no dialect iso; write nj or dgshape"),
            ("fanuc", "there is no dialect fanuc; write nj or dgshape"),
        ] {
            let error = of_coordinate_systems(&[&format!("dialect = \"{name}\"")]).unwrap_err();
            let text = error.to_string();
            assert!(
                text.starts_with("line 9, column 11") && text.contains(why),
                "{text}"
            );
        }
    }

    #[test]
    fn each_coordinate_system_has_a_dialect_and_a_program_number_only_one() {
        let mut config = Config::demo();
        config.coordinate_system[1].dialect = dialects::dgshape();
        let machine = config.resolve().unwrap();
        assert!(machine.is_mixed() && machine.dialect().name == "nj");
        let rules = machine.text_rules_of(dialects::dgshape());
        assert_eq!(rules.dialect.name, "dgshape");
        let shared = ("7".to_owned(), "seven.nc".to_owned());
        for system in &mut config.coordinate_system {
            system.programs.extend([shared.clone()]);
        }
        let error = config.resolve().unwrap_err().to_string();
        assert!(
            error.contains("7 is \"seven.nc\" of dialect nj in another one"),
            "{error}"
        );
    }

    #[test]
    fn d25_units_tell_the_unit_at_start_up() {
        let machine = of_coordinate_systems(&["", "units = \"inch\""]).unwrap();
        let units = machine
            .coordinate_systems
            .iter()
            .map(|system| system.settings.unit);
        assert!(units.eq([Unit::Millimetre, Unit::Inch]));
        let error = of_coordinate_systems(&["units = \"cm\""]).unwrap_err();
        assert_eq!(
            error.to_string(),
            "line 9, column 9: units = \"cm\": write \"mm\" or \"inch\""
        );
    }

    #[test]
    fn what_cutter_compensation_and_dry_run_do_is_configured() {
        let text = "[[motor]]\nnumber = 1\nkind = \"linear\"\nmax_velocity = 500.0\nmax_acceleration = 5000.0\n[[coordinate_system]]\nnumber = 1\naxes = { X = 1 }\n";
        let options = |more: &str| {
            let config = Config::from_toml(&format!("{text}{more}"), "").unwrap();
            config.resolve().unwrap().coordinate_systems[0]
                .settings
                .motion
                .clone()
        };
        assert_eq!(options(""), MotionOptions::default());
        let all = "compensation_feed = \"edge\"\novercut = \"prevent\"\nspiral_tolerance = 0.5\ndry_run_feedrate = 1200.0\n";
        let expected = MotionOptions {
            compensation_feed: CompensationFeed::Edge,
            overcut: Overcut::Prevent,
            spiral_tolerance_mm: 0.5,
            dry_run_feedrate_mm_min: 1200.0,
            ..MotionOptions::default()
        };
        assert_eq!(options(all), expected);
    }

    #[test]
    fn what_the_loss_of_the_broker_does_is_configured() {
        let resolved = |value: &str| {
            let more = format!("[mqtt]\non_bus_loss = \"{value}\"");
            of_coordinate_systems(&[&more]).map(|machine| machine.hold_on_bus_loss)
        };
        assert!(!resolved("continue").unwrap());
        assert!(resolved("hold_at_wait").unwrap());
        assert_eq!(
            resolved("stop").unwrap_err().to_string(),
            "line 10, column 15: on_bus_loss = \"stop\": write \"continue\" or \"hold_at_wait\""
        );
    }

    #[test]
    fn the_demo_machine_has_two_coordinate_systems_and_a_spindle() {
        let machine = Config::demo().resolve().unwrap();
        assert_eq!(machine.name, "mill-1");
        assert_eq!(machine.coordinate_systems.len(), 2);
        assert_eq!(machine.coordinate_systems[0].settings.axes().iter().count(), 3);
        assert!(machine.coordinate_systems[0].settings.spindle.is_some());
        assert_eq!(machine.coordinate_systems[1].settings.axes().iter().count(), 2);
    }
}
