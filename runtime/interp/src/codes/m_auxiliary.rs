//! M codes that are outputs to the sequence program: all that are not reserved, including M03, M04, M05 and
//! M19 (D35).

use tandem_syntax::Address;

use super::{Code, WordSpec};
use crate::execution::{Execution, Flow};
use crate::meaning::Role;

const fn parameter(address: Address) -> WordSpec {
    WordSpec::new(
        address,
        "parameter of the M code",
        "",
        f64::NEG_INFINITY,
        f64::INFINITY,
    )
}

/// The code of each M code from 0 to 191 that is not reserved.
pub static AUXILIARY: Code = Code {
    code: "M",
    name: "Auxiliary Function Output",
    role: Role::Auxiliary,
    words: &[
        parameter(Address::Va),
        parameter(Address::Vb),
        parameter(Address::Vc),
        parameter(Address::Vd),
        parameter(Address::Ve),
        parameter(Address::Vf),
        parameter(Address::Vg),
        parameter(Address::Vh),
    ],
    docs: "Makes an output with up to eight parameters to the sequence program, which must reset it. The \
           setting of the M code selects the time: after the motion of its block, and the next block then \
           waits for the reset, or when the block is interpreted. An output with parameters is always made \
           after the motion (D30).",
    select: output,
    ..Code::BASE
};

/// Returns the index of an address among the output parameters: 0 to 7 for VA to VH, 0 for T (the tool of a
/// tool change).
pub(crate) fn parameter_index(address: Address) -> Option<usize> {
    match address {
        Address::T => Some(0),
        _ => address.parameter_index(),
    }
}

/// Makes the output of the block's M code, with its parameters.
pub(super) fn output(execution: &mut Execution<'_>) {
    let words = execution.words;
    let mut params = [None; 8];
    for address in words.present.iter() {
        if let Some(index) = parameter_index(address) {
            params[index] = words.get(address);
        }
    }
    let m = words.m_number();
    execution.draft.flow = Flow::Output { m, params };
}
