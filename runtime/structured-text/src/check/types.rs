//! Types: the meanings of their names, their sizes and their values at the start.

use tandem_model::Span;

use super::{Checker, Field, Global, Progress};
use crate::blocks::{built_in, initial};
use crate::finding::{BOUNDS, NOT_IN_SUBSET, RECURSION, TOO_LARGE, TWICE, UNKNOWN};
use crate::limits::{MEMORY_MAX, STRING_MAX};
use crate::tree::{Definition, Expression, TypeName, UnitKind};
use crate::types::{ArrayType, Elementary, Type};
use crate::value::Value;

/// Number of characters of a `STRING` for each value of the memory limit.
const CHARACTERS_OF_A_VALUE: usize = 16;

impl Checker<'_> {
    pub(super) fn resolve_type(&mut self, number: usize) {
        let file = self.file;
        let Some(declaration) = file.types.get(number) else {
            return;
        };
        match self.types[number].progress {
            Progress::Open => {}
            Progress::Resolving => {
                let what = format!("{} contains itself", declaration.name.text);
                self.found(&RECURSION, declaration.name.span, what, "remove that part");
                self.types[number].progress = Progress::Refused;
                return;
            }
            Progress::Done | Progress::Refused => return,
        }
        self.types[number].progress = Progress::Resolving;
        // a type has no access to the names of a unit
        let unit = self.unit.take();
        let name = declaration.name.text.as_str();
        let of = match &declaration.definition {
            Definition::Alias(of) => self.type_of(of),
            Definition::Enumeration(_) => Some(Type::Enumeration(number, name.into())),
            Definition::Struct(fields) => {
                self.fields(number, fields);
                Some(Type::Struct(number, name.into()))
            }
        };
        self.unit = unit;
        let info = &mut self.types[number];
        if info.progress == Progress::Resolving {
            info.progress = if of.is_some() {
                Progress::Done
            } else {
                Progress::Refused
            };
            info.of = of;
        }
    }

    fn fields(&mut self, number: usize, fields: &[crate::tree::Variable]) {
        let mut offset = 0;
        for field in fields {
            // too many values were already reported
            if self.memory > MEMORY_MAX {
                return;
            }
            let Some(of) = self.type_of(&field.of) else {
                self.types[number].progress = Progress::Refused;
                continue;
            };
            if of.is_block() {
                let help = "declare it as a variable of its own";
                self.found(
                    &NOT_IN_SUBSET,
                    field.name.span,
                    "a structure cannot contain function blocks",
                    help,
                );
                continue;
            }
            if self.types[number]
                .fields
                .iter()
                .any(|known| known.name == field.name.text)
            {
                let what = format!("{} is declared twice in this structure", field.name.text);
                self.found(&TWICE, field.name.span, what, "take another name");
                continue;
            }
            if !self.reserve_memory(self.weight(&of), field.name.span) {
                return;
            }
            let mut values = self.default(&of);
            if let Some(initial) = &field.initial {
                self.set_initial(&of, initial, &mut values);
            }
            let info = &mut self.types[number];
            info.initial.append(&mut values);
            info.fields.push(Field {
                name: field.name.text.clone(),
                of: of.clone(),
                offset,
            });
            offset += self.size(&of);
        }
    }

    /// Returns the type with this name; `None` after a finding.
    pub(super) fn type_of(&mut self, name: &TypeName) -> Option<Type> {
        match name {
            TypeName::Text(None, _) => Some(Type::STRING),
            TypeName::Text(Some(length), span) => {
                let length = self.constant_int(length)?;
                let fits = usize::try_from(length)
                    .ok()
                    .filter(|length| (1..=STRING_MAX).contains(length));
                if fits.is_none() {
                    let what = format!("the length of a STRING must be 1 to {STRING_MAX}, not {length}");
                    self.found(&BOUNDS, *span, what, "write a length in this range");
                }
                fits.map(Type::Text)
            }
            TypeName::Array {
                bounds,
                element,
                span,
            } => self.array_of(bounds, element, *span),
            TypeName::Named(name) => {
                if let Some(kind) = Elementary::named(&name.text) {
                    return Some(kind.into());
                }
                if let Some(block) = built_in(&name.text) {
                    return Some(Type::BuiltIn(block.name));
                }
                match self.names.get(name.text.as_str()).copied() {
                    Some(Global::Type(number)) => {
                        self.resolve_type(number);
                        self.types[number].of.clone()
                    }
                    Some(Global::Unit(number)) if self.file.units[number].kind == UnitKind::FunctionBlock => {
                        self.resolve_frame(number);
                        let is_done = self.frames[number].progress == Progress::Done;
                        is_done
                            .then(|| Type::Block(number, self.file.units[number].name.text.as_str().into()))
                    }
                    Some(Global::Unit(_)) => {
                        let what = format!("{} is not a type", name.text);
                        self.found(&UNKNOWN, name.span, what, "write a type or a function block");
                        None
                    }
                    None => {
                        let what = format!("the type {} is unknown", name.text);
                        let help = "write an elementary type such as BOOL, INT or TIME, a function block, or declare it by TYPE";
                        self.found(&UNKNOWN, name.span, what, help);
                        None
                    }
                }
            }
        }
    }

    fn array_of(
        &mut self,
        bounds: &[(Expression, Expression)],
        element: &TypeName,
        span: Span,
    ) -> Option<Type> {
        let element = self.type_of(element)?;
        let mut checked = Vec::new();
        let mut count = 1_usize;
        for (low, high) in bounds {
            let (low_value, high_value) = (self.constant_int(low)?, self.constant_int(high)?);
            let both = i64::try_from(low_value).ok().zip(i64::try_from(high_value).ok());
            let Some((low_value, high_value)) = both.filter(|(low, high)| low <= high) else {
                let what = format!("an array cannot have the bounds {low_value} to {high_value}");
                self.found(
                    &BOUNDS,
                    low.span.to(high.span),
                    what,
                    "write the lower bound first",
                );
                return None;
            };
            let length =
                usize::try_from(i128::from(high_value) - i128::from(low_value) + 1).unwrap_or(usize::MAX);
            count = count.saturating_mul(length);
            checked.push((low_value, high_value));
        }
        if count.saturating_mul(self.weight(&element)) > MEMORY_MAX {
            let what = format!("the array has more than {MEMORY_MAX} values");
            self.found(&TOO_LARGE, span, what, "write a smaller array");
            return None;
        }
        Some(Type::Array(
            ArrayType {
                bounds: checked,
                element,
            }
            .into(),
        ))
    }

    /// Returns the number of slots of the memory.
    pub(super) fn size(&self, of: &Type) -> usize {
        match of {
            Type::Elementary(_) | Type::Text(_) | Type::Enumeration(..) => 1,
            Type::Array(array) => elements(array) * self.size(&array.element),
            Type::Struct(number, _) => self.types[*number].initial.len(),
            Type::Block(number, _) => self.frames[*number].initial.len(),
            Type::BuiltIn(name) => built_in(name).map_or(0, crate::blocks::BuiltIn::size),
        }
    }

    /// Returns the number of values of a variable for the memory limit.
    pub(super) fn weight(&self, of: &Type) -> usize {
        match of {
            Type::Text(length) => 1 + length / CHARACTERS_OF_A_VALUE,
            Type::Array(array) => elements(array).saturating_mul(self.weight(&array.element)),
            Type::Struct(number, _) => {
                let fields = self.types[*number].fields.iter();
                fields.map(|field| self.weight(&field.of)).sum()
            }
            Type::Block(number, _) => {
                let variables = self.frames[*number].variables.iter();
                variables.map(|variable| self.weight(&variable.of)).sum()
            }
            // some of its ports are strings
            Type::BuiltIn(_) => 4 * self.size(of),
            Type::Elementary(_) | Type::Enumeration(..) => 1,
        }
        .max(1)
    }

    /// Returns the default values of a variable.
    pub(super) fn default(&self, of: &Type) -> Vec<Value> {
        match of {
            Type::Elementary(kind) => vec![initial(*kind)],
            Type::Text(_) => vec![initial(Elementary::String)],
            Type::Enumeration(..) => vec![Value::Int(0)],
            Type::Array(array) => {
                let element = self.default(&array.element);
                std::iter::repeat_n(element, elements(array)).flatten().collect()
            }
            Type::Struct(number, _) => self.types[*number].initial.clone(),
            Type::Block(number, _) => self.frames[*number].initial.clone(),
            Type::BuiltIn(name) => built_in(name)
                .map(crate::blocks::BuiltIn::instance)
                .unwrap_or_default(),
        }
    }
}

/// Returns the number of elements of an array, which the check of its bounds has limited.
pub(super) fn elements(array: &ArrayType) -> usize {
    let lengths = array
        .bounds
        .iter()
        .map(|(low, high)| usize::try_from(high - low + 1).unwrap_or(usize::MAX));
    lengths.fold(1, usize::saturating_mul)
}
