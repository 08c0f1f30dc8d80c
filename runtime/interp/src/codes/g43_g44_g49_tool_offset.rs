//! G43, G44 and G49 Tool Offset along Z. G43 and G44 use the tool that is selected when they are interpreted
//! (D17, D22).

use tandem_model::flow::{Action, AxisWords, Distance, Frame};
use tandem_model::{Axis, AxisVector};
use tandem_syntax::Address;

use super::{Code, ModalGroup, WordSpec};
use crate::execution::Execution;
use crate::meaning::{LengthOffset, ModalValue, MotionKind, Role};

/// G43: adds the tool length to Z.
pub static G43: Code = Code {
    select: offset,
    ..Code::setting(
        ModalValue::Length(LengthOffset::Added),
        "G43",
        "Tool Offset, positive",
        "Adds the length of the selected tool to Z. The code itself moves nothing; the next motion ends at \
         the corrected Z, also without a Z word (D22). Without a tool of the tool table, a warning is given \
         and the length is 0.",
    )
};
/// G44: subtracts the tool length from Z.
pub static G44: Code = Code {
    select: offset,
    ..Code::setting(
        ModalValue::Length(LengthOffset::Subtracted),
        "G44",
        "Tool Offset, negative",
        "As G43, but subtracts the length from Z.",
    )
};
/// G49: tool offset off.
pub static G49: Code = Code {
    select: offset,
    ..Code::setting(
        ModalValue::Length(LengthOffset::Off),
        "G49",
        "Cancels tool offset",
        "Switches the tool offset off. In force at start-up.",
    )
};

/// G43 of dialect dgshape, with the offset whose number H gives.
pub static G43_H: Code = Code {
    words: &[WordSpec::new(Address::H, "offset number", "", 0.0, 65_535.0)
        .whole()
        .needed()],
    select: |execution| {
        let (number, tool) = execution.offset_entry(Address::H);
        move_by(execution, if number == 0 { 0.0 } else { tool.length });
    },
    docs: "Adds the offset of number H, the length in the tool table, to Z. With axis words, their motion \
           ends at the corrected Z; without them, Z moves by the change of the offset. Number 0 means no \
           offset.",
    ..G43
};

/// G49 of dialect dgshape, which moves Z if the block has no axis word.
pub static G49_H: Code = Code {
    select: |execution| move_by(execution, 0.0),
    docs: "As G43 with number 0: the offset ends, and without axis words Z moves by the change. In force at start-up.",
    ..G49
};

/// Sets the tool length, and moves Z by the change of the length if the block has no axis word.
fn move_by(execution: &mut Execution<'_>, length: f64) {
    if (length - execution.modal.transform.tool_length).abs() == 0.0 {
        return;
    }
    execution.transform(|transform| transform.tool_length = length);
    if !execution.words.axis_words.is_empty() {
        return;
    }
    let none = AxisWords {
        values: AxisVector::ZERO,
        named: [Axis::Z].into_iter().collect(),
        distance: Distance::Incremental,
        frame: Frame::Work,
    };
    let motion = execution.modal.code(ModalGroup::Motion).map(|code| code.role);
    execution.act(match motion {
        Some(Role::Motion(MotionKind::Rapid)) => Action::Rapid(none),
        _ => Action::Linear(none),
    });
}

/// Applies the active tool offset (added, subtracted or off) with the length of the selected tool.
pub fn offset(execution: &mut Execution<'_>) {
    let how = execution.modal.in_force.length.unwrap_or_default();
    let mut length = || execution.selected_tool(ModalGroup::ToolLength, "length").length;
    let tool_length = match how {
        LengthOffset::Added => length(),
        LengthOffset::Subtracted => -length(),
        LengthOffset::Off if execution.modal.transform.tool_length.abs() > 0.0 => 0.0,
        LengthOffset::Off => return,
    };
    execution.transform(|transform| transform.tool_length = tool_length);
}
