//! Overcut: places where the tool on one block would cut into another one (M1g).
//!
//! Blocks whose directions lie within half a turn have no overcut if a part of each remains between its
//! neighbours: as the radius grows from zero, each keeps its direction, and curves that advance in one
//! direction never meet again. So only blocks whose directions differ more are measured: the path of the tool
//! centre on each against the programmed shape of the other.

use std::collections::VecDeque;

use super::curve::Curve;
use super::distance::distance;
use super::piece::{CentrePath, Piece, Role};

/// Overcuts by less than this are the rounding of programs, mm.
pub(super) const OVERCUT_MIN: f64 = 1e-3;

/// Directions within this angle are treated as within half a turn, radians.
const HALF_TURN: f64 = 3.1;

/// A piece that the tool on another one would cut into.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Overcut {
    /// Place in the queue.
    pub earlier: usize,
    /// Distance of the tool's centre from it, mm.
    pub distance: f64,
}

/// Returns the first piece that the piece at `place` interferes with: itself, or one of those in the queue
/// before it and after the last move along another axis.
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

/// Finds an overcut of an arc added before the lead-out, which follows the pieces in the queue and leaves the
/// last piece's corner: it belongs to no block of the contour, but the tool can cut on it too. The lead-out
/// itself is not measured.
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

/// Returns the distance of the tool's centre from the programmed curve of a piece, when that is too small.
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
