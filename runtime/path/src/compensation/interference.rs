//! Overcut: finds places where the tool on one block would cut into another block (M1g).
//!
//! Blocks whose directions lie within half a turn have no overcut if a part of each block remains between its
//! neighbours. The reason: as the radius grows from zero, each block keeps its direction, and curves that
//! advance in one direction never meet again. So only blocks whose directions differ more are measured: the
//! path of the tool centre on each block against the programmed shape of the other block.

use std::collections::VecDeque;

use super::curve::Curve;
use super::distance::distance;
use super::piece::{CentrePath, Piece, Role};

/// Overcuts smaller than this are caused by rounding in programs, mm.
pub(super) const OVERCUT_MIN: f64 = 1e-3;

/// Range of directions up to which blocks are treated as within half a turn, radians.
const HALF_TURN: f64 = 3.1;

/// An overcut between a piece and an earlier piece of the queue.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Overcut {
    /// Index of the earlier piece in the queue.
    pub earlier: usize,
    /// Distance of the tool's centre on one piece from the programmed curve of the other piece, mm.
    pub distance: f64,
}

/// Returns the first piece of the queue with which the piece at `place` interferes. This is the piece itself,
/// or an earlier piece after the last move along another axis.
pub(super) fn with_earlier(queue: &VecDeque<Piece>, place: usize, radius: f64) -> Option<Overcut> {
    let piece = queue.get(place)?;
    let [mut low, mut high] = piece.directions;
    let mut measured = false;
    let mut found = None;
    for earlier in (0..=place).rev() {
        let other = queue.get(earlier)?;
        if other.role != Role::Contour || (earlier < place && other.lifts()) {
            break;
        }
        low = low.min(other.directions[0]);
        high = high.max(other.directions[1]);
        measured |= high - low >= HALF_TURN || other.dropped;
        if !measured {
            continue;
        }
        let to_wall = |piece: &Piece, other| to_wall(piece.way.as_ref()?, other, radius);
        let distance = to_wall(piece, other).or_else(|| to_wall(other, piece));
        if let Some(distance) = distance {
            found = Some(Overcut { earlier, distance });
        }
    }
    found
}

/// Finds an overcut of an arc added before the lead-out. The arc follows the pieces in the queue, and begins
/// at the corner of the last piece. It belongs to no block of the contour, but the tool can also cut on it.
/// The lead-out itself is not measured.
pub(super) fn with_last_arc(queue: &VecDeque<Piece>, arc: Curve, radius: f64) -> Option<Overcut> {
    let way = CentrePath::from_parts(&[Some(arc), None, None, None])?;
    let mut found = None;
    for (earlier, other) in queue.iter().enumerate().rev() {
        if other.role != Role::Contour || other.lifts() {
            break;
        }
        if let Some(distance) = to_wall(&way, other, radius) {
            found = Some(Overcut { earlier, distance });
        }
    }
    found
}

/// Returns the distance of the tool's centre from the programmed curve of a piece, if the distance is too
/// small.
pub(super) fn to_wall(way: &CentrePath, other: &Piece, radius: f64) -> Option<f64> {
    let allowed = radius - OVERCUT_MIN;
    if !way.bounds.is_near(&other.wall_bounds, allowed) {
        return None;
    }
    let closest = way
        .parts()
        .map(|part| distance(part, &other.wall))
        .fold(f64::INFINITY, f64::min);
    (closest < allowed).then_some(closest)
}
