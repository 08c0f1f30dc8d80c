use tandem_model::Span;

use super::*;
use crate::codes::value::validate_value;
use crate::codes::{AXIS_WORDS, m_auxiliary::AUXILIARY};

fn alarm(spec: &crate::codes::WordSpec, value: f64) -> Option<Alarm> {
    let mut alarm = None;
    validate_value(spec, value, Span::default(), &mut |fault| {
        alarm = Some(alarm_for(&fault));
    });
    alarm
}

fn alarm_number(spec: &crate::codes::WordSpec, value: f64) -> Option<u16> {
    alarm(spec, value).map(|alarm| alarm.entry.number)
}

#[test]
fn d07_a_value_that_is_not_finite_is_an_alarm() {
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        assert_eq!(alarm_number(&AXIS_WORDS[0], value), Some(10));
        assert_eq!(alarm_number(&AUXILIARY.words[0], value), Some(10));
    }
}

#[test]
fn d11_a_computed_value_out_of_range_is_an_alarm() {
    assert_eq!(alarm_number(&AXIS_WORDS[0], 1_000_000.0), None);
    assert_eq!(alarm_number(&AXIS_WORDS[0], 1_000_000.1), Some(11));
}

#[test]
fn d11_out_of_range_alarm_names_value_and_range_in_few_digits() {
    for (value, text) in [(-1e6 - 0.5, "X-1000000.5 ("), (1e300, "X1e300 (")] {
        let alarm = alarm(&AXIS_WORDS[0], value).expect("beyond 1e6");
        assert!(alarm.text.starts_with(text), "{}", alarm.text);
        assert!(alarm.text.contains("-1000000 to 1000000 mm"), "{}", alarm.text);
    }
}
