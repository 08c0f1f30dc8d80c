//! Connection slots that are reserved for users who may stop a machine.

use super::*;

/// Known clients of a broker, without those who may operate.
const OTHERS: usize = 256 - 32;

#[tokio::test]
async fn the_last_places_of_the_broker_are_for_users_who_may_operate() {
    let users = TestUsers::new();
    let gateway = start_with(&StubPort::new(), users.settings.clone()).await;
    let mut clients = Vec::new();
    let refused = loop {
        let (client, answer) = mqtt_as(&gateway, 5, "view", users.token("view")).await;
        if answer[1] != 0 {
            break answer;
        }
        clients.push(client);
    };
    // MQTT 5 section 3.2.2.2: 0x89, server busy
    assert_eq!(refused, [0x20, 0x89]);
    // the runtime itself has a slot, too
    assert_eq!(clients.len(), OTHERS, "of 256");
    assert_eq!(
        mqtt_as(&gateway, 5, "handler", users.token("handler")).await.1,
        [0x20, 0x89]
    );
    for name in ["operate", "admin"].repeat(16) {
        let (client, answer) = mqtt_as(&gateway, 4, name, users.token(name)).await;
        assert_eq!(answer, [0x20, 0], "{name}");
        clients.push(client);
    }
    // MQTT 3.1.1 section 3.2.2.3: 3, server unavailable
    assert_eq!(
        mqtt_as(&gateway, 4, "admin", users.token("admin")).await.1,
        [0x20, 3]
    );
    gateway.shutdown().await;
}

/// A connection over HTTP, after a request.
async fn send(gateway: &Gateway, head: &str, body: &str) -> TcpStream {
    let address = gateway.http_addr();
    let mut stream = TcpStream::connect(address).await.unwrap();
    let length = body.len();
    let request = format!(
        "{head} HTTP/1.1\r\nHost: {address}\r\nContent-Type: application/json\r\nContent-Length: {length}\r\n\r\n{body}"
    );
    stream.write_all(request.as_bytes()).await.unwrap();
    stream
}

async fn answer(mut stream: TcpStream) -> String {
    let mut bytes = vec![0; 4096];
    let count = within(stream.read(&mut bytes)).await.unwrap();
    String::from_utf8_lossy(&bytes[..count]).into_owned()
}

#[tokio::test]
async fn while_all_connections_are_busy_only_what_brings_to_rest_is_taken() {
    let port = StubPort::new();
    let gateway = start(&port).await;
    port.silent.store(true, Ordering::Relaxed);
    let mut busy = Vec::new();
    for _ in 0..224 {
        busy.push(send(&gateway, "PUT /api/v1/cs/1/inputs/dry_run", "{\"value\":true}").await);
    }
    within(async {
        while port.asked().len() < 224 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    })
    .await;
    port.silent.store(false, Ordering::Relaxed);
    for head in [
        "GET /api/v1/health",
        "POST /api/v1/cs/1/start",
        "GET /api/v1/cs/1/state",
    ] {
        let answer = answer(send(&gateway, head, "").await).await;
        assert!(
            answer.starts_with("HTTP/1.1 503") && answer.contains("hold, stop and abort"),
            "{head}: {answer}"
        );
    }
    for verb in ["hold", "stop", "abort"] {
        let head = format!("POST /api/v1/cs/1/{verb}");
        let answer = answer(send(&gateway, &head, "{}").await).await;
        assert!(answer.starts_with("HTTP/1.1 202"), "{verb}: {answer}");
    }
    // as soon as one is done, there is a free slot again
    drop(busy.pop());
    within(async {
        while !answer(send(&gateway, "GET /api/v1/health", "").await)
            .await
            .starts_with("HTTP/1.1 200")
        {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    })
    .await;
    gateway.shutdown().await;
}

#[tokio::test]
async fn slow_requests_of_strangers_keep_no_new_connection_out() {
    let port = StubPort::new();
    let users = TestUsers::new();
    let gateway = start_with(&port, users.settings.clone()).await;
    let mut slow = Vec::new();
    for _ in 0..crate::server::SLOT_LIMITS.unauthenticated {
        let mut stream = TcpStream::connect(gateway.http_addr()).await.unwrap();
        let address = gateway.http_addr();
        let head = format!(
            "POST /api/v1/login HTTP/1.1\r\nHost: {address}\r\nContent-Type: application/json\r\nContent-Length: 50\r\n\r\n"
        );
        stream.write_all(head.as_bytes()).await.unwrap();
        slow.push(stream);
    }
    // each of them is being served
    tokio::time::sleep(Duration::from_millis(500)).await;
    let token = users.token("operate");
    let address = gateway.http_addr();
    for verb in ["hold", "stop", "abort"] {
        let mut stream = TcpStream::connect(address).await.unwrap();
        let request = format!(
            "POST /api/v1/cs/1/{verb} HTTP/1.1\r\nHost: {address}\r\nAuthorization: Bearer {token}\r\nContent-Length: 0\r\n\r\n"
        );
        stream.write_all(request.as_bytes()).await.unwrap();
        let answer = answer(stream).await;
        assert!(answer.starts_with("HTTP/1.1 202"), "{verb}: {answer}");
    }
    gateway.shutdown().await;
}
