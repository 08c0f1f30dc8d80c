//! States of a sequence program, which its handlers share.

use std::any::{Any, TypeId};
use std::collections::HashMap;
use std::sync::Arc;

/// The states of a sequence program, by type.
#[derive(Debug, Clone, Default)]
pub(crate) struct States(Arc<HashMap<TypeId, Named>>);

/// A state, and the name of its type.
type Named = (&'static str, Arc<dyn Any + Send + Sync>);

impl States {
    /// Adds a state; returns false if a state of this type exists already.
    pub(crate) fn add<T: Send + Sync + 'static>(&mut self, state: T) -> bool {
        let states = Arc::make_mut(&mut self.0);
        let named = (std::any::type_name::<T>(), Arc::new(state) as _);
        states.insert(TypeId::of::<T>(), named).is_none()
    }

    /// Adds the states of another program; returns the names of the types that both programs have.
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

    pub(crate) fn get<T: Clone + 'static>(&self) -> Option<T> {
        self.0.get(&TypeId::of::<T>())?.1.downcast_ref().cloned()
    }
}
