//! Requests in their HTTP form.

use serde_json::Value;

use super::answer::AnswerForm;
use super::pattern::{fill, names, percent_encoded};
use super::requests::ROWS;
use super::right::Right;
use super::row::{Body, RequestParts, Row};
use super::states::STATES;
use crate::types::not_after::NotAfter;
use crate::types::refusal::{Refusal, RefusalCode};
use crate::types::request::{Input, Request};
use crate::types::topic::Topic;

/// A request over HTTP, and the form of its answer.
#[derive(Debug, Clone)]
pub struct Exchange {
    /// HTTP method.
    pub method: &'static str,
    /// The right that the sender needs.
    pub right: Right,
    /// Path and query, below the base path of the interface.
    pub path: String,
    /// Headers in addition to the token.
    pub headers: Vec<(&'static str, String)>,
    /// Body of the request.
    pub body: Option<String>,
    /// Form of the answer.
    pub answer: AnswerForm,
}

/// Encodes a request.
///
/// # Errors
/// Fails with `not_supported` if the interface has no route for the request.
pub fn encode(request: Request) -> Result<Exchange, Refusal> {
    encode_not_after(request, None)
}

/// Encodes a request with an age limit. The limit is left out if the request cannot cause a motion.
///
/// # Errors
/// Fails like [`encode`].
pub fn encode_not_after(request: Request, not_after: Option<&NotAfter>) -> Result<Exchange, Refusal> {
    let unsupported = |text: String| Err(Refusal::new(RefusalCode::NotSupported, text));
    if let Request::Input(_, Input::OptionalSkip(set)) = &request
        && set.len() != 1
    {
        return unsupported("REST sets one block skip number at a time".to_owned());
    }
    let mut request = request;
    for row in ROWS.iter().filter(|row| !row.routes.is_empty()) {
        let answer = (row.answer)(&request);
        match (row.write)(request) {
            Ok(mut parts) => {
                if row.takes_not_after {
                    parts.limit_age(not_after);
                }
                let text = "the interface has no route for this request";
                return row
                    .exchange(parts, answer)
                    .ok_or_else(|| Refusal::new(RefusalCode::NotSupported, text));
            }
            Err(other) => request = other,
        }
    }
    unsupported(format!("REST has no route for this request: {request:?}"))
}

/// Encodes the request that reads a state; returns `None` if the state has no route.
pub fn read(topic: &Topic) -> Option<Exchange> {
    let parts = match topic {
        Topic::CoordinateSystem(cs, _) => RequestParts::for_coordinate_system(*cs),
        Topic::Io(point) => RequestParts::for_io(point),
        _ => RequestParts::default(),
    };
    let params: Vec<_> = parts
        .params
        .iter()
        .map(|(name, level)| (*name, level.as_str()))
        .collect();
    let row = STATES.iter().find(|row| row.topic(&params) == *topic)?;
    Some(Exchange {
        right: Right::Read,
        method: row.route.method,
        path: fill(row.route.pattern, &parts.params, percent_encoded)?,
        headers: Vec::new(),
        body: None,
        answer: AnswerForm::Nothing,
    })
}

impl Row {
    fn exchange(&self, parts: RequestParts, answer: AnswerForm) -> Option<Exchange> {
        let mut routes = self.routes.iter();
        let (route, path) =
            routes.find_map(|route| Some((route, fill(route.pattern, &parts.params, percent_encoded)?)))?;
        let mut headers = Vec::new();
        let body = match parts.body {
            Body::Nothing => None,
            Body::Json(body) => {
                headers.push(("content-type", "application/json".to_owned()));
                Some(without_names(body, route.pattern).to_string())
            }
            Body::Text(text) => {
                headers.push(("content-type", "text/plain; charset=utf-8".to_owned()));
                Some(text)
            }
        };
        headers.extend(parts.headers);
        Some(Exchange {
            right: self.right,
            method: route.method,
            path: path + &query(&parts.query),
            headers,
            body,
            answer,
        })
    }
}

fn query(values: &[(&str, String)]) -> String {
    let values: Vec<_> = values
        .iter()
        .map(|(name, value)| format!("{name}={}", percent_encoded(value)))
        .collect();
    match values.join("&") {
        none if none.is_empty() => none,
        query => format!("?{query}"),
    }
}

/// Returns a body without the fields whose values are in the path.
fn without_names(mut body: Value, pattern: &str) -> Value {
    if let Value::Object(fields) = &mut body {
        for name in names(pattern) {
            fields.remove(name);
        }
    }
    body
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::handshake::reset_of;
    use crate::types::BootId;
    use crate::types::command::{Command, CommandMeta, Expect};

    fn sent(request: Request) -> (String, String, Value) {
        let exchange = encode(request).unwrap();
        let body = exchange
            .body
            .as_deref()
            .map_or(Value::Null, |body| serde_json::from_str(body).unwrap());
        (exchange.method.to_owned(), exchange.path, body)
    }

    fn command(command: Command, wait: bool) -> Request {
        let meta = CommandMeta {
            command_id: "c 1".into(),
            client_id: "plc".into(),
            expect: Some(Expect {
                state_rev: Some(12),
                ..Expect::default()
            }),
            ..CommandMeta::default()
        };
        Request::Command {
            cs: 2,
            command,
            meta,
            wait,
        }
    }

    #[test]
    fn requests_have_the_routes_and_bodies_of_their_rows() {
        let post = |path: &str, body| ("POST".to_owned(), path.to_owned(), body);
        let put = |path: &str, body| ("PUT".to_owned(), path.to_owned(), body);
        assert_eq!(
            sent(command(Command::Load { program: 7 }, true)),
            post("/cs/2/load?wait=1", json!({"program": 7}))
        );
        assert_eq!(
            sent(command(Command::AlarmAcknowledge { id: 5 }, false)),
            post("/alarms/5/acknowledge", json!({}))
        );
        let reset = reset_of(&BootId("b".into()), 7, "h", None);
        assert_eq!(
            sent(Request::Reset(1, Some(100), reset)),
            post(
                "/cs/1/m_codes/7/reset",
                json!({"boot_id": "b", "handler_id": "h", "result": "ok"})
            )
        );
        assert_eq!(
            sent(Request::Input(1, Input::OptionalSkip([(3, true)].into()))),
            put("/cs/1/inputs/optional_skip/3", json!({"value": true}))
        );
        assert_eq!(
            sent(Request::IntermediateCode(7)),
            (
                "GET".to_owned(),
                "/programs/7/intermediate".to_owned(),
                Value::Null
            )
        );
        assert_eq!(sent(Request::Tool(1, 4)), put("/cs/1/tool", json!({"id": 4})));
    }

    #[test]
    fn a_command_carries_its_id_and_condition_in_headers() {
        let headers = encode(command(Command::Start, false)).unwrap().headers;
        assert!(headers.contains(&("idempotency-key", "c 1".to_owned())));
        assert!(headers.contains(&("if-match", "\"12\"".to_owned())));
    }
}
