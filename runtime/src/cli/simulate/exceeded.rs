//! Limits of the motors that a run exceeds, such as `max_acceleration` with G501.

use serde_json::{Value, json};
use tandem_model::Origin;
use tandem_model::settings::{MotorKind, MotorSettings};

/// Factor of a limit from which it is exceeded. Less is rounding of the differences of setpoints.
const EXCEEDED_FROM: f64 = 1.001;

/// Quantities with a limit, in the order of the derivatives of the position.
const QUANTITIES: [&str; 3] = ["velocity", "acceleration", "jerk"];

/// The largest factor by which a motor exceeds each of its limits.
#[derive(Debug, Clone)]
pub(super) struct ExceededLimits {
    letter: char,
    number: u16,
    unit: &'static str,
    /// Limits at feedrate, and in rapid motion.
    limits: [[f64; 3]; 2],
    worst: [Option<Excess>; 3],
}

/// A limit that is exceeded.
#[derive(Debug, Clone, Copy)]
struct Excess {
    factor: f64,
    value: f64,
    is_rapid: bool,
    at: Origin,
}

impl ExceededLimits {
    pub fn new(letter: char, motor: &MotorSettings) -> Self {
        let jerk = motor.max_jerk.unwrap_or(f64::INFINITY);
        Self {
            letter,
            number: motor.number,
            unit: if motor.kind == MotorKind::Linear {
                "mm"
            } else {
                "deg"
            },
            limits: [
                [motor.max_velocity, motor.max_acceleration, jerk],
                [
                    motor.rapid_velocity.max(motor.skip_velocity),
                    motor.rapid_acceleration,
                    jerk,
                ],
            ],
            worst: [None; 3],
        }
    }

    /// Compares velocity, acceleration and jerk of a servo cycle with the limits.
    pub fn compare(&mut self, values: [f64; 3], is_rapid: bool, at: Origin) {
        let limits = self.limits[usize::from(is_rapid)];
        for ((value, limit), worst) in values.into_iter().zip(limits).zip(&mut self.worst) {
            let factor = value.abs() / limit;
            if factor > worst.map_or(EXCEEDED_FROM, |worst| worst.factor) {
                *worst = Some(Excess {
                    factor,
                    value: value.abs(),
                    is_rapid,
                    at,
                });
            }
        }
    }

    /// Returns a warning for each exceeded limit.
    pub fn warnings(&self) -> impl Iterator<Item = Value> {
        (self.worst.iter().enumerate()).filter_map(|(quantity, worst)| {
            let excess = worst.as_ref()?;
            let limit = self.limits[usize::from(excess.is_rapid)][quantity];
            let kind = if excess.is_rapid && quantity < 2 {
                "rapid"
            } else {
                "max"
            };
            let (unit, power) = (self.unit, ["", "2", "3"][quantity]);
            Some(json!({
                "program": excess.at.program,
                "line": excess.at.line,
                "text": format!(
                    "motor {} ({}) moves at {:.3} {unit}/s{power}, {:.2} times its {kind}_{} of {limit:.3}",
                    self.number, self.letter, excess.value, excess.factor, QUANTITIES[quantity],
                ),
            }))
        })
    }
}
