//! Options of a connection.

use std::time::Duration;

use super::tls::TlsFiles;

/// Options of a connection that an address cannot contain, or should not contain because other users can see
/// the command line.
#[derive(Clone)]
pub struct MqttOptions {
    /// User name; takes precedence over the user name in the address.
    pub username: Option<String>,
    /// Password of the user, which is the token.
    pub password: Option<String>,
    /// Certificates and key, for `mqtts://` and `https://`.
    pub tls: TlsFiles,
    /// Validity of the presence over MQTT, 300 ms to 1 h. If the machine receives no presence of this program
    /// for this time, the machine treats the handlers as lost. The program publishes its presence three times
    /// within this time. Default: 15 s.
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
