//! The programmed point, as far as the text of a program shows it.

use tandem_model::flow::Distance;
use tandem_model::{Axis, AxisVector};
use tandem_syntax::{Address, AddressSet};

use crate::block_words::BlockWords;
use crate::codes::{Code, ModalGroup};
use crate::execution::axis_of;
use crate::meaning::{ModalValue, Role};
use crate::modal::Modal;

/// Returns true for a code that changes neither the coordinates nor the unit, and that moves axes only by the
/// current motion.
fn is_harmless(code: &Code) -> bool {
    match code.sets {
        Some(ModalValue::Unit(_) | ModalValue::Length(_) | ModalValue::Cycle(_) | ModalValue::Shape(..)) => {
            false
        }
        _ => matches!(code.role, Role::Plain | Role::Motion(_) | Role::Dwell),
    }
}

/// A programmed point in the current coordinates and unit; NaN for an axis whose position the text does not
/// show.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TextPosition(AxisVector);

impl PartialEq for TextPosition {
    fn eq(&self, other: &Self) -> bool {
        Axis::ALL
            .iter()
            .all(|axis| self.0[*axis].to_bits() == other.0[*axis].to_bits())
    }
}

impl TextPosition {
    /// Sets each axis in which `other` differs to unknown. Returns `true` if the point changes.
    pub(crate) fn join(&mut self, other: &Self) -> bool {
        let before = *self;
        for axis in Axis::ALL {
            if self.0[axis].to_bits() != other.0[axis].to_bits() {
                self.0[axis] = f64::NAN;
            }
        }
        *self != before
    }

    /// Creates a point with all axes unknown.
    pub(crate) fn unknown() -> Self {
        let mut position = AxisVector::ZERO;
        for axis in Axis::ALL {
            position[axis] = f64::NAN;
        }
        Self(position)
    }

    /// Moves the point by a block without errors. `modal` is the modal state in the block.
    pub(crate) fn follow(&mut self, words: &BlockWords, modal: &Modal) {
        let harmless = words.codes().all(is_harmless);
        let named = words.axis_words;
        let moves = words.taker.map(|taker| taker.group);
        if !harmless || (!named.is_empty() && moves != Some(ModalGroup::Motion)) {
            *self = Self::unknown();
            return;
        }
        let Some(distance) = modal.in_force.distance else {
            self.lose(named);
            return;
        };
        let incremental = distance == Distance::Incremental;
        for (axis, value) in values(words, named) {
            self.0[axis] = if incremental { self.0[axis] + value } else { value };
        }
    }

    /// Sets the named axes to unknown, for example after a block that may be skipped.
    pub(crate) fn lose(&mut self, named: AddressSet) {
        for axis in named.iter().filter_map(axis_of) {
            self.0[axis] = f64::NAN;
        }
    }

    /// Returns the distance that a block moves along an axis; NaN if the text does not show the distance.
    pub(crate) fn move_distance(&self, words: &BlockWords, distance: Option<Distance>, axis: Axis) -> f64 {
        let word = values(words, words.axis_words).find(|(named, _)| *named == axis);
        match (word, distance) {
            (None, _) => 0.0,
            (Some((_, value)), Some(Distance::Incremental)) => value,
            (Some((_, value)), Some(Distance::Absolute)) => value - self.0[axis],
            (Some(_), None) => f64::NAN,
        }
    }
}

/// The axis of each address.
static AXES: [Option<Axis>; Address::COUNT] = {
    let mut axes = [None; Address::COUNT];
    let mut place = 0;
    while place < Address::COUNT {
        axes[place] = axis_of(Address::ALL[place]);
        place += 1;
    }
    axes
};

fn values(words: &BlockWords, named: AddressSet) -> impl Iterator<Item = (Axis, f64)> {
    named
        .iter()
        .filter_map(|address| Some((AXES[address as usize]?, words.get(address)?)))
}
