//! Settings of the server ends. The runtime fills them from its configuration file.

/// Settings of all server ends of one machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GatewaySettings {
    /// Machine name: the level of MQTT topics below `{prefix}/tandem/v1/`. 1 to 64 letters, digits, `-`, `_` or `.`.
    pub machine: String,
    /// `[http] listen`: address and port of REST, WebSocket and HMI. Port 0 takes any free port.
    pub http_listen: String,
    /// `[mqtt]`: the broker, embedded or external.
    pub mqtt: MqttSettings,
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
    /// User at the external broker.
    pub username: Option<String>,
    /// Password at the external broker; never shown in a log.
    pub password: Option<String>,
    /// Client id at the broker; empty: `tandem-{machine}`.
    pub client_id: String,
    /// Levels before `tandem/v1/{machine}`; empty: none. At most 128 characters without `+`, `#`.
    pub prefix: String,
}

impl Default for GatewaySettings {
    /// The demo machine on the loopback.
    fn default() -> Self {
        Self {
            machine: "demo".to_owned(),
            http_listen: "127.0.0.1:8080".to_owned(),
            mqtt: MqttSettings::default(),
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
            .field("username", &self.username)
            .field("password", &self.password.as_ref().map(|_| "hidden"))
            .field("client_id", &self.client_id)
            .field("prefix", &self.prefix)
            .finish()
    }
}
