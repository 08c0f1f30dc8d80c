//! Requests: each row of the wire is read, executed and answered in the same way. Commands answer 202 when accepted;
//! with `?wait=1` 200 when done, or 202 when that takes longer than a minute.

use std::borrow::Cow;
use std::future::poll_fn;
use std::net::IpAddr;
use std::pin::pin;
use std::sync::Arc;
use std::task::Poll;
use std::time::Duration;

use axum::body::Body;
use axum::extract::{FromRequestParts, RawPathParams, Request as HttpRequest};
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use plc_protocol::server::ServerTransport;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::message::Payload;
use plc_protocol::types::planned::PlannedPath;
use plc_protocol::types::program::{PROGRAM_BYTES_MAX, ProgramText};
use plc_protocol::types::request::{Answer, Request};
use plc_protocol::types::topic::Topic;
use plc_protocol::wire::answer::{AnswerForm, Reply};
use plc_protocol::wire::percent_encoded;
use plc_protocol::wire::route::{self, Content, Route};
use plc_protocol::wire::row::{IF_NONE_MATCH, IncomingRequest, Row, Sender, Source, number};
use plc_protocol::wire::tag;
use tokio::task::JoinHandle;
use tokio::time::timeout;

use super::{body, json_response, nothing_at, params, problem_of, query};
use crate::access::{Account, User};
use crate::account_slots::NamedSlot;
use crate::contract::routes::API;
use crate::machine::{AuthorizedRequest, Caller};
use crate::problem::Problem;
use crate::server::Peer;
use crate::server_state::{ServerState, unexpected};
use crate::urgent_slots::UrgentKind;

/// Client id of a REST command that names no client.
const CLIENT_ID: &str = "rest";

/// Longest time that `?wait=1` waits; then 202. Reason: shorter than what proxies and clients allow.
const WAIT_MAX: Duration = Duration::from_mins(1);

/// Serves a row on one of its routes.
pub(super) async fn serve(
    shared: Arc<ServerState>,
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
        Some(shared.large_requests.acquire(&user).await?)
    } else {
        None
    };
    let bytes = read_body(route, &head.headers, body).await?;
    let cs = match params.iter().find(|(name, _)| *name == "id") {
        Some((_, id)) if route.headers == route::Headers::Command => {
            Some(of_alarm(&shared, id, &head.uri).await?.to_string())
        }
        _ => None,
    };
    params.extend(cs.as_deref().map(|cs| ("cs", cs)));
    let sender = HttpSender::new(&shared, (&user, &head.headers), route);
    let incoming = IncomingRequest {
        params: &params,
        body: Cow::Owned(bytes),
        query,
        source: Source::Http(&sender),
        not_after_is_apart: false,
    };
    let mut parsed = row
        .parse(incoming)
        .map_err(|fault| problem_of(fault, &head.uri))?;
    // the sender of a request without an instance is never the instance that is online over another transport
    parsed.identify(CLIENT_ID);
    let caller = Caller {
        user: &user,
        from: head.extensions.get::<Peer>().map(|peer| peer.address),
        over: ServerTransport::Rest,
    };
    let authorized = (shared.machine.authorize_request(caller, parsed).await).map_err(Problem::from)?;
    let form = (row.answer)(authorized.request());
    let urgent = UrgentKind::of_request(authorized.request());
    let reply = match (authorized.request(), urgent) {
        (Request::Command { .. }, Some(kind)) => {
            let account = Account::new(&user, caller.from);
            execute_urgent_request(&shared, authorized, (account, kind), &form).await?
        }
        (Request::Command { .. }, None) => {
            execute_request(&shared, &user, caller.from, authorized, &form).await?
        }
        (Request::Handler(..), _) => form.encode(register(&shared, authorized).await?)?,
        _ => form.encode(shared.ask(authorized).await?)?,
    };
    let mut response = sender.response(reply);
    if let Some(permit) = permit {
        response.extensions_mut().insert(Arc::new(permit));
    }
    Ok(response)
}

async fn read_body(route: &Route, headers: &HeaderMap, body: Body) -> Result<Vec<u8>, Problem> {
    Ok(match route.body {
        Content::Text => body::read(body, PROGRAM_BYTES_MAX).await?,
        Content::Json(_) => body::json(headers, body).await?,
        Content::Nothing | Content::Document | Content::Bytes => Vec::new(),
    })
}

/// Registers a handler, or removes it.
async fn register(shared: &ServerState, authorized: AuthorizedRequest) -> Result<Answer, Problem> {
    let Request::Handler(id, presence) = authorized.request().clone() else {
        return Err(unexpected());
    };
    presence.check_registration().map_err(Problem::invalid)?;
    let change = if presence.online {
        Some(shared.registrations.add_registration(&id, &presence)?)
    } else {
        None
    };
    let answer = shared.ask(authorized).await;
    let instance = presence.instance.as_ref();
    match (&answer, &change) {
        (Err(_), Some(change)) => shared.registrations.undo(&id, instance, change),
        (Ok(_), None) => shared.registrations.remove_registration(&id, instance),
        (Ok(_), Some(_)) | (Err(_), None) => {}
    }
    answer
}

/// Returns the entity tag (`ETag`) of a program text or planned path; `None` for other replies. The client
/// sends the tag back to ask whether its copy is still current.
fn tag_of(reply: &Reply) -> Option<&str> {
    match reply {
        Reply::Program(ProgramText { hash: tag, .. }) | Reply::Bytes(PlannedPath { tag, .. }) => Some(tag),
        _ => None,
    }
}

fn not_modified(reply: &Reply) -> Response {
    tagged(
        StatusCode::NOT_MODIFIED.into_response(),
        tag_of(reply).unwrap_or_default(),
    )
}

fn tagged(mut response: Response, hash: &str) -> Response {
    if let Ok(etag) = HeaderValue::try_from(tag::etag(hash)) {
        response.headers_mut().insert(header::ETAG, etag);
    }
    response
}

struct HttpSender<'a> {
    shared: &'a ServerState,
    user: &'a User,
    headers: &'a HeaderMap,
    route: &'a Route,
}

impl<'a> HttpSender<'a> {
    fn new(shared: &'a ServerState, (user, headers): (&'a User, &'a HeaderMap), route: &'a Route) -> Self {
        Self {
            shared,
            user,
            headers,
            route,
        }
    }

    /// Returns the reply, or that the client already has it.
    fn response(&self, reply: Reply) -> Response {
        if self.had(&reply) {
            not_modified(&reply)
        } else {
            response(reply)
        }
    }

    /// Returns the values of a header that the route lists; none of another one, so that no route reads an undocumented
    /// header.
    fn listed(&self, name: &str) -> impl Iterator<Item = &HeaderValue> {
        let is_listed = self.route.headers.reads(name);
        is_listed
            .then(|| self.headers.get_all(name).iter())
            .into_iter()
            .flatten()
    }

    /// Returns true if the client already has this reply.
    fn had(&self, reply: &Reply) -> bool {
        let mut tags = self.listed(IF_NONE_MATCH).filter_map(|tags| tags.to_str().ok());
        tag_of(reply).is_some_and(|tag| tags.any(|tags| tag::is_had(tags, tag)))
    }
}

impl Sender for HttpSender<'_> {
    fn header(&self, name: &str) -> Option<&str> {
        let value = self.listed(name).next()?;
        Some(value.to_str().unwrap_or_default())
    }

    fn client_id(&self) -> String {
        self.user.name().unwrap_or(CLIENT_ID).to_owned()
    }

    fn new_command_id(&self) -> String {
        self.shared.next_command_id()
    }
}

/// Returns the coordinate system that an alarm stopped; the first one for an alarm of all.
async fn of_alarm(shared: &ServerState, id: &str, uri: &Uri) -> Result<CoordinateSystemNumber, Problem> {
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

async fn execute_request(
    shared: &Arc<ServerState>,
    user: &User,
    from: Option<IpAddr>,
    authorized: AuthorizedRequest,
    form: &AnswerForm,
) -> Result<Reply, Problem> {
    let (command_id, wait) = match authorized.request() {
        Request::Command { meta, wait, .. } => (meta.command_id.clone(), *wait),
        _ => (String::new(), false),
    };
    let account = Account::new(user, from);
    let place = match shared
        .open_commands
        .acquire_named(user, account, command_id.clone())
    {
        NamedSlot::New(place) => place,
        NamedSlot::Held => return answer_again(shared, authorized, form, wait.then_some(command_id)).await,
        NamedSlot::Full => {
            return Err(Problem::new(
                StatusCode::SERVICE_UNAVAILABLE,
                "unavailable",
                "too many commands are unanswered; send the command again",
            ));
        }
    };
    // in a separate task, so that a client that disconnects does not cancel it
    let asking = {
        let shared = Arc::clone(shared);
        async move {
            let answer = shared.ask(authorized).await;
            drop(place);
            answer
        }
    };
    let asking = spawn_request(shared, asking);
    answered(asking, form, wait.then_some(command_id)).await
}

/// Answers the repetition of a command that is not answered yet. It executes nothing and ends with its connection, so it
/// needs no slot of its own.
async fn answer_again(
    shared: &ServerState,
    authorized: AuthorizedRequest,
    form: &AnswerForm,
    waiting: Option<String>,
) -> Result<Reply, Problem> {
    match (timeout(WAIT_MAX, shared.ask(authorized)).await, waiting) {
        (Ok(answer), _) => Ok(form.encode(answer?)?),
        (Err(_), Some(command_id)) => Ok(Reply::Accepted(command_id, None)),
        (Err(_), None) => Err(unexpected()),
    }
}

/// Executes a hold, stop or abort, or ends a jog. It waits only for an earlier one of the same account, kind and coordinate system.
async fn execute_urgent_request(
    shared: &Arc<ServerState>,
    mut authorized: AuthorizedRequest,
    (account, kind): (Account, (CoordinateSystemNumber, UrgentKind)),
    form: &AnswerForm,
) -> Result<Reply, Problem> {
    let waits = shared.urgent_wait(&account);
    if waits.is_none() {
        authorized.do_not_wait();
    }
    let command_id = match authorized.request() {
        Request::Command { meta, wait: true, .. } => Some(meta.command_id.clone()),
        _ => None,
    };
    let slot = shared.urgent.enter(account, kind).await;
    let is_waiting = command_id.is_some();
    let asking = {
        let shared = Arc::clone(shared);
        async move {
            let mut asking = pin!(shared.ask(authorized));
            let first = poll_fn(|context| Poll::Ready(asking.as_mut().poll(context))).await;
            // the coordinate system has accepted it: from here on the request only waits until it is done
            let slot = (!is_waiting).then_some(slot);
            let answer = match first {
                Poll::Ready(answer) => answer,
                Poll::Pending => asking.await,
            };
            drop((slot, waits));
            answer
        }
    };
    let asking = spawn_request(shared, asking);
    answered(asking, form, command_id).await
}

/// Starts a request in a separate task; a panic ends that request alone.
fn spawn_request(
    shared: &ServerState,
    asking: impl Future<Output = Result<Answer, Problem>> + Send + 'static,
) -> JoinHandle<Option<Result<Answer, Problem>>> {
    let supervisor = shared.machine.supervisor();
    shared
        .tasks
        .spawn(supervisor.catch_panic("request over REST", asking))
}

/// Returns the response to a command. `waiting` is the id of a command that must be done; after [`WAIT_MAX`] the
/// response is that it is accepted.
async fn answered(
    asking: JoinHandle<Option<Result<Answer, Problem>>>,
    form: &AnswerForm,
    waiting: Option<String>,
) -> Result<Reply, Problem> {
    let answer: Answer = match waiting {
        Some(command_id) => match timeout(WAIT_MAX, asking).await {
            Ok(answer) => answer,
            Err(_) => return Ok(Reply::Accepted(command_id, None)),
        },
        None => asking.await,
    }
    .ok()
    .flatten()
    .ok_or_else(unexpected)??;
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

/// Adds the location of the rest, a route below the API.
fn at(mut response: Response, route: &str) -> Response {
    if let Ok(location) = HeaderValue::try_from(format!("{API}{route}")) {
        response.headers_mut().insert(header::LOCATION, location);
    }
    response
}
