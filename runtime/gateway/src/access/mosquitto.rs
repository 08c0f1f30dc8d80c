//! The access rules as a Mosquitto ACL file, for an external broker.

use std::fmt::Write as _;

use plc_protocol::wire::machines;
use plc_protocol::wire::message_sender::MessageSender;
use plc_protocol::wire::right::Right;

use super::{Role, Tokens};
use crate::contract::topics::inbound_topics;

/// Returns the text of a Mosquitto ACL file for the users of the tokens, and for the runtime's own user, the only one
/// that may publish states. `root` is the machine's topic root with its last slash.
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
        let _ = writeln!(
            text,
            "# states of other machines, for the page of several machines"
        );
        for topic in machines::TOPICS {
            let _ = writeln!(text, "topic read {base}/+/{topic}");
        }
    }
    for (name, role) in tokens.users() {
        let _ = write!(text, "\n# {}\nuser {name}\ntopic read {root}#\n", role.name());
        for (row, right) in inbound_topics().filter(|(_, right)| role.has(*right)) {
            for filter in filters(name, role, &row.filter(), right) {
                let _ = writeln!(text, "topic write {root}{filter}");
            }
        }
    }
    text
}

/// Returns the filters on which a user may publish: a handler as a handler with its own name, other users as clients
/// with their own names, and an admin also as any handler.
fn filters(name: &str, role: Role, filter: &str, right: Right) -> Vec<String> {
    if let "handler/+/presence" | "client/+/heartbeat" = filter {
        return vec![if role == Role::Admin {
            filter.to_owned()
        } else {
            filter.replacen('+', name, 1)
        }];
    }
    let as_handler = if role == Role::Admin { "+" } else { name };
    let handler = || MessageSender::Handler(as_handler.to_owned()).path(filter);
    let client = || MessageSender::Client(name.to_owned()).path(filter);
    match role {
        Role::Handler => vec![handler()],
        Role::Admin if Role::Handler.has(right) => vec![handler(), client()],
        Role::Admin | Role::Operate | Role::View => vec![client()],
    }
}
