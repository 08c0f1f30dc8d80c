//! The documents of the interface, which tests keep equal to its types and tables.

use std::sync::{Arc, LazyLock};

use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};
use serde_json::{Value, json};

use crate::problem::Problem;
use crate::server_state::{ServerState, unexpected};

const OPENAPI: &str = include_str!("../../api/openapi.json");
const ASYNCAPI: &str = include_str!("../../api/asyncapi.json");

/// Parsed once: that takes longer than the rest of a request for it.
static PARSED_ASYNCAPI: LazyLock<Option<Value>> = LazyLock::new(|| serde_json::from_str(ASYNCAPI).ok());

pub(super) fn routes() -> Router<Arc<ServerState>> {
    Router::new()
        .route("/openapi.json", get(|| async { document(OPENAPI) }))
        .route("/asyncapi.json", get(asyncapi))
}

fn document(text: &'static str) -> Response {
    let kind = HeaderValue::from_static("application/json");
    ([(header::CONTENT_TYPE, kind)], text).into_response()
}

/// Returns the MQTT document, with the servers at which the client reaches this machine.
async fn asyncapi(
    State(shared): State<Arc<ServerState>>,
    headers: HeaderMap,
) -> Result<Json<Value>, Problem> {
    let mut document = Value::clone(PARSED_ASYNCAPI.as_ref().ok_or_else(unexpected)?);
    let asked = headers.get(header::HOST).and_then(|host| host.to_str().ok());
    let here = asked.map_or_else(|| shared.http_addr.to_string(), str::to_owned);
    let websocket = if shared.scheme == "https" { "wss" } else { "ws" };
    let mqtt = &shared.mqtt_server;
    let host = mqtt.host.as_deref().unwrap_or_else(|| without_port(&here));
    let protocol = if mqtt.is_private { "mqtts" } else { "mqtt" };
    document["servers"] = json!({
        "machine": {"host": format!("{host}:{}", mqtt.port), "protocol": protocol},
        "websocket": {"host": here, "protocol": websocket},
    });
    Ok(Json(document))
}

/// Returns the host of `host:port`; an IPv6 address is in brackets.
fn without_port(host: &str) -> &str {
    match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|digit| digit.is_ascii_digit()) && !name.is_empty() => name,
        _ => host,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_host_of_an_address_is_what_stands_before_its_port() {
        for (host, name) in [
            ("mill:8080", "mill"),
            ("mill", "mill"),
            ("[::1]:8080", "[::1]"),
            ("[::1]", "[::1]"),
        ] {
            assert_eq!(without_port(host), name, "{host}");
        }
    }
}
