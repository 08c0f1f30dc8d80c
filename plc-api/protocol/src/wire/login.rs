//! Login: the request of a person, and the answer.

use serde::{Deserialize, Serialize};

/// Credentials of a person.
#[derive(Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LoginRequest {
    /// Name of an entry `[[person]]` of the token file.
    pub user: String,
    /// PIN of the person.
    pub pin: String,
}

/// The current user and the user's role.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CurrentUser {
    /// Name of the user; null if the machine does not require users to identify themselves.
    pub user: Option<String>,
    /// Role of the user: `view`, `operate`, `handler` or `admin`.
    pub role: &'static str,
    /// True for the token of a login; `DELETE /login` ends the validity of such a token.
    pub is_login: bool,
}

/// A token of a login, with limited validity.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Login {
    /// The token; the client sends it with each request, like any token.
    pub token: String,
    /// Name of the user.
    pub user: String,
    /// Role of the user: `view`, `operate`, `handler` or `admin`.
    pub role: &'static str,
    /// Validity of the token, s.
    pub expires_s: u64,
}
