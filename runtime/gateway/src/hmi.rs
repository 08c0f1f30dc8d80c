//! The HMI: the files of `web/`, embedded in the binary.

use std::sync::Arc;

use axum::Router;
use axum::extract::Path;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use rust_embed::{EmbeddedFile, RustEmbed};
use tower_http::compression::CompressionLayer;

use crate::problem::Problem;
use crate::server_state::ServerState;

#[derive(RustEmbed)]
#[folder = "web"]
struct HmiFiles;

/// Pictures of examples, which the book shows too.
#[derive(RustEmbed)]
#[folder = "pictures"]
#[prefix = "pictures/"]
struct Pictures;

/// Extensions of the files that are served; tests, types and package files in the folder are not.
const SERVED: [&str; 8] = ["html", "js", "css", "svg", "png", "ico", "woff2", "webmanifest"];

/// Content from this server only; no plug-ins, no frames, no forms to other servers.
const CONTENT_SECURITY_POLICY: &str =
    "default-src 'self'; object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// The page of several machines connects to the servers that its user names; its scripts come from this server.
const MACHINES_PAGE: &str = "machines.html";
const MACHINES_POLICY: &str = "default-src 'self'; connect-src 'self' http: https: ws: wss:; object-src 'none'; base-uri 'none'; \
                               form-action 'none'; frame-ancestors 'none'";

pub(crate) fn routes() -> Router<Arc<ServerState>> {
    Router::new()
        .route("/", get(serve))
        .route("/{*path}", get(serve))
        .layer(CompressionLayer::new())
}

/// Adds the security headers for browsers to every response, except those already present.
pub(crate) fn add_security_headers(response: &mut Response) {
    let headers = [
        (header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY_POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::X_FRAME_OPTIONS, "DENY"),
    ];
    for (name, value) in headers {
        response
            .headers_mut()
            .entry(name)
            .or_insert(HeaderValue::from_static(value));
    }
}

async fn serve(path: Option<Path<String>>, request: HeaderMap) -> Response {
    let path = match path.as_deref().map(String::as_str) {
        None => "index.html",
        Some("api") => "api.html",
        Some("machines") => MACHINES_PAGE,
        Some(path) => path,
    };
    let hidden = path
        .split('/')
        .any(|part| part.starts_with('.') || part == "node_modules");
    let extension = path.rsplit_once('.').map(|(_, extension)| extension);
    let served = !hidden && extension.is_some_and(|extension| SERVED.contains(&extension));
    match served
        .then(|| HmiFiles::get(path).or_else(|| Pictures::get(path)))
        .flatten()
    {
        Some(file) if path == MACHINES_PAGE => {
            let policy = [(header::CONTENT_SECURITY_POLICY, MACHINES_POLICY)];
            (policy, file_response(file, &request)).into_response()
        }
        Some(file) => file_response(file, &request),
        None => Problem::not_found(format!("there is nothing at /{path}")).into_response(),
    }
}

/// Returns true if the client already has the content with this tag.
pub(crate) fn is_known(request: &HeaderMap, tag: &str) -> bool {
    let tags = request
        .get(header::IF_NONE_MATCH)
        .and_then(|tags| tags.to_str().ok());
    tags.is_some_and(|tags| tags.split(',').any(|one| one.trim() == tag))
}

fn file_response(file: EmbeddedFile, request: &HeaderMap) -> Response {
    let tag = format!("W/\"{}\"", hex::encode(&file.metadata.sha256_hash()[..16]));
    let known = is_known(request, &tag);
    let kind = match file.metadata.mimetype() {
        kind if kind.starts_with("text/") => format!("{kind}; charset=utf-8"),
        kind => kind.to_owned(),
    };
    let headers = [
        (header::ETAG, tag),
        (header::CONTENT_TYPE, kind),
        (header::CACHE_CONTROL, "no-cache".to_owned()),
    ];
    if known {
        (headers, StatusCode::NOT_MODIFIED).into_response()
    } else {
        (headers, file.data.into_owned()).into_response()
    }
}
