//! Address of a machine on a broker.

use crate::error::Error;

/// Default port of a broker.
const PORT_DEFAULT: u16 = 1883;

/// Default port of a broker with TLS.
const TLS_PORT_DEFAULT: u16 = 8883;

/// Largest number of nodes of one broker.
const NODES_MAX: usize = 16;

/// Parsed address `mqtt://[user[:password]@]host[:port][,host[:port]..]/[prefix/]machine`; `mqtts://` with
/// TLS.
#[derive(Clone, PartialEq, Eq)]
pub(super) struct MqttAddress {
    /// Host and port of each node of the broker; at least one.
    pub(super) nodes: Vec<(String, u16)>,
    pub(super) tls: bool,
    pub(super) credentials: Option<(String, String)>,
    /// Root of the machine's topics, without a slash at the end.
    pub(super) root: String,
    /// The given address, without user and password.
    pub(super) shown: String,
}

impl std::fmt::Debug for MqttAddress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.shown)
    }
}

impl MqttAddress {
    pub(super) fn parse(text: &str) -> Result<Self, Error> {
        let (scheme, rest) = text.split_once("://").unwrap_or(("mqtt", text));
        let tls = scheme == "mqtts";
        let (authority, path) = rest.split_once('/').unwrap_or((rest, ""));
        let with_user = authority.rsplit_once('@');
        let (user, host) = with_user.map_or((None, authority), |(user, host)| (Some(user), host));
        // hides all text before the last @, because this text may contain a password
        let after_user = rest.rsplit_once('@').map_or(rest, |(_, after)| after);
        let shown = format!("{scheme}://{after_user}");
        let wrong = |reason: String| Error::Address {
            address: shown.clone(),
            reason,
        };
        if rest.contains("://") {
            let reason = "mqtt:// stands once, before all hosts; write mqtt://host:port,host:port/machine";
            return Err(wrong(reason.to_owned()));
        }
        let port = if tls { TLS_PORT_DEFAULT } else { PORT_DEFAULT };
        let nodes = host.split(',').map(|node| host_and_port(node, port));
        let nodes: Vec<_> = nodes.collect::<Result<_, _>>().map_err(wrong)?;
        if nodes.len() > NODES_MAX {
            return Err(wrong(format!("it names more than {NODES_MAX} hosts")));
        }
        let (prefix, machine) = match path.rsplit_once('/') {
            Some((prefix, machine)) => (format!("{prefix}/"), machine),
            None => (String::new(), path),
        };
        if machine.is_empty() {
            let reason = "it names no machine; write mqtt://host:port/machine";
            return Err(wrong(reason.to_owned()));
        }
        if path.contains(['+', '#']) || path.starts_with('/') || path.contains("//") {
            return Err(wrong("topic levels are not empty and have no + or #".to_owned()));
        }
        let root = format!("{prefix}tandem/v1/{machine}");
        let credentials = user.map(|user| {
            let (user, password) = user.split_once(':').unwrap_or((user, ""));
            (percent_decoded(user), percent_decoded(password))
        });
        Ok(Self {
            nodes,
            tls,
            credentials,
            root,
            shown,
        })
    }
}

fn host_and_port(text: &str, default: u16) -> Result<(String, u16), String> {
    let (host, port) = match text.strip_prefix('[') {
        // an IPv6 address
        Some(rest) => {
            let (host, port) = rest
                .split_once(']')
                .ok_or("the ] of its IPv6 address is missing")?;
            (host, port.strip_prefix(':'))
        }
        None => text
            .split_once(':')
            .map_or((text, None), |(host, port)| (host, Some(port))),
    };
    if host.is_empty() {
        return Err("it names no host; write mqtt://host:port/machine".to_owned());
    }
    let port = match port {
        None => default,
        Some(port) => port.parse().map_err(|_| {
            "its port is not a number; / @ and : of a password are written %2F, %40 and %3A".to_owned()
        })?,
    };
    Ok((host.to_owned(), port))
}

/// Decodes percent-encoded characters, such as `%40` to `@`.
fn percent_decoded(text: &str) -> String {
    percent_encoding::percent_decode_str(text)
        .decode_utf8_lossy()
        .into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_names_broker_user_prefix_and_machine() {
        let address = MqttAddress::parse("mqtt://127.0.0.1:1884/mill-1").unwrap();
        assert_eq!(
            (address.nodes, address.root.as_str()),
            (vec![("127.0.0.1".to_owned(), 1884)], "tandem/v1/mill-1")
        );
        let address = MqttAddress::parse("mqtt://anna:p%40ss@broker/hall/3/mill-1").unwrap();
        assert_eq!(address.nodes, [("broker".to_owned(), 1883)]);
        assert_eq!(address.root, "hall/3/tandem/v1/mill-1");
        assert_eq!(address.credentials, Some(("anna".to_owned(), "p@ss".to_owned())));
        assert_eq!(
            MqttAddress::parse("mqtt://[::1]:1/m").unwrap().nodes,
            [("::1".to_owned(), 1)]
        );
        let address = MqttAddress::parse("mqtts://broker/m").unwrap();
        assert_eq!((address.tls, address.nodes[0].1), (true, 8883));
        assert_eq!(address.shown, "mqtts://broker/m");
    }

    #[test]
    fn an_address_names_several_nodes_of_one_broker() {
        let address = MqttAddress::parse("mqtt://anna:p@a,b:1884,[::1]/mill-1").unwrap();
        let node = |host: &str, port| (host.to_owned(), port);
        assert_eq!(
            address.nodes,
            [node("a", 1883), node("b", 1884), node("::1", 1883)]
        );
        assert_eq!(address.shown, "mqtt://a,b:1884,[::1]/mill-1");
        for wrong in ["mqtt://a,/m", "mqtt://a,b:x/m"] {
            assert!(MqttAddress::parse(wrong).is_err(), "{wrong}");
        }
        assert!(MqttAddress::parse(&format!("mqtt://{}a/m", "a,".repeat(16))).is_err());
        let error = MqttAddress::parse("mqtt://a,mqtt://b/m").unwrap_err().to_string();
        assert!(error.contains("stands once, before all hosts"), "{error}");
    }

    #[test]
    fn a_wrong_address_is_refused_without_showing_the_password() {
        for wrong in [
            "mqtt://host:1883",
            "mqtt://:1883/m",
            "mqtt://h:x/m",
            "mqtt://h/a/#/m",
            "mqtt://u:secret@h//m",
            "mqtt://[::1/m",
            "mqtt://u:secret/@h/m",
            "mqtt://h,mqtt://u:secret@i/m",
        ] {
            let error = MqttAddress::parse(wrong).unwrap_err().to_string();
            assert!(!error.contains("secret"), "{error}");
        }
    }
}
