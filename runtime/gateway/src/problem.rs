//! Problems as HTTP responses.

use axum::body::Body;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use plc_api::types::refusal::Refusal;
use plc_api::wire::problem::Problem as Details;

/// A refusal as problem details. Boxed, because it is the rare result of every handler.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Problem(Box<Details>);

impl Problem {
    pub(crate) fn new(status: StatusCode, code: &str, detail: impl Into<String>) -> Self {
        Details::new(status.as_u16(), code, detail).into()
    }

    /// Status number and code, for tests.
    #[cfg(test)]
    pub(crate) fn status_and_code(&self) -> (u16, &str) {
        (self.0.status, &self.0.code)
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
        Self(Box::new(details))
    }
}

impl From<Box<Details>> for Problem {
    fn from(details: Box<Details>) -> Self {
        Self(details)
    }
}

impl From<Refusal> for Problem {
    fn from(refusal: Refusal) -> Self {
        Details::from(refusal).into()
    }
}

impl IntoResponse for Problem {
    fn into_response(mut self) -> Response {
        let status = StatusCode::from_u16(self.0.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        status
            .canonical_reason()
            .unwrap_or("Problem")
            .clone_into(&mut self.0.title);
        let body = serde_json::to_string(&self.0).unwrap_or_else(|_| "{}".to_owned());
        let mut response = Response::new(Body::from(body));
        *response.status_mut() = status;
        let headers = response.headers_mut();
        headers.insert(
            header::CONTENT_TYPE,
            HeaderValue::from_static("application/problem+json"),
        );
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

    #[test]
    fn a_missing_token_says_which_scheme_and_a_body_too_large_ends_the_connection() {
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
}
