//! State that handlers share.

use std::any::{Any, TypeId};
use std::collections::HashMap;
use std::sync::Arc;

use super::{FromOutput, Takes};
use crate::alarm::Alarm;
use crate::handlers::AuxOutput;
use crate::plc::Plc;

/// A clone of the state of type `T` that the sequence program has by
/// [`SequenceProgram::state`](crate::SequenceProgram::state).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct State<T>(pub T);

impl<T: Clone + Send + Sync + 'static> FromOutput for State<T> {
    fn takes(takes: &mut Takes) {
        takes.state::<T>();
    }

    fn from_output(output: &AuxOutput, _plc: &Plc) -> Result<Self, Alarm> {
        output.states().get::<T>().map(State).ok_or_else(|| {
            let text = format!(
                "{} is no state of the sequence program",
                std::any::type_name::<T>()
            );
            Alarm::user(Alarm::CODE_OF_ERROR, text)
        })
    }
}

/// The state of a sequence program by type.
#[derive(Debug, Clone, Default)]
pub(crate) struct States(Arc<HashMap<TypeId, Named>>);

/// A state, and the name of its type.
type Named = (&'static str, Arc<dyn Any + Send + Sync>);

impl States {
    /// Adds a state; false when there is one of its type.
    pub(crate) fn add<T: Send + Sync + 'static>(&mut self, state: T) -> bool {
        let states = Arc::make_mut(&mut self.0);
        let named = (std::any::type_name::<T>(), Arc::new(state) as _);
        states.insert(TypeId::of::<T>(), named).is_none()
    }

    /// Adds those of another program; the names of those that are there already.
    pub(crate) fn merge(&mut self, other: &Self) -> Vec<&'static str> {
        let states = Arc::make_mut(&mut self.0);
        let mut twice = Vec::new();
        for (of, named) in other.0.iter() {
            if states.insert(*of, named.clone()).is_some() {
                twice.push(named.0);
            }
        }
        twice
    }

    pub(crate) fn has(&self, wanted: TypeId) -> bool {
        self.0.contains_key(&wanted)
    }

    fn get<T: Clone + 'static>(&self) -> Option<T> {
        self.0.get(&TypeId::of::<T>())?.1.downcast_ref().cloned()
    }
}
