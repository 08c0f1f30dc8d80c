//! The HTTP server: limits the number of connections and the size of headers, and closes silent connections.

use std::collections::HashMap;
use std::future::Future;
use std::io;
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::Router;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto;
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Instant, Sleep};
use tokio_util::sync::CancellationToken;

/// Open connections; more wait in the system's queue.
const CONNECTIONS_MAX: usize = 256;

/// A connection without traffic for this long is closed. Reason: longer than `?wait=1` waits, and than the interval of
/// the pings of a WebSocket.
const SILENCE_MAX: Duration = Duration::from_secs(75);

/// Connections of one address; more are closed at once. Reason: one host must not take all. The loopback may.
const CONNECTIONS_OF_ONE_MAX: usize = 64;

/// Time to receive the head of a request; then its connection is closed.
pub(crate) const HEADER_MAX: Duration = Duration::from_secs(10);

/// Header lines of one request; more are 431.
const HEADER_LINES_MAX: usize = 64;

/// Bytes of the head of one request; more are 431.
const HEADER_BYTES_MAX: usize = 64 * 1024;

/// Delay after the system failed to accept a connection, such as without file handles.
const ACCEPT_RETRY: Duration = Duration::from_millis(100);

/// Serves until `stop`, then until the running requests have ended. `header_max` is [`HEADER_MAX`], less in tests.
pub(crate) async fn serve(
    mut listener: LimitedListener,
    router: Router,
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
        let connection = tokio::select! {
            connection = listener.accept() => connection,
            () = stop.cancelled() => break,
        };
        let service = TowerToHyperService::new(router.clone());
        let serving = builder
            .serve_connection_with_upgrades(TokioIo::new(connection), service)
            .into_owned();
        let serving = graceful.watch(serving);
        // a broken connection concerns only its client
        tokio::spawn(async move { serving.await.ok() });
    }
    drop(listener);
    graceful.shutdown().await;
}

/// Accepts connections within the limits.
#[derive(Debug)]
pub(crate) struct LimitedListener {
    listener: TcpListener,
    places: Arc<Semaphore>,
    by_address: HashMap<IpAddr, Arc<Semaphore>>,
}

impl LimitedListener {
    pub(crate) fn new(listener: TcpListener) -> Self {
        Self {
            listener,
            places: Arc::new(Semaphore::new(CONNECTIONS_MAX)),
            by_address: HashMap::new(),
        }
    }

    /// A place for one more connection of an address, if there is one.
    fn place_of(&mut self, address: IpAddr) -> Option<OwnedSemaphorePermit> {
        // each permit holds its semaphore
        self.by_address.retain(|_, places| Arc::strong_count(places) > 1);
        let max = if address.is_loopback() {
            CONNECTIONS_MAX
        } else {
            CONNECTIONS_OF_ONE_MAX
        };
        let places = self.by_address.entry(address);
        let places = places.or_insert_with(|| Arc::new(Semaphore::new(max)));
        Arc::clone(places).try_acquire_owned().ok()
    }

    async fn accept(&mut self) -> Connection {
        let place = Arc::clone(&self.places).acquire_owned().await.ok();
        loop {
            let (stream, address) = match self.listener.accept().await {
                Ok(accepted) => accepted,
                Err(error) => {
                    tracing::warn!("no HTTP connection accepted: {error}");
                    tokio::time::sleep(ACCEPT_RETRY).await;
                    continue;
                }
            };
            let Some(of_address) = self.place_of(address.ip()) else {
                continue;
            };
            // without it responses are only slower
            let _ = stream.set_nodelay(true);
            return Connection {
                stream,
                silence: Box::pin(tokio::time::sleep(SILENCE_MAX)),
                _places: (place, of_address),
            };
        }
    }
}

/// A connection that is closed when it stays silent.
#[derive(Debug)]
pub(crate) struct Connection {
    stream: TcpStream,
    silence: Pin<Box<Sleep>>,
    _places: (Option<OwnedSemaphorePermit>, OwnedSemaphorePermit),
}

impl Connection {
    /// Any traffic restarts the timer; its end is an error.
    fn watched<T>(&mut self, context: &mut Context<'_>, result: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        match result {
            Poll::Ready(result) => {
                self.silence.as_mut().reset(Instant::now() + SILENCE_MAX);
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
        let mut listener = LimitedListener::new(listener);
        let address = listener.listener.local_addr().unwrap();
        let (client, mut connection) = tokio::join!(TcpStream::connect(address), listener.accept());
        let begun = Instant::now();
        let error = connection.read_u8().await.unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::TimedOut);
        assert!(begun.elapsed() >= SILENCE_MAX);
        drop(client);
    }

    #[tokio::test(start_paused = true)]
    async fn no_more_connections_are_accepted_than_the_limit() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let mut listener = LimitedListener::new(listener);
        let address = listener.listener.local_addr().unwrap();
        let mut open = Vec::new();
        for _ in 0..CONNECTIONS_MAX {
            let (client, connection) = tokio::join!(TcpStream::connect(address), listener.accept());
            open.push((client, connection));
        }
        let _waiting = TcpStream::connect(address).await.unwrap();
        let second = Duration::from_secs(1);
        assert!(tokio::time::timeout(second, listener.accept()).await.is_err());
        open.pop();
        listener.accept().await;
    }

    #[tokio::test]
    async fn one_address_of_the_network_does_not_take_all_places() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let mut listener = LimitedListener::new(listener);
        let (host, other) = (IpAddr::from([10, 0, 0, 1]), IpAddr::from([10, 0, 0, 2]));
        let mut open: Vec<_> = (0..CONNECTIONS_OF_ONE_MAX)
            .map(|_| listener.place_of(host).unwrap())
            .collect();
        assert!(listener.place_of(host).is_none());
        assert!(listener.place_of(other).is_some());
        open.pop();
        assert!(listener.place_of(host).is_some());
        let loopback: Vec<_> = (0..CONNECTIONS_MAX)
            .map(|_| listener.place_of([127, 0, 0, 1].into()))
            .collect();
        assert!(loopback.iter().all(Option::is_some));
        drop((open, loopback));
        listener.place_of(other);
        assert_eq!(
            listener.by_address.len(),
            1,
            "those without connections are forgotten"
        );
    }
}
