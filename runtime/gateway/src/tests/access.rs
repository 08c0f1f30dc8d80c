//! Users: the rights of each role over HTTP, WebSocket and the embedded broker, and their limits.

use axum::body::Body;
use axum::http::{Request as HttpRequest, StatusCode, header};
use futures_util::{SinkExt, StreamExt};
use http_body_util::BodyExt;
use plc_protocol::types::output::HandshakeResult;
use rumqttc::{LastWill, MqttOptions, QoS};
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tower::ServiceExt;

use super::mqtt::{ROOT, TestClient};
use super::*;
use crate::access::Role;
use crate::contract::routes::ROUTES;

/// Answers everything of a coordinate system 1.
fn port() -> Arc<StubPort> {
    StubPort::with(|request| {
        Ok(match request {
            Request::Command { meta, .. } => {
                Answer::Command(reply(&meta.command_id, CommandStatus::Accepted, "ok"))
            }
            Request::Claim(_, _, _) | Request::Reset(_, _, _) => Answer::Handshake(HandshakeResult::new(
                1,
                "h",
                plc_protocol::types::output::HandshakeStatus::Accepted,
            )),
            Request::Programs => Answer::Programs(Vec::new()),
            Request::WriteProgram(..) | Request::CheckProgram(_) => {
                Answer::Check(plc_protocol::types::program::ProgramCheck::default())
            }
            _ => Answer::Done,
        })
    })
}

/// One request to a server with the users; its status and problem code.
pub(super) async fn send(
    shared: &Arc<ServerState>,
    (method, path): (&str, &str),
    token: Option<&str>,
    body: &Value,
) -> (StatusCode, Value) {
    let mut request = HttpRequest::builder()
        .method(method)
        .uri(format!("/api/v1{path}"))
        .header(header::HOST, "127.0.0.1:8080")
        .header(header::CONTENT_TYPE, "application/json");
    if let Some(token) = token {
        request = request.header(header::AUTHORIZATION, format!("Bearer {token}"));
    }
    let request = request.body(Body::from(body.to_string())).unwrap();
    let response = crate::http::router(Arc::clone(shared), None)
        .oneshot(request)
        .await
        .unwrap();
    let status = response.status();
    let body = response.into_body().collect().await.unwrap().to_bytes();
    (status, serde_json::from_slice(&body).unwrap_or_default())
}

fn served(users: &TestUsers) -> Arc<ServerState> {
    shared_with(port(), users.settings.tokens.clone())
}

/// A path of the table with numbers for its names.
fn filled(path: &str) -> String {
    let path = path.replace("{cs}", "1").replace("{seq}", "1");
    path.replace("{number}", "1").replace("{id}", "1")
}

#[tokio::test]
async fn every_route_asks_for_a_token_and_lets_pass_the_roles_of_its_right_only() {
    let users = TestUsers::new();
    let port = port();
    port.say_handler("handler", 1);
    let shared = shared_with(port, users.settings.tokens.clone());
    for (route, serves) in ROUTES
        .values()
        .flatten()
        .filter(|(route, _)| route.pattern != "/ws")
    {
        let path = filled(&route.path());
        let asked = (route.method, path.as_str());
        let (status, problem) = send(&shared, asked, None, &json!({})).await;
        let Some(right) = serves.right() else {
            assert_ne!(status, StatusCode::UNAUTHORIZED, "{asked:?}");
            continue;
        };
        // beyond the rate of wrong tokens it is 429
        assert!(
            [401, 429].contains(&status.as_u16()),
            "{asked:?}: {status} {problem}"
        );
        for (name, role) in Role::ALL {
            let (status, problem) = send(&shared, asked, Some(users.token(name)), &json!({})).await;
            assert_ne!(problem["code"], "unauthorized", "{asked:?} {name}");
            assert_ne!(problem["code"], "route_without_right", "{asked:?}");
            let refused = status == StatusCode::FORBIDDEN && problem["code"] == "forbidden";
            assert_eq!(refused, !role.has(right), "{asked:?} {name}: {status} {problem}");
        }
    }
}

#[tokio::test]
async fn without_a_token_file_every_route_of_the_table_is_there() {
    let shared = shared(port());
    for (route, _) in ROUTES
        .values()
        .flatten()
        .filter(|(route, _)| route.pattern != "/ws")
    {
        let path = filled(&route.path());
        let (status, problem) = send(&shared, (route.method, &path), None, &json!({})).await;
        let routed = status != StatusCode::METHOD_NOT_ALLOWED
            && !problem["detail"]
                .as_str()
                .is_some_and(|text| text.starts_with("there is nothing at"));
        assert!(routed, "{} {path}: {status} {problem}", route.method);
        assert_ne!(problem["code"], "route_without_right", "{path}");
    }
}

#[tokio::test]
async fn a_route_without_a_row_is_refused_even_on_the_loopback() {
    let shared = shared(port());
    let api = axum::Router::new()
        .route("/secret", axum::routing::get(|| async { "open" }))
        .layer(axum::middleware::from_fn_with_state(
            Arc::clone(&shared),
            crate::access::guard::guard,
        ));
    let router = axum::Router::new().nest("/api/v1", api);
    let request = HttpRequest::get("/api/v1/secret").body(Body::empty()).unwrap();
    let response = router.oneshot(request).await.unwrap();
    assert_eq!(response.status(), StatusCode::INTERNAL_SERVER_ERROR);
}

#[tokio::test]
async fn a_handler_acts_in_its_own_name_only_and_never_by_force() {
    let users = TestUsers::new();
    let shared = served(&users);
    let path = ("POST", "/cs/1/m_codes/1/reset");
    let body =
        |id: &str, force: bool| json!({"boot_id": "b", "handler_id": id, "result": "ok", "force": force});
    for (user, id, force, expected) in [
        ("handler", "handler", false, 200),
        ("handler", "other", false, 403),
        ("handler", "handler", true, 403),
        ("operate", "hmi", true, 200),
        ("view", "view", false, 403),
    ] {
        let (status, problem) = send(&shared, path, Some(users.token(user)), &body(id, force)).await;
        assert_eq!(status.as_u16(), expected, "{user} {id} {force}: {problem}");
    }
    for (what, mut said) in [
        ("claim", json!({})),
        ("progress", json!({"text": "turns"})),
        (
            "ask",
            json!({"question_id": "q", "text": "Again?", "choices": ["yes"]}),
        ),
    ] {
        said["boot_id"] = "b".into();
        said["handler_id"] = "other".into();
        let path = format!("/cs/1/m_codes/1/{what}");
        let (status, _) = send(&shared, ("POST", &path), Some(users.token("handler")), &said).await;
        assert_eq!(status, StatusCode::FORBIDDEN, "{what}");
    }
}

#[tokio::test]
async fn a_command_is_replied_to_the_user_of_its_token() {
    let users = TestUsers::new();
    let port = port();
    let shared = shared_with(Arc::clone(&port), users.settings.tokens.clone());
    let path = ("POST", "/cs/1/start");
    let (status, _) = send(&shared, path, Some(users.token("operate")), &json!({})).await;
    assert_eq!(status, StatusCode::ACCEPTED);
    assert!(
        matches!(&port.asked()[..], [Request::Command { meta, .. }] if meta.client_id == "operate"),
        "{:?}",
        port.asked()
    );
}

#[tokio::test(start_paused = true)]
async fn wrong_tokens_are_limited_and_hold_up_no_right_one() {
    let users = TestUsers::new();
    let shared = served(&users);
    let mut last = StatusCode::OK;
    for number in 0..60 {
        let wrong = format!("{number:064x}");
        last = send(&shared, ("GET", "/programs"), Some(&wrong), &json!({}))
            .await
            .0;
    }
    assert_eq!(last, StatusCode::TOO_MANY_REQUESTS);
    // the HMI must learn that it needs a token
    let (status, _) = send(&shared, ("GET", "/machine"), None, &json!({})).await;
    assert_eq!(status, StatusCode::UNAUTHORIZED);
    let (status, _) = send(
        &shared,
        ("GET", "/programs"),
        Some(users.token("view")),
        &json!({}),
    )
    .await;
    assert_eq!(status, StatusCode::OK);
}

#[tokio::test(start_paused = true)]
async fn wrong_tokens_of_one_host_limit_no_other_host() {
    let users = TestUsers::new();
    let shared = served(&users);
    let mut headers = axum::http::HeaderMap::new();
    headers.insert(header::AUTHORIZATION, "Bearer wrong".parse().unwrap());
    let asked = |host: [u8; 4]| {
        let refused = (shared.access).user(&headers, (None, Some(host.into())), false);
        refused.map(drop).unwrap_err().status_and_code().0
    };
    for _ in 0..50 {
        assert_eq!(asked([10, 0, 0, 1]), 401);
    }
    assert_eq!(asked([10, 0, 0, 1]), 429);
    assert_eq!(asked([10, 0, 0, 2]), 401);
}

#[tokio::test(start_paused = true)]
async fn no_press_of_a_stop_without_login_is_refused() {
    let users = TestUsers::new();
    let shared = served(&users);
    let (access, host) = (&shared.access, Some([10, 0, 0, 1].into()));
    let request = |cs: u8, verb: &str| {
        let path = format!("/api/v1/cs/{cs}/{verb}");
        let shown = access.authorize_anonymous_stop(host, &path).ok()?;
        Some(access.urgent_delay(&shown.user, host, &path))
    };
    // the login page sends a press to 8 coordinate systems; 3 presses a second, hold, stop and abort in turn
    for press in 0..60 {
        let verb = ["hold", "stop", "abort"][press % 3];
        for cs in 1..=8 {
            assert_eq!(request(cs, verb), Some(Duration::ZERO), "press {press}");
        }
        tokio::time::advance(Duration::from_millis(333)).await;
    }
    // a flood is delayed, and then refused
    let delays: Vec<_> = (0..60).map_while(|_| request(1, "stop")).collect();
    assert!(delays.len() >= 20 && delays.len() < 40, "{}", delays.len());
    assert_eq!(request(2, "stop"), Some(Duration::ZERO));
    assert_eq!(request(1, "abort"), Some(Duration::ZERO));
    for cs in [9, 200] {
        while request(cs, "stop").is_some() {}
    }
    assert_eq!(
        request(0, "stop"),
        None,
        "numbers that do not exist share one rate"
    );
}

#[tokio::test(start_paused = true)]
async fn a_user_who_asks_too_often_is_told_so_and_others_go_on() {
    let users = TestUsers::new();
    let shared = served(&users);
    let asked = |name: &str| {
        let mut headers = axum::http::HeaderMap::new();
        let value = format!("Bearer {}", users.token(name));
        headers.insert(header::AUTHORIZATION, value.parse().unwrap());
        shared
            .access
            .user(&headers, (None, None), false)
            .map(|shown| shown.user)
    };
    for _ in 0..1000 {
        assert!(asked("view").is_ok());
    }
    let problem = asked("view").unwrap_err();
    assert_eq!(problem.status_and_code(), (429, "too_many_requests"));
    assert!(asked("admin").is_ok());
    tokio::time::advance(Duration::from_secs(1)).await;
    assert!(asked("view").is_ok());
}

#[tokio::test]
async fn a_program_is_named_by_its_number_and_by_no_path() {
    let users = TestUsers::new();
    let port = port();
    let shared = shared_with(Arc::clone(&port), users.settings.tokens.clone());
    let token = Some(users.token("admin"));
    for name in [
        "..%2f..%2fetc%2fpasswd",
        "..",
        "%2e%2e%2f1",
        "1%00",
        "1.nc",
        "-1",
        "+1",
        "01",
        "99999999",
    ] {
        let (status, _) = send(&shared, ("GET", &format!("/programs/{name}")), token, &json!({})).await;
        assert_eq!(status, StatusCode::NOT_FOUND, "{name}");
    }
    assert_eq!(port.asked(), []);
}

type Socket = tokio_tungstenite::WebSocketStream<TcpStream>;

async fn websocket(gateway: &Gateway, protocols: Option<String>) -> Result<Socket, u16> {
    let address = gateway.http_addr();
    let mut request = format!("ws://{address}/api/v1/ws").into_client_request().unwrap();
    if let Some(protocols) = protocols {
        let name = header::SEC_WEBSOCKET_PROTOCOL;
        request.headers_mut().insert(name, protocols.parse().unwrap());
    }
    let stream = TcpStream::connect(address).await.unwrap();
    match tokio_tungstenite::client_async(request, stream).await {
        Ok((socket, response)) => {
            assert_eq!(response.headers()[header::SEC_WEBSOCKET_PROTOCOL], "tandem.v1");
            Ok(socket)
        }
        Err(tokio_tungstenite::tungstenite::Error::Http(response)) => Err(response.status().as_u16()),
        Err(error) => panic!("{error}"),
    }
}

async fn next_text(socket: &mut Socket) -> String {
    within(async {
        loop {
            let message = socket.next().await.unwrap().unwrap();
            if message.is_text() {
                return message.into_text().unwrap().to_string();
            }
        }
    })
    .await
}

#[tokio::test]
async fn websocket_takes_its_token_as_sub_protocol_without_returning_it() {
    let users = TestUsers::new();
    let gateway = start_with(&port(), users.settings.clone()).await;
    assert_eq!(websocket(&gateway, None).await.unwrap_err(), 401);
    let wrong = format!("tandem.v1, bearer.{}", "0".repeat(64));
    assert_eq!(websocket(&gateway, Some(wrong)).await.unwrap_err(), 401);
    let right = format!("tandem.v1, bearer.{}", users.token("view"));
    let mut socket = websocket(&gateway, Some(right)).await.unwrap();
    let subscribe = json!({"subscribe": ["cs/1/state"]}).to_string();
    socket.send(subscribe.into()).await.unwrap();
    assert!(next_text(&mut socket).await.contains("\"topic\":\"cs/1/state\""));
    gateway.shutdown().await;
}

#[tokio::test]
async fn over_websocket_only_a_handler_announces_and_validates_as_itself() {
    let users = TestUsers::new();
    let port = port();
    let gateway = start_with(&port, users.settings.clone()).await;
    let announced = json!({"handler": {"id": "handler", "online": true}});
    let validated = json!({"validate_result":
        {"cs": 1, "m": 5, "request_id": "1-1", "handler_id": "handler", "ok": true}});
    for (role, name, allowed) in [
        ("view", "handler", false),
        ("operate", "handler", false),
        ("handler", "other", false),
        ("handler", "handler", true),
    ] {
        let protocols = format!("tandem.v1, bearer.{}", users.token(role));
        let mut socket = websocket(&gateway, Some(protocols)).await.unwrap();
        for said in [&announced, &validated] {
            let said = said.to_string().replace("\"handler\",", &format!("\"{name}\","));
            socket.send(said.into()).await.unwrap();
            if !allowed {
                let answer = next_text(&mut socket).await;
                assert!(answer.contains("error"), "{role} as {name}: {answer}");
                assert_eq!(port.asked(), [], "{role} as {name}");
            }
        }
        if allowed {
            port.asked_for(|request| {
                matches!(request, Request::ValidateResult(1, Some(5), result) if result.ok && result.request_id == "1-1")
            })
            .await;
            port.asked_for(|request| matches!(request, Request::Handler(id, _) if id == "handler"))
                .await;
        }
    }
    gateway.shutdown().await;
}

pub(super) fn mqtt_options(gateway: &Gateway, id: &str, user: &str, password: &str) -> MqttOptions {
    let address = gateway.mqtt_addr().unwrap();
    let mut options = MqttOptions::new(id, address.ip().to_string(), address.port());
    options.set_credentials(user, password);
    options
}

async fn is_let_in(options: MqttOptions) -> bool {
    let (_client, mut eventloop) = rumqttc::AsyncClient::new(options, 8);
    within(eventloop.poll()).await.is_ok()
}

#[tokio::test]
async fn the_broker_lets_in_users_with_their_tokens_and_nobody_as_the_runtime() {
    let users = TestUsers::new();
    let gateway = start_with(&port(), users.settings.clone()).await;
    let view = users.token("view");
    for (id, user, password, expected) in [
        ("a", "view", view, true),
        ("b", "view", users.token("admin"), false),
        ("c", "view", "", false),
        ("d", "nobody", view, false),
        ("e", "$runtime", view, false),
        ("tandem-mill-1", "admin", users.token("admin"), false),
    ] {
        let options = mqtt_options(&gateway, id, user, password);
        assert_eq!(is_let_in(options).await, expected, "{id} {user}");
    }
    let address = gateway.mqtt_addr().unwrap();
    let anonymous = MqttOptions::new("f", address.ip().to_string(), address.port());
    assert!(!is_let_in(anonymous).await);
    let mut evil = mqtt_options(&gateway, "g", "operate", users.token("operate"));
    evil.set_last_will(LastWill::new(
        format!("{ROOT}presence"),
        "{}",
        QoS::AtLeastOnce,
        true,
    ));
    assert!(
        !is_let_in(evil).await,
        "its will would say the runtime's presence"
    );
    gateway.shutdown().await;
}

/// The reason code with which the broker answers an MQTT 5 CONNECT.
async fn connect_code(gateway: &Gateway, user: &str, password: &str) -> u8 {
    let field = |text: &str| {
        [
            &u16::try_from(text.len()).unwrap().to_be_bytes()[..],
            text.as_bytes(),
        ]
        .concat()
    };
    // protocol, version 5, user and password and clean start, keep-alive, no properties
    let fixed = [&field("MQTT")[..], &[5, 0b1100_0010, 0, 30, 0]].concat();
    let rest = [fixed, field("guesser"), field(user), field(password)].concat();
    let packet = [&[0x10, u8::try_from(rest.len()).unwrap()], &rest[..]].concat();
    let mut stream = TcpStream::connect(gateway.mqtt_addr().unwrap()).await.unwrap();
    stream.write_all(&packet).await.unwrap();
    let mut answer = [0; 4];
    stream.read_exact(&mut answer).await.unwrap();
    assert_eq!(answer[0], 0x20, "a CONNACK: {answer:?}");
    answer[3]
}

#[tokio::test]
async fn wrong_tokens_over_mqtt_are_limited_and_hold_up_no_right_one() {
    let users = TestUsers::new();
    let gateway = start_with(&port(), users.settings.clone()).await;
    let (mut wrong, mut limited) = (0, 0);
    for number in 0..300 {
        let user = if number % 2 == 0 { "view" } else { "$runtime" };
        match within(connect_code(&gateway, user, &format!("{number:x}"))).await {
            0x86 => wrong += 1,
            0x9f => limited += 1,
            code => panic!("code {code:#x}"),
        }
    }
    assert!(
        wrong >= 50 && limited > 0,
        "{wrong} told wrong, {limited} told to come later"
    );
    assert_eq!(connect_code(&gateway, "view", users.token("view")).await, 0);
    gateway.shutdown().await;
}

#[tokio::test]
async fn a_user_cannot_push_another_off_the_broker_by_its_client_id() {
    let users = TestUsers::new();
    let port = port();
    let gateway = start_with(&port, users.settings.clone()).await;
    let options = |user: &str| mqtt_options(&gateway, "panel", user, users.token(user));
    let panel = TestClient::with_options(options("operate"), &["presence"]).await;
    assert!(!is_let_in(options("view")).await);
    panel.publish("cs/1/tool/set", false, &json!({"id": 4})).await;
    port.asked_for(|request| *request == Request::Tool(1, 4)).await;
    gateway.shutdown().await;
}

#[tokio::test]
async fn what_a_user_may_not_publish_reaches_nobody_and_the_connection_stays() {
    let users = TestUsers::new();
    let port = port();
    let gateway = start_with(&port, users.settings.clone()).await;
    let options = |id: &str| mqtt_options(&gateway, id, id, users.token(id));
    let mut view = TestClient::with_options(options("view"), &["#"]).await;
    view.next("presence", |value| value["online"] == true).await;
    let handler = TestClient::with_options(options("handler"), &[]).await;
    let operate = TestClient::with_options(options("operate"), &[]).await;
    let claim = |id: &str| json!({"boot_id": "b", "seq": 1, "handler_id": id});
    view.publish("cs/1/tool/set", false, &json!({"id": 1})).await;
    handler
        .publish(
            "cs/1/command/start",
            false,
            &json!({"command_id": "c", "client_id": "x"}),
        )
        .await;
    handler
        .publish("cs/1/m_code/5/claim", false, &claim("other"))
        .await;
    handler
        .publish("handler/other/presence", true, &json!({"online": true}))
        .await;
    operate
        .publish("cs/1/state", true, &json!({"execution": "READY"}))
        .await;
    operate
        .publish("cs/1/m_code/5/claim", false, &claim("operate"))
        .await;
    // each connection still has exactly the rights of its user
    handler
        .publish("cs/1/m_code/5/claim", false, &claim("handler"))
        .await;
    operate.publish("cs/1/tool/set", false, &json!({"id": 4})).await;
    port.asked_for(|request| *request == Request::Tool(1, 4)).await;
    let claimed = |request: &Request| matches!(request, Request::Claim(1, Some(5), claim) if claim.handler_id == "handler");
    port.asked_for(claimed).await;
    assert_eq!(port.asked().len(), 2, "{:?}", port.asked());
    view.next("cs/1/tool/set", |value| value["id"] == 4).await;
    assert!(
        !view
            .here()
            .iter()
            .any(|publish| publish.payload.starts_with(b"{\"execution\":\"READY\""))
    );
    gateway.shutdown().await;
}

#[tokio::test]
async fn revoked_token_disconnects_mqtt_3_and_5_clients_and_publishes_wills() {
    use rumqttc::v5::mqttbytes::{QoS as QoS5, v5 as mqtt5};
    let mut users = TestUsers::new();
    let (old, new, stays) = ["old", "new", "stays"]
        .map(|name| crate::new_token(name, Role::Handler, None).unwrap())
        .into();
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(&file, [&old.entry[..], &new.entry, &stays.entry].concat()).unwrap();
    users.settings.tokens = Some(Arc::new(crate::Tokens::read(file.path()).unwrap()));
    let gateway = start_with(&port(), users.settings).await;
    let address = gateway.mqtt_addr().unwrap();
    // one for each, since their wills come in any order
    let mut watches = Vec::new();
    for path in ["handler/old/presence", "handler/new/presence"] {
        let id = format!("watch-{}", watches.len());
        let options = mqtt_options(&gateway, &id, "stays", &stays.token);
        watches.push((path, TestClient::with_options(options, &[path]).await));
    }
    let will = |name: &str| (format!("{ROOT}handler/{name}/presence"), r#"{"online":false}"#);
    let (topic, payload) = will("old");
    let mut options = mqtt_options(&gateway, "old", "old", &old.token);
    options.set_last_will(LastWill::new(topic, payload, QoS::AtLeastOnce, true));
    let _old = TestClient::with_options(options, &[]).await;
    let (topic, payload) = will("new");
    let mut options = rumqttc::v5::MqttOptions::new("new", address.ip().to_string(), address.port());
    options.set_credentials("new", &new.token);
    options.set_last_will(mqtt5::LastWill::new(
        topic,
        payload,
        QoS5::AtLeastOnce,
        true,
        None,
    ));
    let (_new, mut events) = rumqttc::v5::AsyncClient::new(options, 8);
    within(events.poll()).await.expect("it is let in");

    std::fs::write(&file, &stays.entry).unwrap();
    let closed = async { while events.poll().await.is_ok() {} };
    within(closed).await;
    for (path, mut watch) in watches {
        watch.next(path, |value| value["online"] == false).await;
    }
    gateway.shutdown().await;
}

#[tokio::test]
async fn with_tokens_any_address_may_be_listened_on_and_needs_them() {
    let users = TestUsers::new();
    let mut settings = users.settings.clone();
    settings.http_listen = "0.0.0.0:0".into();
    settings.mqtt.embedded_listen = Some("0.0.0.0:0".into());
    let port = port();
    let gateway = start_with(&port, settings).await;
    let address = format!("127.0.0.1:{}", gateway.http_addr().port());
    let mut stream = TcpStream::connect(&address).await.unwrap();
    let request = "GET /api/v1/cs/1/state HTTP/1.1\r\nHost: mill-1.local\r\n\r\n";
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut answer = [0; 12];
    within(stream.read_exact(&mut answer)).await.unwrap();
    assert_eq!(&answer, b"HTTP/1.1 401");
    gateway.shutdown().await;
}

/// Returns a server's answer to these bytes, up to its end.
async fn answer_to(address: std::net::SocketAddr, bytes: &[u8]) -> String {
    let mut stream = TcpStream::connect(address).await.unwrap();
    stream.write_all(bytes).await.unwrap();
    let mut answer = Vec::new();
    // a server that closes with bytes unread resets the connection
    let _ = within(stream.read_to_end(&mut answer)).await;
    String::from_utf8_lossy(&answer).into_owned()
}

#[tokio::test]
async fn headers_are_limited_in_number_in_size_and_in_time() {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let stop = CancellationToken::new();
    let server = tokio::spawn(crate::server::serve(
        crate::server::LimitedListener::new(listener, crate::server::SLOT_LIMITS),
        axum::Router::new(),
        None,
        stop.clone(),
        Duration::from_millis(200),
    ));
    let many = format!("GET / HTTP/1.1\r\n{}\r\n", "A: b\r\n".repeat(80));
    assert!(
        answer_to(address, many.as_bytes())
            .await
            .starts_with("HTTP/1.1 431")
    );
    let large = format!("GET / HTTP/1.1\r\nA: {}", "b".repeat(70_000));
    assert!(
        answer_to(address, large.as_bytes())
            .await
            .starts_with("HTTP/1.1 431")
    );
    // never finished: closed by time, within the 10 s of `within`
    let slow = answer_to(address, b"GET / HTTP/1.1\r\nA: b\r\n").await;
    assert!(slow.is_empty() || slow.starts_with("HTTP/1.1 408"), "{slow}");
    stop.cancel();
    within(server).await.unwrap();
}
