//! Motor positions that simulated drives keep across restarts.

use std::collections::{BTreeMap, BTreeSet};

use plc_protocol::types::CoordinateSystemNumber;
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{Axis, MachinePosition};

use super::image::Image;
use crate::tables::{KeptValues, LOST_VALUE, keep, value_key};

/// First part of the name of a coordinate system's stored positions.
pub const POSITION: &str = "position";

/// Machine position by motor number.
pub type MotorPositions = BTreeMap<u16, f64>;

/// Rest positions of coordinate systems.
pub type RestPositions = BTreeMap<CoordinateSystemNumber, MotorPositions>;

/// Returns the motors of a coordinate system, each with its axis.
fn motors(settings: &CoordinateSystemSettings) -> impl Iterator<Item = (Axis, u16)> {
    let all = Axis::ALL.into_iter().zip(&settings.motors);
    all.filter_map(|(axis, motor)| Some((axis, motor.as_ref()?.number)))
}

/// Returns the motor positions to store, from the machine position in one servo cycle.
pub fn positions(settings: &CoordinateSystemSettings, at: MachinePosition) -> MotorPositions {
    motors(settings)
        .map(|(axis, motor)| (motor, at.0[axis]))
        .collect()
}

/// Stored motor positions of a machine.
#[derive(Debug, Default)]
pub struct KeptPositions {
    by_motor: MotorPositions,
    lost: BTreeSet<CoordinateSystemNumber>,
}

impl KeptPositions {
    /// Combines stored positions with newer rest positions. A motor keeps its position if the configuration
    /// has moved it to another coordinate system since.
    pub fn new(image: &Image, rests: &RestPositions) -> Self {
        let mut kept = Self::default();
        let newer = rest_positions(image, rests);
        for (name, bytes) in image.values.iter().chain(&newer) {
            let Some(Ok(cs)) = name.strip_prefix(&format!("{POSITION}/")).map(str::parse) else {
                continue;
            };
            match serde_json::from_slice::<MotorPositions>(bytes) {
                Ok(positions) if bytes != LOST_VALUE => kept.by_motor.extend(positions),
                _ => drop(kept.lost.insert(cs)),
            }
        }
        kept
    }

    /// Returns the coordinate systems whose positions are lost.
    pub fn lost(&self) -> impl Iterator<Item = CoordinateSystemNumber> {
        self.lost.iter().copied()
    }

    /// Sets the simulated drives to their last positions. A drive whose position is lost is not homed.
    pub fn apply(&self, settings: &mut CoordinateSystemSettings) {
        let is_lost = self.lost.contains(&settings.number);
        for motor in settings.motors.iter_mut().flatten() {
            match self.by_motor.get(&motor.number) {
                Some(position) => motor.start_at = *position,
                None if is_lost => motor.is_homed_at_start = false,
                None => {}
            }
        }
    }

    /// Describes the motors whose position is outside their soft limits, because the limits have changed
    /// since.
    pub fn outside(&self, settings: &CoordinateSystemSettings) -> Vec<String> {
        let motors = motors(settings).zip(settings.motors.iter().flatten());
        let outside = motors.filter_map(|((axis, number), motor)| {
            let (at, [low, high]) = (*self.by_motor.get(&number)?, motor.soft_limits?);
            let is_inside = (low..=high).contains(&at);
            (!is_inside).then(|| {
                let letter = axis.letter();
                format!("axis {letter} is at {at}, outside its soft limits of {low} to {high}")
            })
        });
        outside.collect()
    }
}

/// Returns rest positions that are newer than the store, which lags. A position that the store marks as lost
/// stays lost.
pub fn rest_positions(image: &Image, rests: &RestPositions) -> KeptValues {
    let mut values = KeptValues::new();
    for (cs, positions) in rests {
        let key = position_key(*cs);
        if image.values.get(&key).is_none_or(|kept| kept != LOST_VALUE) {
            keep(&mut values, key, positions);
        }
    }
    values
}

/// Returns the name of the stored positions of a coordinate system.
pub fn position_key(cs: CoordinateSystemNumber) -> String {
    value_key(POSITION, cs)
}

#[cfg(test)]
mod tests {
    use tandem_model::AxisVector;
    use tandem_model::settings::{MotorKind, MotorSettings};

    use super::*;

    fn settings(number: u8, motors: [u16; 2]) -> CoordinateSystemSettings {
        let motor = |place: usize| {
            let number = *motors.get(place)?;
            Some(MotorSettings {
                soft_limits: Some([-10.0, 10.0]),
                ..MotorSettings::new(number, MotorKind::Linear, 500.0, 5000.0)
            })
        };
        CoordinateSystemSettings {
            number,
            motors: std::array::from_fn(motor),
            ..CoordinateSystemSettings::default()
        }
    }

    fn started(image: &Image, number: u8, motors: [u16; 2]) -> Vec<(f64, bool)> {
        let mut settings = settings(number, motors);
        KeptPositions::new(image, &RestPositions::new()).apply(&mut settings);
        let motors = settings.motors.iter().flatten();
        motors
            .map(|motor| (motor.start_at, motor.is_homed_at_start))
            .collect()
    }

    #[test]
    fn positions_are_bit_exact_and_follow_their_motors() {
        let at = MachinePosition(AxisVector(std::array::from_fn(|i| 0.1 * i as f64 + 1.0 / 3.0)));
        let mut image = Image::default();
        keep(
            &mut image.values,
            position_key(1),
            &positions(&settings(1, [7, 8]), at),
        );
        assert_eq!(
            started(&image, 1, [7, 8]),
            [(1.0 / 3.0, true), (0.1 + 1.0 / 3.0, true)]
        );
        // Motor 8 was in coordinate system 1 before; motor 9 is new.
        assert_eq!(started(&image, 2, [8, 9]), [(0.1 + 1.0 / 3.0, true), (0.0, true)]);
    }

    #[test]
    fn a_lost_position_is_not_taken_for_a_homed_motor() {
        let mut image = Image::default();
        image.lose(&position_key(1));
        assert_eq!(started(&image, 1, [7, 8]), [(0.0, false); 2]);
        assert_eq!(started(&image, 2, [9, 10]), [(0.0, true); 2]);
        assert_eq!(
            KeptPositions::new(&image, &RestPositions::new())
                .lost()
                .collect::<Vec<_>>(),
            [1]
        );
    }

    #[test]
    fn a_position_at_rest_is_newer_than_the_store_but_no_lost_one_returns() {
        let mut image = Image::default();
        let at = |x: f64| MotorPositions::from([(7, x)]);
        keep(&mut image.values, position_key(1), &at(1.0));
        image.lose(&position_key(2));
        let rests = RestPositions::from([(1, at(1.5)), (2, at(2.5)), (3, MotorPositions::from([(9, 3.5)]))]);
        let kept = KeptPositions::new(&image, &rests);
        assert_eq!(kept.by_motor, MotorPositions::from([(7, 1.5), (9, 3.5)]));
        assert_eq!(kept.lost().collect::<Vec<_>>(), [2]);
    }

    #[test]
    fn a_motor_outside_changed_soft_limits_is_named() {
        let at = MachinePosition(AxisVector(std::array::from_fn(
            |i| if i == 0 { 12.0 } else { 3.0 },
        )));
        let mut image = Image::default();
        keep(
            &mut image.values,
            position_key(1),
            &positions(&settings(1, [7, 8]), at),
        );
        let outside = KeptPositions::new(&image, &RestPositions::new()).outside(&settings(1, [7, 8]));
        assert_eq!(outside.len(), 1);
        assert!(outside[0].starts_with("axis X is at 12, outside"), "{outside:?}");
    }
}
