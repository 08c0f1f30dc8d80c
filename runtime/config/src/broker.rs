//! `[mqtt] broker`: the addresses of an external broker.

use std::fmt;
use std::net::Ipv6Addr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Value of the key for the embedded broker.
const EMBEDDED: &str = "embedded";

/// Maximum number of addresses of one broker.
const NODES_MAX: usize = 16;

/// Port of a broker if the address contains none.
const PORT_DEFAULT: u16 = 1883;

/// Port of a broker with TLS if the address contains none.
const TLS_PORT_DEFAULT: u16 = 8883;

/// Address of an external broker: `mqtt://host:1883`, or with TLS `mqtts://host:8883`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExternalBroker {
    /// True if the connection uses TLS.
    pub tls: bool,
    /// Name or address of the host; an IPv6 address is stored without brackets.
    pub host: String,
    /// Port of the broker, 1 to 65535.
    pub port: u16,
}

impl fmt::Display for ExternalBroker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = if self.tls { "mqtts" } else { "mqtt" };
        if self.host.contains(':') {
            write!(f, "{scheme}://[{}]:{}", self.host, self.port)
        } else {
            write!(f, "{scheme}://{}:{}", self.host, self.port)
        }
    }
}

/// Broker through which the MQTT topics are published.
#[derive(Debug, Clone, PartialEq, Eq, Default, Deserialize, Serialize)]
#[serde(try_from = "Text", into = "Text")]
pub enum Broker {
    /// The embedded broker of the runtime.
    #[default]
    Embedded,
    /// An external broker: the addresses of its nodes, either all with TLS or all without.
    External(Vec<ExternalBroker>),
}

/// The value of the key as written: one address, or the addresses of several nodes.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum Text {
    /// One address, or `embedded`.
    One(String),
    /// Several addresses.
    Several(Vec<String>),
}

impl From<Broker> for Text {
    fn from(broker: Broker) -> Self {
        match broker {
            Broker::Embedded => Self::One(EMBEDDED.into()),
            Broker::External(nodes) => match nodes.as_slice() {
                [node] => Self::One(node.to_string()),
                nodes => Self::Several(nodes.iter().map(ToString::to_string).collect()),
            },
        }
    }
}

impl TryFrom<Text> for Broker {
    /// Describes the error of the address and the correct form, without the user and password that it may contain.
    type Error = String;

    fn try_from(text: Text) -> Result<Self, String> {
        let texts = match text {
            Text::One(text) if text == EMBEDDED => return Ok(Self::Embedded),
            Text::One(text) => vec![text],
            Text::Several(texts) => texts,
        };
        if !(1..=NODES_MAX).contains(&texts.len()) {
            return Err(format!("[mqtt] broker: write 1 to {NODES_MAX} addresses"));
        }
        let mut nodes: Vec<ExternalBroker> = Vec::with_capacity(texts.len());
        for text in texts {
            let node = external(&text)?;
            if nodes.contains(&node) {
                return Err(format!("[mqtt] broker: {node} is listed twice"));
            }
            nodes.push(node);
        }
        if nodes.iter().any(|node| node.tls != nodes[0].tls) {
            return Err("[mqtt] broker: write either all addresses with TLS (mqtts), or none".into());
        }
        Ok(Self::External(nodes))
    }
}

fn external(text: &str) -> Result<ExternalBroker, String> {
    if text.contains('@') {
        return Err(
            "[mqtt] broker: the address must not contain a user or password; write username and password_file"
                .into(),
        );
    }
    parse(text).map_err(|why| {
        format!(
            "[mqtt] broker = \"{text}\": {why}; write \"{EMBEDDED}\", \"mqtt://host:{PORT_DEFAULT}\" or, with TLS, \"mqtts://host:{TLS_PORT_DEFAULT}\""
        )
    })
}

fn parse(text: &str) -> Result<ExternalBroker, &'static str> {
    let (tls, authority) = match text.split_once("://") {
        Some(("mqtt", authority)) => (false, authority),
        Some(("mqtts", authority)) => (true, authority),
        _ => return Err("it is not an MQTT address"),
    };
    let (host, port) = if let Some(rest) = authority.strip_prefix('[') {
        let (host, port) = rest
            .split_once(']')
            .ok_or("the ] of its IPv6 address is missing")?;
        host.parse::<Ipv6Addr>()
            .map_err(|_| "there is no IPv6 address between [ and ]")?;
        (host, port)
    } else {
        let (host, port) = authority.split_at(authority.find(':').unwrap_or(authority.len()));
        let good = |c: char| c.is_ascii_alphanumeric() || ['.', '-', '_'].contains(&c);
        if host.is_empty() || !host.chars().all(good) {
            return Err("it names no host");
        }
        (host, port)
    };
    let default = if tls { TLS_PORT_DEFAULT } else { PORT_DEFAULT };
    let port = match port.strip_prefix(':') {
        Some(number) => number.parse().ok().filter(|port| *port != 0),
        None => port.is_empty().then_some(default),
    };
    Ok(ExternalBroker {
        tls,
        host: host.to_owned(),
        port: port.ok_or("its port is not 1 to 65535")?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_taken_apart_and_shown_whole() {
        for (text, tls, host, port) in [
            ("mqtt://h", false, "h", 1883),
            ("mqtts://plant-1.example", true, "plant-1.example", 8883),
            ("mqtt://10.0.0.7:1884", false, "10.0.0.7", 1884),
            ("mqtts://[::1]:7", true, "::1", 7),
            ("mqtt://[fd00::2]", false, "fd00::2", 1883),
        ] {
            let found = external(text).unwrap();
            assert_eq!(
                (found.tls, found.host.as_str(), found.port),
                (tls, host, port),
                "{text}"
            );
            assert!(found.to_string().starts_with(text), "{found}");
        }
        assert_eq!(
            Broker::try_from(Text::One("embedded".to_owned())),
            Ok(Broker::Embedded)
        );
    }

    #[test]
    fn several_addresses_are_those_of_one_broker() {
        let of =
            |texts: &[&str]| Broker::try_from(Text::Several(texts.iter().map(ToString::to_string).collect()));
        let Ok(Broker::External(nodes)) = of(&["mqtt://a:1883", "mqtt://b"]) else {
            panic!("two nodes");
        };
        assert_eq!(
            nodes.iter().map(ToString::to_string).collect::<Vec<_>>(),
            ["mqtt://a:1883", "mqtt://b:1883"]
        );
        for (texts, why) in [
            (&[][..], "write 1 to 16"),
            (&["mqtt://a"; 17], "write 1 to 16"),
            (&["mqtt://a", "mqtt://a:1883"], "twice"),
            (&["mqtt://a", "mqtts://b"], "or none"),
            (&["mqtt://a", "embedded"], "not an MQTT address"),
        ] {
            let error = of(texts).unwrap_err();
            assert!(error.contains(why), "{error}");
        }
    }
}
