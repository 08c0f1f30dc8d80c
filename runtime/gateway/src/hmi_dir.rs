//! `[hmi] dir`: pages and modules of the machine builder, read from the disk with each request, below `/hmi/`. They are
//! served like the HMI itself: to every client that reaches the server, under the same content policy. A file is
//! treated as missing if its extension is not in [`KINDS`], if it is hidden, or if it lies outside the folder, also
//! through a link.

use std::io::ErrorKind;
use std::path::Path;
use std::sync::Arc;
use std::time::UNIX_EPOCH;

use axum::Router;
use axum::body::Body;
use axum::extract::Path as InPath;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Redirect, Response};
use axum::routing::get;
use tokio::fs::{self, File};
use tokio::io::AsyncReadExt as _;
use tokio_util::io::ReaderStream;
use tower_http::compression::CompressionLayer;

use crate::hmi::is_known;
use crate::problem::Problem;
use crate::server_state::ServerState;

/// Path of the folder on the server.
const ROOT: &str = "/hmi";

/// The file that is served for a folder.
const INDEX: &str = "index.html";

/// Largest number of bytes of one file; a larger one is rejected. Reason: tablets load it, and the machine's computer
/// has other work.
pub(crate) const FILE_MAX: u64 = 64 * 1024 * 1024;

/// Endings of the files that are served, with their types.
const KINDS: [(&str, &str); 19] = [
    ("html", "text/html; charset=utf-8"),
    ("js", "text/javascript; charset=utf-8"),
    ("mjs", "text/javascript; charset=utf-8"),
    ("css", "text/css; charset=utf-8"),
    ("json", "application/json"),
    ("txt", "text/plain; charset=utf-8"),
    ("svg", "image/svg+xml"),
    ("png", "image/png"),
    ("jpg", "image/jpeg"),
    ("jpeg", "image/jpeg"),
    ("webp", "image/webp"),
    ("gif", "image/gif"),
    ("ico", "image/x-icon"),
    ("woff2", "font/woff2"),
    ("mp3", "audio/mpeg"),
    ("wav", "audio/wav"),
    ("mp4", "video/mp4"),
    ("pdf", "application/pdf"),
    ("webmanifest", "application/manifest+json"),
];

/// Returns the routes of the folder; empty without a folder.
pub(crate) fn routes(dir: Option<&Path>) -> Router<Arc<ServerState>> {
    let Some(dir) = dir else { return Router::new() };
    let dir: Arc<Path> = dir.into();
    let index = Arc::clone(&dir);
    let root = format!("{ROOT}/");
    Router::new()
        // so that relative names in a page refer to the folder
        .route(ROOT, get(|| async { Redirect::permanent("/hmi/") }))
        .route(
            &root,
            get(move |headers: HeaderMap| serve(index, String::new(), headers)),
        )
        .route(
            &format!("{ROOT}/{{*path}}"),
            get(move |InPath(path): InPath<String>, headers: HeaderMap| serve(dir, path, headers)),
        )
        .layer(CompressionLayer::new())
}

async fn serve(dir: Arc<Path>, path: String, headers: HeaderMap) -> Response {
    match open(&dir, &path).await {
        Ok(found) => found.response(&headers),
        Err(Unread::NotFound) => {
            Problem::not_found(format!("there is nothing at {ROOT}/{path}")).into_response()
        }
        Err(Unread::TooLarge) => {
            let text = format!("{ROOT}/{path} exceeds the limit of {FILE_MAX} bytes");
            Problem::new(StatusCode::PAYLOAD_TOO_LARGE, "too_large", text).into_response()
        }
        Err(Unread::Failed(error)) => {
            tracing::warn!("[hmi] dir: {path:.256} cannot be read: {error}");
            let text = format!("{ROOT}/{path} cannot be read; the log contains the reason");
            Problem::new(StatusCode::INTERNAL_SERVER_ERROR, "unreadable", text).into_response()
        }
    }
}

/// A file that is served.
#[derive(Debug)]
struct ServedFile {
    file: File,
    kind: &'static str,
    bytes: u64,
    tag: String,
}

/// Why a file is not served.
#[derive(Debug)]
enum Unread {
    NotFound,
    TooLarge,
    Failed(std::io::Error),
}

impl From<std::io::Error> for Unread {
    fn from(error: std::io::Error) -> Self {
        match error.kind() {
            ErrorKind::NotFound | ErrorKind::NotADirectory | ErrorKind::InvalidFilename => Unread::NotFound,
            _ => Unread::Failed(error),
        }
    }
}

/// Opens a file of the folder. The resolved path decides, so that no link leads outside.
async fn open(dir: &Path, path: &str) -> Result<ServedFile, Unread> {
    if !is_plain(path) {
        return Err(Unread::NotFound);
    }
    let dir = fs::canonicalize(dir).await?;
    let mut place = fs::canonicalize(dir.join(path)).await?;
    if place.starts_with(&dir) && fs::metadata(&place).await?.is_dir() {
        place = fs::canonicalize(place.join(INDEX)).await?;
    }
    let kind = kind_within(&dir, &place).ok_or(Unread::NotFound)?;
    // opening a FIFO would block
    let seen = fs::metadata(&place).await?;
    if !seen.is_file() {
        return Err(Unread::NotFound);
    }
    if seen.len() > FILE_MAX {
        return Err(Unread::TooLarge);
    }
    let file = File::open(&place).await?;
    let written = seen.modified()?.duration_since(UNIX_EPOCH).unwrap_or_default();
    Ok(ServedFile {
        file,
        kind,
        bytes: seen.len(),
        tag: format!("W/\"{:x}-{:x}\"", seen.len(), written.as_nanos()),
    })
}

/// Returns true for names one below the other, none of which is hidden or leads elsewhere.
fn is_plain(path: &str) -> bool {
    let path = path.strip_suffix('/').unwrap_or(path);
    let is_name = |name: &str| !name.is_empty() && !name.starts_with('.') && !name.contains(['\\', '\0']);
    path.is_empty() || path.split('/').all(is_name)
}

/// Returns the type of a file if its path lies within the folder.
fn kind_within(dir: &Path, place: &Path) -> Option<&'static str> {
    let path = place.strip_prefix(dir).ok()?.to_str()?;
    let (_, ending) = path.rsplit_once('.')?;
    let of_ending = KINDS.iter().find(|(known, _)| known.eq_ignore_ascii_case(ending));
    of_ending.filter(|_| is_plain(path)).map(|(_, kind)| *kind)
}

impl ServedFile {
    fn response(self, asked: &HeaderMap) -> Response {
        let headers = [
            (header::ETAG, self.tag.clone()),
            (header::CONTENT_TYPE, self.kind.to_owned()),
            (header::CACHE_CONTROL, "no-cache".to_owned()),
        ];
        if is_known(asked, &self.tag) {
            return (headers, StatusCode::NOT_MODIFIED).into_response();
        }
        // if the file grows meanwhile, only the announced length is sent
        let body = Body::from_stream(ReaderStream::new(self.file.take(self.bytes)));
        let length = [(header::CONTENT_LENGTH, self.bytes.to_string())];
        (headers, length, body).into_response()
    }
}

#[cfg(test)]
mod tests {
    use tempfile::TempDir;

    use super::*;

    fn folder() -> TempDir {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        std::fs::create_dir_all(folder.path().join("hmi/parts")).unwrap();
        std::fs::create_dir_all(folder.path().join("hmi/.git")).unwrap();
        write("secret.html", "secret");
        write("hmi/index.html", "<html>");
        write("hmi/parts/a.js", "a");
        write("hmi/.git/a.js", "hidden");
        write("hmi/notes.toml", "no ending that is served");
        folder
    }

    async fn read(folder: &TempDir, path: &str) -> Option<(String, &'static str)> {
        let mut found = open(&folder.path().join("hmi"), path).await.ok()?;
        let mut text = String::new();
        found.file.read_to_string(&mut text).await.unwrap();
        Some((text, found.kind))
    }

    #[tokio::test]
    async fn files_outside_the_folder_hidden_or_of_other_kinds_are_not_served() {
        let folder = folder();
        let at = |name: &str| folder.path().join(name);
        std::os::unix::fs::symlink(at("secret.html"), at("hmi/out.html")).unwrap();
        std::os::unix::fs::symlink(folder.path(), at("hmi/up")).unwrap();
        std::os::unix::fs::symlink(at("hmi/.git/a.js"), at("hmi/seen.js")).unwrap();
        std::os::unix::fs::symlink(at("hmi/parts/a.js"), at("hmi/within.js")).unwrap();
        let (html, js) = (KINDS[0].1, KINDS[1].1);
        assert_eq!(read(&folder, "").await, Some(("<html>".into(), html)));
        assert_eq!(read(&folder, "index.html").await, Some(("<html>".into(), html)));
        assert_eq!(read(&folder, "parts/a.js").await, Some(("a".into(), js)));
        assert_eq!(
            read(&folder, "within.js").await,
            Some(("a".into(), js)),
            "a link within"
        );
        for path in [
            "../secret.html",
            "parts/../../secret.html",
            "/etc/passwd",
            "//etc/hosts.txt",
            "out.html",
            "up/secret.html",
            "seen.js",
            ".git/a.js",
            "./index.html",
            "parts/./a.js",
            "parts\\a.js",
            "notes.toml",
            "parts",
            "parts/",
            "index.html/a.js",
            "index.html\0.js",
            "none.html",
            &"x".repeat(5000),
        ] {
            let opened = open(&at("hmi"), path).await;
            assert!(matches!(opened, Err(Unread::NotFound)), "{path}: {opened:?}");
        }
    }

    #[tokio::test]
    async fn only_files_are_served_up_to_their_limit() {
        let folder = folder();
        let place = folder.path().join("hmi/large.png");
        let file = std::fs::File::create(&place).unwrap();
        file.set_len(FILE_MAX).unwrap();
        let hmi = folder.path().join("hmi");
        assert!(open(&hmi, "large.png").await.is_ok());
        file.set_len(FILE_MAX + 1).unwrap();
        assert!(matches!(open(&hmi, "large.png").await, Err(Unread::TooLarge)));
        std::fs::create_dir(hmi.join("folder.js")).unwrap();
        assert!(matches!(open(&hmi, "folder.js").await, Err(Unread::NotFound)));
        let _socket = std::os::unix::net::UnixListener::bind(hmi.join("socket.js")).unwrap();
        assert!(matches!(open(&hmi, "socket.js").await, Err(Unread::NotFound)));
    }
}
