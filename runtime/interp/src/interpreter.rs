//! From the program tree to items for the coordinator: a pull interface, pure.

use std::collections::BTreeMap;
use std::sync::Arc;

use tandem_model::flow::Item;
use tandem_model::settings::{CoordinateSystemSettings, WorkOffsets};
use tandem_model::{Alarm, Origin};
use tandem_syntax::NcProgram;

use crate::modal::Modal;

/// Values from outside, read when a block is interpreted (D16).
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a> {
    /// The programs that M98 may call.
    pub programs: &'a BTreeMap<u16, Arc<NcProgram>>,
    /// Block skip inputs: bit `n - 1` for number `n` (D13).
    pub optional_skip: u32,
    /// G54 to G59.
    pub work_offsets: &'a WorkOffsets,
}

/// Interprets the program of one coordinate system.
#[derive(Debug)]
pub struct Interpreter {
    start_up: Modal,
    modal: Modal,
    stack: Vec<Origin>,
}

impl Interpreter {
    /// An interpreter without a program, in the start-up modal state.
    pub fn new(settings: &CoordinateSystemSettings) -> Self {
        let start_up = Modal::start_up(settings);
        Self {
            modal: start_up.clone(),
            start_up,
            stack: Vec::new(),
        }
    }

    /// Begins a program at its head, in the start-up modal state. `number` 0: a program without a number.
    pub fn start(&mut self, program: Arc<NcProgram>, number: u16) {
        let _ = (program, number);
        self.modal = self.start_up.clone();
    }

    /// The next item. After [`Item::End`] and after an alarm the answer repeats until [`Interpreter::start`].
    ///
    /// # Errors
    /// An alarm that stops the coordinate system; nothing of its block has been given out.
    pub fn next(&mut self, inputs: &Inputs<'_>) -> Result<Item, Alarm> {
        let _ = inputs;
        Ok(Item::End(Origin::default()))
    }

    /// The modal state after the last interpreted block.
    pub fn modal(&self) -> &Modal {
        &self.modal
    }

    /// Where each program of the nesting stands, the main program first: for a caller the calling block, for the
    /// last one the block interpreted last.
    pub fn call_stack(&self) -> impl Iterator<Item = Origin> {
        self.stack.iter().copied()
    }
}
