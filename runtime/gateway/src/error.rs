//! Errors at the start of the server ends.

use std::net::SocketAddr;

/// Reason why the server ends cannot start. Each message names the setting to change.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GatewayError {
    /// Another program listens there.
    #[error(
        "{setting} = \"{address}\": the port is in use; stop the other program, or write another port in \
         {setting}"
    )]
    PortTaken {
        /// The setting, such as `[http] listen`.
        setting: &'static str,
        /// The address of the setting.
        address: SocketAddr,
    },
    /// The address can be reached from the network, and there are no tokens.
    #[error(
        "{setting} = \"{address}\" can be reached from the network, which needs users: create tokens with \
         tandem token and name their file in [http] token_file, or write 127.0.0.1 or [::1] with a port"
    )]
    NotLoopback {
        /// The setting.
        setting: &'static str,
        /// The address of the setting.
        address: SocketAddr,
    },
    /// A setting cannot be read.
    #[error("{setting} = \"{value}\": {text}")]
    Setting {
        /// The setting.
        setting: &'static str,
        /// Its value.
        value: String,
        /// The error, and how to correct it.
        text: String,
    },
    /// A TLS file cannot be used.
    #[error("[mqtt] {0}")]
    Tls(String),
    /// The certificate of the listeners cannot be used.
    #[error("{0}")]
    ServerTls(String),
    /// The operating system refuses to listen on the address.
    #[error("{setting} = \"{address}\": cannot listen on this address: {source}")]
    Listen {
        /// The setting.
        setting: &'static str,
        /// The address of the setting.
        address: SocketAddr,
        /// The system's error.
        source: std::io::Error,
    },
    /// The embedded broker does not start.
    #[error("the embedded MQTT broker ([mqtt] listen) cannot be started: {0}")]
    Broker(String),
}
