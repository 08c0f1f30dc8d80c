//! The smallest length that is treated as a motion, and the straight line between two positions.

use tandem_model::alarm::check_finite;
use tandem_model::flow::Path;
use tandem_model::{Alarm, Axis, AxisVector};

/// Distances below this are treated as rounding, not as motion: mm or degrees. It is also the tolerance of
/// the soft limits.
///
/// Reason: sums of incremental words and work offsets have an error of about 1e-12 of the position, and no
/// motor resolves a millionth of a micrometre. Without this limit, F of a block of rotary axes would apply to
/// a rounding error of X.
pub const LENGTH_MIN: f64 = 1e-9;

/// Returns the straight line between two machine positions; `None` if they differ only by rounding.
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

/// Returns true if two positions differ by more than rounding.
pub(crate) fn moves(from: AxisVector, to: AxisVector) -> bool {
    to.minus(from)
        .0
        .iter()
        .any(|distance| distance.abs() >= LENGTH_MIN)
}

/// Returns true for a path on which X, Y and Z move only by rounding. The length is calculated only if each
/// of these axes moves only by rounding.
pub(crate) fn turns_only(way: AxisVector) -> bool {
    let stands = |axis: Axis| way[axis].abs() < LENGTH_MIN;
    Axis::ORTHOGONAL.into_iter().all(stands) && way.orthogonal_length() < LENGTH_MIN
}
