//! Foreign pages: those of a machine builder in the folder of `[hmi]`, and those of allowed origins.

use axum::body::Body;
use axum::http::{HeaderMap, Request as HttpRequest, StatusCode};
use http_body_util::BodyExt;
use plc_protocol::wire::hmi::{Hmi, HmiButton};
use serde_json::Value;
use tower::ServiceExt;

use super::*;
use crate::HmiSettings;

const ALLOWED: &str = "https://hmi.example.com";

/// A server open to pages of [`ALLOWED`], with its users.
fn open_to_others() -> (TestUsers, Arc<ServerState>) {
    let users = TestUsers::new();
    let mut shared = Arc::into_inner(shared_with(StubPort::new(), users.settings.tokens.clone())).unwrap();
    shared.access = shared.access.allow_origins(&[ALLOWED.to_owned()]);
    (users, Arc::new(shared))
}

fn serving(dir: &std::path::Path) -> Arc<ServerState> {
    let added = Hmi {
        buttons: vec![HmiButton {
            text: "Oil".into(),
            m_code: Some(60),
            ..HmiButton::default()
        }],
        ..Hmi::default()
    };
    let hmi = HmiSettings {
        dir: Some(dir.to_owned()),
        added,
        ..HmiSettings::default()
    };
    Arc::new(Arc::into_inner(shared(StubPort::new())).unwrap().with_hmi(hmi))
}

async fn ask(
    shared: &Arc<ServerState>,
    (method, path): (&str, &str),
    headers: &[(&str, &str)],
) -> (StatusCode, HeaderMap, String) {
    let mut request = HttpRequest::builder()
        .method(method)
        .uri(path)
        .header("host", "127.0.0.1:8080");
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    let request = request.body(Body::empty()).unwrap();
    let response = crate::http::router(Arc::clone(shared), None)
        .oneshot(request)
        .await
        .unwrap();
    let (head, body) = response.into_parts();
    let body = body.collect().await.unwrap().to_bytes();
    (
        head.status,
        head.headers,
        String::from_utf8_lossy(&body).into_owned(),
    )
}

#[tokio::test]
async fn allowed_origin_needs_a_token_and_other_origins_are_refused() {
    let (users, shared) = open_to_others();
    let token = format!("Bearer {}", users.token("view"));
    let state = ("GET", "/api/v1/cs/1/state");
    let origin = ("origin", ALLOWED);
    let allowed = |headers: &HeaderMap| {
        let allowed = headers.get("access-control-allow-origin");
        allowed.map(|origin| origin.to_str().unwrap().to_owned())
    };

    let (status, headers, _) = ask(&shared, state, &[origin, ("authorization", &token)]).await;
    assert_eq!((status.as_u16(), allowed(&headers)), (200, Some(ALLOWED.into())));
    assert!(!headers.contains_key("access-control-allow-credentials"));
    let (status, headers, _) = ask(&shared, state, &[origin]).await;
    assert_eq!(
        (status.as_u16(), allowed(&headers)),
        (401, Some(ALLOWED.into())),
        "it reads why"
    );

    // the browser's preflight request before it sends a command of that page
    let preflight = [
        ("access-control-request-method", "POST"),
        (
            "access-control-request-headers",
            "authorization,content-type,idempotency-key",
        ),
    ];
    let before = ("OPTIONS", "/api/v1/cs/1/start");
    let (status, headers, _) = ask(&shared, before, &[&[origin][..], &preflight].concat()).await;
    assert_eq!((status.as_u16(), allowed(&headers)), (200, Some(ALLOWED.into())));
    let methods = headers["access-control-allow-methods"].to_str().unwrap();
    assert!(methods.contains("POST") && methods.contains("PUT"), "{methods}");

    for other in [
        "https://evil.example.com",
        "http://hmi.example.com",
        "https://hmi.example.com:8443",
        "null",
    ] {
        let other = ("origin", other);
        for (asked, more) in [
            (state, &[("authorization", token.as_str())][..]),
            (before, &preflight),
        ] {
            let (status, headers, body) = ask(&shared, asked, &[&[other][..], more].concat()).await;
            assert_eq!(
                (status.as_u16(), allowed(&headers)),
                (403, None),
                "{other:?} {asked:?}"
            );
            assert!(body.contains("foreign_origin"), "{body}");
        }
    }
}

#[tokio::test]
async fn without_allowed_origins_no_page_of_others_is_told_that_it_may_read() {
    let shared = shared(StubPort::new());
    let (status, headers, _) = ask(&shared, ("GET", "/api/v1/cs/1/state"), &[]).await;
    assert_eq!(status, 200);
    assert!(!headers.contains_key("access-control-allow-origin"));
    let (status, ..) = ask(&shared, ("OPTIONS", "/api/v1/cs/1/start"), &[("origin", ALLOWED)]).await;
    assert_eq!(status, 403);
}

#[tokio::test]
async fn machine_builder_pages_are_served_like_the_hmi_without_other_files() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("hmi");
    std::fs::create_dir(&dir).unwrap();
    std::fs::write(dir.join("index.html"), "<html>ours").unwrap();
    std::fs::write(dir.join("oil.js"), "export default 1;").unwrap();
    std::fs::write(folder.path().join("tokens.json"), "secret").unwrap();
    let shared = serving(&dir);

    let (status, headers, body) = ask(&shared, ("GET", "/hmi/"), &[]).await;
    assert_eq!((status.as_u16(), body.as_str()), (200, "<html>ours"));
    assert_eq!(headers["content-type"], "text/html; charset=utf-8");
    assert_eq!(headers["x-content-type-options"], "nosniff");
    assert_eq!(headers["cache-control"], "no-cache");
    let policy = headers["content-security-policy"].to_str().unwrap();
    assert!(
        policy.contains("default-src 'self'") && policy.contains("frame-ancestors 'none'"),
        "{policy}"
    );
    let tag = headers["etag"].to_str().unwrap();
    let (status, _, body) = ask(&shared, ("GET", "/hmi/index.html"), &[("if-none-match", tag)]).await;
    assert_eq!((status.as_u16(), body.as_str()), (304, ""));
    let (status, headers, _) = ask(&shared, ("GET", "/hmi"), &[]).await;
    assert_eq!(
        (status.as_u16(), headers["location"].to_str().unwrap()),
        (308, "/hmi/")
    );
    std::fs::write(dir.join("oil.js"), "export default 2;\n").unwrap();
    let (_, headers, body) = ask(&shared, ("GET", "/hmi/oil.js"), &[]).await;
    assert_eq!(body, "export default 2;\n", "as it is on the disk now");
    assert!(
        headers["content-type"]
            .to_str()
            .unwrap()
            .starts_with("text/javascript")
    );

    for path in [
        "/hmi/../tokens.json",
        "/hmi/%2e%2e/tokens.json",
        "/hmi/..%2ftokens.json",
        "/hmi/%2e%2e%2ftokens.json",
        "/hmi/..%5ctokens.json",
        "/hmi//etc/hosts.txt",
        "/hmi/none.js",
    ] {
        let (status, _, body) = ask(&shared, ("GET", path), &[]).await;
        assert_eq!(status, 404, "{path}: {body}");
    }
    assert_eq!(ask(&shared, ("POST", "/hmi/oil.js"), &[]).await.0, 405);
    let (_, _, added) = ask(&shared, ("GET", "/api/v1/hmi"), &[]).await;
    let added: Value = serde_json::from_str(&added).unwrap();
    assert_eq!(
        added["buttons"][0],
        serde_json::json!({"text": "Oil", "m_code": 60})
    );
    let (status, ..) = ask(&self::shared(StubPort::new()), ("GET", "/hmi/"), &[]).await;
    assert_eq!(status, 404, "without a folder there is none");
}
