//! From the programmed point to the machine position and back (D20).

use tandem_model::alarm::{VALUE_NOT_FINITE, VALUE_OUT_OF_RANGE};
use tandem_model::flow::{Plane, Rotation, Transform};
use tandem_model::{Alarm, Axis, AxisVector};

/// The machine position of a programmed point: mirror, scaling, rotation, local, work offset, tool length.
pub(crate) fn forward(transform: &Transform, point: AxisVector) -> AxisVector {
    let mut point = point;
    if let Some(mirror) = &transform.mirror {
        for axis in mirror.axes.iter() {
            point[axis] = 2.0 * mirror.centre[axis] - point[axis];
        }
    }
    if let Some(scaling) = &transform.scaling {
        for (axis, factor) in SCALED.into_iter().zip(scaling.factors) {
            point[axis] = scaling.centre[axis] + (point[axis] - scaling.centre[axis]) * factor;
        }
    }
    if let Some(rotation) = &transform.rotation {
        let from_centre = turned(rotation, point.minus(rotation.centre), 1.0);
        for axis in rotation.plane.axes() {
            point[axis] = rotation.centre[axis] + from_centre[axis];
        }
    }
    let mut point = point.plus(transform.local).plus(transform.work_offset);
    point[Axis::Z] += transform.tool_length;
    point
}

/// The machine distance of a programmed distance: what is left of [`forward`] without centres and offsets.
pub(crate) fn linear(transform: &Transform, distance: AxisVector) -> AxisVector {
    let mut distance = distance;
    if let Some(mirror) = &transform.mirror {
        for axis in mirror.axes.iter() {
            distance[axis] = -distance[axis];
        }
    }
    if let Some(scaling) = &transform.scaling {
        for (axis, factor) in SCALED.into_iter().zip(scaling.factors) {
            distance[axis] *= factor;
        }
    }
    match &transform.rotation {
        Some(rotation) => turned(rotation, distance, 1.0),
        None => distance,
    }
}

/// The programmed point of a machine position. Scale factors must not be zero.
pub(crate) fn inverse(transform: &Transform, machine: AxisVector) -> AxisVector {
    let mut point = machine;
    point[Axis::Z] -= transform.tool_length;
    let mut point = point.minus(transform.work_offset).minus(transform.local);
    if let Some(rotation) = &transform.rotation {
        let from_centre = turned(rotation, point.minus(rotation.centre), -1.0);
        for axis in rotation.plane.axes() {
            point[axis] = rotation.centre[axis] + from_centre[axis];
        }
    }
    if let Some(scaling) = &transform.scaling {
        for (axis, factor) in SCALED.into_iter().zip(scaling.factors) {
            point[axis] = scaling.centre[axis] + (point[axis] - scaling.centre[axis]) / factor;
        }
    }
    if let Some(mirror) = &transform.mirror {
        for axis in mirror.axes.iter() {
            point[axis] = 2.0 * mirror.centre[axis] - point[axis];
        }
    }
    point
}

/// True when a word of one of these axes may move the other: the rotation's plane.
pub(crate) fn couples(transform: &Transform, axis: Axis) -> Option<[Axis; 2]> {
    let axes = transform.rotation.as_ref()?.plane.axes();
    axes.contains(&axis).then_some(axes)
}

/// What an arc of this plane becomes: `None` when it is no arc of this plane any more (D21), else its scale and
/// whether its sense of turning changes.
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
    // Factors are typed in or read from one variable: equal means equal up to rounding.
    let equal = (first.abs() - second.abs()).abs() <= 1e-12 * first.abs();
    equal.then_some((first.abs(), first * second < 0.0))
}

/// # Errors
/// `VALUE_NOT_FINITE` when any value of the transform is not a number; `VALUE_OUT_OF_RANGE` for a scale factor of 0.
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
            let text = format!("A scale factor is 0: X, Y, Z are {:?}", scaling.factors);
            return Err(Alarm::new(&VALUE_OUT_OF_RANGE, text));
        }
    }
    if let Some(rotation) = &transform.rotation {
        finite(rotation.centre, "centre of rotation")?;
        numbers.push(("angle of rotation", rotation.angle_deg));
    }
    match numbers.iter().find(|(_, value)| !value.is_finite()) {
        Some((name, value)) => Err(Alarm::new(&VALUE_NOT_FINITE, format!("The {name} is {value}"))),
        None => Ok(()),
    }
}

/// # Errors
/// `VALUE_NOT_FINITE`, with the name of the first axis whose value is not a number.
pub(crate) fn finite(vector: AxisVector, name: &str) -> Result<(), Alarm> {
    let not_finite = Axis::ALL.into_iter().find(|&axis| !vector[axis].is_finite());
    match not_finite {
        None => Ok(()),
        Some(axis) => {
            let text = format!("The {name} of axis {} is {}", axis.letter(), vector[axis]);
            Err(Alarm::new(&VALUE_NOT_FINITE, text))
        }
    }
}

/// Axes that G51 scales.
const SCALED: [Axis; 3] = [Axis::X, Axis::Y, Axis::Z];

/// The vector turned in the rotation's plane, forth (`sense` 1) or back (-1).
fn turned(rotation: &Rotation, vector: AxisVector, sense: f64) -> AxisVector {
    let [first, second] = rotation.plane.axes();
    let (sin, cos) = sine_and_cosine(rotation.angle_deg);
    let sin = sin * sense;
    let mut turned = vector;
    turned[first] = cos * vector[first] - sin * vector[second];
    turned[second] = sin * vector[first] + cos * vector[second];
    turned
}

/// Exact at whole quarter turns, so that they leave no rounding error on the other axis.
fn sine_and_cosine(angle_deg: f64) -> (f64, f64) {
    let within = angle_deg.rem_euclid(360.0);
    let quarters = [
        (0.0, (0.0, 1.0)),
        (90.0, (1.0, 0.0)),
        (180.0, (0.0, -1.0)),
        (270.0, (-1.0, 0.0)),
    ];
    match quarters
        .into_iter()
        .find(|(angle, _)| (angle - within).abs() == 0.0)
    {
        Some((_, exact)) => exact,
        None => within.to_radians().sin_cos(),
    }
}
