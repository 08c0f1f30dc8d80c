//! Half widths of the kernels at the vertices of a chain of chords.
//!
//! A kernel of half width w at a vertex moves the path at the distance x from the vertex by `w b(x/w)` times the turn,
//! with `b(u) = (1 - |u|)^3/6` for `|u| < 1`. Between two vertices the sum of these functions is convex, so its largest
//! values are at the vertices.
//!
//! At each vertex, the *reach* is the largest width with which all vertices may have one width: the sum there is then
//! the part of the tolerance that the chords have left. Widths that change by at most [`SLOPE`] per distance, from the
//! reach times `1 - SLOPE` at each vertex, are nowhere above the reach of a vertex that they touch. A vertex
//! without others in its reach uses all of it.

use std::collections::VecDeque;

use tandem_model::{Axis, AxisVector, bisect};

/// Largest half width, mm or degrees along the path.
const WIDTH_MAX: f64 = 10.0;

/// Largest number of vertices on either side that a kernel touches.
const NEIGHBOURS_MAX: usize = 32;

/// Largest change of the widths per distance.
const SLOPE: f64 = 0.1;

/// Turn below which two chords have one direction.
const TURN_MIN: f64 = 1e-12;

/// Number of halvings of the range of a width. It is exact to 0.1 percent.
const HALVINGS: u32 = 16;

/// A vertex between two chords.
#[derive(Debug, Clone, Copy)]
pub(super) struct Vertex {
    /// Distance along the chain.
    pub(super) at: f64,
    pub(super) point: AxisVector,
    /// Change of the point per distance on the chord after the vertex.
    pub(super) leaving: AxisVector,
    /// Direction after the vertex minus direction before it.
    pub(super) turn: AxisVector,
    /// Size of the turn; 0 at both ends of the chain.
    turn_size: f64,
    /// Part of the tolerance that the chords have left.
    budget: f64,
    reach: f64,
    /// Half width of the kernel; 0 without a turn.
    pub(super) width: f64,
}

/// The vertices of a chain whose blocks are not final, in order.
#[derive(Debug, Clone, Default)]
pub(super) struct Vertices {
    list: VecDeque<Vertex>,
    tolerance: f64,
    /// Number of vertices in `list` whose reach is known.
    reached: usize,
    /// Number of vertices in `list` whose width is final.
    decided: usize,
    /// True when no further chord follows.
    is_complete: bool,
}

impl Vertices {
    /// Begins the chain at this point, unless it has begun.
    pub(super) fn begin_chain(&mut self, at: f64, point: AxisVector, tolerance: f64) {
        if self.list.is_empty() {
            self.tolerance = tolerance;
            self.list.push_back(Vertex::new(at, point, tolerance));
        }
    }

    /// Adds a chord from the last vertex to a new vertex; `error` is its largest distance from the programmed path.
    pub(super) fn add(&mut self, at: f64, point: AxisVector, error: f64) {
        let budget = self.tolerance - error;
        let before = self.list.len().checked_sub(2);
        let arriving = before.and_then(|i| self.list.get(i)).map(|vertex| vertex.leaving);
        if let Some(last) = self.list.back_mut() {
            last.leaving = point.minus(last.point).scaled(1.0 / (at - last.at));
            last.budget = last.budget.min(budget);
            if let Some(arriving) = arriving {
                last.turn = last.leaving.minus(arriving);
                last.turn_size = size(last.turn);
            }
            if last.turn_size < TURN_MIN {
                last.turn_size = 0.0;
            }
        }
        self.list.push_back(Vertex::new(at, point, budget));
    }

    /// Determines the widths that no later vertex can change.
    pub(super) fn settle(&mut self, is_complete: bool) {
        self.is_complete = is_complete;
        while let Some(reach) = self.next_reach() {
            self.list[self.reached].reach = reach;
            self.reached += 1;
        }
        while let Some(width) = self.next_width() {
            self.list[self.decided].width = width;
            self.decided += 1;
        }
    }

    /// Returns the vertices that may turn between two indices, and the known end of the chain.
    fn next_reach(&self) -> Option<f64> {
        let (k, last) = (self.reached, self.list.len().checked_sub(1)?);
        let vertex = self.list.get(k)?;
        let right = self
            .list
            .get(k + NEIGHBOURS_MAX)
            .filter(|_| k + NEIGHBOURS_MAX < last);
        let end = self.list.get(last)?.at - vertex.at;
        if right.is_none() && end < WIDTH_MAX && !self.is_complete {
            return None;
        }
        if vertex.turn_size == 0.0 {
            return Some(0.0);
        }
        let left = self.list.get(k.saturating_sub(NEIGHBOURS_MAX))?;
        let most = (right.map_or(end, |right| right.at - vertex.at))
            .min(vertex.at - left.at)
            .min(WIDTH_MAX);
        let fits = |width: f64| self.moved_by(k, width) <= vertex.budget;
        let alone = most.min(6.0 * vertex.budget / vertex.turn_size);
        if fits(alone) {
            Some(alone)
        } else {
            Some(bisect([0.0, alone], HALVINGS, fits)[0])
        }
    }

    /// Returns the bound of the deviation at a vertex if all kernels have this width.
    fn moved_by(&self, k: usize, width: f64) -> f64 {
        let Some(centre) = self.list.get(k) else {
            return 0.0;
        };
        let part = |vertex: &Vertex| {
            let left = 1.0 - (vertex.at - centre.at).abs() / width;
            (left > 0.0).then_some(vertex.turn_size * width * left * left * left / 6.0)
        };
        let before = self.list.range(..k).rev().map_while(part).sum::<f64>();
        self.list.range(k..).map_while(part).sum::<f64>() + before
    }

    /// Returns the width of the next vertex, if no later vertex can change it.
    fn next_width(&self) -> Option<f64> {
        let k = self.decided;
        let vertex = self.list.get(k).filter(|_| k < self.reached)?;
        if vertex.turn_size == 0.0 {
            return Some(0.0);
        }
        let mut width = (1.0 - SLOPE) * vertex.reach;
        let turns = |other: &&Vertex| other.turn_size > 0.0;
        for other in self.list.range(..k).rev().filter(turns) {
            let distance = vertex.at - other.at;
            if SLOPE * distance >= width {
                break;
            }
            width = width.min((1.0 - SLOPE) * other.reach + SLOPE * distance);
        }
        let mut is_final = self.is_complete;
        for other in self.list.range(k + 1..self.reached) {
            let distance = other.at - vertex.at;
            if SLOPE * distance >= width {
                is_final = true;
                break;
            }
            if other.turn_size > 0.0 {
                width = width.min((1.0 - SLOPE) * other.reach + SLOPE * distance);
            }
        }
        let mut beside = [
            self.list.range(..k).rev().find(turns),
            self.list.range(k + 1..self.reached).find(turns),
        ]
        .into_iter()
        .flatten();
        let is_alone = beside.all(|other| {
            let distance = (other.at - vertex.at).abs();
            other.reach <= distance && vertex.reach <= distance
        });
        is_final.then_some(if is_alone { vertex.reach } else { width })
    }

    /// Returns the distance along the chain up to which all widths are final that affect the path.
    pub(super) fn known_to(&self) -> f64 {
        let Some(next) = self.list.get(self.decided) else {
            return f64::NEG_INFINITY;
        };
        let far = next.at - WIDTH_MAX;
        self.decided
            .checked_sub(NEIGHBOURS_MAX)
            .and_then(|i| self.list.get(i))
            .map_or(far, |vertex| vertex.at.max(far))
    }

    /// Drops the vertices that affect neither the path after this distance nor widths that are not final.
    pub(super) fn forget_before(&mut self, at: f64) {
        while self.decided > 2 * NEIGHBOURS_MAX
            && let Some(vertex) = self.list.get(2 * NEIGHBOURS_MAX)
            && vertex.at <= at
            && let Some(next) = self.list.get(self.decided)
            && let Some(second) = self.list.get(1)
            && second.at < next.at - WIDTH_MAX / SLOPE
        {
            self.list.pop_front();
            self.decided -= 1;
            self.reached -= 1;
        }
    }

    /// Returns the index of the chord at this distance along the chain.
    pub(super) fn chord_at(&self, at: f64) -> usize {
        let after = self.list.partition_point(|vertex| vertex.at <= at);
        after.saturating_sub(1).min(self.list.len().saturating_sub(2))
    }

    /// Returns the vertex with this index.
    pub(super) fn get(&self, index: usize) -> Option<&Vertex> {
        self.list.get(index)
    }

    /// Returns the vertices whose kernels may touch the range of a chain.
    pub(super) fn near(&self, [from, to]: [f64; 2]) -> impl Iterator<Item = &Vertex> {
        let first = self.list.partition_point(|vertex| vertex.at <= from - WIDTH_MAX);
        let end = self.list.partition_point(|vertex| vertex.at < to + WIDTH_MAX);
        let beside = [self.chord_at(from), self.chord_at(to)];
        let first = first.max(beside[0].saturating_sub(NEIGHBOURS_MAX));
        let end = end.min(beside[1] + NEIGHBOURS_MAX + 2);
        self.list
            .range(first..end.max(first))
            .filter(|vertex| vertex.width > 0.0)
    }
}

impl Vertex {
    fn new(at: f64, point: AxisVector, budget: f64) -> Self {
        Self {
            at,
            point,
            leaving: AxisVector::ZERO,
            turn: AxisVector::ZERO,
            turn_size: 0.0,
            budget,
            reach: 0.0,
            width: 0.0,
        }
    }
}

/// Returns the size of a difference: the length over X, Y and Z, or the largest value of another axis.
pub(super) fn size(vector: AxisVector) -> f64 {
    Axis::ALL
        .into_iter()
        .filter(|axis| !axis.is_orthogonal())
        .fold(vector.orthogonal_length(), |most, axis| {
            most.max(vector[axis].abs())
        })
}
