//! Prevention of overcuts: leaves out parts of a contour into which the tool does not fit (M1g).

use std::collections::VecDeque;

use super::distance::{first_on, intersections};
use super::interference::to_wall;
use super::piece::{CentrePath, Piece, Role};

/// Tries to join the piece at `place` with the piece `first` or an earlier piece, and leaves out the pieces
/// between them. Returns `false`, without any change, if each such path has an overcut. Pieces followed by
/// blocks that do not move in the plane are not left out.
pub(super) fn prevent(queue: &mut VecDeque<Piece>, place: usize, first: u64, radius: f64) -> bool {
    for earlier in (0..place).rev() {
        let Some(piece) = queue.get(earlier) else {
            return false;
        };
        if piece.role != Role::Contour || !piece.stills.is_empty() {
            return false;
        }
        if piece.id > first {
            continue;
        }
        let Some(ways) = joined(queue, earlier, place) else {
            continue;
        };
        if is_free(queue, earlier, place, &ways, radius) {
            apply(queue, earlier, place, ways);
            return true;
        }
    }
    false
}

fn joined(queue: &VecDeque<Piece>, earlier: usize, place: usize) -> Option<[CentrePath; 2]> {
    let before = queue.get(earlier)?.way.as_ref()?;
    join(before, queue.get(place)?.way.as_ref()?)
}

/// Returns true if neither the shortened paths nor the paths before them come too close to a programmed
/// curve.
fn is_free(
    queue: &VecDeque<Piece>,
    earlier: usize,
    place: usize,
    [before, after]: &[CentrePath; 2],
    radius: f64,
) -> bool {
    let hits = |way: &CentrePath, piece: &Piece| to_wall(way, piece, radius).is_some();
    // Pieces that had no path until now are measured here for the first time.
    let shortened_hits = |piece: &Piece| hits(before, piece) || hits(after, piece);
    if queue.range(earlier..=place).any(shortened_hits) {
        return false;
    }
    for piece in queue.range(..earlier).rev() {
        if piece.role != Role::Contour || piece.lifts() {
            break;
        }
        let hit = shortened_hits(piece)
            || piece
                .way
                .as_ref()
                .is_some_and(|way| queue.range(earlier..=place).any(|other| hits(way, other)));
        if hit {
            return false;
        }
    }
    true
}

fn apply(queue: &mut VecDeque<Piece>, earlier: usize, place: usize, [before, after]: [CentrePath; 2]) {
    for (i, piece) in queue.iter_mut().enumerate().take(place + 1).skip(earlier) {
        piece.dropped = i != earlier && i != place;
        piece.way = match i {
            _ if i == earlier => Some(before),
            _ if i == place => Some(after),
            _ => None,
        };
    }
}

/// Joins two paths where they first meet, without the parts between. Returns `None` if they do not meet.
fn join(earlier: &CentrePath, later: &CentrePath) -> Option<[CentrePath; 2]> {
    for (i, part) in earlier.parts.iter().enumerate() {
        let Some(part) = part else { continue };
        for (k, other) in later.parts.iter().enumerate() {
            let Some(other) = other else { continue };
            let Some(meet) = first_on(part, intersections(part, other)) else {
                continue;
            };
            let [mut before, mut after] = [earlier.parts, later.parts];
            before[i] = Some(part.between(part.from(), meet)?);
            before[i + 1..].fill(None);
            after[..k].fill(None);
            after[k] = Some(other.between(meet, other.to())?);
            return Some([CentrePath::from_parts(&before)?, CentrePath::from_parts(&after)?]);
        }
    }
    None
}
