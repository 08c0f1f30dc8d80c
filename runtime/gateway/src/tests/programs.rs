//! Programs over REST, and which one a client has, and means: `ETag`, `If-None-Match`, `If-Match`.

use plc_protocol::types::command::Expect;
use plc_protocol::types::planned::{PathQuery, PlannedPath};
use plc_protocol::types::program::{ProgramCheck, ProgramText};
use plc_protocol::types::upload::{Hashes, ProgramCondition, ProgramUpload};

use serde_json::json;

use super::rest::{call, json_of, text};
use super::*;

const PATH: &str = "/api/v1/programs/7";

/// A machine whose program 7 has this hash.
fn port(hash: &str) -> Arc<StubPort> {
    let hash = hash.to_owned();
    StubPort::with(move |request| {
        Ok(match request {
            Request::WriteProgram(..) | Request::StoreProgram(..) => Answer::Check(ProgramCheck {
                hash: hash.clone(),
                ..ProgramCheck::default()
            }),
            Request::FetchProgram(_) => Answer::Program(ProgramText {
                text: "M30\n".into(),
                hash: hash.clone(),
            }),
            _ => Answer::Done,
        })
    })
}

fn hash() -> String {
    "0123456789abcdef".repeat(4)
}

#[tokio::test]
async fn programs_are_written_read_checked_and_removed_as_text() {
    let created = std::sync::atomic::AtomicBool::new(true);
    let port = StubPort::with(move |request| {
        Ok(match request {
            Request::WriteProgram(..) => Answer::Check(ProgramCheck {
                created: created.swap(false, std::sync::atomic::Ordering::Relaxed),
                ..ProgramCheck::default()
            }),
            Request::CheckProgram(_) => Answer::Check(ProgramCheck::default()),
            Request::FetchProgram(_) => Answer::Program(ProgramText {
                text: "G01 X1 (\u{e4})\n".into(),
                hash: "a1".into(),
            }),
            Request::IntermediateCode(7) => Answer::ProgramText("open prog 7\nclose\n".into()),
            _ => Answer::Done,
        })
    });
    let path = "/api/v1/programs/7";
    let plain = [("content-type", "text/plain")];
    let response = call(&port, "PUT", path, &plain, "G01 X1\r\n").await;
    assert_eq!(response.status(), 201);
    assert_eq!(json_of(response).await["diagnostics"], json!([]));
    assert_eq!(call(&port, "PUT", path, &[], "G01 X1\r\n").await.status(), 200);
    assert_eq!(port.asked()[0], Request::WriteProgram(7, "G01 X1\r\n".into()));
    let response = call(&port, "GET", path, &[], "").await;
    assert_eq!(response.headers()["content-type"], "text/plain; charset=utf-8");
    assert_eq!(text(response).await, "G01 X1 (\u{e4})\n");
    assert_eq!(
        call(&port, "POST", "/api/v1/programs/7/check", &[], "")
            .await
            .status(),
        200
    );
    let response = call(&port, "GET", "/api/v1/programs/7/intermediate", &[], "").await;
    assert_eq!(response.headers()["content-type"], "text/plain; charset=utf-8");
    assert_eq!(text(response).await, "open prog 7\nclose\n");
    assert_eq!(call(&port, "DELETE", path, &[], "").await.status(), 204);
    assert_eq!(port.asked().pop(), Some(Request::DeleteProgram(7)));
}

#[tokio::test]
async fn a_program_is_known_by_its_etag_and_not_sent_to_who_has_it() {
    let port = port(&hash());
    let etag = format!("\"{}\"", hash());
    let response = call(&port, "GET", PATH, &[], "").await;
    assert_eq!(response.headers()["etag"], etag.as_str());
    for tags in [
        etag.clone(),
        format!("W/{etag}"),
        "*".into(),
        format!("\"x\", {etag}"),
    ] {
        let response = call(&port, "GET", PATH, &[("if-none-match", &tags)], "").await;
        assert_eq!(response.status(), 304);
        assert_eq!(response.headers()["etag"], etag.as_str());
        assert_eq!(text(response).await, "");
    }
    let response = call(&port, "GET", PATH, &[("if-none-match", "\"x\"")], "").await;
    assert_eq!(response.status(), 200);
}

#[tokio::test]
async fn a_change_and_a_command_carry_the_condition_that_the_headers_say() {
    let port = port(&hash());
    let etag = format!("\"{}\"", hash());
    let is_hash = || Some(Hashes::OneOf(vec![hash()]));
    let condition = [("if-match", etag.as_str()), ("program-signature", " AAAA ")];
    let path = format!("{PATH}?dialect=dgshape");
    let response = call(&port, "PUT", &path, &condition, "M30\n").await;
    assert_eq!(response.headers()["etag"], etag.as_str());
    let upload = ProgramUpload {
        text: "M30\n".into(),
        condition: ProgramCondition {
            if_match: is_hash(),
            if_none_match: None,
        },
        signature: Some("AAAA".into()),
        dialect: Some("dgshape".into()),
    };
    assert_eq!(port.asked().pop(), Some(Request::StoreProgram(7, upload)));
    call(&port, "PUT", PATH, &[("if-none-match", "*")], "M30\n").await;
    let Some(Request::StoreProgram(7, upload)) = port.asked().pop() else {
        panic!("{:?}", port.asked());
    };
    assert_eq!(upload.condition.if_none_match, Some(Hashes::Any));
    call(&port, "DELETE", PATH, &[("if-match", &hash())], "").await;
    let Some(Request::RemoveProgram(7, condition)) = port.asked().pop() else {
        panic!("{:?}", port.asked());
    };
    assert_eq!(condition.if_match, is_hash());
    for (method, header) in [
        ("PUT", "if-match"),
        ("PUT", "if-none-match"),
        ("DELETE", "if-match"),
    ] {
        let response = call(&port, method, PATH, &[(header, "\"12\"")], "M30\n").await;
        assert_eq!(response.status(), 400, "{method} {header}");
    }
    let both = format!("\"3\", {etag}");
    call(&port, "POST", "/api/v1/cs/1/start", &[("if-match", &both)], "").await;
    let Some(Request::Command { meta, .. }) = port.asked().pop() else {
        panic!("{:?}", port.asked());
    };
    let expect = Expect {
        state_rev: Some(3),
        hash: Some(hash()),
        ..Expect::default()
    };
    assert_eq!(meta.expect, Some(expect));
}

#[tokio::test]
async fn a_planned_path_is_bytes_with_an_etag_and_its_query_says_which_part() {
    let port = StubPort::with(|request| {
        Ok(match request {
            Request::PlannedPath(..) => Answer::Path(PlannedPath {
                tag: "a-1-all".into(),
                bytes: vec![0x54, 0xff, 0x00],
                ..PlannedPath::default()
            }),
            _ => Answer::Done,
        })
    });
    let path = format!("{PATH}/path?cs=2&tolerance=0.5&from=3&count=4");
    let response = call(&port, "GET", &path, &[], "").await;
    assert_eq!(response.headers()["content-type"], "application/octet-stream");
    assert_eq!(response.headers()["etag"], "\"a-1-all\"");
    let bytes = axum::body::to_bytes(response.into_body(), 100).await.unwrap();
    assert_eq!(*bytes, [0x54, 0xff, 0x00]);
    let query = PathQuery {
        cs: Some(2),
        tolerance: Some(0.5),
        from: 3,
        count: Some(4),
    };
    assert_eq!(port.asked().pop(), Some(Request::PlannedPath(7, query)));
    let had = [("if-none-match", "\"a-1-all\"")];
    assert_eq!(call(&port, "GET", &path, &had, "").await.status(), 304);
    for query in ["tolerance=0.001", "tolerance=NaN", "cs=x", "level=1"] {
        let response = call(&port, "GET", &format!("{PATH}/path?{query}"), &[], "").await;
        assert_eq!(response.status(), 400, "{query}");
    }
}
