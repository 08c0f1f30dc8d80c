//! Access control: every request needs a [`Right`], a [`Role`] is a set of rights, and a token identifies a user
//! with a role. Without a token file every client on the loopback is `admin`.

mod account;
pub(crate) mod activity;
mod entries;
pub(crate) mod guard;
pub(crate) mod http;
mod live;
pub(crate) mod login;
mod login_budget;
mod mosquitto;
mod pin;
mod rate;
pub(crate) mod rules;
mod token;
mod tokens;
pub(crate) mod topics;
mod users;

use std::sync::Arc;

use plc_protocol::wire::message_sender::MessageSender;
use plc_protocol::wire::right::Right;
use serde::{Deserialize, Serialize};

pub(crate) use account::Account;
pub use entries::{NewToken, certificate_entry, new_token, pin_entry};
pub(crate) use live::LiveTokens;
pub(crate) use login::AuthenticatedUser;
pub use mosquitto::mosquitto_acl;
pub(crate) use rate::{Rate, Rates};
pub(crate) use token::Token;
pub use token::TokenError;
pub(crate) use tokens::Stamp;
pub use tokens::Tokens;
pub(crate) use users::{CloseReason, Users};

/// Rights of a user.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Reads everything, changes nothing.
    View,
    /// Operates the machine: commands, inputs, overrides, values, resets by hand.
    Operate,
    /// May do everything, including changes of the program store.
    Admin,
    /// A sequence program: claims, resets, reports progress and presence, in its own name only, raises alarms, sets its
    /// own sources of interlock and start lock, inputs and outputs of the plant, and tool, spindle and variables in a
    /// coordinate system in which it serves an M code.
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

    /// Returns the role with this name.
    pub fn of_name(name: &str) -> Option<Role> {
        let mut all = Self::ALL.iter();
        all.find(|(known, _)| *known == name).map(|(_, role)| *role)
    }

    /// Returns the name of the role.
    pub fn name(self) -> &'static str {
        let mut all = Self::ALL.iter();
        all.find(|(_, role)| *role == self).map_or("", |(name, _)| name)
    }

    pub(crate) fn has(self, right: Right) -> bool {
        match self {
            Role::View => right == Right::Read,
            Role::Operate => !matches!(right, Right::Handle | Right::Administrate),
            Role::Handler => !matches!(right, Right::Operate | Right::Administrate),
            Role::Admin => true,
        }
    }
}

/// The user of a request or a connection.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum User {
    /// Every client on the loopback, without a token file, and every client that an external broker admits: an admin.
    Anyone,
    /// Any client, on a route that needs no token.
    Unauthenticated,
    /// Any client that reaches the server, if the builder allows hold, stop and abort without a login; it may do only
    /// these.
    Unidentified,
    /// The owner of a token.
    Token(Arc<Token>),
}

impl User {
    /// Returns the sender that a topic names, with an external broker, whose access rules restrict publishing there. A
    /// handler has the rights of a handler, a client those of the topics on which it may publish.
    pub(crate) fn of_topic(speaker: MessageSender) -> Self {
        let (name, role) = match speaker {
            MessageSender::Handler(id) => (id, Role::Handler),
            MessageSender::Client(id) => (id, Role::Admin),
        };
        User::Token(Arc::new(Token::of_topic(name, role)))
    }

    pub(crate) fn name(&self) -> Option<&str> {
        match self {
            User::Token(token) => Some(&token.name),
            User::Anyone | User::Unauthenticated | User::Unidentified => None,
        }
    }

    pub(crate) fn role(&self) -> Role {
        match self {
            User::Anyone => Role::Admin,
            User::Unauthenticated | User::Unidentified => Role::View,
            User::Token(token) => token.role,
        }
    }

    pub(crate) fn has(&self, right: Right) -> bool {
        self.role().has(right)
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
            Right::Set,
            Right::SetInput,
            Right::Raise,
            Right::Administrate,
        ];
        let table = [
            (
                Role::View,
                [true, false, false, false, false, false, false, false],
            ),
            (Role::Operate, [true, true, false, true, true, true, true, false]),
            (Role::Handler, [true, false, true, true, true, true, true, false]),
            (Role::Admin, [true; 8]),
        ];
        for (role, expected) in table {
            assert_eq!(rights.map(|right| role.has(right)), expected, "{role:?}");
            assert_eq!(Role::of_name(role.name()), Some(role));
        }
    }
}
