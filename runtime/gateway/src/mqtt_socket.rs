//! MQTT over WebSocket, `/mqtt`: the embedded broker for pages in a browser. Its bytes are those of a connection over
//! TCP, in binary frames; a packet may be in several, and a frame may contain several. The broker itself decides which
//! clients may connect.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;

use axum::extract::ws::WebSocketUpgrade;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Extension, Router};
use tokio::sync::Semaphore;

use crate::broker::{PACKET_MAX, SocketBytes, WebSocketListener};
use crate::problem::Problem;
use crate::server::Peer;
use crate::server_state::ServerState;
use crate::socket_limits;

/// Path of the broker.
const PATH: &str = "/mqtt";

/// Sub-protocols of MQTT (MQTT 5, 6.0-3).
const PROTOCOLS: [&str; 2] = ["mqtt", "mqttv3.1"];

/// Largest number of connections over WebSocket; further ones get 503. Reason: each takes a slot of HTTP before it is
/// authenticated.
pub(crate) const SOCKETS_MAX: usize = 64;

// the largest packet and some pongs have room
const _: () = assert!(PACKET_MAX < socket_limits::UNSENT_BYTES_MAX);

/// Returns its route; none without an entrance to the broker.
pub(crate) fn routes(entrance: Option<&WebSocketListener>) -> Router<Arc<ServerState>> {
    let Some(entrance) = entrance else {
        return Router::new();
    };
    let (entrance, sockets) = (entrance.clone(), Arc::new(Semaphore::new(SOCKETS_MAX)));
    let upgrade = move |peer: Option<Extension<Peer>>,
                        upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>| async move {
        upgrade_to(entrance, sockets, peer.map(|Extension(peer)| peer), upgrade)
    };
    Router::new().route(PATH, get(upgrade))
}

fn upgrade_to(
    entrance: WebSocketListener,
    sockets: Arc<Semaphore>,
    peer: Option<Peer>,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Response {
    let upgrade = match upgrade {
        Ok(upgrade) => upgrade,
        Err(refusal) => {
            return Problem::new(refusal.status(), "no_websocket", refusal.body_text()).into_response();
        }
    };
    let Ok(permit) = sockets.try_acquire_owned() else {
        let text = format!("the limit of {SOCKETS_MAX} MQTT clients over WebSocket is reached");
        return Problem::new(StatusCode::SERVICE_UNAVAILABLE, "unavailable", text).into_response();
    };
    // a request without a connection comes from a test of the router
    let (address, certificate) = match peer {
        Some(peer) => (peer.address, peer.certificate),
        None => (IpAddr::V4(Ipv4Addr::LOCALHOST), None),
    };
    socket_limits::limit(upgrade, PACKET_MAX)
        .protocols(PROTOCOLS)
        .on_upgrade(move |socket| async move {
            let bytes = SocketBytes::new(socket);
            entrance
                .serve(bytes, SocketAddr::new(address, 0), certificate)
                .await;
            drop(permit);
        })
}
