//! Address of a machine's REST interface.

use tokio_tungstenite::tungstenite::http::Uri;
use tokio_tungstenite::tungstenite::http::uri::InvalidUri;

use crate::error::Error;

/// Path of the interface below the server.
const API: &str = "/api/v1";

/// Parsed address `http://[[user:]token@]host[:port]` or `https://...`.
#[derive(Clone, PartialEq, Eq)]
pub(super) struct RestAddress {
    /// True for an address with TLS.
    pub(super) tls: bool,
    /// URL of the interface, without a slash at the end.
    pub(super) http: String,
    /// URL of the WebSocket of the interface.
    pub(super) websocket: String,
    /// Name of the user to whom the token belongs.
    pub(super) user: Option<String>,
    /// Token, sent as `Authorization: Bearer`.
    pub(super) token: Option<String>,
    /// The given address, without the token.
    pub(super) shown: String,
}

impl std::fmt::Debug for RestAddress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.shown)
    }
}

impl RestAddress {
    pub(super) fn parse(text: &str) -> Result<Self, Error> {
        let (tls, rest) = match text.split_once("://") {
            Some(("https", rest)) => (true, rest),
            Some(("http", rest)) => (false, rest),
            _ => (false, text),
        };
        let (http, websocket) = if tls { ("https", "wss") } else { ("http", "ws") };
        let with_user = rest.rsplit_once('@');
        let (credentials, host) = with_user.map_or((None, rest), |(user, host)| (Some(user), host));
        let (user, token) = match credentials.and_then(|both| both.split_once(':')) {
            Some((user, token)) => (Some(user), Some(token)),
            None => (None, credentials),
        };
        let host = host.trim_end_matches('/');
        let shown = format!("{http}://{host}");
        let wrong = |reason: &str| Error::Address {
            address: shown.clone(),
            reason: reason.to_owned(),
        };
        if host.is_empty() || host.contains(['/', '?', '#']) {
            return Err(wrong(
                "write http://host:port, with a token http://user:token@host:port or http://token@host:port",
            ));
        }
        let uri: Uri = shown
            .parse()
            .map_err(|error: InvalidUri| wrong(&error.to_string()))?;
        let port = uri.authority().and_then(|authority| {
            authority
                .as_str()
                .strip_prefix(authority.host())?
                .strip_prefix(':')
        });
        if let Some(port) = port.filter(|port| port.parse::<u16>().is_err()) {
            return Err(wrong(&format!("{port:?} is not a port number")));
        }
        Ok(Self {
            tls,
            http: format!("{shown}{API}"),
            websocket: format!("{websocket}://{host}{API}/ws"),
            user: user.map(str::to_owned),
            token: token.map(str::to_owned),
            shown,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_names_host_and_token() {
        let address = RestAddress::parse("http://127.0.0.1:8080/").unwrap();
        assert_eq!(address.http, "http://127.0.0.1:8080/api/v1");
        assert_eq!(address.websocket, "ws://127.0.0.1:8080/api/v1/ws");
        assert_eq!(address.token, None);
        let address = RestAddress::parse("https://127.0.0.1:8080/").unwrap();
        assert!(address.tls);
        assert_eq!(address.http, "https://127.0.0.1:8080/api/v1");
        assert_eq!(address.websocket, "wss://127.0.0.1:8080/api/v1/ws");
        let address = RestAddress::parse("http://s3cret@mill-1").unwrap();
        assert_eq!(address.token.as_deref(), Some("s3cret"));
        assert!(!format!("{address:?}").contains("s3cret"));
        let address = RestAddress::parse("http://magazine:s3cret@mill-1").unwrap();
        assert_eq!(
            (
                address.user.as_deref(),
                address.token.as_deref(),
                address.shown.as_str()
            ),
            (Some("magazine"), Some("s3cret"), "http://mill-1")
        );
    }

    #[test]
    fn a_wrong_address_is_refused_without_showing_the_token() {
        for wrong in [
            "http://",
            "http://secret@",
            "http://secret@h/path",
            "http://h:x",
            "http://secret@[::1",
        ] {
            let error = RestAddress::parse(wrong).unwrap_err().to_string();
            assert!(!error.contains("secret"), "{error}");
        }
    }
}
