//! Audit lines: a journal line for each request of a user that changes something.

use plc_protocol::server::{Origin, ServerTransport};
use plc_protocol::types::request::Request;
use plc_protocol::wire::mqtt::sender;
use plc_protocol::wire::rest;
use plc_protocol::wire::right::Right;
use tandem_store::journal::Event;

use crate::shared::SharedState;

/// Maximum number of characters of a request's content in its audit line; the rest is omitted.
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

/// Writes the audit line of a request of a client in this process, unless another line names the client. Writes none in
/// simulated time, which has no users.
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

/// Returns true if a request changes something and no other journal line names its client.
/// Requests that change something have a right other than [`Right::Read`], [`Right::Handle`] and [`Right::Reset`], or
/// no REST route.
/// Returns false for heartbeats, requests with a line `command`, `lease` or `answer`, requests that handlers send for
/// each M code, and [`is_own_level`].
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
        // not encoded for this check, because a program may have 64 MiB
        Request::WriteProgram(..) | Request::StoreProgram(..) => true,
        request => rest::encode(request.clone()).map_or(true, |exchange| {
            !matches!(exchange.right, Right::Read | Right::Handle | Right::Reset)
        }),
    }
}

/// Returns true for values that a handler repeatedly writes to its own inputs and outputs of the plant. They need no
/// audit line, because the published states show them.
pub(super) fn is_own_level(request: &Request) -> bool {
    matches!(request, Request::WriteIo(_, set) if set.handler_id.is_some())
}

/// Returns the method and path of the REST route of a request, and its content. The transport of the request may
/// differ.
fn named(request: &Request) -> (String, Option<String>) {
    match request {
        // only the length, because a program may have 64 MiB
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
