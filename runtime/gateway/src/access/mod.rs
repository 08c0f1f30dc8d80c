//! Who may do what: roles and their rights, tokens, and what each right opens on MQTT.
//!
//! A [`Right`] is named by every route and every topic of the wire; a [`Role`] is a set of
//! rights. Without a token file everyone on the loopback is `admin`; with one, [`Tokens`] tells whose a token is.

pub(crate) mod guard;
pub(crate) mod http;
mod live;
mod mosquitto;
mod rate;
mod tokens;
pub(crate) mod topics;

use plc_api::types::request::Request;
use plc_api::wire::right::Right;
use serde::{Deserialize, Serialize};

pub(crate) use live::LiveTokens;
pub use mosquitto::mosquitto_acl;
pub(crate) use rate::Rate;
pub use tokens::{NewToken, TokenError, Tokens, new_token};
pub(crate) use tokens::{TokenDigest, random_secret};

/// What a user may do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Reads everything, changes nothing.
    View,
    /// Works at the machine: commands, inputs, overrides, values, resets by hand.
    Operate,
    /// Everything, also the program store.
    Admin,
    /// A sequence program: claims, resets, tells progress and its presence, each in its own name only, and raises alarms.
    Handler,
}

impl Role {
    /// The roles and their words, as they stand in token files and on the command line.
    pub const ALL: [(&'static str, Role); 4] = [
        ("view", Role::View),
        ("operate", Role::Operate),
        ("admin", Role::Admin),
        ("handler", Role::Handler),
    ];

    /// The role of a word.
    pub fn of_word(word: &str) -> Option<Role> {
        let mut all = Self::ALL.iter();
        all.find(|(known, _)| *known == word).map(|(_, role)| *role)
    }

    /// The word of the role.
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

/// A user who was let in.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct User {
    /// Of the token; `None`: anyone on the loopback, where there is no token file.
    pub(crate) name: Option<String>,
    pub(crate) role: Role,
    /// The token of a user with a name.
    pub(crate) token: Option<TokenDigest>,
}

impl User {
    /// Anyone on the loopback, where there is no token file.
    pub(crate) fn anyone() -> Self {
        Self {
            name: None,
            role: Role::Admin,
            token: None,
        }
    }

    /// Someone whose token was not asked for.
    pub(crate) fn stranger() -> Self {
        Self {
            name: None,
            role: Role::View,
            token: None,
        }
    }

    /// Why this user may not speak as this handler, if so: a handler's token speaks in its own name only.
    pub(crate) fn speaks_as(&self, handler_id: &str) -> Result<(), String> {
        match &self.name {
            Some(name) if self.role == Role::Handler && name != handler_id => Err(format!(
                "the token of {name} has role handler: it speaks as handler_id {name} only"
            )),
            _ => Ok(()),
        }
    }

    /// Why this user may not reset as this handler, if so. By force is an operator's way.
    pub(crate) fn resets_as(&self, handler_id: &str, force: bool) -> Result<(), String> {
        if force && !self.role.has(Right::Operate) {
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
        let user = |name: &str, role| User {
            name: Some(name.to_owned()),
            role,
            token: None,
        };
        let handler = user("magazine", Role::Handler);
        assert!(handler.speaks_as("magazine").is_ok());
        assert!(handler.speaks_as("other").is_err());
        assert!(handler.resets_as("magazine", false).is_ok());
        assert!(handler.resets_as("magazine", true).is_err());
        assert!(user("hmi-1", Role::Operate).resets_as("hmi", true).is_ok());
        assert!(User::anyone().resets_as("hmi", true).is_ok());
    }
}
