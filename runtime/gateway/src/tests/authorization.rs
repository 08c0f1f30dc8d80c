//! Rights are checked on the request that is executed, for every text and every transport.

use axum::body::Body;
use axum::http::{Request as HttpRequest, StatusCode, header};
use plc_protocol::server::ServerTransport;
use plc_protocol::types::data::VariableArea;
use plc_protocol::types::output::{HandshakeResult, HandshakeStatus};
use plc_protocol::types::request::{RefusalCode, SpindleCommand};
use plc_protocol::types::state::SpindleDirection;
use plc_protocol::wire::json_object;
use plc_protocol::wire::mqtt::{Inbound, decode};
use plc_protocol::wire::right::Right;
use plc_protocol::wire::row::ParsedRequest;
use plc_protocol::wire::websocket::ClientFrame;
use proptest::prelude::*;
use rumqttc::v5::mqttbytes::{QoS as QoS5, v5 as mqtt5};
use serde_json::json;
use tower::ServiceExt;

use super::access::send;
use super::mqtt::{ROOT, TestClient};
use super::*;
use crate::Role;
use crate::access::{Token, User};
use crate::machine::{Caller, Machine};

/// Answers everything as done.
fn port() -> Arc<StubPort> {
    StubPort::with(|request| {
        Ok(match request {
            Request::Claim(..) | Request::Reset(..) | Request::Ask(..) => {
                Answer::Handshake(HandshakeResult::new(1, "handler", HandshakeStatus::Accepted))
            }
            _ => Answer::Done,
        })
    })
}

/// Payloads with which a handler tries to use another handler's output, or to do more than it may.
const FORGERIES: [&str; 9] = [
    r#"{"boot_id":"b","seq":1,"handler_id":"other","result":"ok","force":null}"#,
    r#"{"boot_id":"b","seq":1,"handler_id":"other","result":"fault","code":1,"text":"x","force":null}"#,
    r#"{"boot_id":"b","seq":1,"handler_id":"other","result":"ok"}"#,
    r#"{"boot_id":"b","seq":1,"handler_id":"handler","result":"ok","force":true}"#,
    r#"{"boot_id":"b","seq":1,"handler_id":"handler","handler_id":"other","result":"ok"}"#,
    r#"{"boot_id":"b","seq":1,"handler_id":"other","handler_id":"handler","result":"ok"}"#,
    r#"{"boot_id":"b","seq":1,"h\u0061ndler_id":"other","result":"ok","force":null}"#,
    r#"{"boot_id":"b","seq":1,"handler_id":["other"],"result":"ok"}"#,
    r#"{"boot_id":"b","seq":1,"handler_id":"other","result":"ok","force":0}"#,
];

/// The reset with which a test ends.
const OWN: &str = r#"{"boot_id":"b","seq":2,"handler_id":"handler","result":"ok","force":null}"#;

/// True for the only request that a handler may make here.
fn is_own(request: &Request) -> bool {
    matches!(request, Request::Reset(1, Some(5), reset)
        if reset.handler_id == "handler" && reset.seq == 2 && reset.force != Some(true))
}

#[tokio::test]
async fn no_mqtt_3_or_5_payload_lets_a_handler_reset_under_another_name() {
    let users = TestUsers::new();
    let port = port();
    let gateway = start_with(&port, users.settings.clone()).await;
    let address = gateway.mqtt_addr().unwrap();
    let mut options = rumqttc::MqttOptions::new("old", address.ip().to_string(), address.port());
    options.set_credentials("handler", users.token("handler"));
    let old = TestClient::with_options(options, &[]).await;
    for payload in FORGERIES {
        old.publish_text("cs/1/m_code/5/reset", payload).await;
    }
    old.publish_text("cs/1/m_code/5/reset", OWN).await;
    port.asked_for(is_own).await;
    assert_eq!(port.asked().len(), 1, "{:?}", port.asked());

    let mut options = rumqttc::v5::MqttOptions::new("new", address.ip().to_string(), address.port());
    options.set_credentials("handler", users.token("handler"));
    let (new, mut events) = rumqttc::v5::AsyncClient::new(options, 32);
    let poller = tokio::spawn(async move { while events.poll().await.is_ok() {} });
    // only the broker names the publisher
    let named = |names: &[&str]| mqtt5::PublishProperties {
        user_properties: names
            .iter()
            .map(|name| ("x-mqtt-sender".into(), (*name).into()))
            .collect(),
        ..mqtt5::PublishProperties::default()
    };
    let topic = format!("{ROOT}cs/1/m_code/5/reset");
    for names in [&[][..], &["admin"], &["admin", "handler"], &["other"]] {
        for payload in FORGERIES {
            let properties = named(names);
            new.publish_with_properties(&topic, QoS5::AtLeastOnce, false, payload, properties)
                .await
                .unwrap();
        }
    }
    let own = OWN.replace("\"seq\":2", "\"seq\":3");
    new.publish_with_properties(&topic, QoS5::AtLeastOnce, false, own, named(&["nobody"]))
        .await
        .unwrap();
    port.asked_for(|request| matches!(request, Request::Reset(_, _, reset) if reset.seq == 3))
        .await;
    assert_eq!(port.asked().len(), 2, "{:?}", port.asked());
    let origins = port.origins();
    assert!(
        origins
            .iter()
            .all(|origin| origin.user.as_deref() == Some("handler")
                && origin.over == ServerTransport::Mqtt
                && origin.from.is_some_and(|from| from.is_loopback())
                && origin.right == Right::Reset),
        "{origins:?}"
    );
    poller.abort();
    gateway.shutdown().await;
}

/// Returns the requests that set values of coordinate system 2 and of all coordinate systems.
fn sets_of_system_2_and_of_all() -> [Request; 4] {
    [
        Request::Tool(2, 4),
        Request::Spindle(
            2,
            SpindleCommand {
                direction: SpindleDirection::Cw,
                rpm: 100.0,
            },
        ),
        Request::WriteVariables {
            area: VariableArea::CoordinateSystem(2),
            from: 1,
            values: vec![1.5],
            meta: None,
        },
        Request::WriteVariables {
            area: VariableArea::Global,
            from: 1,
            values: vec![1.5],
            meta: None,
        },
    ]
}

#[tokio::test]
async fn handler_sets_tool_spindle_and_variables_only_where_it_serves_m_codes() {
    let users = TestUsers::new();
    let port = port();
    let shared = shared_with(Arc::clone(&port), users.settings.tokens.clone());
    let token = users.token("handler");
    let sets = |cs: u8| {
        [
            (format!("/cs/{cs}/tool"), json!({"id": 4})),
            (
                format!("/cs/{cs}/spindle"),
                json!({"direction": "cw", "rpm": 100}),
            ),
            (format!("/cs/{cs}/variables/q?from=1"), json!({"values": [1.5]})),
        ]
    };
    let everywhere = ("/variables/p?from=1".to_owned(), json!({"values": [1.5]}));
    for (path, body) in sets(2).iter().chain([&everywhere]) {
        let (status, text) = send(&shared, ("PUT", path), Some(token), body).await;
        assert_eq!(
            status,
            StatusCode::FORBIDDEN,
            "{path}, nothing is served yet: {text}"
        );
        assert!(
            text["detail"]
                .as_str()
                .is_some_and(|text| text.contains("serves none")),
            "{text}"
        );
    }
    port.say_handler("other", 2);
    port.say_handler("handler", 2);
    for (path, body) in sets(2).iter().chain([&everywhere]) {
        let (status, text) = send(&shared, ("PUT", path), Some(token), body).await;
        assert!(status.is_success(), "{path}: {status} {text}");
    }
    for (path, body) in sets(1) {
        let (status, text) = send(&shared, ("PUT", &path), Some(token), &body).await;
        assert_eq!(status, StatusCode::FORBIDDEN, "{path}: {text}");
    }
    for (path, body) in [
        ("/tools", json!({"1": null})),
        ("/cs/2/work_offsets", json!({})),
        ("/cs/2/inputs/interlock", json!({"value": false})),
        ("/cs/2/overrides", json!({"feed": 50})),
    ] {
        let (status, text) = send(&shared, ("PUT", path), Some(token), &body).await;
        assert_eq!(status, StatusCode::FORBIDDEN, "{path}: {text}");
    }
    assert_eq!(port.asked(), sets_of_system_2_and_of_all());
    assert!(
        port.origins()
            .iter()
            .all(|origin| origin.user.as_deref() == Some("handler"))
    );
}

#[tokio::test]
async fn over_mqtt_a_handler_sets_where_it_serves_and_is_told_why_not_elsewhere() {
    let users = TestUsers::new();
    let port = port();
    port.say_handler("handler", 2);
    let gateway = start_with(&port, users.settings.clone()).await;
    let address = gateway.mqtt_addr().unwrap();
    let mut options = rumqttc::MqttOptions::new("h", address.ip().to_string(), address.port());
    options.set_credentials("handler", users.token("handler"));
    let mut handler = TestClient::with_options(options, &["reply/h"]).await;
    handler.publish_text("cs/1/tool/set", r#"{"id":3}"#).await;
    handler
        .publish_text("cs/1/spindle/set", r#"{"direction":"cw","rpm":10}"#)
        .await;
    let set = json!({"command_id": "v1", "client_id": "h", "kind": "Q", "from": 1, "values": [1]});
    handler.publish("cs/1/variable/set", false, &set).await;
    handler
        .next("reply/h", |reply| {
            reply["status"] == "rejected" && reply["code"] == "forbidden"
        })
        .await;
    handler.publish_text("cs/2/tool/set", r#"{"id":4}"#).await;
    port.asked_for(|request| *request == Request::Tool(2, 4)).await;
    assert_eq!(port.asked().len(), 1, "{:?}", port.asked());
    gateway.shutdown().await;
}

#[test]
fn a_user_whose_token_is_revoked_may_only_be_told_gone() {
    let parsed = |path: &str, payload: &str| match decode(path, payload.as_bytes(), false) {
        Inbound::Ask { request, .. } => request,
        other => panic!("{other:?}"),
    };
    for (path, payload, allowed) in [
        ("handler/old/presence", r#"{"online":false}"#, true),
        ("handler/old/presence", r#"{"online":true}"#, false),
        ("handler/other/presence", r#"{"online":false}"#, false),
        ("cs/1/m_code/5/reset", OWN, false),
        ("cs/1/tool/set", r#"{"id":3}"#, false),
        (
            "cs/1/variable/get",
            r#"{"command_id":"c","client_id":"c","kind":"P","from":1,"count":1}"#,
            false,
        ),
    ] {
        let judged = Machine::authorize_last_will("old", parsed(path, payload));
        assert_eq!(judged.is_ok(), allowed, "{path} {payload}");
        if let Err(refusal) = judged {
            assert_eq!(refusal.code, RefusalCode::Forbidden);
        }
    }
}

fn word() -> impl Strategy<Value = &'static str> {
    prop::sample::select(vec![
        "null",
        "true",
        "false",
        "0",
        "1",
        "1e0",
        "\"handler\"",
        "\"other\"",
        "\"\"",
        "\"true\"",
        "[]",
        "{}",
        "[true]",
        "\"ok\"",
        "\"fault\"",
        "\"b\"",
        "\"turns\"",
        "[\"yes\"]",
        "{\"force\":true}",
        "\"h\\u0061ndler\"",
    ])
}

fn name() -> impl Strategy<Value = &'static str> {
    prop::sample::select(vec![
        "boot_id",
        "seq",
        "handler_id",
        "result",
        "force",
        "code",
        "text",
        "question_id",
        "choices",
        "how",
        "choice",
        "client_id",
        "command_id",
        "id",
        "online",
        "handles",
        "ok",
        "request_id",
        "m",
        "cs",
        "forc\\u0065",
        "Force",
    ])
}

/// Almost valid payloads: expected fields and additional ones, in any order and repeated.
fn payload() -> impl Strategy<Value = String> {
    let right = prop::sample::select(vec![
        ("boot_id", "\"b\""),
        ("seq", "1"),
        ("handler_id", "\"handler\""),
        ("handler_id", "\"other\""),
        ("result", "\"ok\""),
        ("text", "\"turns\""),
        ("question_id", "\"q\""),
        ("choices", "[\"yes\"]"),
        ("request_id", "\"r\""),
        ("ok", "true"),
    ]);
    let field = prop_oneof![4 => right, 1 => (name(), word())];
    proptest::collection::vec(field, 0..9).prop_map(|fields| {
        let fields: Vec<_> = fields
            .iter()
            .map(|(name, value)| format!("\"{name}\":{value}"))
            .collect();
        format!("{{{}}}", fields.join(","))
    })
}

/// Returns the handler named by a request, and whether it is by force, from the request's own fields.
fn named(request: &Request) -> (Option<String>, bool) {
    match request {
        Request::Claim(_, _, said) => (Some(said.handler_id.clone()), false),
        Request::Reset(_, _, said) => (Some(said.handler_id.clone()), said.force == Some(true)),
        Request::Progress(_, _, said) => (Some(said.handler_id.clone()), false),
        Request::Checkpoint(_, _, said) => (Some(said.handler_id.clone()), false),
        Request::Ask(_, _, said) => (Some(said.handler_id.clone()), false),
        Request::ValidateResult(_, _, said) => (Some(said.handler_id.clone()), false),
        Request::Handler(id, _) => (Some(id.clone()), false),
        _ => (None, false),
    }
}

/// Checks that the port receives exactly the parsed request, and nothing beyond a handler's own name.
fn is_judged_and_carried_out_as_one_value(parsed: ParsedRequest) -> Result<(), TestCaseError> {
    let port = port();
    let machine = Machine::new(Arc::<StubPort>::clone(&port));
    let handler: User = Token::user_for_test("handler", Role::Handler);
    let request = parsed.request().clone();
    let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
    let caller = Caller {
        user: &handler,
        from: None,
        over: ServerTransport::Mqtt,
    };
    let judged = runtime.block_on(machine.authorize_request(caller, parsed));
    let (name, force) = named(&request);
    let is_own = name.as_deref() == Some("handler") && !force;
    prop_assert_eq!(judged.is_ok(), is_own, "{:?}", request);
    if let Ok(authorized) = judged {
        let _ = runtime.block_on(machine.execute_request(authorized));
        prop_assert_eq!(port.asked(), [request]);
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3_000))]

    #[test]
    fn what_is_judged_over_mqtt_and_what_is_carried_out_are_the_same_value(
        level in prop::sample::select(vec!["claim", "reset", "progress", "checkpoint", "ask", "validate_result", "redeliver", "answer"]),
        payload in payload(),
    ) {
        if let Inbound::Ask { request, .. } = decode(&format!("cs/1/m_code/5/{level}"), payload.as_bytes(), false) {
            is_judged_and_carried_out_as_one_value(request)?;
        }
    }

    #[test]
    fn value_authorized_over_websocket_is_the_value_executed(
        frame in prop::sample::select(vec!["handler", "validate_result"]),
        payload in payload(),
    ) {
        let text = format!("{{\"{frame}\":{payload}}}");
        if let Ok(frame) = json_object::<ClientFrame>(text.as_bytes()) {
            for request in frame.requests() {
                is_judged_and_carried_out_as_one_value(request)?;
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1_000))]

    #[test]
    fn what_a_handler_is_granted_over_rest_is_in_its_own_name(
        level in prop::sample::select(vec!["claim", "reset", "progress", "checkpoint", "ask", "redeliver", "answer"]),
        payload in payload(),
    ) {
        let port = port();
        let users = TestUsers::new();
        let shared = shared_with(Arc::clone(&port), users.settings.tokens.clone());
        let request = HttpRequest::post(format!("/api/v1/cs/1/m_codes/1/{level}"))
            .header(header::HOST, "127.0.0.1:8080")
            .header(header::CONTENT_TYPE, "application/json")
            .header(header::AUTHORIZATION, format!("Bearer {}", users.token("handler")))
            .body(Body::from(payload))
            .unwrap();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let response = runtime.block_on(crate::http::router(shared, None).oneshot(request)).unwrap();
        prop_assert_eq!(response.status().is_success(), !port.asked().is_empty());
        for request in port.asked() {
            prop_assert_eq!(named(&request), (Some("handler".to_owned()), false));
        }
    }
}

#[tokio::test]
async fn a_handler_writes_the_plant_in_its_own_name_and_forces_nothing() {
    let users = TestUsers::new();
    let port = port();
    let shared = shared_with(Arc::clone(&port), users.settings.tokens.clone());
    let own = json!({"value": true, "handler_id": "handler"});
    for (user, path, body, is_allowed) in [
        ("handler", "/io/in/door", own.clone(), true),
        ("handler", "/io/out/lamp", own, true),
        ("handler", "/io/in/door", json!({"value": true}), false),
        (
            "handler",
            "/io/in/door",
            json!({"value": true, "handler_id": "other"}),
            false,
        ),
        ("handler", "/io/in/door/force", json!({"value": true}), false),
        ("operate", "/io/in/door", json!({"value": true}), true),
        ("operate", "/io/out/lamp/force", json!({"value": true}), true),
        ("operate", "/io/out/lamp/force", json!({"value": null}), true),
        ("view", "/io/out/lamp", json!({"value": true}), false),
        ("view", "/io/out/lamp/force", json!({"value": null}), false),
    ] {
        let asked = port.asked().len();
        let (status, text) = send(&shared, ("PUT", path), Some(users.token(user)), &body).await;
        assert_eq!(status.is_success(), is_allowed, "{user} {path} {body}: {text}");
        assert_eq!(port.asked().len() - asked, usize::from(is_allowed));
        if !is_allowed {
            assert_eq!(status, StatusCode::FORBIDDEN, "{user} {path} {body}: {text}");
        }
    }
}
