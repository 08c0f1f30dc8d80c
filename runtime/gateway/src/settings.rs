//! Settings of the gateway's servers, read by the runtime from its configuration file.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use plc_protocol::supervisor::Supervisor;
use plc_protocol::transport::mqtt::mqtt_over;
use plc_protocol::transport::tls::TlsFiles;
use plc_protocol::wire::hmi::Hmi;
use rumqttc::Transport;
use tandem_mtconnect::Version as MtconnectVersion;
use tokio::net::{TcpListener, TcpSocket};

use crate::access::{LiveTokens, Tokens};
use crate::error::GatewayError;
use crate::exposed_settings::{folder_problem, is_origin};
use crate::tls::{LiveTls, ServerTls};

/// Settings of all servers of one machine.
#[derive(Debug, Clone, PartialEq)]
pub struct GatewaySettings {
    /// Machine name: the level of MQTT topics below `{prefix}/tandem/v1/`. 1 to 32 of `a`-`z`, `0`-`9`, `-`.
    pub machine: String,
    /// `[http] listen`: address and port of REST, WebSocket and HMI. Port 0 takes any free port.
    pub http_listen: String,
    /// `[tls]`: TLS of HTTP, WebSocket and the embedded broker. `None` disables TLS.
    pub tls: Option<ServerTls>,
    /// `[mqtt]`: the broker, embedded or external.
    pub mqtt: MqttSettings,
    /// `[http] token_file`: the users of HTTP and of the embedded broker. If it is `None`, every client on the loopback
    /// has all rights, and the servers listen on the loopback only.
    pub tokens: Option<Arc<Tokens>>,
    /// `[mtconnect]`. `None` disables MTConnect.
    pub mtconnect: Option<MtconnectSettings>,
    /// `[http] login_idle_s`: a login ends after this time without activity. If it is `None`, only the limit of 12 h
    /// applies.
    pub login_idle: Option<Duration>,
    /// `[http] allow_origins`: origins whose pages may use HTTP and WebSocket, in addition to its own; they need
    /// tokens. At most 16.
    pub allow_origins: Vec<String>,
    /// `[http] public_url`: origin under which clients reach the HMI. `None` if it is not configured.
    pub public_url: Option<String>,
    /// `[hmi]`: the machine builder's additions to the HMI.
    pub hmi: HmiSettings,
    /// Shortest time between two positions of one coordinate system on MQTT and on a WebSocket, ms. 20 to 10 000.
    pub position_interval_ms: u64,
}

/// Settings of MTConnect.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct MtconnectSettings {
    /// `[mtconnect] version`: version of the documents.
    pub version: MtconnectVersion,
    /// `[mtconnect] emergency_stop`: name of the input that is on while the emergency stop is not pressed. `None` if
    /// there is no such input.
    pub emergency_stop: Option<String>,
    /// `[mtconnect] shdr_listen`: address and port of the adapter, on the loopback. Port 0 takes any free port. `None`
    /// disables the adapter.
    pub shdr_listen: Option<String>,
}

/// The machine builder's additions to the HMI.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HmiSettings {
    /// `[hmi] dir`: folder that is served below `/hmi/`. `None` if no folder is served.
    pub dir: Option<PathBuf>,
    /// `[hmi] machines`: origins of further machines on one page, at most 31.
    pub machines: Vec<String>,
    /// Files and folders that must lie neither inside `dir` nor in a folder that contains it.
    pub secrets: Vec<PathBuf>,
    /// `[hmi] stop_without_login`: every client that reaches the HMI may hold, stop and abort.
    pub stop_without_login: bool,
    /// `[[hmi.button]]` and `[[hmi.card]]`.
    pub added: Hmi,
}

/// Settings of MQTT.
#[derive(Clone, PartialEq, Eq)]
pub struct MqttSettings {
    /// `[mqtt] listen`: address and port of the embedded broker. Port 0 takes any free port. `None` if the broker is
    /// external.
    pub embedded_listen: Option<String>,
    /// `[mqtt] websocket`: the embedded broker also serves MQTT over WebSocket, at `/mqtt` of HTTP. It needs tokens.
    pub websocket: bool,
    /// `[mqtt] accept_unverified_senders`: with an external broker, accepts requests on topics that do not name their
    /// senders. Any client that may publish there can then write any sender into the payload.
    pub accept_unverified_senders: bool,
    /// Host (name or address) and port of each external broker, or of each node of one cluster. The first that answers
    /// is used until its connection is lost.
    pub brokers: Vec<(String, u16)>,
    /// TLS to the external broker. `None` disables TLS.
    pub tls: Option<TlsFiles>,
    /// User at the external broker.
    pub username: Option<String>,
    /// Password at the external broker; never logged.
    pub password: Option<String>,
    /// Client id at the broker; empty: `tandem-{machine}`, with the prefix before the machine.
    pub client_id: String,
    /// Levels before `tandem/v1/{machine}`, such as `plant/hall-1`; empty: none. At most 128 bytes, no level empty, no
    /// `+`, `#` or control character, no `$` at the beginning.
    pub prefix: String,
}

impl Default for GatewaySettings {
    /// Returns the demo machine on the loopback.
    fn default() -> Self {
        Self {
            machine: "mill-1".to_owned(),
            http_listen: "127.0.0.1:8080".to_owned(),
            tls: None,
            mqtt: MqttSettings::default(),
            tokens: None,
            mtconnect: None,
            login_idle: Some(Duration::from_hours(1)),
            allow_origins: Vec::new(),
            public_url: None,
            hmi: HmiSettings::default(),
            position_interval_ms: 100,
        }
    }
}

impl Default for MqttSettings {
    /// Returns the embedded broker on the loopback.
    fn default() -> Self {
        Self {
            embedded_listen: Some("127.0.0.1:1883".to_owned()),
            websocket: false,
            accept_unverified_senders: false,
            brokers: vec![("127.0.0.1".to_owned(), 1883)],
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
            .field("websocket", &self.websocket)
            .field("accept_unverified_senders", &self.accept_unverified_senders)
            .field("brokers", &self.brokers)
            .field("tls", &self.tls)
            .field("username", &self.username)
            .field("password", &self.password.as_ref().map(|_| "hidden"))
            .field("client_id", &self.client_id)
            .field("prefix", &self.prefix)
            .finish()
    }
}

/// Name of the setting of the address of HTTP, for messages.
pub const HTTP_LISTEN: &str = "[http] listen";
/// Name of the setting of the address of the embedded broker, for messages.
pub const MQTT_LISTEN: &str = "[mqtt] listen";
/// Name of the setting of the address of the SHDR adapter, for messages.
pub(crate) const SHDR_LISTEN: &str = "[mtconnect] shdr_listen";

/// Largest number of allowed foreign origins. Reason: each request is compared with them.
pub const ORIGINS_MAX: usize = 16;

/// Largest number of addresses of further machines. Reason: the page connects to each of them; with this machine they
/// are 32.
pub const MACHINES_MAX: usize = 31;

/// Reason for rejecting a setting that opens the server to other computers.
const NEEDS_USERS: &str =
    "this needs users; create tokens with tandem token and name their file in [http] token_file";

impl GatewaySettings {
    /// Returns all problems of these settings that can be found without opening a port: values, addresses, and the TLS
    /// files, which are read. Empty if there is none.
    pub fn problems(&self) -> Vec<GatewayError> {
        let mut problems: Vec<_> = self.check_values().err().into_iter().collect();
        let (http, mqtt) = (self.http_address(), self.mqtt_address());
        if let (Ok(http), Ok(Some(mqtt))) = (&http, &mqtt)
            && share_a_port(*http, *mqtt)
        {
            problems.push(GatewayError::Setting {
                setting: MQTT_LISTEN,
                value: mqtt.to_string(),
                text: format!("{HTTP_LISTEN} = \"{http}\" uses this port; write another port"),
            });
        }
        problems.extend(http.err());
        problems.extend(mqtt.err());
        problems.extend(self.mqtt.transport().err());
        problems.extend(self.shdr_address().err());
        problems.extend(self.origin_problem());
        problems.extend(self.machines_problem());
        problems.extend(self.websocket_problem());
        let wrong_dir = self.hmi.dir.as_ref().and_then(|dir| {
            let text = folder_problem(dir, &self.hmi.secrets)?;
            let value = dir.display().to_string();
            Some(GatewayError::Setting {
                setting: "[hmi] dir",
                value,
                text,
            })
        });
        problems.extend(wrong_dir);
        let tls = self.tls.as_ref().map(ServerTls::check);
        problems.extend(tls.and_then(Result::err).map(GatewayError::ServerTls));
        problems
    }

    /// Returns the error in the settings of MQTT over WebSocket.
    fn websocket_problem(&self) -> Option<GatewayError> {
        let text = match (self.mqtt.websocket, &self.mqtt.embedded_listen, &self.tokens) {
            (true, None, _) => "this is for broker = \"embedded\"; an external broker has its own".to_owned(),
            (true, Some(_), None) => {
                format!("{NEEDS_USERS}: without users, a page in a browser would have all rights")
            }
            _ => return None,
        };
        Some(GatewayError::Setting {
            setting: "[mqtt] websocket",
            value: "true".to_owned(),
            text,
        })
    }

    /// Returns the error in the allowed foreign origins.
    fn origin_problem(&self) -> Option<GatewayError> {
        let wrong = |value: &str, text: String| {
            Some(GatewayError::Setting {
                setting: "[http] allow_origins",
                value: value.to_owned(),
                text,
            })
        };
        let first = self.allow_origins.first()?;
        if self.tokens.is_none() {
            return wrong(
                first,
                format!("{NEEDS_USERS}: without users, pages of other origins would have all rights"),
            );
        }
        if self.allow_origins.len() > ORIGINS_MAX {
            return wrong(first, format!("at most {ORIGINS_MAX} origins are allowed"));
        }
        let other = self.allow_origins.iter().find(|origin| !is_origin(origin))?;
        let text = "write an origin as browsers do, such as https://hmi.example.com or \
                    http://localhost:5173; wildcards are not supported";
        wrong(other, text.to_owned())
    }

    /// Returns the error in the addresses of this machine and of further machines.
    fn machines_problem(&self) -> Option<GatewayError> {
        let wrong = |setting, value: &str, text: String| {
            Some(GatewayError::Setting {
                setting,
                value: value.to_owned(),
                text,
            })
        };
        let form = "write an address as browsers do, without a path, such as http://mill-2:8080";
        let machines = &self.hmi.machines;
        if let Some(own) = self.public_url.as_ref().filter(|url| !is_origin(url)) {
            return wrong("[http] public_url", own, form.to_owned());
        }
        if let Some(other) = machines.iter().find(|url| !is_origin(url)) {
            return wrong("[hmi] machines", other, form.to_owned());
        }
        let last = machines.get(MACHINES_MAX)?;
        wrong(
            "[hmi] machines",
            last,
            format!("at most {MACHINES_MAX} machines are shown in addition to this one"),
        )
    }

    /// Returns the shortest time between two published positions.
    pub(crate) fn position_interval(&self) -> Duration {
        Duration::from_millis(self.position_interval_ms)
    }

    /// Returns the address of HTTP.
    pub(crate) fn http_address(&self) -> Result<SocketAddr, GatewayError> {
        listen_address(HTTP_LISTEN, &self.http_listen, self.tokens.is_some())
    }

    /// Returns the address of the embedded broker, if there is one.
    pub(crate) fn mqtt_address(&self) -> Result<Option<SocketAddr>, GatewayError> {
        let listen = self.mqtt.embedded_listen.as_deref();
        listen
            .map(|listen| listen_address(MQTT_LISTEN, listen, self.tokens.is_some()))
            .transpose()
    }

    /// Returns the address of the SHDR adapter, if it is configured. SHDR has no users, so the adapter listens on the
    /// loopback only.
    pub(crate) fn shdr_address(&self) -> Result<Option<SocketAddr>, GatewayError> {
        let listen = self
            .mtconnect
            .as_ref()
            .and_then(|mtconnect| mtconnect.shdr_listen.as_deref());
        let address = listen
            .map(|listen| listen_address(SHDR_LISTEN, listen, true))
            .transpose()?;
        match address.filter(|address| !address.ip().is_loopback()) {
            None => Ok(address),
            Some(address) => Err(GatewayError::Setting {
                setting: SHDR_LISTEN,
                value: address.to_string(),
                text: "SHDR has no users; write 127.0.0.1 or [::1] with a port; run readers on this host"
                    .to_owned(),
            }),
        }
    }

    /// Returns the certificate of the listeners, which follows its files.
    pub(crate) fn live_tls(
        &self,
        tokens: Option<LiveTokens>,
        supervisor: &Supervisor,
    ) -> Result<Option<LiveTls>, GatewayError> {
        let tls = self
            .tls
            .clone()
            .map(|files| LiveTls::follow(files, tokens, supervisor));
        tls.transpose().map_err(GatewayError::ServerTls)
    }

    fn check_values(&self) -> Result<(), GatewayError> {
        let wrong = |setting, value: &str, text: &str| {
            Err(GatewayError::Setting {
                setting,
                value: value.to_owned(),
                text: text.to_owned(),
            })
        };
        if !is_machine_name(&self.machine) {
            return wrong(
                "[machine] name",
                &self.machine,
                "write 1 to 32 of a to z, 0 to 9 and -",
            );
        }
        let prefix = &self.mqtt.prefix;
        if !is_prefix(prefix) {
            return wrong(
                "[mqtt] prefix",
                prefix,
                "write topic levels such as plant/hall-1: at most 128 characters, no level empty, no + and #, no $ at the beginning",
            );
        }
        let brokers = &self.mqtt.brokers;
        let is_wrong = brokers.is_empty() || brokers.iter().any(|(host, port)| host.is_empty() || *port == 0);
        if self.mqtt.embedded_listen.is_none() && is_wrong {
            let hosts: Vec<&str> = brokers.iter().map(|(host, _)| host.as_str()).collect();
            return wrong("[mqtt] broker", &hosts.join(", "), "write mqtt://host:1883");
        }
        if !(20..=10_000).contains(&self.position_interval_ms) {
            let value = self.position_interval_ms.to_string();
            return wrong("position interval, ms", &value, "write 20 to 10000");
        }
        Ok(())
    }
}

impl MqttSettings {
    /// Returns the transport to the external broker: TCP or TLS.
    pub(crate) fn transport(&self) -> Result<Transport, GatewayError> {
        let tls = self.tls.as_ref().map(TlsFiles::client_config).transpose();
        let tls = tls.map_err(GatewayError::Tls)?;
        Ok(tls.map_or_else(Transport::tcp, mqtt_over))
    }

    /// Returns the root of all topics of a machine, with its last slash.
    pub fn root(&self, machine: &str) -> String {
        format!("{}{machine}/", self.base())
    }

    /// Returns the part of a topic before the machine name.
    pub(crate) fn base(&self) -> String {
        match self.prefix.as_str() {
            "" => "tandem/v1/".to_owned(),
            prefix => format!("{prefix}/tandem/v1/"),
        }
    }
}

/// Returns true if a machine may have this name.
pub(crate) fn is_machine_name(name: &str) -> bool {
    let allowed = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
    (1..=32).contains(&name.len()) && name.chars().all(allowed)
}

/// Returns true if this is empty or made of topic levels that every broker accepts: topics that begin with `$` are
/// reserved.
fn is_prefix(prefix: &str) -> bool {
    let is_level = |level: &str| {
        !level.is_empty() && !level.contains(|c: char| ['+', '#'].contains(&c) || c.is_control())
    };
    prefix.is_empty() || prefix.len() <= 128 && !prefix.starts_with('$') && prefix.split('/').all(is_level)
}

/// Returns true if two listeners need the same port.
fn share_a_port(one: SocketAddr, other: SocketAddr) -> bool {
    let overlap = one.ip() == other.ip() || one.ip().is_unspecified() || other.ip().is_unspecified();
    overlap && one.port() == other.port() && one.port() != 0
}

/// Returns the address of a listen setting, which must be on the loopback where there are no tokens.
fn listen_address(setting: &'static str, value: &str, has_tokens: bool) -> Result<SocketAddr, GatewayError> {
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

/// Connections that the system queues until they are accepted. Reason: if the queue is full, the client retries only
/// after a second.
const BACKLOG: u32 = 4096;

/// Listens on the address of a setting.
pub(crate) fn bind(setting: &'static str, address: SocketAddr) -> Result<TcpListener, GatewayError> {
    let listen = || {
        let socket = match address {
            SocketAddr::V4(_) => TcpSocket::new_v4(),
            SocketAddr::V6(_) => TcpSocket::new_v6(),
        }?;
        // so that a restarted runtime need not wait until the system has forgotten the previous connections
        socket.set_reuseaddr(true)?;
        socket.bind(address)?;
        socket.listen(BACKLOG)
    };
    listen().map_err(|source| match source.kind() {
        std::io::ErrorKind::AddrInUse => GatewayError::PortTaken { setting, address },
        _ => GatewayError::Listen {
            setting,
            address,
            source,
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tokens() -> Arc<Tokens> {
        let file = tempfile::NamedTempFile::new().unwrap();
        let new = crate::new_token("screen", crate::Role::Operate, None).unwrap();
        std::fs::write(file.path(), new.entry).unwrap();
        Arc::new(Tokens::read(file.path()).unwrap())
    }

    #[test]
    fn without_tokens_only_loopback_is_allowed_and_refusal_names_the_setting() {
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
    fn origins_of_others_need_users_and_are_origins() {
        let told = |origins: &[&str], has_tokens: bool| {
            let settings = GatewaySettings {
                allow_origins: origins.iter().map(|origin| (*origin).to_owned()).collect(),
                tokens: has_tokens.then(tokens),
                ..GatewaySettings::default()
            };
            settings
                .problems()
                .iter()
                .map(ToString::to_string)
                .collect::<String>()
        };
        let origin = "https://hmi.example.com";
        assert_eq!(told(&[origin], true), "");
        let refused = told(&[origin], false);
        assert!(
            refused.contains("[http] allow_origins") && refused.contains("token_file"),
            "{refused}"
        );
        for wrong in ["*", "null", "hmi.example.com", "https://hmi.example.com/"] {
            let refused = told(&[origin, wrong], true);
            assert!(refused.contains(&format!("\"{wrong}\"")), "{refused}");
        }
        assert_eq!(told(&[origin; ORIGINS_MAX], true), "");
        assert!(told(&[origin; ORIGINS_MAX + 1], true).contains("at most 16"));
    }

    #[test]
    fn mqtt_over_websocket_needs_users_and_the_embedded_broker() {
        let mut settings = GatewaySettings::default();
        settings.mqtt.websocket = true;
        let refused = settings.problems()[0].to_string();
        assert!(
            refused.contains("[mqtt] websocket") && refused.contains("token_file"),
            "{refused}"
        );
        settings.tokens = Some(tokens());
        assert!(settings.problems().is_empty());
        settings.mqtt.embedded_listen = None;
        assert!(settings.problems()[0].to_string().contains("embedded"));
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
        settings.prefix = "plant/a".into();
        assert_eq!(settings.root("m"), "plant/a/tandem/v1/m/");
    }

    #[test]
    fn a_machine_name_that_is_no_topic_level_is_refused() {
        for name in ["", "Mill", "a/b", "a+", &"x".repeat(33)] {
            let settings = GatewaySettings {
                machine: name.into(),
                ..GatewaySettings::default()
            };
            assert_eq!(settings.problems().len(), 1, "{name}");
        }
        assert!(GatewaySettings::default().problems().is_empty());
    }

    #[test]
    fn a_prefix_is_levels_that_every_broker_takes() {
        let problems = |prefix: &str| {
            let mut settings = GatewaySettings::default();
            settings.mqtt.prefix = prefix.into();
            settings.problems().len()
        };
        for prefix in ["", "plant", "plant/hall-1", "a/$b", &"x".repeat(128)] {
            assert_eq!(problems(prefix), 0, "{prefix}");
        }
        for prefix in [
            "a/#",
            "+",
            "a//b",
            "a/",
            "/a",
            "/",
            "$SYS",
            "a\0b",
            &"x".repeat(129),
        ] {
            assert_eq!(problems(prefix), 1, "{prefix}");
        }
    }

    #[test]
    fn two_listeners_need_two_ports_and_all_problems_are_told() {
        let told = |http: &str, mqtt: &str| {
            let mut settings = GatewaySettings {
                http_listen: http.into(),
                ..GatewaySettings::default()
            };
            settings.mqtt.embedded_listen = Some(mqtt.into());
            settings.problems().len()
        };
        assert_eq!(told("127.0.0.1:7", "127.0.0.1:7"), 1);
        assert_eq!(told("127.0.0.1:7", "[::1]:7"), 0);
        assert_eq!(told("127.0.0.1:0", "127.0.0.1:0"), 0);
        assert_eq!(told("here", "0.0.0.0:1883"), 2);
    }
}
