//! G40, G41 and G42 Cutter Compensation. G41 and G42 use the tool that is selected when they are interpreted
//! (D17).

use tandem_model::flow::Compensation;
use tandem_syntax::Address;

use super::{Code, ModalGroup, WordSpec};
use crate::execution::Execution;
use crate::meaning::{ModalValue, Side};

/// G40: compensation off.
pub static G40: Code = Code {
    select: compensate,
    ..Code::setting(
        ModalValue::Side(Side::Off),
        "G40",
        "Cancels tool compensation",
        "Switches cutter compensation off; the next G00 or G01 that moves in the plane leads out, over at \
         least the tool's radius. Until then, a block that waits or ends the program is an error. In force \
         at start-up.",
    )
};
/// G41: compensation to the left of the path.
pub static G41: Code = Code {
    select: compensate,
    ..Code::setting(
        ModalValue::Side(Side::Left),
        "G41",
        "Tool Compensation, left",
        "Shifts the tool's centre to the left of the path by the tool's radius, in the plane in force. The \
         next motion in the plane leads in: a G01 over at least the tool's radius. Until G40, motions are \
         only G01, G02 and G03, the plane and the side stay, and the program must not wait: M00, M01, an M \
         code with parameters, and an M code that is output after the motion are not allowed. At inside \
         corners, the blocks end where their offset paths meet; at outside corners, they are extended up to \
         90 degrees of deflection, and joined by an arc beyond. If the tool would cut into another block, \
         the run stops with an alarm; with overcut = \"prevent\", the blocks that the tool does not fit \
         between are left out. Without a tool of the tool table, a warning is given and the radius is 0.",
    )
};
/// G42: compensation to the right of the path.
pub static G42: Code = Code {
    select: compensate,
    ..Code::setting(
        ModalValue::Side(Side::Right),
        "G42",
        "Tool Compensation, right",
        "As G41, to the right of the path.",
    )
};

/// Words of G41 and G42 in dialect dgshape.
static OFFSET_NUMBER: [WordSpec; 1] = [WordSpec::new(Address::D, "offset number", "", 0.0, 65_535.0)
    .whole()
    .needed()];

/// G41 of dialect dgshape, with the offset whose number D gives.
pub static G41_D: Code = Code {
    words: &OFFSET_NUMBER,
    select: compensate_by_number,
    docs: "Shifts the tool to the left of the path by the offset of number D: of G10, or the radius in the \
           tool table. The next motion in the XY plane, by G00 or G01, leads in. Until G40, the plane, the \
           side and D stay, and codes that set coordinates, scale, drill or move to the reference point are \
           not allowed.",
    ..G41
};

/// G42 of dialect dgshape, with the offset whose number D gives.
pub static G42_D: Code = Code {
    words: &OFFSET_NUMBER,
    select: compensate_by_number,
    docs: "As G41, to the right of the path.",
    ..G42
};

/// Switches compensation to the active side, with the radius of the selected tool, in the current plane.
pub fn compensate(execution: &mut Execution<'_>) {
    compensate_with(execution, |execution| {
        execution.selected_tool(ModalGroup::ToolRadius, "radius").radius
    });
}

/// Switches compensation to the active side, with the offset whose number D gives.
fn compensate_by_number(execution: &mut Execution<'_>) {
    compensate_with(execution, |execution| {
        let (number, tool) = execution.offset_entry(Address::D);
        match execution.retained().radii.get(&number) {
            _ if number == 0 => 0.0,
            Some(radius) => *radius,
            None => tool.radius,
        }
    });
    // a negative offset shifts the tool to the other side
    let compensation = &mut execution.modal.compensation;
    *compensation = match *compensation {
        Compensation::Left { radius, plane } if radius < 0.0 => Compensation::Right {
            radius: -radius,
            plane,
        },
        Compensation::Right { radius, plane } if radius < 0.0 => Compensation::Left {
            radius: -radius,
            plane,
        },
        same => same,
    };
}

fn compensate_with(execution: &mut Execution<'_>, radius: fn(&mut Execution<'_>) -> f64) {
    let side = execution.modal.in_force.side.unwrap_or_default();
    let plane = execution.modal.plane();
    let mut radius = || radius(execution);
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
