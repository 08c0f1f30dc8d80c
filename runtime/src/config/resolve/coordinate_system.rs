//! `[[coordinate_system]]`.

use std::collections::BTreeMap;

use tandem_interp::codes::work_offset::NAMES;
use tandem_model::settings::{
    CoordinateSystemSettings, MotionOptions, MotorKind, MotorSettings, SimulatedSkip, WorkOffsets,
};
use tandem_model::{AXES_MAX, Axis, AxisVector};

use super::super::error::nearest;
use super::super::{CoordinateSystemConfig, POSITION_MAX};
use super::Ranges;

impl CoordinateSystemConfig {
    pub(super) fn check(&self, problem: &mut impl FnMut(String)) {
        if self.number == 0 {
            problem("coordinate systems count from 1".into());
        }
        let ranges = Ranges::of::<Self>();
        [
            ("max_feedrate", self.max_feedrate),
            ("default_feedrate", self.default_feedrate),
            ("default_ta_ms", self.default_ta_ms),
            ("default_td_ms", self.default_td_ms),
            ("default_ts_ms", self.default_ts_ms),
            ("rotary_feedrate", self.rotary_feedrate),
            ("dry_run_feedrate", self.dry_run_feedrate),
            ("arc_radius_tolerance", self.arc_radius_tolerance),
            ("spiral_tolerance", self.spiral_tolerance),
            ("override_slew_ms", self.override_slew_ms),
            ("hold_slew_ms", self.hold_slew_ms),
            ("pre_read_blocks", self.pre_read_blocks as f64),
            ("open_outputs_max", self.open_outputs_max as f64),
        ]
        .into_iter()
        .filter_map(|number| ranges.problem(number))
        .for_each(problem);
    }

    pub(super) fn settings(
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
                (Some(axis), _) if !letter.contains(axis.letter()) => {
                    problem(format!("axes: {letter} = {number}: write {}", axis.letter()));
                }
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
            unit: self.units,
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
            dry_run_feedrate_mm_min: self.dry_run_feedrate,
            spiral_tolerance_mm: self.spiral_tolerance,
            compensation_feed: self.compensation_feed,
            overcut: self.overcut,
            short_block: self.short_block,
            simulated_skip,
        }
    }

    pub(super) fn work_offsets(&self, problem: &mut impl FnMut(String)) -> WorkOffsets {
        let mut offsets = WorkOffsets::default();
        for (name, values) in &self.work_offset {
            let Some(index) = NAMES.iter().position(|known| known == name) else {
                let known = nearest(name, NAMES.into_iter()).unwrap_or(NAMES[0]);
                problem(format!(
                    "work_offset: unknown key `{name}`; did you mean `{known}`?"
                ));
                continue;
            };
            let mut offset = AxisVector::ZERO;
            for (letter, value) in values {
                match axis(letter) {
                    Some(axis) if self.axes.contains_key(letter) && value.abs() <= POSITION_MAX => {
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
