//! Writes the intermediate code of a program (manual, appendix A-1; D43).
//!
//! Decisions where the manual is silent: each program code has its own line without block number and
//! end-of-block word, as in the manual's sample for `if`; each block skip is a separate word; values of words
//! keep the digits of the source; numbers in expressions are written in their shortest form.

use std::fmt::Write as _;

use crate::address::Address;
use crate::program_code::{Expression, ExpressionId, Operator, ProgramCode, Statement};
use crate::tree::{Block, NcProgram, Value, Word};
use crate::variable::Variable;

/// First line of the intermediate code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Header {
    /// A main program with this number.
    Program(u16),
    /// A subprogram with this number.
    Subprogram(u16),
}

/// Role of a G or M code in the intermediate code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CodeRole {
    /// The code begins a fixed cycle.
    CycleBegin,
    /// The code ends a fixed cycle.
    CycleEnd,
    /// The code ends a subprogram.
    Return,
    /// Any other code.
    Other,
}

/// Description of the codes of a dialect.
pub trait Codes {
    /// Returns the role of the code with this letter (G or M) and this number.
    fn role(&self, letter: Address, number: f64) -> CodeRole;

    /// Returns the word that precedes the code that begins a fixed cycle (D43).
    fn cycle_start(&self) -> String;

    /// Returns the word that ends each block (D43).
    fn block_end(&self) -> &'static str;
}

/// Returns the intermediate code of a program without errors; each line ends with a line feed. Blocks with an
/// error are omitted, so check the program first.
pub fn compile(program: &NcProgram, header: Header, codes: &dyn Codes) -> String {
    let mut writer = IntermediateWriter {
        program,
        codes,
        text: String::with_capacity(program.source().len() + program.blocks().len() * 16),
        cycle: None,
        returned: false,
    };
    let _ = match header {
        Header::Program(number) => writeln!(writer.text, "open prog {number}"),
        Header::Subprogram(number) => writeln!(writer.text, "open subprog {number}"),
    };
    for block in program.blocks().iter().filter(|block| !block.has_errors()) {
        writer.block(block);
    }
    if matches!(header, Header::Subprogram(_)) && !writer.returned {
        writer.text.push_str("return\n");
    }
    writer.text.push_str("close\n");
    writer.text
}

/// Returns the length in bytes of a block's line in the intermediate code (D03). In a fixed cycle, the line
/// repeats the code of the cycle.
pub fn block_bytes(program: &NcProgram, block: &Block, cycle: Option<&str>, codes: &dyn Codes) -> usize {
    let mut writer = IntermediateWriter {
        program,
        codes,
        text: String::new(),
        cycle: cycle.map(str::to_owned),
        returned: false,
    };
    writer.block(block);
    writer.text.trim_end().len()
}

struct IntermediateWriter<'a> {
    program: &'a NcProgram,
    codes: &'a dyn Codes,
    text: String,
    /// The code of the active fixed cycle, as the source writes it.
    cycle: Option<String>,
    /// True if the last line written ends a subprogram.
    returned: bool,
}

impl IntermediateWriter<'_> {
    fn block(&mut self, block: &Block) {
        if let Some(code) = self.program.program_code(block) {
            self.program_code(code);
            return;
        }
        let words = self.program.words(block);
        if words.iter().all(|word| word.address == Address::N) {
            return;
        }
        for number in (1..=31).filter(|number| block.skip_numbers() & (1 << (number - 1)) != 0) {
            let _ = write!(self.text, "cskip{number} ");
        }
        let _ = write!(self.text, "N{}", block.line);
        self.words(words);
        let _ = write!(self.text, " {}", self.codes.block_end());
        self.returned = words.iter().any(|word| self.is(word, CodeRole::Return));
        self.text.push_str(if self.returned { " return\n" } else { "\n" });
    }

    fn words(&mut self, words: &[Word]) {
        let own = words.iter().find(|word| self.is(word, CodeRole::CycleBegin));
        if words.iter().any(|word| self.is(word, CodeRole::CycleEnd)) {
            self.cycle = None;
        }
        let drills = words
            .iter()
            .any(|word| matches!(word.address, Address::X | Address::Y | Address::Z | Address::R));
        let mut repeated = self.cycle.clone().filter(|_| own.is_none() && drills);
        for word in words.iter().filter(|word| word.address != Address::N) {
            if word.address != Address::G
                && let Some(code) = repeated.take()
            {
                let _ = write!(self.text, " {code}");
            }
            if own.is_some_and(|own| std::ptr::eq(own, word)) && self.cycle.is_none() {
                let _ = write!(self.text, " {}", self.codes.cycle_start());
            }
            self.text.push(' ');
            self.word(word);
        }
        if let Some(own) = own {
            self.cycle = Some(format!("G{}", self.value_text(own)));
        }
    }

    fn is(&self, word: &Word, role: CodeRole) -> bool {
        let is_code = matches!(word.address, Address::G | Address::M);
        let number = word.number().filter(|_| is_code);
        number.is_some_and(|number| self.codes.role(word.address, number) == role)
    }

    fn word(&mut self, word: &Word) {
        let address = word.address.text();
        // VA to VH are written as A to H
        let address = match word.address.parameter_index() {
            Some(_) => &address[1..],
            None => address,
        };
        self.text.push_str(address);
        match word.value() {
            Value::Number(_) => {
                let value = self.value_text(word);
                self.text.push_str(&value);
            }
            Value::Indirection(variable) => {
                self.text.push('(');
                self.variable(variable);
                self.text.push(')');
            }
        }
    }

    /// Returns the value of a word as the source writes it.
    fn value_text(&self, word: &Word) -> String {
        let span = word.span();
        let source = self.program.source();
        let text = source
            .get(span.start as usize..span.end as usize)
            .unwrap_or_default();
        let digits = text.trim_start_matches(|letter: char| letter.is_ascii_alphabetic());
        match digits.trim().parse::<f64>() {
            Ok(_) => digits.trim().to_owned(),
            // a comment is between address and value
            Err(_) => word.number().unwrap_or_default().to_string(),
        }
    }

    fn variable(&mut self, variable: Variable) {
        let _ = write!(self.text, "{}{}", variable.kind.prefix(), variable.index);
    }

    fn program_code(&mut self, code: &ProgramCode) {
        let (before, after) = match code.statement {
            Statement::Assignment(target) => {
                self.variable(target);
                (" = ", "")
            }
            Statement::If => ("if(", ")"),
            Statement::While | Statement::DoWhile => ("while(", ")"),
            Statement::Switch { .. } => ("switch(", ")"),
            Statement::Case { label } => {
                let _ = write!(self.text, "case {label}");
                (":", "")
            }
            Statement::Else => ("else", ""),
            Statement::Do => ("do", ""),
            Statement::Default => ("default:", ""),
            Statement::Break => ("break", ""),
            Statement::Open => ("{", ""),
            Statement::Close => ("}", ""),
            Statement::Repeat => return,
        };
        self.text.push_str(before);
        if let Some(value) = code.expression {
            self.expression(value, 0);
        }
        self.text.push_str(after);
        self.text.push('\n');
        self.returned = false;
    }

    /// Writes an expression, in parentheses if its priority is below `outer`. The length of a block limits
    /// the depth of the expression.
    fn expression(&mut self, id: ExpressionId, outer: u8) {
        let Some(expression) = self.program.expression(id).copied() else {
            return;
        };
        // the order of the manual, from low to high priority
        let priority = match expression {
            Expression::Binary { operator, .. } => operator.priority(),
            Expression::Negation(_) | Expression::Not(_) => Operator::PRIORITY_MAX + 1,
            _ => Operator::PRIORITY_MAX + 2,
        };
        let parentheses = priority < outer;
        if parentheses {
            self.text.push('(');
        }
        match expression {
            Expression::Number(value) => {
                let _ = write!(self.text, "{value}");
            }
            Expression::Variable(variable) => self.variable(variable),
            Expression::Negation(operand) => {
                self.text.push('-');
                self.expression(operand, priority);
            }
            Expression::Not(condition) => {
                self.text.push_str("!(");
                self.expression(condition, 0);
                self.text.push(')');
            }
            // operators of equal priority combine from the left
            Expression::Binary {
                operator,
                left,
                right,
            } => {
                self.expression(left, priority);
                let _ = write!(self.text, " {} ", operator.text());
                self.expression(right, priority + 1);
            }
            Expression::Call {
                function,
                first,
                second,
            } => {
                self.text.push_str(function.text());
                self.text.push('(');
                self.expression(first, 0);
                if let Some(second) = second {
                    self.text.push_str(", ");
                    self.expression(second, 0);
                }
                self.text.push(')');
            }
        }
        if parentheses {
            self.text.push(')');
        }
    }
}
