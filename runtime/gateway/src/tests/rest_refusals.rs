//! Every refusal is problem details with a code.

use axum::body::Body;
use axum::http::Response;
use plc_api::types::command::Verb;
use plc_api::types::program::{DiagnosticSeverity, ProgramDiagnostic};
use plc_api::types::request::RefusalCode;
use plc_api::types::state::Execution;
use serde_json::json;

use super::rest::{JSON, call, json_of};
use super::*;

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
    let load = "/cs/1/load";
    refused(&[
        ("POST", load, &[JSON], "{", invalid),
        ("POST", load, &[], "", invalid),
        ("POST", load, &[JSON], r#"{"program":70000}"#, invalid),
        ("POST", load, &[], r#"{"program":1}"#, wrong_type),
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
