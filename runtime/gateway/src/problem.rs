//! Problems as HTTP responses.

use std::time::Duration;

use axum::body::Body;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use plc_protocol::types::refusal::Refusal;
use plc_protocol::wire::problem::Problem as Details;

/// A rejection as problem details. Boxed, because it is the rare result of every handler.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Problem {
    details: Box<Details>,
    /// Time before a retry, whole seconds.
    retry_after_s: Option<u64>,
}

impl Problem {
    pub(crate) fn new(status: StatusCode, code: &str, detail: impl Into<String>) -> Self {
        Details::new(status.as_u16(), code, detail).into()
    }

    /// Adds the time before a retry, rounded up to whole seconds.
    pub(crate) fn retry_after(mut self, wait: Duration) -> Self {
        self.retry_after_s = Some(
            wait.as_millis()
                .div_ceil(1_000)
                .try_into()
                .unwrap_or(u64::MAX)
                .max(1),
        );
        self
    }

    pub(crate) fn not_found(detail: impl Into<String>) -> Self {
        Details::not_found(detail).into()
    }

    pub(crate) fn invalid(detail: impl Into<String>) -> Self {
        Details::invalid(detail).into()
    }
}

impl From<Details> for Problem {
    fn from(details: Details) -> Self {
        Box::new(details).into()
    }
}

impl From<Box<Details>> for Problem {
    fn from(details: Box<Details>) -> Self {
        Self {
            details,
            retry_after_s: None,
        }
    }
}

impl From<Refusal> for Problem {
    fn from(refusal: Refusal) -> Self {
        Details::from(refusal).into()
    }
}

impl IntoResponse for Problem {
    fn into_response(mut self) -> Response {
        let details = &mut self.details;
        let status = StatusCode::from_u16(details.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        status
            .canonical_reason()
            .unwrap_or("Problem")
            .clone_into(&mut details.title);
        let body = serde_json::to_string(&details).unwrap_or_else(|_| "{}".to_owned());
        let mut response = Response::new(Body::from(body));
        *response.status_mut() = status;
        let headers = response.headers_mut();
        headers.insert(
            header::CONTENT_TYPE,
            HeaderValue::from_static("application/problem+json"),
        );
        if let Some(seconds) = self.retry_after_s {
            headers.insert(header::RETRY_AFTER, HeaderValue::from(seconds));
        }
        if status == StatusCode::UNAUTHORIZED {
            headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        if status == StatusCode::PAYLOAD_TOO_LARGE {
            // the rest of the body is not read, so no request can follow it
            headers.insert(header::CONNECTION, HeaderValue::from_static("close"));
        }
        response
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    impl Problem {
        /// Returns status number and code.
        pub(crate) fn status_and_code(&self) -> (u16, &str) {
            (self.details.status, &self.details.code)
        }
    }

    #[test]
    fn missing_token_names_the_scheme_and_large_body_closes_the_connection() {
        let header = |status, name| {
            let response = Problem::new(status, "code", "detail").into_response();
            response.headers().get(name).cloned()
        };
        let unauthorized = header(StatusCode::UNAUTHORIZED, header::WWW_AUTHENTICATE);
        assert_eq!(unauthorized.unwrap(), "Bearer");
        let large = header(StatusCode::PAYLOAD_TOO_LARGE, header::CONNECTION);
        assert_eq!(large.unwrap(), "close");
        assert_eq!(header(StatusCode::CONFLICT, header::CONNECTION), None);
    }

    #[test]
    fn too_many_requests_say_after_how_many_whole_seconds_to_try_again() {
        for (wait_ms, said) in [(0, "1"), (1, "1"), (1_000, "1"), (1_001, "2")] {
            let problem = Problem::new(StatusCode::TOO_MANY_REQUESTS, "code", "detail");
            let response = problem
                .retry_after(Duration::from_millis(wait_ms))
                .into_response();
            assert_eq!(response.headers()[header::RETRY_AFTER], said);
        }
    }
}
