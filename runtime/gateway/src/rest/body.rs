//! Bodies as they come in, with a limit on everything.

use std::time::Duration;

use axum::body::Body;
use axum::http::{HeaderMap, StatusCode, header};
use futures_util::StreamExt;

use crate::problem::Problem;

/// Bytes of a JSON body; more is 413. Reason: the largest, a fault text, is far below.
const JSON_BODY_MAX: usize = 64 * 1024;

/// Time for a whole body to come in; then 408.
const BODY_TIMEOUT: Duration = Duration::from_mins(1);

/// A JSON body; an empty one is `{}`.
pub(super) async fn json(headers: &HeaderMap, body: Body) -> Result<Vec<u8>, Problem> {
    let body = read(body, JSON_BODY_MAX).await?;
    if body.is_empty() {
        return Ok(b"{}".to_vec());
    }
    if media_type(headers).is_none_or(|kind| kind != "application/json") {
        return Err(unsupported("send JSON with Content-Type: application/json"));
    }
    Ok(body)
}

/// Whether a body may be a program's text.
pub(super) fn check_text(headers: &HeaderMap) -> Result<(), Problem> {
    // the last one is what curl says of --data-binary when it is told nothing else
    let is_text = media_type(headers).is_none_or(|kind| {
        kind.starts_with("text/")
            || ["application/octet-stream", "application/x-www-form-urlencoded"].contains(&kind.as_str())
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

/// The media type without parameters, in lower case.
fn media_type(headers: &HeaderMap) -> Option<String> {
    let value = headers.get(header::CONTENT_TYPE)?.to_str().ok()?;
    Some(
        value
            .split(';')
            .next()
            .unwrap_or(value)
            .trim()
            .to_ascii_lowercase(),
    )
}

/// The whole body, at most `limit` bytes.
pub(super) async fn read(body: Body, limit: usize) -> Result<Vec<u8>, Problem> {
    let read = async {
        let mut bytes = Vec::new();
        let mut chunks = body.into_data_stream();
        while let Some(chunk) = chunks.next().await {
            let chunk = chunk.map_err(|error| Problem::invalid(format!("the body broke off: {error}")))?;
            if bytes.len() + chunk.len() > limit {
                return Err(Problem::new(
                    StatusCode::PAYLOAD_TOO_LARGE,
                    "too_large",
                    format!("the body is larger than {limit} bytes"),
                ));
            }
            bytes.extend_from_slice(&chunk);
        }
        Ok(bytes)
    };
    tokio::time::timeout(BODY_TIMEOUT, read)
        .await
        .unwrap_or_else(|_| {
            Err(Problem::new(
                StatusCode::REQUEST_TIMEOUT,
                "timeout",
                format!("the body did not come within {} s", BODY_TIMEOUT.as_secs()),
            ))
        })
}
