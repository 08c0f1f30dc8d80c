//! `[[coordinate_system]]`.

use std::collections::BTreeMap;

use tandem_model::settings::{
    CompensationFeed, CoordinateSystemSettings, MotionOptions, MotorKind, MotorSettings, Overcut, ShortBlock,
    SimulatedSkip, Unit, WorkOffsets,
};
use tandem_model::{AXES_MAX, Axis, AxisVector};

use super::super::CoordinateSystemConfig;
use super::super::error::nearest;
use super::{POSITION_MAX, out_of_range};

impl CoordinateSystemConfig {
    pub(super) fn check(&self, problem: &mut impl FnMut(String)) {
        if self.number == 0 {
            problem("coordinate systems count from 1".into());
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
            ("dry_run_feedrate", self.dry_run_feedrate, 0.0, 1e9),
            ("arc_radius_tolerance", self.arc_radius_tolerance, 0.0, 1e6),
            ("spiral_tolerance", self.spiral_tolerance, 0.0, 1e6),
            ("override_slew_ms", self.override_slew_ms, 1.0, 60_000.0),
            ("hold_slew_ms", self.hold_slew_ms, 1.0, 60_000.0),
        ];
        ranges
            .into_iter()
            .filter_map(out_of_range)
            .for_each(&mut *problem);
        if !(16..=1_000_000).contains(&self.pre_read_blocks) {
            problem("pre_read_blocks: write 16 to 1000000".into());
        }
        if !(1..=1024).contains(&self.open_outputs_max) {
            problem("open_outputs_max: write 1 to 1024".into());
        }
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
            unit: if self.units == "inch" {
                Unit::Inch
            } else {
                Unit::Millimetre
            },
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
            compensation_feed: match self.compensation_feed.as_str() {
                "edge" => CompensationFeed::Edge,
                _ => CompensationFeed::Centre,
            },
            overcut: match self.overcut.as_str() {
                "prevent" => Overcut::Prevent,
                _ => Overcut::Detect,
            },
            short_block: match self.short_block.as_str() {
                "extend" => ShortBlock::Extend,
                _ => ShortBlock::Shrink,
            },
            simulated_skip,
        }
    }

    pub(super) fn work_offsets(&self, problem: &mut impl FnMut(String)) -> WorkOffsets {
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
