//! No message, request or frame causes a panic of its reader, and each input is read as exactly one value.
//! The inputs are seeded, so all runs are identical.

mod readers;

use proptest::prelude::*;

/// Initial messages, valid and invalid: each is a topic or a row, with its content.
const TOPICS: &[&str] = &[
    "cs/1/m_code/20/reset",
    "cs/1/m_code/20/claim",
    "cs/1/command/jog",
    "cs/1/lease/take",
    "cs/1/variable/set",
    "cs/1/input/optional_skip/set",
    "cs/1/override/set",
    "handler/clamp/presence",
    "client/panel/heartbeat",
    "alarm/raise",
    "cs/01/command/start",
    "",
];

/// Pieces of JSON, from which payloads are built.
const PIECES: &[&str] = &[
    "{",
    "}",
    "\"boot_id\":\"b\"",
    "\"seq\":1",
    "\"handler_id\":\"h\"",
    "\"result\":\"ok\"",
    "\"force\":null",
    "\"force\":true",
    "\"command_id\":\"c\"",
    "\"client_id\":\"p\"",
    "\"args\":{\"axis\":\"X\",\"velocity\":1,\"refresh_id\":\"j\"}",
    "\"ttl_ms\":500",
    "\"cs\":1",
    "\"value\":true",
    "\"kind\":\"p\",\"from\":1,\"values\":[1,null]",
    "\"feed\":1e999",
    "\"online\":true,\"handles\":[{\"cs\":1,\"m\":12}]",
    "\"handler\":{\"id\":\"h\",\"online\":true}",
    "\"heartbeat\":{\"id\":\"p\",\"ttl_ms\":500}",
    "\"subscribe\":[\"#\"]",
    ",",
    ",",
    ",",
    "\u{feff}",
    "\\u0000",
];

/// Returns complete objects, and objects with pieces that are missing or in the wrong order.
fn payload() -> impl Strategy<Value = String> {
    let pieces = || proptest::collection::vec(proptest::sample::select(PIECES), 0..9);
    prop_oneof![
        pieces().prop_map(|pieces| pieces.concat()),
        pieces().prop_map(|pieces| {
            let members: Vec<_> = pieces
                .into_iter()
                .filter(|piece| piece.starts_with('"'))
                .collect();
            format!("{{{}}}", members.join(","))
        }),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4_000))]

    #[test]
    fn a_message_over_mqtt_is_one_request_or_a_reason(topic in proptest::sample::select(TOPICS), payload in payload()) {
        readers::mqtt(format!("{topic}\n{payload}").as_bytes());
    }

    #[test]
    fn a_request_over_rest_is_one_request_or_a_reason(row in any::<u8>(), lines in "(1|x|01|-1|)\n(1|x|)\n[1-3]?\n?", payload in payload()) {
        readers::rest(&[&[row], lines.as_bytes(), payload.as_bytes()].concat());
    }

    #[test]
    fn a_frame_of_a_websocket_is_its_requests_or_a_reason(payload in payload()) {
        readers::websocket(payload.as_bytes());
    }

    #[test]
    fn bytes_of_any_kind_make_no_reader_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        readers::mqtt(&bytes);
        readers::rest(&bytes);
        readers::websocket(&bytes);
    }
}
