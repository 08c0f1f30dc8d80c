//! A request costs its row with its answer, its row on the wires, and the code that executes it: clients,
//! server ends, rights and the documents of the interface follow.

use std::path::PathBuf;

use super::{costs, files_where};

const REQUESTS: &str = "plc-api/protocol/src/types/request.rs";
const WIRE: &str = "plc-api/protocol/src/wire/requests.rs";
/// Rows of requests about programs, which are a part of the rows above.
const PROGRAM_ROWS: &str = "plc-api/protocol/src/wire/program_rows.rs";
const PORT: &str = "runtime/src/port.rs";
const LEDGER: &str = "plc-api/protocol/src/handshake.rs";
const COORDINATE_SYSTEM: &str = "runtime/src/coordinate_system/mod.rs";
const FAKE: &str = "plc-api/protocol/src/fake/requests.rs";
const MESSAGE_SENDER: &str = "plc-api/protocol/src/wire/message_sender.rs";

fn is_name(letter: char) -> bool {
    letter.is_alphanumeric() || letter == '_'
}

/// Returns product files with matching code.
fn files(names_it: impl Fn(&str) -> bool) -> Vec<PathBuf> {
    let mut found = files_where("runtime", ".rs", &names_it);
    found.extend(files_where("plc-api", ".rs", names_it));
    found.sort();
    found
}

/// Returns product files that name a request because they execute it, contain its row, or are part of a wire.
/// Clients that send it are not counted.
fn naming(kind: &str, request: &str) -> Vec<PathBuf> {
    let names = |code: &str, variant: &str| {
        code.split(|letter| !is_name(letter) && letter != ':')
            .any(|word| word.ends_with(variant))
    };
    let (carried_out, sent) = (format!("{kind}::{request}"), format!("Request::{request}"));
    let mut found = files(|code| names(code, &carried_out));
    found.extend(files(|code| {
        code.contains(&format!("\n        {request}(")) && code.contains("! requests")
    }));
    let on_a_wire =
        |file: &PathBuf| file.starts_with("plc-api/protocol/src/wire") || file.starts_with("runtime/gateway");
    // the macros of the rows, with and without a right in front
    let rows = [format!("!({request}("), format!(", {request}(")];
    let of_wire = files(|code| names(code, &sent) || rows.iter().any(|row| code.contains(row)));
    found.extend(of_wire.into_iter().filter(on_a_wire));
    found.sort();
    found.dedup();
    found
}

fn sorted<const N: usize>(files: [&str; N]) -> Vec<PathBuf> {
    let mut files = files.map(PathBuf::from);
    files.sort();
    files.into()
}

#[test]
fn machine_request_is_named_in_its_two_rows_and_in_the_port() {
    for request in ["IntermediateCode", "CheckProgram"] {
        let whole_word = |code: &str| code.split(|letter| !is_name(letter)).any(|word| word == request);
        assert_eq!(
            files(whole_word),
            sorted([REQUESTS, PROGRAM_ROWS, PORT]),
            "{request}"
        );
    }
    for request in ["CommandStatus", "Explain", "LineState"] {
        let named = naming("MachineRequest", request);
        assert_eq!(named, sorted([REQUESTS, WIRE, PORT]), "{request}");
    }
    assert_eq!(costs("a request"), [REQUESTS, WIRE, PORT]);
}

#[test]
fn a_request_about_an_output_is_named_by_its_two_rows_and_by_the_ledger() {
    assert_eq!(
        naming("OutputRequest", "Redeliver"),
        sorted([REQUESTS, WIRE, LEDGER])
    );
    assert_eq!(costs("a request about an output"), [REQUESTS, WIRE, LEDGER]);
}

#[test]
fn coordinate_system_request_is_named_in_its_documented_files_only() {
    let files = [REQUESTS, WIRE, COORDINATE_SYSTEM, FAKE, MESSAGE_SENDER];
    assert_eq!(naming("CoordinateSystemRequest", "Spindle"), sorted(files));
    assert_eq!(costs("a request to a coordinate system"), files);
}
