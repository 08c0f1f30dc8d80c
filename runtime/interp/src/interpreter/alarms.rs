//! Alarms of blocks that cannot be executed.

use tandem_model::alarm::{
    ARC_REFUSED, COMPENSATION_REFUSED, FIXED_CYCLE_REFUSED, OFFSET_REFUSED, PROGRAM_HAS_ERRORS, VALUE_LOST,
    VALUE_NOT_FINITE, VALUE_OUT_OF_RANGE,
};
use tandem_model::{Alarm, Diagnostic};
use tandem_syntax::{Variable, diagnostics};

/// Returns the alarm of a block that reads a variable with a lost value.
pub(super) fn value_lost(variable: Variable) -> Alarm {
    let Variable { kind, index } = variable;
    let text = format!(
        "{}{index} is damaged; the block that reads it has not moved",
        kind.prefix()
    );
    Alarm::new(&VALUE_LOST, text)
}

/// Returns the alarm for a fault that the checker would report as an error.
#[cold]
pub(super) fn alarm_for(fault: &Diagnostic) -> Alarm {
    let alarms = [
        (&diagnostics::NUMBER_TOO_LARGE, &VALUE_NOT_FINITE),
        (&diagnostics::OUT_OF_RANGE, &VALUE_OUT_OF_RANGE),
        (&diagnostics::COMPENSATION_RULE, &COMPENSATION_REFUSED),
        (&diagnostics::TOOL_OFFSET_RULE, &OFFSET_REFUSED),
        (&diagnostics::FIXED_CYCLE_RULE, &FIXED_CYCLE_REFUSED),
        (&diagnostics::ARC_SHAPE, &ARC_REFUSED),
    ];
    let found = alarms.iter().find(|(entry, _)| entry.code == fault.code);
    if let Some((_, entry)) = found {
        return Alarm::new(entry, fault.message.clone());
    }
    let (code, message, help) = (fault.code, &fault.message, &fault.help);
    Alarm::new(&PROGRAM_HAS_ERRORS, format!("{code}: {message}. {help}"))
}
