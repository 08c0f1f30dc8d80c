//! Words that fixed cycles have in common, and the effect of a block with these words (D42).
//!
//! All levels are programmed positions. The initial level is Z at the start of the cycle, not at the start of
//! each block. Reason: in the manual's examples, the last hole returns with G98 to the level before the first
//! hole. In G91 all holes have the same R and Z point.

use tandem_model::alarm::FIXED_CYCLE_REFUSED;
use tandem_model::flow::{AxisWords, Distance};
use tandem_model::{Alarm, Axis};
use tandem_syntax::Address;

use super::{POSITION_MAX, WordSpec, axis_word};
use crate::execution::Execution;
use crate::fixed_cycles::{Expansion, FixedCycle, Hole, Peck};
use crate::meaning::ReturnLevel;
use crate::modal::CycleLevel;

/// X, Y, Z, R, P and K with their ranges (manual 2, utilities).
pub static CYCLE_WORDS: [WordSpec; 6] = [
    axis_word(Address::X),
    axis_word(Address::Y),
    WordSpec::new(Address::Z, "Z point", "mm", -POSITION_MAX, POSITION_MAX),
    WordSpec::new(Address::R, "R point", "mm", -POSITION_MAX, POSITION_MAX),
    WordSpec::new(Address::P, "dwell at the Z point", "ms", 0.0, 100_000_000.0),
    WordSpec::new(Address::K, "number of repetitions", "", 0.0, 10_000.0).whole(),
];

/// Stores the words of a block in the active fixed cycle, and starts the steps of the cycle.
pub fn run(execution: &mut Execution<'_>, words: AxisWords) {
    store_cycle_words(execution, words.distance);
    let kept = execution.modal.cycle;
    let in_force = execution.modal.in_force.cycle.flatten();
    let (Some(cycle), Some(z), Some(r)) = (in_force, kept.z, kept.r) else {
        let text = "the fixed cycle has no Z point or no R point";
        execution.refuse(Alarm::new(&FIXED_CYCLE_REFUSED, text));
        return;
    };
    let initial = initial_level(execution);
    let r_point = r.above(initial);
    start_cycle(execution, words, cycle, HoleLevels { initial, r_point, z });
}

/// Levels of a hole, mm; the initial level and the R point are programmed positions.
#[derive(Clone, Copy)]
pub(super) struct HoleLevels {
    pub initial: f64,
    pub r_point: f64,
    pub z: CycleLevel,
}

/// Starts the steps of the cycle for one block. In G91, Z is a distance from the R point.
pub(super) fn start_cycle(
    execution: &mut Execution<'_>,
    position: AxisWords,
    cycle: &'static FixedCycle,
    levels: HoleLevels,
) {
    let HoleLevels { initial, r_point, z } = levels;
    let kept = execution.modal.cycle;
    let z_point = z.above(r_point);
    let returns = execution.modal.in_force.return_level == Some(ReturnLevel::Initial);
    let speed = execution.modal.spindle_speed_r_min;
    let peck = kept.peck.filter(|depth| *depth > 0.0).map(|depth| Peck {
        depth,
        clearance: execution.limits.options.peck_clearance_mm,
    });
    let hole = Hole {
        position,
        r_point,
        z_point,
        initial: returns.then_some(initial),
        dwell_s: kept.dwell_s.unwrap_or_default(),
        spindle_speed_r_min: execution.limits.has_spindle.then_some(speed),
        repetitions: kept.repetitions.unwrap_or(1),
        peck,
    };
    execution.draft.cycle = Some(Box::new(Expansion::new(cycle, hole)));
}

/// Stores the words of a block that the cycle keeps.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the range has been checked, and a cast saturates"
)]
pub(super) fn store_cycle_words(execution: &mut Execution<'_>, distance: Distance) {
    let level = |address| {
        execution
            .length(address)
            .map(|value| CycleLevel { value, distance })
    };
    let (z, r) = (level(Address::Z), level(Address::R));
    let dwell_s = execution.words.get(Address::P).map(|time| time / 1000.0);
    let repetitions = execution.words.get(Address::K).map(|count| count as u16);
    let peck = execution.length(Address::Q).map(f64::abs);
    let kept = &mut execution.modal.cycle;
    kept.z = z.or(kept.z);
    kept.r = r.or(kept.r);
    kept.dwell_s = dwell_s.or(kept.dwell_s);
    kept.repetitions = repetitions.or(kept.repetitions);
    kept.peck = peck.or(kept.peck);
}

/// Returns the initial level: Z at the start of the cycle, as a programmed position. The first block stores
/// the tool's Z.
pub(super) fn initial_level(execution: &mut Execution<'_>) -> f64 {
    let initial = execution.modal.cycle.initial.unwrap_or_else(|| {
        let position = execution.position();
        execution.modal.transform.inverse(position)[Axis::Z]
    });
    execution.modal.cycle.initial = Some(initial);
    initial
}
