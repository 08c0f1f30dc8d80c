//! G81: a drilling cycle of a custom dialect, in one file.

use tandem_interp::codes::{Code, ModalGroup, WordSpec, cycle_words};
use tandem_interp::fixed_cycles::{CycleStep, FixedCycle, Level, Steps};
use tandem_interp::meaning::ModalValue;
use tandem_syntax::Address;

const STEPS: Steps = Steps::new(
    &[],
    &[
        CycleStep::Position,
        CycleStep::Approach,
        CycleStep::Linear(Level::ZPoint),
        CycleStep::Rapid(Level::Return),
    ],
    &[],
);

static DRILLING: FixedCycle = FixedCycle {
    name: "a drilling cycle",
    needed: &[Address::Z, Address::R],
    with_spindle: STEPS,
    without_spindle: STEPS,
};

/// Drills at X, Y: rapid to the R point, the feed to the Z point, rapid to the initial level or the R point.
pub static G81: Code = Code {
    code: "G81",
    name: "Drilling Cycle",
    group: ModalGroup::FixedCycle,
    sets: Some(ModalValue::Cycle(Some(&DRILLING))),
    words: &[
        WordSpec::new(Address::X, "hole", "mm", -1e6, 1e6),
        WordSpec::new(Address::Y, "hole", "mm", -1e6, 1e6),
        WordSpec::new(Address::Z, "Z point", "mm", -1e6, 1e6),
        WordSpec::new(Address::R, "R point", "mm", -1e6, 1e6),
        WordSpec::new(Address::K, "number of holes", "", 0.0, 100.0).whole(),
    ],
    docs: "Drills from the R point to the Z point at X, Y, K times.",
    motion: Some(cycle_words::run),
    ..Code::BASE
};
