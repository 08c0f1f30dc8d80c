//! Every refusal is problem details with a code.

use axum::body::Body;
use axum::http::Response;
use plc_protocol::types::command::Verb;
use plc_protocol::types::program::{DiagnosticSeverity, ProgramDiagnostic};
use plc_protocol::types::request::RefusalCode;
use plc_protocol::types::state::Execution;
use serde_json::json;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use super::rest::{JSON, call, json_of};
use super::*;

/// Content type that curl sends with `-d`.
const FORM: (&str, &str) = ("content-type", "application/x-www-form-urlencoded");

/// Status and code, after looking that it is a problem.
async fn problem(response: Response<Body>) -> (u16, String) {
    assert_eq!(response.headers()["content-type"], "application/problem+json");
    let status = response.status().as_u16();
    let body = json_of(response).await;
    assert_eq!(body["status"], status);
    assert!(
        body["detail"].as_str().is_some_and(|detail| !detail.is_empty()),
        "{body}"
    );
    (status, body["code"].as_str().unwrap().to_owned())
}

/// Method, path, headers, body, and the status and code to expect.
type Case<'a> = (
    &'a str,
    &'a str,
    &'a [(&'a str, &'a str)],
    &'a str,
    (u16, &'a str),
);

async fn refused(cases: &[Case<'_>]) {
    let port = StubPort::new();
    for (method, path, headers, body, expected) in cases {
        let path = format!("/api/v1{path}");
        let response = call(&port, method, &path, headers, (*body).to_owned()).await;
        let allow = response.headers().contains_key("allow");
        let (status, code) = problem(response).await;
        assert_eq!((status, code.as_str()), *expected, "{method} {path} {body:.40}");
        assert_eq!(allow, status == 405, "{method} {path}");
    }
    assert_eq!(port.asked(), [], "a refusal asks the port nothing");
}

#[tokio::test]
async fn what_is_not_there_or_not_for_that_method_is_a_problem() {
    let (missing, wrong) = ((404, "not_found"), (405, "method_not_allowed"));
    let on = r#"{"value":true}"#;
    refused(&[
        ("GET", "/nothing", &[], "", missing),
        ("GET", "/cs/9/state", &[], "", missing),
        ("GET", "/cs/x/state", &[], "", missing),
        ("GET", "/cs/9/inputs", &[], "", missing),
        ("PUT", "/cs/1/inputs/optional_skip/0", &[JSON], on, missing),
        ("PUT", "/cs/1/inputs/optional_skip/32", &[JSON], on, missing),
        ("DELETE", "/cs/1/state", &[], "", wrong),
        ("GET", "/cs/1/start", &[], "", wrong),
        ("PATCH", "/programs/1", &[], "", wrong),
        ("GET", "/ws", &[], "", (400, "no_websocket")),
    ])
    .await;
}

#[tokio::test]
async fn what_is_malformed_too_large_or_of_another_type_is_a_problem() {
    let (invalid, wrong_type) = ((400, "invalid"), (415, "unsupported_media_type"));
    let large = format!("{{\"program\": {}1}}", " ".repeat(70_000));
    let (load, one) = ("/cs/1/load", r#"{"program":1}"#);
    refused(&[
        ("POST", load, &[JSON], "{", invalid),
        ("POST", load, &[], "", invalid),
        ("POST", load, &[JSON], r#"{"program":70000}"#, invalid),
        ("POST", load, &[("content-type", "text/plain")], one, wrong_type),
        ("POST", load, &[("content-type", "a\u{e9}")], one, wrong_type),
        ("POST", load, &[FORM], "program=1", wrong_type),
        ("POST", load, &[FORM], "[1]", wrong_type),
        ("POST", load, &[], "1", wrong_type),
        // a browser's headers, which identify it
        (
            "POST",
            load,
            &[FORM, ("origin", "http://127.0.0.1:8080")],
            one,
            wrong_type,
        ),
        (
            "POST",
            load,
            &[("origin", "http://127.0.0.1:8080")],
            one,
            wrong_type,
        ),
        (
            "POST",
            load,
            &[FORM, ("sec-fetch-site", "cross-site")],
            one,
            wrong_type,
        ),
        ("POST", load, &[JSON], r#"{"program":1,"other":2}"#, invalid),
        ("POST", "/cs/1/start", &[JSON], one, invalid),
        ("POST", load, &[JSON], &large, (413, "too_large")),
        ("POST", "/cs/1/start?wait=x", &[], "", invalid),
        ("POST", "/cs/1/start", &[("if-match", "*")], "", invalid),
        ("POST", "/cs/1/start", &[("idempotency-key", "")], "", invalid),
        ("PUT", "/cs/1/inputs/dry_run", &[JSON], r#"{"on":true}"#, invalid),
        ("PUT", "/cs/1/overrides", &[JSON], r#"{"fed":1}"#, invalid),
        ("PUT", "/cs/1/overrides", &[JSON], "[50,null,null]", invalid),
        ("POST", "/cs/1/hold", &[JSON], "false", invalid),
        ("PUT", "/programs/1", &[JSON], "G01", wrong_type),
    ])
    .await;
}

#[tokio::test]
async fn json_that_says_nothing_of_its_type_or_what_curl_says_by_itself_counts() {
    for headers in [&[][..], &[FORM], &[JSON]] {
        let port = StubPort::new();
        for (path, body) in [
            ("/api/v1/cs/1/load", r#" {"program":1}"#),
            ("/api/v1/cs/1/start", "{}"),
        ] {
            let response = call(&port, "POST", path, headers, body.to_owned()).await;
            assert_eq!(response.status().as_u16(), 202, "{path} {headers:?}");
        }
        assert_eq!(port.asked().len(), 2);
    }
}

#[tokio::test]
async fn stopping_commands_are_executed_despite_unknown_body_members() {
    let port = StubPort::new();
    for verb in ["hold", "stop", "abort"] {
        let path = format!("/api/v1/cs/1/{verb}");
        let response = call(&port, "POST", &path, &[JSON], r#"{"why":"door"}"#).await;
        assert_eq!(response.status().as_u16(), 202, "{verb}");
    }
    assert_eq!(port.asked().len(), 3);
}

#[tokio::test]
async fn a_body_that_says_that_it_is_too_large_is_not_waited_for() {
    let gateway = start(&StubPort::new()).await;
    for (method, path) in [
        ("POST", "/cs/1/start"),
        ("PUT", "/programs/1"),
        ("GET", "/health"),
    ] {
        let mut stream = TcpStream::connect(gateway.http_addr()).await.unwrap();
        let head = format!(
            "{method} /api/v1{path} HTTP/1.1\r\nHost: {}\r\nContent-Length: 99999999999999\r\n\r\n",
            gateway.http_addr()
        );
        stream.write_all(head.as_bytes()).await.unwrap();
        let mut answer = vec![0; 12];
        within(stream.read_exact(&mut answer)).await.unwrap();
        let expected = if method == "GET" { "200" } else { "413" };
        assert_eq!(answer, format!("HTTP/1.1 {expected}").as_bytes(), "{path}");
    }
    gateway.shutdown().await;
}

/// A body of chunks of this size, one per this time, and the status of its answer with how long it took.
async fn slow_body(size: usize, count: usize, each: Duration) -> (u16, Duration) {
    let port = StubPort::with(|_| {
        Ok(Answer::Check(
            plc_protocol::types::program::ProgramCheck::default(),
        ))
    });
    let begun = tokio::time::Instant::now();
    let chunks = futures_util::stream::unfold(0, move |n| async move {
        tokio::time::sleep(each).await;
        (n < count).then(|| (Ok::<_, std::io::Error>(vec![b' '; size]), n + 1))
    });
    let body = Body::from_stream(chunks);
    let response = call(&port, "PUT", "/api/v1/programs/1", &[], body).await;
    (response.status().as_u16(), begun.elapsed())
}

#[tokio::test(start_paused = true)]
async fn nearly_stalled_body_times_out_and_a_large_slow_one_does_not() {
    let second = Duration::from_secs(1);
    let (status, took) = slow_body(1, 1_000_000, 5 * second).await;
    assert_eq!(status, 408);
    assert!((20..22).contains(&took.as_secs()), "{took:?}");
    // 60 MiB at 64 KiB a second
    let (status, took) = slow_body(64 * 1024, 960, second).await;
    assert_eq!(status, 200);
    assert!(took >= 960 * second, "{took:?}");
}

#[tokio::test(start_paused = true)]
async fn programs_that_wait_for_others_are_told_that_there_is_no_place() {
    let shared = shared(StubPort::new());
    let mut permits = Vec::new();
    for _ in 0..4 {
        permits.push(
            shared
                .large_requests
                .acquire(&crate::access::User::Anyone)
                .await
                .unwrap(),
        );
    }
    let request = axum::http::Request::put("/api/v1/programs/1")
        .header("host", "127.0.0.1:8080")
        .body(Body::from("M30"))
        .unwrap();
    let router = crate::http::router(Arc::clone(&shared), None);
    let response = tower::ServiceExt::oneshot(router, request).await.unwrap();
    assert_eq!(problem(response).await, (503, "unavailable".into()));
}

#[tokio::test]
async fn a_program_that_is_not_utf_8_or_larger_than_64_mib_is_refused() {
    let port = StubPort::new();
    let response = call(&port, "PUT", "/api/v1/programs/1", &[], vec![b'G', 0xff]).await;
    assert_eq!(problem(response).await, (400, "invalid".into()));
    let chunk = axum::body::Bytes::from(vec![b' '; 1024 * 1024]);
    let chunks = (0..65).map(move |_| Ok::<_, std::io::Error>(chunk.clone()));
    let body = Body::from_stream(futures_util::stream::iter(chunks));
    let response = call(&port, "PUT", "/api/v1/programs/1", &[], body).await;
    assert_eq!(problem(response).await, (413, "too_large".into()));
    assert_eq!(port.asked(), []);
}

#[tokio::test]
async fn a_refusal_of_the_machine_keeps_state_allowed_and_diagnostics() {
    let port = StubPort::with(|_| {
        Err(Refusal {
            state: Some(Execution::Active),
            allowed: vec![Verb::Hold],
            diagnostics: vec![ProgramDiagnostic {
                code: "E0001".into(),
                severity: DiagnosticSeverity::Error,
                line: 1,
                column: 2,
                end_line: 1,
                end_column: 3,
                message: "m".into(),
                help: "h".into(),
            }],
            ..Refusal::new(RefusalCode::ProgramHasErrors, "program 7 has 1 error")
        })
    });
    for path in ["/api/v1/cs/1/load", "/api/v1/cs/1/load?wait=1"] {
        let response = call(&port, "POST", path, &[JSON], r#"{"program":7}"#).await;
        assert_eq!(response.status(), 422);
        let body = json_of(response).await;
        assert_eq!(body["code"], "program_has_errors");
        assert_eq!(
            (&body["state"], &body["allowed"]),
            (&json!("ACTIVE"), &json!(["hold"]))
        );
        assert_eq!(body["diagnostics"][0]["code"], "E0001");
    }
}

#[tokio::test]
async fn a_page_of_another_origin_or_host_starts_nothing() {
    let port = StubPort::new();
    for (headers, code) in [
        (vec![("origin", "http://evil.example")], "foreign_origin"),
        (vec![("origin", "null")], "foreign_origin"),
        (vec![("origin", "http://127.0.0.1:9000")], "foreign_origin"),
        (vec![("host", "evil.example:8080")], "foreign_host"),
        (
            vec![
                ("host", "evil.example:8080"),
                ("origin", "http://evil.example:8080"),
            ],
            "foreign_host",
        ),
    ] {
        for (method, path) in [
            ("POST", "/api/v1/cs/1/start"),
            ("GET", "/api/v1/ws"),
            ("GET", "/"),
        ] {
            let response = call(&port, method, path, &headers, "").await;
            assert_eq!(problem(response).await, (403, code.into()), "{headers:?} {path}");
        }
    }
    assert_eq!(port.asked(), []);
    let own = [("origin", "http://127.0.0.1:8080")];
    assert_eq!(
        call(&port, "POST", "/api/v1/cs/1/start", &own, "").await.status(),
        202
    );
}

#[tokio::test]
async fn an_answer_of_another_kind_is_our_fault_and_says_so() {
    let port = StubPort::with(|_| Ok(Answer::Done));
    let response = call(&port, "GET", "/api/v1/programs", &[], "").await;
    assert_eq!(problem(response).await, (500, "unexpected_answer".into()));
}
