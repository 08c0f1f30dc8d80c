//! What the arguments of a handler take.

use std::any::TypeId;

use crate::types::m_code::{DeclaredParams, ParamDeclaration, ParamLetter};

/// What the arguments of a handler take: parameters, and state of the sequence program.
#[derive(Debug, Default)]
pub struct Takes {
    pub(crate) params: Option<DeclaredParams>,
    pub(crate) states: Vec<(TypeId, &'static str)>,
    pub(crate) mistakes: Vec<String>,
}

impl Takes {
    /// A parameter.
    pub fn param(&mut self, letter: ParamLetter, declaration: ParamDeclaration) {
        let params = self.params.get_or_insert_default();
        if params.insert(letter, declaration).is_some() {
            self.mistakes
                .push(format!("two arguments of its handler take {letter}"));
        }
    }

    /// No parameters but those of other arguments.
    pub fn no_other_params(&mut self) {
        self.params.get_or_insert_default();
    }

    /// State of this type.
    pub fn state<T: 'static>(&mut self) {
        self.states.push((TypeId::of::<T>(), std::any::type_name::<T>()));
    }
}
