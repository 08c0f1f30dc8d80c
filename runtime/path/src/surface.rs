//! F on the A axis of dialect dgshape. F applies to the path of the tool on a circle about Y0 Z0 of the work
//! coordinates; the radius of the circle is taken at the start of the block (1-4 and 2-5).
//!
//! For a block that also moves other axes, the lengths of both paths are combined. For a block of A alone, F
//! has no effect if Z is at its highest position or the tool is at the centre: A then turns as fast as its
//! motor can.

use tandem_model::alarm::check_finite;
use tandem_model::flow::Path;
use tandem_model::settings::RotaryFeed;
use tandem_model::{Alarm, Axis, AxisVector};

use crate::length::{LENGTH_MIN, turns_only};
use crate::stage::PathStage;

impl PathStage {
    /// Returns the line with the length to which F refers.
    pub(crate) fn along_surface(&self, line: Option<Path>) -> Result<Option<Path>, Alarm> {
        let Some(Path::Line { from, to, .. }) = line else {
            return Ok(line);
        };
        let way = to.minus(from);
        let turns = way[Axis::A].abs() >= LENGTH_MIN;
        let straight = way.orthogonal_length();
        let length = if !turns && straight >= LENGTH_MIN {
            straight
        } else {
            let on_surface = way[Axis::A].to_radians() * self.radius_about_a(from);
            straight.hypot(on_surface)
        };
        check_finite("The length of the block", length)?;
        let length = if self.turns_freely(from, to) {
            self.length_of_free_turn(way)
        } else {
            length
        };
        Ok(Some(Path::Line { from, to, length }))
    }

    /// Returns true for a block that moves A alone, and on which F has no effect.
    pub(crate) fn turns_freely(&self, from: AxisVector, to: AxisVector) -> bool {
        let way = to.minus(from);
        let is_alone = self.settings.path.rotary_feed == RotaryFeed::Surface
            && way[Axis::A].abs() >= LENGTH_MIN
            && turns_only(way);
        let on_surface = || way[Axis::A].abs().to_radians() * self.radius_about_a(from);
        is_alone && (on_surface() < LENGTH_MIN || self.is_highest(from))
    }

    /// Returns the distance of the tool from the axis of A at a machine position, mm.
    fn radius_about_a(&self, machine: AxisVector) -> f64 {
        let at = self.transform.inverse(machine);
        at[Axis::Y].hypot(at[Axis::Z])
    }

    fn is_highest(&self, machine: AxisVector) -> bool {
        let highest = self.limit_passed(Axis::Z, machine[Axis::Z] + 2.0 * LENGTH_MIN);
        highest.is_some_and(|(which, _)| which == "upper")
    }

    /// Returns the length for which a motion at the maximum feedrate takes as long as the motor of A at its
    /// maximum velocity.
    fn length_of_free_turn(&self, way: AxisVector) -> f64 {
        let motor = self.settings.motors[Axis::A.index()].as_ref();
        let velocity = motor.map_or(1.0, |motor| motor.max_velocity);
        self.settings.max_feedrate_mm_min / 60.0 * (way[Axis::A].abs() / velocity)
    }
}
