//! Checks the value of a word against the description of the word.

use tandem_model::{Diagnostic, Span};
use tandem_syntax::diagnostics;

use super::WordSpec;

/// Checks a value against the description of its word (D07, D11), and reports a fault.
#[inline]
pub(crate) fn validate_value(spec: &WordSpec, value: f64, span: Span, fault: &mut dyn FnMut(Diagnostic)) {
    if spec.integer || !value.is_finite() || !spec.holds(value) {
        report_invalid_value(spec, value, span, fault);
    }
}

/// Reports a value that is not finite, out of range, or not whole where a whole number is required.
#[cold]
fn report_invalid_value(spec: &WordSpec, value: f64, span: Span, fault: &mut dyn FnMut(Diagnostic)) {
    let name = spec.address.text();
    if !value.is_finite() {
        fault(diagnostics::NUMBER_TOO_LARGE.at(
            span,
            format!("the value of {name} is {value}"),
            "Check the calculation of the value.",
        ));
    } else if !spec.holds(value) {
        fault(diagnostics::OUT_OF_RANGE.at(
            span,
            format!(
                "{name}{} ({}) is out of its range of {}",
                shown(value),
                spec.meaning,
                spec.range_text()
            ),
            "Write a value within the range.",
        ));
    } else if spec.integer && value.fract().abs() > 0.0 {
        fault(diagnostics::INTEGER_NEEDED.at(
            span,
            format!("{name}{value} ({}) is not a whole number", spec.meaning),
            "Write it without decimals.",
        ));
    }
}

/// Returns a calculated number as text; from 1e15 on and below 1e-9 with a power of ten.
fn shown(value: f64) -> String {
    if value != 0.0 && !(1e-9..1e15).contains(&value.abs()) {
        format!("{value:e}")
    } else {
        value.to_string()
    }
}
