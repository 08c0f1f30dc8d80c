//! The address of an external broker, with credentials and TLS.

use crate::error::GatewayError;
use crate::settings::MqttSettings;

/// A message that the embedded broker refused: its topic and payload.
pub(crate) type RefusedMessage = (String, Vec<u8>);

/// Addresses of a broker, and credentials of the runtime.
pub(crate) struct BrokerAddress {
    /// Host and port of each of its nodes; at least one.
    pub(crate) nodes: Vec<(String, u16)>,
    /// User and password.
    pub(crate) credentials: Option<(String, String)>,
    /// TCP, or TLS.
    pub(crate) transport: rumqttc::Transport,
}

impl BrokerAddress {
    /// Returns the broker of the settings.
    pub(crate) fn of_settings(settings: &MqttSettings) -> Result<Self, GatewayError> {
        let user = settings.username.clone();
        Ok(Self {
            nodes: settings.brokers.clone(),
            credentials: user.map(|user| (user, settings.password.clone().unwrap_or_default())),
            transport: settings.transport()?,
        })
    }
}
