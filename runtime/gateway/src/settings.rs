//! Settings of the server ends. The runtime fills them from its configuration file.

use std::net::SocketAddr;
use std::sync::Arc;

use plc_api::TlsFiles;

use crate::access::Tokens;
use crate::error::GatewayError;

/// Settings of all server ends of one machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GatewaySettings {
    /// Machine name: the level of MQTT topics below `{prefix}/tandem/v1/`. 1 to 32 of `a`-`z`, `0`-`9`, `-`.
    pub machine: String,
    /// `[http] listen`: address and port of REST, WebSocket and HMI. Port 0 takes any free port.
    pub http_listen: String,
    /// `[mqtt]`: the broker, embedded or external.
    pub mqtt: MqttSettings,
    /// `[http] token_file`: who may do what over HTTP and on the embedded broker. `None`: everyone on the loopback
    /// may do everything, and only the loopback may be listened on.
    pub tokens: Option<Arc<Tokens>>,
    /// Least time between two positions of one coordinate system on MQTT and on a WebSocket, ms. 20 to 10 000.
    pub position_interval_ms: u64,
}

/// Settings of the MQTT end.
#[derive(Clone, PartialEq, Eq)]
pub struct MqttSettings {
    /// `[mqtt] listen`: address and port of the embedded broker. Port 0 takes any free port. `None`: an external
    /// broker at `host` and `port`.
    pub embedded_listen: Option<String>,
    /// Host name or address of the external broker.
    pub host: String,
    /// Port of the external broker.
    pub port: u16,
    /// TLS to the external broker; `None`: without.
    pub tls: Option<TlsFiles>,
    /// User at the external broker.
    pub username: Option<String>,
    /// Password at the external broker; never shown in a log.
    pub password: Option<String>,
    /// Client id at the broker; empty: `tandem-{machine}`, with the prefix before the machine.
    pub client_id: String,
    /// Levels before `tandem/v1/{machine}`; empty: none. At most 128 characters without `+`, `#`.
    pub prefix: String,
}

impl Default for GatewaySettings {
    /// The demo machine on the loopback.
    fn default() -> Self {
        Self {
            machine: "mill-1".to_owned(),
            http_listen: "127.0.0.1:8080".to_owned(),
            mqtt: MqttSettings::default(),
            tokens: None,
            position_interval_ms: 100,
        }
    }
}

impl Default for MqttSettings {
    /// The embedded broker on the loopback.
    fn default() -> Self {
        Self {
            embedded_listen: Some("127.0.0.1:1883".to_owned()),
            host: "127.0.0.1".to_owned(),
            port: 1883,
            tls: None,
            username: None,
            password: None,
            client_id: String::new(),
            prefix: String::new(),
        }
    }
}

impl std::fmt::Debug for MqttSettings {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("MqttSettings")
            .field("embedded_listen", &self.embedded_listen)
            .field("host", &self.host)
            .field("port", &self.port)
            .field("tls", &self.tls)
            .field("username", &self.username)
            .field("password", &self.password.as_ref().map(|_| "hidden"))
            .field("client_id", &self.client_id)
            .field("prefix", &self.prefix)
            .finish()
    }
}

/// Names of the settings, for messages.
pub(crate) const HTTP_LISTEN: &str = "[http] listen";
pub(crate) const MQTT_LISTEN: &str = "[mqtt] listen";

impl GatewaySettings {
    /// Checks what can be checked without opening anything.
    pub(crate) fn check(&self) -> Result<(), GatewayError> {
        let machine_allowed = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        let wrong = |setting, value: &str, text: &str| {
            Err(GatewayError::Setting {
                setting,
                value: value.to_owned(),
                text: text.to_owned(),
            })
        };
        if !(1..=32).contains(&self.machine.len()) || !self.machine.chars().all(machine_allowed) {
            return wrong(
                "[machine] name",
                &self.machine,
                "write 1 to 32 of a to z, 0 to 9 and -",
            );
        }
        let prefix = &self.mqtt.prefix;
        if prefix.len() > 128 || prefix.contains(['+', '#', '\0']) {
            return wrong(
                "[mqtt] prefix",
                prefix,
                "write at most 128 characters without + and #",
            );
        }
        if self.mqtt.embedded_listen.is_none() && (self.mqtt.host.is_empty() || self.mqtt.port == 0) {
            return wrong("[mqtt] broker", &self.mqtt.host, "write mqtt://host:1883");
        }
        if !(20..=10_000).contains(&self.position_interval_ms) {
            let value = self.position_interval_ms.to_string();
            return wrong("position interval, ms", &value, "write 20 to 10000");
        }
        Ok(())
    }
}

impl MqttSettings {
    /// Root of all topics of a machine, with its last slash.
    pub fn root(&self, machine: &str) -> String {
        let prefix = self.prefix.trim_matches('/');
        if prefix.is_empty() {
            format!("tandem/v1/{machine}/")
        } else {
            format!("{prefix}/tandem/v1/{machine}/")
        }
    }
}

/// The address of a listen setting, which must be on the loopback where there are no tokens.
pub(crate) fn listen_address(
    setting: &'static str,
    value: &str,
    has_tokens: bool,
) -> Result<SocketAddr, GatewayError> {
    let with_name = value
        .strip_prefix("localhost:")
        .map(|port| format!("127.0.0.1:{port}"));
    let address: SocketAddr =
        with_name
            .as_deref()
            .unwrap_or(value)
            .parse()
            .map_err(|_| GatewayError::Setting {
                setting,
                value: value.to_owned(),
                text: "write an address and a port, such as 127.0.0.1:8080".to_owned(),
            })?;
    if has_tokens || address.ip().is_loopback() {
        Ok(address)
    } else {
        Err(GatewayError::NotLoopback { setting, address })
    }
}

/// What a failed `bind` means.
pub(crate) fn listen_error(
    setting: &'static str,
    address: SocketAddr,
    source: std::io::Error,
) -> GatewayError {
    if source.kind() == std::io::ErrorKind::AddrInUse {
        GatewayError::PortTaken { setting, address }
    } else {
        GatewayError::Listen {
            setting,
            address,
            source,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_tokens_only_the_loopback_may_be_listened_on_and_the_refusal_names_the_setting() {
        for address in ["127.0.0.1:8080", "[::1]:8080", "localhost:0"] {
            assert!(listen_address(HTTP_LISTEN, address, false).is_ok());
        }
        for address in ["0.0.0.0:8080", "192.168.1.7:80", "[::]:8080"] {
            let error = listen_address(HTTP_LISTEN, address, false).unwrap_err();
            let text = error.to_string();
            assert!(text.contains("[http] listen") && text.contains(address), "{text}");
            assert!(text.contains("token_file"), "{text}");
            assert!(listen_address(HTTP_LISTEN, address, true).is_ok());
        }
        let text = listen_address(MQTT_LISTEN, "here", true).unwrap_err().to_string();
        assert!(text.contains("[mqtt] listen") && text.contains("here"), "{text}");
    }

    #[test]
    fn a_password_is_not_shown() {
        let settings = MqttSettings {
            password: Some("s3cret".into()),
            ..MqttSettings::default()
        };
        assert!(!format!("{settings:?}").contains("s3cret"));
    }

    #[test]
    fn the_root_has_the_prefix_only_where_one_is_set() {
        let mut settings = MqttSettings::default();
        assert_eq!(settings.root("m"), "tandem/v1/m/");
        settings.prefix = "plant/a/".into();
        assert_eq!(settings.root("m"), "plant/a/tandem/v1/m/");
    }

    #[test]
    fn a_machine_name_that_is_no_topic_level_is_refused() {
        for name in ["", "Mill", "a/b", "a+", &"x".repeat(33)] {
            let settings = GatewaySettings {
                machine: name.into(),
                ..GatewaySettings::default()
            };
            assert!(settings.check().is_err(), "{name}");
        }
        assert!(GatewaySettings::default().check().is_ok());
    }
}
