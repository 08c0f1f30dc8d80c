//! Options of a connection.

use std::time::Duration;

use super::tls::TlsFiles;

/// Options that are not in an address, or should not be, since others may see a command line.
#[derive(Clone)]
pub struct MqttOptions {
    /// User name; takes precedence over one in the address.
    pub username: Option<String>,
    /// The user's password: its token.
    pub password: Option<String>,
    /// For `mqtts://` and `https://`: certificates and key.
    pub tls: TlsFiles,
    /// Over MQTT the machine takes handlers for lost when it has not heard this program for so long, 300 ms to 1 h; it is told
    /// at a third of it. Default: 15 s.
    pub presence_expires: Duration,
}

impl Default for MqttOptions {
    fn default() -> Self {
        Self {
            username: None,
            password: None,
            tls: TlsFiles::default(),
            presence_expires: Duration::from_secs(15),
        }
    }
}

impl std::fmt::Debug for MqttOptions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("MqttOptions")
            .field("username", &self.username)
            .field("password", &self.password.as_ref().map(|_| "hidden"))
            .field("tls", &self.tls)
            .field("presence_expires", &self.presence_expires)
            .finish()
    }
}
