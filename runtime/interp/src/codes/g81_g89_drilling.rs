//! G81 to G83, G85, G86 and G89 of dialect dgshape: drilling along Z (2-2).
//!
//! Z, R, P and Q stay until G80; K applies to its block only. Without Z, a block drills no hole; without R,
//! the R point is the initial level. These cycles neither start nor stop the spindle, so G86 moves like G81.

use tandem_model::flow::{Action, AxisWords};
use tandem_model::{Axis, AxisSet};
use tandem_syntax::Address;

use super::cycle_words::{HoleLevels, initial_level, start_cycle, store_cycle_words};
use super::{Code, POSITION_MAX, WordSpec, axis_word};
use crate::execution::Execution;
use crate::fixed_cycles::{CycleStep, FixedCycle, Level, Steps};
use crate::meaning::ModalValue;

const X: WordSpec = axis_word(Address::X);
const Y: WordSpec = axis_word(Address::Y);
const Z: WordSpec = WordSpec::new(
    Address::Z,
    "bottom of the hole",
    "mm",
    -POSITION_MAX,
    POSITION_MAX,
);
const R: WordSpec = WordSpec::new(Address::R, "R point", "mm", -POSITION_MAX, POSITION_MAX);
const K: WordSpec = WordSpec::new(Address::K, "number of repetitions", "", 0.0, 9999.0).whole();
const P: WordSpec = WordSpec::new(Address::P, "dwell at the bottom", "ms", 0.0, 3_600_000.0).whole();
const Q: WordSpec = WordSpec::new(Address::Q, "depth of each cut", "mm", -POSITION_MAX, POSITION_MAX);

static WORDS: [WordSpec; 5] = [X, Y, Z, R, K];
static WITH_DWELL: [WordSpec; 6] = [X, Y, Z, R, P, K];
static WITH_PECKS: [WordSpec; 6] = [X, Y, Z, R, Q, K];

/// Creates a cycle that moves into each hole and out of it by these steps.
const fn drilling(repetition: &'static [CycleStep]) -> FixedCycle {
    let steps = Steps::new(&[], repetition, &[]);
    FixedCycle {
        name: "a fixed cycle",
        needed: &[],
        with_spindle: steps,
        without_spindle: steps,
    }
}

const POSITION: CycleStep = CycleStep::Position;
const APPROACH: CycleStep = CycleStep::Approach;
const DOWN: CycleStep = CycleStep::Linear(Level::ZPoint);
const UP: CycleStep = CycleStep::Rapid(Level::Return);
const SLOWLY_UP: CycleStep = CycleStep::Linear(Level::RPoint);
const INITIAL: CycleStep = CycleStep::Rapid(Level::Initial);

static DRILL: FixedCycle = drilling(&[POSITION, APPROACH, DOWN, UP]);
static DRILL_AND_DWELL: FixedCycle = drilling(&[POSITION, APPROACH, DOWN, CycleStep::Dwell, UP]);
static PECK: FixedCycle = drilling(&[POSITION, APPROACH, CycleStep::Peck, UP]);
static BORE: FixedCycle = drilling(&[POSITION, APPROACH, DOWN, SLOWLY_UP, INITIAL]);
static BORE_AND_DWELL: FixedCycle =
    drilling(&[POSITION, APPROACH, DOWN, CycleStep::Dwell, SLOWLY_UP, INITIAL]);
static BORE_AND_OUT: FixedCycle = drilling(&[POSITION, APPROACH, DOWN, UP]);

const fn cycle(
    code: &'static str,
    of: &'static FixedCycle,
    words: &'static [WordSpec],
    docs: &'static str,
) -> Code {
    Code {
        words,
        motion: Some(run),
        ..Code::setting(ModalValue::Cycle(Some(of)), code, "Fixed Cycle", docs)
    }
}

/// G81: drilling.
pub static G81: Code = cycle(
    "G81",
    &DRILL,
    &WORDS,
    "Drills at X, Y: rapid to the R point, feed to Z, rapid to the initial level (G98) or the R point (G99), \
     K times. Each later block with a word of the cycle drills again until G80 or G00 to G03; Z and R stay, \
     K does not. If written in G91, R counts from the initial level and Z from R; a later G90 or G91 changes \
     neither. Without Z, only X and Y move; without R, the R point is the initial level. The spindle must \
     turn (M03), the plane must be XY, and A does not move.",
);
/// G82: drilling with a dwell at the bottom.
pub static G82: Code = cycle(
    "G82",
    &DRILL_AND_DWELL,
    &WITH_DWELL,
    "As G81, with a dwell of P milliseconds at the bottom.",
);
/// G83: drilling in several cuts.
pub static G83: Code = cycle(
    "G83",
    &PECK,
    &WITH_PECKS,
    "As G81, but in cuts of depth Q. After each cut, the tool moves to the R point, and back to \
     peck_clearance above the last depth, at rapid speed. The sign of Q has no effect; without Q, or with \
     Q0, the hole is drilled in one cut.",
);
/// G85: boring, with the return to the R point at the feedrate.
pub static G85: Code = cycle(
    "G85",
    &BORE,
    &WORDS,
    "As G81, but returns to the R point at the feedrate.",
);
/// G86: boring, with the motions of G81.
pub static G86: Code = cycle(
    "G86",
    &BORE_AND_OUT,
    &WORDS,
    "Moves as G81. The spindle continues to turn.",
);
/// G89: boring as by G85, with a dwell at the bottom.
pub static G89: Code = cycle(
    "G89",
    &BORE_AND_DWELL,
    &WITH_DWELL,
    "As G85, with a dwell of P milliseconds at the bottom.",
);

/// Stores the words of a block in the active fixed cycle, and starts the steps of the cycle.
fn run(execution: &mut Execution<'_>, words: AxisWords) {
    execution.modal.cycle.repetitions = None;
    store_cycle_words(execution, words.distance);
    let Some(cycle) = execution.modal.in_force.cycle.flatten() else {
        return;
    };
    let (kept, initial) = (execution.modal.cycle, initial_level(execution));
    let Some(z) = kept.z else {
        return only_position(execution, words);
    };
    let r_point = kept.r.map_or(initial, |r| r.above(initial));
    start_cycle(execution, words, cycle, HoleLevels { initial, r_point, z });
}

fn only_position(execution: &mut Execution<'_>, mut words: AxisWords) {
    let named: AxisSet = words.named.iter().filter(|axis| *axis != Axis::Z).collect();
    words.named = named;
    if !named.is_empty() {
        execution.act(Action::Rapid(words));
    }
}
