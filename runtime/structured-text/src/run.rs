//! Runs a checked program: one scan at a time.

use tandem_model::Span;

use crate::blocks::Ports;
use crate::calculate::{calculate, compare, minus, not, scale_time};
use crate::code::{
    BlockCall, BlockOf, Code, Expr, ExprKind, ForLoop, FunctionCall, Operand, Root, Stmt, VariableLocation,
};
use crate::convert::{convert, truncate};
use crate::functions::Call;
use crate::limits::STEPS_MAX;
use crate::machine::Machine;
use crate::tree::Binary;
use crate::types::Elementary;
use crate::value::{Fault, Value, int_of};

/// A fault with its position in the source.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FaultAt {
    pub fault: Fault,
    pub span: Span,
}

type RunResult<T> = Result<T, FaultAt>;

/// Result of a list of statements.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Flow {
    Next,
    Exit,
    Continue,
    Return,
}

/// Returns the memory before the first scan.
pub(crate) fn memory(code: &Code) -> Vec<Value> {
    let mut memory = Vec::with_capacity(code.memory);
    memory.extend(
        code.units
            .get(code.program)
            .into_iter()
            .flat_map(|unit| unit.initial.iter().cloned()),
    );
    // the variables of functions are written at each call
    memory.resize(code.memory, Value::Bool(false));
    memory
}

/// Runs one scan.
///
/// # Errors
/// Returns the fault that stops the program.
pub(crate) fn scan(code: &Code, memory: &mut [Value], machine: &mut Machine) -> RunResult<()> {
    let mut run = ProgramRun {
        code,
        memory,
        machine,
        steps: 0,
    };
    run.unit(code.program, 0)
}

struct ProgramRun<'a, 'm> {
    code: &'a Code,
    memory: &'a mut [Value],
    machine: &'a mut Machine<'m>,
    steps: u32,
}

impl<'a> ProgramRun<'a, '_> {
    /// Runs a unit whose variables are at `base`.
    fn unit(&mut self, number: usize, base: usize) -> RunResult<()> {
        let unit = &self.code.units[number];
        for (slot, value) in &unit.temporary {
            self.memory[base + slot].clone_from(value);
        }
        self.statements(&unit.body, base)?;
        Ok(())
    }

    fn statements(&mut self, statements: &'a [Stmt], base: usize) -> RunResult<Flow> {
        for statement in statements {
            match self.statement(statement, base)? {
                Flow::Next => {}
                other => return Ok(other),
            }
        }
        Ok(Flow::Next)
    }

    /// Counts steps; fails if the scan has too many.
    fn count_steps(&mut self, steps: usize, span: Span) -> RunResult<()> {
        let steps = u32::try_from(steps).unwrap_or(u32::MAX);
        self.steps = self.steps.saturating_add(steps);
        if self.steps <= STEPS_MAX {
            return Ok(());
        }
        let fault = Fault::Steps;
        Err(FaultAt { fault, span })
    }

    fn statement(&mut self, statement: &'a Stmt, base: usize) -> RunResult<Flow> {
        match statement {
            Stmt::Assign { to, value, text_max } => {
                let value = self.value(value, base)?;
                self.store(to, base, value, *text_max)?;
            }
            Stmt::Copy { to, from, size } => {
                self.count_steps(*size, to.span)?;
                let (from, to) = (self.address(from, base)?, self.address(to, base)?);
                let values = self.memory[from..from + size].to_vec();
                self.memory[to..to + size].clone_from_slice(&values);
            }
            Stmt::Block(call) => self.block(call, base)?,
            Stmt::Evaluate(expr) => {
                self.value(expr, base)?;
            }
            Stmt::If(branches, otherwise) => {
                for (condition, body) in branches {
                    if self.value(condition, base)?.bool() {
                        return self.statements(body, base);
                    }
                }
                return self.statements(otherwise, base);
            }
            Stmt::Case {
                selector,
                branches,
                otherwise,
            } => {
                let value = self.value(selector, base)?.int();
                for (ranges, body) in branches {
                    if ranges.iter().any(|(low, high)| (*low..=*high).contains(&value)) {
                        return self.statements(body, base);
                    }
                }
                return self.statements(otherwise, base);
            }
            Stmt::For(of) => return self.for_loop(of, base),
            Stmt::While(condition, body) => {
                while self.value(condition, base)?.bool() {
                    match self.statements(body, base)? {
                        Flow::Exit => break,
                        Flow::Return => return Ok(Flow::Return),
                        Flow::Next | Flow::Continue => {}
                    }
                }
            }
            Stmt::Repeat(body, condition) => loop {
                match self.statements(body, base)? {
                    Flow::Exit => break,
                    Flow::Return => return Ok(Flow::Return),
                    Flow::Next | Flow::Continue => {}
                }
                if self.value(condition, base)?.bool() {
                    break;
                }
            },
            Stmt::Exit => return Ok(Flow::Exit),
            Stmt::Continue => return Ok(Flow::Continue),
            Stmt::Return => return Ok(Flow::Return),
        }
        Ok(Flow::Next)
    }

    fn for_loop(&mut self, of: &'a ForLoop, base: usize) -> RunResult<Flow> {
        let mut value = self.value(&of.from, base)?.int();
        let to = self.value(&of.to, base)?.int();
        let by = match &of.by {
            Some(by) => {
                let step = self.value(by, base)?.int();
                if step == 0 {
                    let fault = Fault::StepOfZero;
                    return Err(FaultAt { fault, span: by.span });
                }
                step
            }
            None => 1,
        };
        loop {
            self.count_steps(1, of.variable.span)?;
            let address = self.address(&of.variable, base)?;
            // the variable ends one step after the last value, if the type has that value
            if let Ok(value) = int_of(value, of.of) {
                self.memory[address] = value;
            }
            if (by > 0 && value > to) || (by < 0 && value < to) {
                return Ok(Flow::Next);
            }
            match self.statements(&of.body, base)? {
                Flow::Exit => return Ok(Flow::Next),
                Flow::Return => return Ok(Flow::Return),
                Flow::Next | Flow::Continue => {}
            }
            value += by;
        }
    }

    fn store(
        &mut self,
        to: &'a VariableLocation,
        base: usize,
        value: Value,
        text_max: Option<usize>,
    ) -> RunResult<()> {
        self.count_steps(1, to.span)?;
        let address = self.address(to, base)?;
        fits(&value, text_max).map_err(|fault| FaultAt { fault, span: to.span })?;
        self.memory[address] = value;
        Ok(())
    }

    fn address(&mut self, place: &'a VariableLocation, base: usize) -> RunResult<usize> {
        let root = match place.root {
            Root::Frame => base,
            Root::Function(unit) => self.code.units[unit].base,
            Root::Reference(slot) => match self.memory[base + slot] {
                Value::Address(address) => address,
                // a VAR_IN_OUT is read only within a call, which has set it
                _ => base,
            },
        };
        let mut address = root + place.offset;
        for index in &place.indices {
            let value = self.value(&index.value, base)?.int();
            let offset = usize::try_from(value - i128::from(index.low)).ok();
            let Some(offset) = offset.filter(|_| value <= i128::from(index.high)) else {
                let fault = Fault::Index(value, index.low, index.high);
                return Err(FaultAt {
                    fault,
                    span: place.span,
                });
            };
            address += offset * index.stride;
        }
        Ok(address)
    }

    fn value(&mut self, expr: &'a Expr, base: usize) -> RunResult<Value> {
        self.count_steps(1, expr.span)?;
        let at = |fault| FaultAt {
            fault,
            span: expr.span,
        };
        match &expr.kind {
            ExprKind::Constant(value) => Ok(value.clone()),
            ExprKind::Load(place) => {
                let address = self.address(place, base)?;
                Ok(self.memory[address].clone())
            }
            ExprKind::Not(of, kind) => Ok(not(&self.value(of, base)?, *kind)),
            ExprKind::Minus(of, kind) => minus(&self.value(of, base)?, *kind).map_err(at),
            ExprKind::Calculate(operator, kind, sides) => {
                self.calculated(*operator, *kind, sides, base, expr.span)
            }
            ExprKind::ScaleTime(operator, sides) => {
                let (time, by) = (self.value(&sides.0, base)?, self.value(&sides.1, base)?);
                scale_time(*operator, &time, &by).map_err(|fault| divisor(fault, &sides.1, expr.span))
            }
            ExprKind::Compare(operator, sides) => {
                let (left, right) = (self.value(&sides.0, base)?, self.value(&sides.1, base)?);
                Ok(compare(*operator, &left, &right))
            }
            ExprKind::Convert(of, from, to) => convert(&self.value(of, base)?, *from, *to).map_err(at),
            ExprKind::Truncate(of, to) => truncate(self.value(of, base)?.real(), *to).map_err(at),
            ExprKind::Standard(run, of, parameters) => {
                let values = self.values(parameters, base)?;
                let call = Call {
                    values: &values,
                    of: *of,
                };
                run(&call).map_err(at)
            }
            ExprKind::Machine(function, parameters) => {
                let values = self.values(parameters, base)?;
                Ok((function.run)(self.machine, &values))
            }
            ExprKind::Call(call) => self.function(call, base, expr.span),
        }
    }

    fn values(&mut self, parameters: &'a [Expr], base: usize) -> RunResult<Vec<Value>> {
        parameters
            .iter()
            .map(|parameter| self.value(parameter, base))
            .collect()
    }

    fn calculated(
        &mut self,
        operator: Binary,
        kind: Elementary,
        sides: &'a (Expr, Expr),
        base: usize,
        span: Span,
    ) -> RunResult<Value> {
        let left = self.value(&sides.0, base)?;
        if kind == Elementary::Bool {
            match (operator, left.bool()) {
                (Binary::And, false) | (Binary::Or, true) => return Ok(left),
                _ => {}
            }
        }
        let right = self.value(&sides.1, base)?;
        calculate(operator, kind, &left, &right).map_err(|fault| divisor(fault, &sides.1, span))
    }

    fn function(&mut self, call: &'a FunctionCall, base: usize, span: Span) -> RunResult<Value> {
        let unit = &self.code.units[call.unit];
        self.count_steps(unit.initial.len(), span)?;
        // all arguments are evaluated before the variables of the function are written: a call may be an
        // argument of another call
        let mut given = Vec::with_capacity(call.inputs.len());
        for (slot, operand) in &call.inputs {
            let values = match operand {
                Operand::Value(expr, text_max) => {
                    let value = self.value(expr, base)?;
                    fits(&value, *text_max).map_err(|fault| FaultAt {
                        fault,
                        span: expr.span,
                    })?;
                    vec![value]
                }
                Operand::Copy(place, size) => {
                    self.count_steps(*size, place.span)?;
                    let address = self.address(place, base)?;
                    self.memory[address..address + size].to_vec()
                }
            };
            given.push((*slot, values));
        }
        for (slot, place) in &call.references {
            given.push((*slot, vec![Value::Address(self.address(place, base)?)]));
        }
        let own = unit.base;
        self.memory[own..own + unit.initial.len()].clone_from_slice(&unit.initial);
        for (slot, values) in given {
            for (value, place) in values.into_iter().zip(own + slot..) {
                self.memory[place] = value;
            }
        }
        self.unit(call.unit, own)?;
        for output in &call.outputs {
            self.statement(output, base)?;
        }
        Ok(call
            .result
            .map_or(Value::Bool(false), |slot| self.memory[own + slot].clone()))
    }

    fn block(&mut self, call: &'a BlockCall, base: usize) -> RunResult<()> {
        self.count_steps(1, call.span)?;
        for input in &call.inputs {
            self.statement(input, base)?;
        }
        let instance = self.address(&call.instance, base)?;
        for (slot, place) in &call.references {
            let address = self.address(place, base)?;
            self.memory[instance + slot] = Value::Address(address);
        }
        match call.block {
            BlockOf::Unit(unit) => self.unit(unit, instance)?,
            BlockOf::BuiltIn(block) => {
                let mut ports = Ports {
                    slots: &mut self.memory[instance..instance + block.size()],
                    instance,
                };
                (block.run)(&mut ports, self.machine);
            }
        }
        for output in &call.outputs {
            self.statement(output, base)?;
        }
        Ok(())
    }
}

/// Checks that a string fits its variable.
fn fits(value: &Value, text_max: Option<usize>) -> Result<(), Fault> {
    if let (Value::Text(text), Some(max)) = (value, text_max) {
        let length = text.chars().count();
        if length > max {
            return Err(Fault::TooLong(length, max));
        }
    }
    Ok(())
}

/// Returns a fault at its position; that of a division by zero is the divisor.
fn divisor(fault: Fault, right: &Expr, span: Span) -> FaultAt {
    let span = if fault == Fault::DivisionByZero {
        right.span
    } else {
        span
    };
    FaultAt { fault, span }
}
