//! Access control: every route and topic needs a [`Right`], a [`Role`] is a set of rights, and a token identifies a user
//! with a role. Without a token file everyone on the loopback is `admin`.

pub(crate) mod guard;
pub(crate) mod http;
mod live;
mod mosquitto;
mod rate;
mod tokens;
pub(crate) mod topics;

use std::sync::Arc;

use plc_api::types::request::Request;
use plc_api::wire::right::Right;
use serde::{Deserialize, Serialize};

pub(crate) use live::LiveTokens;
pub use mosquitto::mosquitto_acl;
pub(crate) use rate::{Rate, Rates};
pub use tokens::{NewToken, TokenError, Tokens, new_token};
pub(crate) use tokens::{Token, random_secret};

/// What a user may do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Reads everything, changes nothing.
    View,
    /// Operates the machine: commands, inputs, overrides, values, resets by hand.
    Operate,
    /// May do everything, including changes of the program store.
    Admin,
    /// A sequence program: claims, resets, reports progress and presence, in its own name only, and raises alarms.
    Handler,
}

impl Role {
    /// The roles and their names in token files and on the command line.
    pub const ALL: [(&'static str, Role); 4] = [
        ("view", Role::View),
        ("operate", Role::Operate),
        ("admin", Role::Admin),
        ("handler", Role::Handler),
    ];

    /// The role with this name.
    pub fn of_word(word: &str) -> Option<Role> {
        let mut all = Self::ALL.iter();
        all.find(|(known, _)| *known == word).map(|(_, role)| *role)
    }

    /// The name of the role.
    pub fn word(self) -> &'static str {
        let mut all = Self::ALL.iter();
        all.find(|(_, role)| *role == self).map_or("", |(word, _)| word)
    }

    pub(crate) fn has(self, right: Right) -> bool {
        match self {
            Role::View => right == Right::Read,
            Role::Operate => matches!(right, Right::Read | Right::Operate | Right::Reset | Right::Raise),
            Role::Handler => matches!(right, Right::Read | Right::Handle | Right::Reset | Right::Raise),
            Role::Admin => true,
        }
    }
}

/// The user of a request or a connection.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum User {
    /// Anyone on the loopback, without a token file: an admin.
    Anyone,
    /// Anyone, on a route that needs no token.
    Stranger,
    /// The owner of a token.
    Token(Arc<Token>),
}

impl User {
    pub(crate) fn name(&self) -> Option<&str> {
        match self {
            User::Token(token) => Some(&token.name),
            User::Anyone | User::Stranger => None,
        }
    }

    pub(crate) fn role(&self) -> Role {
        match self {
            User::Anyone => Role::Admin,
            User::Stranger => Role::View,
            User::Token(token) => token.role,
        }
    }

    pub(crate) fn has(&self, right: Right) -> bool {
        self.role().has(right)
    }

    /// An error if this user may not act as this handler: a handler's token acts in its own name only.
    pub(crate) fn speaks_as(&self, handler_id: &str) -> Result<(), String> {
        match self.name() {
            Some(name) if self.role() == Role::Handler && name != handler_id => Err(format!(
                "the token of {name} has role handler: it speaks as handler_id {name} only"
            )),
            _ => Ok(()),
        }
    }

    /// An error if this user may not reset as this handler. Only operators may reset by force.
    pub(crate) fn resets_as(&self, handler_id: &str, force: bool) -> Result<(), String> {
        if force && !self.has(Right::Operate) {
            return Err("a reset by force needs role operate or admin".to_owned());
        }
        self.speaks_as(handler_id)
    }
}

/// Why a user may not send this request, if so: a handler speaks in its own name only.
pub(crate) fn check_speaker(user: &User, request: &Request) -> Result<(), String> {
    match request {
        Request::Claim(_, _, claim) => user.speaks_as(&claim.handler_id),
        Request::Reset(_, _, reset) => user.resets_as(&reset.handler_id, reset.force.unwrap_or(false)),
        Request::Progress(_, _, report) => user.speaks_as(&report.handler_id),
        Request::Ask(_, _, ask) => user.speaks_as(&ask.handler_id),
        Request::ValidateResult(_, _, result) => user.speaks_as(&result.handler_id),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_role_has_the_rights_of_its_row_and_no_more() {
        let rights = [
            Right::Read,
            Right::Operate,
            Right::Handle,
            Right::Reset,
            Right::Administrate,
        ];
        let table = [
            (Role::View, [true, false, false, false, false]),
            (Role::Operate, [true, true, false, true, false]),
            (Role::Handler, [true, false, true, true, false]),
            (Role::Admin, [true; 5]),
        ];
        for (role, expected) in table {
            assert_eq!(rights.map(|right| role.has(right)), expected, "{role:?}");
            assert_eq!(Role::of_word(role.word()), Some(role));
        }
    }

    #[test]
    fn a_handler_speaks_in_its_own_name_and_never_by_force() {
        let user = Token::user_for_test;
        let handler = user("magazine", Role::Handler);
        assert!(handler.speaks_as("magazine").is_ok());
        assert!(handler.speaks_as("other").is_err());
        assert!(handler.resets_as("magazine", false).is_ok());
        assert!(handler.resets_as("magazine", true).is_err());
        assert!(user("hmi-1", Role::Operate).resets_as("hmi", true).is_ok());
        assert!(User::Anyone.resets_as("hmi", true).is_ok());
    }
}
