//! Who has asked for what: a line of the journal for each request of a user that changes something.

use plc_api::server::{Origin, ServerTransport};
use plc_api::types::request::Request;
use plc_api::wire::mqtt::sender;
use plc_api::wire::rest;
use plc_api::wire::right::Right;

use crate::journal::Event;
use crate::shared::Shared;

/// Characters of what a request says; the rest is left out.
const SAID_MAX: usize = 200;

/// Writes the line.
pub(super) fn record(shared: &Shared, origin: Origin, request: &Request) {
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

/// The same for a client in this process, where no other line names it. In simulated time there are no users.
pub(super) fn record_edit(shared: &Shared, client: Option<&str>, request: &Request) {
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

/// True for what changes something and has no line of its own that says who asked: what needs more than to see and to answer
/// for an output, but for what a line `command`, `lease` or `answer` names the client of, and signs of life. What has no route
/// counts as an edit unless it is named here. What is asked for each M code is named, too: an M code waits for this.
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

/// True for what a handler says of its own inputs and outputs of the plant, again and again: their states tell of it.
pub(super) fn is_own_level(request: &Request) -> bool {
    matches!(request, Request::WriteIo(_, set) if set.handler_id.is_some())
}

/// The request as its REST route, whichever way it came in, and what it says.
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
