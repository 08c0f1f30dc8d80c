//! The shortest length that is a motion, and the straight line between two places.

use tandem_model::alarm::check_finite;
use tandem_model::flow::Path;
use tandem_model::{Alarm, Axis, AxisVector};

/// Distances below this are rounding, not motion: mm or degrees. It is also the tolerance of the soft limits.
///
/// Reason: sums of incremental words and work offsets err by about 1e-12 of the position, and no motor resolves a
/// millionth of a micrometre. Without it F of a block of rotary axes would count along a rounding error of X.
pub const LENGTH_MIN: f64 = 1e-9;

/// Returns the straight line between two machine positions; `None` if they are equal but for rounding.
pub(crate) fn line_between(from: AxisVector, to: AxisVector) -> Result<Option<Path>, Alarm> {
    if !moves(from, to) {
        return Ok(None);
    }
    let distance = to.minus(from);
    let orthogonal = distance.orthogonal_length();
    let length = if orthogonal < LENGTH_MIN {
        distance.rotary_length()
    } else {
        orthogonal
    };
    check_finite("The length of the block", length)?;
    Ok(Some(Path::Line { from, to, length }))
}

/// Returns true for positions that differ by more than rounding.
pub(crate) fn moves(from: AxisVector, to: AxisVector) -> bool {
    to.minus(from)
        .0
        .iter()
        .any(|distance| distance.abs() >= LENGTH_MIN)
}

/// Returns true for a path on which X, Y and Z move only by rounding. Its length is only calculated in that
/// case.
pub(crate) fn turns_only(way: AxisVector) -> bool {
    let stands = |axis: Axis| way[axis].abs() < LENGTH_MIN;
    Axis::ORTHOGONAL.into_iter().all(stands) && way.orthogonal_length() < LENGTH_MIN
}
