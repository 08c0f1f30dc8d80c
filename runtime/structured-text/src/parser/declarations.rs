//! Types, units and their variables.

use super::{ParseResult, Parser};
use crate::finding::{LITERAL_RANGE, NOT_IN_SUBSET};
use crate::limits::DIMENSIONS_MAX;
use crate::tree::{
    Definition, Expression, Initial, Name, Section, TypeDeclaration, TypeName, Unit, UnitKind, Variable,
};

/// Types of the standard that are not part of the subset, and what to write instead.
const OTHER_TYPES: [(&str, &str); 15] = [
    ("LTIME", "write TIME, which counts nanoseconds"),
    ("DATE", "write a STRING, or seconds as an LINT"),
    ("LDATE", "write a STRING, or seconds as an LINT"),
    ("TOD", "write a TIME since midnight"),
    ("LTOD", "write a TIME since midnight"),
    ("TIME_OF_DAY", "write a TIME since midnight"),
    ("LTIME_OF_DAY", "write a TIME since midnight"),
    ("DT", "write a STRING, or seconds as an LINT"),
    ("LDT", "write a STRING, or seconds as an LINT"),
    ("DATE_AND_TIME", "write a STRING, or seconds as an LINT"),
    ("LDATE_AND_TIME", "write a STRING, or seconds as an LINT"),
    ("WSTRING", "write STRING, which holds every character"),
    ("CHAR", "write STRING[1]"),
    ("WCHAR", "write STRING[1]"),
    ("BIT", "write BOOL"),
];

impl Parser<'_> {
    /// Reads the types after `TYPE`.
    pub(super) fn types(&mut self, types: &mut Vec<TypeDeclaration>) -> ParseResult<()> {
        while !self.accept("END_TYPE") {
            let name = self.name()?;
            self.expect(":")?;
            let definition = if self.accept("STRUCT") {
                let mut fields = Vec::new();
                while !self.accept("END_STRUCT") {
                    self.variables(Section::Local, false, &mut fields)?;
                }
                Definition::Struct(fields)
            } else if self.accept("(") {
                let mut values = vec![self.name()?];
                while self.accept(",") {
                    values.push(self.name()?);
                }
                self.expect(")")?;
                Definition::Enumeration(values)
            } else {
                Definition::Alias(self.type_name()?)
            };
            if self.is(":=") {
                let span = self.span();
                let help = "write the initial values at the variables";
                return Err(self.found(
                    &NOT_IN_SUBSET,
                    span,
                    "an initial value of a type is not part of this subset",
                    help,
                ));
            }
            self.expect(";")?;
            types.push(TypeDeclaration { name, definition });
        }
        Ok(())
    }

    /// Reads a unit after `PROGRAM`, `FUNCTION_BLOCK` or `FUNCTION`.
    pub(super) fn unit(&mut self, kind: UnitKind) -> ParseResult<Unit> {
        let name = self.name()?;
        let result = if kind == UnitKind::Function && self.accept(":") {
            Some(self.type_name()?)
        } else {
            None
        };
        let mut variables = Vec::new();
        while let Some(section) = self.section() {
            self.section_of(section, &mut variables)?;
        }
        let end = match kind {
            UnitKind::Program => "END_PROGRAM",
            UnitKind::FunctionBlock => "END_FUNCTION_BLOCK",
            UnitKind::Function => "END_FUNCTION",
        };
        let body = self.statements(&[end]);
        self.expect(end)?;
        Ok(Unit {
            kind,
            name,
            result,
            variables,
            body,
        })
    }

    fn section(&mut self) -> Option<Section> {
        let sections = [
            ("VAR", Section::Local),
            ("VAR_TEMP", Section::Temporary),
            ("VAR_INPUT", Section::Input),
            ("VAR_OUTPUT", Section::Output),
            ("VAR_IN_OUT", Section::InOut),
        ];
        sections
            .into_iter()
            .find(|(word, _)| self.accept(word))
            .map(|(_, section)| section)
    }

    fn section_of(&mut self, section: Section, variables: &mut Vec<Variable>) -> ParseResult<()> {
        let is_constant = self.accept("CONSTANT");
        if self.is_any(&["RETAIN", "NON_RETAIN", "PERSISTENT"]) {
            return Err(self.expected("a name"));
        }
        while !self.accept("END_VAR") {
            self.variables(section, is_constant, variables)?;
        }
        Ok(())
    }

    /// Reads declarations: `a, b : INT := 5;`
    fn variables(
        &mut self,
        section: Section,
        is_constant: bool,
        variables: &mut Vec<Variable>,
    ) -> ParseResult<()> {
        let mut names = vec![self.name()?];
        while self.accept(",") {
            names.push(self.name()?);
        }
        self.expect(":")?;
        let of = self.type_name()?;
        let initial = if self.accept(":=") {
            Some(self.initial()?)
        } else {
            None
        };
        self.expect(";")?;
        variables.extend(names.into_iter().map(|name| Variable {
            name,
            section,
            is_constant,
            of: of.clone(),
            initial: initial.clone(),
        }));
        Ok(())
    }

    fn type_name(&mut self) -> ParseResult<TypeName> {
        let span = self.span();
        if self.is_any(&["POINTER", "REFERENCE", "REF_TO"]) {
            return Err(self.expected("a type"));
        }
        if self.accept("ARRAY") {
            return self.array();
        }
        if self.accept("STRING") {
            let close = if self.accept("[") {
                "]"
            } else if self.accept("(") {
                ")"
            } else {
                return Ok(TypeName::Text(None, span));
            };
            let length = self.expression()?;
            self.expect(close)?;
            return Ok(TypeName::Text(Some(Box::new(length)), span.to(self.last_span())));
        }
        let name = self.name()?;
        if let Some((_, help)) = OTHER_TYPES.iter().find(|(other, _)| *other == name.text) {
            let what = format!("{} is not part of this subset", name.text);
            return Err(self.found(&NOT_IN_SUBSET, span, what, *help));
        }
        if self.is("(") {
            let span = self.span();
            let help = "remove the range, and check the value in the program";
            return Err(self.found(
                &NOT_IN_SUBSET,
                span,
                "subranges are not part of this subset",
                help,
            ));
        }
        Ok(TypeName::Named(name))
    }

    fn array(&mut self) -> ParseResult<TypeName> {
        let start = self.last_span();
        self.expect("[")?;
        let mut bounds: Vec<(Expression, Expression)> = Vec::new();
        loop {
            let low = self.expression()?;
            self.expect("..")?;
            bounds.push((low, self.expression()?));
            if !self.accept(",") {
                break;
            }
        }
        self.expect("]")?;
        let span = start.to(self.last_span());
        if bounds.len() > DIMENSIONS_MAX {
            let what = format!("an array has at most {DIMENSIONS_MAX} dimensions");
            return Err(self.found(&LITERAL_RANGE, span, what, "write an array of arrays"));
        }
        self.expect("OF")?;
        let element = self.deeper(Self::type_name)?;
        Ok(TypeName::Array {
            bounds,
            element: Box::new(element),
            span,
        })
    }

    fn initial(&mut self) -> ParseResult<Initial> {
        let start = self.span();
        if self.accept("[") {
            let mut list = Vec::new();
            while !self.accept("]") {
                list.push(self.deeper(Self::element)?);
                if !self.is("]") {
                    self.expect(",")?;
                }
            }
            return Ok(Initial::List(list, start.to(self.last_span())));
        }
        let is_field = self
            .tokens
            .get(self.at + 2)
            .is_some_and(|token| Self::is_text(token, ":="));
        if self.is("(") && is_field {
            self.advance();
            let mut fields: Vec<(Name, Initial)> = Vec::new();
            loop {
                let name = self.name()?;
                self.expect(":=")?;
                fields.push((name, self.deeper(Self::initial)?));
                if !self.accept(",") {
                    break;
                }
            }
            self.expect(")")?;
            return Ok(Initial::Fields(fields, start.to(self.last_span())));
        }
        Ok(Initial::Value(self.expression()?))
    }

    /// Reads an element of a list, or several equal ones: `3(0)`.
    fn element(&mut self) -> ParseResult<Initial> {
        use crate::tokens::TokenKind;
        let is_literal = self
            .token()
            .is_some_and(|token| matches!(token.kind, TokenKind::Literal(..)));
        if is_literal && self.is_next("(") {
            let count = self.primary()?;
            self.expect("(")?;
            let of = self.initial()?;
            self.expect(")")?;
            return Ok(Initial::Repeated(count, Box::new(of)));
        }
        self.initial()
    }
}
