//! Options of a connection.

use super::tls::TlsFiles;

/// Options that are not in an address, or should not be, since others may see a command line.
#[derive(Clone, Default)]
pub struct MqttOptions {
    /// User name; takes precedence over one in the address.
    pub username: Option<String>,
    /// The user's password: its token.
    pub password: Option<String>,
    /// For `mqtts://` and `https://`: certificates and key.
    pub tls: TlsFiles,
}

impl std::fmt::Debug for MqttOptions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("MqttOptions")
            .field("username", &self.username)
            .field("password", &self.password.as_ref().map(|_| "hidden"))
            .field("tls", &self.tls)
            .finish()
    }
}
