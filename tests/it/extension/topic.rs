//! A state topic costs its row, where it is published, and its route: transports and the documents of the interface follow.
//! A payload of its own is a type and a variant besides.

use std::path::PathBuf;

use super::{costs, files_where};

const TOPICS: &str = "plc-api/src/types/topic.rs";
const PUBLISHED: &str = "runtime/src/coordinate_system/publish.rs";
const ROUTES: &str = "plc-api/src/wire/states.rs";
const TYPES: &str = "plc-api/src/types/state.rs";
const PAYLOADS: &str = "plc-api/src/types/message.rs";

/// Product files of a folder with this code.
fn with(folder: &str, code: &str) -> Vec<PathBuf> {
    files_where(folder, ".rs", |text| text.contains(code))
}

#[test]
fn a_state_topic_is_named_by_its_row_by_its_route_and_where_it_is_published() {
    for (code, file) in [
        ("Modal \"modal\" Modal(Modal);", TOPICS),
        ("CsTopic::Modal", ROUTES),
        ("pub struct Modal {", TYPES),
        ("    Modal(Modal),", PAYLOADS),
    ] {
        assert_eq!(with("plc-api", code), [PathBuf::from(file)], "{code}");
    }
    assert_eq!(with("runtime", "CsTopic::Modal"), [PathBuf::from(PUBLISHED)]);
    assert_eq!(
        costs("a state topic"),
        [TOPICS, PUBLISHED, ROUTES, TYPES, PAYLOADS]
    );
}
