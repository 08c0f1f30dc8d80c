//! MTConnect: off by default, for users who may read, and its adapter on the loopback only.

use axum::body::Body;
use axum::http::{Request as HttpRequest, header};
use plc_protocol::supervisor::Supervisor;
use tandem_mtconnect::{Agent, AgentSettings};
use tokio_util::sync::CancellationToken;
use tower::ServiceExt;

use super::*;
use crate::MtconnectSettings;
use crate::http::router;

async fn status(shared: &Arc<ServerState>, agent: Option<&Agent>, method: &str, token: Option<&str>) -> u16 {
    let mut request = HttpRequest::builder()
        .method(method)
        .uri("/mtconnect/current")
        .header(header::HOST, "127.0.0.1:8080");
    if let Some(token) = token {
        request = request.header(header::AUTHORIZATION, format!("Bearer {token}"));
    }
    let request = request.body(Body::empty()).unwrap();
    let response = router(Arc::clone(shared), agent).oneshot(request).await.unwrap();
    response.status().as_u16()
}

#[tokio::test]
async fn mtconnect_is_off_by_default_and_readable_on_loopback_without_users() {
    let port = StubPort::new();
    let shared = shared(Arc::clone(&port));
    assert_eq!(status(&shared, None, "GET", None).await, 404);
    let agent = Agent::start(
        port,
        AgentSettings::default(),
        CancellationToken::new(),
        Supervisor::default(),
    )
    .await;
    assert_eq!(status(&shared, Some(&agent), "GET", None).await, 200);
    for method in ["POST", "PUT", "DELETE"] {
        assert_eq!(status(&shared, Some(&agent), method, None).await, 405, "{method}");
    }
}

#[tokio::test]
async fn where_there_are_users_it_is_for_those_who_may_read() {
    let port = StubPort::new();
    let users = TestUsers::new();
    let shared = shared_with(Arc::clone(&port), users.settings.tokens.clone());
    let agent = Agent::start(
        port,
        AgentSettings::default(),
        CancellationToken::new(),
        Supervisor::default(),
    )
    .await;
    assert_eq!(status(&shared, Some(&agent), "GET", None).await, 401);
    assert_eq!(status(&shared, Some(&agent), "GET", Some("wrong")).await, 401);
    assert_eq!(
        status(&shared, Some(&agent), "GET", Some(users.token("view"))).await,
        200
    );
}

#[test]
fn the_adapter_knows_no_users_and_is_refused_anywhere_but_on_the_loopback() {
    let with = |listen: &str| {
        let settings = GatewaySettings {
            mtconnect: Some(MtconnectSettings {
                shdr_listen: Some(listen.to_owned()),
                ..MtconnectSettings::default()
            }),
            ..GatewaySettings::default()
        };
        settings
            .problems()
            .iter()
            .map(ToString::to_string)
            .collect::<Vec<_>>()
            .join(" ")
    };
    assert_eq!(with("127.0.0.1:7878"), "");
    assert_eq!(with("[::1]:7878"), "");
    assert!(
        with("0.0.0.0:7878").contains("SHDR has no users"),
        "{}",
        with("0.0.0.0:7878")
    );
    assert!(with("here").contains("[mtconnect] shdr_listen"));
}
