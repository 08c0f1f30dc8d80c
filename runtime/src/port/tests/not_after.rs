//! Tests of the age limits of requests. Ages are in real time, even if the clock of the machine is simulated.

use plc_protocol::types::data::{ToolChange, WorkOffsetTable};
use plc_protocol::types::not_after::NotAfter;
use plc_protocol::types::output::HandlerPresence;
use plc_protocol::wire::mqtt::{Inbound, decode};
use serde_json::{Value, json};

use super::*;

/// Returns an age limit of `within_ms` from now.
async fn from_now(port: &Arc<dyn Port>, within_ms: u64) -> NotAfter {
    let message = port.read(&Topic::Heartbeat).await.unwrap();
    let Payload::Heartbeat(heartbeat) = message.payload else {
        panic!("{message:?}");
    };
    NotAfter {
        boot_id: port.boot_id(),
        heartbeat: heartbeat.cycle,
        within_ms,
    }
}

/// Returns an age limit that has already passed.
async fn passed(port: &Arc<dyn Port>) -> NotAfter {
    let not_after = from_now(port, 1).await;
    std::thread::sleep(Duration::from_millis(3));
    not_after
}

/// Decodes a message with an age limit, and returns its request and the decoded limit.
fn read(path: &str, mut payload: Value, not_after: &NotAfter) -> (Request, Option<NotAfter>) {
    payload["not_after"] = json!(not_after);
    match decode(path, payload.to_string().as_bytes(), false) {
        Inbound::Ask { request, .. } => {
            let not_after = request.not_after().cloned();
            (request.into_request(), not_after)
        }
        other => panic!("{path}: {other:?}"),
    }
}

fn commanded(verb: &str, args: &Value) -> (String, Value) {
    let payload = json!({"command_id": format!("old-{verb}-{args}"), "client_id": "hmi", "args": args});
    (format!("cs/1/command/{verb}"), payload)
}

fn jog(more: &Value) -> Value {
    let mut args = json!({"axis": "X", "velocity": 100, "refresh_id": "a"});
    args.as_object_mut()
        .unwrap()
        .extend(more.as_object().unwrap().clone());
    args
}

#[test]
fn every_request_after_which_something_can_move_is_rejected_when_too_old() {
    let of_output = |more: Value| {
        let mut payload = json!({"boot_id": "b", "seq": 1});
        payload
            .as_object_mut()
            .unwrap()
            .extend(more.as_object().unwrap().clone());
        payload
    };
    let set = |path: &str, payload: Value| (path.to_owned(), payload);
    let variables = json!({
        "command_id": "v", "client_id": "hmi", "kind": "P", "from": 0, "values": [1.0],
    });
    let requests = [
        commanded("load", &json!({"program": 50})),
        commanded("start", &json!({})),
        commanded("start", &json!({"from_line": 1})),
        commanded("run", &json!({"program": 50})),
        commanded("resume", &json!({})),
        commanded("reset", &json!({})),
        commanded("mdi", &json!({"text": "G00 X1"})),
        commanded("jog", &jog(&json!({}))),
        commanded("jog", &jog(&json!({"distance": 1.0}))),
        commanded("home", &json!({})),
        commanded("back_trace", &json!({"on": true})),
        set("cs/1/input/interlock/set", json!({"value": false, "text": ""})),
        set("cs/1/input/start_lock/set", json!({"value": false, "text": ""})),
        set("cs/1/input/single_block/set", json!({"value": false})),
        set("cs/1/override/set", json!({"feed": 100})),
        set("cs/1/spindle/set", json!({"direction": "cw", "rpm": 100})),
        set("cs/1/tool/set", json!({"id": 3})),
        set("io/out/valve/set", json!({"value": true})),
        set("io/out/valve/force", json!({"value": true})),
        set("motor/1/skip_input/set", json!({"value": true})),
        set("cs/1/variable/set", variables),
        set(
            "cs/1/m_code/100/reset",
            of_output(json!({"handler_id": "hmi", "result": "ok"})),
        ),
        set("cs/1/m_code/100/redeliver", of_output(json!({"how": "redo"}))),
        set(
            "cs/1/m_code/100/answer",
            of_output(json!({"question_id": "q", "choice": "yes"})),
        ),
        set("stored_data/answer", json!({"decision": "accept"})),
    ];
    with_machine(async move |port| {
        let not_after = passed(&port).await;
        let before = port.read(&Topic::cs(1, CsTopic::State)).await.unwrap().rev;
        for (path, payload) in requests {
            let (request, limit) = read(&path, payload, &not_after);
            assert_eq!(limit.as_ref(), Some(&not_after), "{path}");
            let answer = port.request_not_after(&not_after, None, request).await;
            let refusal = answer.unwrap_err();
            assert_eq!(refusal.code, RefusalCode::Expired, "{path}: {}", refusal.text);
        }
        let after = port.read(&Topic::cs(1, CsTopic::State)).await.unwrap().rev;
        assert_eq!(before, after, "nothing has changed");
    });
}

#[test]
fn settings_and_acknowledgements_over_rest_are_rejected_when_too_old() {
    let tools = ToolChange {
        tools: Vec::new(),
        remove: vec![1],
    };
    let offsets = WorkOffsetTable {
        work_offsets: [("G54".to_owned(), [("X".to_owned(), 1.0)].into())].into(),
    };
    let acknowledged = typed::Command {
        command: Command::AlarmAcknowledge { id: 1 },
        ..start("acknowledged")
    };
    let requests = [
        Request::WriteTools(tools),
        Request::WriteWorkOffsets(1, offsets),
        acknowledged.into(),
    ];
    with_machine(async move |port| {
        let not_after = passed(&port).await;
        let before = port.ask(typed::WorkOffsets(1)).await.unwrap();
        for request in requests {
            let answer = port.request_not_after(&not_after, None, request.clone()).await;
            assert_eq!(answer.unwrap_err().code, RefusalCode::Expired, "{request:?}");
        }
        assert_eq!(
            port.ask(typed::WorkOffsets(1)).await.unwrap(),
            before,
            "nothing has changed"
        );
    });
}

#[test]
fn hold_stop_abort_and_the_end_of_a_jog_are_executed_however_old_they_are() {
    with_machine(async move |port| {
        let not_after = passed(&port).await;
        let end = json!({"refresh_id": "a", "end": true});
        for (verb, args) in [
            ("hold", json!({})),
            ("stop", json!({})),
            ("abort", json!({})),
            ("jog", end),
        ] {
            let (path, mut payload) = commanded(verb, &args);
            let (request, _) = read(&path, payload.clone(), &not_after);
            let answer = port.request_not_after(&not_after, None, request).await;
            assert!(answer.is_ok(), "{verb}: {answer:?}");
            if verb != "jog" {
                payload["not_after"] = json!("soon");
                let read = decode(&path, payload.to_string().as_bytes(), false);
                assert!(matches!(read, Inbound::Ask { .. }), "{verb}: {read:?}");
            }
        }
    });
}

#[test]
fn request_within_age_limit_is_executed_and_foreign_boot_is_expired() {
    with_machine(async move |port| {
        let not_after = from_now(&port, 60_000).await;
        let elsewhere = NotAfter {
            boot_id: BootId("another".into()),
            ..not_after.clone()
        };
        let refusal = port.request_not_after(&elsewhere, None, start("1").into()).await;
        assert_eq!(refusal.unwrap_err().code, RefusalCode::Expired);
        let started = port.request_not_after(&not_after, None, start("2").into()).await;
        assert!(matches!(started, Ok(Answer::Command(_))), "{started:?}");
        assert_eq!(execution(&port).await, Execution::Active);
        for within_ms in [0, 60_001] {
            let wrong = NotAfter {
                within_ms,
                ..not_after.clone()
            };
            let refusal = port.request_not_after(&wrong, None, start("3").into()).await;
            assert_eq!(refusal.unwrap_err().code, RefusalCode::Invalid);
        }
    });
}

#[test]
fn a_command_that_waits_longer_than_its_age_limit_does_not_take_effect() {
    with_machine(async move |port| {
        // a handler that never answers delays the load, and with it the start
        let silent = HandlerPresence {
            online: true,
            handles: vec![HandledCode { cs: 1, m: 60 }],
            validates: true,
            ..HandlerPresence::default()
        };
        port.ask(typed::Handler("silent".into(), silent)).await.unwrap();
        let text = "M60 VA1\nG04 X1000\nM30\n".to_owned();
        port.ask(typed::WriteProgram(60, text)).await.unwrap();
        let not_after = from_now(&port, 200).await;
        let real_wait = async {
            port.sleep(Duration::from_millis(500)).await;
            std::thread::sleep(Duration::from_millis(201));
        };
        let (load, started, ()) = futures_util::join!(
            port.ask(command(Command::Load { program: 60 }, "1", "hmi")),
            port.request_not_after(&not_after, None, start("2").into()),
            real_wait,
        );
        assert_eq!(status(&load), Some(CommandStatus::Done), "{load:?}");
        assert_eq!(started.unwrap_err().code, RefusalCode::Expired);
        assert_eq!(execution(&port).await, Execution::Ready);
    });
}

#[test]
fn start_expires_when_validation_exceeds_its_age_limit() {
    with_machine(async move |port| {
        let picky = HandlerPresence {
            online: true,
            handles: vec![HandledCode { cs: 1, m: 60 }],
            validates: true,
            ..HandlerPresence::default()
        };
        port.ask(typed::WriteProgram(60, "M60 VA1\nM30\n".into()))
            .await
            .unwrap();
        port.ask(command(Command::Load { program: 60 }, "1", "hmi"))
            .await
            .unwrap();
        port.ask(typed::Handler("picky".into(), picky)).await.unwrap();
        port.ask(typed::WriteProgram(60, "M60 VA2\nM30\n".into()))
            .await
            .unwrap();
        let topic = Topic::cs(1, CsTopic::Validate(60));
        let mut asked = port.subscribe(Filter::Topics(vec![topic]));
        let not_after = from_now(&port, 200).await;
        let (started, ()) = futures_util::join!(
            port.request_not_after(&not_after, None, start("2").into()),
            answer_validation(&port, &mut asked, true, async || {
                std::thread::sleep(Duration::from_millis(201));
            }),
        );
        assert_eq!(started.unwrap_err().code, RefusalCode::Expired);
        assert_eq!(execution(&port).await, Execution::Ready);
    });
}

#[test]
fn repeated_command_gets_its_stored_reply_after_its_age_limit() {
    with_machine(async move |port| {
        let not_after = from_now(&port, 300).await;
        let first = port.request_not_after(&not_after, None, start("1").into()).await;
        assert!(first.is_ok(), "{first:?}");
        std::thread::sleep(Duration::from_millis(301));
        let again = port.request_not_after(&not_after, None, start("1").into()).await;
        assert!(matches!(again, Ok(Answer::Command(_))), "{again:?}");
    });
}

#[test]
fn repetition_that_waits_for_an_accepted_command_does_not_expire() {
    with_machine(async move |port| {
        let not_after = from_now(&port, 300).await;
        let text = "G01 X100 F1000".to_owned();
        let mdi = Command::Mdi {
            text,
            is_macro: false,
        };
        let move_x = |wait| typed::Command {
            wait,
            ..command(mdi.clone(), "mdi", "hmi")
        };
        let first = port
            .request_not_after(&not_after, None, move_x(false).into())
            .await;
        assert!(
            matches!(&first, Ok(Answer::Command(reply)) if reply.status == CommandStatus::Accepted),
            "{first:?}"
        );
        std::thread::sleep(Duration::from_millis(301));
        let done = port
            .request_not_after(&not_after, None, move_x(true).into())
            .await;
        assert!(
            matches!(&done, Ok(Answer::Command(reply)) if reply.status == CommandStatus::Done),
            "{done:?}"
        );
        let known = port.ask(typed::CommandStatus("mdi".into())).await;
        assert_eq!(status(&known), Some(CommandStatus::Done));
    });
}

#[test]
fn repetition_of_a_command_that_waits_for_its_turn_does_not_expire() {
    with_machine(async move |port| {
        // the load waits for a handler that never answers
        let silent = HandlerPresence {
            online: true,
            handles: vec![HandledCode { cs: 1, m: 60 }],
            validates: true,
            ..HandlerPresence::default()
        };
        port.ask(typed::Handler("silent".into(), silent)).await.unwrap();
        let text = "M60 VA1\nG04 X1000\nM30\n".to_owned();
        port.ask(typed::WriteProgram(60, text)).await.unwrap();
        let load = || command(Command::Load { program: 60 }, "1", "hmi");
        let not_after = passed(&port).await;
        let repeated = async {
            port.sleep(Duration::from_millis(500)).await;
            port.request_not_after(&not_after, None, load().into()).await
        };
        let (first, second) = futures_util::join!(port.ask(load()), repeated);
        assert_eq!(status(&first), Some(CommandStatus::Done), "{first:?}");
        assert!(
            matches!(&second, Ok(Answer::Command(reply)) if reply.status == CommandStatus::Done),
            "{second:?}"
        );
    });
}
