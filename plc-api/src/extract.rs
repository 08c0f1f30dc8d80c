//! Extractors: the arguments of a handler of an M code with a name.
//!
//! Each argument takes its value from the output. The declaration of an argument applies everywhere: the
//! handler is not started with other parameters, an NC program with other parameters is not loaded, and
//! `birth`, panels and `tandem check` show the parameters with their units.
//!
//! ```
//! use std::sync::{Arc, Mutex};
//! use std::time::Duration;
//!
//! use plc_api::units::{KiloNewton, Whole};
//! use plc_api::{Alarm, AuxOutput, HandlerState, MCode, Params, Plc, SequenceProgram, Va};
//!
//! const CLAMP: MCode = MCode::new(12, "clamp");
//! const CHANGE_TOOL: MCode = MCode::new(100, "change tool");
//!
//! /// Closes the clamp with the force VA, 1 to 20 kN.
//! async fn clamp(Va(force): Va<KiloNewton<1, 20>>, output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
//!     output.progress(format!("the clamp closes with {force}"), None).await?;
//!     plc.sleep(Duration::from_millis(400)).await;
//!     Ok(())
//! }
//!
//! /// Several parameters, with their names.
//! #[derive(Params)]
//! struct Change {
//!     #[va(1..=24)]
//!     tool: u16,
//!     #[vb(0.5..=2.0, "m/s")]
//!     speed: Option<f64>,
//! }
//!
//! /// The tool that is in the spindle.
//! type Spindle = Arc<Mutex<u16>>;
//!
//! async fn change_tool(change: Change, HandlerState(spindle): HandlerState<Spindle>) -> Result<(), Alarm> {
//!     let _speed = change.speed.unwrap_or(1.0);
//!     *spindle.lock().map_err(|_| Alarm::user(1, "the magazine is broken"))? = change.tool;
//!     Ok(())
//! }
//!
//! let program = SequenceProgram::new()
//!     .state(Spindle::default())
//!     .on(CLAMP, clamp)
//!     .on(CHANGE_TOOL, change_tool);
//! assert_eq!(program.check(), Ok(()));
//! ```
//!
//! | argument | value |
//! | --- | --- |
//! | [`Va<T>`](Va) to [`Vh<T>`](Vh) | one parameter: a [unit](crate::units) with bounds, `f64`, `u16`, `bool`; `Va<Option<T>>` may be left out |
//! | a struct with [`#[derive(Params)]`](derive@crate::Params) | several parameters by name |
//! | [`HandlerState<T>`](HandlerState) | a clone of the state that [`SequenceProgram::state`](crate::SequenceProgram::state) added |
//! | [`AuxOutput`], [`Plc`], [`CoordinateSystem`] | the output, the machine, the coordinate system of the output |
//! | a type of your own | the value that its implementation of [`FromOutput`] returns |

mod state;
mod takes;
#[cfg(test)]
mod tests;
mod value;

pub use state::HandlerState;
pub use takes::Takes;
pub use value::{ParamValue, Va, Vb, Vc, Vd, Ve, Vf, Vg, Vh, param};

use plc_protocol::alarm::Alarm;

use crate::aux_output::AuxOutput;
use crate::coordinate_system::CoordinateSystem;
use crate::plc::Plc;

/// An argument of a handler.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is no argument of a handler",
    label = "no argument of a handler",
    note = "a handler of an M code with a name takes `Va<T>` to `Vh<T>`, structs with `#[derive(Params)]`, `HandlerState<T>`, `AuxOutput`, `Plc` and `CoordinateSystem`"
)]
pub trait FromOutput: Sized + Send + 'static {
    /// Records the parameters and states that this argument takes. Called once, when the handler is
    /// registered.
    fn takes(takes: &mut Takes) {
        let _ = takes;
    }

    /// Returns the argument for an output, whose parameters match their declarations.
    ///
    /// # Errors
    /// Returns the alarm that stops the NC program if the handler cannot start.
    fn from_output(output: &AuxOutput, plc: &Plc) -> Result<Self, Alarm>;
}

impl FromOutput for AuxOutput {
    fn from_output(output: &AuxOutput, _plc: &Plc) -> Result<Self, Alarm> {
        Ok(output.clone())
    }
}

impl FromOutput for Plc {
    fn from_output(_output: &AuxOutput, plc: &Plc) -> Result<Self, Alarm> {
        Ok(plc.clone())
    }
}

impl FromOutput for CoordinateSystem {
    fn from_output(output: &AuxOutput, plc: &Plc) -> Result<Self, Alarm> {
        Ok(plc.coordinate_system(output.coordinate_system()))
    }
}
