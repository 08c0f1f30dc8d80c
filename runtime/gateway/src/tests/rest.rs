//! Every route that answers.

use axum::body::Body;
use axum::http::{Request as HttpRequest, Response};
use http_body_util::BodyExt;
use plc_protocol::server::{Durations, ServoTiming};
use plc_protocol::types::command::{Command, CommandStatus, Expect};
use plc_protocol::types::machine::{ActiveAlarms, AlarmRecord};
use plc_protocol::types::output::{HandshakeResult, HandshakeStatus, Pending};
use plc_protocol::types::program::ProgramInfo;
use plc_protocol::types::request::{Input, OverrideChange};
use plc_protocol::types::state::{
    CapturedPositions, LockSet, Modal, Overrides, ProgramLocation, Spindle, Tool,
};
use serde_json::{Value, json};
use tower::ServiceExt;

use super::*;
use crate::http::router;

/// Calls a route; headers as `name: value`.
pub(super) async fn call(
    port: &Arc<StubPort>,
    method: &str,
    path: &str,
    headers: &[(&str, &str)],
    body: impl Into<Body>,
) -> Response<Body> {
    let mut request = HttpRequest::builder().method(method).uri(path);
    if !headers.iter().any(|(name, _)| *name == "host") {
        request = request.header("host", "127.0.0.1:8080");
    }
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    let app = router(shared(Arc::clone(port)), None);
    app.oneshot(request.body(body.into()).unwrap()).await.unwrap()
}

pub(super) async fn text(response: Response<Body>) -> String {
    let bytes = response.into_body().collect().await.unwrap().to_bytes();
    String::from_utf8(bytes.to_vec()).unwrap()
}

pub(super) async fn json_of(response: Response<Body>) -> Value {
    let text = text(response).await;
    serde_json::from_str(&text).unwrap_or_else(|error| panic!("{error}: {text}"))
}

pub(super) const JSON: (&str, &str) = ("content-type", "application/json");

async fn get(port: &Arc<StubPort>, path: &str) -> (u16, Value) {
    let response = call(port, "GET", path, &[], "").await;
    let status = response.status().as_u16();
    (status, json_of(response).await)
}

#[tokio::test]
async fn states_are_answered_as_their_messages_with_the_revision_as_etag() {
    let port = StubPort::new();
    for (topic, payload) in [
        (CsTopic::Position, Payload::Position(Position::default())),
        (CsTopic::Program, Payload::Program(ProgramLocation::default())),
        (CsTopic::Modal, Payload::Modal(Modal::default())),
        (CsTopic::Captured, Payload::Captured(CapturedPositions::default())),
        (CsTopic::Pending, Payload::Pending(Pending::default())),
        (CsTopic::Override, Payload::Override(Overrides::default())),
        (CsTopic::Spindle, Payload::Spindle(Spindle::default())),
        (CsTopic::Tool, Payload::Tool(Tool::default())),
    ] {
        port.say(Topic::cs(1, topic), Some(5), payload);
    }
    for name in [
        "position",
        "program",
        "modal",
        "captured",
        "m_codes",
        "overrides",
        "spindle",
        "tool",
    ] {
        let response = call(&port, "GET", &format!("/api/v1/cs/1/{name}"), &[], "").await;
        assert_eq!(response.status(), 200, "{name}");
        assert_eq!(response.headers()["etag"], "\"5\"", "{name}");
        let body = json_of(response).await;
        assert_eq!((&body["v"], &body["boot_id"]), (&json!(1), &json!("boot-1")));
    }
    let response = call(&port, "GET", "/api/v1/cs/1/state", &[], "").await;
    assert_eq!(response.headers()["etag"], "\"12\"");
    assert_eq!(response.headers()["cache-control"], "no-store");
    assert_eq!(json_of(response).await["execution"], "STOPPED");
}

#[tokio::test]
async fn the_machine_its_coordinate_systems_and_inputs_are_answered() {
    let port = StubPort::new();
    port.say_dry_run(4, true);
    assert_eq!(get(&port, "/api/v1/machine").await.1["machine"], "mill-1");
    let (_, list) = get(&port, "/api/v1/cs").await;
    let first = &list["coordinate_systems"][0];
    assert_eq!(
        (&first["number"], &first["state"]["execution"]),
        (&json!(1), &json!("STOPPED"))
    );
    let (_, inputs) = get(&port, "/api/v1/cs/1/inputs").await;
    assert_eq!(
        (&inputs["dry_run"]["value"], &inputs["dry_run"]["rev"]),
        (&json!(true), &json!(4))
    );
    assert_eq!(get(&port, "/api/v1/cs/1/inputs/dry_run").await.1["value"], true);
    assert_eq!(get(&port, "/api/v1/health").await, (200, json!({"status": "ok"})));
}

#[tokio::test]
async fn a_command_is_accepted_with_its_id_and_where_to_ask() {
    let port = StubPort::new();
    let headers = [JSON, ("idempotency-key", "k 1"), ("if-match", "\"12\"")];
    let response = call(&port, "POST", "/api/v1/cs/1/load", &headers, r#"{"program":7}"#).await;
    assert_eq!(response.status(), 202);
    assert_eq!(response.headers()["location"], "/api/v1/commands/k%201");
    assert_eq!(json_of(response).await, json!({"command_id": "k 1"}));
    let [
        Request::Command {
            cs,
            command,
            meta,
            wait,
        },
    ] = &port.asked()[..]
    else {
        panic!("{:?}", port.asked());
    };
    assert_eq!((*cs, command, *wait), (1, &Command::Load { program: 7 }, false));
    assert_eq!(
        (meta.command_id.as_str(), meta.client_id.as_str()),
        ("k 1", "rest")
    );
    let expect = Expect {
        state_rev: Some(12),
        ..Expect::default()
    };
    assert_eq!(meta.expect, Some(expect));
}

#[tokio::test]
async fn every_verb_has_its_route_and_each_command_an_id_of_its_own() {
    let port = StubPort::new();
    let app = router(shared(Arc::clone(&port)), None);
    let commands = [
        Command::Start,
        Command::Hold,
        Command::Resume,
        Command::Stop,
        Command::Reset,
        Command::Abort,
        Command::Mdi {
            text: "G00 X1\nY2".into(),
            is_macro: false,
        },
        Command::Home { axes: vec!['X'] },
        Command::Home { axes: Vec::new() },
        Command::BackTrace { on: true },
        Command::Jog {
            axis: 'X',
            velocity: -600.0,
            distance: Some(1.5),
            refresh_id: "panel-1".into(),
        },
        Command::JogEnd {
            refresh_id: "panel-1".into(),
        },
    ];
    for command in &commands {
        let verb = serde_json::to_value(command.verb()).unwrap();
        let request = HttpRequest::post(format!("/api/v1/cs/2/{}", verb.as_str().unwrap()))
            .header("host", "127.0.0.1:8080")
            .header("content-type", "application/json")
            .body(Body::from(command.args().to_string()))
            .unwrap();
        let response = app.clone().oneshot(request).await.unwrap();
        assert_eq!(response.status(), 202, "{verb}");
    }
    let mut ids = std::collections::BTreeSet::new();
    for (request, expected) in port.asked().iter().zip(&commands) {
        let Request::Command {
            cs: 2, command, meta, ..
        } = request
        else {
            panic!("{request:?}");
        };
        assert_eq!(command, expected);
        ids.insert(meta.command_id.clone());
    }
    assert_eq!(ids.len(), commands.len());
}

#[tokio::test]
async fn with_wait_a_command_answers_when_it_is_done() {
    let port = StubPort::new();
    let headers = [("idempotency-key", "c1")];
    let response = call(&port, "POST", "/api/v1/cs/1/start?wait=1", &headers, "").await;
    assert_eq!(response.status(), 200);
    let body = json_of(response).await;
    assert_eq!(
        (&body["command_id"], &body["status"]),
        (&json!("c1"), &json!("done"))
    );
    assert!(matches!(port.asked()[..], [Request::Command { wait: true, .. }]));
}

#[tokio::test(start_paused = true)]
async fn a_command_that_takes_longer_than_a_minute_answers_202_to_wait() {
    let port = StubPort::new();
    port.silent.store(true, std::sync::atomic::Ordering::Relaxed);
    let begun = tokio::time::Instant::now();
    let headers = [("idempotency-key", "c1")];
    let response = call(&port, "POST", "/api/v1/cs/1/start?wait=1", &headers, "").await;
    assert_eq!(begun.elapsed().as_secs(), 60);
    assert_eq!(
        (response.status().as_u16(), json_of(response).await),
        (202, json!({"command_id": "c1"}))
    );
}

#[tokio::test]
async fn a_command_that_failed_while_it_was_waited_for_is_a_problem() {
    let port = StubPort::with(|_| Ok(Answer::Command(reply("c", CommandStatus::Failed, "not_allowed"))));
    let response = call(&port, "POST", "/api/v1/cs/1/start?wait=1", &[], "").await;
    assert_eq!(response.status(), 409);
    assert_eq!(json_of(response).await["code"], "not_allowed");
}

#[tokio::test]
async fn commands_and_lists_are_answered() {
    let port = StubPort::with(|request| {
        Ok(match request {
            Request::CommandStatus(id) => Answer::Command(reply(id, CommandStatus::Done, "ok")),
            Request::Programs => Answer::Programs(vec![ProgramInfo {
                number: 7,
                title: "Flange".into(),
                bytes: 10,
                errors: 0,
                warnings: 1,
                hash: "a1".into(),
                signature: None,
                dialect: "nj".into(),
                o_number: None,
                folder: String::new(),
            }]),
            Request::Handlers => Answer::Handlers([].into()),
            Request::AlarmHistory => Answer::Alarms(vec![AlarmRecord::default()]),
            other => panic!("{other:?}"),
        })
    });
    assert_eq!(get(&port, "/api/v1/commands/k%201").await.1["command_id"], "k 1");
    assert_eq!(
        get(&port, "/api/v1/programs").await.1["programs"][0]["title"],
        "Flange"
    );
    assert_eq!(get(&port, "/api/v1/handlers").await.1, json!({"handlers": {}}));
    let (_, history) = get(&port, "/api/v1/alarms/history").await;
    assert_eq!(history["alarms"].as_array().unwrap().len(), 1);
}

#[tokio::test]
async fn inputs_overrides_spindle_and_tool_are_set() {
    let port = StubPort::new();
    let lock = LockSet::new(true, "door");
    let change = OverrideChange {
        feed: Some(80.0),
        ..OverrideChange::default()
    };
    let lock_body = r#"{"value":true,"text":"door"}"#;
    let cases = [
        (
            "inputs/optional_skip/3",
            r#"{"value":true}"#,
            Input::OptionalSkip([(3, true)].into()),
        ),
        (
            "inputs/optional_stop",
            r#"{"value":true}"#,
            Input::OptionalStop(true),
        ),
        (
            "inputs/single_block",
            r#"{"value":false}"#,
            Input::SingleBlock(false),
        ),
        ("inputs/dry_run", r#"{"value":true}"#, Input::DryRun(true)),
        ("inputs/interlock", lock_body, Input::Interlock(lock.clone())),
        ("inputs/start_lock", lock_body, Input::StartLock(lock)),
        ("overrides", r#"{"feed":80}"#, Input::Override(change)),
    ];
    for (path, body, expected) in cases {
        let response = call(&port, "PUT", &format!("/api/v1/cs/1/{path}"), &[JSON], body).await;
        assert_eq!(response.status(), 204, "{path}");
        assert_eq!(port.asked().pop(), Some(Request::Input(1, expected)), "{path}");
    }
    let response = call(&port, "PUT", "/api/v1/cs/1/tool", &[JSON], r#"{"id":4}"#).await;
    assert_eq!(
        (response.status().as_u16(), port.asked().pop()),
        (204, Some(Request::Tool(1, 4)))
    );
    let body = r#"{"value":true}"#;
    let response = call(&port, "PUT", "/api/v1/motors/3/skip_input", &[JSON], body).await;
    assert_eq!(
        (response.status().as_u16(), port.asked().pop()),
        (204, Some(Request::SkipInput(3, true)))
    );
    let body = r#"{"direction":"ccw","rpm":500}"#;
    let response = call(&port, "PUT", "/api/v1/cs/1/spindle", &[JSON], body).await;
    assert_eq!(response.status(), 204);
    assert!(
        matches!(port.asked().pop(), Some(Request::Spindle(1, command)) if (499.9..500.1).contains(&command.rpm))
    );
}

#[tokio::test]
async fn handshake_returns_200_if_accepted_or_duplicate_else_409_with_status() {
    for (status, expected) in [
        (HandshakeStatus::Accepted, (200, "accepted")),
        (HandshakeStatus::Duplicate, (200, "duplicate")),
        (HandshakeStatus::Stale, (409, "stale")),
        (HandshakeStatus::Unknown, (409, "unknown")),
        (HandshakeStatus::NotOwner, (409, "not_owner")),
    ] {
        let port = StubPort::with(move |_| Ok(Answer::Handshake(HandshakeResult::new(9, "h", status))));
        let bodies = [
            ("claim", r#"{"boot_id":"boot-1","handler_id":"h"}"#),
            (
                "reset",
                r#"{"boot_id":"boot-1","handler_id":"h","result":"ok","force":true}"#,
            ),
        ];
        for (what, body) in bodies {
            let path = format!("/api/v1/cs/1/m_codes/9/{what}");
            let response = call(&port, "POST", &path, &[JSON], body).await;
            let code = response.status().as_u16();
            let body = json_of(response).await;
            let word = if code == 200 {
                &body["status"]
            } else {
                &body["code"]
            };
            assert_eq!((code, word.as_str().unwrap()), expected, "{what}");
        }
        let asked = port.asked();
        assert!(matches!(&asked[0], Request::Claim(1, None, claim) if claim.seq == 9));
        assert!(matches!(&asked[1], Request::Reset(1, None, reset) if reset.force == Some(true)));
    }
}

#[tokio::test]
async fn progress_and_redelivery_are_taken() {
    let port = StubPort::new();
    let body = r#"{"boot_id":"boot-1","handler_id":"h","text":"turning","percent":40}"#;
    let response = call(&port, "POST", "/api/v1/cs/1/m_codes/9/progress", &[JSON], body).await;
    assert_eq!(response.status(), 204);
    let body = r#"{"boot_id":"boot-1","how":"redo"}"#;
    let response = call(&port, "POST", "/api/v1/cs/1/m_codes/9/redeliver", &[JSON], body).await;
    assert_eq!(response.status(), 204);
    let asked = port.asked();
    assert!(matches!(&asked[0], Request::Progress(1, None, report) if report.percent == Some(40.0)));
    assert!(matches!(&asked[1], Request::Redeliver(1, None, redeliver) if redeliver.seq == 9));
}

#[tokio::test]
async fn questions_are_asked_and_answered() {
    use plc_protocol::types::output::{HandshakeResult, HandshakeStatus};
    for (status, http) in [
        (HandshakeStatus::Accepted, 200),
        (HandshakeStatus::Duplicate, 200),
        (HandshakeStatus::Unknown, 409),
        (HandshakeStatus::Stale, 409),
    ] {
        let port = StubPort::with(move |_| {
            let handler_id = String::new();
            let seq = 9;
            Ok(Answer::Handshake(HandshakeResult::new(seq, handler_id, status)))
        });
        let body =
            r#"{"boot_id":"boot-1","handler_id":"h","question_id":"q","text":"Clean?","choices":["yes"]}"#;
        let response = call(&port, "POST", "/api/v1/cs/1/m_codes/9/ask", &[JSON], body).await;
        assert_eq!(response.status(), http);
        let body = r#"{"boot_id":"boot-1","question_id":"q","choice":"yes","client_id":"hmi"}"#;
        let response = call(&port, "POST", "/api/v1/cs/1/m_codes/9/answer", &[JSON], body).await;
        assert_eq!(response.status(), http);
        let asked = port.asked();
        assert!(matches!(&asked[0], Request::Ask(1, None, ask) if ask.choices == ["yes"]));
        assert!(matches!(&asked[1], Request::AnswerQuestion(1, None, answer) if answer.choice == "yes"));
    }
}

#[tokio::test]
async fn an_alarm_is_acknowledged_at_the_coordinate_system_that_it_stopped() {
    let port = StubPort::new();
    let alarm = |id, cs| AlarmRecord {
        id,
        cs,
        ..AlarmRecord::default()
    };
    let active = ActiveAlarms {
        alarms: vec![alarm(3, Some(2)), alarm(4, None)],
    };
    port.say(Topic::AlarmActive, Some(1), Payload::AlarmActive(active));
    assert_eq!(get(&port, "/api/v1/alarms").await.1["alarms"][0]["id"], 3);
    for (id, expected_cs) in [(3, 2), (4, 1)] {
        let path = format!("/api/v1/alarms/{id}/acknowledge");
        assert_eq!(call(&port, "POST", &path, &[], "").await.status(), 202);
        let Some(Request::Command { cs, command, .. }) = port.asked().pop() else {
            panic!("{:?}", port.asked());
        };
        assert_eq!((cs, command), (expected_cs, Command::AlarmAcknowledge { id }));
    }
    assert_eq!(
        call(&port, "POST", "/api/v1/alarms/5/acknowledge", &[], "")
            .await
            .status(),
        404
    );
}

#[tokio::test]
async fn metrics_count_responses_by_class() {
    let app = router(shared(StubPort::new()), None);
    for path in ["/api/v1/health", "/api/v1/nothing", "/api/v1/metrics"] {
        let request = HttpRequest::get(path).header("host", "localhost:8080");
        let response = app
            .clone()
            .oneshot(request.body(Body::empty()).unwrap())
            .await
            .unwrap();
        if path.ends_with("metrics") {
            let text = text(response).await;
            assert!(
                text.contains("tandem_http_responses_total{class=\"2xx\"} 1\n"),
                "{text}"
            );
            assert!(
                text.contains("tandem_http_responses_total{class=\"4xx\"} 1\n"),
                "{text}"
            );
            assert!(text.contains("tandem_mqtt_connected 0\n"), "{text}");
        }
    }
}

#[tokio::test]
async fn the_hmi_is_served_with_its_type_tag_and_protection() {
    let port = StubPort::new();
    let response = call(&port, "GET", "/", &[], "").await;
    assert_eq!(response.status(), 200);
    assert_eq!(response.headers()["content-type"], "text/html; charset=utf-8");
    assert_eq!(response.headers()["x-content-type-options"], "nosniff");
    let policy = response.headers()["content-security-policy"].to_str().unwrap();
    assert!(
        policy.contains("default-src 'self'") && policy.contains("frame-ancestors 'none'"),
        "{policy}"
    );
    let tag = response.headers()["etag"].to_str().unwrap().to_owned();
    let again = call(&port, "GET", "/", &[("if-none-match", &tag)], "").await;
    assert_eq!((again.status().as_u16(), text(again).await), (304, String::new()));
    let script = call(&port, "GET", "/main.js", &[], "").await;
    let kind = script.headers()["content-type"].to_str().unwrap();
    assert!(kind.starts_with("text/javascript"), "{kind}");
    for path in [
        "/types.d.ts",
        "/nothing.js",
        "/../Cargo.toml",
        "/.git/config",
        "/package.json",
    ] {
        assert_eq!(call(&port, "GET", path, &[], "").await.status(), 404, "{path}");
    }
}

#[tokio::test]
async fn only_the_machines_page_contacts_other_servers_without_their_scripts() {
    let port = StubPort::new();
    for path in ["/machines", "/machines.html"] {
        let response = call(&port, "GET", path, &[], "").await;
        assert_eq!(
            (response.status().as_u16(), &response.headers()["content-type"]),
            (200, &"text/html; charset=utf-8".parse().unwrap())
        );
        let policies: Vec<_> = response
            .headers()
            .get_all("content-security-policy")
            .iter()
            .collect();
        let [policy] = policies[..] else {
            panic!("{policies:?}")
        };
        let policy = policy.to_str().unwrap();
        assert!(
            policy.contains("default-src 'self'; connect-src 'self' http: https: ws: wss:;"),
            "{policy}"
        );
        assert!(!policy.contains("script-src"), "{policy}");
    }
    for path in ["/", "/api", "/machines.js", "/api/v1/health"] {
        let response = call(&port, "GET", path, &[], "").await;
        let policy = response.headers()["content-security-policy"]
            .to_str()
            .unwrap()
            .to_owned();
        assert!(!policy.contains("connect-src"), "{path}: {policy}");
    }
}

#[tokio::test]
async fn metrics_tell_how_punctual_the_servo_thread_is_as_prometheus_histograms() {
    let durations = |max_s| Durations {
        buckets: vec![(2e-6, 3), (4e-6, 0), (f64::INFINITY, 2)],
        sum_s: 0.25,
        max_s,
    };
    let port = StubPort::new();
    *port.servo_timing.lock().unwrap() = Some(ServoTiming {
        period_s: 0.001,
        overruns: 7,
        missed: 5,
        late_exchanges: 3,
        lost_frames: 2,
        lateness: durations(0.125),
        computing: durations(0.0005),
    });
    let response = call(&port, "GET", "/api/v1/metrics", &[], "").await;
    let text = text(response).await;
    let servo: Vec<&str> = text
        .lines()
        .filter(|line| line.starts_with("tandem_servo") || line.starts_with("# TYPE tandem_servo"))
        .collect();
    let mut expected = vec![
        "# TYPE tandem_servo_period_seconds gauge".to_owned(),
        "tandem_servo_period_seconds 0.001".to_owned(),
        "# TYPE tandem_servo_overruns_total counter".to_owned(),
        "tandem_servo_overruns_total 7".to_owned(),
        "# TYPE tandem_servo_missed_cycles_total counter".to_owned(),
        "tandem_servo_missed_cycles_total 5".to_owned(),
        "# TYPE tandem_servo_late_exchanges_total counter".to_owned(),
        "tandem_servo_late_exchanges_total 3".to_owned(),
        "# TYPE tandem_servo_lost_frames_total counter".to_owned(),
        "tandem_servo_lost_frames_total 2".to_owned(),
    ];
    for (name, max) in [
        ("tandem_servo_wakeup_lateness", "0.125"),
        ("tandem_servo_cycle", "0.0005"),
    ] {
        expected.extend([
            format!("# TYPE {name}_seconds histogram"),
            format!("{name}_seconds_bucket{{le=\"2e-06\"}} 3"),
            format!("{name}_seconds_bucket{{le=\"4e-06\"}} 3"),
            format!("{name}_seconds_bucket{{le=\"+Inf\"}} 5"),
            format!("{name}_seconds_sum 0.25"),
            format!("{name}_seconds_count 5"),
            format!("# TYPE {name}_max_seconds gauge"),
            format!("{name}_max_seconds {max}"),
        ]);
    }
    assert_eq!(servo, expected);
    // every metric has its help, and a machine in simulated time has no servo thread
    assert_eq!(text.matches("# HELP ").count(), text.matches("# TYPE ").count());
    let simulated = call(&StubPort::new(), "GET", "/api/v1/metrics", &[], "").await;
    assert!(!self::text(simulated).await.contains("tandem_servo"));
}

#[tokio::test]
async fn the_documents_and_their_page_are_served_from_here_alone() {
    let port = StubPort::new();
    for (path, key) in [("openapi", "3.1.0"), ("asyncapi", "3.0.0")] {
        let (status, document) = get(&port, &format!("/api/v1/{path}.json")).await;
        assert_eq!((status, &document[path]), (200, &json!(key)));
    }
    let (_, document) = get(&port, "/api/v1/asyncapi.json").await;
    assert_eq!(
        document["servers"],
        json!({
            "machine": {"host": "127.0.0.1:1883", "protocol": "mqtt"},
            "websocket": {"host": "127.0.0.1:8080", "protocol": "ws"},
        }),
        "where this machine is"
    );
    let response = call(&port, "GET", "/api", &[], "").await;
    assert_eq!(response.headers()["content-type"], "text/html; charset=utf-8");
    let page = text(response).await;
    for file in ["api_page.js", "styles/api_page.css"] {
        assert!(page.contains(file), "{page}");
        assert_eq!(
            call(&port, "GET", &format!("/{file}"), &[], "").await.status(),
            200
        );
    }
    assert!(!page.contains("://"), "nothing from elsewhere: {page}");
}
