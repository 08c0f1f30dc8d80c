//! What a machine publishes of itself: presence, and its birth message.

use plc_api::types::machine::{Birth, CoordinateSystemInfo, Limits, MCodeInfo, MotorInfo, Presence};
use plc_api::types::output::Timing;
use tandem_model::Axis;
use tandem_model::limits::PROGRAM_BYTES_MAX;
use tandem_model::settings::{MotorKind, Unit};

use crate::config::{CoordinateSystem, Machine};
use crate::shared::Shared;

pub(super) fn presence(shared: &Shared, online: bool) -> Presence {
    Presence {
        online,
        started_at: shared.timestamp(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        broker: None,
    }
}

pub(super) fn birth(machine: &Machine) -> Birth {
    let systems = machine.coordinate_systems.iter().map(|system| {
        let axes = system.settings.axes();
        let motor = |axis: Axis| {
            let motor = system.settings.motors[axis.index()].as_ref()?;
            Some((axis.letter().to_string(), motor.number))
        };
        CoordinateSystemInfo {
            number: system.settings.number,
            axes: axes.iter().filter_map(motor).collect(),
            spindle: system.settings.spindle.as_ref().map(|motor| motor.number),
            dialect: system.dialect.name.to_owned(),
            units: match system.settings.unit {
                Unit::Millimetre => "mm".to_owned(),
                Unit::Inch => "inch".to_owned(),
            },
        }
    });
    let motors = machine.motors.iter().map(|motor| MotorInfo {
        number: motor.number,
        kind: match motor.kind {
            MotorKind::Linear => "linear".to_owned(),
            MotorKind::Rotary => "rotary".to_owned(),
            MotorKind::Spindle => "spindle".to_owned(),
        },
        soft_limits: motor.soft_limits,
        max_velocity: motor.max_velocity,
    });
    let first = machine.coordinate_systems.first();
    let default_timing = first.map_or_else(Timing::default, CoordinateSystem::default_timing);
    let m_codes = machine.m_codes.iter().map(|(m, settings)| {
        let info = MCodeInfo {
            timing: settings.timing.unwrap_or(default_timing),
            timeout_ms: settings.timeout_ms,
            wait_state: settings.wait_state.clone(),
        };
        (*m, info)
    });
    let open_outputs = machine
        .coordinate_systems
        .iter()
        .map(|system| system.open_outputs_max);
    let open_outputs_max = open_outputs.max().unwrap_or_default();
    Birth {
        machine: machine.name.clone(),
        servo_period_us: machine.servo_period_us,
        coordinate_systems: systems.collect(),
        motors: motors.collect(),
        m_codes: m_codes.collect(),
        limits: Limits {
            open_outputs_max: u32::try_from(open_outputs_max).unwrap_or(u32::MAX),
            program_bytes_max: PROGRAM_BYTES_MAX as u64,
        },
    }
}
