//! Declarations of M codes by a sequence program: their names, and the meanings of the parameters VA to VH.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use super::CoordinateSystemNumber;
use super::params::Params;
use super::redelivery::Redelivery;
use super::refusal::{Refusal, RefusalCode};

/// Highest M number.
pub const M_CODE_MAX: u16 = 191;

/// M codes that the runtime handles itself (D35); they never reach a handler.
pub const RUNTIME_M_CODES: [u16; 6] = [0, 1, 2, 30, 98, 99];

/// Largest number of characters of the name of an M code or of a parameter.
pub const DECLARED_NAME_MAX: usize = 40;

/// Largest number of characters of a unit.
pub const UNIT_MAX: usize = 16;

/// Largest deviation from a whole number that is still accepted. Reason: the numbers of a program are binary
/// floating-point numbers.
const WHOLE_TOLERANCE: f64 = 1e-9;

/// Letter of one of the parameters VA to VH; in JSON `A` to `H`, as in `params` of an output.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[allow(missing_docs, reason = "they are their names")]
pub enum ParamLetter {
    #[serde(alias = "VA")]
    A,
    #[serde(alias = "VB")]
    B,
    #[serde(alias = "VC")]
    C,
    #[serde(alias = "VD")]
    D,
    #[serde(alias = "VE")]
    E,
    #[serde(alias = "VF")]
    F,
    #[serde(alias = "VG")]
    G,
    #[serde(alias = "VH")]
    H,
}

impl ParamLetter {
    /// All letters, in order.
    pub const ALL: [Self; 8] = [
        Self::A,
        Self::B,
        Self::C,
        Self::D,
        Self::E,
        Self::F,
        Self::G,
        Self::H,
    ];

    /// Returns the value of this parameter in an output, or `None` if it is not programmed.
    pub fn value_in(self, params: &Params) -> Option<f64> {
        match self {
            Self::A => params.a,
            Self::B => params.b,
            Self::C => params.c,
            Self::D => params.d,
            Self::E => params.e,
            Self::F => params.f,
            Self::G => params.g,
            Self::H => params.h,
        }
    }
}

impl fmt::Display for ParamLetter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "V{self:?}")
    }
}

/// Meaning of one parameter, and the numbers that it accepts.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct ParamDeclaration {
    /// Name, such as `force`: 1 to 40 characters.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Unit, such as `kN`: 1 to 16 characters.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// Lowest accepted number.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min: Option<f64>,
    /// Highest accepted number.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max: Option<f64>,
    /// True if only whole numbers are accepted.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub whole: bool,
    /// True if the parameter may be omitted.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub optional: bool,
}

impl ParamDeclaration {
    /// Creates the declaration of a parameter that accepts any number, in this unit.
    pub fn in_unit(unit: impl Into<String>) -> Self {
        Self {
            unit: Some(unit.into()),
            ..Self::default()
        }
    }

    /// Sets the lowest and the highest accepted number; `None` leaves a bound unchanged.
    #[must_use]
    pub fn within(self, min: Option<f64>, max: Option<f64>) -> Self {
        Self {
            min: min.or(self.min),
            max: max.or(self.max),
            ..self
        }
    }

    /// Returns true if the parameter accepts this number. A whole number may differ by the rounding error of
    /// a calculation in the program, such as 0.1 * 30.
    pub fn takes(&self, number: f64) -> bool {
        let meant = if self.whole { number.round() } else { number };
        meant.is_finite()
            && (number - meant).abs() <= WHOLE_TOLERANCE
            && self.min.is_none_or(|min| meant >= min)
            && self.max.is_none_or(|max| meant <= max)
    }

    /// Returns the accepted numbers in words, such as `1 to 20 kN`.
    pub fn range_text(&self) -> String {
        let unit = self
            .unit
            .as_deref()
            .map_or_else(String::new, |unit| format!(" {unit}"));
        let range = match (self.min, self.max) {
            (Some(min), Some(max)) => format!("{min} to {max}{unit}"),
            (Some(min), None) => format!("{min}{unit} or more"),
            (None, Some(max)) => format!("{max}{unit} or less"),
            (None, None) if self.whole => return format!("a whole number{}", of_unit(self.unit.as_deref())),
            (None, None) => return format!("a number{}", of_unit(self.unit.as_deref())),
        };
        if self.whole {
            format!("a whole number, {range}")
        } else {
            range
        }
    }

    /// Returns the name and the range of the parameter.
    pub fn text(&self) -> String {
        let optional = if self.optional { "; may be left out" } else { "" };
        match &self.name {
            Some(name) => format!("{name}, {}{optional}", self.range_text()),
            None => format!("{}{optional}", self.range_text()),
        }
    }

    fn mistake(&self) -> Option<String> {
        let is_text = |text: &Option<String>, max| text.as_ref().is_none_or(|text| is_word(text, max));
        if !is_text(&self.name, DECLARED_NAME_MAX) {
            return Some(format!("name: write 1 to {DECLARED_NAME_MAX} characters"));
        }
        if !is_text(&self.unit, UNIT_MAX) {
            return Some(format!("unit: write 1 to {UNIT_MAX} characters"));
        }
        let bounds = [self.min, self.max];
        if bounds.into_iter().flatten().any(|bound| !bound.is_finite()) {
            return Some("min and max: write numbers".to_owned());
        }
        match (self.min, self.max) {
            (Some(min), Some(max)) if min > max => Some(format!("min {min} is above max {max}")),
            _ => None,
        }
    }
}

fn of_unit(unit: Option<&str>) -> String {
    unit.map_or_else(String::new, |unit| format!(" in {unit}"))
}

fn is_word(text: &str, max: usize) -> bool {
    (1..=max).contains(&text.chars().count()) && !text.contains(char::is_control)
}

/// Declared parameters of an M code; the M code accepts no other parameters.
pub type DeclaredParams = BTreeMap<ParamLetter, ParamDeclaration>;

/// Declaration of an M code by the handler that serves it: its name, and the meaning of its parameters.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct MCodeDeclaration {
    /// M number.
    pub m: u16,
    /// Coordinate system to which the declaration applies. Without this field, the declaration applies to all
    /// coordinate systems in which the handler serves the M code and which have no separate declaration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cs: Option<CoordinateSystemNumber>,
    /// Function of the M code, such as `clamp`: 1 to 40 characters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Parameters of the M code: a program with other parameters, or with numbers that a parameter does not
    /// accept, is not loaded. Without this field every parameter is accepted; an empty map accepts no
    /// parameter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub params: Option<DeclaredParams>,
    /// Treatment of an output of this M code that was claimed when its handler was lost. This value replaces
    /// the `redelivery` of the whole presence.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub redelivery: Option<Redelivery>,
}

/// A parameter of an M code in the text of an NC program.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GivenParam {
    /// Not programmed.
    Absent,
    /// A number.
    Number(f64),
    /// A variable; its value is known only when the block runs.
    Variable,
}

impl From<Option<f64>> for GivenParam {
    fn from(number: Option<f64>) -> Self {
        number.map_or(Self::Absent, Self::Number)
    }
}

/// A parameter that an M code does not accept, or that is missing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ParamFault {
    /// The parameter.
    pub letter: ParamLetter,
    /// The fault, and what to write.
    pub text: String,
}

impl MCodeDeclaration {
    /// Returns number and name, such as `M12 clamp`.
    pub fn title(&self) -> String {
        let m = self.m;
        match &self.name {
            Some(name) => format!("M{m:02} {name}"),
            None => format!("M{m:02}"),
        }
    }

    /// Returns number, name and parameters, such as `M12 clamp VA (force, 1 to 20 kN)`.
    pub fn text(&self) -> String {
        let params = self.params.iter().flatten();
        let params = params.map(|(letter, param)| format!("{letter} ({})", param.text()));
        let parts: Vec<String> = std::iter::once(self.title()).chain(params).collect();
        parts.join(" ")
    }

    /// Checks the parameters of an output against the declaration.
    ///
    /// # Errors
    /// Fails with the first parameter that does not match the declaration. The error text gives the correct
    /// form.
    pub fn check(&self, params: &Params) -> Result<(), ParamFault> {
        let Some(declared) = &self.params else {
            return Ok(());
        };
        for letter in ParamLetter::ALL {
            if let Some(fault) = self.fault(declared, letter, letter.value_in(params).into()) {
                return Err(fault);
            }
        }
        Ok(())
    }

    /// Returns all parameters, VA to VH, that do not match the declaration.
    pub fn faults(&self, given: [GivenParam; 8]) -> Vec<ParamFault> {
        let Some(declared) = &self.params else {
            return Vec::new();
        };
        let each = ParamLetter::ALL.into_iter().zip(given);
        each.filter_map(|(letter, given)| self.fault(declared, letter, given))
            .collect()
    }

    fn fault(&self, declared: &DeclaredParams, letter: ParamLetter, given: GivenParam) -> Option<ParamFault> {
        let text = match (declared.get(&letter), given) {
            (None, GivenParam::Absent) | (Some(_), GivenParam::Variable) => return None,
            (Some(param), GivenParam::Absent) if param.optional => return None,
            (Some(param), GivenParam::Number(number)) if param.takes(number) => return None,
            (None, _) => {
                let all: Vec<_> = (declared.iter())
                    .map(|(letter, param)| format!("{letter} ({})", param.text()))
                    .collect();
                let takes = if all.is_empty() {
                    "it takes no parameters".to_owned()
                } else {
                    format!("it takes {}", all.join(", "))
                };
                format!("{} takes no {letter}; {takes}", self.title())
            }
            (Some(param), GivenParam::Absent) => {
                format!("{} needs {letter} ({})", self.title(), param.text())
            }
            (Some(param), GivenParam::Number(number)) => {
                let name = param
                    .name
                    .as_deref()
                    .map_or_else(String::new, |name| format!(" ({name})"));
                let unit = param
                    .unit
                    .as_deref()
                    .map_or_else(String::new, |unit| format!(" {unit}"));
                let range = param.range_text();
                format!(
                    "{}: {letter}{name} is {number}{unit}; write {range}",
                    self.title()
                )
            }
        };
        Some(ParamFault { letter, text })
    }

    /// Validates the declaration.
    ///
    /// # Errors
    /// Fails if the M number, a name, a unit or a range is not allowed. The error text gives the correct
    /// form.
    pub fn mistake(&self) -> Result<(), String> {
        if self.m > M_CODE_MAX {
            return Err(format!("M{}: M codes are 0 to {M_CODE_MAX}", self.m));
        }
        let title = format!("M{:02}", self.m);
        if !self
            .name
            .as_ref()
            .is_none_or(|name| is_word(name, DECLARED_NAME_MAX))
        {
            return Err(format!(
                "{title}: name: write 1 to {DECLARED_NAME_MAX} characters"
            ));
        }
        for (letter, param) in self.params.iter().flatten() {
            if let Some(mistake) = param.mistake() {
                return Err(format!("{title} {letter}: {mistake}"));
            }
        }
        Ok(())
    }
}

/// An M code that is served, and its handler.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ServedMCode {
    /// M number.
    pub m: u16,
    /// Coordinate systems in which the M code is served, ascending.
    #[serde(default)]
    pub cs: Vec<CoordinateSystemNumber>,
    /// The handler; null for the stock sequence program of the runtime.
    #[serde(default)]
    pub handler_id: Option<String>,
    /// Name that the handler declares, otherwise the name in the configuration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Parameters that the handler declares, otherwise those of the configuration. If neither declares
    /// parameters, every parameter is accepted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub params: Option<DeclaredParams>,
}

impl ServedMCode {
    /// Returns true if the M code is served in this coordinate system.
    pub fn is_in(&self, cs: CoordinateSystemNumber) -> bool {
        self.cs.is_empty() || self.cs.contains(&cs)
    }

    /// Returns the declaration of the M code.
    pub fn declaration(&self) -> MCodeDeclaration {
        MCodeDeclaration {
            m: self.m,
            cs: None,
            name: self.name.clone(),
            params: self.params.clone(),
            redelivery: None,
        }
    }

    /// Returns the name of the handler that serves the M code, or a text for the stock sequence program.
    pub fn by(&self) -> String {
        match &self.handler_id {
            Some(id) => format!("handler {id}"),
            None => "the stock sequence program".to_owned(),
        }
    }
}

/// M codes that a sequence program serves, as a file: with it NC programs can be checked while the sequence
/// program does not run. `SequenceProgram::served` of `plc-api` returns the contents of
/// the file. The file may also contain the `birth` of a machine; its other fields are ignored.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ServedMCodesFile {
    /// M codes, ascending by number; at most 1000. An entry without `cs` applies to all coordinate systems.
    pub serves: Vec<ServedMCode>,
}

impl std::fmt::Display for ServedMCodesFile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let json = serde_json::to_string_pretty(self).map_err(|_| std::fmt::Error)?;
        writeln!(f, "{json}")
    }
}

/// Validates declarations.
///
/// # Errors
/// Fails with `invalid` for the first declaration that is not allowed. The error text gives the correct form.
pub(super) fn check_all(declared: &[MCodeDeclaration]) -> Result<(), Refusal> {
    let mut mistakes = declared.iter().filter_map(|one| one.mistake().err());
    match mistakes.next() {
        None => Ok(()),
        Some(mistake) => Err(Refusal::new(RefusalCode::Invalid, format!("m_codes: {mistake}"))),
    }
}

#[cfg(test)]
mod tests;
