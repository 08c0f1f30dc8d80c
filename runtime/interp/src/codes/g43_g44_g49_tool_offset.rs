//! G43, G44 and G49 Tool Offset along Z, with the tool that is selected when they are interpreted (D17, D22).

use super::{Code, ModalGroup};

const fn tool_offset(
    code: &'static str,
    tenths: u16,
    name: &'static str,
    docs: &'static str,
    select: super::Effect,
) -> Code {
    Code {
        code,
        tenths,
        name,
        group: ModalGroup::ToolLength,
        words: &[],
        docs,
        check: None,
        select,
        motion: None,
    }
}

/// G43.
pub static G43: Code = tool_offset(
    "G43",
    430,
    "Tool Offset, positive",
    "Adds the length of the selected tool to Z. It moves nothing by itself; the next motion ends at the corrected Z, \
     whether it names Z or not (D22). Without a tool of the tool table it warns, and the length counts as 0.",
    |execution| {
        let length = execution.selected_tool("G43", "length").length;
        execution.transform(|transform| transform.tool_length = length);
    },
);
/// G44.
pub static G44: Code = tool_offset(
    "G44",
    440,
    "Tool Offset, negative",
    "As G43, and takes the length away from Z.",
    |execution| {
        let length = execution.selected_tool("G44", "length").length;
        execution.transform(|transform| transform.tool_length = -length);
    },
);
/// G49.
pub static G49: Code = tool_offset(
    "G49",
    490,
    "Cancels tool offset",
    "Switches the tool offset off. In force at start-up.",
    |execution| {
        if execution.modal().transform.tool_length.abs() > 0.0 {
            execution.transform(|transform| transform.tool_length = 0.0);
        }
    },
);
