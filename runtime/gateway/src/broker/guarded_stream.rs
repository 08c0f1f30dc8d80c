//! Byte stream between a client and the library: packet by packet, with rejections of the broker.

use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};

use mqtt5::broker::transport::WebSocketTransport;
use mqtt5::types::ReasonCode;
use parking_lot::Mutex;
use tokio::io::{AsyncBufRead as _, AsyncRead, AsyncWrite, BufReader, ReadBuf};
use tokio_util::either::Either;
use tokio_util::sync::WaitForCancellationFutureOwned;

use super::packet_monitor::PacketMonitor;
use super::socket::SocketBytes;
use crate::tls::ClientStream;

/// Largest size of the read buffer of a connection, bytes.
const READ_MAX: usize = 4096;

/// A connection of a client: over TCP with TLS or without, or over a WebSocket.
pub(super) type ClientTransport = Either<ClientStream, Box<SocketBytes>>;

/// Byte stream of a connection. The library acknowledges a message that the guard has handled as a success, and asks
/// for no reason: here the acknowledgement of a rejected message is replaced by one with its reason.
pub(super) struct GuardedStream {
    inner: BufReader<ClientTransport>,
    peer: SocketAddr,
    /// Packet id of the message whose acknowledgement comes next and must become a rejection.
    refused: Arc<Mutex<Option<u16>>>,
    /// Unwritten rest of the acknowledgement, and the number of bytes of the library that it replaces.
    answer: Vec<u8>,
    replaced: usize,
    /// Unwritten bytes of a packet that was partly written.
    unwritten: usize,
    line: Arc<PacketMonitor>,
    ended: Pin<Box<WaitForCancellationFutureOwned>>,
}

impl GuardedStream {
    pub(super) fn new(
        stream: ClientTransport,
        peer: SocketAddr,
        refused: Arc<Mutex<Option<u16>>>,
        line: Arc<PacketMonitor>,
    ) -> Self {
        Self {
            inner: BufReader::with_capacity(READ_MAX, stream),
            peer,
            refused,
            answer: Vec::new(),
            replaced: 0,
            unwritten: 0,
            ended: Box::pin(line.ended.clone().cancelled_owned()),
            line,
        }
    }

    /// Ends reading and, if there is a reason, sends it to the client. Reads happen only between two written packets; a
    /// client that does not accept it at once does not get it.
    fn finish_reading(&mut self, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let packet = self.line.farewell();
        let _ = Pin::new(&mut self.inner).poll_write(context, &packet);
        Poll::Ready(Ok(()))
    }

    /// Returns the rejection that replaces a PUBACK or PUBREC. The library writes each packet at once.
    fn refusal(&self, packet: &[u8]) -> Option<Vec<u8>> {
        let id = (*self.refused.lock())?.to_be_bytes();
        match *packet {
            [kind @ (0x40 | 0x50), 2, high, low] if [high, low] == id => {
                Some(vec![kind, 3, high, low, u8::from(ReasonCode::QuotaExceeded)])
            }
            _ => None,
        }
    }
}

impl WebSocketTransport for GuardedStream {
    fn peer_addr(&self) -> mqtt5::Result<SocketAddr> {
        Ok(self.peer)
    }
}

/// Acknowledges received data at once instead of after 40 ms: a client that collects small packets (Nagle's algorithm,
/// without `TCP_NODELAY`) sends nothing until then. The setting does not last.
fn acknowledge_at_once(stream: &ClientTransport) {
    #[cfg(target_os = "linux")]
    {
        let tcp = match stream {
            Either::Left(Either::Left(tcp)) => tcp,
            Either::Left(Either::Right(tls)) => tls.get_ref().0,
            // the HTTP server does this
            Either::Right(_) => return,
        };
        // on failure, a client is only slower
        let _ = tcp.set_quickack(true);
    }
    #[cfg(not(target_os = "linux"))]
    let _ = stream;
}

impl AsyncRead for GuardedStream {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if self.ended.as_mut().poll(context).is_ready() {
            return self.finish_reading(context);
        }
        let Self { inner, line, .. } = &mut *self;
        let is_new = inner.buffer().is_empty();
        let _ = ready!(Pin::new(&mut *inner).poll_fill_buf(context))?;
        if is_new {
            acknowledge_at_once(inner.get_ref());
        }
        let bytes = inner.buffer();
        let read = line.read(&bytes[..bytes.len().min(buffer.remaining())]);
        if line.end_if_refused() {
            return self.finish_reading(context);
        }
        buffer.put_slice(&bytes[..read]);
        Pin::new(inner).consume(read);
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for GuardedStream {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        if self.ended.as_mut().poll(context).is_ready() {
            return Poll::Ready(Err(io::ErrorKind::ConnectionAborted.into()));
        }
        if self.answer.is_empty() {
            let Some(refusal) = self.refusal(bytes) else {
                let written = Pin::new(&mut self.inner).poll_write(context, bytes);
                if let Poll::Ready(Ok(count)) = written {
                    if self.unwritten == 0 {
                        self.line.write(bytes);
                    }
                    self.unwritten = bytes.len() - count;
                }
                self.line.set_stalled(written.is_pending());
                return written;
            };
            *self.refused.lock() = None;
            self.replaced = bytes.len();
            self.answer = refusal;
        }
        while !self.answer.is_empty() {
            let Self { inner, answer, .. } = &mut *self;
            let written = ready!(Pin::new(inner).poll_write(context, answer))?;
            answer.drain(..written);
        }
        Poll::Ready(Ok(self.replaced))
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner).poll_shutdown(context)
    }
}
