//! The message `birth`, in which a machine describes itself.

use std::collections::BTreeMap;

use plc_protocol::types::machine::{Birth, CoordinateSystemInfo, Limits, MCodeInfo, MotorInfo, ServedMCode};
use plc_protocol::types::output::{HandlerPresence, Timing};
use tandem_config::{ConfiguredSystem, Machine};
use tandem_model::Axis;
use tandem_model::limits::{M_CODE_MAX, PROGRAM_BYTES_MAX};
use tandem_model::settings::{MotorKind, Unit};

use crate::sequence::stock;

/// Returns the description of the machine, with the handlers of its M codes.
pub(crate) fn birth(machine: &Machine, handlers: &BTreeMap<String, HandlerPresence>) -> Birth {
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
    let default_timing = first.map_or_else(Timing::default, ConfiguredSystem::default_timing);
    let m_codes = machine.m_codes.iter().map(|(m, settings)| {
        let info = MCodeInfo {
            timing: settings.timing.unwrap_or(default_timing),
            timeout_ms: settings.timeout_ms,
            wait_state: settings.wait_state.clone(),
            name: settings
                .declared
                .as_ref()
                .and_then(|declared| declared.name.clone()),
            params: settings
                .declared
                .as_ref()
                .and_then(|declared| declared.params.clone()),
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
        identification: machine.identification.clone(),
        servo_period_us: machine.servo_period_us,
        coordinate_systems: systems.collect(),
        motors: motors.collect(),
        m_codes: m_codes.collect(),
        serves: serves(machine, handlers),
        io: machine.io.clone(),
        limits: Limits {
            open_outputs_max: u32::try_from(open_outputs_max).unwrap_or(u32::MAX),
            program_bytes_max: PROGRAM_BYTES_MAX as u64,
        },
    }
}

/// Maximum number of M codes in `birth` that are listed with their handlers; further M codes are omitted. Reason: all
/// of them are in one message.
const SERVES_MAX: usize = 1000;

/// Returns the handlers of each M code, including the stock sequence program.
fn serves(machine: &Machine, handlers: &BTreeMap<String, HandlerPresence>) -> Vec<ServedMCode> {
    let mut all: Vec<ServedMCode> = Vec::new();
    for m in 0..=M_CODE_MAX {
        let is_stock = machine
            .m_codes
            .get(&m)
            .is_some_and(|settings| settings.stock.is_some());
        let is_served = |system: &&ConfiguredSystem| {
            is_stock || system.settings.spindle.is_some() && stock::is_spindle_code(m)
        };
        let systems = machine.coordinate_systems.iter().filter(is_served);
        let cs: Vec<_> = systems.map(|system| system.settings.number).collect();
        if !cs.is_empty() {
            all.push(ServedMCode {
                m,
                cs,
                ..ServedMCode::default()
            });
        }
    }
    all.extend(handlers.iter().flat_map(|(id, handler)| handler.served(id)));
    for one in &mut all {
        let settings = machine.m_codes.get(&one.m);
        let Some(declared) = settings.and_then(|settings| settings.declared.as_ref()) else {
            continue;
        };
        one.name = one.name.take().or_else(|| declared.name.clone());
        one.params = one.params.take().or_else(|| declared.params.clone());
    }
    all.sort_by_key(|one| one.m);
    all.truncate(SERVES_MAX);
    all
}
