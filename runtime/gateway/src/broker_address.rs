//! What an MQTT connection needs of its broker, embedded or external.

use crate::error::GatewayError;
use crate::settings::MqttSettings;

/// A message that the embedded broker refused: its topic and payload.
pub(crate) type Refused = (String, Vec<u8>);

/// Address of a broker, and credentials of the runtime.
pub(crate) struct BrokerAddress {
    pub(crate) host: String,
    pub(crate) port: u16,
    /// User and password.
    pub(crate) credentials: Option<(String, String)>,
    /// TCP, or TLS.
    pub(crate) transport: rumqttc::Transport,
}

impl BrokerAddress {
    /// The broker of the settings.
    pub(crate) fn of_settings(settings: &MqttSettings) -> Result<Self, GatewayError> {
        let user = settings.username.clone();
        Ok(Self {
            host: settings.host.clone(),
            port: settings.port,
            credentials: user.map(|user| (user, settings.password.clone().unwrap_or_default())),
            transport: settings.transport()?,
        })
    }
}
