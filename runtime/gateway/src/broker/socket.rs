//! A connection over WebSocket: it has the same bytes as one over TCP, in binary frames.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use axum::body::Bytes;
use axum::extract::ws::{Message as Frame, WebSocket};
use futures_util::{Sink, Stream};
use parking_lot::Mutex;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use crate::socket_limits::{ControlFrames, TOO_MANY_CONTROL_FRAMES};

/// The bytes in the frames of a WebSocket.
pub(crate) struct SocketBytes {
    /// Never locked; the library requires a connection that is `Sync`.
    socket: Mutex<WebSocket>,
    /// Received bytes that are not read yet.
    come: Bytes,
    /// A frame may not be fully sent yet.
    is_unflushed: bool,
    control: ControlFrames,
}

impl std::fmt::Debug for SocketBytes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SocketBytes").finish_non_exhaustive()
    }
}

impl SocketBytes {
    pub(crate) fn new(socket: WebSocket) -> Self {
        Self {
            socket: Mutex::new(socket),
            come: Bytes::new(),
            is_unflushed: false,
            control: ControlFrames::new(),
        }
    }

    fn flush(&mut self, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        ready!(Pin::new(self.socket.get_mut()).poll_flush(context)).map_err(io::Error::other)?;
        self.is_unflushed = false;
        Poll::Ready(Ok(()))
    }
}

impl AsyncRead for SocketBytes {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        // a read continues an unfinished flush, so a frame is sent even if the writer does not flush again
        if self.is_unflushed
            && let Poll::Ready(flushed) = self.flush(context)
        {
            flushed?;
        }
        while self.come.is_empty() {
            let frame = ready!(Pin::new(self.socket.get_mut()).poll_next(context));
            if let Some(Ok(frame)) = &frame
                && !self.control.admit(frame)
            {
                let error = io::Error::new(io::ErrorKind::InvalidData, TOO_MANY_CONTROL_FRAMES);
                return Poll::Ready(Err(error));
            }
            match frame {
                Some(Ok(Frame::Binary(bytes))) => self.come = bytes,
                Some(Ok(Frame::Ping(_) | Frame::Pong(_))) => {}
                Some(Ok(Frame::Text(_))) => {
                    let text = "MQTT is sent in binary frames";
                    return Poll::Ready(Err(io::Error::new(io::ErrorKind::InvalidData, text)));
                }
                Some(Ok(Frame::Close(_))) | None => return Poll::Ready(Ok(())),
                Some(Err(error)) => return Poll::Ready(Err(io::Error::other(error))),
            }
        }
        let count = self.come.len().min(buffer.remaining());
        buffer.put_slice(&self.come.split_to(count));
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for SocketBytes {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        // one frame at a time: a client that does not read delays only its own
        if self.is_unflushed {
            ready!(self.flush(context))?;
        }
        ready!(Pin::new(self.socket.get_mut()).poll_ready(context)).map_err(io::Error::other)?;
        let frame = Frame::Binary(Bytes::copy_from_slice(bytes));
        Pin::new(self.socket.get_mut())
            .start_send(frame)
            .map_err(io::Error::other)?;
        self.is_unflushed = true;
        if let Poll::Ready(flushed) = self.flush(context) {
            flushed?;
        }
        Poll::Ready(Ok(bytes.len()))
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(self.socket.get_mut())
            .poll_close(context)
            .map_err(io::Error::other)
    }
}
