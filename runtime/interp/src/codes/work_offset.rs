//! G54 to G59 Select Work Coordinate System. The offset is read when the block is interpreted (D16); selecting it
//! moves nothing (D20).

use tandem_model::alarm::VALUE_LOST;
use tandem_model::lost::is_lost;
use tandem_model::{Alarm, Axis};

use super::{Code, ModalGroup};
use crate::execution::Execution;
use crate::meaning::Role;

const fn work_offset(code: &'static str, name: &'static str, select: super::Effect) -> Code {
    Code {
        code,
        name,
        group: ModalGroup::WorkCoordinates,
        role: Role::Coordinates,
        docs: "Adds the offsets of this work coordinate system to all positions from here on. The code itself moves \
               nothing; it ends scaling, mirroring and rotation. At start-up no work coordinate system is selected.",
        select,
        ..Code::BASE
    }
}

/// The codes in the order of the offsets, as settings and tables name them.
pub static NAMES: [&str; 6] = [G54.code, G55.code, G56.code, G57.code, G58.code, G59.code];

/// G54.
pub static G54: Code = work_offset("G54", "1st Work Coordinate System selection", select::<0>);
/// G55.
pub static G55: Code = work_offset("G55", "2nd Work Coordinate System selection", select::<1>);
/// G56.
pub static G56: Code = work_offset("G56", "3rd Work Coordinate System selection", select::<2>);
/// G57.
pub static G57: Code = work_offset("G57", "4th Work Coordinate System selection", select::<3>);
/// G58.
pub static G58: Code = work_offset("G58", "5th Work Coordinate System selection", select::<4>);
/// G59.
pub static G59: Code = work_offset("G59", "6th Work Coordinate System selection", select::<5>);

fn select<const INDEX: usize>(execution: &mut Execution<'_>) {
    let offset = execution.inputs.work_offsets.0[INDEX];
    let lost = Axis::ALL.into_iter().find(|axis| is_lost(offset[*axis]));
    if let Some(axis) = lost {
        let text = format!("{} of the work offset {} is damaged", axis.letter(), NAMES[INDEX]);
        return execution.refuse(Alarm::new(&VALUE_LOST, text));
    }
    execution.release_shape();
    execution.transform(|transform| transform.work_offset = offset);
}
