//! The WebSocket: what the machine says, which handlers this process serves, and what they say of programs to be loaded.

use std::sync::Arc;
use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::http::HeaderValue;
use tokio_tungstenite::tungstenite::{self, Message as Frame};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream};

use crate::lock::lock;
use crate::types::message::{Message, Payload};
use crate::types::request::Request;
use crate::types::topic::Topic;
use crate::wire::websocket::{ClientFrame, ServerFrame, encode};

use super::super::backoff::Backoff;
use super::Shared;

/// The machine pings every 15 s; silence for this long means that the connection is gone.
const SILENCE_MAX: Duration = Duration::from_secs(45);

type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;

/// Keeps a connection until the port is dropped.
pub(super) async fn keep_connected(shared: Arc<Shared>) {
    let mut backoff = Backoff::default();
    while !shared.is_closed() {
        match open(&shared).await {
            Ok(mut socket) => {
                tracing::info!(address = %shared.address.shown, "connected");
                backoff.reset();
                if let Err(error) = serve(&shared, &mut socket).await {
                    tracing::warn!(%error, address = %shared.address.shown, "connection lost");
                    lock(&shared.state).trouble = Some(error.to_string());
                }
                gone(&shared);
            }
            Err(error) => lock(&shared.state).trouble = Some(error.to_string()),
        }
        if !shared.is_closed() {
            backoff.wait().await;
        }
    }
}

async fn open(shared: &Shared) -> tungstenite::Result<Socket> {
    let mut request = shared.address.websocket.as_str().into_client_request()?;
    if let Some(token) = &shared.address.token {
        let bearer = HeaderValue::try_from(format!("Bearer {token}"))
            .map_err(|error| tungstenite::Error::HttpFormat(error.into()))?;
        request.headers_mut().insert("authorization", bearer);
    }
    let (mut socket, _) = tokio_tungstenite::connect_async(request).await?;
    let subscribe = ClientFrame {
        subscribe: vec!["#".to_owned()],
        ..ClientFrame::default()
    };
    socket.send(Frame::text(subscribe.to_json())).await?;
    let mut state = lock(&shared.state);
    state.trouble = None;
    state.unsaid = state.handlers.keys().cloned().collect();
    // What was asked over the last connection is not waited for any more.
    state.validated.clear();
    drop(state);
    shared.wake.notify_one();
    Ok(socket)
}

/// Until the connection ends, or the port is dropped.
async fn serve(shared: &Shared, socket: &mut Socket) -> tungstenite::Result<()> {
    loop {
        tokio::select! {
            frame = tokio::time::timeout(SILENCE_MAX, socket.next()) => match frame {
                Ok(Some(Ok(Frame::Text(text)))) => hear(shared, &text),
                Ok(Some(Ok(Frame::Close(_))) | None) => return Err(tungstenite::Error::ConnectionClosed),
                Ok(Some(Ok(_))) => {}
                Ok(Some(Err(error))) => return Err(error),
                Err(_) => return Err(tungstenite::Error::Io(std::io::ErrorKind::TimedOut.into())),
            },
            () = shared.wake.notified() => {
                if shared.is_closed() {
                    // The machine notices at once that the handlers have gone.
                    return socket.close(None).await;
                }
                for said in unsaid(shared) {
                    socket.send(Frame::text(said.to_json())).await?;
                }
            }
        }
    }
}

/// The frames that are still to be said: presences of handlers first, then what they have validated.
fn unsaid(shared: &Shared) -> Vec<ClientFrame> {
    let mut state = lock(&shared.state);
    let unsaid = std::mem::take(&mut state.unsaid).into_iter();
    let frames = unsaid.filter_map(|id| {
        let presence = state.handlers.get(&id).cloned().unwrap_or_default();
        encode(Request::Handler(id, presence)).ok()
    });
    let mut frames: Vec<_> = frames.collect();
    frames.append(&mut state.validated);
    frames
}

/// Until the next connection the machine counts as absent: what is pending may be out of date.
fn gone(shared: &Shared) {
    let Some(last) = shared.hub.read(&Topic::Presence) else {
        return;
    };
    if let Payload::Presence(presence) = &last.payload {
        let mut absent = presence.clone();
        absent.online = false;
        shared.hub.publish(Message {
            payload: Payload::Presence(absent),
            ..(*last).clone()
        });
    }
}

/// Hands a message to the hub.
fn hear(shared: &Shared, text: &str) {
    match ServerFrame::read(text) {
        ServerFrame::Message(message) => shared.hub.publish(message),
        ServerFrame::Error(text) => {
            tracing::warn!(%text, "the machine refuses");
            refused(shared, text);
        }
        ServerFrame::Unknown(why) => tracing::debug!(%why, "a message is passed over"),
    }
}

/// Tells who waits for the handler that an error frame names.
fn refused(shared: &Shared, text: String) {
    let mut state = lock(&shared.state);
    let is_named = |id: &&String| text.contains(&Topic::HandlerPresence((*id).clone()).path());
    let Some(id) = state.handlers.keys().find(is_named).cloned() else {
        return;
    };
    state.handlers.remove(&id);
    state.refused.insert(id, text);
    drop(state);
    shared.refused.notify_waiters();
}
