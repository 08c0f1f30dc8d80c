//! Requests: each row of the wire is read, asked and answered in the same way. Commands answer 202 when accepted; with
//! `?wait=1` 200 when done, or 202 when that takes longer than a minute.

use std::borrow::Cow;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::{FromRequestParts, RawPathParams, Request as HttpRequest};
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use plc_api::server::ServerTransport;
use plc_api::types::CoordinateSystemNumber;
use plc_api::types::message::Payload;
use plc_api::types::planned::PlannedPath;
use plc_api::types::program::{PROGRAM_BYTES_MAX, ProgramText};
use plc_api::types::request::{Answer, Request};
use plc_api::types::topic::Topic;
use plc_api::wire::answer::{AnswerForm, Reply};
use plc_api::wire::percent_encoded;
use plc_api::wire::route::{self, Content, Route};
use plc_api::wire::row::{Fault, IF_NONE_MATCH, IncomingRequest, Row, Sender, Source, number};
use plc_api::wire::tag;
use tokio::sync::SemaphorePermit;
use tokio::time::timeout;

use super::{body, json_response, nothing_at, params, query};
use crate::access::User;
use crate::contract::routes::API;
use crate::machine::{Authorized, Caller};
use crate::problem::Problem;
use crate::server::Peer;
use crate::shared::{LARGE_REQUESTS_MAX, Shared, unexpected};

/// Who commands when a command comes over REST from nobody in particular.
const CLIENT_ID: &str = "rest";

/// Longest time that `?wait=1` waits; then 202. Reason: shorter than what proxies and clients allow.
const WAIT_MAX: Duration = Duration::from_mins(1);

/// Longest time that a request with a whole program waits for others of that kind; then 503.
const LARGE_WAIT_MAX: Duration = Duration::from_secs(30);

/// Serves a row on one of its routes.
pub(super) async fn serve(
    shared: Arc<Shared>,
    user: User,
    row: &Row,
    route: &Route,
    request: HttpRequest,
) -> Result<Response, Problem> {
    let (mut head, body) = request.into_parts();
    let raw = RawPathParams::from_request_parts(&mut head, &()).await;
    let mut params = params(&raw, &head.uri)?;
    for fixed in route.fixed() {
        params.push(fixed);
    }
    let query = query::read(route, &head.uri)?;
    if matches!(route.body, Content::Text) {
        body::check_text(&head.headers)?;
    }
    let permit = if row.is_large {
        Some(large_place(&shared).await?)
    } else {
        None
    };
    let bytes = match route.body {
        Content::Text => body::read(body, PROGRAM_BYTES_MAX).await?,
        Content::Json(_) => body::json(&head.headers, body).await?,
        Content::Nothing | Content::Document | Content::Bytes => Vec::new(),
    };
    let cs = match params.iter().find(|(name, _)| *name == "id") {
        Some((_, id)) if route.headers == route::Headers::Command => {
            Some(of_alarm(&shared, id, &head.uri).await?)
        }
        _ => None,
    };
    let cs = cs.map(|cs| cs.to_string());
    params.extend(cs.as_deref().map(|cs| ("cs", cs)));
    let sender = HttpSender {
        shared: &shared,
        user: &user,
        headers: &head.headers,
    };
    let incoming = IncomingRequest {
        params: &params,
        body: Cow::Owned(bytes),
        query,
        source: Source::Http(&sender),
    };
    let parsed = row.parse(incoming).map_err(|fault| match fault {
        Fault::Level(_) => nothing_at(&head.uri),
        Fault::NotFound(text) => Problem::not_found(text),
        Fault::Json(error) => Problem::invalid(format!("the JSON body is not right: {error}")),
        Fault::Invalid(text) => Problem::invalid(text),
    })?;
    let caller = Caller {
        user: &user,
        from: head.extensions.get::<Peer>().map(|peer| peer.address),
        over: ServerTransport::Rest,
    };
    let judged = shared.machine.judge(caller, parsed).await;
    let authorized = judged.map_err(Problem::from)?;
    let form = (row.answer)(authorized.request());
    let reply = match authorized.request() {
        Request::Command { .. } => carry_out(&shared, authorized, &form).await?,
        _ => form.encode(shared.ask(authorized).await?)?,
    };
    drop(permit);
    Ok(unless_had(&head.headers, reply))
}

/// The answer, or that the client has it already.
fn unless_had(headers: &HeaderMap, reply: Reply) -> Response {
    match reply {
        Reply::Program(ProgramText { hash: tag, .. }) | Reply::Bytes(PlannedPath { tag, .. })
            if has(headers, &tag) =>
        {
            not_modified(&tag)
        }
        reply => response(reply),
    }
}

/// True when the client has the program already.
fn has(headers: &HeaderMap, hash: &str) -> bool {
    let tags = headers.get_all(IF_NONE_MATCH).iter();
    let mut tags = tags.filter_map(|tags| tags.to_str().ok());
    tags.any(|tags| tag::is_had(tags, hash))
}

fn not_modified(hash: &str) -> Response {
    tagged(StatusCode::NOT_MODIFIED.into_response(), hash)
}

fn tagged(mut response: Response, hash: &str) -> Response {
    if let Ok(etag) = HeaderValue::try_from(tag::etag(hash)) {
        response.headers_mut().insert(header::ETAG, etag);
    }
    response
}

/// A place for a request that carries a whole program.
async fn large_place(shared: &Shared) -> Result<SemaphorePermit<'_>, Problem> {
    let place = timeout(LARGE_WAIT_MAX, shared.large_requests.acquire()).await;
    place.ok().and_then(Result::ok).ok_or_else(|| {
        let text =
            format!("{LARGE_REQUESTS_MAX} programs are on their way, which is the limit; send it again");
        Problem::new(StatusCode::SERVICE_UNAVAILABLE, "unavailable", text)
    })
}

struct HttpSender<'a> {
    shared: &'a Shared,
    user: &'a User,
    headers: &'a HeaderMap,
}

impl Sender for HttpSender<'_> {
    fn header(&self, name: &str) -> Option<&str> {
        let value = self.headers.get(name)?;
        Some(value.to_str().unwrap_or_default())
    }

    fn client_id(&self) -> String {
        self.user.name().unwrap_or(CLIENT_ID).to_owned()
    }

    fn new_command_id(&self) -> String {
        self.shared.next_command_id()
    }
}

/// The coordinate system that an alarm stopped; the first one for an alarm of all.
async fn of_alarm(shared: &Shared, id: &str, uri: &Uri) -> Result<CoordinateSystemNumber, Problem> {
    let id: u64 = number(id).ok_or_else(|| nothing_at(uri))?;
    let active = shared.read(&Topic::AlarmActive).await?;
    let Payload::AlarmActive(active) = &active.payload else {
        return Err(unexpected());
    };
    let alarm = active.alarms.iter().find(|alarm| alarm.id == id);
    let alarm = alarm.ok_or_else(|| Problem::not_found(format!("no alarm with id {id} is active")))?;
    if let Some(cs) = alarm.cs {
        return Ok(cs);
    }
    let birth = shared.birth().await?;
    let first = birth.coordinate_systems.first().ok_or_else(unexpected)?;
    Ok(first.number)
}

async fn carry_out(
    shared: &Arc<Shared>,
    authorized: Authorized,
    form: &AnswerForm,
) -> Result<Reply, Problem> {
    let places = match authorized.request() {
        Request::Command { command, .. } if command.is_urgent() => &shared.urgent_commands,
        _ => &shared.open_commands,
    };
    let Ok(place) = Arc::clone(places).try_acquire_owned() else {
        return Err(Problem::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "unavailable",
            "too many commands are unanswered; send it again",
        ));
    };
    let (command_id, wait) = match authorized.request() {
        Request::Command { meta, wait, .. } => (meta.command_id.clone(), *wait),
        _ => (String::new(), false),
    };
    // a task of its own: a client that goes away takes back nothing
    let asking = shared.tasks.spawn({
        let shared = Arc::clone(shared);
        async move {
            let answer = shared.ask(authorized).await;
            drop(place);
            answer
        }
    });
    let answer: Answer = if wait {
        match timeout(WAIT_MAX, asking).await {
            Ok(answer) => answer,
            Err(_) => return Ok(Reply::Accepted(command_id, None)),
        }
    } else {
        asking.await
    }
    .map_err(|_| unexpected())??;
    Ok(form.encode(answer)?)
}

fn response(reply: Reply) -> Response {
    let json = |status, text| json_response(StatusCode::from_u16(status).unwrap_or_default(), text);
    let plain = |text: String| {
        let kind = HeaderValue::from_static("text/plain; charset=utf-8");
        ([(header::CONTENT_TYPE, kind)], text).into_response()
    };
    match reply {
        Reply::Nothing => StatusCode::NO_CONTENT.into_response(),
        Reply::Json(status, text) => json(status, text),
        Reply::Stored(status, text, hash) => tagged(json(status, text), &hash),
        Reply::Text(text) => plain(text),
        Reply::Program(program) => tagged(plain(program.text), &program.hash),
        Reply::Bytes(path) => {
            let kind = HeaderValue::from_static("application/octet-stream");
            tagged(
                ([(header::CONTENT_TYPE, kind)], path.bytes).into_response(),
                &path.tag,
            )
        }
        Reply::Created(text, route) => at(json(201, text), &route),
        Reply::Accepted(id, hash) => {
            let response = json_response(StatusCode::ACCEPTED, Reply::accepted_body(&id, hash.as_deref()));
            at(response, &format!("/commands/{}", percent_encoded(&id)))
        }
    }
}

/// With the route below the API where the rest is.
fn at(mut response: Response, route: &str) -> Response {
    if let Ok(location) = HeaderValue::try_from(format!("{API}{route}")) {
        response.headers_mut().insert(header::LOCATION, location);
    }
    response
}
