//! The plan of a program matches its execution: its path, its times, the time left.

use plc_api::Execution;
use plc_protocol::types::planned::{ManualText, PathQuery, PlannedPath, Rehearsal, RehearsalOutcome};
use plc_protocol::types::request::typed;
use plc_protocol::types::request::{OverrideChange, RefusalCode, Request};

use super::rig::{Point, Rig, on_machine};

/// Arcs, compensation, a chain of blended blocks, look-ahead, an offset, a subprogram, a dwell, rapids.
const PART: &str = "G54 G90 G00 X0 Y0 Z5
G01 Z0 F600
G64 X20 F3000
G03 X30 Y10 R10
G01 Y20
G02 X20 Y30 I-10 J0 F2000
G04 P300
G500
G91
G01 X-3 Y1 F6000
X-3 Y-1
X-3 Y1
G90 G501
G61 G01 X0 Y0
M98 P1001
G00 Z20
M30
";

const SUBPROGRAM: &str = "G91 G01 X5 F1200\nG03 X4 Y4 J4\nG90\nM99\n";

/// Smallest error that a picture in single precision has, mm.
const ROUNDING_MM: f64 = 1e-4;

async fn write(rig: &Rig, number: u16, text: &str) {
    let write = Request::WriteProgram(number, text.to_owned());
    rig.plc.port().request(write).await.unwrap();
}

async fn path(rig: &Rig, query: PathQuery) -> PlannedPath {
    rig.plc.port().ask(typed::PlannedPath(50, query)).await.unwrap()
}

async fn rehearsal(rig: &Rig) -> Rehearsal {
    rig.plc.port().ask(typed::Rehearsal(50, Some(1))).await.unwrap()
}

/// A vertex as a client reads it: position, line with the flag of a rapid, time.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Vertex(Point, u32, f64);

/// Returns the lines of the finest level in the bytes, read as the page on the planned path describes.
fn read(bytes: &[u8]) -> Vec<Vertex> {
    let u16_at = |at: usize| usize::from(u16::from_le_bytes(bytes[at..at + 2].try_into().unwrap()));
    let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let f32_at = |at: usize| f64::from(f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()));
    assert_eq!((&bytes[..4], u16_at(4)), (&b"TPTH"[..], 1));
    let (table, chunks, levels) = (u16_at(6), u32_at(20), u32_at(24));
    let (finest, first, count) = (u32_at(44), u32_at(48), u32_at(52));
    let of = |chunk: usize, level: usize| u32_at(table + chunk * 48 + 32 + level * 4);
    let of_level = |level: usize| {
        (first..first + count)
            .map(|chunk| of(chunk, level))
            .sum::<usize>()
    };
    let coarser: usize = (finest + 1..levels).map(of_level).sum();
    let begin = table + chunks * 48 + coarser * 20;
    assert_eq!(bytes.len(), begin + of_level(finest) * 20);
    let vertex = |i: usize| {
        let at = begin + i * 20;
        let word = u32::from_le_bytes(bytes[at + 12..at + 16].try_into().unwrap());
        Vertex([0, 4, 8].map(|i| f32_at(at + i)), word, f32_at(at + 16))
    };
    (0..of_level(finest)).map(vertex).collect()
}

fn off(point: Point, from: Point, to: Point) -> f64 {
    let way: Point = std::array::from_fn(|i| to[i] - from[i]);
    let length: f64 = way.iter().map(|part| part * part).sum();
    let along: f64 = (0..3).map(|i| (point[i] - from[i]) * way[i]).sum();
    let along = if length > 0.0 {
        (along / length).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (0..3)
        .map(|i| (point[i] - from[i] - along * way[i]).powi(2))
        .sum::<f64>()
        .sqrt()
}

#[test]
fn a_planned_path_passes_every_setpoint_of_the_run_at_its_time() {
    on_machine("", |rig| async move {
        write(&rig, 1001, SUBPROGRAM).await;
        rig.load(PART).await;
        let vertices = read(&path(&rig, PathQuery::default()).await.bytes);
        let planned = rehearsal(&rig).await;
        assert_eq!(
            (planned.outcome, planned.text.as_str()),
            (RehearsalOutcome::Completed, "")
        );
        rig.trace();
        rig.cs.start().await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
        let trace = rig.trace();
        let mut last = 0;
        for (i, at) in trace.iter().enumerate() {
            let time_s = (i + 1) as f64 * 0.001;
            // within the time tolerance of the picture
            let near = vertices
                .windows(2)
                .filter(|ends| ends[0].2 - 0.03 <= time_s && ends[1].2 + 0.03 >= time_s);
            let nearest = near
                .map(|ends| off(*at, ends[0].0, ends[1].0))
                .fold(f64::INFINITY, f64::min);
            assert!(nearest <= 0.01 + ROUNDING_MM, "{at:?} at {time_s} s: {nearest}");
            last = i;
        }
        assert!(last > 1000);
        let run_s = trace.len() as f64 * 0.001;
        assert!(
            (planned.cycle_time_s - run_s).abs() < 0.003,
            "{} {run_s}",
            planned.cycle_time_s
        );
        let feed = vertices.iter().filter(|vertex| vertex.1 >> 31 == 0).count();
        assert!(feed > 20 && feed < vertices.len());
        assert!(
            vertices.iter().any(|vertex| vertex.1 >> 26 & 31 == 1),
            "lines of the subprogram"
        );
    });
}

#[test]
fn coarser_levels_have_fewer_lines_and_stay_within_their_tolerance() {
    on_machine("", |rig| async move {
        write(&rig, 1001, SUBPROGRAM).await;
        rig.load(PART).await;
        let fine = read(&path(&rig, PathQuery::default()).await.bytes);
        let query = PathQuery {
            tolerance: Some(0.64),
            ..PathQuery::default()
        };
        let coarse = read(&path(&rig, query).await.bytes);
        assert!(2 * coarse.len() < fine.len(), "{} {}", coarse.len(), fine.len());
        for Vertex(at, ..) in fine {
            let nearest = coarse.windows(2).map(|ends| off(at, ends[0].0, ends[1].0));
            assert!(nearest.fold(f64::INFINITY, f64::min) <= 0.64);
        }
    });
}

#[test]
fn plan_changes_only_with_an_offset_a_skip_number_or_the_text() {
    on_machine("", |rig| async move {
        rig.load("G54 G00 X1\n/1 G00 X5\nM30\n").await;
        let tag = async || path(&rig, PathQuery::default()).await.tag;
        let first = tag().await;
        assert_eq!(first, tag().await);
        rig.cs.set_optional_skip(1, true).await.unwrap();
        let skipped = tag().await;
        assert_ne!(first, skipped);
        rig.cs.set_optional_skip(1, false).await.unwrap();
        assert_eq!(first, tag().await);
        let offsets = serde_json::json!({"work_offsets": {"G54": {"X": 12.5}}});
        let change = serde_json::from_value(offsets).unwrap();
        rig.plc
            .port()
            .ask(typed::WriteWorkOffsets(1, change))
            .await
            .unwrap();
        assert_ne!(first, tag().await);
        let x = rehearsal(&rig).await.axes["X"].highest;
        assert!((x - 17.5).abs() < 1e-9, "{x}");
        let hash = first.split('-').next().unwrap().to_owned();
        write(&rig, 50, "G00 X2\nM30\n").await;
        assert!(!tag().await.starts_with(&hash));
    });
}

#[test]
fn plan_names_the_line_from_which_it_depends_on_run_time_events() {
    on_machine("[m_code.12]\nunhandled = \"auto_reset\"\n", |rig| async move {
        for (text, line, why) in [
            ("G00 X5\nG31 X20\nG00 X0\nM30\n", Some(2), "skip input"),
            (
                "P1 = 3\nG00 X[P1]\nM12\nG00 X5\nG00 X[P1]\nM30\n",
                Some(5),
                "variable",
            ),
            ("G00 X5\nM12\nG43 Z1\nM30\n", Some(3), "tool"),
            ("P1 = 3\nG00 X[P1]\nM12\nG00 X1\nM30\n", None, ""),
        ] {
            rig.load(text).await;
            let depends = rehearsal(&rig).await.depends;
            assert_eq!(depends.as_ref().map(|depends| depends.line), line, "{text}");
            assert!(depends.is_none_or(|depends| depends.why.contains(why)), "{text}");
        }
    });
}

#[test]
fn rehearsal_reports_the_alarm_of_the_run_and_refuses_faulty_programs() {
    on_machine("", |rig| async move {
        rig.load("G90 G00 X10\nP1 = 900\nG00 X[P1]\nM30\n").await;
        let planned = rehearsal(&rig).await;
        assert_eq!(planned.outcome, RehearsalOutcome::Alarm);
        assert_eq!(planned.at.map(|at| (at.program, at.line)), Some((50, 3)));
        assert!(planned.text.contains("limit"), "{}", planned.text);
        write(&rig, 50, "G77 X\n").await;
        let refusal = rig.plc.port().ask(typed::Rehearsal(50, None)).await.unwrap_err();
        assert!(refusal.to_string().contains("errors"), "{refusal}");
        let no_program = rig.plc.port().request(Request::Rehearsal(51, None)).await;
        assert_eq!(no_program.unwrap_err().code, RefusalCode::NotFound);
        let no_system = rig.plc.port().request(Request::Rehearsal(50, Some(9))).await;
        assert_eq!(no_system.unwrap_err().code, RefusalCode::NotFound);
    });
}

#[test]
fn a_program_without_end_is_planned_up_to_a_limit() {
    on_machine("", |rig| async move {
        rig.load("P1 = 0\nG00 X10\nwhile (P1 < 1) {\nG04 P60000\n}\nM30\n")
            .await;
        let planned = rehearsal(&rig).await;
        assert_eq!(planned.outcome, RehearsalOutcome::TooLong);
        assert!(planned.cycle_time_s > 6.0 * 86_400.0, "{}", planned.cycle_time_s);
        assert!(
            planned.lines.len() <= 2048 && planned.text.contains("may be endless"),
            "{}",
            planned.text
        );
        assert!(read(&path(&rig, PathQuery::default()).await.bytes).len() < 20);
    });
}

/// Runs during the whole program, line by line.
async fn time_left_is_right(rig: &Rig, changes: &[(f64, OverrideChange)]) {
    rig.load(PART).await;
    rehearsal(rig).await;
    rig.trace();
    rig.cs.start().await.unwrap();
    for (wait_s, change) in changes {
        rig.sleep(*wait_s).await;
        rig.cs.set_overrides(*change).await.unwrap();
    }
    rig.sleep(0.2).await;
    let mut said = Vec::new();
    while rig.state().await.0 != Execution::ProgramCompleted {
        if let Some(left_s) = rehearsal(rig).await.run.and_then(|run| run.left_s) {
            said.push((rig.plc.now_s(), left_s));
        }
        rig.sleep(0.05).await;
    }
    let end_s = said.last().unwrap().0;
    let begin_s = said[0].0;
    assert!(said.len() > 10);
    for (at_s, left_s) in said {
        let off_s = (end_s + 0.03 - at_s - left_s).abs();
        assert!(
            off_s <= 0.06 + 0.02 * (end_s - begin_s),
            "{left_s} s left {} s before the end",
            end_s - at_s
        );
    }
}

#[test]
fn what_an_m_code_takes_counts_in_the_plan_and_in_the_time_left() {
    let more = "[m_code.6]\nstock = \"select_tool\"\nsimulated_ms = 2500\n[[tool]]\nid = 1\nradius = 2.0\nlength = 8.0\n";
    on_machine(more, |rig| async move {
        rig.load("G90 G00 X30\nM06 VA1\nG01 X10 F1200\nM30\n").await;
        let planned = rehearsal(&rig).await;
        let codes: Vec<_> = planned
            .m_codes
            .iter()
            .map(|code| (code.m, code.line, code.wait_s))
            .collect();
        assert_eq!(codes, [(6, 2, Some(2.5))]);
        assert!((planned.wait_s - 2.5).abs() < 0.002, "{}", planned.wait_s);
        rig.cs.start().await.unwrap();
        rig.until(Execution::Wait).await;
        let begin_s = rig.plc.now_s();
        rig.sleep(1.5).await;
        let left_s = rehearsal(&rig).await.run.unwrap().left_s.unwrap();
        let at_s = rig.plc.now_s();
        rig.until(Execution::ProgramCompleted).await;
        let end_s = rig.plc.now_s();
        let off_s = (end_s - at_s - left_s).abs();
        assert!(
            off_s < 0.02 * (end_s - begin_s),
            "{left_s} s left {} s before the end",
            end_s - at_s
        );
    });
}

#[test]
fn the_time_left_is_right_with_overrides_and_after_a_hold() {
    on_machine("", |rig| async move {
        write(&rig, 1001, SUBPROGRAM).await;
        let feed = |percent| OverrideChange {
            feed: Some(percent),
            ..OverrideChange::default()
        };
        time_left_is_right(&rig, &[]).await;
        time_left_is_right(&rig, &[(0.1, feed(40.0))]).await;
        let rapid = OverrideChange {
            feed: Some(70.0),
            rapid: Some(25.0),
            spindle: None,
        };
        time_left_is_right(&rig, &[(0.1, rapid)]).await;
        rig.cs.set_overrides(feed(100.0)).await.unwrap();
        rig.load(PART).await;
        rehearsal(&rig).await;
        rig.cs.start().await.unwrap();
        rig.sleep(0.8).await;
        rig.cs.hold().await.unwrap();
        rig.sleep(0.5).await;
        let held = rehearsal(&rig).await.run.unwrap();
        rig.sleep(20.0).await;
        assert_eq!(
            rehearsal(&rig).await.run,
            Some(held),
            "a hold takes nothing of the time left"
        );
    });
}

#[test]
fn manual_text_is_planned_with_subprograms_without_motion() {
    on_machine("", |rig| async move {
        write(&rig, 1001, SUBPROGRAM).await;
        let text = |text: &str| ManualText {
            text: text.to_owned(),
        };
        let port = rig.plc.port();
        let before = rig.cs.state().await.unwrap();
        let way = text("G91 G01 X10 F600\nM98 P1001");
        let planned = port.ask(typed::ManualRehearsal(1, way.clone())).await.unwrap();
        assert_eq!(
            (planned.outcome, planned.text.as_str()),
            (RehearsalOutcome::Completed, "")
        );
        // 10 mm, then 5 mm and a quarter of a circle of 4 mm
        let x = &planned.axes["X"];
        assert_eq!((x.lowest, x.highest), (0.0, 19.0));
        let vertices = read(&port.ask(typed::ManualPath(1, way)).await.unwrap().bytes);
        let last = vertices.last().unwrap().0;
        assert!(
            off(last, [19.0, 4.0, 0.0], [19.0, 4.0, 0.0]) <= 0.01 + ROUNDING_MM,
            "{last:?}"
        );
        let beyond = port
            .ask(typed::ManualRehearsal(1, text("G91 G01 X5000 F600")))
            .await
            .unwrap();
        assert_eq!(beyond.outcome, RehearsalOutcome::Alarm);
        assert!(!beyond.text.is_empty());
        let refused = port.ask(typed::ManualRehearsal(1, text("G01 X1 X2"))).await;
        assert_eq!(refused.unwrap_err().code, RefusalCode::ProgramHasErrors);
        assert_eq!(rig.cs.position().await.unwrap().machine["X"], 0.0);
        let state = rig.cs.state().await.unwrap();
        assert_eq!((state.execution, state.run_kind), (before.execution, None));
    });
}

#[test]
fn a_text_is_checked_as_a_program_and_not_stored() {
    on_machine("", |rig| async move {
        let check = |number: u16, dialect: Option<&str>, text: &str| {
            typed::CheckText(number, dialect.map(str::to_owned), text.to_owned())
        };
        let port = rig.plc.port();
        let found = port.ask(check(77, None, "G01 X1 X2 F500\nM30\n")).await.unwrap();
        let places: Vec<_> = found
            .diagnostics
            .iter()
            .map(|found| (found.line, found.column))
            .collect();
        assert_eq!(places, [(1, 8)]);
        let clean = port.ask(check(77, Some("nj"), "G90\nM30\n")).await.unwrap();
        assert_eq!(clean.diagnostics, []);
        let refused = port.ask(check(77, Some("none"), "M30\n")).await;
        assert_eq!(refused.unwrap_err().code, RefusalCode::Invalid);
        let programs = port.ask(typed::Programs).await.unwrap();
        assert!(programs.iter().all(|program| program.number != 77));
    });
}
