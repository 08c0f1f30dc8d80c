//! Declarations of M codes by handlers and by the configuration, and checks of parameters against them.

use std::collections::BTreeMap;

use plc_protocol::types::m_code::{GivenParam, MCodeDeclaration};
use tandem_interp::{Dialect, programmed_outputs};
use tandem_model::alarm::VALUE_OUT_OF_RANGE;
use tandem_model::flow::Output;
use tandem_model::{Alarm, Diagnostic};
use tandem_syntax::NcProgram;
use tandem_syntax::diagnostics::{NOT_SERVED, PARAMS_REFUSED};

/// Maximum number of findings in one program. Further findings appear after the first ones are corrected.
const FOUND_MAX: usize = 1000;

/// Declaration of an M code with a description of its origin.
#[derive(Debug, Clone, PartialEq)]
pub struct SourcedDeclaration {
    /// Origin of the declaration, such as `handler cell` or `[m_code.12]`.
    pub by: String,
    /// The declaration itself.
    pub declaration: MCodeDeclaration,
}

impl SourcedDeclaration {
    /// Creates a declaration of the configuration.
    pub fn in_config(declaration: MCodeDeclaration) -> Self {
        Self {
            by: format!("[m_code.{}]", declaration.m),
            declaration,
        }
    }

    /// Creates a declaration of a handler.
    pub fn by_handler(handler_id: &str, declaration: MCodeDeclaration) -> Self {
        Self {
            by: format!("handler {handler_id}"),
            declaration,
        }
    }
}

/// Returns diagnostics for the parameters in a program that its M codes do not accept, each once, at the word of the
/// parameter. A missing parameter is reported at its M code.
pub fn wrong_params(
    program: &NcProgram,
    dialect: &Dialect,
    declared: &[SourcedDeclaration],
) -> Vec<Diagnostic> {
    let mut found: Vec<Diagnostic> = Vec::new();
    if declared.is_empty() {
        return found;
    }
    let mut by_m: BTreeMap<u16, Vec<&SourcedDeclaration>> = BTreeMap::new();
    for one in declared {
        by_m.entry(one.declaration.m).or_default().push(one);
    }
    for output in programmed_outputs(program, dialect) {
        let Some(declared) = by_m.get(&output.m) else {
            continue;
        };
        let given = output.params.map(|word| match word {
            None => GivenParam::Absent,
            Some(word) => word.number().map_or(GivenParam::Variable, GivenParam::Number),
        });
        for SourcedDeclaration { by, declaration } in declared {
            for fault in declaration.faults(given) {
                let word = output.params[fault.letter as usize].unwrap_or(output.word);
                let is_known = |known: &Diagnostic| known.span == word.span() && known.message == fault.text;
                // diagnostics of the same block are at the end of the list
                if found.iter().rev().take(16).any(is_known) {
                    continue;
                }
                if found.len() == FOUND_MAX {
                    return found;
                }
                let help = format!("{by} declares {}.", declaration.text());
                found.push(PARAMS_REFUSED.at(word.span(), fault.text, help));
            }
        }
    }
    found
}

/// Returns alarm 11 if a declaration does not accept the parameters of an output; computed values are included. An
/// output without parameters needs no check here, because the load has checked its program.
pub fn refused_output(output: &Output, declared: &[SourcedDeclaration]) -> Option<Alarm> {
    let given = output
        .params
        .map(|value| value.map_or(GivenParam::Absent, GivenParam::Number));
    let mut faults = declared.iter().flat_map(|one| {
        let faults = one.declaration.faults(given).into_iter();
        faults.map(move |fault| format!("{} (declared by {})", fault.text, one.by))
    });
    Some(Alarm::new(&VALUE_OUT_OF_RANGE, faults.next()?).at(output.origin))
}

/// Returns the M codes of a program that no handler serves, each at the place where it first occurs.
pub fn unserved(
    program: &NcProgram,
    dialect: &Dialect,
    is_unserved: impl Fn(u16) -> bool,
) -> Vec<Diagnostic> {
    let mut found: BTreeMap<u16, Diagnostic> = BTreeMap::new();
    for output in programmed_outputs(program, dialect) {
        if !found.contains_key(&output.m) && is_unserved(output.m) {
            let message = format!("no handler serves M{:02}", output.m);
            let help = "Add a handler, or write the file named by [machine] served again.";
            found.insert(output.m, NOT_SERVED.at(output.word.span(), message, help));
        }
    }
    found.into_values().collect()
}

#[cfg(test)]
mod tests {
    use tandem_interp::dialects;
    use tandem_syntax::{Grammar, LineIndex, parse};

    use super::*;

    fn declared(by: &str, json: &str) -> SourcedDeclaration {
        SourcedDeclaration::by_handler(by, serde_json::from_str(json).unwrap())
    }

    fn clamp(by: &str) -> SourcedDeclaration {
        let json = r#"{"m":12,"name":"clamp","params":{"A":{"name":"force","unit":"kN","min":1,"max":20}}}"#;
        declared(by, json)
    }

    fn found(text: &str, declared: &[SourcedDeclaration]) -> Vec<((u32, u32), String)> {
        let (program, parsed) = parse(text, Grammar::nj());
        assert_eq!(parsed, []);
        let lines = LineIndex::new(text);
        let found = wrong_params(&program, dialects::nj(), declared);
        found
            .into_iter()
            .map(|found| (lines.locate(found.span.start), found.message))
            .collect()
    }

    #[test]
    fn wrong_parameter_found_at_its_word_missing_one_at_its_m_code() {
        let text = "G01 X10 F300\nM12 VA50\nN3 M12\nM12 VA5 VB1\nM12 VA[P3]\nM12 VA20\nM10 VA50\nM30\n";
        let expected = [
            ((2, 5), "M12 clamp: VA (force) is 50 kN; write 1 to 20 kN"),
            ((3, 4), "M12 clamp needs VA (force, 1 to 20 kN)"),
            ((4, 9), "M12 clamp takes no VB; it takes VA (force, 1 to 20 kN)"),
        ];
        assert_eq!(
            found(text, &[clamp("cell")]),
            expected.map(|(at, text)| (at, text.to_owned()))
        );
    }

    #[test]
    fn what_two_declare_alike_is_told_once_and_who_declares_it() {
        let (program, _) = parse("M12 VA50\n", Grammar::nj());
        let found = wrong_params(&program, dialects::nj(), &[clamp("a"), clamp("b")]);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].code, "E0191");
        assert_eq!(
            found[0].help,
            "handler a declares M12 clamp VA (force, 1 to 20 kN)."
        );
    }

    #[test]
    fn a_long_list_ends_at_its_limit() {
        let text = "M12\n".repeat(FOUND_MAX + 5);
        assert_eq!(found(&text, &[clamp("cell")]).len(), FOUND_MAX);
    }
}
