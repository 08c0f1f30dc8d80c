//! What can be read: the same messages as on MQTT, with the revision as `ETag`.

use std::sync::Arc;

use axum::Router;
use axum::extract::State;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use plc_api::types::CoordinateSystemNumber;
use plc_api::types::machine::AlarmRaise;
use plc_api::types::message::Message;
use plc_api::types::request::typed::{AlarmHistory, Handlers, RaiseAlarm, ServoTiming};
use plc_api::types::topic::{CsTopic, Topic};
use serde_json::{Value, json};

use super::extract::{InPath, JsonBody};
use crate::problem::Problem;
use crate::shared::Shared;

/// What `GET /cs/{n}/...` answers with one message.
const CS_TOPICS: [(&str, CsTopic); 10] = [
    ("state", CsTopic::State),
    ("position", CsTopic::Position),
    ("program", CsTopic::Program),
    ("modal", CsTopic::Modal),
    ("captured", CsTopic::Captured),
    ("m_codes", CsTopic::Pending),
    ("overrides", CsTopic::Override),
    ("spindle", CsTopic::Spindle),
    ("tool", CsTopic::Tool),
    ("lease", CsTopic::Lease),
];

/// The inputs, each with its message, in `GET /cs/{n}/inputs`; each also alone.
const INPUTS: [(&str, CsTopic); 6] = [
    ("optional_skip", CsTopic::OptionalSkip),
    ("optional_stop", CsTopic::OptionalStop),
    ("single_block", CsTopic::SingleBlock),
    ("dry_run", CsTopic::DryRun),
    ("interlock", CsTopic::Interlock),
    ("start_lock", CsTopic::StartLock),
];

pub(super) fn routes() -> Router<Arc<Shared>> {
    let mut router = Router::new()
        .route("/machine", get(machine))
        .route("/cs", get(coordinate_systems))
        .route("/cs/{cs}/inputs", get(inputs))
        .route("/alarms", get(alarms).post(raise_alarm))
        .route("/alarms/history", get(alarm_history))
        .route("/handlers", get(handlers))
        .route("/health", get(health))
        .route("/metrics", get(metrics));
    let inputs = INPUTS.map(|(name, topic)| (format!("/cs/{{cs}}/inputs/{name}"), topic));
    let others = CS_TOPICS.map(|(name, topic)| (format!("/cs/{{cs}}/{name}"), topic));
    for (path, topic) in others.into_iter().chain(inputs) {
        let read =
            move |shared: State<Arc<Shared>>, cs: InPath<CoordinateSystemNumber>| one(shared, cs, topic);
        router = router.route(&path, get(read));
    }
    router
}

async fn one(
    State(shared): State<Arc<Shared>>,
    InPath(cs): InPath<CoordinateSystemNumber>,
    topic: CsTopic,
) -> Result<Response, Problem> {
    let message = shared.read(&Topic::cs(cs, topic)).await?;
    Ok(message_response(&message))
}

async fn machine(State(shared): State<Arc<Shared>>) -> Result<Response, Problem> {
    Ok(message_response(&*shared.read(&Topic::Birth).await?))
}

async fn raise_alarm(
    State(shared): State<Arc<Shared>>,
    JsonBody(raise): JsonBody<AlarmRaise>,
) -> Result<StatusCode, Problem> {
    shared.ask(RaiseAlarm(raise)).await?;
    Ok(StatusCode::NO_CONTENT)
}

async fn alarms(State(shared): State<Arc<Shared>>) -> Result<Response, Problem> {
    Ok(message_response(&*shared.read(&Topic::AlarmActive).await?))
}

/// `{"coordinate_systems": [{"number", "axes", ..., "state": {...}}]}`.
async fn coordinate_systems(State(shared): State<Arc<Shared>>) -> Result<Response, Problem> {
    let mut list = Vec::new();
    for info in shared.birth().await?.coordinate_systems {
        let state = shared.read(&Topic::cs(info.number, CsTopic::State)).await.ok();
        let mut entry = serde_json::to_value(&info).unwrap_or_default();
        if let Value::Object(entry) = &mut entry {
            entry.insert(
                "state".into(),
                state.map_or(Value::Null, |state| message_value(&state)),
            );
        }
        list.push(entry);
    }
    Ok(json_response(&json!({ "coordinate_systems": list })))
}

/// `{"optional_skip": {...}, "optional_stop": {...}, ...}`: the message of each input.
async fn inputs(
    State(shared): State<Arc<Shared>>,
    InPath(cs): InPath<CoordinateSystemNumber>,
) -> Result<Response, Problem> {
    let mut all = serde_json::Map::new();
    for (name, topic) in INPUTS {
        if let Ok(message) = shared.read(&Topic::cs(cs, topic)).await {
            all.insert(name.to_owned(), message_value(&message));
        }
    }
    if all.is_empty() {
        return Err(Problem::not_found(format!("this machine has no cs/{cs}/input")));
    }
    Ok(json_response(&Value::Object(all)))
}

async fn alarm_history(State(shared): State<Arc<Shared>>) -> Result<Response, Problem> {
    let alarms = shared.ask(AlarmHistory).await?;
    Ok(json_response(&json!({ "alarms": alarms })))
}

async fn handlers(State(shared): State<Arc<Shared>>) -> Result<Response, Problem> {
    let handlers = shared.ask(Handlers).await?;
    Ok(json_response(&json!({ "handlers": handlers })))
}

async fn health() -> Response {
    json_response(&json!({ "status": "ok" }))
}

async fn metrics(State(shared): State<Arc<Shared>>) -> Response {
    let kind = HeaderValue::from_static("text/plain; version=0.0.4; charset=utf-8");
    // In simulated time there is no servo thread, and its metrics are left out.
    let servo = shared.ask(ServoTiming).await.ok();
    let text = shared.metrics.text(servo.as_ref());
    ([(header::CONTENT_TYPE, kind)], text).into_response()
}

fn message_value(message: &Message) -> Value {
    serde_json::from_str(&message.to_json()).unwrap_or_default()
}

/// The message as its body, its revision as `ETag`.
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

/// A JSON answer with status 200.
pub(super) fn json_response(value: &Value) -> Response {
    json_text(value.to_string())
}

fn json_text(text: String) -> Response {
    let kind = HeaderValue::from_static("application/json");
    ([(header::CONTENT_TYPE, kind)], text).into_response()
}
