//! G52 Local Coordinate System Set.

use tandem_model::AxisVector;

use super::{AXIS_WORDS, Code};
use crate::meaning::Role;

/// G52: an offset that is added to the work coordinates.
pub static G52: Code = Code {
    code: "G52",
    name: "Local Coordinate System Set",
    role: Role::Coordinates,
    words: &AXIS_WORDS,
    docs: "Adds the values to the coordinates in force, for the named axes; without axis words all local offsets end. \
           Ends scaling, mirroring and rotation. Moves nothing.",
    select: |execution| {
        let offset = execution.own_axis_words();
        execution.release_shape();
        execution.transform(|transform| {
            if offset.named.is_empty() {
                transform.local = AxisVector::ZERO;
            }
            for axis in offset.named.iter() {
                transform.local[axis] = offset.values[axis];
            }
        });
    },
    ..Code::BASE
};
