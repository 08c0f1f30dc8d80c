//! A small HTTP/1.1 client: one request on one connection.

use serde_json::Value;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use super::schemas::{check_accepted, check_answer};
use super::wait::within;

/// An answer.
#[derive(Debug, Clone)]
pub struct Answer {
    pub status: u16,
    pub head: String,
    pub body: String,
}

impl Answer {
    /// The body as JSON; null when there is none.
    pub fn json(&self) -> Value {
        if self.body.is_empty() {
            return Value::Null;
        }
        serde_json::from_str(&self.body).unwrap_or_else(|error| panic!("{error} in {self:?}"))
    }

    /// A header's value.
    pub fn header(&self, name: &str) -> Option<&str> {
        let mut fields = self.head.lines().filter_map(|line| line.split_once(':'));
        fields
            .find(|(key, _)| key.eq_ignore_ascii_case(name))
            .map(|(_, value)| value.trim())
    }

    #[track_caller]
    pub fn expect(self, status: u16) -> Self {
        assert_eq!(self.status, status, "{self:?}");
        self
    }
}

/// Sends a request. A body that is JSON or text names its type.
pub async fn request(address: &str, method: &str, path: &str, kind: &str, body: &str) -> Answer {
    request_as(address, method, path, kind, body, None).await
}

/// Sends a request with a token.
pub async fn request_as(
    address: &str,
    method: &str,
    path: &str,
    kind: &str,
    body: &str,
    token: Option<&str>,
) -> Answer {
    let token = token.map_or(String::new(), |token| {
        format!("Authorization: Bearer {token}\r\n")
    });
    request_with(address, method, path, kind, body, &token).await
}

/// Sends a request with header lines, each ended by CR and LF.
pub async fn request_with(
    address: &str,
    method: &str,
    path: &str,
    kind: &str,
    body: &str,
    headers: &str,
) -> Answer {
    within(&format!("{method} {path}"), async {
        let bytes = exchange(address, method, path, kind, body, headers).await;
        let answer = parse(&bytes.expect("the HTTP port answers"));
        if let Err(error) = check_answer(method, path, answer.status, &answer.body) {
            panic!("{error}");
        }
        if answer.status < 300
            && let Err(error) = check_accepted(method, path, body)
        {
            panic!("{error}");
        }
        answer
    })
    .await
}

/// Sends a request to a machine that may be offline; returns `None` in this case.
pub async fn try_request(address: &str, method: &str, path: &str, kind: &str, body: &str) -> Option<Answer> {
    try_request_with(address, method, path, kind, body, "").await
}

/// Tries a request with header lines, each ended by CR and LF.
pub async fn try_request_with(
    address: &str,
    method: &str,
    path: &str,
    kind: &str,
    body: &str,
    headers: &str,
) -> Option<Answer> {
    let bytes = exchange(address, method, path, kind, body, headers).await.ok()?;
    bytes
        .windows(4)
        .any(|end| end == b"\r\n\r\n")
        .then(|| parse(&bytes))
}

async fn exchange(
    address: &str,
    method: &str,
    path: &str,
    kind: &str,
    body: &str,
    headers: &str,
) -> std::io::Result<Vec<u8>> {
    let mut stream = TcpStream::connect(address).await?;
    let content = if body.is_empty() {
        "Content-Length: 0".to_owned()
    } else {
        format!("Content-Type: {kind}\r\nContent-Length: {}", body.len())
    };
    let head = format!(
        "{method} {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n{headers}{content}\r\n\r\n"
    );
    stream.write_all(head.as_bytes()).await?;
    stream.write_all(body.as_bytes()).await?;
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).await?;
    Ok(bytes)
}

fn parse(bytes: &[u8]) -> Answer {
    let text = String::from_utf8_lossy(bytes);
    let (head, body) = text.split_once("\r\n\r\n").expect("a head and a body");
    let status = head
        .split(' ')
        .nth(1)
        .and_then(|word| word.parse().ok())
        .expect("a status");
    let mut answer = Answer {
        status,
        head: head.to_owned(),
        body: body.to_owned(),
    };
    if answer.header("transfer-encoding") == Some("chunked") {
        answer.body = unchunked(body);
    }
    answer
}

fn unchunked(mut rest: &str) -> String {
    let mut body = String::new();
    while let Some((size, behind)) = rest.split_once("\r\n") {
        let size = usize::from_str_radix(size, 16).expect("a chunk size");
        if size == 0 {
            break;
        }
        body.push_str(&behind[..size]);
        rest = &behind[size + 2..];
    }
    body
}
