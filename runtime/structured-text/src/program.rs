//! A program that a scan of a machine runs.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;
use std::sync::Arc;
use std::time::Duration;

use plc_api::handlers::MCodes;
use plc_api::scan::{Image, Reads, ScanProgram};
use plc_api::{Alarm, SequenceProgram};
use plc_protocol::types::CoordinateSystemNumber;
use tandem_model::{Diagnostic, Span};

use crate::check::check;
use crate::code::Code;
use crate::finding::{Findings, TOO_LARGE};
use crate::limits::SOURCE_BYTES_MAX;
use crate::machine::{Levels, Machine, MachineNeeds, VariableNumber};
use crate::parser::parse;
use crate::run::{FaultAt, memory, scan};
use crate::tokens::tokens;
use crate::value::Value;

/// Coordinate systems that a machine may have.
const SYSTEMS: RangeInclusive<CoordinateSystemNumber> = 1..=8;

/// Maximum number of characters of the source in an alarm.
const SHOWN_MAX: usize = 60;

/// A checked program with its variables.
#[derive(Debug)]
pub struct Program {
    name: Arc<str>,
    source: Arc<str>,
    code: Code,
    needs: MachineNeeds,
    memory: Vec<Value>,
    levels: Levels,
    /// The last values of the P and Q variables that are read.
    variables: BTreeMap<VariableNumber, f64>,
    /// Reason why the program has stopped; `None` while it runs.
    stopped: Option<String>,
}

impl Program {
    /// Checks a source text; `name` is that of its file, for alarms.
    ///
    /// # Errors
    /// Returns all faults of the text, in the order of its lines.
    pub fn compile(name: &str, source: &str) -> Result<Self, Vec<Diagnostic>> {
        let mut findings = Findings::default();
        if source.len() > SOURCE_BYTES_MAX {
            let what = format!("the text has more than {SOURCE_BYTES_MAX} bytes");
            findings.push(&TOO_LARGE, Span::default(), what, "write a smaller program");
            return Err(findings.into_list());
        }
        let tokens = tokens(source, &mut findings);
        let file = parse(&tokens, &mut findings);
        let checked = check(&file, &mut findings);
        match checked.filter(|_| findings.is_empty()) {
            Some((code, needs)) => Ok(Self {
                name: name.into(),
                source: source.into(),
                memory: memory(&code),
                code,
                needs,
                levels: Levels::default(),
                variables: BTreeMap::new(),
                stopped: None,
            }),
            None => Err(findings.into_list()),
        }
    }

    /// Returns the M codes that its `MCODE` blocks serve, with their coordinate systems.
    pub fn m_codes(&self) -> impl Iterator<Item = (CoordinateSystemNumber, u16)> + '_ {
        self.needs.m_codes.iter().copied()
    }

    /// Returns a sequence program that scans the program at a period. A program for one coordinate system
    /// serves its M codes only in that one.
    pub fn sequence_program(self, period: Duration) -> SequenceProgram {
        let codes = ServedMCodes(self.m_codes().map(|(_, m)| m).collect());
        let systems: BTreeSet<CoordinateSystemNumber> = self.m_codes().map(|(cs, _)| cs).collect();
        let program = SequenceProgram::new();
        match (systems.len(), systems.first().copied()) {
            (1, Some(cs)) => program.in_coordinate_system(cs, |system| system.scan(codes, period, self)),
            _ => program.scan(codes, period, self),
        }
    }

    /// Fails M codes that the program serves only in another coordinate system.
    fn fail_others(&self, image: &mut Image) {
        let codes: BTreeSet<u16> = self.m_codes().map(|(_, m)| m).collect();
        for m in codes {
            for cs in SYSTEMS.filter(|cs| !self.needs.m_codes.contains(&(*cs, m))) {
                let text = format!("{} serves M{m:02} only in another coordinate system", self.name);
                image.fail(cs, m, Alarm::user(m, text));
            }
        }
    }

    /// Returns the text of a fault, with its line.
    fn fault_text(&self, FaultAt { fault, span }: &FaultAt) -> String {
        let start = usize::try_from(span.start).unwrap_or(0);
        let before = self.source.get(..start).unwrap_or_default();
        let line = before.matches('\n').count() + 1;
        let end = usize::try_from(span.end).unwrap_or(0);
        let piece = self.source.get(start..end).unwrap_or_default();
        let piece = piece.split_whitespace().collect::<Vec<_>>().join(" ");
        let mut shown: String = piece.chars().take(SHOWN_MAX).collect();
        if piece.chars().count() > SHOWN_MAX {
            shown.push_str("...");
        }
        format!(
            "{} has stopped: line {line}, at {shown}: {fault}. Correct the program, and start it again",
            self.name
        )
    }
}

/// M numbers, each once.
struct ServedMCodes(BTreeSet<u16>);

impl MCodes for ServedMCodes {
    fn m_codes(self) -> Vec<RangeInclusive<u16>> {
        self.0.into_iter().map(|m| m..=m).collect()
    }
}

impl ScanProgram for Program {
    fn reads(&self) -> Reads {
        let positions = self.needs.positions.iter();
        let reads = positions.fold(Reads::default(), |reads, cs| reads.position(*cs));
        let variables = self.needs.variables.iter();
        variables.fold(reads, |reads, (cs, number)| match cs {
            None => reads.p(*number, 1),
            Some(cs) => reads.q(*cs, *number, 1),
        })
    }

    fn scan(&mut self, image: &mut Image) {
        for (cs, number) in &self.needs.variables {
            let value = match cs {
                None => image.p(*number),
                Some(cs) => image.q(*cs, *number),
            };
            if let Some(value) = value.filter(|value| value.is_finite()) {
                self.variables.insert((*cs, *number), value);
            }
        }
        if self.stopped.is_none() {
            let mut machine = Machine {
                image,
                levels: &mut self.levels,
                variables: &self.variables,
            };
            if let Err(fault) = scan(&self.code, &mut self.memory, &mut machine) {
                self.stopped = Some(self.fault_text(&fault));
            }
        }
        if let Some(text) = &self.stopped {
            let alarm = Alarm::user(Alarm::CODE_OF_ERROR, text.as_str());
            for (cs, m) in &self.needs.m_codes {
                image.fail(*cs, *m, alarm.clone());
            }
            image.set_alarm(None, true, alarm);
        }
        self.levels.write(image);
        self.fail_others(image);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::convert::convert;
    use crate::types::Elementary;

    impl Program {
        /// Returns the value of a variable of the program as text; `None` if no variable of this name has a
        /// single value.
        pub(crate) fn shown(&self, name: &str) -> Option<String> {
            let (slot, kind) = self.code.names.get(name)?;
            match convert(self.memory.get(*slot)?, *kind, Elementary::String) {
                Ok(Value::Text(text)) => Some(text),
                _ => None,
            }
        }

        /// Returns the reason why the program has stopped.
        pub(crate) fn stopped(&self) -> Option<&str> {
            self.stopped.as_deref()
        }
    }
}
