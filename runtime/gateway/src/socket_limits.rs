//! Limits of every WebSocket of the server, before and after its client is authenticated.

use axum::extract::ws::{Message as Frame, WebSocketUpgrade};

use crate::access::Rate;

/// Bytes that the library reads at once. Reason: it reserves them for each connection, and answers the pings among them before
/// the connection notices that its client does not read.
const READ_BYTES: usize = 16 * 1024;

/// Largest number of bytes of frames that wait to be written to one client: the largest message, and pongs. A further
/// pong replaces the one that waits, and a further message ends the connection.
pub(crate) const UNSENT_BYTES_MAX: usize = 1024 * 1024 + 64 * 1024;

/// Control frames and empty frames of one client: burst, and rate per second. More end its connection. Reason: a client sends
/// a ping every few seconds, and a pong for each of ours.
const CONTROL_BURST: u32 = 100;
const CONTROL_PER_SECOND: u32 = 20;

/// Reason for closing the connection of a client that sends more.
pub(crate) const TOO_MANY_CONTROL_FRAMES: &str = "more than 20 pings, pongs or empty frames per second";

/// Sets the limits of a connection whose client may send messages of this size, in bytes.
pub(crate) fn limit(upgrade: WebSocketUpgrade, message_max: usize) -> WebSocketUpgrade {
    upgrade
        .read_buffer_size(READ_BYTES)
        // each message is written at once
        .write_buffer_size(0)
        .max_write_buffer_size(UNSENT_BYTES_MAX)
        .max_message_size(message_max)
        .max_frame_size(message_max)
}

/// Control frames that one client has sent.
#[derive(Debug)]
pub(crate) struct ControlFrames(Rate);

impl ControlFrames {
    pub(crate) fn new() -> Self {
        Self(Rate::new(CONTROL_BURST, CONTROL_PER_SECOND))
    }

    /// Counts a frame. Returns `false` if it is one control frame too many.
    pub(crate) fn admit(&self, frame: &Frame) -> bool {
        let is_empty = match frame {
            Frame::Ping(_) | Frame::Pong(_) => true,
            Frame::Binary(bytes) => bytes.is_empty(),
            Frame::Text(text) => text.is_empty(),
            Frame::Close(_) => false,
        };
        !is_empty || self.0.try_charge().is_ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn control_frames_have_a_burst_and_a_rate_and_others_do_not() {
        let frames = ControlFrames::new();
        let ping = Frame::Ping(Vec::new().into());
        for _ in 0..CONTROL_BURST {
            assert!(frames.admit(&ping));
        }
        assert!(!frames.admit(&Frame::Pong(Vec::new().into())));
        assert!(!frames.admit(&Frame::Binary(Vec::new().into())));
        assert!(frames.admit(&Frame::Text("{}".into())));
        assert!(frames.admit(&Frame::Close(None)));
        tokio::time::advance(std::time::Duration::from_secs(1)).await;
        for _ in 0..CONTROL_PER_SECOND {
            assert!(frames.admit(&ping));
        }
        assert!(!frames.admit(&ping));
        assert!(TOO_MANY_CONTROL_FRAMES.contains(&format!("than {CONTROL_PER_SECOND} ")));
    }
}
