//! Connections that were opened with a token or a login end with it.

use futures_util::StreamExt;
use tokio::io::AsyncReadExt;
use tokio::net::TcpStream;
use tokio::time::Instant;
use tokio_tungstenite::client_async;
use tokio_tungstenite::tungstenite::Message as Frame;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;

use super::*;
use crate::access::login::LOGIN_MAX;
use crate::{Role, Tokens, pin_entry};

/// A machine with one person, and a login of hers.
async fn with_login() -> (Gateway, String) {
    let person = pin_entry("anna", Role::Operate, "493021", None).unwrap();
    let mut settings = settings();
    settings.tokens = Some(Arc::new(Tokens::parse(&person).unwrap()));
    // so that twelve hours pass quickly
    settings.position_interval_ms = 10_000;
    settings.login_idle = None;
    let gateway = start_with(&StubPort::new(), settings).await;
    let users = gateway.shared.access.users().unwrap();
    let from = std::net::Ipv4Addr::LOCALHOST.into();
    let login = users
        .logins
        .log_in(&users.tokens.now(), "anna", "493021".into(), from)
        .await;
    let (token, _) = login.unwrap();
    (gateway, token)
}

/// Waits for the end of a WebSocket that is opened with a token: how long it takes, its code and its reason.
async fn end_of_websocket(gateway: &Gateway, token: &str, then: impl FnOnce()) -> (Duration, u16, String) {
    let address = gateway.http_addr();
    let mut request = format!("ws://{address}/api/v1/ws").into_client_request().unwrap();
    let protocols = format!("tandem.v1, bearer.{token}").parse().unwrap();
    request.headers_mut().insert("sec-websocket-protocol", protocols);
    let stream = TcpStream::connect(address).await.unwrap();
    let (mut socket, _) = client_async(request, stream).await.unwrap();
    let begun = Instant::now();
    then();
    loop {
        if let Frame::Close(Some(frame)) = socket.next().await.unwrap().unwrap() {
            return (begun.elapsed(), frame.code.into(), frame.reason.to_string());
        }
    }
}

#[tokio::test(start_paused = true)]
async fn websocket_of_a_login_is_closed_at_its_expiry_or_logout() {
    let (gateway, token) = with_login().await;
    let (after, code, reason) = end_of_websocket(&gateway, &token, || {}).await;
    assert_eq!(
        (code, reason.as_str()),
        (1008, "the login has ended; log in again")
    );
    let late = after.abs_diff(LOGIN_MAX);
    assert!(late < Duration::from_secs(1), "{after:?}");

    let (gateway, token) = with_login().await;
    let log_out = || {
        let users = gateway.shared.access.users().unwrap();
        assert!(users.logins.log_out(token.as_bytes()));
    };
    let (after, code, reason) = end_of_websocket(&gateway, &token, log_out).await;
    assert_eq!(
        (code, reason.as_str()),
        (1008, "the login has ended; log in again")
    );
    assert!(after < Duration::from_secs(1), "{after:?}");
}

#[tokio::test]
async fn the_token_of_a_login_lets_into_the_broker_until_the_login_ends() {
    let (gateway, token) = with_login().await;
    let (_, refused) = mqtt_as(&gateway, 5, "anna", &"0".repeat(64)).await;
    assert_eq!(refused, [0x20, 0x86], "bad user name or password");
    let (mut new, connected) = mqtt_as(&gateway, 5, "anna", &token).await;
    assert_eq!(connected, [0x20, 0]);
    let (mut old, connected) = mqtt_as(&gateway, 4, "anna", &token).await;
    assert_eq!(connected, [0x20, 0]);
    assert!(
        gateway
            .shared
            .access
            .users()
            .unwrap()
            .logins
            .log_out(token.as_bytes())
    );
    let mut rest = Vec::new();
    within(new.read_to_end(&mut rest)).await.unwrap();
    // MQTT 5 section 3.14: 0xa0, maximum connect time, with its reason
    assert_eq!((rest[0], rest[2]), (0xe0, 0xa0), "{rest:?}");
    assert!(rest.ends_with(b"the login has ended; log in again"));
    let mut rest = Vec::new();
    within(old.read_to_end(&mut rest)).await.unwrap();
    assert!(rest.is_empty(), "MQTT 3.1.1 has no word for it: {rest:?}");
    gateway.shutdown().await;
}
