//! Checks and converts `[[coordinate_system]]`.

use std::collections::BTreeMap;

use tandem_interp::codes::work_offset::NAMES;
use tandem_model::settings::{
    CoordinateSystemSettings, MCodeSet, MotionOptions, MotorKind, MotorSettings, SimulatedRound,
    SimulatedSkip, WorkOffsets,
};
use tandem_model::{AXES_MAX, Axis};

use super::super::error::nearest;
use super::super::{CoordinateSystemConfig, POSITION_MAX};
use super::TableCheck;

impl CoordinateSystemConfig {
    pub(super) fn settings(
        &self,
        motors: &BTreeMap<u16, MotorSettings>,
        servo_period_us: u64,
        (skips, rounds): (&BTreeMap<u16, SimulatedSkip>, &BTreeMap<u8, SimulatedRound>),
        m_codes: MCodeSet,
        checked: &mut TableCheck<'_, '_>,
    ) -> CoordinateSystemSettings {
        let mut of_axis: [Option<MotorSettings>; AXES_MAX] = [const { None }; AXES_MAX];
        let mut simulated_skip = [None; AXES_MAX];
        for (letter, number) in &self.axes {
            let wrong = match (axis(letter), motors.get(number)) {
                (None, _) => " is not an axis; write X Y Z A B C U or V".to_owned(),
                (Some(axis), _) if !letter.contains(axis.letter()) => {
                    format!(" = {number}: write {}", axis.letter())
                }
                (_, None) => format!(" = {number}: there is no [[motor]] {number}"),
                (Some(_), Some(motor)) if motor.kind == MotorKind::Spindle => {
                    format!(" = {number}: motor {number} is a spindle; write spindle = {number}")
                }
                (Some(axis), Some(motor)) => {
                    of_axis[axis.index()] = Some(motor.clone());
                    simulated_skip[axis.index()] = skips.get(number).copied();
                    continue;
                }
            };
            checked.problem(&format!("axes.{letter}"), format!("axes: {letter}{wrong}"));
        }
        if self.axes.is_empty() {
            checked.problem("axes", "axes: write at least one axis");
        }
        let spindle = self.spindle.and_then(|number| motors.get(&number));
        let spindle = spindle.filter(|motor| motor.kind == MotorKind::Spindle).cloned();
        if let (Some(number), None) = (self.spindle, &spindle) {
            let text = format!("spindle = {number}: there is no [[motor]] {number} of kind spindle");
            checked.problem("spindle", text);
        }
        let ramp_ms = |time| if self.dialect.has_ramp_times() { time } else { 0.0 };
        CoordinateSystemSettings {
            number: self.number,
            motors: of_axis,
            spindle,
            unit: self.units,
            max_feedrate_mm_min: self.max_feedrate,
            default_feedrate_mm_min: self.default_feedrate,
            default_ta_ms: ramp_ms(self.default_ta_ms),
            default_td_ms: ramp_ms(self.default_td_ms),
            default_ts_ms: ramp_ms(self.default_ts_ms),
            rotary_feedrate_deg_min: self.rotary_feedrate,
            override_slew_ms: self.override_slew_ms,
            hold_slew_ms: self.hold_slew_ms,
            servo_period_s: servo_period_us as f64 / 1e6,
            blocks_without_motion_max: u32::try_from(self.blocks_without_motion_max).unwrap_or(u32::MAX),
            path: self.dialect.path,
            nc: self.nc_options(m_codes, checked),
            motion: MotionOptions {
                path_tolerance_mm: self.path_tolerance,
                corner_warning_mm: self.corner_warning,
                low_override: self.low_override,
                arc_radius_tolerance_mm: self.arc_radius_tolerance,
                dry_run_feedrate_mm_min: self.dry_run_feedrate,
                spiral_tolerance_mm: self.spiral_tolerance,
                compensation_feed: self.compensation_feed,
                overcut: self.overcut,
                short_block: self.short_block,
                simulated_skip,
                simulated_round: rounds.get(&self.number).copied(),
            },
        }
    }

    pub(super) fn work_offsets(&self, checked: &mut TableCheck<'_, '_>) -> WorkOffsets {
        let mut offsets = WorkOffsets::default();
        for (name, values) in &self.work_offset {
            let key = format!("work_offset.{name}");
            let Some(index) = NAMES.iter().position(|known| known == name) else {
                let known = nearest(name, NAMES.into_iter()).unwrap_or(NAMES[0]);
                let text = format!("work_offset: unknown key `{name}`; did you mean `{known}`?");
                checked.problem(&key, text);
                continue;
            };
            for (letter, value) in values {
                match axis(letter) {
                    Some(axis) if self.axes.contains_key(letter) && value.abs() <= POSITION_MAX => {
                        offsets.0[index][axis] = *value;
                    }
                    _ => checked.problem(
                        &format!("{key}.{letter}"),
                        format!(
                            "{key}: {letter} = {value}: write an axis of this coordinate system and a number"
                        ),
                    ),
                }
            }
        }
        offsets
    }
}

pub(super) fn axis(letter: &str) -> Option<Axis> {
    letter.parse().ok().and_then(Axis::from_letter)
}
