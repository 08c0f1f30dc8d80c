//! Reads request bodies, with limits on size and time.

use std::time::Duration;

use axum::body::{Body, HttpBody};
use axum::http::{HeaderMap, StatusCode, header};
use futures_util::StreamExt;
use plc_protocol::wire::PAYLOAD_MAX;
use tokio::time::{Instant, timeout_at};

use crate::problem::Problem;

/// Longest time for a body to arrive; each received byte extends it at [`BODY_RATE_MIN`]. Then 408. Reason: a body that
/// hardly arrives holds a slot, and the largest may need minutes on a slow line.
pub(super) const BODY_MAX: Duration = Duration::from_secs(20);

/// Bytes per second: the largest program takes 17 minutes at this rate.
pub(super) const BODY_RATE_MIN: u32 = 64 * 1024;

/// Content type that curl sends with `-d` by default.
const OF_FORMS: &str = "application/x-www-form-urlencoded";

/// Reads a JSON body; an empty body is `{}`.
pub(super) async fn json(headers: &HeaderMap, body: Body) -> Result<Vec<u8>, Problem> {
    let body = read(body, PAYLOAD_MAX).await?;
    if body.is_empty() {
        return Ok(b"{}".to_vec());
    }
    if !is_json(headers, &body) {
        return Err(unsupported("send JSON with Content-Type: application/json"));
    }
    Ok(body)
}

/// Returns true if a body is meant as JSON. A body without a content type, or with curl's default one, is JSON if it
/// cannot be anything else: the fields of a form never begin with a brace. A web page may send such a body to other
/// sites without a preflight request, so from a browser, which sends the origin of a page, only the JSON type is
/// accepted.
fn is_json(headers: &HeaderMap, body: &[u8]) -> bool {
    let is_of_browser = [header::ORIGIN.as_str(), "sec-fetch-site"]
        .iter()
        .any(|name| headers.contains_key(*name));
    match media_type(headers).as_deref() {
        Some("application/json") => true,
        None | Some(OF_FORMS) => !is_of_browser && body.trim_ascii_start().first() == Some(&b'{'),
        Some(_) => false,
    }
}

/// Rejects a body whose content type is not one of an NC program.
pub(super) fn check_text(headers: &HeaderMap) -> Result<(), Problem> {
    let is_text = media_type(headers).is_none_or(|kind| {
        kind.starts_with("text/") || ["application/octet-stream", OF_FORMS].contains(&kind.as_str())
    });
    if is_text {
        Ok(())
    } else {
        Err(unsupported(
            "send the program's text with Content-Type: text/plain",
        ))
    }
}

fn unsupported(text: &str) -> Problem {
    Problem::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, "unsupported_media_type", text)
}

/// Returns the media type without parameters, in lower case; empty if the header is not text, `None` without header.
fn media_type(headers: &HeaderMap) -> Option<String> {
    let value = headers.get(header::CONTENT_TYPE)?.to_str().unwrap_or_default();
    Some(
        value
            .split(';')
            .next()
            .unwrap_or(value)
            .trim()
            .to_ascii_lowercase(),
    )
}

/// Reads the whole body, at most `limit` bytes. A body that announces a larger size is rejected at once.
pub(super) async fn read(body: Body, limit: usize) -> Result<Vec<u8>, Problem> {
    let too_large = || {
        Err(Problem::new(
            StatusCode::PAYLOAD_TOO_LARGE,
            "too_large",
            format!("the body is larger than {limit} bytes"),
        ))
    };
    if body.size_hint().lower() > u64::try_from(limit).unwrap_or(u64::MAX) {
        return too_large();
    }
    let mut bytes = Vec::new();
    let mut deadline = Instant::now() + BODY_MAX;
    let mut chunks = body.into_data_stream();
    loop {
        let chunk = timeout_at(deadline, chunks.next()).await;
        let Some(chunk) = chunk.map_err(|_| too_slow())? else {
            return Ok(bytes);
        };
        let chunk = chunk.map_err(|error| Problem::invalid(format!("the body ended early: {error}")))?;
        if bytes.len() + chunk.len() > limit {
            return too_large();
        }
        let length = u32::try_from(chunk.len()).unwrap_or(u32::MAX);
        deadline += Duration::from_secs(1).saturating_mul(length) / BODY_RATE_MIN;
        bytes.extend_from_slice(&chunk);
    }
}

fn too_slow() -> Problem {
    let text = format!(
        "the body arrives too slowly: the limit is {} s, and 1 s more for each {} KiB",
        BODY_MAX.as_secs(),
        BODY_RATE_MIN / 1024
    );
    Problem::new(StatusCode::REQUEST_TIMEOUT, "timeout", text)
}
