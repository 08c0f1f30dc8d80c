//! G40, G41 and G42 Cutter Compensation, with the tool that is selected when they are interpreted (D17).

use tandem_model::flow::Compensation;

use super::{Code, ModalGroup};

const fn compensation(
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
        group: ModalGroup::ToolRadius,
        words: &[],
        docs,
        check: None,
        select,
        motion: None,
    }
}

/// G40.
pub static G40: Code = compensation(
    "G40",
    400,
    "Cancels tool compensation",
    "Switches cutter compensation off; the next G00 or G01 leads out. In force at start-up.",
    |execution| execution.modal_mut().compensation = Compensation::Off,
);
/// G41.
pub static G41: Code = compensation(
    "G41",
    410,
    "Tool Compensation, left",
    "Moves the tool's centre to the left of the path by its radius, in the plane in force. The next motion leads in: a \
     G01. Until G40 only G01, G02 and G03 move, the plane and the side stay, and no M00, M01 or M code with parameters \
     may stand.",
    |execution| {
        let (radius, plane) = (execution.inputs().tool.radius, execution.modal().plane());
        execution.modal_mut().compensation = Compensation::Left { radius, plane };
    },
);
/// G42.
pub static G42: Code = compensation(
    "G42",
    420,
    "Tool Compensation, right",
    "As G41, to the right of the path.",
    |execution| {
        let (radius, plane) = (execution.inputs().tool.radius, execution.modal().plane());
        execution.modal_mut().compensation = Compensation::Right { radius, plane };
    },
);
