//! Calls of functions.

use tandem_model::Span;

use super::arguments::is_output;
use super::expressions::{ExprType, TypedExpr};
use super::operators::common;
use super::{Checker, Global, Section};
use crate::code::{ExprKind, FunctionCall, Operand, Root, Stmt, VariableLocation};
use crate::convert::{convert, is_conversion, truncate};
use crate::finding::{NOT_CALLABLE, NOT_CONSTANT, PARAMETERS, TYPE, UNKNOWN};
use crate::functions::{Call, Class, Conversion, Function, OPERATORS, ResultType, function};
use crate::limits::NESTING_MAX;
use crate::machine::{MachineFunction, machine_function};
use crate::tree::{Argument, Binary, Expression, ExpressionKind, UnitKind};
use crate::types::{Elementary, Type};
use crate::value::Value;

impl Checker<'_> {
    pub(super) fn function_call(
        &mut self,
        callee: &Expression,
        arguments: &[Argument],
        (span, wanted): (Span, Option<Elementary>),
    ) -> Option<TypedExpr> {
        let ExpressionKind::Name(name) = &callee.kind else {
            let help = "call an instance of a function block as a statement";
            self.found(&NOT_CALLABLE, callee.span, "only a function has a value", help);
            return None;
        };
        if let Some(Global::Unit(unit)) = self.names.get(name.as_str()).copied()
            && self.file.units[unit].kind == UnitKind::Function
        {
            return self.own_function(unit, arguments, span);
        }
        if let Some(function) = function(name) {
            return self.standard(function, arguments, (span, wanted));
        }
        if let Some((_, operator)) = OPERATORS.iter().find(|(known, _)| known == name) {
            return self.operator_by_name(name, operator, arguments, span);
        }
        if let Some(conversion) = Conversion::named(name) {
            return self.conversion(name, conversion, arguments, span);
        }
        if let Some(function) = machine_function(name) {
            return self.machine_function(function, arguments, span);
        }
        if self.is_refused(name) {
            return None;
        }
        if self.variable(name).is_some()
            || self.names.contains_key(name.as_str())
            || crate::blocks::built_in(name).is_some()
        {
            let what = format!("{name} is not a function");
            self.found(
                &NOT_CALLABLE,
                callee.span,
                what,
                "declare an instance of a function block, and call it as a statement",
            );
        } else {
            let what = format!("the function {name} is unknown");
            self.found(
                &UNKNOWN,
                callee.span,
                what,
                "write a standard function, or declare it by FUNCTION",
            );
        }
        None
    }

    /// Returns the parameters of a unit for [`Checker::arranged`], without the result of a function.
    pub(super) fn parameters(&self, unit: usize) -> Vec<(usize, String, bool)> {
        let frame = &self.frames[unit];
        let variables = frame
            .variables
            .iter()
            .enumerate()
            .skip(usize::from(frame.result.is_some()));
        let parameters = variables.filter(|(_, variable)| {
            matches!(
                variable.section,
                Section::Input | Section::Output | Section::InOut
            ) && !variable.is_constant
        });
        parameters
            .map(|(number, of)| (number, of.name.clone(), is_output(of.section)))
            .collect()
    }

    fn own_function(&mut self, unit: usize, arguments: &[Argument], span: Span) -> Option<TypedExpr> {
        let name = &self.file.units[unit].name.text;
        self.calls(unit, span);
        let parameters = self.parameters(unit);
        let named: Vec<_> = parameters
            .iter()
            .map(|(_, name, is_output)| (name.clone(), *is_output))
            .collect();
        let arranged = self.arranged(name, &named, arguments, span)?;
        let mut call = FunctionCall {
            unit,
            inputs: Vec::new(),
            references: Vec::new(),
            outputs: Vec::new(),
            result: self.frames[unit].result.as_ref().map(|(slot, _)| *slot),
        };
        for ((number, ..), argument) in parameters.iter().zip(arranged) {
            let variable = self.frames[unit].variables[*number].clone();
            match (variable.section, argument) {
                (Section::InOut, None) => {
                    self.missing(name, &variable.name, span);
                    return None;
                }
                (_, None) => {}
                (Section::InOut, Some(argument)) => {
                    let place = self.passed(argument, &variable.of)?;
                    call.references.push((variable.offset, place));
                }
                (Section::Input, Some(argument)) => {
                    let to = VariableLocation {
                        root: Root::Frame,
                        offset: 0,
                        indices: Vec::new(),
                        span,
                    };
                    let operand = match self.assignment(to, &variable.of, &argument.value)? {
                        Stmt::Assign { value, text_max, .. } => Operand::Value(value, text_max),
                        Stmt::Copy { from, size, .. } => Operand::Copy(from, size),
                        _ => return None,
                    };
                    call.inputs.push((variable.offset, operand));
                }
                (_, Some(argument)) => {
                    let from = VariableLocation {
                        root: Root::Function(unit),
                        offset: variable.offset,
                        indices: Vec::new(),
                        span,
                    };
                    let output = self.output(from, &variable.of, &argument.value)?;
                    call.outputs.push(output);
                }
            }
        }
        let of = self.frames[unit]
            .result
            .as_ref()
            .map_or(ExprType::Nothing, |(_, of)| ExprType::Type(of.clone()));
        self.folded(None, ExprKind::Call(Box::new(call)), of, span)
    }

    /// Returns the names of the parameters of a standard function for this number of arguments.
    fn standard_parameters(function: &Function, count: usize) -> Vec<(String, Class)> {
        let fixed = function
            .parameters
            .iter()
            .map(|(name, class)| ((*name).to_owned(), *class));
        let mut all: Vec<_> = fixed.collect();
        if function.is_extensible {
            let (last, class) = function.parameters[function.parameters.len() - 1];
            let stem = last.trim_end_matches(|letter: char| letter.is_ascii_digit());
            let first: usize = last[stem.len()..].parse().unwrap_or(0);
            for number in 1..=count.min(NESTING_MAX).saturating_sub(all.len()) {
                all.push((format!("{stem}{}", first + number), class));
            }
        }
        all
    }

    fn standard(
        &mut self,
        function: &'static Function,
        arguments: &[Argument],
        (span, wanted): (Span, Option<Elementary>),
    ) -> Option<TypedExpr> {
        let parameters = Self::standard_parameters(function, arguments.len());
        let typed = self.all_given(function.name, &parameters, arguments, span)?;
        let mut common: Option<TypedExpr> = None;
        for (typed, (_, class)) in typed.iter().zip(&parameters) {
            if !self.fits(typed, *class, function.name) {
                return None;
            }
            if is_common(*class) {
                common = match common {
                    None => Some(typed.clone()),
                    Some(so_far) => Some(self.with_common(so_far, typed, function.name, span)?),
                };
            }
        }
        let is_real = parameters.iter().any(|(_, class)| *class == Class::Real);
        let literals = typed.iter().filter_map(TypedExpr::value);
        let kind = common.map(|common| match common.of {
            ExprType::Integer if !is_real => literal_type(wanted, literals),
            ExprType::Integer | ExprType::Real => {
                wanted.filter(|kind| kind.is_real()).unwrap_or(Elementary::Lreal)
            }
            _ => common.elementary().unwrap_or(Elementary::Lint),
        });
        let mut values = Vec::new();
        for (typed, (_, class)) in typed.into_iter().zip(&parameters) {
            let of = match class {
                Class::Bool => Elementary::Bool,
                Class::Int => typed.elementary().unwrap_or(Elementary::Lint),
                Class::Text => Elementary::String,
                // an exponent may have another type than its base
                _ => kind.unwrap_or(Elementary::Lint),
            };
            values.push(self.become_type(typed, &of.into())?);
        }
        let of = match function.gives {
            ResultType::Of(of) => of,
            ResultType::Common => kind.unwrap_or(Elementary::Lint),
        };
        let constants: Option<Vec<Value>> = values.iter().map(constant).collect();
        let folded = constants.map(|values| (function.run)(&Call { values: &values, of }));
        self.folded(
            folded,
            ExprKind::Standard(function.run, of, values),
            ExprType::Type(of.into()),
            span,
        )
    }

    /// Returns all arguments, in the order of their parameters.
    fn all_given(
        &mut self,
        name: &str,
        parameters: &[(String, Class)],
        arguments: &[Argument],
        span: Span,
    ) -> Option<Vec<TypedExpr>> {
        let named: Vec<_> = parameters.iter().map(|(name, _)| (name.clone(), false)).collect();
        let arranged = self.arranged(name, &named, arguments, span)?;
        let mut typed = Vec::new();
        for (argument, (parameter, _)) in arranged.into_iter().zip(parameters) {
            let Some(argument) = argument else {
                self.missing(name, parameter, span);
                return None;
            };
            typed.push(self.valued(&argument.value)?);
        }
        Some(typed)
    }

    /// Returns true if a value is of a class; otherwise reports a finding.
    fn fits(&mut self, typed: &TypedExpr, class: Class, name: &str) -> bool {
        let kind = typed.elementary();
        let is_number = matches!(typed.of, ExprType::Integer | ExprType::Real);
        let is = |fits: fn(Elementary) -> bool| kind.is_some_and(fits);
        let (fits, wanted) = match class {
            Class::Bool => (kind == Some(Elementary::Bool), "a BOOL"),
            Class::Int => (
                typed.of == ExprType::Integer || is(Elementary::is_int),
                "an integer",
            ),
            Class::Text => (kind == Some(Elementary::String), "a STRING"),
            Class::Any => (is_number || kind.is_some(), "a value of an elementary type"),
            Class::Num => (is_number || is(Elementary::is_num), "a number"),
            Class::Real => (is_number || is(Elementary::is_num), "a REAL or an LREAL"),
            Class::Bits => (is(Elementary::is_bits), "a BYTE, WORD, DWORD or LWORD"),
        };
        if !fits {
            let what = format!("{name} needs {wanted} here, not {}", typed.of);
            let help = if class == Class::Bits && is_number {
                "write its type: WORD#16#FF"
            } else {
                "write another value"
            };
            self.found(&TYPE, typed.expr.span, what, help);
        }
        // an integer is converted to REAL or LREAL only if no digits can be lost
        if fits && class == Class::Real && !is_number && !is(Elementary::is_real) {
            let what = format!("{name} needs a REAL or an LREAL, not {}", typed.of);
            self.found(
                &TYPE,
                typed.expr.span,
                what,
                "convert it, for example with INT_TO_REAL(...)",
            );
            return false;
        }
        fits
    }

    /// Returns a value converted to the common type of two values.
    fn with_common(
        &mut self,
        one: TypedExpr,
        other: &TypedExpr,
        name: &str,
        span: Span,
    ) -> Option<TypedExpr> {
        let untyped = |typed: &TypedExpr| matches!(typed.of, ExprType::Integer | ExprType::Real);
        if untyped(&one) && untyped(other) {
            return Some(if one.of == ExprType::Real {
                one
            } else {
                other.clone()
            });
        }
        let Some(kind) = common(&one, other) else {
            let what = format!("{} and {} have no common type for {name}", one.of, other.of);
            self.found(
                &TYPE,
                span,
                what,
                "convert one of them, for example with DINT_TO_REAL(...)",
            );
            return None;
        };
        Some(TypedExpr::with_type(one.expr.kind, kind, span))
    }

    /// Checks an operator that is written as a function: `ADD(a, b)` is `a + b`.
    fn operator_by_name(
        &mut self,
        name: &str,
        operator: &str,
        arguments: &[Argument],
        span: Span,
    ) -> Option<TypedExpr> {
        let operators = [
            Binary::Multiply,
            Binary::Divide,
            Binary::Modulo,
            Binary::Add,
            Binary::Subtract,
            Binary::Less,
            Binary::Greater,
            Binary::LessOrEqual,
            Binary::GreaterOrEqual,
            Binary::Equal,
            Binary::NotEqual,
            Binary::And,
            Binary::Xor,
            Binary::Or,
        ];
        let operator = operators.into_iter().find(|known| known.text() == operator)?;
        let is_extensible = matches!(
            operator,
            Binary::Add | Binary::Multiply | Binary::And | Binary::Or | Binary::Xor
        );
        let count = if is_extensible {
            arguments.len().clamp(2, NESTING_MAX)
        } else {
            2
        };
        let parameters: Vec<_> = (1..=count)
            .map(|number| (format!("IN{number}"), Class::Any))
            .collect();
        let mut typed = self.all_given(name, &parameters, arguments, span)?.into_iter();
        let mut whole = typed.next()?;
        for next in typed {
            whole = self.binary(operator, whole, next, span)?;
        }
        Some(whole)
    }

    fn conversion(
        &mut self,
        name: &str,
        conversion: Conversion,
        arguments: &[Argument],
        span: Span,
    ) -> Option<TypedExpr> {
        let typed = self
            .all_given(name, &[("IN".to_owned(), Class::Any)], arguments, span)?
            .pop()?;
        let (expr, from) = match (conversion.from, &typed.of) {
            (Some(from), _) => (self.become_type(typed, &from.into())?, from),
            (None, ExprType::Integer) => (
                self.become_type(typed, &Elementary::Lint.into())?,
                Elementary::Lint,
            ),
            (None, ExprType::Real) => (
                self.become_type(typed, &Elementary::Lreal.into())?,
                Elementary::Lreal,
            ),
            (None, of) => {
                let Some(from) = typed.elementary() else {
                    let what = format!("{name} needs a value of an elementary type, not {of}");
                    self.found(&TYPE, span, what, "write another value");
                    return None;
                };
                (typed.expr, from)
            }
        };
        let to = conversion.to;
        let fits = if conversion.truncates {
            from.is_real() && to.is_int()
        } else {
            is_conversion(from, to)
        };
        if !fits {
            let what = format!(
                "there is no conversion of {} to {} by {name}",
                from.text(),
                to.text()
            );
            self.found(
                &UNKNOWN,
                span,
                what,
                "write another conversion, or two conversions",
            );
            return None;
        }
        let value = constant(&expr);
        let (folded, node) = if conversion.truncates {
            let folded = value.map(|value| truncate(value.real(), to));
            (folded, ExprKind::Truncate(Box::new(expr), to))
        } else {
            let folded = value.map(|value| convert(&value, from, to));
            (folded, ExprKind::Convert(Box::new(expr), from, to))
        };
        self.folded(folded, node, ExprType::Type(to.into()), span)
    }

    fn machine_function(
        &mut self,
        function: &'static MachineFunction,
        arguments: &[Argument],
        span: Span,
    ) -> Option<TypedExpr> {
        let parameters: Vec<_> = function
            .parameters
            .iter()
            .map(|(name, _)| ((*name).to_owned(), Class::Any))
            .collect();
        let typed = self.all_given(function.name, &parameters, arguments, span)?;
        let mut values = Vec::new();
        for (number, (typed, (name, of))) in typed.into_iter().zip(function.parameters).enumerate() {
            let expr = self.become_type(typed, &(*of).into())?;
            let range = match *name {
                "CS" => (1, 8),
                "NUMBER" if function.name.ends_with('Q') => (
                    0,
                    tandem_model::variables::COORDINATE_SYSTEM_VARIABLES as i128 - 1,
                ),
                _ => (0, tandem_model::variables::GLOBAL_VARIABLES as i128 - 1),
            };
            match constant(&expr) {
                Some(value) if *name != "IN" => self.number_in(value.int(), range, name, expr.span)?,
                None if number < function.constants => {
                    let what = format!("{} needs a constant {name}", function.name);
                    let help = "write a number or a VAR CONSTANT: the variable is read before each scan";
                    self.found(&NOT_CONSTANT, expr.span, what, help);
                    return None;
                }
                _ => {}
            }
            values.push(expr);
        }
        if function.gives.is_some() {
            let numbers: Vec<i128> = values
                .iter()
                .filter_map(constant)
                .map(|value| value.int())
                .collect();
            // both are in the ranges of their types
            let number = numbers.last().and_then(|number| u32::try_from(*number).ok())?;
            let cs = if numbers.len() == 2 {
                u8::try_from(numbers[0]).ok()
            } else {
                None
            };
            self.needs.variables.insert((cs, number));
        }
        let of = function
            .gives
            .map_or(ExprType::Nothing, |of| ExprType::Type(of.into()));
        self.folded(None, ExprKind::Machine(function, values), of, span)
    }

    /// Checks a function that is called as a statement, for its effect.
    pub(super) fn function_statement(
        &mut self,
        callee: &Expression,
        arguments: &[Argument],
        span: Span,
    ) -> Option<Stmt> {
        let typed = self.function_call(callee, arguments, (span, None))?;
        if matches!(typed.expr.kind, ExprKind::Call(_)) || typed.of == ExprType::Nothing {
            return Some(Stmt::Evaluate(typed.expr));
        }
        self.found(
            &PARAMETERS,
            span,
            "the value of this function is not used",
            "assign it to a variable",
        );
        None
    }

    /// Returns the type of the variable with this name.
    pub(super) fn type_of_variable(&self, name: &str) -> Option<&Type> {
        self.variable(name).map(|variable| &variable.of)
    }
}

fn constant(expr: &crate::code::Expr) -> Option<Value> {
    match &expr.kind {
        ExprKind::Constant(value) => Some(value.clone()),
        _ => None,
    }
}

/// Returns the type of integers without a type: the wanted type, otherwise the narrowest that contains all of
/// them.
fn literal_type<'v>(wanted: Option<Elementary>, values: impl Iterator<Item = &'v Value>) -> Elementary {
    use Elementary::{Dint, Int, Lint, Udint, Ulint, Usint};
    if let Some(kind) = wanted.filter(|kind| kind.is_num() || kind.is_bits()) {
        return kind;
    }
    let values: Vec<i128> = values.map(Value::int).collect();
    let has_all = |kind: &Elementary| {
        let (low, high) = kind.range().unwrap_or_default();
        values.iter().all(|value| (low..=high).contains(value))
    };
    [Usint, Int, Dint, Udint, Lint, Ulint]
        .into_iter()
        .find(has_all)
        .unwrap_or(Lint)
}

/// Returns true for classes whose values are converted to one type.
fn is_common(class: Class) -> bool {
    matches!(class, Class::Any | Class::Num | Class::Real | Class::Bits)
}
