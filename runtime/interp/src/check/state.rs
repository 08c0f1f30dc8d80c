//! What the text shows of a run at one of its places.

use tandem_syntax::AddressSet;

use crate::dialect::{Dialect, SpindleWord};
use crate::modal::Modal;
use crate::text_position::TextPosition;
use crate::text_values::{Locals, Values};

use super::CheckContext;

/// A program that waits for the end of one that it calls.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Caller {
    /// Place of the program among those checked.
    pub program: usize,
    /// The block that it goes on with.
    pub block: usize,
    /// How often the called program runs again; `None`: that is not known.
    pub repetitions: Option<u16>,
    pub locals: Locals,
}

/// What is known where a run comes to a block.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct State {
    pub modal: Modal,
    pub position: TextPosition,
    pub values: Values,
    pub callers: Vec<Caller>,
    /// F has been programmed, or may have been.
    pub has_feed: bool,
    /// S has been programmed, or may have been.
    pub has_speed: bool,
    /// Blocks in a row that do not move in the plane of cutter compensation.
    pub at_rest: u8,
    /// Something that is in force is not known: it stands for many states.
    pub is_open: bool,
}

impl State {
    /// At the head of a main program.
    pub fn start_up(dialect: &Dialect, context: &CheckContext<'_>) -> Self {
        Self {
            modal: Modal::of_text(dialect, context.unit),
            position: TextPosition::unknown(),
            values: Values::default(),
            callers: Vec::new(),
            has_feed: !context.calculates
                || context
                    .default_feedrate_mm_min
                    .is_some_and(|feedrate| feedrate > 0.0),
            has_speed: !(context.calculates
                && context.has_spindle == Some(true)
                && dialect.policy.spindle_word == SpindleWord::Speed),
            at_rest: 0,
            is_open: false,
        }
    }

    /// Lets go what is in force and where the tool is.
    pub fn forget(&mut self) {
        self.modal.forget();
        self.position = TextPosition::unknown();
        self.has_feed = true;
        self.has_speed = true;
        self.is_open = true;
    }

    /// What somebody whose text is not seen leaves: a subprogram.
    pub fn forget_all(&mut self) {
        self.forget();
        self.values.forget_shared();
    }

    /// Lets go the axes of a block that may be skipped.
    pub fn lose(&mut self, named: AddressSet) {
        self.position.lose(named);
    }

    /// Takes over what another state of the same place does not share. True when that is less than was known.
    pub fn widen(&mut self, other: &Self) -> bool {
        let mut changed = self.values.widen(&other.values);
        changed |= self.position.join(&other.position);
        if self.modal != other.modal {
            changed |= self.modal.join(&other.modal);
            self.is_open = true;
        }
        changed |= !self.has_feed && other.has_feed;
        changed |= !self.has_speed && other.has_speed;
        self.has_feed |= other.has_feed;
        self.has_speed |= other.has_speed;
        self.at_rest = self.at_rest.min(other.at_rest);
        self.is_open |= other.is_open;
        changed
    }
}
