//! `[[motor]]` and `[[simulated_skip]]`.

use std::collections::BTreeMap;

use tandem_model::settings::{MotorKind, MotorSettings, SimulatedSkip};

use super::super::{Config, MotorConfig, POSITION_MAX};
use super::Ranges;

impl Config {
    /// The motors by number.
    pub(super) fn motors(&self, problems: &mut Vec<String>) -> BTreeMap<u16, MotorSettings> {
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

    /// The simulated skip input of each motor that has one.
    pub(super) fn simulated_skips(
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
                (Some(below), None) if below.abs() <= POSITION_MAX => SimulatedSkip::Below(below),
                (None, Some(above)) if above.abs() <= POSITION_MAX => SimulatedSkip::Above(above),
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
}

impl MotorConfig {
    fn check(&self, problems: &mut Vec<String>) {
        let mut problem = |text: String| problems.push(format!("[[motor]] number = {}: {text}", self.number));
        let optional = [
            ("max_jerk", self.max_jerk),
            ("rapid_velocity", self.rapid_velocity),
            ("rapid_acceleration", self.rapid_acceleration),
            ("skip_velocity", self.skip_velocity),
        ];
        let optional = optional
            .into_iter()
            .filter_map(|(key, value)| Some((key, value?)));
        let points = self.reference_points.map(|point| ("reference_points", point));
        let ranges = Ranges::of::<Self>();
        [
            ("max_velocity", self.max_velocity),
            ("max_acceleration", self.max_acceleration),
            ("orientation_velocity", self.orientation_velocity),
            ("in_position", self.in_position),
            ("in_position_timeout_ms", self.in_position_timeout_ms),
            ("lag_ms", self.lag_ms),
            ("orientation_position", self.orientation_position),
        ]
        .into_iter()
        .chain(optional)
        .chain(points)
        .filter_map(|number| ranges.problem(number))
        .for_each(&mut problem);
        if let Some([low, high]) = self.soft_limits
            && !(-POSITION_MAX <= low && low < high && high <= POSITION_MAX)
        {
            problem(format!(
                "soft_limits = [{low}, {high}]: write [lowest, highest], within {POSITION_MAX} of 0"
            ));
        }
    }

    fn settings(&self) -> MotorSettings {
        MotorSettings {
            number: self.number,
            kind: self.kind,
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
