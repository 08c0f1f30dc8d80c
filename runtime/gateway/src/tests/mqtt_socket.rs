//! MQTT over WebSocket, at `/mqtt`.

use futures_util::{SinkExt, StreamExt};
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::{Error, Message as Frame};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream};

use super::*;
use crate::mqtt_socket::SOCKETS_MAX;

type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;

async fn open_with(gateway: &Gateway, headers: &[(&'static str, &str)]) -> Result<Socket, Error> {
    let mut request = format!("ws://{}/mqtt", gateway.http_addr())
        .into_client_request()
        .unwrap();
    for (name, value) in headers {
        request.headers_mut().insert(*name, value.parse().unwrap());
    }
    let (socket, answer) = within(Box::pin(tokio_tungstenite::connect_async(request))).await?;
    assert_eq!(answer.headers()["sec-websocket-protocol"], "mqtt");
    Ok(socket)
}

async fn open(gateway: &Gateway) -> Result<Socket, Error> {
    open_with(gateway, &[("sec-websocket-protocol", "mqtt")]).await
}

fn status(opened: Result<Socket, Error>) -> u16 {
    match opened.err() {
        Some(Error::Http(answer)) => answer.status().as_u16(),
        other => panic!("{other:?}"),
    }
}

/// Returns the next packet; `None` if the connection has ended.
async fn next(socket: &mut Socket) -> Option<Vec<u8>> {
    loop {
        match within(socket.next()).await {
            Some(Ok(Frame::Binary(bytes))) => return Some(bytes.to_vec()),
            Some(Ok(Frame::Close(_)) | Err(_)) | None => return None,
            Some(Ok(_)) => {}
        }
    }
}

async fn served() -> (TestUsers, Gateway, Arc<StubPort>) {
    let mut users = TestUsers::new();
    users.settings.mqtt.websocket = true;
    let port = StubPort::new();
    let gateway = start_with(&port, users.settings.clone()).await;
    (users, gateway, port)
}

#[tokio::test]
async fn a_page_speaks_mqtt_over_a_websocket_with_its_token_as_over_tcp() {
    let (users, gateway, _port) = served().await;
    for version in [4, 5] {
        let mut socket = open(&gateway).await.unwrap();
        let connect = connect_packet(version, "view", users.token("view"));
        // a packet may come in several frames
        for part in [&connect[..7], &connect[7..]] {
            socket.send(Frame::binary(part.to_vec())).await.unwrap();
        }
        let answer = next(&mut socket).await.unwrap();
        assert_eq!((answer[0], answer[3]), (0x20, 0), "MQTT {version}");
        let topic = b"tandem/v1/mill-1/presence";
        let length = u16::try_from(topic.len()).unwrap().to_be_bytes();
        let properties: &[u8] = if version == 5 { &[0] } else { &[] };
        let subscribe = packet(0x82, &[&[0, 1], properties, &length, topic, &[0]]);
        // and a frame may hold several
        let both = [subscribe, vec![0xc0, 0]].concat();
        socket.send(Frame::binary(both)).await.unwrap();
        let mut kinds = Vec::new();
        while !(kinds.contains(&0x30) && kinds.contains(&0x90) && kinds.contains(&0xd0)) {
            let packet = next(&mut socket).await.unwrap();
            if packet[0] & 0xf0 == 0x30 {
                assert!(String::from_utf8_lossy(&packet).contains("\"online\":true"));
            }
            kinds.push(packet[0] & 0xf0);
        }
    }
}

#[tokio::test]
async fn mqtt_over_websocket_requires_a_token_and_rejects_foreign_origins() {
    let (users, gateway, _port) = served().await;
    for (user, password) in [("view", "guessed"), ("admin", users.token("view")), ("", "")] {
        let mut socket = open(&gateway).await.unwrap();
        let connect = connect_packet(5, user, password);
        socket.send(Frame::binary(connect)).await.unwrap();
        let answer = next(&mut socket).await.unwrap();
        assert_eq!(answer[0], 0x20);
        assert_ne!(answer[3], 0, "{user}");
        assert_eq!(next(&mut socket).await, None);
    }
    let foreign = [
        ("sec-websocket-protocol", "mqtt"),
        ("origin", "http://evil.example"),
    ];
    assert_eq!(status(open_with(&gateway, &foreign).await), 403);
    let mut socket = open(&gateway).await.unwrap();
    socket.send(Frame::text("CONNECT")).await.unwrap();
    assert_eq!(next(&mut socket).await, None, "text is no MQTT");
    let off = start_with(&StubPort::new(), TestUsers::new().settings).await;
    assert_eq!(status(open(&off).await), 404, "it is off unless it is asked for");
}

#[tokio::test]
async fn silent_mqtt_websockets_are_limited_and_leave_other_services_free() {
    let (users, gateway, _port) = served().await;
    let mut silent = Vec::new();
    for _ in 0..SOCKETS_MAX {
        silent.push(open(&gateway).await.unwrap());
    }
    assert_eq!(status(open(&gateway).await), 503);
    let url = format!("http://{}/api/v1/cs/1/state", gateway.http_addr());
    let mut stream = TcpStream::connect(gateway.http_addr()).await.unwrap();
    let request = format!(
        "GET {url} HTTP/1.1\r\nhost: {}\r\nauthorization: Bearer {}\r\nconnection: close\r\n\r\n",
        gateway.http_addr(),
        users.token("view")
    );
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut answer = String::new();
    within(stream.read_to_string(&mut answer)).await.unwrap();
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    let (_stream, answer) = mqtt_as(&gateway, 5, "view", users.token("view")).await;
    assert_eq!(answer, [0x20, 0]);
    drop(silent);
}
