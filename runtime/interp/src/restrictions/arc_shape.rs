//! Checks whether the words of an arc define an arc (D26), as far as the text shows it.

use tandem_syntax::Address;
use tandem_syntax::diagnostics::ARC_SHAPE;

use super::{centre, moves_by};
use crate::block_words::{BlockWords, Reading};
use crate::codes::Refusal;
use crate::meaning::{MotionKind, Shape};

/// Finds a fault in the arc of a block, as far as the text shows it.
pub(super) fn find(words: &BlockWords, with: &Reading<'_>) -> Option<Refusal> {
    if !moves_by(words, MotionKind::Arc) {
        return None;
    }
    let address = words.taken.iter().next()?;
    let (in_force, own) = (&with.modal.in_force, words.sets());
    let axes = own.plane.or(in_force.plane)?.axes();
    let Some(radius) = words.get(Address::R) else {
        let centres = axes.map(centre);
        let centred = centres.iter().any(|centre| words.present.contains(*centre));
        return (!centred).then(|| Refusal {
            entry: &ARC_SHAPE,
            address,
            message: "the arc has neither a centre in its plane nor a radius".to_owned(),
            help: format!("Write {} and {}, or R.", centres[0].text(), centres[1].text()),
        });
    };
    if radius.abs() <= 0.0 {
        return None;
    }
    let distance = own.distance.or(in_force.distance);
    let [first, second] = axes.map(|axis| with.position.move_distance(words, distance, axis));
    // If the text does not determine the start or end point, `chord` is NaN, and the arc is not rejected.
    let chord = first.hypot(second);
    // The tolerance is taken in the current unit: in inches it is larger, so the check never rejects too
    // much. The path stage checks arcs after scaling.
    let scaling = Shape::Scaling as usize;
    let unscaled = own.shapes[scaling].or(in_force.shapes[scaling]) == Some(false);
    let short = unscaled && radius.abs() < chord / 2.0 - with.arc_radius_tolerance_mm;
    (short || chord <= 0.0).then(|| Refusal {
        entry: &ARC_SHAPE,
        address: Address::R,
        message: format!(
            "an arc of radius {} cannot join two points at a distance of {chord}",
            radius.abs()
        ),
        help: "Write a radius of at least half the distance; a full circle needs a centre.".to_owned(),
    })
}
