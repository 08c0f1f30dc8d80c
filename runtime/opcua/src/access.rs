//! Access: the server passes a client's user name and token to the machine, which authorizes the client.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use async_trait::async_trait;
use opcua::server::ServerEndpoint;
use opcua::server::authenticator::{
    AuthManager, Password, UserToken, user_pass_security_policy_id, user_pass_security_policy_uri,
};
use opcua::types::{Error, StatusCode, UAString, UserTokenPolicy, UserTokenType};
use parking_lot::Mutex;
use plc_api::{MqttOptions, Plc, TlsFiles};

/// Largest number of logged-in users. The user that was idle for the longest time is removed and has to log in again.
/// Reason: each user has a connection to the machine.
const USERS_MAX: usize = 100;

/// Time limit of a login at the machine. Reason: clients wait for 4 s or more.
pub const LOGIN_TIMEOUT: Duration = Duration::from_secs(3);

/// Address and TLS files of the machine.
#[derive(Debug, Clone)]
pub struct Machine {
    /// `mqtt://...` or `http://...`, without user and token.
    pub address: String,
    pub tls: TlsFiles,
}

impl Machine {
    /// Connects as a user.
    ///
    /// # Errors
    /// Fails if the machine cannot be reached, or rejects the user.
    pub async fn connect(&self, user: Option<(&str, &str)>) -> plc_api::Result<Plc> {
        let options = MqttOptions {
            username: user.map(|(name, _)| name.to_owned()),
            password: user.map(|(_, token)| token.to_owned()),
            tls: self.tls.clone(),
            ..MqttOptions::default()
        };
        Plc::connect_with(&self.address, options).await
    }
}

/// Users of this server.
pub struct Access {
    machine: Machine,
    /// True if clients without a user may read.
    is_anonymous_allowed: bool,
    users: Mutex<Users>,
}

#[derive(Default)]
struct Users {
    /// Users by session token.
    known: BTreeMap<String, User>,
    /// Number of logins so far.
    count: u64,
}

struct User {
    name: String,
    token: String,
    plc: Plc,
    used: Instant,
}

impl Access {
    pub fn new(machine: Machine, is_anonymous_allowed: bool) -> Self {
        Self {
            machine,
            is_anonymous_allowed,
            users: Mutex::default(),
        }
    }

    /// Returns the machine on behalf of the user of a session; `None` for anonymous clients and removed users.
    pub fn plc(&self, session: &UserToken) -> Option<Plc> {
        let mut users = self.users.lock();
        let user = users.known.get_mut(&session.0)?;
        user.used = Instant::now();
        Some(user.plc.clone())
    }

    fn find_user(&self, name: &str, token: &str) -> Option<UserToken> {
        let mut users = self.users.lock();
        let mut all = users.known.iter_mut();
        let (id, user) = all.find(|(_, user)| user.name == name && user.token == token)?;
        user.used = Instant::now();
        Some(UserToken(id.clone()))
    }

    fn add_user(&self, name: &str, token: &str, plc: Plc) -> UserToken {
        let mut users = self.users.lock();
        if users.known.len() >= USERS_MAX {
            let idle = users.known.iter().min_by_key(|(_, user)| user.used);
            if let Some(id) = idle.map(|(id, _)| id.clone()) {
                users.known.remove(&id);
            }
        }
        users.count += 1;
        let id = format!("{name}#{}", users.count);
        let user = User {
            name: name.to_owned(),
            token: token.to_owned(),
            plc,
            used: Instant::now(),
        };
        users.known.insert(id.clone(), user);
        UserToken(id)
    }
}

#[async_trait]
impl AuthManager for Access {
    async fn authenticate_anonymous_token(&self, _: &ServerEndpoint) -> Result<(), Error> {
        if self.is_anonymous_allowed {
            return Ok(());
        }
        let why = "log in with a user name and a token of the machine";
        Err(Error::new(StatusCode::BadIdentityTokenRejected, why))
    }

    async fn authenticate_username_identity_token(
        &self,
        _: &ServerEndpoint,
        username: &str,
        password: &Password,
    ) -> Result<UserToken, Error> {
        let token = password.get();
        if let Some(known) = self.find_user(username, token) {
            return Ok(known);
        }
        let connecting = self.machine.connect(Some((username, token)));
        match tokio::time::timeout(LOGIN_TIMEOUT, connecting).await {
            Ok(Ok(plc)) => Ok(self.add_user(username, token, plc)),
            Ok(Err(error)) => {
                tracing::warn!(user = username, %error, "the machine rejects the user");
                Err(Error::new(StatusCode::BadIdentityTokenRejected, error))
            }
            Err(_) => {
                tracing::warn!(
                    user = username,
                    "the machine rejects the user, or does not answer"
                );
                let why = format!("the machine did not accept the user within {LOGIN_TIMEOUT:?}");
                Err(Error::new(StatusCode::BadIdentityTokenRejected, why))
            }
        }
    }

    fn user_token_policies(&self, endpoint: &ServerEndpoint) -> Vec<UserTokenPolicy> {
        let policy = |policy_id, token_type, security_policy_uri| UserTokenPolicy {
            policy_id,
            token_type,
            issued_token_type: UAString::null(),
            issuer_endpoint_url: UAString::null(),
            security_policy_uri,
        };
        let mut policies = vec![policy(
            user_pass_security_policy_id(endpoint),
            UserTokenType::UserName,
            user_pass_security_policy_uri(endpoint),
        )];
        if self.is_anonymous_allowed {
            policies.push(policy(
                UAString::from("anonymous"),
                UserTokenType::Anonymous,
                UAString::null(),
            ));
        }
        policies
    }
}
