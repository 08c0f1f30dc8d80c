//! Readable states: the same messages as on MQTT, with the revision as `ETag`.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::Router;
use axum::extract::rejection::RawPathParamsRejection;
use axum::extract::{RawPathParams, State};
use axum::http::{HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::io::IoSide;
use plc_protocol::types::message::Message;
use plc_protocol::types::topic::{CsTopic, Topic};
use plc_protocol::wire::row::number;
use plc_protocol::wire::states::{
    AllIo, CoordinateSystems, Health, HealthStatus, Inputs, STATES, StateRow, WithState,
};
use prometheus_client::encoding::prometheus_text::CONTENT_TYPE;
use serde_json::{Value, json};

use super::login::{current_user, log_in, log_out};
use super::{json_response, params};
use crate::metrics::States;
use crate::problem::Problem;
use crate::server_state::ServerState;

/// Routes that the server answers without the machine.
pub(super) fn own_routes() -> Router<Arc<ServerState>> {
    Router::new()
        .route("/cs", get(coordinate_systems))
        .route("/cs/{cs}/inputs", get(inputs))
        .route("/io", get(all_io))
        .route("/hmi", get(hmi))
        .route("/machines", get(machines))
        .route("/health", get(health))
        .route("/metrics", get(metrics))
        .route("/login", get(current_user).post(log_in).delete(log_out))
}

/// Names and values in a path.
pub(super) type Params = Result<RawPathParams, RawPathParamsRejection>;

/// Returns the coordinate system of a path that names one, else 0.
fn cs_of(raw: &Params, uri: &Uri) -> Result<CoordinateSystemNumber, Problem> {
    let params = params(raw, uri)?;
    let cs = params.iter().find(|(name, _)| *name == "cs");
    Ok(cs.and_then(|(_, cs)| number(cs)).unwrap_or_default())
}

/// Answers a request for one state.
pub(super) async fn one(
    State(shared): State<Arc<ServerState>>,
    uri: Uri,
    params: Params,
    row: &StateRow,
) -> Result<Response, Problem> {
    let message = shared.read(&row.topic(&super::params(&params, &uri)?)).await?;
    Ok(message_response(&message))
}

async fn hmi(State(shared): State<Arc<ServerState>>) -> Response {
    json_response(StatusCode::OK, json!(shared.hmi.added).to_string())
}

async fn machines(State(shared): State<Arc<ServerState>>) -> Response {
    json_text(json!(shared.peer_machines.machines()).to_string())
}

async fn coordinate_systems(State(shared): State<Arc<ServerState>>) -> Result<Response, Problem> {
    let mut coordinate_systems = Vec::new();
    for info in shared.birth().await?.coordinate_systems {
        let state = shared.read(&Topic::cs(info.number, CsTopic::State)).await.ok();
        let state = state.map(|state| message_value(&state));
        coordinate_systems.push(WithState { info, state });
    }
    Ok(json_text(
        json!(CoordinateSystems { coordinate_systems }).to_string(),
    ))
}

async fn inputs(
    State(shared): State<Arc<ServerState>>,
    uri: Uri,
    params: Params,
) -> Result<Response, Problem> {
    let cs = cs_of(&params, &uri)?;
    let number = cs.to_string();
    let mut all = BTreeMap::new();
    for row in STATES.iter() {
        if let Some(name) = row.input()
            && let Ok(message) = shared.read(&row.topic(&[("cs", &number)])).await
        {
            all.insert(name, message_value(&message));
        }
    }
    if all.is_empty() {
        return Err(Problem::not_found(format!("this machine has no cs/{cs}/input")));
    }
    Ok(json_text(json!(Inputs(all)).to_string()))
}

async fn all_io(State(shared): State<Arc<ServerState>>) -> Result<Response, Problem> {
    let mut all = AllIo::default();
    for (point, _) in shared.birth().await?.io.points() {
        let side = match point.side {
            IoSide::In => &mut all.inputs,
            IoSide::Out => &mut all.outputs,
        };
        let name = point.name.clone();
        if let Ok(message) = shared.read(&Topic::Io(point)).await {
            side.insert(name, message_value(&message));
        }
    }
    Ok(json_text(json!(all).to_string()))
}

async fn health(State(shared): State<Arc<ServerState>>) -> Response {
    let link = &shared.metrics.broker;
    let faults = shared.machine.supervisor().faults();
    let status = if faults.iter().any(|fault| fault.consequence.needs_restart()) {
        HealthStatus::Failed
    } else if link.is_lost() || !faults.is_empty() {
        HealthStatus::Degraded
    } else {
        HealthStatus::Ok
    };
    let health = Health {
        status,
        broker: link.in_use(),
        stop_without_login: shared.access.allows_stop_without_login(),
        faults,
    };
    json_text(json!(health).to_string())
}

async fn metrics(State(shared): State<Arc<ServerState>>) -> Response {
    // In simulated time there is no servo thread, and its metrics are left out.
    let servo = shared.machine.servo_timing();
    let text = (shared.metrics).text(States::from_machine(&shared.machine), servo);
    ([(header::CONTENT_TYPE, CONTENT_TYPE)], text).into_response()
}

fn message_value(message: &Message) -> Value {
    serde_json::from_str(&message.to_json()).unwrap_or_default()
}

/// Returns the response with the message as its body, and the revision of the message as `ETag`.
fn message_response(message: &Message) -> Response {
    let mut response = json_text(message.to_json());
    if let Some(tag) = message
        .rev
        .and_then(|rev| HeaderValue::try_from(format!("\"{rev}\"")).ok())
    {
        response.headers_mut().insert(header::ETAG, tag);
    }
    response
}

fn json_text(text: String) -> Response {
    json_response(StatusCode::OK, text)
}
