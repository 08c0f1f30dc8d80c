//! NC program tree to blocks: modal state, codes, control flow, subprograms.
//!
//! [`check`] finds what is wrong before anything moves; [`Interpreter`] is asked for the next [`Item`] and answers.
//! Both read the same tables: a code is one file of [`codes`], a dialect one file of [`dialects`].
//! Nothing here calls out: values from outside come in as [`Inputs`].
//!
//! [`Item`]: tandem_model::flow::Item

mod check;
mod interpreter;
mod modal;

pub use check::{Check, CheckContext, check};
pub use interpreter::{Inputs, Interpreter};
pub use modal::Modal;
