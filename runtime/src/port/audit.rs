//! Audit lines: one line of the journal for each request of a user that changes something.

use plc_api::server::{Origin, ServerTransport};
use plc_api::types::request::Request;
use plc_api::wire::mqtt::sender;
use plc_api::wire::rest;
use plc_api::wire::right::Right;

use crate::journal::Event;
use crate::shared::SharedState;

/// Maximum length of a request's content, in characters; the rest is left out.
const SAID_MAX: usize = 200;

/// Writes the audit line of a request.
pub(super) fn record(shared: &SharedState, origin: Origin, request: &Request) {
    let (name, said) = named(request);
    let event = Event::Request {
        user: origin.user,
        from: origin.from,
        over: origin.over,
        request: cut(&name),
        said: said.as_deref().map(cut),
        command_id: sender(request).map(|(_, meta)| meta.command_id.clone()),
    };
    shared.record(request.coordinate_system().unwrap_or(0), event);
}

/// Writes the audit line for a client in this process, if no other line names it. In simulated time there are no users.
pub(super) fn record_edit(shared: &SharedState, client: Option<&str>, request: &Request) {
    if shared.clock.is_simulated() || !is_edit(request) {
        return;
    }
    let origin = Origin {
        user: client.map(str::to_owned),
        from: None,
        over: ServerTransport::InProcess,
        right: Right::Operate,
        not_after: None,
    };
    record(shared, origin, request);
}

/// Returns true for a request that changes something and gets no other journal line that names the client.
/// Its right is none of [`Right::Read`], [`Right::Handle`] and [`Right::Reset`], or it has no REST route.
/// Excluded are heartbeats, requests with a line `command`, `lease` or `answer`, requests made for each M
/// code, and [`is_own_level`].
fn is_edit(request: &Request) -> bool {
    match request {
        request if is_own_level(request) => false,
        Request::Command { .. }
        | Request::Lease { .. }
        | Request::AnswerQuestion(..)
        | Request::Heartbeat(..)
        | Request::Claim(..)
        | Request::Reset(..)
        | Request::Handler(..)
        | Request::ValidateResult(..) => false,
        // a program may have 64 MiB
        Request::WriteProgram(..) | Request::StoreProgram(..) => true,
        request => rest::encode(request.clone()).map_or(true, |exchange| {
            !matches!(exchange.right, Right::Read | Right::Handle | Right::Reset)
        }),
    }
}

/// Returns true for levels that a handler repeatedly writes to its own inputs and outputs of the plant. They
/// need no audit line, because the published states show them.
pub(super) fn is_own_level(request: &Request) -> bool {
    matches!(request, Request::WriteIo(_, set) if set.handler_id.is_some())
}

/// Returns the request as its REST route, whatever its transport, and its content.
fn named(request: &Request) -> (String, Option<String>) {
    match request {
        // a program may have 64 MiB
        Request::WriteProgram(number, text) => (
            format!("PUT /programs/{number}"),
            Some(format!("{} bytes", text.len())),
        ),
        Request::StoreProgram(number, upload) => (
            format!("PUT /programs/{number}"),
            Some(format!(
                "{} bytes, with a condition, a signature or a dialect",
                upload.text.len()
            )),
        ),
        request => match rest::encode(request.clone()) {
            Ok(exchange) => (format!("{} {}", exchange.method, exchange.path), exchange.body),
            Err(_) => (format!("{request:?}"), None),
        },
    }
}

fn cut(text: &str) -> String {
    text.chars().take(SAID_MAX).collect()
}
