//! From the configuration's text to the settings that the stages take; all that does not fit is said at once.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use plc_api::types::output::Timing;
use serde::Deserialize;
use tandem_model::limits::{COORDINATE_SYSTEMS_MAX, M_CODE_MAX, PROGRAM_NUMBER_MAX};
use tandem_model::settings::{
    CoordinateSystemSettings, MotionOptions, MotorKind, MotorSettings, ShortBlock, SimulatedSkip, WorkOffsets,
};
use tandem_model::{AXES_MAX, Axis, AxisVector};

use super::error::nearest;
use super::{Config, ConfigError, CoordinateSystemConfig, MotorConfig, MotorKindConfig};

/// A machine as configured.
#[derive(Debug, Clone)]
pub struct Machine {
    /// MQTT topic level.
    pub name: String,
    /// Servo period, microseconds.
    pub servo_period_us: u64,
    /// Folder of what is kept; `None`: nothing is kept.
    pub data_dir: Option<PathBuf>,
    /// Motors, ascending by number.
    pub motors: Vec<MotorSettings>,
    /// Coordinate systems, ascending by number.
    pub coordinate_systems: Vec<CoordinateSystem>,
    /// M codes that have settings.
    pub m_codes: BTreeMap<u16, MCodeSettings>,
    /// What happens to an output of an M code without settings that no handler is registered for.
    pub unhandled: Unhandled,
    /// Settings that have no effect yet, in words for the person who wrote them.
    pub warnings: Vec<String>,
}

/// A coordinate system as configured.
#[derive(Debug, Clone)]
pub struct CoordinateSystem {
    /// What the stages need.
    pub settings: CoordinateSystemSettings,
    /// NC dialect.
    pub dialect: String,
    /// `mm` or `inch` at start.
    pub units: String,
    /// G54 to G59.
    pub work_offsets: WorkOffsets,
    /// Programs to put into the store.
    pub programs: BTreeMap<u16, ProgramSource>,
    /// Profiles that wait for the servo cycle at the most.
    pub pre_read_blocks: usize,
    /// Outputs open at the same time.
    pub open_outputs_max: usize,
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
    /// When it is output.
    pub timing: Timing,
    /// What happens when no handler is registered; `None`: as for M codes without settings.
    pub unhandled: Option<Unhandled>,
    /// Time limit of the reset, ms.
    pub timeout_ms: Option<u64>,
    /// What the state shows while it is waited for.
    pub wait_state: Option<String>,
    /// What the stock sequence program does.
    pub stock: Option<Stock>,
    /// How long the stock sequence program takes, s.
    pub simulated_s: f64,
}

/// What happens to an output that no handler is registered for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stock {
    /// Selects the tool of parameter VA.
    SelectTool,
}

impl Config {
    /// The machine of this configuration.
    ///
    /// # Errors
    /// All values that do not fit together, at once.
    pub fn resolve(&self) -> Result<Machine, ConfigError> {
        let mut problems = Vec::new();
        self.check_machine(&mut problems);
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
            m_codes,
            unhandled: Unhandled::Alarm,
            warnings: self.warnings(),
        })
    }

    /// What is set and has no effect yet.
    fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        for system in &self.coordinate_system {
            let unusual = [
                (
                    "compensation_feed",
                    &system.compensation_feed,
                    "centre",
                    "G41 and G42 are not supported",
                ),
                (
                    "overcut",
                    &system.overcut,
                    "detect",
                    "G41 and G42 are not supported",
                ),
            ];
            for (key, value, default, why) in unusual {
                if value != default {
                    let number = system.number;
                    warnings.push(format!(
                        "[[coordinate_system]] number = {number}: {key} = \"{value}\" has no effect yet: {why}"
                    ));
                }
            }
        }
        warnings
    }

    fn check_machine(&self, problems: &mut Vec<String>) {
        let name = &self.machine.name;
        let good = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        if name.is_empty() || name.len() > 32 || !name.chars().all(good) {
            problems.push(format!(
                "[machine] name = \"{name}\": write 1 to 32 lower-case letters, digits and hyphens"
            ));
        }
        if !(125..=10_000).contains(&self.machine.servo_period_us) {
            problems.push(format!(
                "[machine] servo_period_us = {}: write 125 to 10000",
                self.machine.servo_period_us
            ));
        }
        let mqtt = &self.mqtt;
        if mqtt.broker.starts_with("mqtts://")
            || mqtt.ca_file.is_some()
            || mqtt.client_cert_file.is_some()
            || mqtt.client_key_file.is_some()
        {
            problems.push(
                "[mqtt] TLS to a broker is not supported yet; write broker = \"mqtt://host:port\"".into(),
            );
        } else if mqtt.broker != "embedded" && !mqtt.broker.starts_with("mqtt://") {
            problems.push(format!(
                "[mqtt] broker = \"{}\": write \"embedded\" or \"mqtt://host:port\"",
                mqtt.broker
            ));
        }
        if mqtt.on_bus_loss != "continue" {
            problems.push("[mqtt] on_bus_loss: only \"continue\" is supported yet".into());
        }
        if self.http.token_file.is_some() {
            problems.push(
                "[http] token_file is not supported yet; listen on a loopback address without it".into(),
            );
        }
        if !self
            .tool
            .iter()
            .all(|tool| tool.id >= 1 && tool.radius >= 0.0 && tool.length.is_finite())
        {
            problems.push("[[tool]]: id counts from 1, radius is 0 or more, length a number".into());
        }
        let ids: BTreeSet<u16> = self.tool.iter().map(|tool| tool.id).collect();
        if ids.len() != self.tool.len() {
            problems.push("[[tool]]: each id stands once".into());
        }
    }

    fn motors(&self, problems: &mut Vec<String>) -> BTreeMap<u16, MotorSettings> {
        let mut motors = BTreeMap::new();
        for motor in &self.motor {
            motor.check(problems);
            if motors.insert(motor.number, motor.settings()).is_some() {
                problems.push(format!(
                    "[[motor]] number = {}: the number stands twice",
                    motor.number
                ));
            }
        }
        motors
    }

    fn m_codes(&self, problems: &mut Vec<String>) -> BTreeMap<u16, MCodeSettings> {
        let mut m_codes = BTreeMap::new();
        for (key, config) in &self.m_code {
            let Some(m) = key.parse::<u16>().ok().filter(|m| *m <= M_CODE_MAX) else {
                problems.push(format!("[m_code.{key}]: write an M code, 0 to {M_CODE_MAX}"));
                continue;
            };
            if !(0.0..=86_400_000.0).contains(&config.simulated_ms) {
                problems.push(format!("[m_code.{key}] simulated_ms: write 0 to 86400000"));
            }
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
        for config in &self.coordinate_system {
            let place = format!("[[coordinate_system]] number = {}", config.number);
            let mut problem = |text: String| problems.push(format!("{place}: {text}"));
            config.check(&mut problem);
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
                dialect: config.dialect.clone(),
                units: config.units.clone(),
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

    /// The simulated skip input of each motor that has one.
    fn simulated_skips(
        &self,
        motors: &BTreeMap<u16, MotorSettings>,
        problems: &mut Vec<String>,
    ) -> BTreeMap<u16, SimulatedSkip> {
        let mut skips = BTreeMap::new();
        for config in &self.simulated_skip {
            let place = format!("[[simulated_skip]] motor = {}", config.motor);
            let is_axis = motors
                .get(&config.motor)
                .is_some_and(|motor| motor.kind != MotorKind::Spindle);
            if !is_axis {
                problems.push(format!(
                    "{place}: there is no [[motor]] {} of an axis",
                    config.motor
                ));
            }
            let skip = match (config.below, config.above) {
                (Some(below), None) if below.is_finite() => SimulatedSkip::Below(below),
                (None, Some(above)) if above.is_finite() => SimulatedSkip::Above(above),
                _ => {
                    problems.push(format!("{place}: write a position for either below or above"));
                    continue;
                }
            };
            if skips.insert(config.motor, skip).is_some() {
                problems.push(format!("{place}: the motor stands twice"));
            }
        }
        skips
    }

    fn programs(
        &self,
        config: &CoordinateSystemConfig,
        problem: &mut impl FnMut(String),
    ) -> BTreeMap<u16, ProgramSource> {
        let mut programs = BTreeMap::new();
        for (key, path) in &config.programs {
            let Some(number) = key.parse().ok().filter(|n| (1..=PROGRAM_NUMBER_MAX).contains(n)) else {
                problem(format!(
                    "programs: {key} is not a program number; write 1 to {PROGRAM_NUMBER_MAX}"
                ));
                continue;
            };
            let source = match self.embedded_programs.get(path.as_str()) {
                Some(text) => ProgramSource::Text(text),
                None => ProgramSource::File(self.base_dir.join(path)),
            };
            programs.insert(number, source);
        }
        programs
    }
}

impl MotorConfig {
    fn check(&self, problems: &mut Vec<String>) {
        let mut positive = |key: &str, value: f64| {
            if !(value > 0.0 && value.is_finite()) {
                problems.push(format!(
                    "[[motor]] number = {}: {key} = {value}: write a number above 0",
                    self.number
                ));
            }
        };
        positive("max_velocity", self.max_velocity);
        positive("max_acceleration", self.max_acceleration);
        positive("in_position", self.in_position);
        positive("in_position_timeout_ms", self.in_position_timeout_ms);
        positive("orientation_velocity", self.orientation_velocity);
        let optional = [
            ("max_jerk", self.max_jerk),
            ("rapid_velocity", self.rapid_velocity),
            ("rapid_acceleration", self.rapid_acceleration),
            ("skip_velocity", self.skip_velocity),
        ];
        for (key, value) in optional {
            if let Some(value) = value {
                positive(key, value);
            }
        }
        if !(0.0..=10_000.0).contains(&self.lag_ms) {
            problems.push(format!(
                "[[motor]] number = {}: lag_ms: write 0 to 10000",
                self.number
            ));
        }
        if self
            .soft_limits
            .is_some_and(|[low, high]| low.is_nan() || high.is_nan() || low >= high)
        {
            problems.push(format!(
                "[[motor]] number = {}: soft_limits: write [lowest, highest]",
                self.number
            ));
        }
    }

    fn settings(&self) -> MotorSettings {
        MotorSettings {
            number: self.number,
            kind: match self.kind {
                MotorKindConfig::Linear => MotorKind::Linear,
                MotorKindConfig::Rotary => MotorKind::Rotary,
                MotorKindConfig::Spindle => MotorKind::Spindle,
            },
            max_velocity: self.max_velocity,
            max_acceleration: self.max_acceleration,
            max_jerk: self.max_jerk,
            rapid_velocity: self.rapid_velocity.unwrap_or(self.max_velocity),
            rapid_acceleration: self.rapid_acceleration.unwrap_or(self.max_acceleration),
            skip_velocity: self.skip_velocity.unwrap_or(self.max_velocity / 10.0),
            in_position: self.in_position,
            in_position_timeout_ms: self.in_position_timeout_ms,
            soft_limits: self.soft_limits,
            reference_points: self.reference_points,
            lag_ms: self.lag_ms,
            orientation_velocity: self.orientation_velocity,
            orientation_position: self.orientation_position,
        }
    }
}

impl CoordinateSystemConfig {
    fn check(&self, problem: &mut impl FnMut(String)) {
        if self.number == 0 {
            problem("coordinate systems count from 1".into());
        }
        if self.dialect == "dgshape" {
            problem("dialect = \"dgshape\" is not supported yet; write \"nj\"".into());
        } else if self.dialect != "nj" {
            problem(format!("dialect = \"{}\": write \"nj\"", self.dialect));
        }
        if self.units == "inch" {
            problem("units = \"inch\" is not supported yet; write \"mm\"".into());
        }
        let words = [
            ("units", &self.units, ["mm", "inch"]),
            ("short_block", &self.short_block, ["shrink", "extend"]),
            ("compensation_feed", &self.compensation_feed, ["centre", "edge"]),
            ("overcut", &self.overcut, ["detect", "prevent"]),
        ];
        for (key, value, allowed) in words {
            if !allowed.contains(&value.as_str()) {
                problem(format!(
                    "{key} = \"{value}\": write \"{}\" or \"{}\"",
                    allowed[0], allowed[1]
                ));
            }
        }
        let ranges = [
            ("max_feedrate", self.max_feedrate, 1e-9, 1e9),
            ("default_feedrate", self.default_feedrate, 0.0, 1e9),
            ("default_ta_ms", self.default_ta_ms, 0.0, 250_000.0),
            ("default_td_ms", self.default_td_ms, 0.0, 250_000.0),
            ("default_ts_ms", self.default_ts_ms, 0.0, 125_000.0),
            ("rotary_feedrate", self.rotary_feedrate, 0.0, 1e9),
            ("arc_radius_tolerance", self.arc_radius_tolerance, 0.0, 1e6),
            ("spiral_tolerance", self.spiral_tolerance, 0.0, 1e6),
            ("override_slew_ms", self.override_slew_ms, 1.0, 60_000.0),
            ("hold_slew_ms", self.hold_slew_ms, 1.0, 60_000.0),
        ];
        for (key, value, low, high) in ranges {
            if !(low..=high).contains(&value) {
                problem(format!("{key} = {value}: write {low} to {high}"));
            }
        }
        if !(16..=1_000_000).contains(&self.pre_read_blocks) {
            problem("pre_read_blocks: write 16 to 1000000".into());
        }
        if !(1..=1024).contains(&self.open_outputs_max) {
            problem("open_outputs_max: write 1 to 1024".into());
        }
    }

    fn settings(
        &self,
        motors: &BTreeMap<u16, MotorSettings>,
        servo_period_us: u64,
        skips: &BTreeMap<u16, SimulatedSkip>,
        problem: &mut impl FnMut(String),
    ) -> CoordinateSystemSettings {
        let mut of_axis: [Option<MotorSettings>; AXES_MAX] = [const { None }; AXES_MAX];
        for (letter, number) in &self.axes {
            match (axis(letter), motors.get(number)) {
                (None, _) => problem(format!("axes: {letter} is not an axis; write X Y Z A B C U or V")),
                (_, None) => problem(format!(
                    "axes: {letter} = {number}: there is no [[motor]] {number}"
                )),
                (Some(_), Some(motor)) if motor.kind == MotorKind::Spindle => {
                    problem(format!(
                        "axes: {letter} = {number}: motor {number} is a spindle; write spindle = {number}"
                    ));
                }
                (Some(axis), Some(motor)) => of_axis[axis.index()] = Some(motor.clone()),
            }
        }
        if self.axes.is_empty() {
            problem("axes: write at least one".into());
        }
        let spindle = self.spindle.and_then(|number| motors.get(&number)).cloned();
        if let Some(number) = self.spindle
            && spindle
                .as_ref()
                .is_none_or(|motor| motor.kind != MotorKind::Spindle)
        {
            problem(format!(
                "spindle = {number}: there is no [[motor]] {number} of kind spindle"
            ));
        }
        CoordinateSystemSettings {
            number: self.number,
            motors: of_axis,
            spindle,
            max_feedrate_mm_min: self.max_feedrate,
            default_feedrate_mm_min: self.default_feedrate,
            default_ta_ms: self.default_ta_ms,
            default_td_ms: self.default_td_ms,
            default_ts_ms: self.default_ts_ms,
            rotary_feedrate_deg_min: self.rotary_feedrate,
            override_slew_ms: self.override_slew_ms,
            hold_slew_ms: self.hold_slew_ms,
            servo_period_s: servo_period_us as f64 / 1e6,
            motion: self.motion_options(skips),
        }
    }

    fn motion_options(&self, skips: &BTreeMap<u16, SimulatedSkip>) -> MotionOptions {
        let mut simulated_skip = [None; AXES_MAX];
        for (letter, number) in &self.axes {
            if let Some(axis) = axis(letter) {
                simulated_skip[axis.index()] = skips.get(number).copied();
            }
        }
        MotionOptions {
            arc_radius_tolerance_mm: self.arc_radius_tolerance,
            short_block: match self.short_block.as_str() {
                "extend" => ShortBlock::Extend,
                _ => ShortBlock::Shrink,
            },
            simulated_skip,
        }
    }

    fn work_offsets(&self, problem: &mut impl FnMut(String)) -> WorkOffsets {
        const NAMES: [&str; 6] = ["G54", "G55", "G56", "G57", "G58", "G59"];
        let mut offsets = WorkOffsets::default();
        for (name, values) in &self.work_offset {
            let Some(index) = NAMES.iter().position(|known| known == name) else {
                let known = nearest(name, NAMES.into_iter()).unwrap_or("G54");
                problem(format!(
                    "work_offset: unknown key `{name}`; did you mean `{known}`?"
                ));
                continue;
            };
            let mut offset = AxisVector::ZERO;
            for (letter, value) in values {
                match axis(letter) {
                    Some(axis) if self.axes.contains_key(letter) && value.is_finite() => {
                        offset[axis] = *value;
                    }
                    _ => problem(format!(
                        "work_offset.{name}: {letter} = {value}: write an axis of this coordinate system and a number"
                    )),
                }
            }
            offsets.0[index] = offset;
        }
        offsets
    }
}

fn axis(letter: &str) -> Option<Axis> {
    let mut letters = letter.chars();
    letters
        .next()
        .filter(|_| letters.next().is_none())
        .and_then(Axis::from_letter)
}

#[cfg(test)]
mod tests {
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
    fn defaults_are_those_of_the_interface_page() {
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
