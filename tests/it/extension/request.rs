//! A request costs its row with its answer, its row on the wires, and what carries it out: clients, server ends, rights and
//! the documents of the interface follow.

use std::path::PathBuf;

use super::{costs, files_where};

const REQUESTS: &str = "plc-api/src/types/request.rs";
const WIRE: &str = "plc-api/src/wire/requests.rs";
const PORT: &str = "runtime/src/port.rs";

/// Product files that name a request.
fn naming(request: &str) -> Vec<PathBuf> {
    let is_letter = |letter: char| letter.is_alphanumeric() || letter == '_';
    let names_it = |code: &str| {
        code.split(|letter| !is_letter(letter))
            .any(|word| word == request)
    };
    let mut found = files_where("runtime", ".rs", names_it);
    found.extend(files_where("plc-api", ".rs", names_it));
    found.sort();
    found
}

#[test]
fn a_request_is_named_by_its_two_rows_and_where_it_is_carried_out() {
    for request in ["DeleteProgram", "CheckProgram", "IntermediateCode"] {
        let mut expected: Vec<PathBuf> = [REQUESTS, WIRE, PORT].map(PathBuf::from).into();
        if request == "IntermediateCode" {
            // as large as an upload, so that it waits for a place among them
            expected.push("runtime/gateway/src/rest/requests.rs".into());
        }
        expected.sort();
        assert_eq!(naming(request), expected, "{request}");
    }
    assert_eq!(costs("a request"), [REQUESTS, WIRE, PORT]);
}
