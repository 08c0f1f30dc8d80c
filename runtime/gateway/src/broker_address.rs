//! Where a broker is, embedded or not, and what its clients and the runtime's own end hand to each other.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

use crate::settings::MqttSettings;

/// A message that the embedded broker refused: its topic and payload.
pub(crate) type Refused = (String, Vec<u8>);

/// Where a broker is, and how the runtime comes in.
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
    pub(crate) fn of_settings(settings: &MqttSettings, transport: rumqttc::Transport) -> Self {
        Self {
            host: settings.host.clone(),
            port: settings.port,
            credentials: settings
                .username
                .clone()
                .map(|user| (user, settings.password.clone().unwrap_or_default())),
            transport,
        }
    }
}

/// A broker that listens on every address is on the loopback, too.
pub(crate) fn reachable(address: IpAddr) -> IpAddr {
    match address {
        IpAddr::V4(v4) if v4.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
        IpAddr::V6(v6) if v6.is_unspecified() => Ipv6Addr::LOCALHOST.into(),
        address => address,
    }
}
