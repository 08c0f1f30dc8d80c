//! The account to which limits are applied.

use std::net::IpAddr;

use super::User;
use crate::connection_slots::host_of;

/// Owner of requests that share one limit: a user, or without users a host.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(crate) enum Account {
    /// A user of the token file.
    User(String),
    /// A host, for requests without a user; `None` if the server does not know it.
    Host(Option<IpAddr>),
}

impl Account {
    /// Returns the account of a user's request from a host.
    pub(crate) fn new(user: &User, from: Option<IpAddr>) -> Self {
        Self::named(user.name(), from)
    }

    /// Returns the account of the user with this name; without a name, that of the host.
    pub(crate) fn named(user: Option<&str>, from: Option<IpAddr>) -> Self {
        match user {
            Some(name) => Self::User(name.to_owned()),
            None => Self::Host(from.map(host_of)),
        }
    }
}
