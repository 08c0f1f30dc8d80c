//! G54 to G59 Select Work Coordinate System. The offset is read when the block is interpreted (D16); the
//! selection moves no axis (D20).

use tandem_model::alarm::VALUE_LOST;
use tandem_model::flow::AxisWords;
use tandem_model::lost::is_lost;
use tandem_model::{Alarm, Axis, AxisVector};

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

/// Names of the codes in the order of the offsets, as used in settings and tables.
pub static NAMES: [&str; 6] = [G54.code, G55.code, G56.code, G57.code, G58.code, G59.code];

/// G54: the first work coordinate system.
pub static G54: Code = work_offset("G54", "1st Work Coordinate System selection", select::<0>);
/// G55: the second work coordinate system.
pub static G55: Code = work_offset("G55", "2nd Work Coordinate System selection", select::<1>);
/// G56: the third work coordinate system.
pub static G56: Code = work_offset("G56", "3rd Work Coordinate System selection", select::<2>);
/// G57: the fourth work coordinate system.
pub static G57: Code = work_offset("G57", "4th Work Coordinate System selection", select::<3>);
/// G58: the fifth work coordinate system.
pub static G58: Code = work_offset("G58", "5th Work Coordinate System selection", select::<4>);
/// G59: the sixth work coordinate system.
pub static G59: Code = work_offset("G59", "6th Work Coordinate System selection", select::<5>);

fn select<const INDEX: usize>(execution: &mut Execution<'_>) {
    if let Some(offset) = table_offset(execution, INDEX) {
        execution.release_shape();
        execution.transform(|transform| transform.work_offset = offset);
    }
}

/// Returns a work offset of the table. If a value of the offset is lost, raises an alarm and returns `None`.
fn table_offset(execution: &mut Execution<'_>, index: usize) -> Option<AxisVector> {
    let offset = execution.inputs.work_offsets.0[index];
    let lost = Axis::ALL.into_iter().find(|axis| is_lost(offset[*axis]));
    if let Some(axis) = lost {
        let text = format!("{} of the work offset {} is damaged", axis.letter(), NAMES[index]);
        execution.refuse(Alarm::new(&VALUE_LOST, text));
    }
    lost.is_none().then_some(offset)
}

const fn selection(code: &'static str, name: &'static str, select: super::Effect) -> Code {
    Code {
        docs: "Adds the offsets of this work coordinate system, EXOFS and the shift of G92 to all positions from here on. The \
               code itself moves nothing. At start-up G54 is selected.",
        select,
        ..work_offset(code, name, select)
    }
}

/// G54 of dialect dgshape, with EXOFS and the shift of G92.
pub static G54_SHIFTED: Code = selection("G54", "Select workpiece coordinate system 1", select_shifted::<0>);
/// G55 of dialect dgshape, with EXOFS and the shift of G92.
pub static G55_SHIFTED: Code = selection("G55", "Select workpiece coordinate system 2", select_shifted::<1>);
/// G56 of dialect dgshape, with EXOFS and the shift of G92.
pub static G56_SHIFTED: Code = selection("G56", "Select workpiece coordinate system 3", select_shifted::<2>);
/// G57 of dialect dgshape, with EXOFS and the shift of G92.
pub static G57_SHIFTED: Code = selection("G57", "Select workpiece coordinate system 4", select_shifted::<3>);
/// G58 of dialect dgshape, with EXOFS and the shift of G92.
pub static G58_SHIFTED: Code = selection("G58", "Select workpiece coordinate system 5", select_shifted::<4>);
/// G59 of dialect dgshape, with EXOFS and the shift of G92.
pub static G59_SHIFTED: Code = selection("G59", "Select workpiece coordinate system 6", select_shifted::<5>);

fn select_shifted<const INDEX: usize>(execution: &mut Execution<'_>) {
    execution.retained_mut().selected = INDEX;
    activate_selected(execution);
}

/// Applies the origin of the selected work coordinate system: the sum of its offset, EXOFS and the shift of
/// G92.
pub(super) fn activate_selected(execution: &mut Execution<'_>) {
    let index = execution.retained().selected;
    let Some(own) = execution.retained().work_offsets[index].or_else(|| table_offset(execution, index))
    else {
        return;
    };
    let offset = own.plus(external(execution)).plus(execution.retained().shift);
    execution.transform(|transform| transform.work_offset = offset);
}

/// Returns the external offset (EXOFS) in force: that of G10, otherwise that of the settings.
fn external(execution: &Execution<'_>) -> AxisVector {
    let kept = execution.retained().external_offset;
    kept.unwrap_or(execution.limits.options.external_offset)
}

/// Changes the named axes of a work offset (`number` from 1 on) or of EXOFS (0), until the next program
/// begins.
pub(super) fn set(execution: &mut Execution<'_>, number: usize, words: &AxisWords) {
    let change = |mut offset: AxisVector| {
        for axis in words.named.iter() {
            offset[axis] = words.values[axis];
        }
        offset
    };
    match number.checked_sub(1) {
        None => execution.retained_mut().external_offset = Some(change(external(execution))),
        Some(index) => {
            let before = execution.retained().work_offsets[index];
            let Some(before) = before.or_else(|| table_offset(execution, index)) else {
                return;
            };
            execution.retained_mut().work_offsets[index] = Some(change(before));
        }
    }
    activate_selected(execution);
}
