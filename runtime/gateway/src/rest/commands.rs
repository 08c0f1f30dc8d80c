//! Commands. They answer 202 when accepted; with `?wait=1` 200 when done, or 202 when that takes longer than a minute.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::Response;
use axum::routing::{get, post};
use axum::{Extension, Router};
use plc_api::types::CoordinateSystemNumber;
use plc_api::types::command::{Command, CommandMeta, CommandReply, CommandStatus, Expect};
use plc_api::types::message::Payload;
use plc_api::types::request::typed;
use plc_api::types::topic::Topic;
use serde::Deserialize;
use serde_json::{Value, json};

use super::extract::{InPath, InQuery, JsonBody};
use super::states::json_response;
use crate::access::User;
use crate::contract::routes::API;
use crate::problem::Problem;
use crate::shared::{Shared, unexpected};

/// Who commands when a command comes over REST from nobody in particular.
const CLIENT_ID: &str = "rest";

/// Longest time that `?wait=1` waits; then 202. Reason: shorter than what proxies and clients allow.
const WAIT_MAX: Duration = Duration::from_mins(1);

/// Characters of a command id.
const COMMAND_ID_MAX: usize = 128;

pub(super) fn routes() -> Router<Arc<Shared>> {
    let mut router = Router::new()
        .route("/alarms/{id}/acknowledge", post(acknowledge))
        .route("/commands/{id}", get(status));
    // An alarm is acknowledged by its own route.
    for verb in Command::VERBS
        .into_iter()
        .filter(|verb| *verb != "alarm_acknowledge")
    {
        let handler = move |State(shared): State<Arc<Shared>>,
                            Extension(user): Extension<User>,
                            InPath(cs): InPath<CoordinateSystemNumber>,
                            InQuery(wait): InQuery<Wait>,
                            headers: HeaderMap,
                            JsonBody(args): JsonBody<Value>| async move {
            let command = Command::parse(verb, &args).map_err(Problem::invalid)?;
            let meta = meta(&shared, &user, &headers)?;
            carry_out(&shared, cs, command, meta, wait.asked()?).await
        };
        router = router.route(&format!("/cs/{{cs}}/{verb}"), post(handler));
    }
    router
}

#[derive(Deserialize)]
struct Wait {
    wait: Option<String>,
}

impl Wait {
    fn asked(&self) -> Result<bool, Problem> {
        match self.wait.as_deref() {
            None | Some("0" | "false") => Ok(false),
            Some("" | "1" | "true") => Ok(true),
            Some(other) => Err(Problem::invalid(format!(
                "wait={other} is not known; write wait=1 or wait=0"
            ))),
        }
    }
}

async fn carry_out(
    shared: &Arc<Shared>,
    cs: CoordinateSystemNumber,
    command: Command,
    meta: CommandMeta,
    wait: bool,
) -> Result<Response, Problem> {
    let command_id = meta.command_id.clone();
    let request = typed::Command {
        cs,
        command,
        meta,
        wait,
    };
    let Ok(place) = Arc::clone(&shared.open_commands).try_acquire_owned() else {
        return Err(Problem::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "unavailable",
            "too many commands are unanswered; send it again",
        ));
    };
    // a task of its own: a client that goes away takes back nothing
    let asking = shared.tasks.spawn({
        let shared = Arc::clone(shared);
        async move {
            let answer = shared.ask(request).await;
            drop(place);
            answer
        }
    });
    let answer = if wait {
        match tokio::time::timeout(WAIT_MAX, asking).await {
            Ok(answer) => answer,
            Err(_) => return Ok(accepted(&command_id)),
        }
    } else {
        asking.await
    };
    reply_response(&answer.map_err(|_| unexpected())??, wait)
}

fn reply_response(reply: &CommandReply, wait: bool) -> Result<Response, Problem> {
    match reply.status {
        CommandStatus::Rejected | CommandStatus::Failed => Err(Problem::of_reply(reply)),
        CommandStatus::Done if wait => Ok(json_response(&json!(reply))),
        CommandStatus::Done | CommandStatus::Accepted => Ok(accepted(&reply.command_id)),
    }
}

/// 202 with the id and where to ask for the rest.
fn accepted(command_id: &str) -> Response {
    let mut response = json_response(&json!({ "command_id": command_id }));
    *response.status_mut() = StatusCode::ACCEPTED;
    if let Ok(location) = HeaderValue::try_from(format!("{API}/commands/{}", percent_encoded(command_id))) {
        response.headers_mut().insert(header::LOCATION, location);
    }
    response
}

fn percent_encoded(text: &str) -> String {
    use std::fmt::Write as _;
    text.bytes().fold(String::new(), |mut path, byte| {
        if byte.is_ascii_alphanumeric() || b"-._~".contains(&byte) {
            path.push(char::from(byte));
        } else {
            // writing to a String cannot fail
            let _ = write!(path, "%{byte:02X}");
        }
        path
    })
}

/// Identity and condition of a command from `Idempotency-Key`, `If-Match` and `Lease-Fence`.
pub(super) fn meta(shared: &Shared, user: &User, headers: &HeaderMap) -> Result<CommandMeta, Problem> {
    let command_id = match headers.get("idempotency-key") {
        None => shared.next_command_id(),
        Some(key) => key
            .to_str()
            .ok()
            .filter(|key| (1..=COMMAND_ID_MAX).contains(&key.len()))
            .map(ToOwned::to_owned)
            .ok_or_else(|| {
                Problem::invalid(format!(
                    "Idempotency-Key is the command's id: write 1 to {COMMAND_ID_MAX} ASCII characters"
                ))
            })?,
    };
    let expect = match headers.get(header::IF_MATCH) {
        None => None,
        Some(tag) => Some(Expect {
            boot_id: None,
            state_rev: Some(state_rev(tag)?),
        }),
    };
    Ok(CommandMeta {
        command_id,
        client_id: user.name.clone().unwrap_or_else(|| CLIENT_ID.to_owned()),
        expect,
        fence: fence(headers)?,
        ..CommandMeta::default()
    })
}

/// Number of the control lease under which a request is sent.
pub(super) fn fence(headers: &HeaderMap) -> Result<Option<u64>, Problem> {
    let Some(value) = headers.get("lease-fence") else {
        return Ok(None);
    };
    let number = value.to_str().ok().and_then(|text| text.trim().parse().ok());
    number.map(Some).ok_or_else(|| {
        Problem::invalid("Lease-Fence is the number of the control lease, as it was given when it was taken")
    })
}

fn state_rev(tag: &HeaderValue) -> Result<u64, Problem> {
    tag.to_str()
        .ok()
        .and_then(|tag| tag.trim().trim_matches('"').parse().ok())
        .ok_or_else(|| {
            Problem::invalid("If-Match is the ETag of the coordinate system's state, such as \"12\"")
        })
}

/// Commands the coordinate system that the alarm stopped; the first one for an alarm of all.
async fn acknowledge(
    State(shared): State<Arc<Shared>>,
    Extension(user): Extension<User>,
    InPath(id): InPath<u64>,
    InQuery(wait): InQuery<Wait>,
    headers: HeaderMap,
    JsonBody(_): JsonBody<Value>,
) -> Result<Response, Problem> {
    let active = shared.read(&Topic::AlarmActive).await?;
    let Payload::AlarmActive(active) = &active.payload else {
        return Err(unexpected());
    };
    let alarm = active
        .alarms
        .iter()
        .find(|alarm| alarm.id == id)
        .ok_or_else(|| Problem::not_found(format!("no alarm with id {id} is active")))?;
    let cs = if let Some(cs) = alarm.cs {
        cs
    } else {
        let birth = shared.birth().await?;
        let first = birth.coordinate_systems.first().ok_or_else(unexpected)?;
        first.number
    };
    let meta = meta(&shared, &user, &headers)?;
    carry_out(&shared, cs, Command::AlarmAcknowledge { id }, meta, wait.asked()?).await
}

async fn status(State(shared): State<Arc<Shared>>, InPath(id): InPath<String>) -> Result<Response, Problem> {
    let reply = shared.ask(typed::CommandStatus(id)).await?;
    Ok(json_response(&json!(reply)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_id_of_any_characters_makes_one_path_segment() {
        assert_eq!(percent_encoded("a-1._~"), "a-1._~");
        assert_eq!(percent_encoded("a/b c?"), "a%2Fb%20c%3F");
    }

    #[test]
    fn if_match_takes_the_revision_with_and_without_quotes() {
        for (tag, rev) in [
            ("\"12\"", Some(12)),
            ("7", Some(7)),
            ("W/\"3\"", None),
            ("*", None),
        ] {
            assert_eq!(state_rev(&HeaderValue::from_static(tag)).ok(), rev, "{tag}");
        }
    }
}
