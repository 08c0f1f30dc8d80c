//! Sequence-control API of the Tandem runtime.

pub mod alarm;
mod coordinate_system;
mod error;
pub mod fake;
pub mod handlers;
pub mod handshake;
pub mod hub;
mod outputs;
mod plc;
pub mod port;
mod text;
pub mod transport;
pub mod types;

pub use alarm::Alarm;
pub use coordinate_system::CoordinateSystem;
pub use error::{Error, Result};
pub use handlers::{AuxOutput, Cancellation, SequenceProgram};
pub use outputs::{Outputs, RawOutput};
pub use plc::Plc;
pub use types::output::{CancelReason, Params, Redelivery};
pub use types::state::Execution;
