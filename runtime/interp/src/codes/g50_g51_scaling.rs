//! G50 and G51 Scaling. Factors near zero are not allowed, which the range of a word cannot express.

use tandem_model::axis::Axis;
use tandem_model::flow::{Scaling, Transform};
use tandem_syntax::Address;
use tandem_syntax::diagnostics::OUT_OF_RANGE;

use super::{Code, ModalGroup, Refusal, WordSpec, axis_word};
use crate::block_words::BlockWords;
use crate::execution::Execution;
use crate::meaning::{ModalValue, Role, Shape};

const FACTOR_MIN: f64 = 0.000_01;
const FACTOR_MAX: f64 = 10_000.0;

/// Smallest factor of dialect dgshape.
pub(crate) const SAME_FACTOR_MIN: f64 = 0.001;

/// Largest factor of dialect dgshape.
pub(crate) const SAME_FACTOR_MAX: f64 = 999.999;

/// Limit of P as written, in dialect dgshape (range 1).
const POINT_MAX: f64 = 99_999_999.0;

const fn factor(address: Address, meaning: &'static str) -> WordSpec {
    WordSpec::new(address, meaning, "", -FACTOR_MAX, FACTOR_MAX)
}

/// G50: scaling off.
pub static G50: Code = Code {
    code: "G50",
    name: "Cancel scaling",
    group: ModalGroup::Scaling,
    sets: Some(ModalValue::Shape(Shape::Scaling, false)),
    role: Role::Coordinates,
    docs: "Switches scaling off. In force at start-up.",
    select: |execution| {
        if execution.modal.transform.scaling.is_some() {
            execution.transform(|transform| transform.scaling = None);
        }
    },
    ..Code::BASE
};

/// G51: scaling on.
pub static G51: Code = Code {
    code: "G51",
    name: "Scaling",
    group: ModalGroup::Scaling,
    sets: Some(ModalValue::Shape(Shape::Scaling, true)),
    role: Role::Coordinates,
    words: &[
        axis_word(Address::X),
        axis_word(Address::Y),
        axis_word(Address::Z),
        WordSpec::new(Address::P, "factor of all axes", "", FACTOR_MIN, FACTOR_MAX),
        factor(Address::I, "factor of X"),
        factor(Address::J, "factor of Y"),
        factor(Address::K, "factor of Z"),
    ],
    docs: "Multiplies distances from the centre X, Y, Z by P, or by I, J and K for each axis. With P, I, J \
           and K have no effect; a missing factor is 1, and a negative factor mirrors. Factors are 0.00001 \
           to 10000 in amount. The centre is absolute; for an axis not written, it is the position of the \
           tool.",
    check: Some(factors),
    select: |execution| {
        let all = execution.words.get(Address::P);
        let factors = [Address::I, Address::J, Address::K]
            .map(|address| all.or(execution.words.get(address)).unwrap_or(1.0));
        scale(execution, factors);
    },
    ..Code::BASE
};

/// G51 of dialect dgshape, with one factor for X, Y and Z.
pub static G51_P: Code = Code {
    words: &[
        axis_word(Address::X),
        axis_word(Address::Y),
        axis_word(Address::Z),
        WordSpec::new(Address::P, "factor", "", -POINT_MAX, POINT_MAX).needed(),
    ],
    docs: "Multiplies distances in X, Y and Z by P. They are measured from the point of these words, for an \
           axis not written from the position of the tool. The factor is limited to 0.001 to 999.999. The \
           point is absolute.",
    check: None,
    select: |execution| {
        let written = execution.words.get(Address::P).unwrap_or(1.0);
        let factor = written.clamp(SAME_FACTOR_MIN, SAME_FACTOR_MAX);
        scale(execution, [factor; 3]);
    },
    ..G51
};

fn scale(execution: &mut Execution<'_>, factors: [f64; 3]) {
    let centre = execution.centre(&[Axis::X, Axis::Y, Axis::Z], Transform::before_scaling);
    execution.transform(|transform| {
        transform.scaling = Some(Scaling { centre, factors });
    });
}

fn factors(words: &BlockWords) -> Option<Refusal> {
    let address = [Address::I, Address::J, Address::K].into_iter().find(|address| {
        words
            .get(*address)
            .is_some_and(|factor| factor.abs() < FACTOR_MIN)
    })?;
    Some(Refusal {
        entry: &OUT_OF_RANGE,
        address,
        message: format!("the factor {} is too small", address.text()),
        help: "Write a factor of 0.00001 to 10000 in amount.".to_owned(),
    })
}
