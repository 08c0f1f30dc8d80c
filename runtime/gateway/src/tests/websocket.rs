//! WebSocket: full value first, then changes; slow readers; refusals.

use futures_util::{SinkExt, StreamExt};
use plc_protocol::types::output::{Cancel, CancelReason, Pending};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::{self, client::IntoClientRequest};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

use super::*;

/// Values of 64 KiB each: far more than what the connection itself can hold.
const VALUES: u64 = 800;

type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;

async fn connect(gateway: &Gateway) -> Socket {
    let url = format!("ws://{}/api/v1/ws", gateway.http_addr());
    within(Box::pin(connect_async(url))).await.unwrap().0
}

async fn ask(socket: &mut Socket, value: &Value) {
    let frame = tungstenite::Message::text(value.to_string());
    within(socket.send(frame)).await.unwrap();
}

/// The next JSON message.
async fn next(socket: &mut Socket) -> Value {
    within(async {
        loop {
            match socket.next().await.unwrap().unwrap() {
                tungstenite::Message::Text(text) => return serde_json::from_str(&text).unwrap(),
                tungstenite::Message::Ping(_) => {}
                other => panic!("{other:?}"),
            }
        }
    })
    .await
}

#[tokio::test]
async fn subscriber_gets_the_full_value_first_then_each_change_with_revision() {
    let port = StubPort::new();
    let gateway = start(&port).await;
    let mut socket = connect(&gateway).await;
    ask(
        &mut socket,
        &json!({"subscribe": ["cs/1/state", "cs/1/m_code/+/cancel"]}),
    )
    .await;
    let first = next(&mut socket).await;
    assert_eq!(
        (&first["topic"], &first["rev"]),
        (&json!("cs/1/state"), &json!(12))
    );
    assert_eq!((&first["v"], &first["execution"]), (&json!(1), &json!("STOPPED")));
    port.say(
        Topic::cs(1, CsTopic::State),
        Some(13),
        Payload::State(State::default()),
    );
    assert_eq!(next(&mut socket).await["rev"], 13);
    let reason = CancelReason::Stop;
    port.say(
        Topic::cs(1, CsTopic::Cancel(5)),
        None,
        Payload::Cancel(Cancel { seq: 8, reason }),
    );
    let cancel = next(&mut socket).await;
    assert_eq!(
        (&cancel["topic"], &cancel["seq"]),
        (&json!("cs/1/m_code/5/cancel"), &json!(8))
    );
    ask(
        &mut socket,
        &json!({"unsubscribe": ["cs/1/state"], "subscribe": ["presence"]}),
    )
    .await;
    assert_eq!(next(&mut socket).await["topic"], "presence");
    port.say(
        Topic::cs(1, CsTopic::State),
        Some(14),
        Payload::State(State::default()),
    );
    port.say_dry_run(1, true);
    ask(&mut socket, &json!({"subscribe": ["cs/1/input/dry_run/state"]})).await;
    let last = next(&mut socket).await;
    assert_eq!(
        last["topic"], "cs/1/input/dry_run/state",
        "no state after unsubscribing"
    );
    gateway.shutdown().await;
}

#[tokio::test]
async fn what_is_not_understood_is_answered_and_the_connection_stays() {
    let gateway = start(&StubPort::new()).await;
    let mut socket = connect(&gateway).await;
    for asked in [
        json!({"subscribe": ["cs/1/stat"]}),
        json!({"subscribe": "cs/1/state"}),
        json!({"publish": 1}),
    ] {
        ask(&mut socket, &asked).await;
        let answer = next(&mut socket).await;
        assert!(answer["error"].is_string(), "{asked}: {answer}");
    }
    let many: Vec<_> = (0..257).map(|m| format!("cs/1/m_code/{m}/output")).collect();
    ask(&mut socket, &json!({"subscribe": many})).await;
    assert!(next(&mut socket).await["error"].as_str().unwrap().contains("256"));
    ask(
        &mut socket,
        &json!({"unsubscribe": many, "subscribe": ["presence"]}),
    )
    .await;
    assert_eq!(next(&mut socket).await["online"], true);
    gateway.shutdown().await;
}

#[tokio::test]
async fn slow_reader_gets_the_latest_values_and_never_an_unbounded_backlog() {
    let port = StubPort::new();
    let gateway = start(&port).await;
    let mut socket = connect(&gateway).await;
    ask(&mut socket, &json!({"subscribe": ["cs/1/state"]})).await;
    assert_eq!(next(&mut socket).await["rev"], 12);
    for rev in 100..100 + VALUES {
        let state = State {
            run_id: Some("r".repeat(64 * 1024)),
            ..State::default()
        };
        port.say(Topic::cs(1, CsTopic::State), Some(rev), Payload::State(state));
        tokio::task::yield_now().await;
    }
    let mut received = 0;
    let mut last = 0;
    while last != 100 + VALUES - 1 {
        let value = next(&mut socket).await;
        let rev = value["rev"].as_u64().unwrap();
        assert!(rev > last, "{rev} after {last}");
        assert_eq!(
            value["run_id"].as_str().map(str::len),
            Some(64 * 1024),
            "each is whole: what a reader has missed it need not ask for"
        );
        last = rev;
        received += 1;
    }
    assert!(
        received < VALUES / 2,
        "{received} of {VALUES} were kept for a reader that did not read"
    );
    gateway.shutdown().await;
}

#[tokio::test]
async fn slow_reader_receives_a_cancel_before_the_pending_without_the_output() {
    let port = StubPort::new();
    let gateway = start(&port).await;
    let mut socket = connect(&gateway).await;
    ask(&mut socket, &json!({"subscribe": ["cs/1/#"]})).await;
    assert_eq!(next(&mut socket).await["topic"], "cs/1/state");
    for rev in 100..100 + VALUES {
        let run_id = Some("r".repeat(64 * 1024));
        let state = State {
            run_id,
            ..State::default()
        };
        port.say(Topic::cs(1, CsTopic::State), Some(rev), Payload::State(state));
        tokio::task::yield_now().await;
    }
    let pending = |rev| {
        let topic = Topic::cs(1, CsTopic::Pending);
        port.say(topic, Some(rev), Payload::Pending(Pending::default()));
    };
    let reason = CancelReason::Stop;
    pending(1);
    pending(2);
    port.say(
        Topic::cs(1, CsTopic::Cancel(5)),
        None,
        Payload::Cancel(Cancel { seq: 8, reason }),
    );
    pending(3);
    let mut heard = Vec::new();
    while heard.len() < 3 {
        let message = next(&mut socket).await;
        if message["topic"] != "cs/1/state" {
            heard.push((message["topic"].clone(), message["rev"].clone()));
        }
    }
    let (pending, cancel) = (json!("cs/1/m_code/pending"), json!("cs/1/m_code/5/cancel"));
    let right = [
        (pending.clone(), json!(2)),
        (cancel, json!(null)),
        (pending, json!(3)),
    ];
    assert_eq!(heard, right);
    gateway.shutdown().await;
}

#[tokio::test]
async fn positions_come_at_the_interval_with_the_latest_value_last() {
    let port = StubPort::new();
    let gateway = start(&port).await;
    let mut socket = connect(&gateway).await;
    ask(&mut socket, &json!({"subscribe": ["cs/1/position"]})).await;
    for feedrate in 0..500 {
        port.say_position(f64::from(feedrate));
        tokio::task::yield_now().await;
    }
    let mut received = 1;
    while next(&mut socket).await["feedrate"] != 499.0 {
        received += 1;
    }
    assert!(received < 250, "{received} of 500");
    gateway.shutdown().await;
}

#[tokio::test]
async fn a_foreign_origin_gets_no_websocket_and_too_many_get_503() {
    let gateway = start(&StubPort::new()).await;
    let url = format!("ws://{}/api/v1/ws", gateway.http_addr());
    let mut request = url.as_str().into_client_request().unwrap();
    let headers = request.headers_mut();
    headers.insert("origin", "http://evil.example".parse().unwrap());
    match within(Box::pin(connect_async(request))).await {
        Err(tungstenite::Error::Http(response)) => assert_eq!(response.status(), 403),
        other => panic!("{other:?}"),
    }
    let mut open = Vec::new();
    for _ in 0..crate::server_state::WEBSOCKET_LIMITS.all {
        open.push(connect(&gateway).await);
    }
    match within(Box::pin(connect_async(&url))).await {
        Err(tungstenite::Error::Http(response)) => assert_eq!(response.status(), 503),
        other => panic!("{other:?}"),
    }
    drop(open);
    gateway.shutdown().await;
}

#[tokio::test]
async fn a_shutdown_closes_the_websocket_with_a_reason() {
    let gateway = start(&StubPort::new()).await;
    let mut socket = connect(&gateway).await;
    let (frame, ()) = tokio::join!(
        within(async {
            loop {
                match socket.next().await {
                    Some(Ok(tungstenite::Message::Close(frame))) => return frame,
                    Some(Ok(_)) => {}
                    other => panic!("{other:?}"),
                }
            }
        }),
        gateway.shutdown()
    );
    assert_eq!(frame.unwrap().reason.as_str(), "the runtime stops");
}

#[tokio::test]
async fn a_handler_that_a_client_announces_goes_with_its_connection() {
    let port = StubPort::new();
    let gateway = start(&port).await;
    let mut socket = connect(&gateway).await;
    let handles = json!([{"cs": 1, "m": 12}]);
    ask(
        &mut socket,
        &json!({"handler": {"id": "clamp", "online": true, "handles": handles}}),
    )
    .await;
    let is = |request: &Request, is_online: bool| {
        matches!(request, Request::Handler(id, presence)
            if id == "clamp" && presence.online == is_online && presence.handles.len() == usize::from(is_online))
    };
    port.asked_for(|request| is(request, true)).await;
    drop(socket);
    port.asked_for(|request| is(request, false)).await;
}
