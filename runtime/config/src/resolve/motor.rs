//! Checks and converts `[[motor]]`, `[[simulated_skip]]` and `[[simulated_round]]`.

use std::collections::BTreeMap;

use tandem_model::settings::{MotorKind, MotorSettings, SimulatedRound, SimulatedSkip};

use super::super::text::Problems;
use super::super::{Config, EncoderKind, MotorConfig, POSITION_MAX, RoundKind};

impl Config {
    /// Returns the settings of the motors by number.
    pub(super) fn motors(&self, problems: &mut Problems<'_>) -> BTreeMap<u16, MotorSettings> {
        let mut motors = BTreeMap::new();
        for (index, motor) in self.motor.iter().enumerate() {
            let name = format!("[[motor]] number = {}: ", motor.number);
            let mut checked = problems.check_table(format!("motor.{index}"), name);
            checked.check_ranges(motor, &["soft_limits"]);
            if let Some([low, high]) = motor.soft_limits
                && !(-POSITION_MAX <= low && low < high && high <= POSITION_MAX)
            {
                let text = format!(
                    "soft_limits = [{low}, {high}]: write [lowest, highest], within {POSITION_MAX} of 0"
                );
                checked.problem("soft_limits", text);
            }
            if let Some(at) = motor.start_at {
                let [low, high] = motor.soft_limits.unwrap_or([-POSITION_MAX, POSITION_MAX]);
                if motor.kind == MotorKind::Spindle {
                    let text = format!("start_at = {at}: a spindle has none; remove it");
                    checked.problem("start_at", text);
                } else if !(low..=high).contains(&at) {
                    let text =
                        format!("start_at = {at}: write a position within soft_limits, {low} to {high}");
                    checked.problem("start_at", text);
                }
            }
            if motors.insert(motor.number, motor.settings()).is_some() {
                checked.problem("number", "the number is listed twice");
            }
        }
        motors
    }

    /// Returns the simulated skip inputs by motor number; motors without a skip input have no entry.
    pub(super) fn simulated_skips(
        &self,
        motors: &BTreeMap<u16, MotorSettings>,
        problems: &mut Problems<'_>,
    ) -> BTreeMap<u16, SimulatedSkip> {
        let mut skips = BTreeMap::new();
        for (index, config) in self.simulated_skip.iter().enumerate() {
            let number = config.motor;
            let name = format!("[[simulated_skip]] motor = {number}: ");
            let mut checked = problems.check_table(format!("simulated_skip.{index}"), name);
            let motor = motors.get(&number);
            if motor.is_none_or(|motor| motor.kind == MotorKind::Spindle) {
                checked.problem("motor", format!("there is no [[motor]] {number} of an axis"));
            }
            let skip = match (config.below, config.above) {
                (Some(below), None) if below.abs() <= POSITION_MAX => SimulatedSkip::Below(below),
                (None, Some(above)) if above.abs() <= POSITION_MAX => SimulatedSkip::Above(above),
                _ => {
                    checked.problem("", "write a position for either below or above");
                    continue;
                }
            };
            if skips.insert(number, skip).is_some() {
                checked.problem("motor", "the motor is listed twice");
            }
        }
        skips
    }

    /// Returns the object that a simulated probe touches, by coordinate system.
    pub(super) fn simulated_rounds(&self, problems: &mut Problems<'_>) -> BTreeMap<u8, SimulatedRound> {
        let mut rounds = BTreeMap::new();
        for (index, config) in self.simulated_round.iter().enumerate() {
            let number = config.coordinate_system;
            let name = format!("[[simulated_round]] coordinate_system = {number}: ");
            let mut checked = problems.check_table(format!("simulated_round.{index}"), name);
            checked.check_ranges(config, &["coordinate_system"]);
            let mut systems = self.coordinate_system.iter();
            let has_plane =
                |axes: &BTreeMap<String, u16>| ["X", "Y"].iter().all(|axis| axes.contains_key(*axis));
            if !systems.any(|system| system.number == number && has_plane(&system.axes)) {
                let text = format!("there is no [[coordinate_system]] {number} with X and Y");
                checked.problem("coordinate_system", text);
            }
            let is_bore = config.kind == RoundKind::Bore;
            if is_bore && config.ball >= config.diameter {
                let text = format!(
                    "ball = {}: write less than the diameter of the bore, {}",
                    config.ball, config.diameter
                );
                checked.problem("ball", text);
            }
            let ball = if is_bore { -config.ball } else { config.ball };
            let round = SimulatedRound {
                centre: [config.x, config.y],
                radius: f64::midpoint(config.diameter, ball),
                is_bore,
                below: config.below.unwrap_or(f64::INFINITY),
            };
            if rounds.insert(number, round).is_some() {
                checked.problem("coordinate_system", "the coordinate system is listed twice");
            }
        }
        rounds
    }
}

impl MotorConfig {
    /// Returns 0 if the soft limits allow that position, otherwise the nearest soft limit.
    fn position_near_zero(&self) -> f64 {
        match self.soft_limits {
            Some([low, high]) if low > 0.0 && low < high => low,
            Some([low, high]) if high < 0.0 && low < high => high,
            _ => 0.0,
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
            at_speed_percent: self.at_speed_percent,
            start_at: self.start_at.unwrap_or_else(|| self.position_near_zero()),
            is_homed_at_start: self.encoder == EncoderKind::Absolute,
            orientation_velocity: self.orientation_velocity,
            orientation_position: self.orientation_position,
        }
    }
}
