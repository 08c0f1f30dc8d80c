//! Curves of a block, from the vertices of its chain.

use tandem_model::AxisVector;

use super::WaitingBlock;
use super::widths::{Vertex, Vertices};
use crate::smooth_block::{SmoothBlock, Stretch};

/// Distance between two ends of curves, relative to the smaller width of their kernels, below which the curve between
/// them is left out. The second derivative then has a step of this relative size.
const SAME_PLACE: f64 = 1e-5;

/// An end of a curve: distance along the chain, and width of the kernel that ends there.
type Knot = (f64, f64);

/// Returns the curves of a block.
pub(super) fn smooth_block(
    block: &WaitingBlock,
    vertices: &Vertices,
    [begins_at_rest, ends_at_rest]: [bool; 2],
) -> SmoothBlock {
    let [from, to] = block.range;
    let mut knots: Vec<Knot> = vertices
        .near(block.range)
        .flat_map(|vertex| [-1.0, 0.0, 1.0].map(|side| (vertex.at + side * vertex.width, vertex.width)))
        .filter(|(at, _)| *at > from && *at < to)
        .collect();
    knots.sort_by(|one, other| one.0.total_cmp(&other.0));
    let mut begin = (from, f64::INFINITY);
    let mut stretches = Vec::with_capacity(knots.len() + 1);
    let far = |one: Knot, other: Knot| other.0 - one.0 > SAME_PLACE * one.1.min(other.1);
    for knot in knots {
        let is_apart = if begin.1.is_finite() {
            far(begin, knot)
        } else {
            knot.0 - from > SAME_PLACE * knot.1
        };
        if is_apart && to - knot.0 > SAME_PLACE * knot.1 {
            stretches.push(stretch(vertices, [begin.0, knot.0], from, block.speed));
            begin = knot;
        }
    }
    stretches.push(stretch(vertices, [begin.0, to], from, block.speed));
    if begins_at_rest && let Some(first) = stretches.first_mut() {
        first.derivatives[0] = block.programmed[0];
    }
    let [start_s, stop_s] = block.ramps_s;
    let ramp_s = f64::max(
        if begins_at_rest { start_s } else { 0.0 },
        if ends_at_rest { stop_s } else { 0.0 },
    );
    let plan_s = (to - from) / block.speed;
    SmoothBlock {
        programmed: block.programmed,
        speed: block.speed,
        begins_at_rest,
        ends_at_rest,
        // Rule `shrink` of M1b.4: the ramp takes no longer than the block.
        ramp_s: ramp_s.min(plan_s),
        stretches: stretches.into(),
        plan_s,
    }
}

/// Returns the stretch between two ends of curves, of a block that begins at the distance `block_from`.
fn stretch(vertices: &Vertices, [from, to]: [f64; 2], block_from: f64, speed: f64) -> Stretch {
    let middle = f64::midpoint(from, to);
    let [mut position, mut first, mut second, mut third] = on_chord(vertices, middle);
    for vertex in vertices.near([middle, middle]) {
        let x = middle - vertex.at;
        let left = 1.0 - x.abs() / vertex.width;
        if left <= 0.0 {
            continue;
        }
        let (turn, w) = (vertex.turn, vertex.width);
        position = position.plus(turn.scaled(w * left * left * left / 6.0));
        first = first.plus(turn.scaled(-(left * left / 2.0).copysign(x)));
        second = second.plus(turn.scaled(left / w));
        third = third.plus(turn.scaled(-(1.0 / (w * w)).copysign(x)));
    }
    let back = from - middle;
    position = position
        .plus(first.scaled(back))
        .plus(second.scaled(back * back / 2.0))
        .plus(third.scaled(back * back * back / 6.0));
    first = first
        .plus(second.scaled(back))
        .plus(third.scaled(back * back / 2.0));
    second = second.plus(third.scaled(back));
    Stretch {
        from_s: (from - block_from) / speed,
        derivatives: [
            position,
            first.scaled(speed),
            second.scaled(speed * speed),
            third.scaled(speed * speed * speed),
        ],
    }
}

/// Returns the point on the chord at this distance, and its derivatives.
fn on_chord(vertices: &Vertices, at: f64) -> [AxisVector; 4] {
    let vertex: Option<&Vertex> = vertices.get(vertices.chord_at(at));
    vertex.map_or([AxisVector::ZERO; 4], |vertex| {
        [
            vertex.point.plus(vertex.leaving.scaled(at - vertex.at)),
            vertex.leaving,
            AxisVector::ZERO,
            AxisVector::ZERO,
        ]
    })
}
