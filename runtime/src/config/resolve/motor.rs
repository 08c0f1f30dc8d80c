//! `[[motor]]` and `[[simulated_skip]]`.

use std::collections::BTreeMap;

use tandem_model::settings::{MotorKind, MotorSettings, SimulatedSkip};

use super::super::{Config, MotorConfig, MotorKindConfig};

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
