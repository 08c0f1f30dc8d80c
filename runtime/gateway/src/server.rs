//! The HTTP server: connections are counted, silent ones are closed, and headers have limits.

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
use parking_lot::Mutex;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Instant, Sleep};
use tokio_util::sync::CancellationToken;

/// Connections that may be open; more wait in the system's queue.
const CONNECTIONS_MAX: usize = 256;

/// A connection on which nothing comes or goes for this long is closed. Reason: longer than `?wait=1` waits, and
/// than the pings of a WebSocket are apart.
const SILENCE_MAX: Duration = Duration::from_secs(75);

/// Connections of one address but the loopback; more are closed at once. Reason: one host must not take them all.
const CONNECTIONS_OF_ONE_MAX: usize = 64;

/// Time for the head of a request to come in; then its connection is closed.
pub(crate) const HEADER_MAX: Duration = Duration::from_secs(10);

/// Header lines of one request; more are 431.
const HEADER_LINES_MAX: usize = 64;

/// Bytes of the head of one request; more are 431.
const HEADER_BYTES_MAX: usize = 64 * 1024;

/// Wait after the system gave no connection, such as for want of file handles.
const ACCEPT_RETRY: Duration = Duration::from_millis(100);

/// Serves until `stop`, then until the requests that run have ended. `header_max` is [`HEADER_MAX`].
pub(crate) async fn serve(
    listener: LimitedListener,
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
        // a connection that breaks is its client's affair
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
    of_one: OfOne,
}

/// Connections that are open by address.
#[derive(Debug, Clone, Default)]
struct OfOne(Arc<Mutex<HashMap<IpAddr, usize>>>);

impl OfOne {
    /// A place for one more of an address, if there is one.
    fn place(&self, address: IpAddr) -> Option<PlaceOfOne> {
        let mut counts = self.0.lock();
        let count = counts.entry(address).or_default();
        if *count >= CONNECTIONS_OF_ONE_MAX && !address.is_loopback() {
            return None;
        }
        *count += 1;
        Some(PlaceOfOne {
            of_one: self.clone(),
            address,
        })
    }
}

/// Gives the place back when it is dropped.
#[derive(Debug)]
struct PlaceOfOne {
    of_one: OfOne,
    address: IpAddr,
}

impl Drop for PlaceOfOne {
    fn drop(&mut self) {
        let mut counts = self.of_one.0.lock();
        if let Some(count) = counts.get_mut(&self.address) {
            *count -= 1;
            if *count == 0 {
                counts.remove(&self.address);
            }
        }
    }
}

impl LimitedListener {
    pub(crate) fn new(listener: TcpListener) -> Self {
        Self {
            listener,
            places: Arc::new(Semaphore::new(CONNECTIONS_MAX)),
            of_one: OfOne::default(),
        }
    }

    async fn accept(&self) -> Connection {
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
            let Some(of_one) = self.of_one.place(address.ip()) else {
                continue;
            };
            // without it answers are slower, but right
            let _ = stream.set_nodelay(true);
            return Connection {
                stream,
                silence: Box::pin(tokio::time::sleep(SILENCE_MAX)),
                _places: (place, of_one),
            };
        }
    }
}

/// A connection that is closed when it stays silent.
#[derive(Debug)]
pub(crate) struct Connection {
    stream: TcpStream,
    silence: Pin<Box<Sleep>>,
    _places: (Option<OwnedSemaphorePermit>, PlaceOfOne),
}

impl Connection {
    /// Anything that came or went starts the silence anew; waiting too long is an error.
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
        let listener = LimitedListener::new(listener);
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
        let listener = LimitedListener::new(listener);
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
}
