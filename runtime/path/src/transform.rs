//! Requirements that the transforms (D20) make on words, arcs and numbers.

use tandem_model::alarm::{VALUE_OUT_OF_RANGE, check_finite};
use tandem_model::flow::Transform;
use tandem_model::plane::Plane;
use tandem_model::{Alarm, Axis, AxisSet, AxisVector};

/// Returns the axes that words for the axes `named` move. A word for one axis of the rotation's plane moves
/// both axes of the plane.
pub(crate) fn moved(transform: &Transform, named: AxisSet) -> AxisSet {
    let mut moved = named;
    if let Some(rotation) = &transform.rotation {
        let plane = rotation.plane.axes();
        if plane.iter().any(|axis| named.contains(*axis)) {
            for axis in plane {
                moved.insert(axis);
            }
        }
    }
    moved
}

/// Returns the scale of an arc in this plane, and whether the direction of the arc reverses. Returns `None`
/// if the transformed arc is no arc in this plane (D21).
pub(crate) fn arc_scale(transform: &Transform, plane: Plane) -> Option<(f64, bool)> {
    let rotated_out = transform
        .rotation
        .as_ref()
        .is_some_and(|rotation| rotation.plane != plane && rotation.angle_deg.rem_euclid(360.0) != 0.0);
    if rotated_out {
        return None;
    }
    let mut scales = [1.0; 2];
    for (scale, axis) in scales.iter_mut().zip(plane.axes()) {
        if let Some(scaling) = &transform.scaling {
            *scale *= scaling.factors[axis.index()];
        }
        if transform
            .mirror
            .as_ref()
            .is_some_and(|mirror| mirror.axes.contains(axis))
        {
            *scale = -*scale;
        }
    }
    let [first, second] = scales;
    // Factors come from the text or from variables: factors that differ only by rounding are equal.
    let equal = (first.abs() - second.abs()).abs() <= 1e-12 * first.abs();
    equal.then_some((first.abs(), first * second < 0.0))
}

/// Returns true if the transform reverses the sense of rotation in the plane. The left side of the programmed
/// path is then the right side of the machine's path.
pub(crate) fn swaps_sides(transform: &Transform, plane: Plane) -> bool {
    if transform.mirror.is_none() && transform.scaling.is_none() && transform.rotation.is_none() {
        return false;
    }
    let [first, second] = plane.axes();
    let image = |axis: Axis| {
        let mut unit = AxisVector::ZERO;
        unit[axis] = 1.0;
        transform.linear(unit)
    };
    let (a, b) = (image(first), image(second));
    a[first] * b[second] - a[second] * b[first] < 0.0
}

/// Checks the values of a transform.
///
/// # Errors
/// Returns `VALUE_NOT_FINITE` if a value of the transform is not finite, and `VALUE_OUT_OF_RANGE` for a scale
/// factor of 0.
pub(crate) fn check(transform: &Transform) -> Result<(), Alarm> {
    finite(transform.work_offset, "work offset")?;
    finite(transform.local, "local offset")?;
    if let Some(mirror) = &transform.mirror {
        finite(mirror.centre, "mirror centre")?;
    }
    let mut numbers = vec![("tool length", transform.tool_length)];
    if let Some(scaling) = &transform.scaling {
        finite(scaling.centre, "scaling centre")?;
        numbers.extend(scaling.factors.map(|factor| ("scale factor", factor)));
        if scaling.factors.contains(&0.0) {
            let [x, y, z] = scaling.factors;
            let text = format!("A scale factor is 0: X, Y and Z are scaled by {x}, {y} and {z}");
            return Err(Alarm::new(&VALUE_OUT_OF_RANGE, text));
        }
    }
    if let Some(rotation) = &transform.rotation {
        finite(rotation.centre, "centre of rotation")?;
        numbers.push(("angle of rotation", rotation.angle_deg));
    }
    numbers
        .into_iter()
        .try_for_each(|(name, value)| check_finite(format_args!("The {name}"), value))
}

/// Checks that the values of a vector are finite.
///
/// # Errors
/// Returns `VALUE_NOT_FINITE`, with the name of the first axis whose value is not finite.
#[inline]
pub(crate) fn finite(vector: AxisVector, name: &str) -> Result<(), Alarm> {
    if vector.0.iter().fold(true, |all, value| all & value.is_finite()) {
        Ok(())
    } else {
        not_finite(vector, name)
    }
}

#[cold]
fn not_finite(vector: AxisVector, name: &str) -> Result<(), Alarm> {
    Axis::ALL.into_iter().try_for_each(|axis| {
        let name = format_args!("The {name} of axis {}", axis.letter());
        check_finite(name, vector[axis])
    })
}
