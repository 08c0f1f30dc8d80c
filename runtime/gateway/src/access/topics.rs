//! Access to MQTT topics. Pure: no I/O.

use plc_api::wire::right::Right;
use serde::Deserialize;

use super::User;
use crate::contract::topics::inbound;

/// Whether a user may publish on a topic. States belong to the runtime; below other roots anyone may publish without
/// tokens, and nobody with them.
pub(crate) fn may_publish(user: &User, root: &str, topic: &str) -> bool {
    let Some(path) = topic.strip_prefix(root) else {
        return user.name().is_none();
    };
    let Some(row) = inbound(path) else {
        return false;
    };
    let in_own_name = match path.split('/').collect::<Vec<_>>().as_slice() {
        ["handler", id, "presence"] => user.speaks_as(id).is_ok(),
        _ => true,
    };
    user.has(row.right) && in_own_name
}

/// Whether a user may subscribe. Whoever may read may read all that the machine publishes.
pub(crate) fn may_subscribe(user: &User) -> bool {
    user.has(Right::Read)
}

/// An error if a user may not publish this payload: a handler claims, resets and reports progress in its own name, and
/// never by force. A malformed payload is refused later, when it is decoded.
pub(crate) fn may_say(user: &User, path: &str, payload: &[u8]) -> Result<(), String> {
    #[derive(Deserialize)]
    struct Said {
        handler_id: Option<String>,
        #[serde(default)]
        force: bool,
    }
    if user.has(Right::Operate) || !path.contains("/m_code/") {
        return Ok(());
    }
    match serde_json::from_slice::<Said>(payload) {
        Ok(said) => user.resets_as(said.handler_id.as_deref().unwrap_or_default(), said.force),
        Err(_) => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::{Role, Token};

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
            ("alarm/raise", [false, true, true, true]),
            ("alarm/active", [false; 4]),
            ("cs/1/command/start", [false, true, false, true]),
            ("cs/1/input/dry_run/set", [false, true, false, true]),
            ("cs/1/override/set", [false, true, false, true]),
            ("cs/1/tool/set", [false, true, false, true]),
            ("cs/1/lease/take", [false, true, false, true]),
            ("cs/1/lease/release", [false, true, false, true]),
            ("cs/1/lease/break", [false, false, false, true]),
            ("cs/1/lease/state", [false; 4]),
            ("cs/1/variable/set", [false, true, false, true]),
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

    #[test]
    fn a_handler_says_only_what_is_its_own() {
        let path = "cs/1/m_code/5/reset";
        let handler = user(Role::Handler);
        for (payload, allowed) in [
            (r#"{"handler_id":"magazine","seq":1}"#, true),
            (r#"{"handler_id":"other","seq":1}"#, false),
            (r#"{"handler_id":"magazine","force":true}"#, false),
            (r#"{"seq":1}"#, false),
        ] {
            assert_eq!(
                may_say(&handler, path, payload.as_bytes()).is_ok(),
                allowed,
                "{payload}"
            );
            assert!(may_say(&user(Role::Operate), path, payload.as_bytes()).is_ok());
        }
    }
}
