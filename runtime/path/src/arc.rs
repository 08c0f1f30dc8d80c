//! G02 and G03: converts the words of an arc to the circle in machine coordinates (M1f, D21, D26).

use tandem_model::alarm::{ARC_DISTORTED, ARC_IMPOSSIBLE, VALUE_NOT_FINITE, check_finite};
use tandem_model::flow::{Arc, ArcShape, Block, Frame, Path, Rotation, Scaling, Transform};
use tandem_model::plane::{Plane, Turn};
use tandem_model::{Alarm, ArcPath, Axis, AxisVector};

use crate::length::{LENGTH_MIN, line_between};
use crate::stage::PathStage;
use crate::transform;

impl PathStage {
    /// Returns the path of an arc; `None` if R is 0 and the target is the start point.
    pub(crate) fn arc(&self, block: &Block, arc: &Arc) -> Result<Option<Path>, Alarm> {
        let plane = arc.plane.axes();
        if let Some(axis) = plane.into_iter().find(|axis| !self.axes.contains(*axis)) {
            return Err(Self::axis_missing(axis));
        }
        let mut to = self.target(block, &arc.target)?;
        let transform = match arc.target.frame {
            Frame::Work => self.transform,
            Frame::Machine => Transform::default(),
        };
        let Some((scale, flips)) = transform::arc_scale(&transform, arc.plane) else {
            return Err(Alarm::new(&ARC_DISTORTED, distortion(&transform, arc.plane)));
        };
        let turn = if flips { arc.turn.reversed() } else { arc.turn };
        let chord = plane.map(|axis| to[axis] - self.at[axis]);
        let closed = chord[0].hypot(chord[1]) < LENGTH_MIN;
        let from_start = match arc.shape {
            ArcShape::Centre(ijk) => {
                if closed {
                    for axis in plane {
                        to[axis] = self.at[axis];
                    }
                }
                let mut programmed = AxisVector::ZERO;
                programmed.0[..3].copy_from_slice(&ijk);
                let machine = transform.linear(programmed);
                plane.map(|axis| machine[axis])
            }
            ArcShape::Radius(0.0) => return line_between(self.at, to),
            ArcShape::Radius(radius) => {
                if plane.iter().all(|axis| !arc.target.named.contains(*axis)) {
                    let [first, second] = plane.map(Axis::letter);
                    let text = format!(
                        "R {radius:.6} mm: the block has neither {first} nor {second}, so the target is the start point"
                    );
                    return Err(Alarm::new(&ARC_IMPOSSIBLE, text).of_words("R"));
                }
                centre_from_radius(
                    chord,
                    radius * scale,
                    turn,
                    self.settings.motion.arc_radius_tolerance_mm,
                )?
            }
        };
        self.around(from_start, to, arc, turn).map(Path::Arc).map(Some)
    }

    /// Returns the arc about a centre that is at `from_start`, measured from the start point.
    fn around(&self, from_start: [f64; 2], to: AxisVector, arc: &Arc, turn: Turn) -> Result<ArcPath, Alarm> {
        let [first, second] = arc.plane.axes();
        let centre = [self.at[first] + from_start[0], self.at[second] + from_start[1]];
        let start_radius = from_start[0].hypot(from_start[1]);
        let end_radius = (to[first] - centre[0]).hypot(to[second] - centre[1]);
        if !start_radius.is_finite() || !end_radius.is_finite() {
            let text = format!("The radius is {start_radius} at the start, {end_radius} at the end");
            return Err(Alarm::new(&VALUE_NOT_FINITE, text));
        }
        for (name, radius) in [("start", start_radius), ("end", end_radius)] {
            if radius < LENGTH_MIN {
                let text = format!(
                    "The centre {}{:.6} {}{:.6} (machine) is the {name} point",
                    first.letter(),
                    centre[0],
                    second.letter(),
                    centre[1]
                );
                return Err(Alarm::new(&ARC_IMPOSSIBLE, text).of_words(centre_words(arc.plane)));
            }
        }
        let tolerance = self.settings.motion.spiral_tolerance_mm;
        if tolerance > 0.0 && (end_radius - start_radius).abs() > tolerance {
            let text = format!(
                "The radius is {start_radius:.6} mm at the start, {end_radius:.6} mm at the end, and spiral_tolerance \
                 is {tolerance} mm"
            );
            return Err(Alarm::new(&ARC_IMPOSSIBLE, text).of_words(centre_words(arc.plane)));
        }
        let path = ArcPath::new(self.at, to, arc.plane, centre, turn);
        check_finite("The length of the arc", path.length()).map(|()| path)
    }
}

/// Returns a text that names the parts of a transform that distort an arc in this plane.
fn distortion(transform: &Transform, plane: Plane) -> String {
    let scaling = transform.scaling.map(|Scaling { factors, .. }| {
        let [x, y, z] = factors;
        format!("; X, Y and Z are scaled by {x}, {y} and {z}")
    });
    let rotation = transform.rotation.map(|Rotation { plane, angle_deg, .. }| {
        format!("; the rotation is by {angle_deg} degrees in {plane}")
    });
    let (scaling, rotation) = (scaling.unwrap_or_default(), rotation.unwrap_or_default());
    format!("The arc is in {plane}{scaling}{rotation}")
}

/// Returns the letters of the words that give the centre of an arc in this plane.
fn centre_words(plane: Plane) -> &'static str {
    match plane {
        Plane::Xy => "IJ",
        Plane::Zx => "KI",
        Plane::Yz => "JK",
    }
}

/// Returns the centre, measured from the start point. The centre is at a distance of `sqrt(R^2 - c^2/4)` from
/// the middle of the chord of length c. It is to the left for a counter-clockwise arc up to a half circle and
/// for a larger clockwise arc, otherwise to the right.
fn centre_from_radius(
    chord: [f64; 2],
    radius: f64,
    turn: Turn,
    tolerance_mm: f64,
) -> Result<[f64; 2], Alarm> {
    let length = chord[0].hypot(chord[1]);
    check_finite("R", radius)?;
    if length < LENGTH_MIN {
        let text = format!("R {radius:.6} mm: the target is the start point in the arc's plane");
        return Err(Alarm::new(&ARC_IMPOSSIBLE, text).of_words("R"));
    }
    let half = length / 2.0;
    if radius.abs() < half - tolerance_mm {
        let text = format!("R {radius:.6} mm is smaller than half the distance to the target, {half:.6} mm");
        return Err(Alarm::new(&ARC_IMPOSSIBLE, text).of_words("R"));
    }
    // The form (R - h)(R + h) stays exact if R is only slightly more than half the chord (h).
    let off_chord = ((radius.abs() - half) * (radius.abs() + half)).max(0.0).sqrt();
    let left = (radius > 0.0) == (turn == Turn::CounterClockwise);
    let side = if left { off_chord } else { -off_chord } / length;
    Ok([chord[0] / 2.0 - side * chord[1], chord[1] / 2.0 + side * chord[0]])
}
