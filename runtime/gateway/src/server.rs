//! The HTTP server: places of connections, the size of headers, and the end of silent connections.

use std::future::Future;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::extract::Request;
use axum::http::{Extensions, HeaderValue, Method, StatusCode, header};
use axum::response::Response;
use axum::{Extension, Router};
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto;
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use plc_api::types::command::Verb;
use serde::Deserialize;
use serde::de::IntoDeserializer;
use serde::de::value::{Error as ValueError, StrDeserializer};
use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt as _, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::{Instant, Sleep};
use tokio_util::sync::CancellationToken;
use tower::Layer;

use crate::places::{ACCEPT_RETRY, Busy, Place, PlaceLimits, Places};
use crate::problem::Problem;
use crate::shared::Shared;
use crate::tls::{Accepted, ClientStream, Fingerprint, LiveTls};

/// Places of connections.
const PLACES: PlaceLimits = PlaceLimits {
    all: 256,
    of_one: 64,
    strangers: 192,
    known: 224,
};

/// A connection without traffic for this long is closed. Reason: longer than `?wait=1` waits, and than the interval of
/// the pings of a WebSocket.
const SILENCE_MAX: Duration = Duration::from_secs(75);

/// Time to receive the head of a request; then its connection is closed.
pub(crate) const HEADER_MAX: Duration = Duration::from_secs(10);

/// Header lines of one request; more are 431.
const HEADER_LINES_MAX: usize = 64;

/// Bytes of the head of one request; more are 431.
const HEADER_BYTES_MAX: usize = 64 * 1024;

/// Time to hand the refusal of a client without TLS to its connection.
const REFUSAL_MAX: Duration = Duration::from_secs(2);

/// Who is at the other end of a connection.
#[derive(Debug, Clone)]
pub(crate) struct Peer {
    pub(crate) address: IpAddr,
    /// The certificate that it has shown.
    pub(crate) certificate: Option<Fingerprint>,
}

/// The certificate that the connection of a request has shown.
pub(crate) fn certificate_of(extensions: &Extensions) -> Option<&Fingerprint> {
    extensions.get::<Peer>()?.certificate.as_ref()
}

/// Serves until `stop`, then until the running requests have ended. `header_max` is [`HEADER_MAX`], less in tests.
pub(crate) async fn serve(
    listener: LimitedListener,
    router: Router,
    tls: Option<LiveTls>,
    stop: CancellationToken,
    header_max: Duration,
) {
    let mut builder = auto::Builder::new(TokioExecutor::new()).http1_only();
    builder
        .http1()
        .timer(TokioTimer::new())
        .header_read_timeout(header_max)
        .max_headers(HEADER_LINES_MAX)
        .max_buf_size(HEADER_BYTES_MAX);
    let graceful = GracefulShutdown::new();
    loop {
        let (stream, address, place) = tokio::select! {
            accepted = listener.accept() => accepted,
            () = stop.cancelled() => break,
        };
        let (builder, router, tls, watcher) =
            (builder.clone(), router.clone(), tls.clone(), graceful.watcher());
        let leave = place.leave();
        let place = Arc::new(place);
        let serving = async move {
            let Some(accepted) = let_in(stream, tls.as_ref()).await else {
                return;
            };
            let peer = Peer {
                address: address.ip(),
                certificate: accepted.certificate,
            };
            let router = Extension(peer).layer(Extension(Arc::clone(&place)).layer(router));
            let connection = Connection::new(accepted.stream, place);
            let serving = builder
                .serve_connection_with_upgrades(TokioIo::new(connection), TowerToHyperService::new(router))
                .into_owned();
            // a broken connection concerns only its client
            let _ = watcher.watch(serving).await;
        };
        tokio::spawn(async move {
            tokio::select! {
                () = serving => {}
                () = leave.cancelled() => {}
            }
        });
    }
    drop(listener);
    graceful.shutdown().await;
}

/// The connection of a client that speaks TLS where there is a certificate; another is told so.
async fn let_in(stream: TcpStream, tls: Option<&LiveTls>) -> Option<Accepted> {
    let Some(tls) = tls else {
        return Some(Accepted::plain(stream));
    };
    let mut accepted = tls.accept(stream).await.ok()?;
    if accepted.is_private() {
        return Some(accepted);
    }
    let text = "this port speaks https only: write https:// in place of http://\n";
    let answer = format!(
        "HTTP/1.1 400 Bad Request\r\ncontent-type: text/plain\r\ncontent-length: {}\r\nconnection: close\r\n\r\n{text}",
        text.len()
    );
    let refusing = async {
        accepted.stream.write_all(answer.as_bytes()).await?;
        accepted.stream.shutdown().await
    };
    // a client that does not take it has gone
    let _ = tokio::time::timeout(REFUSAL_MAX, refusing).await;
    None
}

/// Requests that are served also where there is no place for others: what brings a machine to rest.
pub(crate) fn is_urgent(method: &Method, path: &str) -> bool {
    let last: StrDeserializer<'_, ValueError> =
        path.rsplit('/').next().unwrap_or_default().into_deserializer();
    method == Method::POST && Verb::deserialize(last).is_ok_and(Verb::is_urgent)
}

/// The place of a connection while one of its requests is served.
pub(crate) struct HeldPlace {
    place: Arc<Place>,
    is_known: bool,
    /// `None`: it is not to be served.
    busy: Option<Busy>,
}

/// Whoever shows a token, or needs none, is known from then on. `None` without a connection: a test of the router.
pub(crate) fn hold_place(shared: &Shared, request: &Request) -> Option<HeldPlace> {
    let place = Arc::clone(request.extensions().get::<Arc<Place>>()?);
    let is_user = place.is_known()
        || shared
            .access
            .knows(request.headers(), certificate_of(request.extensions()));
    let is_known = is_user && place.know(0);
    let is_full = is_user && !is_known && !is_urgent(request.method(), request.uri().path());
    let busy = place.busy().filter(|_| !is_full);
    Some(HeldPlace {
        place,
        is_known,
        busy,
    })
}

impl HeldPlace {
    /// True when its request is to be served.
    pub(crate) fn is_served(&self) -> bool {
        self.busy.is_some()
    }

    /// Who is not known is answered once, and the connection is closed.
    pub(crate) fn answered(self, response: &mut Response) {
        if response.status() == StatusCode::SWITCHING_PROTOCOLS {
            // from now on it is a WebSocket, which has a limit of its own
            self.place.stay();
        } else if !self.is_known {
            let close = HeaderValue::from_static("close");
            response.headers_mut().insert(header::CONNECTION, close);
        }
    }
}

/// The answer to a request that is not served.
pub(crate) fn no_place() -> Problem {
    let text = format!(
        "{} connections are busy, which is the limit; only hold, stop and abort are taken now",
        PLACES.known
    );
    Problem::new(StatusCode::SERVICE_UNAVAILABLE, "unavailable", text)
}

/// Accepts connections within the limits.
#[derive(Debug)]
pub(crate) struct LimitedListener {
    listener: TcpListener,
    places: Arc<Places>,
}

impl LimitedListener {
    pub(crate) fn new(listener: TcpListener) -> Self {
        Self {
            listener,
            places: Places::new(PLACES),
        }
    }

    async fn accept(&self) -> (TcpStream, SocketAddr, Place) {
        loop {
            let (stream, address) = match self.listener.accept().await {
                Ok(accepted) => accepted,
                Err(error) => {
                    tracing::warn!("no HTTP connection accepted: {error}");
                    tokio::time::sleep(ACCEPT_RETRY).await;
                    continue;
                }
            };
            let Some(place) = self.places.take(address.ip()) else {
                continue;
            };
            // without it responses are only slower
            let _ = stream.set_nodelay(true);
            return (stream, address, place);
        }
    }
}

/// A connection that is closed when it stays silent.
#[derive(Debug)]
pub(crate) struct Connection {
    stream: ClientStream,
    silence: Pin<Box<Sleep>>,
    place: Arc<Place>,
}

impl Connection {
    fn new(stream: ClientStream, place: Arc<Place>) -> Self {
        Self {
            stream,
            silence: Box::pin(tokio::time::sleep(SILENCE_MAX)),
            place,
        }
    }

    /// Any traffic restarts the timer; its end is an error.
    fn watched<T>(&mut self, context: &mut Context<'_>, result: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        match result {
            Poll::Ready(result) => {
                self.silence.as_mut().reset(Instant::now() + SILENCE_MAX);
                self.place.moved();
                Poll::Ready(result)
            }
            Poll::Pending => self
                .silence
                .as_mut()
                .poll(context)
                .map(|()| Err(io::ErrorKind::TimedOut.into())),
        }
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let result = Pin::new(&mut self.stream).poll_read(context, buffer);
        self.watched(context, result)
    }
}

impl AsyncWrite for Connection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let result = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.watched(context, result)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffers: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let result = Pin::new(&mut self.stream).poll_write_vectored(context, buffers);
        self.watched(context, result)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}

#[cfg(test)]
mod tests {
    use tokio::io::AsyncReadExt;

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_silent_connection_is_closed() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let listener = LimitedListener::new(listener);
        let address = listener.listener.local_addr().unwrap();
        let (client, (stream, _, place)) = tokio::join!(TcpStream::connect(address), listener.accept());
        let mut connection = Connection::new(Accepted::plain(stream).stream, Arc::new(place));
        let begun = Instant::now();
        let error = connection.read_u8().await.unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::TimedOut);
        assert!(begun.elapsed() >= SILENCE_MAX);
        drop(client);
    }

    #[test]
    fn what_brings_to_rest_is_urgent() {
        for verb in ["hold", "stop", "abort"] {
            assert!(is_urgent(&Method::POST, &format!("/api/v1/cs/1/{verb}")));
            assert!(!is_urgent(&Method::GET, &format!("/api/v1/cs/1/{verb}")));
        }
        assert!(!is_urgent(&Method::POST, "/api/v1/cs/1/start"));
    }
}
