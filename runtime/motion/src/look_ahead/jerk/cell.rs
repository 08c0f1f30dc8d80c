//! A cell of the path, with the constraints of the motors.

/// The constraints of one motor at one point of a cell. In shares of the limits, with the square x of the speed, the
/// acceleration b along the path and its change c per distance, the acceleration is `second x + first b + by_change c`, and
/// the jerk is `sqrt(x) (jerk[0] x + jerk[1] b + jerk[2] c)`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row {
    /// Distance of the point from the start of the cell.
    pub(super) at: f64,
    /// Length after the point on which the third derivative is constant.
    pub(super) reach: f64,
    /// Change of `second` per distance.
    pub(super) third: f64,
    pub(super) second: f64,
    pub(super) first: f64,
    /// Factor of the change of the acceleration; 0 except in a joint.
    pub(super) by_change: f64,
    pub(super) jerk: [f64; 3],
}

/// A part of the path on which the acceleration along the path is linear in distance; or a joint of length 0, at which the
/// acceleration along the path changes by c at once.
#[derive(Debug, Clone, Default)]
pub(super) struct Cell {
    pub(super) from: f64,
    pub(super) length: f64,
    pub(super) rows: Vec<Row>,
    /// Points of the cell, with the largest square of the speed at each.
    pub(super) caps: Vec<[f64; 2]>,
    /// Largest square of the speed in the whole cell.
    pub(super) cap: f64,
    /// Part of the limits that the motion in the cell may use.
    pub(super) limit: f64,
    /// Part of the jerks that joints near the cell leave.
    pub(super) jerk_left: f64,
    /// Room in the cells near it, if the cell is a joint.
    pub(super) joint: Option<Room>,
}

/// Room that a joint needs in the cells near it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Room {
    /// Part of the jerk that the joint leaves.
    pub(super) left: f64,
    /// Distance before and after the joint.
    pub(super) zone: f64,
}

impl Room {
    /// Limits the jerk in cells, which are in the order of their distance from the joint.
    pub(super) fn leave<'a>(&self, cells: impl Iterator<Item = &'a mut Cell>, at: f64) {
        let is_near =
            |cell: &&mut Cell| cell.from < at + self.zone && cell.from + cell.length > at - self.zone;
        for cell in cells.take_while(is_near).filter(|cell| !cell.is_joint()) {
            cell.jerk_left = cell.jerk_left.min(self.left);
        }
    }
}

impl Row {
    pub(super) fn limits_jerk(&self) -> bool {
        self.jerk.iter().any(|factor| factor.abs() > 0.0)
    }

    /// Returns the constraints at a distance after the point, within its reach.
    pub(super) fn shifted(&self, by: f64) -> Self {
        let [j0, j1, j2] = self.jerk;
        Self {
            at: self.at + by,
            reach: self.reach - by,
            second: self.second + self.third * by,
            first: self.first + by * (self.second + self.third * by / 2.0),
            jerk: [j0, j1 + 3.0 * j0 * by, j2 + by * (j1 / 3.0 + j0 * by / 2.0)],
            ..*self
        }
    }
}

impl Cell {
    pub(super) fn is_joint(&self) -> bool {
        self.joint.is_some()
    }

    /// Tightens the jerk limits of the cell by a factor.
    pub(super) fn tighten(&mut self, factor: f64) {
        for row in &mut self.rows {
            row.jerk = row.jerk.map(|value| value * factor);
        }
    }

    /// Tightens the acceleration limits of the cell by a factor.
    pub(super) fn tighten_acceleration(&mut self, factor: f64) {
        for row in &mut self.rows {
            row.third *= factor;
            row.second *= factor;
            row.first *= factor;
        }
    }
}
