//! M98 Subprogram Call (D12).

use tandem_model::limits::{PROGRAM_NUMBER_MAX, SUBPROGRAM_MIN};
use tandem_syntax::Address;

use super::{Code, WordSpec};
use crate::execution::{Execution, Flow};
use crate::meaning::Role;

/// M98: calls a subprogram, L times.
pub static M98: Code = Code {
    code: "M98",
    name: "Subprogram Call",
    role: Role::Call,
    words: &[
        WordSpec::new(
            Address::P,
            "program number",
            "",
            SUBPROGRAM_MIN as f64,
            PROGRAM_NUMBER_MAX as f64,
        )
        .whole()
        .needed(),
        WordSpec::new(Address::L, "number of calls", "", 0.0, 10_000.0).whole(),
    ],
    docs: "Runs subprogram P from its first block, L times (once without L, not at all with L0), then \
           continues with the next block. Calls can be nested 8 deep; a deeper call is skipped with a \
           warning. A missing program is an alarm. As every block without motion, M98 and M99 end a chain of \
           blended blocks, but not with G500.",
    select: call,
    ..Code::BASE
};

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "ranges have been checked, and a cast saturates"
)]
fn call(execution: &mut Execution<'_>) {
    let words = execution.words;
    let program = words.get(Address::P).unwrap_or(0.0) as u16;
    let times = words.get(Address::L).unwrap_or(1.0) as u16;
    execution.draft.flow = Flow::Call { program, times };
}
