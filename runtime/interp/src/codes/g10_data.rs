//! G10 of dialect dgshape: sets work offsets, EXOFS and tool-diameter offsets (2-2). The values are valid
//! until the next program begins; the machine's tables do not change.

use tandem_syntax::Address;
use tandem_syntax::diagnostics::{OUT_OF_RANGE, WORD_MISSING, WORD_NOT_TAKEN};

use super::work_offset;
use super::{Code, POSITION_MAX, Refusal, WordSpec, axis_word};
use crate::block_words::BlockWords;
use crate::execution::Execution;
use crate::meaning::Role;

/// Value of L for work offsets.
const WORK_OFFSETS: f64 = 2.0;

/// Largest P with L2, the number of a work coordinate system; P0 selects EXOFS.
const COORDINATES_MAX: f64 = 6.0;

const OFFSET_NUMBER_MAX: f64 = 65_535.0;

/// G10: sets data for the rest of the program.
pub static G10: Code = Code {
    code: "G10",
    name: "Data Setting",
    role: Role::Coordinates,
    words: &[
        WordSpec::new(Address::L, "kind of data", "", WORK_OFFSETS, WORK_OFFSETS).whole(),
        WordSpec::new(Address::P, "number", "", 0.0, OFFSET_NUMBER_MAX)
            .whole()
            .needed(),
        axis_word(Address::X),
        axis_word(Address::Y),
        axis_word(Address::Z),
        axis_word(Address::A),
        WordSpec::new(
            Address::R,
            "tool-diameter offset",
            "mm",
            -POSITION_MAX,
            POSITION_MAX,
        ),
    ],
    docs: "With L2, sets the offsets of work coordinate system P (1 to 6 for G54 to G59), or EXOFS with P0. \
           Axes not written keep their offsets, in G90 and G91 alike. With R, sets the tool-diameter \
           offset of number P, 1 or more. Both are valid until the next program begins, in place of the \
           machine's tables, which do not change.",
    check: Some(form),
    select: set,
    ..Code::BASE
};

fn form(words: &BlockWords) -> Option<Refusal> {
    let number = words.get(Address::P)?;
    let refuse = |entry, address, message: &str, help: &str| {
        Some(Refusal {
            entry,
            address,
            message: message.to_owned(),
            help: help.to_owned(),
        })
    };
    let has = |address| words.present.contains(address);
    if let Some(kind) = words.get(Address::L) {
        if kind.to_bits() != WORK_OFFSETS.to_bits() {
            return None; // the range of L reports the fault
        }
        if has(Address::R) {
            return refuse(
                &WORD_NOT_TAKEN,
                Address::R,
                "data of L2 has no R",
                "Remove R, or L2.",
            );
        }
        let beyond = number > COORDINATES_MAX;
        let help = "Write P1 to P6, or P0 for EXOFS.";
        return beyond.then(|| {
            refuse(
                &OUT_OF_RANGE,
                Address::P,
                "this coordinate system does not exist",
                help,
            )
        })?;
    }
    let axes = [Address::X, Address::Y, Address::Z, Address::A];
    if let Some(axis) = axes.into_iter().find(|axis| has(*axis)) {
        return refuse(
            &WORD_NOT_TAKEN,
            axis,
            "offsets of axes need L2",
            "Write L2 with them.",
        );
    }
    if !has(Address::R) {
        return refuse(
            &WORD_MISSING,
            Address::P,
            "the data has neither L2 nor R",
            "Write L2 or R.",
        );
    }
    (number < 1.0).then(|| {
        let help = "Write P1 or more.";
        refuse(
            &OUT_OF_RANGE,
            Address::P,
            "the offset of number 0 is always 0",
            help,
        )
    })?
}

fn set(execution: &mut Execution<'_>) {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the range has been checked, and a cast saturates"
    )]
    let number = execution.words.get(Address::P).unwrap_or_default() as u16;
    if let Some(radius) = execution.length(Address::R) {
        execution.retained_mut().radii.insert(number, radius);
        return;
    }
    let words = execution.own_axis_words();
    work_offset::set(execution, usize::from(number).min(6), &words);
}
