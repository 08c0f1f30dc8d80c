//! Numbers in the text: those of codes, and those of a dialect that counts increments (manual dgshape, 1-5
//! and 2-1).

use tandem_model::settings::{Calculator, NcOptions, Unit};
use tandem_model::{Diagnostic, Span};
use tandem_syntax::{Address, AddressSet, Word, diagnostics};

use crate::codes::WordSpec;

/// Number of least increments in a mm, and in a mm/min.
const PER_MM: f64 = 1000.0;

/// Number of least increments in an inch, and in an inch per minute.
const PER_INCH: f64 = 10_000.0;

/// Number of least increments in a second.
const PER_S: f64 = 1000.0;

/// Largest number without a decimal point, also in words that never have a decimal point (ranges 1 and 2).
const WITHOUT_POINT_MAX: f64 = 99_999_999.0;

/// Largest number with a decimal point (range 1).
const WITH_POINT_MAX: f64 = 99_999.999;

/// Largest length (mm) and feedrate (mm/min) with a decimal point.
const WITH_POINT_MM_MAX: f64 = 9_999.999;

const ANGLES: AddressSet = AddressSet::from_addresses(&[Address::A, Address::B, Address::C]);

/// Addresses of the dimension words, which a setting can exempt from counting increments.
const DIMENSIONS: AddressSet = AddressSet::from_addresses(&[
    Address::I,
    Address::J,
    Address::K,
    Address::R,
    Address::X,
    Address::Y,
    Address::Z,
    Address::A,
]);

/// Kind of quantity that a number expresses.
#[derive(Clone, Copy, PartialEq, Eq)]
enum QuantityKind {
    LengthOrFeedrate,
    Angle,
    Time,
    /// A quantity without increments: its value is the written number.
    Plain,
}

fn quantity_kind(spec: &WordSpec) -> QuantityKind {
    match spec.unit {
        _ if spec.integer => QuantityKind::Plain,
        "mm or deg" if ANGLES.contains(spec.address) => QuantityKind::Angle,
        "mm" | "mm or deg" | "mm/min" => QuantityKind::LengthOrFeedrate,
        "s" => QuantityKind::Time,
        _ => QuantityKind::Plain,
    }
}

/// Converts the number in a word to its value. A number without a decimal point counts increments unless a
/// setting exempts it.
pub(crate) fn convert_written_value(
    value: f64,
    spec: &WordSpec,
    word: &Word,
    unit: Unit,
    options: &NcOptions,
) -> f64 {
    let as_by_calculator = match options.calculator {
        Calculator::None => false,
        Calculator::All => true,
        Calculator::F => word.address == Address::F,
        Calculator::Dimensions => DIMENSIONS.contains(word.address),
    };
    if !word.is_whole() || as_by_calculator {
        return value;
    }
    match (quantity_kind(spec), unit) {
        (QuantityKind::LengthOrFeedrate, Unit::Millimetre) => value / PER_MM,
        (QuantityKind::LengthOrFeedrate, Unit::Inch) => value / PER_INCH,
        (QuantityKind::Angle, _) => value * options.angle_increment_deg,
        (QuantityKind::Time, _) => value / PER_S,
        (QuantityKind::Plain, _) => value,
    }
}

/// Returns the range of the numbers that may be written in a word, with their unit; lengths in mm.
pub(crate) fn written_range(spec: &WordSpec) -> String {
    let both = |with_point: f64, unit: &str| {
        format!(
            "-{with_point} to {with_point} {unit} with a decimal point, -{WITHOUT_POINT_MAX} to {WITHOUT_POINT_MAX} increments without"
        )
    };
    match quantity_kind(spec) {
        QuantityKind::LengthOrFeedrate => {
            let unit = if spec.unit == "mm or deg" { "mm" } else { spec.unit };
            both(WITH_POINT_MM_MAX, unit)
        }
        QuantityKind::Angle => both(WITH_POINT_MAX, "deg"),
        QuantityKind::Plain if spec.max.is_infinite() => {
            format!("-{WITHOUT_POINT_MAX} to {WITHOUT_POINT_MAX} {}", spec.unit)
        }
        QuantityKind::Plain | QuantityKind::Time => spec.range_text(),
    }
}

/// Checks the form and the range of a written number. Returns `true` if both are valid.
pub(crate) fn validate_written_form(
    spec: &WordSpec,
    word: &Word,
    unit: Unit,
    fault: &mut dyn FnMut(Diagnostic),
) -> bool {
    let Some(written) = word.number() else { return true };
    let has_point = !word.is_whole();
    let name = word.address.text();
    if spec.integer && has_point {
        let message = format!("{name} ({}) is written with a decimal point", spec.meaning);
        fault(diagnostics::INTEGER_NEEDED.at(word.span(), message, "Write it without a decimal point."));
        return false;
    }
    let max = match (has_point, quantity_kind(spec), unit) {
        (false, ..) => WITHOUT_POINT_MAX,
        (true, QuantityKind::LengthOrFeedrate, Unit::Millimetre) => WITH_POINT_MM_MAX,
        (true, ..) => WITH_POINT_MAX,
    };
    let within = written.abs() <= max;
    if !within {
        let how = if has_point { "with" } else { "without" };
        fault(out_of_range(name, written, spec.meaning, max, how, word.span()));
    }
    within
}

/// Checks a block number (N), which has no decimal point (manual dgshape, 2-6). The parser counts its digits.
pub(crate) fn validate_block_number(word: &Word, fault: &mut dyn FnMut(Diagnostic)) {
    let number = word.number().unwrap_or_default();
    if !word.is_whole() || number < 0.0 {
        let message = format!("N{number} is not a block number");
        let help = "Write N and 1 to 8 digits.";
        fault(diagnostics::CODE_NUMBER.at(word.span(), message, help));
    }
}

#[cold]
fn out_of_range(name: &str, written: f64, meaning: &str, max: f64, how: &str, span: Span) -> Diagnostic {
    diagnostics::OUT_OF_RANGE.at(
        span,
        format!("{name}{written} ({meaning}) is out of the range of -{max} to {max} {how} a decimal point"),
        "Write a value within the range.",
    )
}

/// Returns the number of a G word, or `None` if the word is negative or not a constant.
pub(crate) fn code_number(word: &Word) -> Option<f64> {
    word.number().filter(|value| *value >= 0.0)
}

/// Checks that a block number is a whole number.
pub(crate) fn validate_whole_number(word: &Word, fault: &mut dyn FnMut(Diagnostic)) {
    if word.whole().is_none() {
        fault(constant_needed(word, "a whole number", "N10"));
    }
}

/// Returns the finding for a code whose number is not a valid constant.
#[cold]
pub(crate) fn constant_needed(word: &Word, kind: &str, example: &str) -> Diagnostic {
    let name = word.address.text();
    let shown = word
        .number()
        .map_or_else(|| "[...]".to_owned(), |value| value.to_string());
    diagnostics::CODE_NUMBER.at(
        word.span(),
        format!("{name}{shown} is not a code number"),
        format!("Write {kind} such as {example}."),
    )
}

#[cfg(test)]
mod tests {
    use tandem_syntax::{Grammar, parse};

    use super::*;
    use crate::codes::feed_words::FEED_AND_SPEED;
    use crate::codes::g04_dwell::G04_X_P;
    use crate::codes::{AXIS_WORDS, axis_word};

    /// Returns the value of a word in mm, degrees, mm/min or s, or the finding.
    fn read(text: &str, unit: Unit, calculator: Calculator) -> Result<f64, &'static str> {
        let (program, _) = parse(text.to_owned(), Grammar::dgshape());
        let word = program.all_words()[0];
        let options = NcOptions {
            calculator,
            angle_increment_deg: 0.01,
            ..NcOptions::default()
        };
        let spec = match word.address {
            Address::F => FEED_AND_SPEED[0].clone(),
            Address::S => FEED_AND_SPEED[1].clone(),
            Address::A => axis_word(Address::A),
            Address::T => G04_X_P.words[0].clone(),
            _ => AXIS_WORDS[0].clone(),
        };
        let mut found = None;
        validate_written_form(&spec, &word, unit, &mut |fault| found = Some(fault.code));
        let value = convert_written_value(word.number().unwrap(), &spec, &word, unit, &options);
        found.map_or(Ok(value), Err)
    }

    #[test]
    fn dgshape_1_5_a_number_means_its_unit_or_so_many_increments() {
        use Calculator::{All, None};
        use Unit::{Inch, Millimetre as Mm};
        // the manual's tables of inch input and millimetre input: distance, angle, feedrate
        for (text, unit, calculator, expected) in [
            ("X1000", Mm, None, 1.0),
            ("X1000", Mm, All, 1000.0),
            ("X1000.", Mm, None, 1000.0),
            ("X1000", Inch, None, 0.1),
            ("X1000", Inch, All, 1000.0),
            ("X1000.0", Inch, None, 1000.0),
            ("F120000", Mm, None, 120.0),
            ("F120.0", Mm, None, 120.0),
            ("F50000", Inch, None, 5.0),
            ("F5.0", Inch, None, 5.0),
            ("A4500", Mm, None, 45.0),
            ("A45", Inch, All, 45.0),
            ("A45.", Mm, None, 45.0),
            ("S8000", Mm, None, 8000.0),
            ("S8000", Inch, All, 8000.0),
        ] {
            let value = read(text, unit, calculator).unwrap();
            assert!(
                (value - expected).abs() < 1e-9,
                "{text} {unit:?} {calculator:?}: {value}"
            );
        }
    }

    #[test]
    fn dgshape_1_5_calculator_reading_can_be_limited_to_words() {
        use Calculator::{All, Dimensions, F, None};
        for (calculator, x, f) in [
            (None, 1.0, 1.0),
            (All, 1e3, 1e3),
            (F, 1.0, 1e3),
            (Dimensions, 1e3, 1.0),
        ] {
            assert_eq!(
                read("X1000", Unit::Millimetre, calculator),
                Ok(x),
                "{calculator:?}"
            );
            assert_eq!(
                read("F1000", Unit::Millimetre, calculator),
                Ok(f),
                "{calculator:?}"
            );
        }
    }

    #[test]
    fn dgshape_2_1_what_is_written_has_a_range() {
        use Unit::{Inch, Millimetre as Mm};
        let fault = Err("E0109");
        for (text, unit, good) in [
            ("X99999999", Mm, true),
            ("X-99999999", Inch, true),
            ("X100000000", Mm, false),
            ("X9999.999", Mm, true),
            ("X10000.0", Mm, false),
            ("X-10000.", Mm, false),
            ("X10000.0", Inch, true),
            ("X99999.999", Inch, true),
            ("X100000.0", Inch, false),
            ("F9999.999", Mm, true),
            ("F10000.", Mm, false),
            ("A99999.999", Mm, true),
            ("A100000.", Mm, false),
        ] {
            let found = read(text, unit, Calculator::None);
            assert_eq!(found.is_ok(), good, "{text} {unit:?}: {found:?}");
            assert!(good || found == fault);
        }
        assert_eq!(read("S8000.", Mm, Calculator::None), Err("E0110"));
    }
}
