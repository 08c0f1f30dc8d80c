//! Converts an NC program tree to blocks: modal state, codes, control flow, subprograms.
//!
//! [`check`] finds faults before any motion; [`Interpreter`] returns the next [`Item`] on request. Both read
//! the same tables: each code is a file in [`codes`], each dialect a file in [`dialects`]. This crate calls
//! no other component: callers pass external values as [`Inputs`].
//!
//! Decisions where the manual is silent: G09 between axis words acts like G09 after them (D27); a word that
//! two codes of a block could take is an error; G04 takes only one time; M30 in a subprogram ends the whole
//! run.
//!
//! [`Item`]: tandem_model::flow::Item

mod arithmetic;
pub mod block_words;
mod check;
pub mod codes;
pub mod dialect;
pub mod dialects;
mod evaluation;
pub mod execution;
pub mod fixed_cycles;
mod flow;
mod inputs;
mod interpreter;
pub mod meaning;
mod modal;
mod numbers;
mod outputs;
mod range;
mod restricted;
pub mod restrictions;
mod text_position;
mod text_values;

pub use check::{Check, CheckContext, Programs, check, check_source};
pub use dialect::Dialect;
pub use inputs::{Inputs, NO_TOOLS};
pub use interpreter::{Interpreter, ModalState, not_there};
pub use modal::{CycleWords, Middle, Modal, RetainedData};
pub use outputs::{ProgrammedOutput, WrittenOutput, programmed_outputs, written_outputs};
pub use restricted::restrictions_of;
