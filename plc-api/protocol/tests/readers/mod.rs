//! Properties of every input from a client, for tests of this crate and for the fuzzers.

use std::borrow::Cow;

use plc_protocol::wire::mqtt::{self, Inbound};
use plc_protocol::wire::parameter::QueryValues;
use plc_protocol::wire::row::{IncomingRequest, Sender, Source};
use plc_protocol::wire::websocket::{self, ClientFrame, ServerFrame};
use plc_protocol::wire::{ROWS, json_object};

/// Returns the next line of the input.
fn line<'a>(rest: &mut &'a [u8]) -> Cow<'a, str> {
    let end = rest.iter().position(|byte| *byte == b'\n').unwrap_or(rest.len());
    let (line, behind) = rest.split_at(end);
    *rest = behind.get(1..).unwrap_or_default();
    String::from_utf8_lossy(line)
}

/// Reads an MQTT message; the first line is its topic. The request that is read can be written and read again
/// as an equal request, so the authorized request is the executed request.
pub fn mqtt(data: &[u8]) {
    let mut payload = data;
    let topic = line(&mut payload);
    let read = mqtt::decode(&topic, payload, false);
    let retained = mqtt::decode(&topic, payload, true);
    match &read {
        Inbound::Ask { request, .. } => {
            let sender = mqtt::sender(request.request());
            let client_id = sender.map_or_else(String::new, |(_, meta)| meta.client_id.clone());
            let Ok(sent) = mqtt::encode(request.request().clone(), &client_id, |_, _| None) else {
                return;
            };
            let again = match mqtt::decode(&sent.path, sent.payload.as_bytes(), false) {
                Inbound::Ask { request, .. } => format!("{request:?}"),
                other => format!("{other:?}"),
            };
            assert_eq!(again, format!("{request:?}"));
        }
        Inbound::Reject { refusal, .. } => assert!(!refusal.text.is_empty()),
        Inbound::RefuseOutput { result, .. } => assert!(result.text.is_some()),
        Inbound::Drop(text) => assert!(!text.is_empty()),
    }
    if let (Inbound::Ask { request, .. }, Inbound::Ask { request: kept, .. }) = (&read, &retained) {
        assert_eq!(format!("{request:?}"), format!("{kept:?}"));
    }
}

/// The head of an HTTP request in which each header has one and the same value.
struct UniformHeaders(String);

impl Sender for UniformHeaders {
    fn header(&self, _: &str) -> Option<&str> {
        (!self.0.is_empty()).then_some(self.0.as_str())
    }

    fn client_id(&self) -> String {
        "rest".to_owned()
    }

    fn new_command_id(&self) -> String {
        "1".to_owned()
    }
}

/// Reads a request over REST. The first byte names the row; the next lines are a header, `wait`, and the
/// levels of the path; the rest is the body. The request that is read needs the right of its row.
pub fn rest(data: &[u8]) {
    let Some((which, mut body)) = data.split_first() else {
        return;
    };
    let row = &ROWS[usize::from(*which) % ROWS.len()];
    let head = UniformHeaders(line(&mut body).into_owned());
    let wait = line(&mut body).into_owned();
    for route in row.routes {
        let mut body = body;
        let values: Vec<_> = route.names().map(|name| (name, line(&mut body))).collect();
        let mut params: Vec<(&str, &str)> = values.iter().map(|(name, value)| (*name, &**value)).collect();
        for (name, value) in route.fixed() {
            params.push((name, value));
        }
        let incoming = IncomingRequest {
            params: &params,
            body: Cow::Borrowed(body),
            query: QueryValues {
                from: Some(0),
                count: wait.parse().ok(),
                wait: Some(wait.clone()),
                ..QueryValues::default()
            },
            source: Source::Http(&head),
            not_after_is_apart: false,
        };
        if let Ok(request) = row.parse(incoming) {
            assert_eq!(request.right(), row.right);
        }
    }
}

/// Reads a frame of the WebSocket as each side does. The requests of a frame can be written again as frames
/// of equal requests.
pub fn websocket(data: &[u8]) {
    let _ = ServerFrame::read(&String::from_utf8_lossy(data));
    let Ok(frame) = json_object::<ClientFrame>(data) else {
        return;
    };
    for request in frame.requests() {
        let written = websocket::encode(request.request().clone()).map(|frame| frame.to_json());
        let again: ClientFrame = json_object(written.unwrap_or_default().as_bytes()).unwrap_or_default();
        let again: Vec<_> = again.requests().collect();
        assert_eq!(format!("{again:?}"), format!("{:?}", [request]));
    }
}
