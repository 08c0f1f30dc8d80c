//! Tests of the text of each event.

use std::time::SystemTime;

use plc_protocol::types::Timestamp;
use plc_protocol::types::data::JournalFilter;
use plc_protocol::types::machine::AlarmSeverity;
use plc_protocol::types::output::{Params, Timing};

use super::*;
use crate::program_store::EditKind;

fn output() -> OutputNotice {
    OutputNotice {
        id: "b1.1.7".to_owned(),
        seq: 7,
        run_id: "1-1".to_owned(),
        m: 100,
        params: Params {
            a: Some(3.0),
            h: Some(-0.5),
            ..Params::default()
        },
        timing: Timing::AfterMotion,
        program: 60,
        line: 4,
        attempt: 1,
        redelivered: false,
    }
}

fn reset(m: Option<u16>, outcome: ResetOutcome, force: bool) -> Event {
    Event::Reset {
        seq: 7,
        m,
        handler_id: "gripper".to_owned(),
        outcome,
        force,
    }
}

fn stop(m: Option<u16>, reason: Option<Reason>, at: Option<(u16, u32)>) -> Event {
    Event::Stop {
        m,
        reason,
        program: at.map(|(program, _)| program),
        line: at.map(|(_, line)| line),
    }
}

/// Returns each line of a run and its outputs: the event, and its text without `cs` and `t_s`.
fn of_outputs() -> Vec<(Event, &'static str)> {
    let question = Event::Question {
        seq: 7,
        text: "Is it clamped?".to_owned(),
        choices: vec!["yes".to_owned(), "no".to_owned()],
    };
    let answer = |client_id: Option<&str>| Event::Answer {
        seq: 7,
        choice: "yes".to_owned(),
        client_id: client_id.map(str::to_owned),
    };
    let fault = |code, text: Option<&str>| ResetOutcome::Fault {
        code,
        text: text.map(str::to_owned),
    };
    vec![
        (
            Event::Output(Box::new(output())),
            r#""attempt":1,"event":"output","id":"b1.1.7","line":4,"m":100,"params":{"A":3.0,"H":-0.5},"program":60,"redelivered":false,"run_id":"1-1","seq":7,"timing":"after_motion""#,
        ),
        (
            Event::Claim {
                seq: 7,
                handler_id: "gripper".to_owned(),
            },
            r#""event":"claim","handler_id":"gripper","seq":7"#,
        ),
        (
            reset(Some(100), ResetOutcome::Ok, false),
            r#""event":"reset","handler_id":"gripper","m":100,"result":"ok","seq":7"#,
        ),
        (
            reset(None, fault(Some(3), Some("jammed")), true),
            r#""code":3,"event":"reset","force":true,"handler_id":"gripper","m":null,"result":"fault","seq":7,"text":"jammed""#,
        ),
        (
            reset(Some(100), fault(None, None), false),
            r#""code":null,"event":"reset","handler_id":"gripper","m":100,"result":"fault","seq":7,"text":null"#,
        ),
        (
            question,
            r#""choices":["yes","no"],"event":"question","seq":7,"text":"Is it clamped?""#,
        ),
        (
            answer(Some("hmi-1")),
            r#""choice":"yes","client_id":"hmi-1","event":"answer","seq":7"#,
        ),
        (
            answer(None),
            r#""choice":"yes","client_id":null,"event":"answer","seq":7"#,
        ),
    ]
}

fn of_programs() -> Vec<(Event, &'static str)> {
    let edit = Edit {
        program: 60,
        what: EditKind::Replace,
        old: Some("a1".to_owned()),
        new: Some("b2".to_owned()),
    };
    let command = |verb, program: Option<u16>| Event::Command {
        verb,
        command_id: "c1".to_owned(),
        client_id: "hmi-1".to_owned(),
        program,
        program_hash: program.map(|_| "b2".to_owned()),
    };
    vec![
        (
            command(Verb::BackTrace, None),
            r#""client_id":"hmi-1","command_id":"c1","event":"command","verb":"back_trace""#,
        ),
        (
            command(Verb::Load, Some(60)),
            r#""client_id":"hmi-1","command_id":"c1","event":"command","program":60,"program_hash":"b2","verb":"load""#,
        ),
        (
            Event::Start {
                program: 60,
                run_id: "1-1".to_owned(),
                program_hash: Some("b2".to_owned()),
                from_line: None,
                parts: None,
                order: None,
            },
            r#""event":"start","program":60,"program_hash":"b2","run_id":"1-1""#,
        ),
        (
            Event::Program(edit),
            r#""event":"program","new_hash":"b2","old_hash":"a1","program":60,"what":"replace""#,
        ),
        (
            Event::Refused {
                request: "mdi".to_owned(),
                program: None,
                code: RefusalCode::NotSigned,
                text: "not signed".to_owned(),
                client_id: None,
            },
            r#""code":"not_signed","event":"refused","program":null,"request":"mdi","text":"not signed""#,
        ),
        (
            Event::Access {
                what: AccessKind::LoginRefused,
                user: Some("anna".to_owned()),
                from: None,
                over: ServerTransport::Rest,
                request: "POST /login".to_owned(),
                left_out: Some(3),
            },
            r#""event":"access","left_out":3,"over":"rest","request":"POST /login","user":"anna","what":"login_refused""#,
        ),
    ]
}

fn of_runs() -> Vec<(Event, &'static str)> {
    let captured = CapturedPositions {
        run_id: Some("1-1".to_owned()),
        line: 5,
        motors: vec![1, 3],
        positions: vec![10.0, -7.25],
        captured: vec![false, true],
    };
    let cut_short = |outcome, reason| {
        Event::End(RunEnd::CutShort {
            outcome,
            reason,
            program: None,
            line: None,
        })
    };
    let completed = RunEnd::Completed {
        outcome: Execution::ProgramCompleted,
    };
    vec![
        (
            Event::Block { program: 60, line: 2 },
            r#""event":"block","line":2,"program":60"#,
        ),
        (
            stop(Some(1), None, Some((60, 3))),
            r#""event":"stop","line":3,"m":1,"program":60"#,
        ),
        (
            stop(None, Some(Reason::SingleBlock), Some((60, 3))),
            r#""event":"stop","line":3,"program":60,"reason":"SINGLE_BLOCK""#,
        ),
        (stop(None, None, None), r#""event":"stop""#),
        (
            Event::Hold {
                reason: Reason::BusLost,
                m: Some(100),
                seq: Some(7),
            },
            r#""event":"hold","m":100,"reason":"BUS_LOST","seq":7"#,
        ),
        (Event::Resume, r#""event":"resume""#),
        (Event::BackTrace { on: true }, r#""event":"back_trace","on":true"#),
        (
            Event::Capture(Box::new(captured)),
            r#""captured":[false,true],"event":"capture","line":5,"motors":[1,3],"positions":[10.0,-7.25],"run_id":"1-1""#,
        ),
        (
            Event::End(completed),
            r#""event":"end","outcome":"PROGRAM_COMPLETED""#,
        ),
        (
            cut_short(Execution::Ready, None),
            r#""event":"end","outcome":"READY","reason":null"#,
        ),
        (
            cut_short(Execution::Stopped, Some(Reason::Alarm)),
            r#""event":"end","outcome":"STOPPED","reason":"ALARM""#,
        ),
    ]
}

fn of_alarms() -> Vec<(Event, &'static str)> {
    let alarm = AlarmRecord {
        id: 2,
        severity: AlarmSeverity::Alarm,
        number: 10_003,
        text: "jammed".to_owned(),
        cs: Some(1),
        program: Some(60),
        line: Some(4),
        raised_at: Timestamp("2026-01-01T00:00:01.000000Z".to_owned()),
        ..AlarmRecord::default()
    };
    let warning = |at: Option<(u16, u32)>| Event::Warning {
        program: at.map(|(program, _)| program),
        line: at.map(|(_, line)| line),
        text: "slow".to_owned(),
    };
    vec![
        (
            warning(Some((60, 4))),
            r#""event":"warning","line":4,"program":60,"text":"slow""#,
        ),
        (
            warning(None),
            r#""event":"warning","line":null,"program":null,"text":"slow""#,
        ),
        (
            Event::Alarm(RaisedAlarm::OfThis(Box::new(alarm))),
            r#""acknowledged_by":null,"cleared_at":null,"event":"alarm","id":2,"line":4,"number":10003,"program":60,"raised_at":"2026-01-01T00:00:01.000000Z","severity":"alarm","text":"jammed""#,
        ),
        (
            Event::Alarm(RaisedAlarm::OfAll {
                number: 10_001,
                text: "air".to_owned(),
            }),
            r#""event":"alarm","number":10001,"text":"air""#,
        ),
    ]
}

fn of_the_machine() -> Vec<(Event, &'static str)> {
    let last_run = LastRun {
        boot_id: BootId("b0".to_owned()),
        run_id: "1-3".to_owned(),
        program: Some(60),
        running: None,
        line: 4,
        execution: Execution::Wait,
        outputs: Vec::new(),
        at: Timestamp("2026-01-01T00:00:01.000000Z".to_owned()),
    };
    let lease = |what, client_id: Option<&str>| Event::Lease {
        what,
        holder: "mes".to_owned(),
        fence: 9,
        client_id: client_id.map(str::to_owned),
    };
    vec![
        (
            Event::Boot {
                boot_id: BootId("b1".to_owned()),
                version: "0.2.0".to_owned(),
            },
            r#""boot_id":"b1","event":"boot","version":"0.2.0""#,
        ),
        (
            Event::Interrupted(Box::new(last_run)),
            r#""at":"2026-01-01T00:00:01.000000Z","boot_id":"b0","event":"interrupted","execution":"WAIT","line":4,"outputs":[],"program":60,"run_id":"1-3","running":null"#,
        ),
        (
            Event::Request {
                user: Some("hmi-1".to_owned()),
                from: Some([10, 0, 0, 7].into()),
                over: ServerTransport::Mqtt,
                request: "PUT /cs/1/tool".to_owned(),
                said: Some("{\"id\":4}".to_owned()),
                command_id: None,
            },
            r#""event":"request","from":"10.0.0.7","over":"mqtt","request":"PUT /cs/1/tool","said":"{\"id\":4}","user":"hmi-1""#,
        ),
        (
            Event::Inconsistency {
                text: "the state READY does not expect the event: resume the run".to_owned(),
            },
            r#""event":"inconsistency","text":"the state READY does not expect the event: resume the run""#,
        ),
        (
            Event::Bus { connected: false },
            r#""connected":false,"event":"bus""#,
        ),
        (
            lease(LeaseChange::Taken, Some("hmi-1")),
            r#""client_id":"hmi-1","event":"lease","fence":9,"holder":"mes","what":"taken""#,
        ),
        (
            lease(LeaseChange::Released, None),
            r#""client_id":null,"event":"lease","fence":9,"holder":"mes","what":"released""#,
        ),
        (
            lease(LeaseChange::Broken, None),
            r#""client_id":null,"event":"lease","fence":9,"holder":"mes","what":"broken""#,
        ),
        (
            lease(LeaseChange::Expired, None),
            r#""client_id":null,"event":"lease","fence":9,"holder":"mes","what":"expired""#,
        ),
    ]
}

#[test]
fn each_event_is_a_line_of_one_form_which_is_read_as_that_event() {
    for (event, expected) in [
        of_outputs(),
        of_programs(),
        of_runs(),
        of_alarms(),
        of_the_machine(),
    ]
    .concat()
    {
        let line = Line {
            t_s: 1.5,
            cs: 1,
            event,
        };
        let json = line.to_json();
        let text = json.to_string();
        let (before, t_s) = text.split_once(r#""t_s":1.5"#).expect("a time");
        let fields = format!("{before}{t_s}").replace(r#""cs":1,"#, "");
        let fields = fields.replace(",,", ",").replace(",}", "}");
        assert_eq!(fields, format!("{{{expected}}}"));
        assert_eq!(Line::from_json(&json), Some(line));
    }
}

#[test]
fn the_lines_that_are_written_are_those_that_a_filter_follows() {
    let claim = Event::Claim {
        seq: 7,
        handler_id: "gripper".to_owned(),
    };
    let end = Event::End(RunEnd::Completed {
        outcome: Execution::ProgramCompleted,
    });
    let events = [
        Event::Output(Box::new(output())),
        claim.clone(),
        reset(None, ResetOutcome::Ok, false),
        claim,
        end,
        Event::Resume,
    ];
    let lines = events.map(|event| {
        let line = Line {
            t_s: 1.5,
            cs: 1,
            event,
        };
        let mut json = line.to_json();
        json["boot_id"] = json!("b1");
        json
    });
    let found = |wanted: JournalFilter| {
        let mut filter = LineFilter::new(&wanted, SystemTime::UNIX_EPOCH).expect("no time is asked for");
        let found = lines.iter().map(|line| filter.takes(line));
        found.collect::<Vec<_>>()
    };
    let of_m_code = JournalFilter {
        m: Some(100),
        ..JournalFilter::default()
    };
    assert_eq!(found(of_m_code), [true, true, true, false, false, false]);
    let of_run = JournalFilter {
        run: Some("1-1".to_owned()),
        ..JournalFilter::default()
    };
    assert_eq!(found(of_run), [true, true, true, true, true, false]);
}
