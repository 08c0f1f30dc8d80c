//! What the journal knows about a run beyond the stored state: the journal lags behind less.
//!
//! A kill may come after an output was made and before the state writer looked again. The lines of the journal since
//! then report it, so that the operator learns of every M code on which a handler may have begun to work.

use plc_api::types::data::LastRun;
use plc_api::types::output::{OutputState, PendingOutput, Timing};
use plc_api::types::state::Execution;
use plc_api::types::{BootId, CoordinateSystemNumber, Timestamp};
use serde::Deserialize;
use serde_json::Value;

use super::image::{Image, LastRuns};
use crate::journal::{Event, Line};
use crate::tables::{keep, value_key};

/// Newest lines of the journal that are read. Reason: eight coordinate systems of 200 M codes a second write fewer in the
/// time by which what is kept may be behind.
pub(crate) const REPLAYED_LINES_MAX: usize = 4096;

/// Brings the last runs up to the newest lines of the journal; gives what of them is not kept yet.
pub(crate) fn replay_last_runs(
    systems: impl Iterator<Item = CoordinateSystemNumber>,
    last_runs: &mut LastRuns,
    journal: &[Value],
) -> Image {
    let mut change = Image::default();
    for cs in systems {
        let Some(run) = replay(cs, last_runs.get(&cs), journal) else {
            continue;
        };
        if last_runs.get(&cs) != Some(&run) {
            keep(&mut change.values, value_key("last_run", cs), &run);
            last_runs.insert(cs, run);
        }
    }
    change
}

/// The last run of a coordinate system, as kept and as these lines of the journal tell what came after.
fn replay(cs: CoordinateSystemNumber, kept: Option<&LastRun>, journal: &[Value]) -> Option<LastRun> {
    let mut boot_id = kept.map(|kept| kept.boot_id.clone());
    let mut run = kept.cloned();
    let kept_at = kept.and_then(|kept| kept.at.to_system_time());
    for written in journal {
        // Lines that this version does not know are left out.
        let of_cs = Line::from_json(written).filter(|line| line.cs == cs);
        let (Some(line), Ok(ts)) = (of_cs, Timestamp::deserialize(&written["ts"])) else {
            continue;
        };
        if ts.to_system_time() <= kept_at {
            continue;
        }
        match line.event {
            Event::Boot { boot_id: of, .. } => boot_id = Some(of),
            Event::Start { program, run_id } => {
                let is_this = |run: &LastRun| Some(&run.boot_id) == boot_id.as_ref() && run.run_id == run_id;
                if let Some(boot_id) = boot_id.clone()
                    && !run.as_ref().is_some_and(is_this)
                {
                    run = Some(begun(boot_id, run_id, program, ts));
                }
            }
            event => {
                let of_boot = run.as_mut().filter(|run| Some(&run.boot_id) == boot_id.as_ref());
                if let Some(run) = of_boot {
                    on_event(run, event, ts);
                }
            }
        }
    }
    run.map(waiting)
}

/// The run, in WAIT where it waits for an output: its state may have been stored a moment before that.
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

/// A run at its start.
fn begun(boot_id: BootId, run_id: String, program: u16, at: Timestamp) -> LastRun {
    LastRun {
        boot_id,
        run_id,
        program: Some(program),
        running: Some(program),
        line: 1,
        execution: Execution::Active,
        outputs: Vec::new(),
        at,
    }
}

fn on_event(run: &mut LastRun, event: Event, at: Timestamp) {
    match event {
        Event::Output(output) => {
            if output.run_id != run.run_id || run.outputs.iter().any(|open| open.output.seq == output.seq) {
                return;
            }
            run.outputs.push(PendingOutput {
                output: *output,
                state: OutputState::Output,
                handler_id: None,
                since: at.clone(),
                lost: false,
                progress: None,
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

    fn line(second: u32, event: &str, fields: Value) -> Value {
        let mut line = fields;
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

    /// The boot and the start of run 1-1 in second 1, and what came after.
    fn journal(after: &[Value]) -> Vec<Value> {
        let begin = [
            line(1, "boot", json!({"boot_id": BOOT, "version": "0.1.0"})),
            line(1, "start", json!({"run_id": "1-1", "program": 60})),
        ];
        [&begin[..], after].concat()
    }

    fn kept(second: u32) -> LastRun {
        replay(1, None, &journal(&[]))
            .map(|run| LastRun {
                at: Timestamp(at(second)),
                ..run
            })
            .unwrap()
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
    fn a_run_that_was_kept_with_its_output_before_its_state_said_so_waits() {
        let looked_at = LastRun {
            execution: Execution::Active,
            line: 2,
            at: Timestamp(at(7)),
            ..replay(1, Some(&kept(5)), &journal(&[output(6, 1)])).unwrap()
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
        let of_before = LastRun {
            boot_id: BootId("b0".into()),
            execution: Execution::ProgramCompleted,
            ..kept(0)
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
    fn what_was_kept_later_than_a_line_counts() {
        assert_eq!(
            replay(1, Some(&kept(6)), &journal(&[output(6, 1)])),
            Some(kept(6))
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
    fn lines_of_other_coordinate_systems_and_of_a_boot_without_a_run_change_nothing() {
        let mut other = output(6, 1);
        other["cs"] = json!(2);
        let boot = line(7, "boot", json!({"boot_id": "b2", "version": "0.1.0"}));
        let lines = journal(&[other, boot, output(8, 1)]);
        assert_eq!(replay(1, Some(&kept(5)), &lines), Some(kept(5)));
    }
}
