//! Parameters and states that a handler takes as arguments.

use std::any::TypeId;

use plc_protocol::types::m_code::{DeclaredParams, ParamDeclaration, ParamLetter};

/// Parameters of the M code and states of the sequence program that a handler takes as arguments.
#[derive(Debug, Default)]
pub struct Takes {
    pub(crate) params: Option<DeclaredParams>,
    pub(crate) states: Vec<(TypeId, &'static str)>,
    pub(crate) mistakes: Vec<String>,
}

impl Takes {
    /// Adds a parameter that an argument of the handler takes.
    pub fn param(&mut self, letter: ParamLetter, declaration: ParamDeclaration) {
        let params = self.params.get_or_insert_default();
        if params.insert(letter, declaration).is_some() {
            self.mistakes
                .push(format!("two arguments of its handler take {letter}"));
        }
    }

    /// Declares that the M code has no parameters except those that the arguments of the handler take.
    pub fn no_other_params(&mut self) {
        self.params.get_or_insert_default();
    }

    /// Adds the state of type `T`, which an argument of the handler takes.
    pub fn state<T: 'static>(&mut self) {
        self.states.push((TypeId::of::<T>(), std::any::type_name::<T>()));
    }
}
