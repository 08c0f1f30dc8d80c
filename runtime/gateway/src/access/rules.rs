//! Rights of users, checked on the request that is executed. Pure: no I/O.

use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::request::{Input, Request};
use plc_protocol::wire::right::Right;
use plc_protocol::wire::row::ParsedRequest;

use super::{Role, User};
use crate::urgent_slots::UrgentKind;

/// Returns an error text if a user may not make a request. `serves` returns whether the user is an online handler that
/// serves an M code of this coordinate system, or of any for `None`.
pub(crate) fn check(
    user: &User,
    parsed: &ParsedRequest,
    serves: impl Fn(Option<CoordinateSystemNumber>) -> bool,
) -> Result<(), String> {
    if *user == User::Unidentified {
        return match UrgentKind::of_request(parsed.request()) {
            Some((_, UrgentKind::Verb(_))) => Ok(()),
            _ => Err("without a login only hold, stop and abort are allowed; log in first".to_owned()),
        };
    }
    let role = user.role();
    if !role.has(parsed.right()) {
        let needed: Vec<_> = Role::ALL
            .iter()
            .filter(|(_, role)| role.has(parsed.right()))
            .collect();
        let needed: Vec<_> = needed.into_iter().map(|(word, _)| *word).collect();
        return Err(format!(
            "role {} may not do this; it needs {}",
            role.name(),
            needed.join(" or ")
        ));
    }
    match user {
        User::Token(token) if token.role == Role::Handler => check_handler(&token.name, parsed, serves),
        _ => Ok(()),
    }
}

/// Checks whether a user may send in the name of a handler: the user needs the right, and a handler may use
/// only its own name.
pub(crate) fn may_speak_as(user: &User, right: Right, handler_id: &str) -> bool {
    user.has(right) && (user.role() != Role::Handler || user.name() == Some(handler_id))
}

/// Checks that a handler acts in its own name, not by force, and sets values only where it serves an M code.
fn check_handler(
    name: &str,
    parsed: &ParsedRequest,
    serves: impl Fn(Option<CoordinateSystemNumber>) -> bool,
) -> Result<(), String> {
    let request = parsed.request();
    if let Some(said) = spoken_for(request).filter(|said| *said != name) {
        return Err(format!(
            "the token of {name} has role handler, so its handler_id must be {name}, not {said:?}"
        ));
    }
    if matches!(request, Request::Reset(_, _, reset) if reset.force.unwrap_or(false)) {
        return Err("a reset by force needs role operate or admin".to_owned());
    }
    if parsed.right() == Right::SetInput {
        return check_input(name, request);
    }
    if parsed.right() != Right::Set {
        return Ok(());
    }
    let cs = request.coordinate_system();
    if serves(cs) {
        return Ok(());
    }
    let place = cs.map_or_else(
        || "this machine".to_owned(),
        |cs| format!("coordinate system {cs}"),
    );
    Err(format!(
        "the token of {name} has role handler, which may set tool, spindle and variables only if its \
         handler serves an \
         M code; handler {name} serves none of {place} now"
    ))
}

/// Checks that a handler sets only its own sources of interlock and start lock, and inputs and outputs of the plant
/// in its own name.
fn check_input(name: &str, request: &Request) -> Result<(), String> {
    match request {
        Request::Input(_, Input::Interlock(set) | Input::StartLock(set))
            if set.handler_id.as_deref() == Some(name) && set.force != Some(true) =>
        {
            Ok(())
        }
        Request::WriteIo(_, set) if set.handler_id.as_deref() == Some(name) => Ok(()),
        Request::WriteIo(point, _) => Err(format!(
            "the token of {name} has role handler, which may write {point} only with handler_id {name}"
        )),
        _ => Err(format!(
            "the token of {name} has role handler, which may set only sources of interlock and start lock \
             as inputs, with \
             handler_id {name} and without force"
        )),
    }
}

/// Returns the handler in whose name a request is made.
fn spoken_for(request: &Request) -> Option<&str> {
    match request {
        Request::Claim(_, _, claim) => Some(&claim.handler_id),
        Request::Reset(_, _, reset) => Some(&reset.handler_id),
        Request::Progress(_, _, report) => Some(&report.handler_id),
        Request::Checkpoint(_, _, report) => Some(&report.handler_id),
        Request::Ask(_, _, ask) => Some(&ask.handler_id),
        Request::ValidateResult(_, _, result) => Some(&result.handler_id),
        Request::Input(_, Input::Interlock(set) | Input::StartLock(set)) => set.handler_id.as_deref(),
        Request::WriteIo(_, set) => set.handler_id.as_deref(),
        Request::Handler(id, _) | Request::Heartbeat(id, _) => Some(id),
        _ => None,
    }
}
