//! The coordinate transforms of D20, applied to points and distances.

use crate::axis::{Axis, AxisSet, AxisVector};
use crate::plane::Plane;

/// Transform from the programmed point to the machine position, applied in the order of the fields (D20).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Transform {
    /// Mirror image, G51.1.
    pub mirror: Option<Mirror>,
    /// Scaling, G51.
    pub scaling: Option<Scaling>,
    /// Rotation, G68.
    pub rotation: Option<Rotation>,
    /// Offset of the local coordinates (G52), added to the point.
    pub local: AxisVector,
    /// Work offset (G54 to G59), added to the point.
    pub work_offset: AxisVector,
    /// Tool length, positive with G43 and negative with G44, added to Z, mm.
    pub tool_length: f64,
}

/// Mirror image of G51.1: each of these axes changes its sign about the centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mirror {
    /// The mirrored axes.
    pub axes: AxisSet,
    /// The centre.
    pub centre: AxisVector,
}

/// Scaling of G51: distances from the centre are multiplied by the factor of the axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scaling {
    /// The centre.
    pub centre: AxisVector,
    /// Factors of X, Y, Z.
    pub factors: [f64; 3],
}

/// Rotation of G68 in a plane about a centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rotation {
    /// The plane.
    pub plane: Plane,
    /// The centre.
    pub centre: AxisVector,
    /// Angle of the rotation, degrees, counter-clockwise positive.
    pub angle_deg: f64,
}

impl Transform {
    /// Returns the machine position of a programmed point: applies mirror, scaling, rotation, local offset,
    /// work offset and tool length, in this order.
    #[inline]
    pub fn forward(&self, point: AxisVector) -> AxisVector {
        let point = if self.only_shifts() {
            point
        } else {
            self.formed(point)
        };
        let mut point = point.plus(self.local).plus(self.work_offset);
        if self.tool_length != 0.0 {
            point[Axis::Z] += self.tool_length;
        }
        point
    }

    /// Returns true without mirror, scaling and rotation. Most programs use none of these, and the point then
    /// stays in processor registers.
    #[inline]
    fn only_shifts(&self) -> bool {
        self.mirror.is_none() && self.scaling.is_none() && self.rotation.is_none()
    }

    /// Returns the point mirrored, scaled and rotated.
    #[inline(never)]
    fn formed(&self, point: AxisVector) -> AxisVector {
        let mut point = self.mirrored(point);
        if let Some(scaling) = &self.scaling {
            for (axis, factor) in Axis::ORTHOGONAL.into_iter().zip(scaling.factors) {
                point[axis] = scaling.centre[axis] + (point[axis] - scaling.centre[axis]) * factor;
            }
        }
        self.rotated(point, 1.0)
    }

    /// Returns the machine distance of a programmed distance, as [`forward`](Self::forward) but without
    /// centres and offsets.
    pub fn linear(&self, mut distance: AxisVector) -> AxisVector {
        if let Some(mirror) = &self.mirror {
            for axis in mirror.axes.iter() {
                distance[axis] = -distance[axis];
            }
        }
        if let Some(scaling) = &self.scaling {
            for (axis, factor) in Axis::ORTHOGONAL.into_iter().zip(scaling.factors) {
                distance[axis] *= factor;
            }
        }
        match &self.rotation {
            Some(rotation) => rotated(rotation, distance, 1.0),
            None => distance,
        }
    }

    /// Returns the programmed point of a machine position. Scale factors must not be zero.
    #[inline]
    pub fn inverse(&self, mut point: AxisVector) -> AxisVector {
        if self.tool_length != 0.0 {
            point[Axis::Z] -= self.tool_length;
        }
        let point = point.minus(self.work_offset).minus(self.local);
        if self.only_shifts() {
            point
        } else {
            self.formed_back(point)
        }
    }

    /// Returns the point after the inverse of rotation, scaling and mirror, in this order.
    #[inline(never)]
    fn formed_back(&self, point: AxisVector) -> AxisVector {
        let mut point = self.rotated(point, -1.0);
        if let Some(scaling) = &self.scaling {
            for (axis, factor) in Axis::ORTHOGONAL.into_iter().zip(scaling.factors) {
                point[axis] = scaling.centre[axis] + (point[axis] - scaling.centre[axis]) / factor;
            }
        }
        self.mirrored(point)
    }

    /// Returns the point mirrored about the centre. The inverse is this same function.
    fn mirrored(&self, mut point: AxisVector) -> AxisVector {
        if let Some(mirror) = &self.mirror {
            for axis in mirror.axes.iter() {
                point[axis] = 2.0 * mirror.centre[axis] - point[axis];
            }
        }
        point
    }

    /// Returns the point rotated about the centre: forward if `sense` is 1, backward if it is -1.
    fn rotated(&self, mut point: AxisVector, sense: f64) -> AxisVector {
        if let Some(rotation) = &self.rotation {
            let from_centre = rotated(rotation, point.minus(rotation.centre), sense);
            for axis in rotation.plane.axes() {
                point[axis] = rotation.centre[axis] + from_centre[axis];
            }
        }
        point
    }

    /// Returns the coordinates that G51 scales, of the tool at this machine position.
    pub fn before_scaling(&self, machine: AxisVector) -> AxisVector {
        Self {
            mirror: None,
            scaling: None,
            ..*self
        }
        .inverse(machine)
    }

    /// Returns the coordinates that G68 rotates, of the tool at this machine position.
    pub fn before_rotation(&self, machine: AxisVector) -> AxisVector {
        Self {
            rotation: None,
            ..*self
        }
        .before_scaling(machine)
    }
}

/// Returns the vector turned in the plane of the rotation: forward if `sense` is 1, backward if it is -1.
fn rotated(rotation: &Rotation, vector: AxisVector, sense: f64) -> AxisVector {
    let [first, second] = rotation.plane.axes();
    let (sin, cos) = sine_and_cosine(rotation.angle_deg);
    let sin = sin * sense;
    let mut turned = vector;
    turned[first] = cos * vector[first] - sin * vector[second];
    turned[second] = sin * vector[first] + cos * vector[second];
    turned
}

/// Returns sine and cosine. They are exact at multiples of 90 degrees, so that such a rotation causes no
/// rounding error on the other axis.
fn sine_and_cosine(angle_deg: f64) -> (f64, f64) {
    let within = angle_deg.rem_euclid(360.0);
    let quarters = [
        (0.0, (0.0, 1.0)),
        (90.0, (1.0, 0.0)),
        (180.0, (0.0, -1.0)),
        (270.0, (-1.0, 0.0)),
    ];
    let exact = quarters
        .into_iter()
        .find(|(angle, _)| (angle - within).abs() == 0.0);
    exact.map_or_else(|| within.to_radians().sin_cos(), |(_, exact)| exact)
}
