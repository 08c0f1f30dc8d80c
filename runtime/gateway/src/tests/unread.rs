//! Limits on responses that clients do not read.

use futures_util::{SinkExt, StreamExt};
use plc_protocol::types::program::ProgramText;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::client_async;
use tokio_tungstenite::tungstenite::Message as Frame;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;

use super::*;

type Socket = WebSocketStream<TcpStream>;

async fn open(gateway: &Gateway, path: &str, protocol: &str) -> Socket {
    let url = format!("ws://{}{path}", gateway.http_addr());
    let mut request = url.into_client_request().unwrap();
    let protocol = protocol.parse().unwrap();
    request.headers_mut().insert("sec-websocket-protocol", protocol);
    let stream = TcpStream::connect(gateway.http_addr()).await.unwrap();
    within(client_async(request, stream)).await.unwrap().0
}

async fn served() -> (TestUsers, Gateway) {
    let mut users = TestUsers::new();
    users.settings.mqtt.websocket = true;
    let gateway = start_with(&StubPort::new(), users.settings.clone()).await;
    (users, gateway)
}

/// Sends pings until the server ends the connection. Returns the last frame.
async fn ping_until_the_end(mut socket: Socket) -> Option<Frame> {
    let pinged = async {
        for _ in 0..1000 {
            if socket.send(Frame::Ping(vec![b'p'; 125].into())).await.is_err() {
                break;
            }
        }
        let mut last = None;
        while let Some(Ok(frame)) = socket.next().await {
            last = Some(frame);
        }
        last
    };
    within(pinged).await
}

#[tokio::test]
async fn a_flood_of_pings_ends_its_websocket_before_and_after_the_login() {
    let (users, gateway) = served().await;
    let own = format!("tandem.v1, bearer.{}", users.token("view"));
    let last = ping_until_the_end(open(&gateway, "/api/v1/ws", &own).await).await;
    if let Some(Frame::Close(Some(close))) = last {
        assert_eq!(u16::from(close.code), 1008, "{close}");
        assert!(close.reason.contains("pings"), "{close}");
    }
    ping_until_the_end(open(&gateway, "/mqtt", "mqtt").await).await;
    let mut known = open(&gateway, "/mqtt", "mqtt").await;
    let connect = connect_packet(5, "view", users.token("view"));
    known.send(Frame::binary(connect)).await.unwrap();
    ping_until_the_end(known).await;
    gateway.shutdown().await;
}

#[tokio::test]
async fn pings_now_and_then_are_answered() {
    let (users, gateway) = served().await;
    let own = format!("tandem.v1, bearer.{}", users.token("view"));
    let mut socket = open(&gateway, "/api/v1/ws", &own).await;
    for n in 0..50_u8 {
        socket.send(Frame::Ping(vec![n].into())).await.unwrap();
        loop {
            match within(socket.next()).await.unwrap().unwrap() {
                Frame::Pong(bytes) => break assert_eq!(bytes[..], [n]),
                Frame::Ping(_) => {}
                other => panic!("{other:?}"),
            }
        }
    }
    gateway.shutdown().await;
}

#[tokio::test]
async fn a_subscription_longer_than_any_topic_is_refused_over_each_transport() {
    let (users, gateway) = served().await;
    let own = format!("tandem.v1, bearer.{}", users.token("view"));
    let mut socket = open(&gateway, "/api/v1/ws", &own).await;
    for (length, is_refused) in [(254, false), (255, true)] {
        let pattern = format!("+/{}", "x".repeat(length));
        let subscribe = serde_json::json!({"subscribe": [pattern, "presence"], "unsubscribe": ["presence"]});
        socket.send(Frame::text(subscribe.to_string())).await.unwrap();
        let answer = loop {
            if let Frame::Text(text) = within(socket.next()).await.unwrap().unwrap() {
                break text;
            }
        };
        assert_eq!(answer.contains("256 bytes"), is_refused, "{answer}");
        if is_refused {
            within(socket.next()).await.unwrap().unwrap();
        }
    }
    let (mut stream, answer) = mqtt_as(&gateway, 5, "view", users.token("view")).await;
    assert_eq!(answer, [0x20, 0]);
    for (length, granted) in [(512, 1), (513, 0x87)] {
        let filter = "f".repeat(length);
        let bytes = u16::try_from(length).unwrap().to_be_bytes();
        let subscribe = packet(0x82, &[&[0, 1, 0], &bytes, filter.as_bytes(), &[1]]);
        stream.write_all(&subscribe).await.unwrap();
        let mut head = [0; 2];
        within(stream.read_exact(&mut head)).await.unwrap();
        let mut body = vec![0; head[1].into()];
        within(stream.read_exact(&mut body)).await.unwrap();
        // MQTT 5, 3.9.3: granted quality 1, or not authorized
        assert_eq!((head[0], body.last()), (0x90, Some(&granted)), "{length} bytes");
    }
    gateway.shutdown().await;
}

#[tokio::test]
async fn a_packet_beyond_a_limit_ends_its_connection_to_the_broker() {
    let (users, gateway) = served().await;
    let mut stranger = TcpStream::connect(gateway.mqtt_addr().unwrap()).await.unwrap();
    // a CONNECT of a megabyte, of which only the beginning arrives
    stranger.write_all(&[0x10, 0xff, 0xff, 0x3f, 0]).await.unwrap();
    let mut rest = Vec::new();
    within(stranger.read_to_end(&mut rest)).await.ok();
    let (mut stream, _) = mqtt_as(&gateway, 5, "admin", users.token("admin")).await;
    let topic = "t".repeat(1025);
    let publish = packet(
        0x30,
        &[&1025_u16.to_be_bytes(), topic.as_bytes(), &[0], b"payload"],
    );
    stream.write_all(&publish).await.unwrap();
    let mut rest = Vec::new();
    within(stream.read_to_end(&mut rest)).await.ok();
    // MQTT 5, 3.14.2.1: 0x90, topic name invalid
    assert_eq!((rest[0], rest[2]), (0xe0, 0x90), "{rest:?}");
    gateway.shutdown().await;
}

#[tokio::test]
async fn http_2_is_not_offered() {
    let gateway = start(&StubPort::new()).await;
    let mut stream = TcpStream::connect(gateway.http_addr()).await.unwrap();
    // RFC 9113, 3.4: the preface of a client, and an empty SETTINGS frame
    let preface = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";
    stream.write_all(preface).await.unwrap();
    let mut answer = Vec::new();
    within(stream.read_to_end(&mut answer)).await.ok();
    let answer = String::from_utf8_lossy(&answer);
    assert!(answer.is_empty() || answer.starts_with("HTTP/1.1 "), "{answer:?}");
    assert!(!answer.starts_with("HTTP/1.1 2"), "{answer:?}");
    gateway.shutdown().await;
}

#[tokio::test(start_paused = true)]
async fn a_user_of_large_documents_waits_and_its_stop_does_not() {
    const BYTES: usize = 16 * 1024 * 1024;
    let users = TestUsers::new();
    let port = StubPort::with(|request| {
        Ok(match request {
            Request::Command { meta, .. } => {
                Answer::Command(reply(&meta.command_id, CommandStatus::Accepted, "ok"))
            }
            _ => Answer::Program(ProgramText {
                text: " ".repeat(BYTES),
                hash: "0".into(),
            }),
        })
    });
    let shared = shared_with(port, users.settings.tokens.clone());
    let router = crate::http::router(Arc::clone(&shared), None);
    let call = async |method: &str, path: &str, name: &str| {
        let request = axum::http::Request::builder()
            .method(method)
            .uri(format!("/api/v1{path}"))
            .header("host", "127.0.0.1:8080")
            .header("authorization", format!("Bearer {}", users.token(name)))
            .body(axum::body::Body::empty())
            .unwrap();
        let response = tower::ServiceExt::oneshot(router.clone(), request).await.unwrap();
        response.status().as_u16()
    };
    // 128 MiB at once, 32 MiB per second
    for _ in 0..=128 * 1024 * 1024 / BYTES {
        assert_eq!(call("GET", "/programs/1", "operate").await, 200);
    }
    assert_eq!(call("GET", "/cs/1/state", "operate").await, 429);
    assert_eq!(call("POST", "/cs/1/stop", "operate").await, 202);
    assert_eq!(call("GET", "/cs/1/state", "view").await, 200);
    tokio::time::advance(Duration::from_secs(1)).await;
    assert_eq!(call("GET", "/cs/1/state", "operate").await, 200);
}
