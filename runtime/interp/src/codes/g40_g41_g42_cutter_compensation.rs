//! G40, G41 and G42 Cutter Compensation, with the tool that is selected when they are interpreted (D17).

use tandem_model::flow::Compensation;

use super::{Code, ModalGroup};
use crate::execution::Execution;
use crate::meaning::{ModalValue, Side};

/// G40.
pub static G40: Code = Code {
    select: compensate,
    ..Code::setting(
        ModalValue::Side(Side::Off),
        "G40",
        "Cancels tool compensation",
        "Switches cutter compensation off; the next G00 or G01 that moves in the plane leads out, over at least the tool's \
         radius. Until then the program neither waits nor ends. In force at start-up.",
    )
};
/// G41.
pub static G41: Code = Code {
    select: compensate,
    ..Code::setting(
        ModalValue::Side(Side::Left),
        "G41",
        "Tool Compensation, left",
        "Moves the tool's centre to the left of the path by its radius, in the plane in force. The next motion in the plane \
         leads in: a G01 over at least the tool's radius. Until G40 only G01, G02 and G03 move, the plane and the side stay, \
         and nothing may stand at which the program waits: M00, M01, an M code with parameters or one that is output after \
         the motion. Inside corners end where the offset blocks meet, outside corners are extended up to 90 degrees of \
         deflection and rounded beyond. Where the tool would cut into another block there is an alarm, or with overcut = \
         \"prevent\" the blocks that it does not fit between are left out. Without a tool of the tool table it warns, and the \
         radius counts as 0.",
    )
};
/// G42.
pub static G42: Code = Code {
    select: compensate,
    ..Code::setting(
        ModalValue::Side(Side::Right),
        "G42",
        "Tool Compensation, right",
        "As G41, to the right of the path.",
    )
};

/// Puts the compensation of the side in force into effect, with the radius of the selected tool in the plane in force.
pub fn compensate(execution: &mut Execution<'_>) {
    let side = execution.modal.in_force.side.unwrap_or_default();
    let plane = execution.modal.plane();
    let mut radius = || execution.selected_tool(ModalGroup::ToolRadius, "radius").radius;
    let compensation = match side {
        Side::Off => Compensation::Off,
        Side::Left => Compensation::Left {
            radius: radius(),
            plane,
        },
        Side::Right => Compensation::Right {
            radius: radius(),
            plane,
        },
    };
    execution.modal.compensation = compensation;
}
