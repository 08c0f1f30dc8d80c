//! G74, G80 and G84: tapping cycles. How they expand is in [`crate::fixed_cycles`].

use tandem_model::plane::Turn;
use tandem_syntax::Address;

use super::{Code, ModalGroup, POSITION_MAX, WordSpec, axis_word};
use crate::fixed_cycles;
use crate::meaning::ModalValue;
use crate::modal::CycleWords;

static WORDS: [WordSpec; 6] = [
    axis_word(Address::X),
    axis_word(Address::Y),
    WordSpec::new(Address::Z, "Z point", "mm", -POSITION_MAX, POSITION_MAX),
    WordSpec::new(Address::R, "R point", "mm", -POSITION_MAX, POSITION_MAX),
    WordSpec::new(Address::P, "dwell at the Z point", "ms", 0.0, 100_000_000.0),
    WordSpec::new(Address::K, "number of repetitions", "", 0.0, 10_000.0).whole(),
];

/// G74: left-hand threads.
pub static G74: Code = Code {
    code: "G74",
    tenths: 740,
    name: "Left-handed Tapping Cycle",
    group: ModalGroup::FixedCycle,
    sets: Some(ModalValue::Cycle(true)),
    words: &WORDS,
    docs: "Taps at X, Y from the R point to the Z point and back, the spindle turning counter-clockwise on the way in, \
           K times (once without K). Each later block with an axis word taps again until G80 or G00 to G03; Z, R, P \
           and K stay. The first block needs Z and R. In G91 R counts from the initial level, Z from R (D42). The \
           initial level is Z where the cycle began; G98 returns to it, G99 to the R point. With a spindle in the \
           coordinate system it turns in step with Z, S / F revolutions a millimetre, ramps included, and rests at the \
           R and Z point. A block with a hole beyond a soft limit moves nothing. No override acts on a thread, \
           and feed hold waits until the tool is out.",
    motion: Some(|execution, words| fixed_cycles::tapping(execution, words, Turn::CounterClockwise)),
    ..Code::BASE
};

/// G84: right-hand threads.
pub static G84: Code = Code {
    code: "G84",
    tenths: 840,
    name: "Tapping Cycle",
    group: ModalGroup::FixedCycle,
    sets: Some(ModalValue::Cycle(true)),
    words: &WORDS,
    docs: "As G74, the spindle turning clockwise on the way in.",
    motion: Some(|execution, words| fixed_cycles::tapping(execution, words, Turn::Clockwise)),
    ..Code::BASE
};

/// G80.
pub static G80: Code = Code {
    code: "G80",
    tenths: 800,
    name: "Fixed Cycle Cancel",
    group: ModalGroup::FixedCycle,
    sets: Some(ModalValue::Cycle(false)),
    docs: "Ends a fixed cycle and forgets its words. In force at start-up.",
    select: |execution| execution.modal_mut().cycle = CycleWords::default(),
    ..Code::BASE
};
