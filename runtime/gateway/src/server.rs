//! The HTTP server: connection slots, limits on headers, and the end of silent connections. It speaks HTTP/1.1 only.

use std::future::Future;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use axum::extract::Request;
use axum::http::{Extensions, HeaderValue, Method, StatusCode, header};
use axum::response::Response;
use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use plc_protocol::supervisor::Supervisor;
use plc_protocol::types::command::Verb;
use plc_protocol::wire::right::Right;
use serde::Deserialize;
use serde::de::IntoDeserializer;
use serde::de::value::{Error as ValueError, StrDeserializer};
use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt as _, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::{Instant, Sleep};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tower::Layer;

use crate::certificate::ClientCertificate;
use crate::connection_slots::{ACCEPT_RETRY, ConnectionSlot, ConnectionSlots, PendingUse, SlotLimits};
use crate::problem::Problem;
use crate::server_state::ServerState;
use crate::tls::{AcceptedClient, ClientStream, LiveTls};

/// Limits of connection slots.
pub(crate) const SLOT_LIMITS: SlotLimits = SlotLimits {
    all: 256,
    of_one: 64,
    unauthenticated: 192,
    known: 224,
};

/// Connection slots of known clients that are reserved for users who may operate the machine.
pub(crate) const RESERVED: usize = 32;

/// A connection without traffic for this long is closed. Reason: longer than `?wait=1` waits, and than the interval of
/// the pings of a WebSocket.
const SILENCE_MAX: Duration = Duration::from_secs(75);

/// Longest time within which a client must read the data sent to it. Each byte that it reads extends it at
/// [`READ_RATE_MIN`]; then its connection is closed. Reason: unread data stays in memory.
const UNREAD_MAX: Duration = Duration::from_secs(20);

/// Bytes per second: the largest answer takes 17 minutes at this rate.
const READ_RATE_MIN: u32 = 64 * 1024;

/// Longest time to receive the header of a request; then its connection is closed.
pub(crate) const HEADER_MAX: Duration = Duration::from_secs(10);

/// Largest number of header lines of one request; more are 431.
const HEADER_LINES_MAX: usize = 64;

/// Largest number of bytes of the header of one request; more are 431.
const HEADER_BYTES_MAX: usize = 64 * 1024;

/// Longest time to send the rejection to a client without TLS.
const REFUSAL_MAX: Duration = Duration::from_secs(2);

/// Client of a connection.
#[derive(Debug, Clone)]
pub(crate) struct Peer {
    pub(crate) address: IpAddr,
    /// Certificate that the client has presented.
    pub(crate) certificate: Option<ClientCertificate>,
}

/// Returns the certificate that the connection of a request has shown.
pub(crate) fn certificate_of(extensions: &Extensions) -> Option<&ClientCertificate> {
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
    let mut builder = http1::Builder::new();
    builder
        .timer(TokioTimer::new())
        .header_read_timeout(header_max)
        .max_headers(HEADER_LINES_MAX)
        // a body is written without a copy: its memory is released once it is written
        .writev(true)
        .max_buf_size(HEADER_BYTES_MAX);
    let connections = TaskTracker::new();
    loop {
        let (stream, address, place) = tokio::select! {
            accepted = listener.accept() => accepted,
            () = stop.cancelled() => break,
        };
        let (builder, router, tls, stop) = (builder.clone(), router.clone(), tls.clone(), stop.clone());
        let leave = place.eviction_token();
        let place = Arc::new(place);
        let serving = async move {
            let Some(accepted) = accept_client(stream, tls.as_ref()).await else {
                return;
            };
            let peer = Peer {
                address: address.ip(),
                certificate: accepted.certificate,
            };
            let router = Extension(peer).layer(Extension(Arc::clone(&place)).layer(router));
            let connection = TokioIo::new(Connection::new(accepted.stream, place));
            let mut serving = pin!(
                builder
                    .serve_connection(connection, TowerToHyperService::new(router))
                    .with_upgrades()
            );
            // a broken connection concerns only its client
            tokio::select! {
                _ = serving.as_mut() => return,
                () = stop.cancelled() => serving.as_mut().graceful_shutdown(),
            }
            let _ = serving.await;
        };
        let serving = async move {
            tokio::select! {
                () = serving => {}
                () = leave.cancelled() => {}
            }
        };
        connections.spawn(listener.supervisor.contained("HTTP connection", serving));
    }
    drop(listener);
    connections.close();
    connections.wait().await;
}

/// Accepts a client. If there is a certificate and the client does not use TLS, it receives a rejection.
async fn accept_client(stream: TcpStream, tls: Option<&LiveTls>) -> Option<AcceptedClient> {
    let Some(tls) = tls else {
        return Some(AcceptedClient::plain(stream));
    };
    let mut accepted = tls.accept(stream).await.ok()?;
    if accepted.is_private() {
        return Some(accepted);
    }
    let text = "this port accepts only https: write https:// instead of http://\n";
    let answer = format!(
        "HTTP/1.1 400 Bad Request\r\ncontent-type: text/plain\r\ncontent-length: {}\r\nconnection: close\r\n\r\n{text}",
        text.len()
    );
    let refusing = async {
        accepted.stream.write_all(answer.as_bytes()).await?;
        accepted.stream.shutdown().await
    };
    // if the client does not read the response, it is dropped after this time
    let _ = tokio::time::timeout(REFUSAL_MAX, refusing).await;
    None
}

/// Requests that are served even without a free slot: those that stop a machine.
pub(crate) fn is_urgent(method: &Method, path: &str) -> bool {
    let last: StrDeserializer<'_, ValueError> =
        path.rsplit('/').next().unwrap_or_default().into_deserializer();
    method == Method::POST && Verb::deserialize(last).is_ok_and(Verb::is_urgent)
}

/// Connection slot while one of its requests is served.
pub(crate) struct HeldSlot {
    slot: Arc<ConnectionSlot>,
    is_known: bool,
    is_served: bool,
    /// Protects the connection of a user from eviction.
    _busy: Option<PendingUse>,
}

/// Marks the client as known if it presents a token or needs none. Returns `None` without a connection, in a test of
/// the router.
pub(crate) fn hold_slot(shared: &ServerState, request: &Request) -> Option<HeldSlot> {
    let place = Arc::clone(request.extensions().get::<Arc<ConnectionSlot>>()?);
    let is_already_known = place.is_known();
    let user = if is_already_known {
        None
    } else {
        let certificate = certificate_of(request.extensions());
        shared.access.identify(request.headers(), certificate)
    };
    let is_user = is_already_known || user.is_some();
    let may_operate = user.is_none_or(|user| user.has(Right::Operate));
    let is_known = is_user && place.mark_known(if may_operate { 0 } else { RESERVED });
    let is_full = is_user && !is_known && !is_urgent(request.method(), request.uri().path());
    // a request of a stranger never protects its slot: its body may take as long as the stranger wants
    let busy = is_user.then(|| place.protect_while_pending()).flatten();
    let is_open = busy.is_some() || !is_user && !place.eviction_token().is_cancelled();
    Some(HeldSlot {
        slot: place,
        is_known,
        is_served: is_open && !is_full,
        _busy: busy,
    })
}

impl HeldSlot {
    /// Returns true if the request of the connection must be served.
    pub(crate) fn is_served(&self) -> bool {
        self.is_served
    }

    /// Returns the response to a request that is not served.
    pub(crate) fn refusal(&self) -> Problem {
        let text = format!(
            "the limit of {} busy connections is reached; only hold, stop and abort are accepted now",
            self.slot.known_max()
        );
        Problem::new(StatusCode::SERVICE_UNAVAILABLE, "unavailable", text)
    }

    /// Closes the connection of an unknown client after one response.
    pub(crate) fn answered(self, response: &mut Response) {
        if response.status() == StatusCode::SWITCHING_PROTOCOLS {
            // from now on it is a WebSocket, which has its own limit
            self.slot.protect_permanently();
        } else if !self.is_known {
            let close = HeaderValue::from_static("close");
            response.headers_mut().insert(header::CONNECTION, close);
        }
    }
}

/// Accepts connections within the limits.
#[derive(Debug)]
pub(crate) struct LimitedListener {
    listener: TcpListener,
    slots: Arc<ConnectionSlots>,
    supervisor: Supervisor,
}

impl LimitedListener {
    pub(crate) fn new(listener: TcpListener, limits: SlotLimits) -> Self {
        Self {
            listener,
            slots: ConnectionSlots::new(limits),
            supervisor: Supervisor::default(),
        }
    }

    /// Supervisor to which faults in connections are reported.
    pub(crate) fn supervised_by(self, supervisor: Supervisor) -> Self {
        Self { supervisor, ..self }
    }

    async fn accept(&self) -> (TcpStream, SocketAddr, ConnectionSlot) {
        loop {
            let (stream, address) = match self.listener.accept().await {
                Ok(accepted) => accepted,
                Err(error) => {
                    tracing::warn!("cannot accept an HTTP connection: {error}");
                    tokio::time::sleep(ACCEPT_RETRY).await;
                    continue;
                }
            };
            let Some(place) = self.slots.acquire_slot(address.ip()) else {
                continue;
            };
            // without it responses are only slower
            let _ = stream.set_nodelay(true);
            return (stream, address, place);
        }
    }
}

/// A connection that is closed when it stays silent, and that is not read while its client does not read the sent data.
///
/// The layers above answer some input automatically (the pong of a ping), into a buffer of their own. The client
/// decides how fast that buffer empties, so it must not decide how fast it fills.
#[derive(Debug)]
pub(crate) struct Connection {
    stream: ClientStream,
    silence: Pin<Box<Sleep>>,
    slot: Arc<ConnectionSlot>,
    /// The latest write found no room.
    is_blocked: bool,
    /// When the connection is closed, unless the client has read all sent data by then.
    unread_timeout: Option<Pin<Box<Sleep>>>,
    /// The reader that waits for room.
    reader: Option<Waker>,
}

impl Connection {
    fn new(stream: ClientStream, slot: Arc<ConnectionSlot>) -> Self {
        Self {
            stream,
            silence: Box::pin(tokio::time::sleep(SILENCE_MAX)),
            slot,
            is_blocked: false,
            unread_timeout: None,
            reader: None,
        }
    }

    /// Restarts the timer of silence after any traffic; returns an error if the timer has ended.
    fn watched<T>(&mut self, context: &mut Context<'_>, result: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        match result {
            Poll::Ready(result) => {
                self.silence.as_mut().reset(Instant::now() + SILENCE_MAX);
                self.slot.record_transfer();
                Poll::Ready(result)
            }
            Poll::Pending if self.is_unresponsive(context) => {
                Poll::Ready(Err(io::ErrorKind::TimedOut.into()))
            }
            Poll::Pending => self
                .silence
                .as_mut()
                .poll(context)
                .map(|()| Err(io::ErrorKind::TimedOut.into())),
        }
    }

    /// Records the result of a write or flush of the layers above, and wakes the reader that waits for room.
    fn record_room<T>(&mut self, result: &Poll<io::Result<T>>) {
        self.is_blocked = result.is_pending();
        if self.is_blocked {
            let begin = || Box::pin(tokio::time::sleep(UNREAD_MAX));
            self.unread_timeout.get_or_insert_with(begin);
        } else if let Some(reader) = self.reader.take() {
            reader.wake();
        }
    }

    /// Notes a write.
    fn written(
        &mut self,
        context: &mut Context<'_>,
        result: Poll<io::Result<usize>>,
    ) -> Poll<io::Result<usize>> {
        self.record_room(&result);
        if let (Poll::Ready(Ok(count)), Some(untaken)) = (&result, &mut self.unread_timeout) {
            let bytes = u32::try_from(*count).unwrap_or(u32::MAX);
            let later = untaken.deadline() + Duration::from_secs(1).saturating_mul(bytes) / READ_RATE_MIN;
            untaken.as_mut().reset(later);
        }
        self.watched(context, result)
    }

    /// Returns `true` if the client has not read the sent data within the limit.
    fn is_unresponsive(&mut self, context: &mut Context<'_>) -> bool {
        (self.unread_timeout.as_mut()).is_some_and(|untaken| untaken.as_mut().poll(context).is_ready())
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let result = if self.is_blocked {
            self.reader = Some(context.waker().clone());
            Poll::Pending
        } else {
            Pin::new(&mut self.stream).poll_read(context, buffer)
        };
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
        self.written(context, result)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let result = Pin::new(&mut self.stream).poll_flush(context);
        self.record_room(&result);
        if result.is_ready() {
            // the layers above flush when they have written everything
            self.unread_timeout = None;
        }
        result
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
        self.written(context, result)
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
        let listener = LimitedListener::new(listener, SLOT_LIMITS);
        let address = listener.listener.local_addr().unwrap();
        let (client, (stream, _, place)) = tokio::join!(TcpStream::connect(address), listener.accept());
        let mut connection = Connection::new(AcceptedClient::plain(stream).stream, Arc::new(place));
        let begun = Instant::now();
        let error = connection.read_u8().await.unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::TimedOut);
        assert!(begun.elapsed() >= SILENCE_MAX);
        drop(client);
    }

    /// Returns a connection whose client has not read any sent data, and that client.
    async fn blocked() -> (Connection, TcpStream) {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let listener = LimitedListener::new(listener, SLOT_LIMITS);
        let address = listener.listener.local_addr().unwrap();
        let (client, (stream, _, place)) = tokio::join!(TcpStream::connect(address), listener.accept());
        let mut connection = Connection::new(AcceptedClient::plain(stream).stream, Arc::new(place));
        let large = vec![0; 1024 * 1024];
        std::future::poll_fn(|context| {
            while Pin::new(&mut connection).poll_write(context, &large).is_ready() {}
            Poll::Ready(())
        })
        .await;
        (connection, client.unwrap())
    }

    #[tokio::test]
    async fn nothing_is_read_while_the_client_does_not_take_what_it_was_sent() {
        let (mut connection, mut client) = blocked().await;
        client.write_all(b"more").await.unwrap();
        let early = tokio::time::timeout(Duration::from_millis(200), connection.read_u8()).await;
        assert!(early.is_err(), "{early:?}");
        let reading = async move {
            let mut taken = vec![0; 1024 * 1024];
            while client.read(&mut taken).await.is_ok_and(|count| count > 0) {}
        };
        tokio::spawn(reading);
        connection.write_all(&[0; 1000]).await.unwrap();
        connection.flush().await.unwrap();
        assert_eq!(connection.read_u8().await.unwrap(), b'm');
    }

    #[tokio::test]
    async fn a_client_that_takes_nothing_is_closed_after_its_time() {
        let (mut connection, client) = blocked().await;
        tokio::time::pause();
        let begun = Instant::now();
        let error = connection.read_u8().await.unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::TimedOut);
        let time = begun.elapsed();
        assert!(
            time + Duration::from_secs(2) >= UNREAD_MAX && time < SILENCE_MAX,
            "{time:?}"
        );
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
