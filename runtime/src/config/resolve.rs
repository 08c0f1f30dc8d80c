//! From the values of the configuration to the settings that the stages take; all faults are reported together.

mod coordinate_system;
mod motor;
mod mqtt;

use std::collections::{BTreeMap, BTreeSet};

use plc_api::handlers::RUNTIME_M_CODES;
use schemars::{JsonSchema, Schema, schema_for};
use tandem_model::limits::{COORDINATE_SYSTEMS_MAX, M_CODE_MAX, PROGRAM_NUMBER_MAX};
use tandem_model::settings::{MotorSettings, Tool};

use super::machine::{CoordinateSystem, MCodeSettings, Machine, ProgramSource, Unhandled};
use super::reference::range;
use super::{Config, ConfigError, CoordinateSystemConfig, MCodeConfig, MachineConfig, OnBusLoss, ToolConfig};
use crate::tables::TOOLS_MAX;

/// Characters of a `wait_state`.
const WAIT_STATE_MAX: usize = 64;

/// The ranges of the numbers of a table.
struct Ranges(Schema);

impl Ranges {
    fn of<T: JsonSchema>() -> Self {
        Self(schema_for!(T))
    }

    /// What to write where a value of a key is not a number of its range; `None`: it is.
    fn problem(&self, (key, value): (&str, f64)) -> Option<String> {
        let (low, high) = range(self.0.get("properties")?.get(key)?);
        (!(low..=high).contains(&value)).then(|| format!("{key} = {value}: write {low} to {high}"))
    }
}

impl Config {
    /// The machine of this configuration.
    ///
    /// # Errors
    /// All values that do not fit together, at once.
    pub fn resolve(&self) -> Result<Machine, ConfigError> {
        let mut problems = Vec::new();
        self.check_machine(&mut problems);
        self.mqtt.check(&mut problems);
        self.check_tools(&mut problems);
        let motors = self.motors(&mut problems);
        let m_codes = self.m_codes(&mut problems);
        let coordinate_systems = self.coordinate_systems(&motors, &mut problems);
        if !problems.is_empty() {
            return Err(ConfigError::Values(problems));
        }
        Ok(Machine {
            name: self.machine.name.clone(),
            servo_period_us: self.machine.servo_period_us,
            data_dir: Some(self.base_dir.join(&self.machine.data_dir)),
            motors: motors.into_values().collect(),
            coordinate_systems,
            tools: self.tools(),
            m_codes,
            unhandled: Unhandled::Alarm,
            hold_on_bus_loss: self.mqtt.on_bus_loss == OnBusLoss::HoldAtWait,
        })
    }

    fn tools(&self) -> BTreeMap<u16, Tool> {
        let of = |tool: &ToolConfig| {
            (
                tool.id,
                Tool {
                    length: tool.length,
                    radius: tool.radius,
                },
            )
        };
        self.tool.iter().map(of).collect()
    }

    fn check_machine(&self, problems: &mut Vec<String>) {
        let name = &self.machine.name;
        let good = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        if name.is_empty() || name.len() > 32 || !name.chars().all(good) {
            problems.push(format!(
                "[machine] name = \"{name}\": write 1 to 32 lower-case letters, digits and hyphens"
            ));
        }
        let period = ("servo_period_us", self.machine.servo_period_us as f64);
        if let Some(text) = Ranges::of::<MachineConfig>().problem(period) {
            problems.push(format!("[machine] {text}"));
        }
        if self.machine.data_dir.as_os_str().is_empty() {
            problems.push("[machine] data_dir = \"\": write the name of a folder".into());
        }
    }

    fn check_tools(&self, problems: &mut Vec<String>) {
        let ranges = Ranges::of::<ToolConfig>();
        let mut ids = BTreeSet::new();
        for tool in &self.tool {
            let mut problem = |text: String| problems.push(format!("[[tool]] id = {}: {text}", tool.id));
            if tool.id == 0 {
                problem("tools count from 1".into());
            }
            if !ids.insert(tool.id) {
                problem("the id stands twice".into());
            }
            [("radius", tool.radius), ("length", tool.length)]
                .into_iter()
                .filter_map(|number| ranges.problem(number))
                .for_each(problem);
        }
        if self.tool.len() > TOOLS_MAX {
            problems.push(format!("[[tool]]: the table holds {TOOLS_MAX} tools"));
        }
    }

    fn m_codes(&self, problems: &mut Vec<String>) -> BTreeMap<u16, MCodeSettings> {
        let mut m_codes = BTreeMap::new();
        for (key, config) in &self.m_code {
            let mut problem = |text: String| problems.push(format!("[m_code.{key}]{text}"));
            let Some(m) = key.parse::<u16>().ok().filter(|m| *m <= M_CODE_MAX) else {
                problem(format!(": write an M code, 0 to {M_CODE_MAX}"));
                continue;
            };
            if m.to_string() != *key {
                problem(format!(": write [m_code.{m}]"));
            }
            if RUNTIME_M_CODES.contains(&m) {
                problem(format!(
                    ": the runtime handles M{m:02} itself, and nothing reads this table; take it out"
                ));
            }
            config.check(&mut problem);
            m_codes.insert(
                m,
                MCodeSettings {
                    timing: config.timing,
                    unhandled: config.unhandled,
                    timeout_ms: config.timeout_ms,
                    wait_state: config.wait_state.clone(),
                    stock: config.stock,
                    simulated_s: config.simulated_ms / 1000.0,
                },
            );
        }
        m_codes
    }

    fn coordinate_systems(
        &self,
        motors: &BTreeMap<u16, MotorSettings>,
        problems: &mut Vec<String>,
    ) -> Vec<CoordinateSystem> {
        if self.coordinate_system.is_empty() || self.coordinate_system.len() > COORDINATE_SYSTEMS_MAX {
            problems.push(format!(
                "write 1 to {COORDINATE_SYSTEMS_MAX} [[coordinate_system]] tables"
            ));
        }
        let skips = self.simulated_skips(motors, problems);
        let mut taken = BTreeMap::new();
        let mut systems = BTreeMap::new();
        let first = self.coordinate_system.first().map(|config| config.dialect.name);
        for config in &self.coordinate_system {
            let place = format!("[[coordinate_system]] number = {}", config.number);
            let mut problem = |text: String| problems.push(format!("{place}: {text}"));
            config.check(&mut problem);
            if first.is_some_and(|first| first != config.dialect.name) {
                problem("dialect: coordinate systems share the programs; write the same in all".into());
            }
            let all = config.axes.values().copied().chain(config.spindle);
            for motor in all {
                if let Some(other) = taken.insert(motor, config.number) {
                    problem(format!(
                        "motor {motor} already belongs to coordinate system {other}"
                    ));
                }
            }
            let system = CoordinateSystem {
                settings: config.settings(motors, self.machine.servo_period_us, &skips, &mut problem),
                dialect: config.dialect,
                work_offsets: config.work_offsets(&mut problem),
                programs: self.programs(config, &mut problem),
                pre_read_blocks: config.pre_read_blocks,
                open_outputs_max: config.open_outputs_max,
            };
            if systems.insert(config.number, system).is_some() {
                problem("the number stands twice".into());
            }
        }
        systems.into_values().collect()
    }

    fn programs(
        &self,
        config: &CoordinateSystemConfig,
        problem: &mut impl FnMut(String),
    ) -> BTreeMap<u16, ProgramSource> {
        let mut programs = BTreeMap::new();
        for (key, path) in &config.programs {
            let number = key.parse::<u16>().ok();
            let Some(number) = number.filter(|n| (1..=PROGRAM_NUMBER_MAX).contains(n)) else {
                problem(format!(
                    "programs: {key} is not a program number; write 1 to {PROGRAM_NUMBER_MAX}"
                ));
                continue;
            };
            if number.to_string() != *key {
                problem(format!("programs: {key}: write {number}"));
            }
            let others = self
                .coordinate_system
                .iter()
                .take_while(|other| other.number != config.number);
            let mut elsewhere = others.filter_map(|other| other.programs.get(key));
            if let Some(other) = elsewhere.find(|other| *other != path) {
                problem(format!(
                    "programs: {key} = \"{path}\": coordinate systems share the programs, and {key} is \"{other}\" in another one"
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

impl MCodeConfig {
    fn check(&self, problem: &mut impl FnMut(String)) {
        let timeout = self.timeout_ms.map(|ms| ("timeout_ms", ms as f64));
        let ranges = Ranges::of::<Self>();
        [("simulated_ms", self.simulated_ms)]
            .into_iter()
            .chain(timeout)
            .filter_map(|number| ranges.problem(number))
            .for_each(|text| problem(format!(" {text}")));
        if let Some(word) = &self.wait_state
            && (!(1..=WAIT_STATE_MAX).contains(&word.chars().count()) || word.contains(char::is_control))
        {
            problem(format!(
                " wait_state: write a word of 1 to {WAIT_STATE_MAX} characters"
            ));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::LazyLock;

    use tandem_interp::{Dialect, dialects};
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
        assert_eq!(machine.unhandled, Unhandled::Alarm);
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
            ("dgshape", "dialect dgshape is not supported yet; write nj"),
            ("fanuc", "there is no dialect fanuc; write nj"),
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
    fn coordinate_systems_have_the_same_dialect() {
        static OTHER: LazyLock<Dialect> = LazyLock::new(|| Dialect {
            name: "other",
            ..dialects::nj().clone()
        });
        let mut config = Config::demo();
        config.coordinate_system[1].dialect = &OTHER;
        let error = config.resolve().unwrap_err();
        assert!(error.to_string().contains("write the same in all"), "{error}");
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
