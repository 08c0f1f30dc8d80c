//! The agent's requests: `probe`, `current`, `sample` and `assets`.

use std::convert::Infallible;
use std::time::Duration;

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::{FromRequestParts, OriginalUri, Path, Query};
use axum::http::request::Parts;
use axum::http::{StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use futures_util::{StreamExt, stream};
use plc_protocol::types::data::ToolTable;
use plc_protocol::types::request::typed;
use serde::Deserialize;

use crate::Agent;
use crate::buffer::{BUFFER_SIZE, Observation};
use crate::documents::{self, ErrorKind, Sequences};
use crate::filter;

/// Number of observations in a sample if the request contains no count.
const COUNT: usize = 100;

/// Time without an observation after which a stream sends a heartbeat, ms.
const HEARTBEAT_MS: u64 = 10_000;

/// Longest heartbeat and interval, ms. Reason: a connection without traffic is closed shortly after this time.
const TIME_MAX_MS: u64 = 60_000;

/// Boundary between the parts of a stream.
const BOUNDARY: &str = "tandem-mtconnect";

/// A rejection with its text.
struct RequestRejection(ErrorKind, String);

fn out_of_range(parameter: &'static str, text: impl Into<String>) -> RequestRejection {
    RequestRejection(ErrorKind::OutOfRange(parameter), text.into())
}

/// A request with its agent.
#[derive(Debug, Clone)]
struct AgentRequest {
    agent: Agent,
    uri: Uri,
}

impl FromRequestParts<Agent> for AgentRequest {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, agent: &Agent) -> Result<Self, Infallible> {
        let OriginalUri(uri) = OriginalUri::from_request_parts(parts, agent).await?;
        Ok(Self {
            agent: agent.clone(),
            uri,
        })
    }
}

impl AgentRequest {
    fn refuse(&self, RequestRejection(kind, text): RequestRejection) -> Response {
        let status = match kind {
            ErrorKind::InvalidRequest | ErrorKind::InvalidXPath => StatusCode::BAD_REQUEST,
            _ => StatusCode::NOT_FOUND,
        };
        xml(
            status,
            documents::error(&self.agent.head(), &kind, &self.uri.to_string(), &text),
        )
    }
}

/// Returns the routes below the agent's path.
pub fn router(agent: Agent) -> Router {
    Router::new()
        .route("/", get(probe))
        .route("/probe", get(probe))
        .route("/current", get(current))
        .route("/sample", get(sample))
        .route("/assets", get(assets))
        .route("/asset", get(assets))
        .route("/assets/{ids}", get(some_assets))
        .route("/asset/{ids}", get(some_assets))
        .route("/{device}", get(named_probe))
        .route("/{device}/probe", get(named_probe))
        .route("/{device}/current", get(named_current))
        .route("/{device}/sample", get(named_sample))
        .fallback(unknown)
        .with_state(agent)
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct CurrentQuery {
    path: Option<String>,
    at: Option<u64>,
    interval: Option<u64>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct SampleQuery {
    path: Option<String>,
    from: Option<u64>,
    count: Option<usize>,
    interval: Option<u64>,
    heartbeat: Option<u64>,
}

type ParsedQuery<T> = Result<Query<T>, axum::extract::rejection::QueryRejection>;

async fn probe(asker: AgentRequest) -> Response {
    let agent = asker.agent.clone();
    let count = tools(&agent).await.tools.len();
    let feed = agent.inner.feed.lock();
    xml(
        StatusCode::OK,
        documents::devices(&agent.head(), &feed.device, count),
    )
}

async fn named_probe(asker: AgentRequest, Path(device): Path<String>) -> Response {
    if asker.agent.is_device(&device) {
        probe(asker).await
    } else {
        no_device(&asker, &device)
    }
}

async fn named_current(
    asker: AgentRequest,
    Path(device): Path<String>,
    query: ParsedQuery<CurrentQuery>,
) -> Response {
    if asker.agent.is_device(&device) {
        current(asker, query).await
    } else {
        no_device(&asker, &device)
    }
}

async fn named_sample(
    asker: AgentRequest,
    Path(device): Path<String>,
    query: ParsedQuery<SampleQuery>,
) -> Response {
    if asker.agent.is_device(&device) {
        sample(asker, query).await
    } else {
        no_device(&asker, &device)
    }
}

async fn current(asker: AgentRequest, query: ParsedQuery<CurrentQuery>) -> Response {
    let agent = asker.agent.clone();
    let asked = match query {
        Ok(Query(asked)) => asked,
        Err(wrong) => return asker.refuse(invalid(wrong.body_text())),
    };
    let wanted = match wanted(&agent, asked.path.as_deref()) {
        Ok(wanted) => wanted,
        Err(refused) => return asker.refuse(refused),
    };
    match asked.interval {
        None => match current_document(&agent, asked.at, &wanted) {
            Ok(document) => xml(StatusCode::OK, document),
            Err(refused) => asker.refuse(refused),
        },
        Some(_) if asked.at.is_some() => asker.refuse(invalid("at and interval do not go together")),
        Some(interval) if interval > TIME_MAX_MS => asker.refuse(out_of_range(
            "interval",
            format!("interval is at most {TIME_MAX_MS} ms"),
        )),
        Some(interval) => {
            let pause = Duration::from_millis(interval.max(1));
            let parts = stream::unfold((agent, wanted, false), move |(agent, wanted, waits)| async move {
                if waits && !agent.sleep(pause).await {
                    return None;
                }
                let document = current_document(&agent, None, &wanted).ok()?;
                Some((part(&document), (agent, wanted, true)))
            });
            multipart(parts)
        }
    }
}

fn current_document(agent: &Agent, at: Option<u64>, wanted: &[bool]) -> Result<String, RequestRejection> {
    let feed = agent.inner.feed.lock();
    let buffer = &feed.buffer;
    let observations = match at {
        None => buffer.current(),
        Some(at) if (buffer.first()..=buffer.last()).contains(&at) => buffer.current_at(at),
        Some(at) => {
            let text = format!(
                "at is {at}, and observations {} to {} are kept",
                buffer.first(),
                buffer.last()
            );
            return Err(out_of_range("from", text));
        }
    };
    let is_wanted = |one: &Observation| wanted.get(one.item).copied().unwrap_or_default();
    let observations: Vec<_> = observations.into_iter().filter(is_wanted).collect();
    let sequences = Sequences {
        first: buffer.first(),
        last: buffer.last(),
        next: buffer.next(),
    };
    Ok(documents::streams(
        &agent.head(),
        &feed.device,
        sequences,
        &observations,
    ))
}

async fn sample(asker: AgentRequest, query: ParsedQuery<SampleQuery>) -> Response {
    let agent = asker.agent.clone();
    let asked = match query {
        Ok(Query(asked)) => asked,
        Err(wrong) => return asker.refuse(invalid(wrong.body_text())),
    };
    let wanted = match wanted(&agent, asked.path.as_deref()) {
        Ok(wanted) => wanted,
        Err(refused) => return asker.refuse(refused),
    };
    let count = asked.count.unwrap_or(COUNT);
    if !(1..=BUFFER_SIZE).contains(&count) {
        return asker.refuse(out_of_range("count", format!("count is 1 to {BUFFER_SIZE}")));
    }
    let first = sample_document(&agent, asked.from, count, &wanted);
    let (document, next, _) = match first {
        Ok(first) => first,
        Err(refused) => return asker.refuse(refused),
    };
    let Some(interval) = asked.interval else {
        return xml(StatusCode::OK, document);
    };
    let heartbeat = asked.heartbeat.unwrap_or(HEARTBEAT_MS);
    if interval > TIME_MAX_MS || !(1..=TIME_MAX_MS).contains(&heartbeat) {
        let text = format!("interval is at most {TIME_MAX_MS} ms, heartbeat 1 to {TIME_MAX_MS} ms");
        return asker.refuse(out_of_range("heartbeat", text));
    }
    let following = Following {
        agent,
        wanted,
        count,
        interval: Duration::from_millis(interval.max(1)),
        heartbeat: Duration::from_millis(heartbeat),
        next,
        document: Some(document),
    };
    multipart(stream::unfold(following, Following::part))
}

/// A stream of samples.
struct Following {
    agent: Agent,
    wanted: Vec<bool>,
    count: usize,
    interval: Duration,
    heartbeat: Duration,
    next: u64,
    document: Option<String>,
}

impl Following {
    /// Returns the next part: at most one per interval if there are new observations, otherwise one per heartbeat.
    async fn part(mut self) -> Option<(Bytes, Self)> {
        if let Some(document) = self.document.take() {
            return Some((part(&document), self));
        }
        if !self.agent.sleep(self.interval).await {
            return None;
        }
        let mut waited = self.interval;
        loop {
            // a client that is too slow for the ring has to start again
            let (document, next, found) =
                sample_document(&self.agent, Some(self.next), self.count, &self.wanted).ok()?;
            if found > 0 || waited >= self.heartbeat {
                self.next = next;
                return Some((part(&document), self));
            }
            self.next = next;
            let pause = self.interval.min(self.heartbeat.saturating_sub(waited));
            if !self.agent.sleep(pause).await {
                return None;
            }
            waited += pause;
        }
    }
}

/// Returns a document, the next sequence number, and the number of observations.
fn sample_document(
    agent: &Agent,
    from: Option<u64>,
    count: usize,
    wanted: &[bool],
) -> Result<(String, u64, usize), RequestRejection> {
    let feed = agent.inner.feed.lock();
    let buffer = &feed.buffer;
    let from = from.unwrap_or(buffer.first());
    if !(buffer.first()..=buffer.next()).contains(&from) {
        let text = format!(
            "from is {from}, and observations {} to {} are kept",
            buffer.first(),
            buffer.last()
        );
        return Err(out_of_range("from", text));
    }
    let (observations, next) =
        buffer.sample(from, count, &|item| wanted.get(item).copied().unwrap_or_default());
    let sequences = Sequences {
        first: buffer.first(),
        last: buffer.last(),
        next,
    };
    let document = documents::streams(&agent.head(), &feed.device, sequences, &observations);
    Ok((document, next, observations.len()))
}

async fn assets(asker: AgentRequest) -> Response {
    let agent = asker.agent.clone();
    let tools = tools(&agent).await;
    let feed = agent.inner.feed.lock();
    xml(
        StatusCode::OK,
        documents::assets(&agent.head(), &feed.device, &tools, &|_| true),
    )
}

async fn some_assets(asker: AgentRequest, Path(ids): Path<String>) -> Response {
    let agent = asker.agent.clone();
    let tools = tools(&agent).await;
    let ids: Vec<&str> = ids.split(';').collect();
    let missing = ids.iter().find(|id| {
        !tools
            .tools
            .iter()
            .any(|tool| documents::asset_id(tool.id) == **id)
    });
    if let Some(missing) = missing {
        let text = format!("there is no asset {missing:.64}; tools are T and their number");
        return asker.refuse(RequestRejection(
            ErrorKind::AssetNotFound((*missing).to_owned()),
            text,
        ));
    }
    let feed = agent.inner.feed.lock();
    let document = documents::assets(&agent.head(), &feed.device, &tools, &|id| ids.contains(&id));
    xml(StatusCode::OK, document)
}

async fn tools(agent: &Agent) -> ToolTable {
    // a machine that cannot answer has no tools to show
    agent.inner.port.ask(typed::Tools).await.unwrap_or_default()
}

async fn unknown(asker: AgentRequest) -> Response {
    let text = "requests are probe, current, sample and assets";
    asker.refuse(RequestRejection(ErrorKind::Unsupported, text.to_owned()))
}

fn no_device(asker: &AgentRequest, device: &str) -> Response {
    let name = asker.agent.inner.feed.lock().device.name.clone();
    let text = format!("there is no device {device:.64}; this is {name}");
    asker.refuse(RequestRejection(ErrorKind::NoDevice, text))
}

fn invalid(text: impl Into<String>) -> RequestRejection {
    RequestRejection(ErrorKind::InvalidRequest, text.into())
}

fn wanted(agent: &Agent, path: Option<&str>) -> Result<Vec<bool>, RequestRejection> {
    let feed = agent.inner.feed.lock();
    match path {
        None => Ok(vec![true; feed.device.items.len()]),
        Some(path) => filter::wanted(&feed.device, path)
            .map_err(|wrong| RequestRejection(ErrorKind::InvalidXPath, wrong.0)),
    }
}

fn xml(status: StatusCode, document: String) -> Response {
    (status, [(header::CONTENT_TYPE, "application/xml")], document).into_response()
}

fn part(document: &str) -> Bytes {
    let length = document.len();
    let text = format!(
        "--{BOUNDARY}\r\nContent-type: application/xml\r\nContent-length: {length}\r\n\r\n{document}\r\n"
    );
    text.into()
}

fn multipart(parts: impl futures_util::Stream<Item = Bytes> + Send + 'static) -> Response {
    let kind = format!("multipart/x-mixed-replace;boundary={BOUNDARY}");
    (
        [(header::CONTENT_TYPE, kind)],
        Body::from_stream(parts.map(Ok::<_, Infallible>)),
    )
        .into_response()
}
