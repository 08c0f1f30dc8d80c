//! The warning to the operator about a run that the end of an earlier start of the runtime cut short.

use plc_protocol::execution::wire_name;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::data::LastRun;
use plc_protocol::types::machine::{AlarmRecord, AlarmSeverity};
use plc_protocol::types::output::PendingOutput;
use plc_protocol::types::run::Run;
use serde_json::json;
use tandem_model::alarm::RESTARTED_IN_RUN;

/// Returns the warning about a run that was cut short, with the pending M codes.
pub fn cut_short(cs: CoordinateSystemNumber, last_run: &LastRun) -> AlarmRecord {
    AlarmRecord {
        severity: AlarmSeverity::Warning,
        number: RESTARTED_IN_RUN.number,
        text: format!("{}: {}", RESTARTED_IN_RUN.title, what_was_open(last_run)),
        cs: Some(cs),
        program: last_run.running.or(last_run.program),
        line: Some(last_run.line),
        ..AlarmRecord::default()
    }
}

/// Returns the warning about a run of several parts that was cut short between two parts.
pub fn cut_short_between_parts(run: &Run) -> AlarmRecord {
    let (id, done, parts) = (&run.id, run.parts_done, run.parts);
    AlarmRecord {
        severity: AlarmSeverity::Warning,
        number: RESTARTED_IN_RUN.number,
        text: format!(
            "{}: run {id} was between two parts; {done} of {parts} are done",
            RESTARTED_IN_RUN.title
        ),
        cs: Some(run.cs),
        program: Some(run.program),
        ..AlarmRecord::default()
    }
}

/// Describes the state of a run, for example:
/// `run 1-3 was in WAIT; open: M100 VA3 (line 7, CLAIMED by gripper)`.
fn what_was_open(last_run: &LastRun) -> String {
    let one = |open: &PendingOutput| {
        let output = &open.output;
        let params = json!(output.params);
        let params = params.as_object().into_iter().flatten();
        let params: Vec<String> = params
            .map(|(letter, value)| format!(" V{letter}{value}"))
            .collect();
        let params = params.concat();
        let owner = open.handler_id.as_ref().map(|id| format!(" by {id}"));
        let state = wire_name(&open.state) + &owner.unwrap_or_default();
        format!("M{:02}{params} (line {}, {state})", output.m, output.line)
    };
    let open: Vec<String> = last_run.outputs.iter().map(one).collect();
    let open = if open.is_empty() {
        "no M code is known to have been open".to_owned()
    } else {
        format!("open: {}", open.join(", "))
    };
    let execution = wire_name(&last_run.execution);
    format!("run {} was in {execution}; {open}", last_run.run_id)
}
