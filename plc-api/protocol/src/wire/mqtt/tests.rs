use crate::handshake::reset_of;
use crate::types::BootId;
use crate::types::command::Command;
use crate::types::data::VariableArea;
use crate::types::lease::{LeaseRelease, LeaseRequest, LeaseTake};
use crate::types::machine::AlarmRaise;
use crate::types::output::{
    Claim, HandlerPresence, ProgressReport, Redeliver, Redelivery, Reset, ResetResult,
};
use crate::types::request::{Input, OverrideChange, SpindleCommand};
use crate::types::state::{LockSet, SpindleDirection};

use super::super::find_row::parsed;
use super::*;

fn ask(path: &str, payload: &str) -> Request {
    match decode(path, payload.as_bytes(), false) {
        Inbound::Ask { request, .. } => request.into_request(),
        other => panic!("{path}: {other:?}"),
    }
}

#[test]
fn the_handshake_comes_in_with_the_m_number_of_its_topic() {
    let boot_id = BootId("b".into());
    assert_eq!(
        ask(
            "cs/2/m_code/100/claim",
            r#"{"boot_id":"b","seq":7,"handler_id":"h"}"#
        ),
        Request::Claim(
            2,
            Some(100),
            Claim {
                boot_id: boot_id.clone(),
                seq: 7,
                handler_id: "h".into(),
                instance: None,
            }
        )
    );
    assert_eq!(
        ask(
            "cs/1/m_code/0/reset",
            r#"{"boot_id":"b","seq":7,"handler_id":"h","result":"fault","code":3,"text":"jam"}"#
        ),
        Request::Reset(
            1,
            Some(0),
            Reset {
                boot_id: boot_id.clone(),
                seq: 7,
                handler_id: "h".into(),
                result: ResetResult::Fault,
                code: Some(3),
                text: Some("jam".into()),
                force: None,
                instance: None,
            }
        )
    );
    assert_eq!(
        ask(
            "cs/1/m_code/5/progress",
            r#"{"boot_id":"b","seq":7,"handler_id":"h","text":"turning"}"#
        ),
        Request::Progress(
            1,
            Some(5),
            ProgressReport {
                boot_id,
                seq: 7,
                handler_id: "h".into(),
                text: "turning".into(),
                percent: None,
                instance: None,
            }
        )
    );
}

#[test]
fn a_decision_about_an_output_comes_in_with_the_m_number_of_its_topic() {
    let boot_id = BootId("b".into());
    assert_eq!(
        ask(
            "cs/1/m_code/5/redeliver",
            r#"{"boot_id":"b","seq":7,"how":"verify"}"#
        ),
        Request::Redeliver(
            1,
            Some(5),
            Redeliver {
                boot_id,
                seq: 7,
                how: Redelivery::Verify
            }
        )
    );
}

#[test]
fn questions_answers_and_results_of_validation_come_in() {
    let ask_json =
        r#"{"boot_id":"b","seq":7,"handler_id":"h","question_id":"q","text":"Clean?","choices":["yes"]}"#;
    assert!(matches!(
        ask("cs/1/m_code/5/ask", ask_json),
        Request::Ask(1, Some(5), ask) if ask.text == "Clean?" && ask.choices == ["yes"]
    ));
    let answer_json = r#"{"boot_id":"b","seq":7,"question_id":"q","choice":"yes"}"#;
    assert!(matches!(
        ask("cs/1/m_code/5/answer", answer_json),
        Request::AnswerQuestion(1, Some(5), answer) if answer.choice == "yes" && answer.client_id.is_none()
    ));
    let result_json = r#"{"request_id":"1-4","handler_id":"h","ok":false,"text":"no such tool"}"#;
    assert!(matches!(
        ask("cs/1/m_code/5/validate_result", result_json),
        Request::ValidateResult(1, Some(5), result) if !result.ok && result.request_id == "1-4"
    ));
}

#[test]
fn what_is_asked_of_the_control_lease_comes_in_or_is_rejected_with_words() {
    let asked = |what: &str, payload: &str| match ask(&format!("cs/1/lease/{what}"), payload) {
        Request::Lease { cs: 1, request, .. } => request,
        other => panic!("{other:?}"),
    };
    let take = r#"{"command_id":"c","client_id":"h","holder":"mes","ttl_ms":5000,"fence":7}"#;
    let expected = LeaseTake {
        holder: Some("mes".into()),
        ttl_ms: Some(5000),
        fence: Some(7),
    };
    assert_eq!(asked("take", take), LeaseRequest::Take(expected));
    let release = r#"{"command_id":"c","client_id":"h","fence":7}"#;
    assert_eq!(
        asked("release", release),
        LeaseRequest::Release(LeaseRelease { fence: 7 })
    );
    let ids = r#"{"command_id":"c","client_id":"h"}"#;
    assert_eq!(asked("break", ids), LeaseRequest::Break);
    for (what, payload, retained, code) in [
        ("take", take, true, RefusalCode::Retained),
        ("release", ids, false, RefusalCode::Invalid),
        ("break", release, false, RefusalCode::Invalid),
        (
            "take",
            r#"{"command_id":"","client_id":"h"}"#,
            false,
            RefusalCode::Invalid,
        ),
        (
            "take",
            r#"{"command_id":"c","client_id":"h","ttl":1}"#,
            false,
            RefusalCode::Invalid,
        ),
    ] {
        let read = decode(&format!("cs/1/lease/{what}"), payload.as_bytes(), retained);
        assert!(
            matches!(&read, Inbound::Reject { refusal, .. } if refusal.code == code),
            "{what} {payload}: {read:?}"
        );
    }
}

#[test]
fn inputs_and_settings_come_in() {
    let input = |name: &str, payload: &str| ask(&format!("cs/1/{name}/set"), payload);
    let lock = LockSet::new(true, "door");
    assert_eq!(
        input("input/optional_skip", r#"{"set":{"3":true,"31":false}}"#),
        Request::Input(1, Input::OptionalSkip([(3, true), (31, false)].into()))
    );
    for (name, expected) in [
        ("optional_stop", Input::OptionalStop(true)),
        ("single_block", Input::SingleBlock(true)),
        ("dry_run", Input::DryRun(true)),
    ] {
        assert_eq!(
            input(&format!("input/{name}"), r#"{"value":true}"#),
            Request::Input(1, expected)
        );
    }
    let payload = r#"{"value":true,"text":"door"}"#;
    assert_eq!(
        input("input/interlock", payload),
        Request::Input(1, Input::Interlock(lock.clone()))
    );
    assert_eq!(
        input("input/start_lock", payload),
        Request::Input(1, Input::StartLock(lock))
    );
    let change = OverrideChange {
        feed: Some(50.0),
        ..OverrideChange::default()
    };
    assert_eq!(
        input("override", r#"{"feed":50}"#),
        Request::Input(1, Input::Override(change))
    );
    let command = SpindleCommand {
        direction: SpindleDirection::Cw,
        rpm: 900.0,
    };
    assert_eq!(
        input("spindle", r#"{"direction":"cw","rpm":900}"#),
        Request::Spindle(1, command)
    );
    assert_eq!(input("tool", r#"{"id":4}"#), Request::Tool(1, 4));
    let presence = HandlerPresence {
        online: false,
        handles: Vec::new(),
        validates: false,
        ..HandlerPresence::default()
    };
    assert_eq!(
        ask("handler/h1/presence", r#"{"online":false}"#),
        Request::Handler("h1".into(), presence)
    );
}

#[test]
fn hold_stop_and_abort_are_urgent_and_others_are_not() {
    for verb in ["load", "start", "hold", "resume", "stop", "reset", "abort"] {
        let args = if verb == "load" {
            json!({"program": 1})
        } else {
            json!({})
        };
        let payload = json!({"command_id": "c", "client_id": "hmi", "args": args}).to_string();
        match decode(&format!("cs/1/command/{verb}"), payload.as_bytes(), false) {
            Inbound::Ask { urgent, request } => {
                assert_eq!(urgent, ["hold", "stop", "abort"].contains(&verb), "{verb}");
                let Request::Command { meta, wait, .. } = request.request() else {
                    panic!("{verb}: {request:?}");
                };
                assert_eq!((meta.client_id.as_str(), *wait), ("hmi", false));
            }
            other => panic!("{verb}: {other:?}"),
        }
    }
}

#[test]
fn an_invalid_age_limit_prevents_no_end_of_a_jog() {
    let said = |args: &str| {
        let payload = format!(r#"{{"command_id":"j","client_id":"p","not_after":5,"args":{args}}}"#);
        decode("cs/1/command/jog", payload.as_bytes(), false)
    };
    let end = said(r#"{"refresh_id":"r","end":true}"#);
    assert!(matches!(end, Inbound::Ask { urgent: true, .. }), "{end:?}");
    for args in [
        r#"{"refresh_id":"r","axis":"X","velocity":1}"#,
        r#"{"refresh_id":"r","axis":"X","velocity":1,"end":false}"#,
    ] {
        assert!(matches!(said(args), Inbound::Reject { .. }), "{args}");
    }
}

#[test]
fn a_command_that_is_too_large_is_answered_when_its_sender_can_be_read() {
    let long = "x".repeat(100_000);
    for (payload, id) in [
        (
            json!({"command_id": long, "client_id": "hmi"}),
            &long[..COMMAND_ID_MAX],
        ),
        (
            json!({"command_id": "c", "client_id": "hmi", "args": {"text": long}}),
            "c",
        ),
        (
            json!({"command_id": 5, "client_id": "hmi", "args": {"text": long}}),
            "",
        ),
    ] {
        match decode("cs/1/command/mdi", payload.to_string().as_bytes(), false) {
            Inbound::Reject {
                cs: 1,
                client_id,
                command_id,
                refusal,
            } => {
                assert_eq!((client_id.as_str(), command_id.as_str()), ("hmi", id));
                assert_eq!(refusal.code, RefusalCode::Invalid);
            }
            other => panic!("{other:?}"),
        }
    }
    let nobody = json!({"command_id": "c", "client_id": long}).to_string();
    let read = decode("cs/1/command/mdi", nobody.as_bytes(), false);
    assert!(matches!(read, Inbound::Drop(_)), "{read:?}");
}

#[test]
fn a_malformed_command_is_answered_when_its_sender_can_be_read() {
    let code_of = |verb: &str, payload: &str, retained: bool| match decode(
        &format!("cs/1/command/{verb}"),
        payload.as_bytes(),
        retained,
    ) {
        Inbound::Reject {
            cs: 1,
            client_id,
            command_id,
            refusal,
        } => {
            assert_eq!((client_id.as_str(), command_id.as_str()), ("hmi", "c"));
            refusal.code
        }
        other => panic!("{other:?}"),
    };
    let good = r#"{"command_id":"c","client_id":"hmi"}"#;
    assert_eq!(code_of("load", good, false), RefusalCode::Invalid);
    assert_eq!(code_of("jump", good, false), RefusalCode::Invalid);
    assert_eq!(code_of("jog", good, false), RefusalCode::Invalid);
    assert_eq!(code_of("back_trace", good, false), RefusalCode::Invalid);
    assert_eq!(code_of("start", good, true), RefusalCode::Retained);
    let unknown_field = r#"{"command_id":"c","client_id":"hmi","expct":{}}"#;
    assert_eq!(code_of("start", unknown_field, false), RefusalCode::Invalid);
}

#[test]
fn variables_are_read_and_written_by_range_under_a_command_id() {
    let get = r#"{"command_id":"c","client_id":"hmi","kind":"Q","from":4000,"count":96}"#;
    let meta = Some(CommandMeta {
        command_id: "c".into(),
        client_id: "hmi".into(),
        ..CommandMeta::default()
    });
    assert_eq!(
        ask("cs/2/variable/get", get),
        Request::ReadVariables {
            area: VariableArea::CoordinateSystem(2),
            from: 4000,
            count: 96,
            meta: meta.clone()
        }
    );
    let set = r#"{"command_id":"c","client_id":"hmi","kind":"P","from":7,"values":[1,-0.5,"inf"]}"#;
    assert_eq!(
        ask("cs/2/variable/set", set),
        Request::WriteVariables {
            area: VariableArea::Global,
            from: 7,
            values: vec![1.0, -0.5, f64::INFINITY],
            meta
        }
    );
    let code_of = |path: &str, text: &str, retained| match decode(path, text.as_bytes(), retained) {
        Inbound::Reject { refusal, .. } => refusal.code,
        other => panic!("{other:?}"),
    };
    assert_eq!(code_of("cs/1/variable/set", set, true), RefusalCode::Retained);
    for (path, text) in [("cs/1/variable/get", set), ("cs/1/variable/set", get)] {
        assert_eq!(code_of(path, text, false), RefusalCode::Invalid, "{path}");
    }
    for wrong in [
        r#""kind":"P","from":7,"values":["12"]"#,
        r#""kind":"P","values":[1]"#,
        r#""from":7,"values":[1]"#,
    ] {
        let set = format!(r#"{{"command_id":"c","client_id":"hmi",{wrong}}}"#);
        assert_eq!(
            code_of("cs/1/variable/set", &set, false),
            RefusalCode::Invalid,
            "{wrong}"
        );
    }
}

#[test]
fn a_skip_input_names_its_motor() {
    let expected = Inbound::Ask {
        request: parsed(Request::SkipInput(3, true)).unwrap(),
        urgent: false,
    };
    assert_eq!(
        decode("motor/3/skip_input/set", br#"{"value":true}"#, false),
        expected
    );
}

#[test]
fn an_alarm_is_raised_for_one_coordinate_system_or_for_all() {
    for (payload, cs) in [
        (r#"{"cs":2,"code":20,"text":"low"}"#, Some(2)),
        (r#"{"cs":null,"code":20,"text":"low"}"#, None),
        (r#"{"code":20,"text":"low"}"#, None),
    ] {
        let text = "low".to_owned();
        let expected = Inbound::Ask {
            request: parsed(Request::RaiseAlarm(AlarmRaise { cs, code: 20, text })).unwrap(),
            urgent: true,
        };
        assert_eq!(
            decode("alarm/raise", payload.as_bytes(), false),
            expected,
            "{payload}"
        );
        assert!(matches!(
            decode("alarm/raise", payload.as_bytes(), true),
            Inbound::Drop(_)
        ));
    }
}

#[test]
fn what_names_nobody_or_is_retained_is_dropped_with_a_reason() {
    let large = format!("{{\"text\":\"{}\"}}", "x".repeat(PAYLOAD_MAX));
    for (path, payload, retained) in [
        ("cs/1/command/start", "not json", false),
        (
            "cs/1/command/start",
            r#"{"client_id":"a/b","command_id":"c"}"#,
            false,
        ),
        ("cs/1/input/dry_run/set", r#"{"value":true}"#, true),
        ("cs/1/m_code/5/claim", "{}", false),
        ("cs/1/m_code/70000/claim", "{}", false),
        ("cs/x/command/start", "{}", false),
        (
            "cs/01/command/start",
            r#"{"client_id":"a","command_id":"c"}"#,
            false,
        ),
        ("cs/1/input/nothing/set", "{}", false),
        ("motor/1/skip_input/set", r#"{"value":true}"#, true),
        ("motor/x/skip_input/set", r#"{"value":true}"#, false),
        ("motor/1/skip_input/set", r#"{"value":1}"#, false),
        ("cs/1/command/start", large.as_str(), false),
        ("elsewhere", "{}", false),
    ] {
        match decode(path, payload.as_bytes(), retained) {
            Inbound::Drop(text) => assert!(text.contains("refused"), "{text}"),
            other => panic!("{path}: {other:?}"),
        }
    }
}

fn sent(request: Request) -> (String, Value, bool) {
    let outgoing = encode(request, "plc-1", |_, _| None).unwrap();
    (
        outgoing.path,
        serde_json::from_str(&outgoing.payload).unwrap(),
        outgoing.retain,
    )
}

#[test]
fn requests_have_the_topics_and_payloads_of_their_rows() {
    let reset = reset_of(&BootId("b".into()), 7, "h", None);
    let json = json!({"boot_id": "b", "seq": 7, "handler_id": "h", "result": "ok"});
    assert_eq!(
        sent(Request::Reset(2, Some(100), reset)),
        ("cs/2/m_code/100/reset".to_owned(), json, false)
    );
    let gone = HandlerPresence {
        online: false,
        handles: Vec::new(),
        validates: false,
        ..HandlerPresence::default()
    };
    let json = json!({"online": false, "handles": [], "validates": false});
    assert_eq!(
        sent(Request::Handler("h".into(), gone)),
        ("handler/h/presence".to_owned(), json, true)
    );
    let skip = Input::OptionalSkip([(3, true)].into());
    assert_eq!(
        sent(Request::Input(1, skip)),
        (
            "cs/1/input/optional_skip/set".to_owned(),
            json!({"set": {"3": true}}),
            false
        )
    );
    assert_eq!(
        sent(Request::Tool(1, 4)),
        ("cs/1/tool/set".to_owned(), json!({"id": 4}), false)
    );
    assert_eq!(
        sent(Request::SkipInput(3, true)),
        ("motor/3/skip_input/set".to_owned(), json!({"value": true}), false)
    );
    let raise = AlarmRaise {
        cs: None,
        code: 20,
        text: "low".into(),
    };
    let json = json!({"cs": null, "code": 20, "text": "low"});
    assert_eq!(
        sent(Request::RaiseAlarm(raise)),
        ("alarm/raise".to_owned(), json, false)
    );
}

#[test]
fn a_command_is_replied_to_the_connection_that_sends_it() {
    let meta = CommandMeta {
        command_id: "c1".into(),
        client_id: "other".into(),
        ..CommandMeta::default()
    };
    let command = Command::Load { program: 12 };
    let request = Request::Command {
        cs: 1,
        command,
        meta,
        wait: true,
    };
    let json = json!({"command_id": "c1", "client_id": "plc-1", "args": {"program": 12}});
    assert_eq!(sent(request), ("cs/1/command/load".to_owned(), json, false));
}

#[test]
fn variables_are_read_and_written_under_a_command_id_of_the_connection() {
    let meta = |id: &str| {
        Some(CommandMeta {
            command_id: id.into(),
            client_id: "other".into(),
            ..CommandMeta::default()
        })
    };
    let get = Request::ReadVariables {
        area: VariableArea::CoordinateSystem(2),
        from: 10,
        count: 3,
        meta: meta("v1"),
    };
    let json = json!({"command_id": "v1", "client_id": "plc-1", "kind": "Q", "from": 10, "count": 3});
    assert_eq!(sent(get), ("cs/2/variable/get".to_owned(), json, false));
    let set = Request::WriteVariables {
        area: VariableArea::Global,
        from: 0,
        values: vec![1.5, f64::INFINITY],
        meta: meta("v2"),
    };
    let json =
        json!({"command_id": "v2", "client_id": "plc-1", "kind": "P", "from": 0, "values": [1.5, "inf"]});
    assert_eq!(sent(set), ("cs/1/variable/set".to_owned(), json, false));
}

#[test]
fn what_mqtt_does_not_carry_is_refused() {
    let refusal = encode(Request::Programs, "c", |_, _| None).unwrap_err();
    assert_eq!(refusal.code, RefusalCode::NotSupported);
}
