//! What handlers take from a request, with problems as refusals and a limit on everything.

use std::time::Duration;

use axum::extract::{FromRequest, FromRequestParts, Path, Query, RawPathParams, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, StatusCode, header};
use futures_util::StreamExt;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::json::json_object;
use crate::problem::Problem;

/// Bytes of a JSON body; more is 413. Reason: the largest, a fault text, is far below.
pub(crate) const JSON_BODY_MAX: usize = 64 * 1024;

/// Time for a whole body to come in; then 408.
const BODY_TIMEOUT: Duration = Duration::from_mins(1);

/// The numbers and names in a path; others are 404, and so is a number that is not written as such: of `1`, `01` and
/// `+1` only the first names something.
pub(crate) struct InPath<T>(pub(crate) T);

impl<S: Send + Sync, T: DeserializeOwned + Serialize + Send> FromRequestParts<S> for InPath<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let written = RawPathParams::from_request_parts(parts, state).await;
        let value = Path::<T>::from_request_parts(parts, state).await;
        match (written, value) {
            (Ok(written), Ok(Path(value))) if is_as_written(&value, &written) => Ok(Self(value)),
            _ => Err(Problem::not_found(format!(
                "there is nothing at {}",
                parts.uri.path()
            ))),
        }
    }
}

fn is_as_written(value: &impl Serialize, written: &RawPathParams) -> bool {
    let values = match serde_json::to_value(value) {
        Ok(Value::Array(values)) => values,
        Ok(value) => vec![value],
        Err(_) => return false,
    };
    let mut both = values.iter().zip(written);
    both.all(|(value, (_, written))| {
        let canonical = value.to_string();
        !value.is_number() || canonical == written
    })
}

/// The query of a URL; others are 400.
pub(crate) struct InQuery<T>(pub(crate) T);

impl<S: Send + Sync, T: DeserializeOwned> FromRequestParts<S> for InQuery<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        match Query::<T>::try_from_uri(&parts.uri) {
            Ok(Query(value)) => Ok(Self(value)),
            Err(refusal) => Err(Problem::invalid(refusal.body_text())),
        }
    }
}

/// A JSON body; an empty one is `{}`.
pub(crate) struct JsonBody<T>(pub(crate) T);

impl<S: Send + Sync, T: DeserializeOwned> FromRequest<S> for JsonBody<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, _: &S) -> Result<Self, Problem> {
        let json = is_json(request.headers());
        let mut body = read_body(request, JSON_BODY_MAX).await?;
        if body.is_empty() {
            body = b"{}".to_vec();
        } else if !json {
            return Err(Problem::new(
                StatusCode::UNSUPPORTED_MEDIA_TYPE,
                "unsupported_media_type",
                "send JSON with Content-Type: application/json",
            ));
        }
        json_object(&body)
            .map(Self)
            .map_err(|error| Problem::invalid(format!("the JSON body is not right: {error}")))
    }
}

fn is_json(headers: &HeaderMap) -> bool {
    media_type(headers).is_some_and(|kind| kind == "application/json")
}

/// The media type without parameters, in lower case.
pub(crate) fn media_type(headers: &HeaderMap) -> Option<String> {
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
pub(crate) async fn read_body(request: Request, limit: usize) -> Result<Vec<u8>, Problem> {
    let read = async {
        let mut body = Vec::new();
        let mut chunks = request.into_body().into_data_stream();
        while let Some(chunk) = chunks.next().await {
            let chunk = chunk.map_err(|error| Problem::invalid(format!("the body broke off: {error}")))?;
            if body.len() + chunk.len() > limit {
                return Err(Problem::new(
                    StatusCode::PAYLOAD_TOO_LARGE,
                    "too_large",
                    format!("the body is larger than {limit} bytes"),
                ));
            }
            body.extend_from_slice(&chunk);
        }
        Ok(body)
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
