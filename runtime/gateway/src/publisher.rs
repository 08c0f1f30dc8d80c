//! The publisher of a message over MQTT.

use std::net::IpAddr;

use crate::access::User;

/// The publisher of a message.
#[derive(Debug)]
pub(crate) enum Publisher {
    User {
        user: User,
        from: Option<IpAddr>,
        client_id: Option<String>,
    },
    /// A name whose token is no longer valid, or a publisher that the broker does not name.
    Unknown { name: String, client_id: Option<String> },
}

impl Publisher {
    /// Returns the publisher with this name and MQTT client id; `user` is `None` if the name is unknown.
    pub(crate) fn new(
        user: Option<User>,
        name: Option<&str>,
        from: Option<IpAddr>,
        client_id: Option<String>,
    ) -> Self {
        match user {
            Some(user) => Publisher::User {
                user,
                from,
                client_id,
            },
            None => Publisher::Unknown {
                name: name.unwrap_or_default().to_owned(),
                client_id,
            },
        }
    }

    /// Its MQTT client id, where the embedded broker gives it.
    pub(crate) fn client_id(&self) -> Option<&str> {
        match self {
            Publisher::User { client_id, .. } | Publisher::Unknown { client_id, .. } => client_id.as_deref(),
        }
    }
}
