//! The plain data that the stages of the Tandem runtime pass to each other.
//!
//! Data flows in one direction: NC text -> tokens -> [program
//! tree](https://en.wikipedia.org/wiki/Abstract_syntax_tree) -> [`Block`](flow::Block) ->
//! [`Segment`](flow::Segment) -> [`Profile`](profile::Profile) -> setpoints. This crate reads no clock, file
//! or socket; the same input gives the same bytes.

pub mod alarm;
pub mod arc;
pub mod axis;
mod bisect;
mod cubic;
pub mod diagnostic;
pub mod flow;
pub mod hyperbolic;
pub mod limits;
pub mod lost;
mod motor_move;
mod motor_stop;
mod pace;
pub mod plane;
pub mod profile;
pub mod ramp;
pub mod settings;
pub mod span;
mod speed_growth;
mod transform;
mod unit;
pub mod variables;

pub use alarm::Alarm;
pub use arc::ArcPath;
pub use axis::{AXES_MAX, Axis, AxisSet, AxisVector, MachinePosition, WorkPosition};
pub use bisect::bisect;
pub use diagnostic::{Diagnostic, Severity};
pub use span::{Origin, Span};
pub use variables::Variables;
