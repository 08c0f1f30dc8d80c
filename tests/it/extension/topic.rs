//! A state topic costs its row and the code that publishes it: transports, routes and the documents of the
//! interface follow. A new payload also costs its type.

use std::path::PathBuf;

use super::{costs, files_where};

const TOPICS: &str = "plc-api/protocol/src/types/topic.rs";
const PUBLISHED: &str = "runtime/src/coordinate_system/publish/published_values.rs";
const TYPES: &str = "plc-api/protocol/src/types/state.rs";

/// Product files of a folder with this code.
fn with(folder: &str, code: &str) -> Vec<PathBuf> {
    files_where(folder, ".rs", |text| text.contains(code))
}

#[test]
fn state_topic_is_named_in_its_row_payload_and_publisher_only() {
    for (code, file) in [
        ("Modal \"modal\" \"modal\" Modal(Modal)", TOPICS),
        ("    Modal(Modal),", TOPICS),
        ("pub struct Modal {", TYPES),
    ] {
        assert_eq!(with("plc-api", code), [PathBuf::from(file)], "{code}");
    }
    assert_eq!(with("plc-api", "CsTopic::Modal"), Vec::<PathBuf>::new());
    // the command line and MTConnect read topics as any client does
    let mut named = with("runtime", "CsTopic::Modal");
    named.retain(|file| !file.starts_with("runtime/src/cli") && !file.starts_with("runtime/mtconnect"));
    assert_eq!(named, [PathBuf::from(PUBLISHED)]);
    assert_eq!(costs("a state topic"), [TOPICS, PUBLISHED, TYPES]);
}
