//! G74, G80 and G84: tapping cycles (manual 2, utilities; D42).
//!
//! A block moves in this order: M19, rapids to X, Y and to the R point, the thread in, dwell, the thread out;
//! with G98 back to the initial level. A spindle of the coordinate system turns in step with Z. Without such
//! a spindle, M codes switch the spindle between the motions.

use tandem_model::flow::TapLeg;
use tandem_model::plane::Turn;
use tandem_syntax::Address;

use super::Code;
use super::cycle_words::{self, CYCLE_WORDS};
use crate::fixed_cycles::{CycleStep, FixedCycle, Level, Steps};
use crate::meaning::ModalValue;
use crate::modal::CycleWords;

/// Creates a tapping cycle from the turns of the spindle into the hole and out of it: M03 clockwise, M04
/// counter-clockwise.
macro_rules! tapping {
    ($in:ident $m_in:literal, $out:ident $m_out:literal) => {
        FixedCycle {
            name: "a tapping cycle",
            needed: &[Address::Z, Address::R],
            with_spindle: Steps::new(
                &[CycleStep::Output(19)],
                &[
                    CycleStep::Position,
                    CycleStep::Approach,
                    CycleStep::Thread(TapLeg::In, Turn::$in),
                    CycleStep::Dwell,
                    CycleStep::Thread(TapLeg::Out, Turn::$out),
                    CycleStep::Rapid(Level::Initial),
                ],
                &[CycleStep::Output(5)],
            ),
            without_spindle: Steps::new(
                &[],
                &[
                    CycleStep::Position,
                    CycleStep::Approach,
                    CycleStep::Output(19),
                    CycleStep::Output($m_in),
                    CycleStep::Thread(TapLeg::In, Turn::$in),
                    CycleStep::Dwell,
                    CycleStep::Output($m_out),
                    CycleStep::Thread(TapLeg::Out, Turn::$out),
                    CycleStep::Output($m_in),
                    CycleStep::Linear(Level::Initial),
                ],
                &[],
            ),
        }
    };
}

/// Tapping cycle for left-hand threads.
pub static LEFT_HAND: FixedCycle = tapping!(CounterClockwise 4, Clockwise 3);
/// Tapping cycle for right-hand threads.
pub static RIGHT_HAND: FixedCycle = tapping!(Clockwise 3, CounterClockwise 4);

/// G74: cuts left-hand threads.
pub static G74: Code = Code {
    words: &CYCLE_WORDS,
    motion: Some(cycle_words::run),
    ..Code::setting(
        ModalValue::Cycle(Some(&LEFT_HAND)),
        "G74",
        "Left-handed Tapping Cycle",
        "Taps at X, Y from the R point to the Z point and back, with a counter-clockwise spindle on the way \
         in, K times (once without K). Each later block with an axis word taps again until G80 or G00 to \
         G03; Z, R, P and K stay. The first block needs Z and R. In G91, R counts from the initial level, Z \
         from R (D42). The initial level is Z at the start of the cycle; G98 returns to it, G99 to the R \
         point. A spindle of the coordinate system turns in step with Z, S / F revolutions per millimetre, \
         ramps included, and rests at the R point and the Z point. If a hole of a block is beyond a soft \
         limit, the block does not move. No override acts on a thread, and a feed hold takes effect only \
         after the tool is out.",
    )
};

/// G84: cuts right-hand threads.
pub static G84: Code = Code {
    words: &CYCLE_WORDS,
    motion: Some(cycle_words::run),
    ..Code::setting(
        ModalValue::Cycle(Some(&RIGHT_HAND)),
        "G84",
        "Tapping Cycle",
        "As G74, but with a clockwise spindle on the way in.",
    )
};

/// G80: ends a fixed cycle.
pub static G80: Code = Code {
    select: |execution| execution.modal.cycle = CycleWords::default(),
    ..Code::setting(
        ModalValue::Cycle(None),
        "G80",
        "Fixed Cycle Cancel",
        "Ends a fixed cycle and discards its words. In force at start-up.",
    )
};
