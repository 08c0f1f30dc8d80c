//! The plan shown for a run belongs to this run: it has the text and the inputs with which the run began.

use plc_api::Execution;
use plc_protocol::types::line_start::LineStart;
use plc_protocol::types::planned::{PathIdentity, PathQuery, Rehearsal, RehearsalOutcome};
use plc_protocol::types::request::{OverrideChange, Request, typed};
use plc_protocol::types::state::Reason;

use super::rig::{Rig, on_machine};

/// Reads a tool, an offset, P and Q variables, skips, an optional stop and a subprogram; it sets P2 before
/// reading it, and moves relative to its start.
const READS: &str = "G54 G90 G00 G43 Z5
P2 = 10
L1 = P2
G91 G01 X[P10] F6000
/1 X2
/2 X3
X[Q3]
M98 P1001
M01
M30
";

const CALLED: &str = "G91 G01 X1 F3000\nM99\n";

const TOOLS: &str =
    "[[tool]]\nid = 1\nradius = 2.0\nlength = 8.0\n[[tool]]\nid = 2\nradius = 2.0\nlength = 9.0\n";

async fn write(rig: &Rig, number: u16, text: &str) {
    let write = Request::WriteProgram(number, text.to_owned());
    rig.plc.port().request(write).await.unwrap();
}

async fn rehearsal(rig: &Rig) -> Rehearsal {
    rig.plc.port().ask(typed::Rehearsal(50, Some(1))).await.unwrap()
}

async fn change(rig: &Rig, body: serde_json::Value) {
    let change = serde_json::from_value(body).unwrap();
    rig.plc
        .port()
        .ask(typed::WriteWorkOffsets(1, change))
        .await
        .unwrap();
}

/// Each input of a plan.
const INPUTS: [&str; 13] = [
    "text",
    "called",
    "offset",
    "table",
    "tool",
    "skip",
    "stop",
    "dry run",
    "single block",
    "P",
    "Q",
    "position",
    "nothing",
];

async fn set(rig: &Rig, input: &str) {
    match input {
        "text" => {
            write(rig, 50, &READS.replace("X2", "X7")).await;
            rig.cs.load(50).await.unwrap();
        }
        "called" => write(rig, 1001, "G91 G01 X4 F3000\nM99\n").await,
        "offset" => change(rig, serde_json::json!({"work_offsets": {"G54": {"Z": 42.0}}})).await,
        "table" => {
            let body = serde_json::json!({"tools": [{"id": 1, "radius": 2.0, "length": 12.5}]});
            let change = serde_json::from_value(body).unwrap();
            rig.plc.port().ask(typed::WriteTools(change)).await.unwrap();
        }
        "tool" => rig.cs.select_tool(2).await.unwrap(),
        "skip" => rig.cs.set_optional_skip(1, true).await.unwrap(),
        "stop" => rig.cs.set_optional_stop(true).await.unwrap(),
        "dry run" => rig.cs.set_dry_run(true).await.unwrap(),
        "single block" => rig.cs.set_single_block(true).await.unwrap(),
        "P" => rig.plc.variables().set(10, 15.0).await.unwrap(),
        "Q" => rig.cs.variables().set(3, 6.0).await.unwrap(),
        "position" => rig.cs.mdi("G91 G01 X3 F6000").await.unwrap(),
        "nothing" => {}
        other => panic!("{other}"),
    }
}

async fn prepare(rig: &Rig) {
    write(rig, 1001, CALLED).await;
    rig.cs.select_tool(1).await.unwrap();
    rig.plc.variables().set(10, 5.0).await.unwrap();
    rig.cs.variables().set(3, 1.0).await.unwrap();
    rig.load(READS).await;
}

#[test]
fn plan_of_a_run_has_the_inputs_with_which_it_began() {
    for input in INPUTS {
        on_machine(TOOLS, move |rig| async move {
            prepare(&rig).await;
            let before = rehearsal(&rig).await;
            assert_eq!(before.run_id, None, "{input}");
            set(&rig, input).await;
            rig.trace();
            rig.cs.start().await.unwrap();
            let state = rig.cs.state().await.unwrap();
            let of_run = rehearsal(&rig).await;
            assert_eq!(of_run.run_id, state.run_id, "{input}");
            assert_eq!(Some(&of_run.hash), state.hash.as_ref(), "{input}");
            assert_eq!(of_run.plan != before.plan, input != "nothing", "{input}");
            if input == "stop" {
                rig.until(Execution::OptionalStop).await;
                rig.cs.resume().await.unwrap();
            }
            while input == "single block" && rig.interrupted_or_completed().await {
                rig.cs.resume().await.unwrap();
            }
            rig.until(Execution::ProgramCompleted).await;
            for (letter, index) in [("X", 0), ("Z", 2)] {
                let trace = rig.trace.lock().unwrap();
                let highest = trace.iter().map(|at| at[index]).fold(f64::NEG_INFINITY, f64::max);
                let planned = of_run.axes[letter].highest;
                assert!(
                    (highest - planned).abs() < 1e-9,
                    "{input}: {letter} {highest} {planned}"
                );
            }
        });
    }
}

#[test]
fn inputs_that_change_during_a_run_leave_its_plan_and_the_next_has_them() {
    for input in INPUTS
        .into_iter()
        .filter(|input| !["text", "called", "position", "nothing"].contains(input))
    {
        on_machine(TOOLS, move |rig| async move {
            prepare(&rig).await;
            rig.cs.start().await.unwrap();
            let began = rehearsal(&rig).await.plan;
            set(&rig, input).await;
            let now = rehearsal(&rig).await;
            assert_eq!(now.plan, began, "{input}");
            assert_eq!(now.run_id, rig.cs.state().await.unwrap().run_id, "{input}");
            rig.cs.stop().await.unwrap();
            let next = rehearsal(&rig).await;
            assert_eq!(next.run_id, None, "{input}");
            assert_ne!(next.plan, began, "{input}");
        });
    }
}

#[test]
fn a_variable_that_the_program_does_not_read_changes_no_plan() {
    on_machine(TOOLS, |rig| async move {
        prepare(&rig).await;
        let tag = async || {
            let path = typed::PlannedPath(50, PathQuery::default());
            rig.plc.port().ask(path).await.unwrap().tag
        };
        let first = tag().await;
        // P2 is set before it is read
        for (number, is_read) in [(500, false), (2, false), (11, false), (10, true)] {
            rig.plc.variables().set(number, 7.0).await.unwrap();
            assert_eq!(tag().await != first, is_read, "P{number}");
        }
        let second = tag().await;
        for (number, is_read) in [(4, false), (3, true)] {
            rig.cs.variables().set(number, 7.0).await.unwrap();
            assert_eq!(tag().await != second, is_read, "Q{number}");
        }
    });
}

#[test]
fn the_bytes_of_a_path_name_the_run_and_the_plan() {
    on_machine(TOOLS, |rig| async move {
        prepare(&rig).await;
        let path = async || {
            let path = typed::PlannedPath(50, PathQuery::default());
            rig.plc.port().ask(path).await.unwrap()
        };
        let before = path().await;
        rig.cs.start().await.unwrap();
        let during = path().await;
        let planned = rehearsal(&rig).await;
        for (path, run_id) in [(&before, None), (&during, rig.cs.state().await.unwrap().run_id)] {
            let identity = PathIdentity::of_bytes(&path.bytes).unwrap();
            assert_eq!((&identity.run_id, &identity.plan), (&run_id, &planned.plan));
            assert_eq!((&path.run_id, &path.plan), (&run_id, &planned.plan));
        }
        assert_ne!(before.tag, during.tag);
        assert!(planned.plan.called.is_some());
        assert_eq!(planned.plan.hash, planned.hash);
    });
}

#[test]
fn a_run_from_a_line_has_its_own_plan_and_a_time_left() {
    on_machine("", |rig| async move {
        rig.load("G90 G01 X50 F6000\nY10\nX20 F1200\nX0\nM30\n").await;
        let whole = rehearsal(&rig).await;
        rig.trace();
        rig.cs.start_from(LineStart::line(3)).await.unwrap();
        let planned = rehearsal(&rig).await;
        assert_eq!(planned.run_id, rig.cs.state().await.unwrap().run_id);
        assert_ne!(planned.plan, whole.plan);
        let mut told = Vec::new();
        while rig.state().await.0 != Execution::ProgramCompleted {
            if let Some(left_s) = rehearsal(&rig).await.run.and_then(|run| run.left_s) {
                told.push((rig.plc.now_s(), left_s));
            }
            rig.sleep(0.05).await;
        }
        let end_s = rig.plc.now_s();
        assert!(told.len() > 20, "{}", told.len());
        for (at_s, left_s) in told {
            assert!((end_s - at_s - left_s).abs() < 0.15, "{left_s} {}", end_s - at_s);
        }
        let took_s = rig.trace().len() as f64 * 0.001;
        assert!(
            (planned.cycle_time_s - took_s).abs() < 0.06,
            "{} {took_s}",
            planned.cycle_time_s
        );
    });
}

#[test]
fn what_moves_by_hand_has_no_plan_of_a_run() {
    on_machine("", |rig| async move {
        rig.load("G90 G01 X50 F6000\nM30\n").await;
        let before = rehearsal(&rig).await;
        let cs = rig.plc.coordinate_system(1);
        let mdi = tokio::spawn(async move { cs.mdi("G91 G01 X20 F1200").await });
        rig.sleep(0.3).await;
        let during = rehearsal(&rig).await;
        assert_eq!((during.run_id, during.run), (None, None));
        assert_eq!(during.plan, before.plan);
        mdi.await.unwrap().unwrap();
        assert_ne!(rehearsal(&rig).await.plan, before.plan);
    });
}

/// With blending of G64, single block changes corners and times, so it changes the plan.
#[test]
fn p1_plan_in_single_block_stops_at_each_corner_and_takes_its_time() {
    on_machine("", |rig| async move {
        // ramps of 200 ms at 100 mm/s: the chain cuts its corner
        rig.load("ta200 td200 ts0\nG64 G501 G90 G01 X50 F6000\nY50\nX100\nM30\n")
            .await;
        let chain = rehearsal(&rig).await;
        rig.cs.set_single_block(true).await.unwrap();
        let planned = rehearsal(&rig).await;
        assert_ne!(planned.plan, chain.plan);
        // each of the two joints overlaps two ramps of 200 ms in the chain
        let more_s = planned.cycle_time_s - chain.cycle_time_s;
        assert!((more_s - 0.4).abs() < 0.02, "{more_s}");
        let tag_of_path = async || {
            let path = typed::PlannedPath(50, PathQuery::default());
            rig.plc.port().ask(path).await.unwrap().tag
        };
        let tag = tag_of_path().await;
        rig.trace();
        rig.cs.start().await.unwrap();
        let of_run = rehearsal(&rig).await;
        assert_eq!(of_run.run_id, rig.cs.state().await.unwrap().run_id);
        assert_eq!(of_run.plan, planned.plan);
        while rig.interrupted_or_completed().await {
            rig.cs.resume().await.unwrap();
        }
        let trace = rig.trace();
        let corner = |[x, y, _]: &[f64; 3]| f64::hypot(x - 50.0, *y) < 1e-9;
        assert!(trace.iter().any(corner), "the run stops at the corner");
        let moving = trace.windows(2).filter(|pair| pair[0] != pair[1]).count();
        let took_s = moving as f64 * 0.001;
        assert!(
            (planned.cycle_time_s - took_s).abs() < 0.06,
            "{} {took_s}",
            planned.cycle_time_s
        );
        rig.cs.set_single_block(false).await.unwrap();
        assert_ne!(tag_of_path().await, tag);
    });
}

#[test]
fn p1_rehearsal_reports_that_single_block_refuses_compensation() {
    let text = "G90 G01 F6000 G41 X20\nX40\nG40 X60\nM30\n";
    on_machine(TOOLS, move |rig| async move {
        rig.cs.select_tool(1).await.unwrap();
        rig.load(text).await;
        assert_eq!(rehearsal(&rig).await.outcome, RehearsalOutcome::Completed);
        rig.cs.set_single_block(true).await.unwrap();
        let planned = rehearsal(&rig).await;
        assert_eq!(planned.outcome, RehearsalOutcome::Alarm);
        assert!(planned.text.contains("single block"), "{}", planned.text);
        rig.cs.start().await.unwrap();
        while rig.interrupted_or_completed().await {
            rig.cs.resume().await.unwrap();
        }
        assert_eq!(rig.state().await, (Execution::Stopped, Some(Reason::Alarm)));
    });
}

async fn left(rig: &Rig) -> Option<f64> {
    rehearsal(rig).await.run.unwrap().left_s
}

#[test]
fn the_time_left_is_null_while_an_override_of_0_stops_what_is_left() {
    on_machine("", |rig| async move {
        let set = async |feed: f64, rapid: f64| {
            let change = OverrideChange {
                feed: Some(feed),
                rapid: Some(rapid),
                spindle: None,
            };
            rig.cs.set_overrides(change).await.unwrap();
        };
        rig.start("G90 G01 X50 F3000\nG00 X0\nG04 P5000\nM30\n").await;
        rig.sleep(0.2).await;
        assert!(left(&rig).await.is_some());
        for (feed, rapid) in [(0.0, 100.0), (100.0, 0.0), (0.0, 0.0)] {
            set(feed, rapid).await;
            rig.sleep(0.5).await;
            assert_eq!(left(&rig).await, None, "{feed} {rapid}");
        }
        set(100.0, 100.0).await;
        rig.sleep(3.0).await;
        // only the dwell is left
        set(0.0, 0.0).await;
        assert!(left(&rig).await.is_some_and(|left_s| left_s < 5.0));
    });
}

#[test]
fn time_left_is_null_in_a_wait_without_a_known_end_and_stands_in_a_hold() {
    on_machine("[m_code.80]\nunhandled = \"wait\"\n", |rig| async move {
        rig.start("G01 X20 F1200\nM80\nM00\nX0\nM30\n").await;
        rig.sleep(0.3).await;
        rig.cs.hold().await.unwrap();
        let held = left(&rig).await;
        assert!(held.is_some());
        rig.sleep(9.0).await;
        assert_eq!(left(&rig).await, held);
        rig.cs.resume().await.unwrap();
        rig.until(Execution::Wait).await;
        assert_eq!(left(&rig).await, None, "nothing is known of M80");
        let mut outputs = rig.plc.outputs().on(80);
        outputs.next().await.unwrap().reset().await.unwrap();
        rig.until(Execution::ProgramStopped).await;
        assert_eq!(left(&rig).await, None, "M00");
        rig.cs.resume().await.unwrap();
        rig.sleep(0.1).await;
        assert!(left(&rig).await.is_some_and(|left_s| left_s < 1.1));
    });
}

#[test]
fn an_override_of_0_is_the_reason_for_which_a_motion_stands() {
    on_machine("", |rig| async move {
        let set = async |feed: f64, rapid: f64| {
            let change = OverrideChange {
                feed: Some(feed),
                rapid: Some(rapid),
                spindle: None,
            };
            rig.cs.set_overrides(change).await.unwrap();
        };
        let zero = (Execution::Active, Some(Reason::OverrideZero));
        rig.start("G90 G01 X20 F3000\nG00 X0\nG04 P2000\nG01 X5\nM30\n")
            .await;
        rig.sleep(0.1).await;
        assert_eq!(rig.state().await, (Execution::Active, None));
        set(0.0, 100.0).await;
        assert_eq!(rig.state().await, zero, "feed");
        set(100.0, 0.0).await;
        assert_eq!(rig.state().await, (Execution::Active, None));
        rig.sleep(1.0).await;
        assert_eq!(rig.state().await, zero, "the rapid motion has begun");
        set(0.0, 100.0).await;
        assert_eq!(rig.state().await, (Execution::Active, None));
        rig.sleep(1.0).await;
        assert_eq!(rig.state().await, (Execution::Active, None), "a dwell goes on");
        rig.sleep(2.0).await;
        assert_eq!(rig.state().await, zero, "the next block at feedrate");
        rig.cs.hold().await.unwrap();
        assert_eq!(rig.state().await, (Execution::FeedHold, None));
        rig.cs.resume().await.unwrap();
        assert_eq!(rig.state().await, zero);
        set(100.0, 100.0).await;
        rig.until(Execution::ProgramCompleted).await;
    });
}

#[test]
fn p3_spindle_override_of_0_is_the_reason_for_which_m03_waits() {
    on_machine("", |rig| async move {
        let set = async |spindle: f64| {
            let change = OverrideChange {
                spindle: Some(spindle),
                ..OverrideChange::default()
            };
            rig.cs.set_overrides(change).await.unwrap();
        };
        set(0.0).await;
        rig.start("S1000 M03\nG04 P2000\nM30\n").await;
        rig.sleep(1.0).await;
        assert_eq!(rig.state().await, (Execution::Wait, Some(Reason::OverrideZero)));
        assert_eq!(left(&rig).await, None);
        set(100.0).await;
        assert_eq!(rig.state().await, (Execution::Wait, None));
        rig.until(Execution::ProgramCompleted).await;
    });
}

#[test]
fn a_rehearsal_of_a_run_that_is_too_long_to_plan_has_its_identity() {
    on_machine("", |rig| async move {
        rig.start("G00 X10\nwhile (1 > 0) {\nG04 P60000\n}\nM30\n").await;
        let planned = rehearsal(&rig).await;
        assert_eq!(planned.outcome, RehearsalOutcome::TooLong);
        assert_eq!(planned.run_id, rig.cs.state().await.unwrap().run_id);
    });
}
