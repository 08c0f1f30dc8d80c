//! State that handlers share.

use plc_protocol::alarm::Alarm;

use super::{FromOutput, Takes};
use crate::aux_output::AuxOutput;
use crate::plc::Plc;

/// A clone of the state of type `T` that [`SequenceProgram::state`](crate::SequenceProgram::state) added to
/// the sequence program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HandlerState<T>(pub T);

impl<T: Clone + Send + Sync + 'static> FromOutput for HandlerState<T> {
    fn takes(takes: &mut Takes) {
        takes.state::<T>();
    }

    fn from_output(output: &AuxOutput, _plc: &Plc) -> Result<Self, Alarm> {
        output.states().get::<T>().map(HandlerState).ok_or_else(|| {
            let text = format!(
                "{} is no state of the sequence program",
                std::any::type_name::<T>()
            );
            Alarm::user(Alarm::CODE_OF_ERROR, text)
        })
    }
}
