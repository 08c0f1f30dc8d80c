//! Access to MQTT topics. Pure: no I/O.

use plc_protocol::wire::message_sender::MessageSender;
use plc_protocol::wire::right::Right;

use super::{Role, User};
use crate::contract::topics::inbound;

/// Returns true if a user may publish on a topic; the payload is authorized after it is parsed. States belong to the
/// runtime. Below other roots, publishing is allowed to every client without tokens, and to none with them.
pub(crate) fn may_publish(user: &User, root: &str, topic: &str) -> bool {
    let Some(path) = topic.strip_prefix(root) else {
        return user.name().is_none();
    };
    let Some((_, right)) = inbound(path) else {
        return false;
    };
    let in_own_name = match (
        MessageSender::split(path).0,
        path.split('/').collect::<Vec<_>>().as_slice(),
    ) {
        (Some(speaker), _) => user.role() != Role::Handler || user.name() == Some(speaker.id()),
        (None, ["handler", id, "presence"] | ["client", id, "heartbeat"]) => {
            user.role() != Role::Handler || user.name() == Some(id)
        }
        _ => true,
    };
    user.has(right) && in_own_name
}

/// Returns true if a user may subscribe. A user who may read may read all messages of the machine.
pub(crate) fn may_subscribe(user: &User) -> bool {
    user.has(Right::Read)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::Token;

    const ROOT: &str = "tandem/v1/mill-1/";

    fn user(role: Role) -> User {
        Token::user_for_test("magazine", role)
    }

    #[test]
    fn handlers_claim_and_reset_hmis_command_and_only_the_runtime_says_state() {
        // view, operate, handler, admin
        let roles = [Role::View, Role::Operate, Role::Handler, Role::Admin];
        for (path, allowed) in [
            ("cs/1/m_code/5/claim", [false, false, true, true]),
            ("cs/1/m_code/5/progress", [false, false, true, true]),
            ("cs/1/m_code/5/reset", [false, true, true, true]),
            ("cs/1/m_code/5/redeliver", [false, true, false, true]),
            ("handler/magazine/presence", [false, false, true, true]),
            ("handler/other/presence", [false, false, false, true]),
            ("client/magazine/heartbeat", [false, true, true, true]),
            ("client/other/heartbeat", [false, true, false, true]),
            ("heartbeat", [false; 4]),
            ("alarm/raise", [false, true, true, true]),
            ("alarm/active", [false; 4]),
            ("stored_data/answer", [false, true, false, true]),
            ("stored_data", [false; 4]),
            ("cs/1/command/start", [false, true, false, true]),
            ("cs/1/input/interlock/set", [false, true, true, true]),
            ("io/in/door/set", [false, true, true, true]),
            ("io/out/lamp/set", [false, true, true, true]),
            ("io/out/lamp/force", [false, true, false, true]),
            ("io/out/lamp", [false; 4]),
            ("cs/1/override/set", [false, true, false, true]),
            ("cs/1/tool/set", [false, true, true, true]),
            ("cs/1/lease/take", [false, true, false, true]),
            ("cs/1/lease/release", [false, true, false, true]),
            ("cs/1/lease/break", [false, false, false, true]),
            ("cs/1/lease/state", [false; 4]),
            ("cs/1/variable/set", [false, true, true, true]),
            ("cs/1/variable/get", [true; 4]),
            ("cs/1/spindle/set", [false, true, true, true]),
            ("client/magazine/cs/1/command/start", [false, true, false, true]),
            ("client/other/cs/1/variable/get", [true, true, false, true]),
            ("handler/magazine/cs/1/m_code/5/claim", [false, false, true, true]),
            ("handler/other/cs/1/m_code/5/claim", [false, false, false, true]),
            ("handler/magazine/io/out/lamp/set", [false, true, true, true]),
            ("handler/magazine/cs/1/state", [false; 4]),
            ("cs/1/state", [false; 4]),
            ("cs/1/m_code/pending", [false; 4]),
            ("cs/1/m_code/5/output", [false; 4]),
            ("presence", [false; 4]),
            ("reply/hmi", [false; 4]),
        ] {
            let topic = format!("{ROOT}{path}");
            let found = roles.map(|role| may_publish(&user(role), ROOT, &topic));
            assert_eq!(found, allowed, "{path}");
        }
        assert!(!may_publish(
            &user(Role::Admin),
            ROOT,
            "tandem/v1/mill-2/cs/1/command/start"
        ));
        assert!(may_publish(&User::Anyone, ROOT, "plant/light"));
        assert!(!may_publish(&User::Anyone, ROOT, "tandem/v1/mill-1/cs/1/state"));
        assert!(
            roles
                .map(|role| may_subscribe(&user(role)))
                .iter()
                .all(|may| *may)
        );
    }
}
