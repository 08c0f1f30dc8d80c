//! Login: the request of a person, and the answer.

use serde::{Deserialize, Serialize};

/// Who wants to be let in.
#[derive(Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LoginRequest {
    /// Name of an entry `[[person]]` of the token file.
    pub user: String,
    /// Its PIN.
    pub pin: String,
}

/// Who asks, and what the asker may do.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CurrentUser {
    /// Name of the user; null: the machine asks nobody who it is.
    pub user: Option<String>,
    /// What the user may do: `view`, `operate`, `handler` or `admin`.
    pub role: &'static str,
    /// True for the token of a login, which `DELETE /login` ends.
    pub is_login: bool,
}

/// A token for some hours.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Login {
    /// Sent with each request, as any token.
    pub token: String,
    /// Name of the user.
    pub user: String,
    /// What the user may do: `view`, `operate`, `handler` or `admin`.
    pub role: &'static str,
    /// Seconds for which it counts.
    pub expires_s: u64,
}
