//! Who has asked for what: a line of the journal for each request of a user that changes something.

use plc_api::server::Origin;
use plc_api::types::request::Request;
use plc_api::wire::mqtt::sender;
use plc_api::wire::rest;

use crate::journal::Event;
use crate::shared::Shared;

/// Characters of what a request says; the rest is left out.
const SAID_MAX: usize = 200;

/// Writes the line. The request is named as its REST route, whichever way it came in.
pub(super) fn record(shared: &Shared, origin: Origin, request: &Request) {
    let (name, said) = match request {
        // a program may have 64 MiB
        Request::WriteProgram(number, text) => (
            format!("PUT /programs/{number}"),
            Some(format!("{} bytes", text.len())),
        ),
        request => match rest::encode(request.clone()) {
            Ok(exchange) => (format!("{} {}", exchange.method, exchange.path), exchange.body),
            Err(_) => (format!("{request:?}"), None),
        },
    };
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

fn cut(text: &str) -> String {
    text.chars().take(SAID_MAX).collect()
}
