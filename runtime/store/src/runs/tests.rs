use std::time::{Duration, UNIX_EPOCH};

use plc_protocol::types::execution::Execution;
use plc_protocol::types::machine::AlarmRecord;
use plc_protocol::types::output::{OutputNotice, Params};

use super::*;
use crate::journal::ResetOutcome;

fn at(s: f64) -> Now {
    Now {
        monotonic_s: s,
        time: UNIX_EPOCH + Duration::from_secs_f64(s),
    }
}

fn start(program: u16, run_id: &str, parts: Option<u32>) -> Event {
    Event::Start {
        program,
        run_id: run_id.to_owned(),
        program_hash: Some("h".to_owned()),
        from_line: None,
        parts,
        order: None,
    }
}

fn output(seq: u64, m: u16, timing: Timing) -> Event {
    Event::Output(Box::new(OutputNotice {
        id: String::new(),
        seq,
        run_id: String::new(),
        m,
        params: Params::default(),
        timing,
        program: 1,
        line: 1,
        attempt: 1,
        redelivered: false,
    }))
}

fn reset(seq: u64) -> Event {
    Event::Reset {
        seq,
        m: None,
        handler_id: "h".to_owned(),
        outcome: ResetOutcome::Ok,
        force: false,
    }
}

const COMPLETED: Event = Event::End(RunEnd::Completed {
    outcome: Execution::ProgramCompleted,
});

fn cut_short(reason: Option<Reason>) -> Event {
    Event::End(RunEnd::CutShort {
        outcome: Execution::Stopped,
        reason,
        program: Some(7),
        line: Some(12),
    })
}

fn how(book: &RunBook, id: &str) -> Option<RunEndedHow> {
    book.run(id, 0.0).unwrap().end.map(|end| end.how)
}

#[test]
fn a_run_tells_its_parts_its_times_and_for_which_m_codes_it_waited() {
    let mut book = RunBook::default();
    assert!(book.on(1, &start(7, "b-1-1", Some(2)), at(10.0)));
    book.on(1, &output(1, 6, Timing::AfterMotion), at(11.0));
    book.on(1, &output(2, 8, Timing::WithMotion), at(11.0));
    book.on(1, &reset(1), at(13.0));
    book.on(1, &reset(2), at(19.0));
    assert!(book.on(1, &COMPLETED, at(20.0)), "a part is done");
    let half = book.run("b-1-1", 21.0).unwrap();
    assert_eq!((half.parts, half.parts_done, half.end), (2, 1, None));
    assert_eq!((half.took_s, half.last_part_s), (11.0, Some(10.0)));
    assert_eq!(book.state(1).run.unwrap().parts_done, 1);
    book.on(1, &start(7, "b-1-1", Some(2)), at(22.0));
    book.on(1, &output(3, 6, Timing::AfterMotion), at(23.0));
    book.on(1, &reset(3), at(24.5));
    book.on(1, &COMPLETED, at(30.0));
    let whole = book.run("b-1-1", 99.0).unwrap();
    let end = whole.end.clone().unwrap();
    assert_eq!(end.how, RunEndedHow::Completed);
    assert_eq!(end.at, Timestamp("1970-01-01T00:00:30.000000Z".to_owned()));
    assert_eq!((whole.parts_done, whole.took_s), (2, 20.0));
    let wait = RunWait {
        m: 6,
        count: 2,
        total_s: 3.5,
        longest_s: 2.0,
    };
    assert_eq!(whole.waits, [wait], "M8 runs with the motion");
    let made = &book.production()[0];
    assert_eq!((made.cs, made.program, made.parts, made.cut_short), (1, 7, 2, 0));
    assert!((made.parts_s - 18.0).abs() < 1e-9);
}

#[test]
fn a_run_that_is_cut_short_tells_by_what() {
    for (reason, wanted) in [
        (Some(Reason::Stop), RunEndedHow::Stopped),
        (Some(Reason::Aborted), RunEndedHow::Aborted),
        (Some(Reason::Alarm), RunEndedHow::Alarm),
        (None, RunEndedHow::Reset),
    ] {
        let mut book = RunBook::default();
        book.on(1, &start(7, "b-1-1", Some(5)), at(0.0));
        let alarm = AlarmRecord {
            number: 101,
            text: "soft limit".to_owned(),
            line: Some(3),
            ..AlarmRecord::default()
        };
        book.on(1, &Event::Alarm(RaisedAlarm::OfThis(Box::new(alarm))), at(1.0));
        book.on(1, &cut_short(reason), at(2.0));
        let run = book.run("b-1-1", 9.0).unwrap();
        let end = run.end.unwrap();
        assert_eq!(end.how, wanted);
        assert_eq!(end.place, Some(PlannedLocation { program: 7, line: 12 }));
        assert_eq!((run.alarms[0].number, run.alarms[0].line), (101, Some(3)));
        assert_eq!((run.parts_done, run.took_s), (0, 2.0));
        assert_eq!(book.production()[0].cut_short, 1);
        assert!(book.open(1).is_none());
    }
}

#[test]
fn parts_that_do_not_begin_end_the_run_between_two_of_them() {
    let mut book = RunBook::default();
    book.on(1, &start(7, "b-1-1", Some(3)), at(0.0));
    book.on(1, &COMPLETED, at(5.0));
    let locked = Event::PartsWait {
        text: "the start lock is on: load a blank".to_owned(),
    };
    assert!(book.on(1, &locked, at(5.0)));
    let waiting = book.run("b-1-1", 60.0).unwrap();
    assert_eq!(
        waiting.waits_for.as_deref(),
        Some("the start lock is on: load a blank")
    );
    let ended = Event::PartsEnded {
        how: RunEndedHow::LeaseLost,
        text: "its lease has ended".to_owned(),
    };
    book.on(1, &ended, at(70.0));
    let run = book.run("b-1-1", 99.0).unwrap();
    assert_eq!((run.parts_done, run.took_s, run.waits_for), (1, 5.0, None));
    let end = run.end.unwrap();
    assert_eq!(
        (end.how, end.text.as_str()),
        (RunEndedHow::LeaseLost, "its lease has ended")
    );
    assert!(!book.on(1, &ended, at(71.0)), "there is none any more");
}

#[test]
fn runs_by_hand_are_none_and_coordinate_systems_are_apart() {
    let mut book = RunBook::default();
    assert!(!book.on(1, &start(0, "b-1-1", None), at(0.0)));
    assert!(!book.on(1, &COMPLETED, at(1.0)));
    book.on(1, &start(7, "b-1-2", None), at(2.0));
    book.on(2, &start(8, "b-2-1", None), at(2.0));
    book.on(2, &COMPLETED, at(3.0));
    assert_eq!(
        (how(&book, "b-1-2"), how(&book, "b-2-1")),
        (None, Some(RunEndedHow::Completed))
    );
    assert_eq!(book.run("b-1-1", 9.0), None);
    let query = |cs| RunQuery {
        cs,
        from: 0,
        count: 10,
    };
    assert_eq!(book.runs(query(Some(1))).runs, []);
    assert_eq!(book.runs(query(None)).runs[0].id, "b-2-1");
}

#[test]
fn what_is_kept_goes_on_and_a_run_that_was_open_was_ended_by_the_restart() {
    let mut book = RunBook::default();
    for n in 1..=3 {
        book.on(1, &start(7, &format!("a-1-{n}"), None), at(f64::from(n)));
        book.on(1, &COMPLETED, at(f64::from(n) + 0.5));
    }
    book.on(1, &start(7, "a-1-4", Some(9)), at(4.0));
    let kept = KeptRuns {
        ended: book.ended().cloned().collect(),
        open: vec![book.open(1).unwrap()],
        production: book.production(),
        lines: LinesIncluded::new(),
    };
    let mut later = RunBook::default();
    let place = PlannedLocation { program: 7, line: 3 };
    let place_of = |run: &Run| (run.id == "a-1-4").then_some(place);
    later.restore(kept, &[], place_of, UNIX_EPOCH + Duration::from_secs(100));
    let query = RunQuery {
        cs: None,
        from: 1,
        count: 2,
    };
    let ids: Vec<_> = later.runs(query).runs.into_iter().map(|run| run.id).collect();
    assert_eq!(ids, ["a-1-3", "a-1-2"]);
    let cut = later.state(1).run.unwrap();
    let end = cut.end.unwrap();
    assert_eq!((cut.id.as_str(), end.how), ("a-1-4", RunEndedHow::Restarted));
    assert_eq!(end.place, Some(place));
    let made = &later.production()[0];
    assert_eq!((made.parts, made.cut_short), (3, 1));
    assert!(later.open(1).is_none(), "nothing goes on by itself");
}

/// Returns a journal line of an earlier start; `n` is its number and its second.
fn line(n: u32, event: &Event) -> Value {
    let line = Line {
        t_s: f64::from(n),
        cs: 1,
        event: event.clone(),
    };
    let mut line = line.to_json();
    line["n"] = n.into();
    line["ts"] = format!("2026-01-01T00:00:{n:02}.000000Z").into();
    line
}

#[test]
fn parts_after_the_last_kept_state_are_counted_once_from_the_journal() {
    let parts = Some(9);
    let events = [
        start(7, "a-1-1", parts),
        COMPLETED,
        start(7, "a-1-1", parts),
        COMPLETED,
        start(7, "a-1-1", parts),
    ];
    let lines: Vec<Value> = (1..).zip(&events).map(|(n, event)| line(n, event)).collect();
    // for each line up to which the store is current, the counters after the restart equal the published ones
    for included in 0..=lines.len() {
        let mut book = RunBook::default();
        book.restore(KeptRuns::default(), &[], |_| None, UNIX_EPOCH);
        lines[..included].iter().for_each(|line| book.replay(line));
        let kept = KeptRuns {
            ended: book.ended().cloned().collect(),
            open: book.open(1).into_iter().collect(),
            production: book.production(),
            lines: book.lines().clone(),
        };
        let mut later = RunBook::default();
        later.restore(kept, &lines, |_| None, UNIX_EPOCH + Duration::from_secs(100));
        let run = later.state(1).run.unwrap();
        let produced = &later.production()[0];
        assert_eq!(
            (
                run.parts_done,
                produced.parts,
                produced.cut_short,
                produced.parts_s
            ),
            (2, 2, 1, 2.0),
            "{included} lines are kept"
        );
        assert_eq!(run.end.unwrap().how, RunEndedHow::Restarted);
        // the counters after a further restart are equal, too
        let again = KeptRuns {
            ended: later.ended().cloned().collect(),
            production: later.production(),
            lines: later.lines().clone(),
            ..KeptRuns::default()
        };
        let mut last = RunBook::default();
        last.restore(again, &lines, |_| None, UNIX_EPOCH);
        assert_eq!(last.production(), later.production());
    }
}

#[test]
fn the_oldest_runs_are_forgotten_and_none_of_the_newest() {
    let mut book = RunBook::default();
    for n in 0..RUNS_KEPT + 5 {
        book.on(1, &start(7, &n.to_string(), None), at(0.0));
        book.on(1, &COMPLETED, at(1.0));
    }
    assert_eq!(book.ended().count(), RUNS_KEPT);
    assert_eq!(book.run("4", 0.0), None);
    assert!(book.run("5", 0.0).is_some());
    assert_eq!(book.production()[0].parts, (RUNS_KEPT + 5) as u64);
}

/// Returns the start of a run that was ordered by user `mes`.
fn ordered(run_id: &str, id: &str, parts: u32) -> Event {
    match start(60, run_id, Some(parts)) {
        Event::Start {
            program,
            run_id,
            program_hash,
            from_line,
            parts,
            ..
        } => Event::Start {
            program,
            run_id,
            program_hash,
            from_line,
            parts,
            order: Some(key(id, parts.unwrap_or(1))),
        },
        other => other,
    }
}

fn key(id: &str, parts: u32) -> OrderKey {
    OrderKey {
        user: "mes".to_owned(),
        id: id.to_owned(),
        program: Some(60),
        parts,
    }
}

#[test]
fn the_key_of_an_order_leads_to_its_run_after_a_restart() {
    let mut book = RunBook::default();
    book.on(1, &ordered("b-1-1", "job-1", 1), at(0.0));
    book.on(1, &COMPLETED, at(1.0));
    book.on(1, &ordered("b-1-2", "job-2", 3), at(2.0));
    let kept = KeptRuns {
        ended: book.ended().cloned().collect(),
        open: book.open(1).into_iter().collect(),
        ..KeptRuns::default()
    };
    // in the form in which the store keeps runs
    let text = serde_json::to_string(&(&kept.ended, &kept.open)).unwrap();
    let (ended, open) = serde_json::from_str(&text).unwrap();
    let mut restarted = RunBook::default();
    let kept = KeptRuns {
        ended,
        open,
        ..KeptRuns::default()
    };
    restarted.restore(kept, &[], |_| None, UNIX_EPOCH);
    for (id, parts, run_id, how) in [
        ("job-1", 1, "b-1-1", RunEndedHow::Completed),
        ("job-2", 3, "b-1-2", RunEndedHow::Restarted),
    ] {
        let (run, order) = restarted.ordered(&key(id, parts)).unwrap();
        assert_eq!((run.id.as_str(), order), (run_id, &key(id, parts)));
        assert_eq!(run.end.as_ref().map(|end| end.how), Some(how));
    }
    let (_, order) = restarted.ordered(&key("job-1", 9)).unwrap();
    assert_ne!(*order, key("job-1", 9), "an order of other content");
    let other = OrderKey {
        user: "panel".to_owned(),
        ..key("job-1", 1)
    };
    assert!(restarted.ordered(&other).is_none());
}

#[test]
fn an_order_in_the_journal_alone_is_known_after_a_kill() {
    let start = line(1, &ordered("b-1-1", "job-1", 1));
    let end = line(2, &COMPLETED);
    for (lines, end) in [
        (vec![start.clone()], RunEndedHow::Restarted),
        (vec![start, end], RunEndedHow::Completed),
    ] {
        let mut restarted = RunBook::default();
        restarted.restore(KeptRuns::default(), &lines, |_| None, UNIX_EPOCH);
        let (run, order) = restarted.ordered(&key("job-1", 1)).unwrap();
        assert_eq!((run.id.as_str(), order), ("b-1-1", &key("job-1", 1)));
        assert_eq!(run.end.as_ref().map(|ended| ended.how), Some(end));
        assert_eq!(restarted.ended().count(), 1);
    }
}
