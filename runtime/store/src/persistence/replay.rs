//! Updates the stored state of a run from the journal, which lags less than the store.
//!
//! The process may be killed after it issued an output and before the state writer stored it. The journal
//! lines written since then report the output. So the operator learns of every M code on which a handler may
//! have begun to work. Line numbers, which increase across all starts of the runtime, order lines and stored
//! states; the wall clock is not used.

use plc_protocol::types::data::LastRun;
use plc_protocol::types::output::{OutputState, PendingOutput, Timing};
use plc_protocol::types::state::Execution;
use plc_protocol::types::{BootId, CoordinateSystemNumber, Timestamp};
use serde::Deserialize;
use serde_json::Value;

use super::ahead::OPEN;
use super::image::{Image, KeptRun, LastRuns};
use crate::disk::number;
use crate::journal::{Event, Line};
use crate::tables::{keep, value_key};

/// Number of newest journal lines that are read. Reason: while the store lags, eight coordinate systems with
/// 200 M codes per second each write fewer lines.
pub const REPLAYED_LINES_MAX: usize = 4096;

/// Updates the last runs from the newest journal lines, and returns the runs that the store does not contain
/// yet.
pub fn replay_last_runs(
    systems: impl Iterator<Item = CoordinateSystemNumber>,
    last_runs: &mut LastRuns,
    journal: &[Value],
) -> Image {
    let mut change = Image::default();
    let last = journal.last().map_or(0, number);
    for cs in systems {
        let Some(run) = replay(cs, last_runs.get(&cs), journal) else {
            continue;
        };
        if last_runs.get(&cs).map(|kept| &kept.run) != Some(&run) {
            let run = KeptRun { run, line: last };
            keep(&mut change.values, value_key("last_run", cs), &run);
            last_runs.insert(cs, run);
        }
    }
    change
}

/// Returns the last run of a coordinate system: the stored run, updated by the journal lines.
fn replay(cs: CoordinateSystemNumber, kept: Option<&KeptRun>, journal: &[Value]) -> Option<LastRun> {
    let mut run = kept.map(|kept| kept.run.clone());
    let kept_line = kept.map_or(0, |kept| kept.line);
    for written in journal.iter().filter(|line| number(line) > kept_line) {
        // Skips lines of a form that this version does not know.
        let of_cs = Line::from_json(written).filter(|line| line.cs == cs);
        let ts = Timestamp::deserialize(&written["ts"]);
        let (Some(line), Ok(ts), Ok(boot_id)) = (of_cs, ts, BootId::deserialize(&written["boot_id"])) else {
            continue;
        };
        let of_run = match &line.event {
            Event::Start { program, run_id, .. } => Some((run_id.clone(), Some(*program))),
            // An output begins a run, because the line of the run's start may be lost.
            Event::Output(output) => Some((output.run_id.clone(), None)),
            _ => None,
        };
        if let Some((run_id, program)) = of_run
            && run.as_ref().map(|run| (&run.boot_id, &run.run_id)) != Some((&boot_id, &run_id))
        {
            run = Some(start_run(boot_id.clone(), run_id, program, ts.clone()));
        }
        if let Some(run) = run.as_mut().filter(|run| run.boot_id == boot_id) {
            // Removes outputs whose reset lines were lost.
            if let Ok(still_open) = Vec::<u64>::deserialize(&written[OPEN]) {
                run.outputs.retain(|open| still_open.contains(&open.output.seq));
            }
            on_event(run, line.event, ts);
        }
    }
    run.map(waiting)
}

/// Sets a run with pending outputs to WAIT, because its state may have been stored shortly before the wait
/// began.
fn waiting(mut run: LastRun) -> LastRun {
    let awaited = |open: &&PendingOutput| open.output.timing == Timing::AfterMotion;
    if run.execution == Execution::Active
        && let Some(open) = run.outputs.iter().find(awaited)
    {
        (run.execution, run.line) = (Execution::Wait, open.output.line);
        run.running = Some(open.output.program);
    }
    run
}

/// Creates the state of a run at its start.
fn start_run(boot_id: BootId, run_id: String, program: Option<u16>, at: Timestamp) -> LastRun {
    LastRun {
        boot_id,
        run_id,
        program,
        running: program,
        line: 1,
        execution: Execution::Active,
        outputs: Vec::new(),
        at,
    }
}

fn on_event(run: &mut LastRun, event: Event, at: Timestamp) {
    match event {
        // The start of the first part of the run, or of a further part.
        Event::Start { .. } => {
            (run.execution, run.line, run.running) = (Execution::Active, 1, run.program);
            run.outputs.clear();
        }
        Event::Output(output) => {
            if run.outputs.iter().any(|open| open.output.seq == output.seq) {
                return;
            }
            run.outputs.push(PendingOutput {
                redelivery: None,
                output: *output,
                state: OutputState::Output,
                handler_id: None,
                instance: None,
                since: at.clone(),
                lost: false,
                lost_instance: None,
                progress: None,
                checkpoint: None,
                how: None,
                question: None,
            });
        }
        Event::Claim { seq, handler_id } => {
            if let Some(open) = run.outputs.iter_mut().find(|open| open.output.seq == seq) {
                (open.state, open.since) = (OutputState::Claimed, at.clone());
                open.handler_id = Some(handler_id);
            }
        }
        Event::Reset { seq, .. } => {
            run.outputs.retain(|open| open.output.seq != seq);
            if run.execution == Execution::Wait && run.outputs.is_empty() {
                run.execution = Execution::Active;
            }
        }
        Event::End(end) => {
            run.execution = end.outcome();
            run.outputs.clear();
        }
        _ => return,
    }
    run.at = at;
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    const BOOT: &str = "b1";

    fn at(second: u32) -> String {
        format!("2026-01-01T00:00:{second:02}.000000Z")
    }

    /// A line, with its second as its number.
    fn line(second: u32, event: &str, fields: Value) -> Value {
        let mut line = fields;
        line["n"] = json!(second);
        line["boot_id"] = json!(BOOT);
        line["t_s"] = json!(0.0);
        line["cs"] = json!(1);
        line["event"] = json!(event);
        line["ts"] = json!(at(second));
        line
    }

    fn output(second: u32, seq: u64) -> Value {
        let fields = json!({
            "seq": seq, "run_id": "1-1", "m": 100, "params": {"A": 3.0}, "timing": "after_motion", "program": 60,
            "line": 7, "attempt": 1, "redelivered": false,
        });
        line(second, "output", fields)
    }

    /// Returns the lines of the boot and the start of run 1-1 in second 1, followed by `after`.
    fn journal(after: &[Value]) -> Vec<Value> {
        let begin = [
            line(1, "boot", json!({"boot_id": BOOT, "version": "0.1.0"})),
            line(1, "start", json!({"run_id": "1-1", "program": 60})),
        ];
        [&begin[..], after].concat()
    }

    /// Returns the run as the store contains it after the line of this second.
    fn kept(second: u32) -> KeptRun {
        let run = replay(1, None, &journal(&[])).unwrap();
        KeptRun {
            run,
            line: second.into(),
        }
    }

    fn open(run: &LastRun) -> Vec<(u64, OutputState)> {
        run.outputs
            .iter()
            .map(|open| (open.output.seq, open.state))
            .collect()
    }

    #[test]
    fn an_output_after_the_last_look_is_open() {
        let run = replay(1, Some(&kept(5)), &journal(&[output(6, 1)])).unwrap();
        assert_eq!((run.execution, run.line), (Execution::Wait, 7));
        assert_eq!(open(&run), [(1, OutputState::Output)]);
    }

    #[test]
    fn what_the_line_of_a_later_output_does_not_name_as_open_was_reset() {
        let (mut second, mut third) = (output(7, 2), output(8, 3));
        second["open"] = json!([1]);
        third["open"] = json!([1]);
        let run = replay(1, Some(&kept(5)), &journal(&[output(6, 1), second, third])).unwrap();
        assert_eq!(open(&run), [(1, OutputState::Output), (3, OutputState::Output)]);
    }

    #[test]
    fn a_run_that_was_kept_with_its_output_before_its_state_said_so_waits() {
        let looked_at = KeptRun {
            run: LastRun {
                execution: Execution::Active,
                line: 2,
                ..replay(1, Some(&kept(5)), &journal(&[output(6, 1)])).unwrap()
            },
            line: 7,
        };
        let run = replay(1, Some(&looked_at), &journal(&[output(6, 1)])).unwrap();
        assert_eq!((run.execution, run.line), (Execution::Wait, 7));
    }

    #[test]
    fn a_run_that_was_not_kept_at_all_is_told() {
        let run = replay(1, None, &journal(&[output(6, 1)])).unwrap();
        assert_eq!(
            (run.boot_id.0.as_str(), run.run_id.as_str(), run.program),
            (BOOT, "1-1", Some(60))
        );
        assert!(run.is_under_way());
        let of_before = KeptRun {
            run: LastRun {
                boot_id: BootId("b0".into()),
                execution: Execution::ProgramCompleted,
                ..kept(0).run
            },
            line: 0,
        };
        assert_eq!(replay(1, Some(&of_before), &journal(&[output(6, 1)])), Some(run));
    }

    #[test]
    fn what_was_claimed_reset_or_ended_since_is_so() {
        let claim = line(7, "claim", json!({"seq": 1, "handler_id": "gripper"}));
        let reset = line(
            8,
            "reset",
            json!({"seq": 1, "m": 100, "handler_id": "gripper", "result": "ok"}),
        );
        let end = line(9, "end", json!({"outcome": "PROGRAM_COMPLETED"}));
        let lines = journal(&[output(6, 1), claim, output(7, 2), reset, end]);
        let after = |n: usize| replay(1, Some(&kept(5)), &lines[..n]).unwrap();
        assert_eq!(after(4).outputs[0].handler_id.as_deref(), Some("gripper"));
        assert_eq!(
            open(&after(5)),
            [(1, OutputState::Claimed), (2, OutputState::Output)]
        );
        assert_eq!(open(&after(6)), [(2, OutputState::Output)]);
        assert!(!after(7).is_under_way());
        assert_eq!(open(&after(7)), []);
    }

    #[test]
    fn a_run_is_under_way_in_each_of_its_parts() {
        let end = line(7, "end", json!({"outcome": "PROGRAM_COMPLETED"}));
        let next = line(8, "start", json!({"run_id": "1-1", "program": 60}));
        let lines = journal(&[output(6, 1), end, next]);
        let after = |n: usize| replay(1, Some(&kept(5)), &lines[..n]).unwrap();
        assert!(!after(4).is_under_way());
        let run = after(5);
        assert_eq!((run.execution, run.line), (Execution::Active, 1));
        assert_eq!(open(&run), []);
    }

    #[test]
    fn what_was_kept_later_than_a_line_counts() {
        assert_eq!(
            replay(1, Some(&kept(6)), &journal(&[output(6, 1)])),
            Some(kept(6).run)
        );
    }

    #[test]
    fn a_line_of_another_version_and_a_damaged_one_tell_nothing() {
        let later = line(7, "polished", json!({"seq": 1}));
        let damaged = line(8, "reset", json!({"handler_id": "gripper", "result": "ok"}));
        let lines = journal(&[output(6, 1), later, damaged, json!(null), json!("reset")]);
        let run = replay(1, Some(&kept(5)), &lines).unwrap();
        assert_eq!(open(&run), [(1, OutputState::Output)]);
        assert_eq!(run.at, Timestamp(at(6)));
    }

    #[test]
    fn other_coordinate_systems_and_boots_do_not_change_the_last_run() {
        let mut other = output(6, 1);
        other["cs"] = json!(2);
        let mut boot = line(7, "boot", json!({"version": "0.1.0"}));
        boot["boot_id"] = json!("b2");
        let mut reset = line(8, "reset", json!({"seq": 1, "handler_id": "h", "result": "ok"}));
        reset["boot_id"] = json!("b2");
        let lines = journal(&[other, boot, reset]);
        assert_eq!(replay(1, Some(&kept(5)), &lines), Some(kept(5).run));
    }

    #[test]
    fn the_number_of_a_line_orders_runs_and_not_the_clock_of_the_day() {
        let mut later = journal(&[output(6, 1)]);
        for (line, n) in later.iter_mut().zip(10..) {
            line["n"] = json!(n);
            line["ts"] = json!("2025-12-31T22:00:00.000000Z");
            line["boot_id"] = json!("b2");
        }
        let run = replay(1, Some(&kept(5)), &[journal(&[]), later].concat()).unwrap();
        assert_eq!((run.boot_id.0.as_str(), open(&run).len()), ("b2", 1));
    }

    #[test]
    fn an_output_whose_start_was_lost_is_told() {
        let mut ahead = output(6, 1);
        ahead["boot_id"] = json!("b9");
        ahead["run_id"] = json!("1-4");
        let run = replay(1, Some(&kept(5)), &[ahead]).unwrap();
        assert_eq!(
            (run.boot_id.0.as_str(), run.run_id.as_str(), run.program),
            ("b9", "1-4", None)
        );
        assert_eq!((open(&run).len(), run.running), (1, Some(60)));
    }
}
