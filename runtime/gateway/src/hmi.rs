//! The HMI: the files of `web/`, embedded in the binary.

use std::sync::Arc;

use axum::Router;
use axum::body::Body;
use axum::extract::Path;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use rust_embed::{EmbeddedFile, RustEmbed};
use tower_http::compression::CompressionLayer;

use crate::problem::Problem;
use crate::shared::Shared;

#[derive(RustEmbed)]
#[folder = "web"]
struct Files;

/// What a browser may fetch. Tests, types and package files that lie beside them are not served.
const SERVED: [&str; 7] = ["html", "js", "css", "svg", "png", "ico", "woff2"];

/// Everything from this server only; no plug-ins, no frames, no forms to elsewhere.
const CONTENT_SECURITY_POLICY: &str =
    "default-src 'self'; object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

pub(crate) fn routes() -> Router<Arc<Shared>> {
    Router::new()
        .route(
            "/",
            get(|headers: HeaderMap| async move { serve("index.html", &headers) }),
        )
        .route(
            "/api",
            get(|headers: HeaderMap| async move { serve("api.html", &headers) }),
        )
        .route(
            "/{*path}",
            get(|Path(path): Path<String>, headers: HeaderMap| async move { serve(&path, &headers) }),
        )
        .layer(CompressionLayer::new())
}

/// Adds to every response what browsers need to be told.
pub(crate) async fn security_headers(mut response: Response) -> Response {
    let headers = response.headers_mut();
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY_POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::X_FRAME_OPTIONS, "DENY"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
}

fn serve(path: &str, request: &HeaderMap) -> Response {
    let hidden = path
        .split('/')
        .any(|part| part.starts_with('.') || part == "node_modules");
    let extension = path.rsplit_once('.').map(|(_, extension)| extension);
    let served = !hidden && extension.is_some_and(|extension| SERVED.contains(&extension));
    match served.then(|| Files::get(path)).flatten() {
        Some(file) => file_response(file, request),
        None => Problem::not_found(format!("there is nothing at /{path}")).into_response(),
    }
}

fn file_response(file: EmbeddedFile, request: &HeaderMap) -> Response {
    use std::fmt::Write as _;
    let mut tag = String::from("W/\"");
    for byte in &file.metadata.sha256_hash()[..16] {
        // writing to a String cannot fail
        let _ = write!(tag, "{byte:02x}");
    }
    tag.push('"');
    let known = request
        .get(header::IF_NONE_MATCH)
        .and_then(|tags| tags.to_str().ok())
        .is_some_and(|tags| tags.split(',').any(|one| one.trim() == tag));
    let mut response = if known {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        Response::new(Body::from(file.data.into_owned()))
    };
    let headers = response.headers_mut();
    let kind = match file.metadata.mimetype() {
        kind if kind.starts_with("text/") => format!("{kind}; charset=utf-8"),
        kind => kind.to_owned(),
    };
    for (name, value) in [(header::ETAG, tag), (header::CONTENT_TYPE, kind)] {
        if let Ok(value) = HeaderValue::try_from(value) {
            headers.insert(name, value);
        }
    }
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    response
}
