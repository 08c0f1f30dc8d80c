//! G43, G44 and G49 Tool Offset along Z, with the tool that is selected when they are interpreted (D17, D22).

use super::{Code, ModalGroup};
use crate::execution::Execution;
use crate::meaning::{LengthOffset, ModalValue};

/// G43.
pub static G43: Code = Code {
    select: offset,
    ..Code::setting(
        ModalValue::Length(LengthOffset::Added),
        "G43",
        "Tool Offset, positive",
        "Adds the length of the selected tool to Z. It moves nothing by itself; the next motion ends at the corrected Z, \
         whether it names Z or not (D22). Without a tool of the tool table it warns, and the length counts as 0.",
    )
};
/// G44.
pub static G44: Code = Code {
    select: offset,
    ..Code::setting(
        ModalValue::Length(LengthOffset::Subtracted),
        "G44",
        "Tool Offset, negative",
        "As G43, and takes the length away from Z.",
    )
};
/// G49.
pub static G49: Code = Code {
    select: offset,
    ..Code::setting(
        ModalValue::Length(LengthOffset::Off),
        "G49",
        "Cancels tool offset",
        "Switches the tool offset off. In force at start-up.",
    )
};

/// Puts the tool offset in force into effect, with the length of the selected tool.
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
