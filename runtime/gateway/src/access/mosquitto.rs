//! The access rules as a Mosquitto ACL file, for an external broker.

use std::fmt::Write as _;

use plc_api::wire::machines;

use super::{Role, Tokens};
use crate::contract::topics::inbound_topics;

/// The text of a Mosquitto ACL file for the users of the tokens, and for the runtime's own user, the only one that may
/// publish states. `root` is the machine's topic root with its last slash.
pub fn mosquitto_acl(root: &str, runtime_user: Option<&str>, tokens: &Tokens) -> String {
    let mut text = format!(
        "# Access to the topics below {root}. Users are those of the token file; give each its token as password:\n# mosquitto_passwd -b PASSWORD_FILE NAME TOKEN\n"
    );
    // writing to a String cannot fail
    if let Some(user) = runtime_user {
        let _ = write!(
            text,
            "\n# the runtime itself ([mqtt] username)\nuser {user}\ntopic readwrite {root}#\n"
        );
        let base = root
            .trim_end_matches('/')
            .rsplit_once('/')
            .map_or("", |(base, _)| base);
        let _ = writeln!(text, "# what it shows of other machines on the page of several");
        for topic in machines::TOPICS {
            let _ = writeln!(text, "topic read {base}/+/{topic}");
        }
    }
    for (name, role) in tokens.users() {
        let _ = write!(text, "\n# {}\nuser {name}\ntopic read {root}#\n", role.name());
        for (row, _) in inbound_topics().filter(|(_, right)| role.has(*right)) {
            // a handler announces itself, and is watched, in its own name only
            let filter = match row.filter().as_str() {
                filter @ ("handler/+/presence" | "client/+/heartbeat") if role == Role::Handler => {
                    filter.replace('+', name)
                }
                filter => filter.to_owned(),
            };
            let _ = writeln!(text, "topic write {root}{filter}");
        }
    }
    text
}
