//! The WebSocket, which carries messages of the machine, and presences and validation results of handlers.

use std::sync::Arc;

use futures_util::{SinkExt, StreamExt};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::http::HeaderValue;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::tungstenite::{self, Message as Frame};
use tokio_tungstenite::{Connector, MaybeTlsStream, WebSocketStream, connect_async_tls_with_config};

use crate::lock::lock;
use crate::types::request::{Refusal, Request};
use crate::types::topic::Topic;
use crate::wire::PAYLOAD_MAX;
use crate::wire::websocket::{ClientFrame, SILENCE_MAX, ServerFrame, encode};

use super::super::backoff::Backoff;
use super::RestClient;

type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;

/// Largest number of bytes of unsent frames. Reason: this is many times the size of the largest message of a
/// client, and of pongs. At this limit a further pong replaces the unsent pong. A further message ends the
/// connection, which the client then opens again.
const UNSENT_BYTES_MAX: usize = 16 * PAYLOAD_MAX;

/// Returns the limits of the WebSocket library. By default the library does not limit the bytes of the pongs
/// that a server can make it send.
fn limits() -> WebSocketConfig {
    WebSocketConfig::default()
        .write_buffer_size(0)
        .max_write_buffer_size(UNSENT_BYTES_MAX)
}

pub(super) async fn keep_connected(shared: Arc<RestClient>) {
    let mut backoff = Backoff::default();
    while !shared.link.is_closed() {
        match open(&shared).await {
            Ok(mut socket) => {
                tracing::info!(address = %shared.link.address, "connected");
                backoff.reset();
                if let Err(error) = serve(&shared, &mut socket).await {
                    tracing::warn!(%error, address = %shared.link.address, "connection lost");
                    lock(&shared.state).trouble = Some(error.to_string());
                }
                // until the next connection the known `pending` may be stale
                shared.link.set_offline();
            }
            Err(error) => lock(&shared.state).trouble = Some(error.to_string()),
        }
        if !shared.link.is_closed() {
            backoff.wait().await;
        }
    }
}

async fn open(shared: &RestClient) -> tungstenite::Result<Socket> {
    let mut request = shared.address.websocket.as_str().into_client_request()?;
    if let Some(token) = &shared.address.token {
        let bearer = HeaderValue::try_from(format!("Bearer {token}"))
            .map_err(|error| tungstenite::Error::HttpFormat(error.into()))?;
        request.headers_mut().insert("authorization", bearer);
    }
    let connector = if shared.address.tls {
        Connector::Rustls(Arc::clone(&shared.tls))
    } else {
        Connector::Plain
    };
    let (mut socket, _) =
        connect_async_tls_with_config(request, Some(limits()), false, Some(connector)).await?;
    let subscribe = ClientFrame {
        subscribe: vec!["#".to_owned()],
        ..ClientFrame::default()
    };
    socket.send(Frame::text(subscribe.to_json())).await?;
    let mut state = lock(&shared.state);
    state.trouble = None;
    state.unsent = state.handlers.keys().cloned().collect();
    // the machine no longer waits for the results of validations that it requested on the last connection
    state.validated.clear();
    drop(state);
    shared.link.wake.notify_one();
    Ok(socket)
}

/// Receives and sends until the connection ends, or the port is dropped.
async fn serve(shared: &RestClient, socket: &mut Socket) -> tungstenite::Result<()> {
    loop {
        tokio::select! {
            frame = tokio::time::timeout(SILENCE_MAX, socket.next()) => match frame {
                Ok(Some(Ok(Frame::Text(text)))) => on_text(shared, &text),
                Ok(Some(Ok(Frame::Close(_))) | None) => return Err(tungstenite::Error::ConnectionClosed),
                Ok(Some(Ok(_))) => {}
                Ok(Some(Err(error))) => return Err(error),
                Err(_) => return Err(tungstenite::Error::Io(std::io::ErrorKind::TimedOut.into())),
            },
            () = shared.link.wake.notified() => {
                if shared.link.is_closed() {
                    // the close frame lets the machine notice at once that the handlers are offline
                    return socket.close(None).await;
                }
                for frame in unsent(shared) {
                    socket.send(Frame::text(frame.to_json())).await?;
                }
            }
        }
    }
}

/// Returns the frames to send: presence of handlers first, then results of validations.
fn unsent(shared: &RestClient) -> Vec<ClientFrame> {
    let mut state = lock(&shared.state);
    let unsent = std::mem::take(&mut state.unsent).into_iter();
    let frames = unsent.filter_map(|id| {
        let gone = state.offline.remove(&id).unwrap_or_default();
        let presence = match state.handlers.get_mut(&id) {
            // the announcement requests a take-over only once
            Some(known) => {
                let said = known.clone();
                known.take_over = false;
                said
            }
            None => gone,
        };
        encode(Request::Handler(id, presence)).ok()
    });
    let mut frames: Vec<_> = frames.collect();
    frames.append(&mut state.validated);
    frames
}

/// Passes a message to the hub.
fn on_text(shared: &RestClient, text: &str) {
    match ServerFrame::read(text) {
        ServerFrame::Message(message) => shared.link.hub.publish(*message),
        ServerFrame::Error(refusal) => {
            tracing::warn!(%refusal, "the machine refuses");
            on_error(shared, refusal);
        }
        ServerFrame::Unknown(why) => tracing::debug!(%why, "a message of an unknown format is ignored"),
    }
}

/// Records that the machine has refused the handler which an error frame names.
fn on_error(shared: &RestClient, refusal: Refusal) {
    let mut state = lock(&shared.state);
    let is_named = |id: &&String| {
        refusal
            .text
            .contains(&Topic::HandlerPresence((*id).clone()).path())
    };
    let Some(id) = state.handlers.keys().find(is_named).cloned() else {
        return;
    };
    state.handlers.remove(&id);
    state.refused.insert(id, refusal);
    drop(state);
    shared.refused.notify_waiters();
}
