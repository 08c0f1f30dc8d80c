//! The stock sequence program: the runtime's action for an M code for which no handler is registered. This module only
//! determines the action; the coordinate system executes it and resets the output.

use plc_protocol::types::output::OutputNotice;
use plc_protocol::types::state::SpindleDirection;

use tandem_config::{MCodeSettings, Stock};

/// Action of the stock sequence program. The reset of the output follows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StockAction {
    /// No action.
    Nothing,
    /// Commands the spindle. With `Orient`, the output is reset when the spindle is at its orientation position.
    Spindle(SpindleDirection),
    /// Sets the number of the tool in the spindle.
    SelectTool(u16),
}

/// Returns the action for an output; `None` if the stock sequence program does not handle this M code. Returns `Err`
/// with the reason if the action is impossible.
pub fn action(
    output: &OutputNotice,
    settings: &MCodeSettings,
    has_spindle: bool,
) -> Option<Result<StockAction, String>> {
    if settings.stock == Some(Stock::SelectTool) {
        return Some(selected_tool(output.m, output.params.a).map(StockAction::SelectTool));
    }
    let direction = spindle_direction(output.m)?;
    has_spindle.then_some(Ok(StockAction::Spindle(direction)))
}

/// Returns true for M03, M04, M05 and M19.
pub fn is_spindle_code(m: u16) -> bool {
    spindle_direction(m).is_some()
}

/// Returns the spindle command of M03, M04, M05 or M19; `None` for other M codes.
pub fn spindle_direction(m: u16) -> Option<SpindleDirection> {
    match m {
        3 => Some(SpindleDirection::Cw),
        4 => Some(SpindleDirection::Ccw),
        5 => Some(SpindleDirection::Stop),
        19 => Some(SpindleDirection::Orient),
        _ => None,
    }
}

/// Returns the tool number in VA of an M code with the setting [`Stock::SelectTool`]. Returns `Err` with the reason if
/// VA is missing or is not a tool number.
pub fn selected_tool(m: u16, va: Option<f64>) -> Result<u16, String> {
    match va {
        Some(id) if id.fract() == 0.0 && (0.0..=f64::from(u16::MAX)).contains(&id) =>
        {
            #[allow(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "checked above"
            )]
            Ok(id as u16)
        }
        Some(id) => Err(format!("M{m:02} VA{id}: VA is not a tool number")),
        None => Err(format!("M{m:02} needs VA: the tool number")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plc_protocol::types::output::{Params, Timing};

    fn output(m: u16, a: Option<f64>) -> OutputNotice {
        OutputNotice {
            id: String::new(),
            seq: 1,
            run_id: "1".into(),
            m,
            params: Params {
                a,
                ..Params::default()
            },
            timing: Timing::AfterMotion,
            program: 1,
            line: 1,
            attempt: 1,
            redelivered: false,
        }
    }

    #[test]
    fn spindle_codes_need_a_spindle() {
        let settings = MCodeSettings::default();
        let cw = Some(Ok(StockAction::Spindle(SpindleDirection::Cw)));
        assert_eq!(action(&output(3, None), &settings, true), cw);
        assert_eq!(action(&output(3, None), &settings, false), None);
        assert_eq!(action(&output(55, None), &settings, true), None);
    }

    #[test]
    fn select_tool_takes_va() {
        let settings = MCodeSettings {
            stock: Some(Stock::SelectTool),
            ..MCodeSettings::default()
        };
        assert_eq!(
            action(&output(6, Some(12.0)), &settings, false),
            Some(Ok(StockAction::SelectTool(12)))
        );
        assert!(matches!(action(&output(6, None), &settings, false), Some(Err(_))));
        assert!(matches!(
            action(&output(6, Some(1.5)), &settings, false),
            Some(Err(_))
        ));
    }
}
