//! Structured Text of IEC 61131-3, a subset, as a scan program of [`plc_api`].
//!
//! [`Program::compile`] converts a source text to a program, or returns all faults of the text. A program is
//! a
//! a [`ScanProgram`](plc_api::scan::ScanProgram): [`Program::sequence_program`] runs it on a machine or in
//! simulated time.
//!
//! ```
//! use std::time::Duration;
//! use plc_api::{Params, fake::FakePort};
//! use plc_api::fake::OutputOutcome;
//! use tandem_structured_text::Program;
//!
//! # #[tokio::main(flavor = "current_thread")] async fn main() {
//! let source = "
//! PROGRAM clamp
//! VAR close : MCODE; settled : TON; END_VAR
//! close(M := 10);
//! settled(IN := close.Active, PT := T#200ms);
//! close(M := 10, Done := settled.Q);
//! END_PROGRAM
//! ";
//! let program = Program::compile("clamp.st", source).unwrap();
//! # let fake = FakePort::new([1]);
//! # let plc = fake.plc();
//! let program = program.sequence_program(Duration::from_millis(10));
//! # tokio::spawn(async move { program.run(&plc).await });
//! # fake.settle().await;
//! # let seq = fake.issue_output(1, 10, Params::default());
//! # fake.advance(Duration::from_millis(150)).await;
//! # assert_eq!(fake.closed(1, seq), None);
//! # fake.advance(Duration::from_millis(100)).await;
//! # assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
//! # }
//! ```

mod blocks;
mod calculate;
mod check;
mod code;
pub mod conformance;
mod convert;
mod finding;
mod functions;
pub mod limits;
mod machine;
mod parser;
mod program;
pub mod reference;
mod run;
mod state;
#[cfg(test)]
mod tests;
mod tokens;
mod tree;
mod types;
mod value;

pub use finding::{FINDINGS, FindingEntry};
pub use program::Program;
