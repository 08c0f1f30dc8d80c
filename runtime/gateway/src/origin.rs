//! Which web pages may talk to us: only our own. A page of another site open in the same browser must not be able
//! to start a machine, neither by a request of its own (CSRF) nor by a name that it lets point to the loopback (DNS
//! rebinding). So on the loopback the Host must be a name of the loopback with our port, and an Origin, where there is
//! one, the same. Where the network is listened to, each request needs a token, which no other page has: there the
//! Host may be any name of the machine, and an Origin must be that of the Host.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use crate::problem::Problem;
use crate::shared::Shared;

/// Lets a request pass only with our Host, and with our Origin or none.
pub(crate) async fn guard(State(shared): State<Arc<Shared>>, request: Request, next: Next) -> Response {
    match check(request.headers(), shared.http_addr) {
        Ok(()) => next.run(request).await,
        Err(problem) => problem.into_response(),
    }
}

fn check(headers: &HeaderMap, own: SocketAddr) -> Result<(), Problem> {
    let hosts: Vec<_> = headers.get_all(header::HOST).iter().collect();
    let host = match hosts.as_slice() {
        [host] => host.to_str().ok(),
        _ => None,
    };
    let Some(host) = host.filter(|host| !own.ip().is_loopback() || is_own(host, own)) else {
        return Err(Problem::new(
            StatusCode::FORBIDDEN,
            "foreign_host",
            format!("the Host header does not name this server; call it as http://{own}"),
        ));
    };
    let origin_ok = headers.get_all(header::ORIGIN).iter().all(|origin| {
        origin.to_str().ok().is_some_and(|origin| {
            let page = origin.strip_prefix("http://");
            if own.ip().is_loopback() {
                page.is_some_and(|page| is_own(page, own))
            } else {
                // a proxy before us may speak https
                page.or_else(|| origin.strip_prefix("https://")) == Some(host)
            }
        })
    });
    if origin_ok {
        Ok(())
    } else {
        Err(Problem::new(
            StatusCode::FORBIDDEN,
            "foreign_origin",
            "a web page of another origin may not use this machine",
        ))
    }
}

/// True for a loopback name or address with our port, or the address listened on.
fn is_own(host: &str, own: SocketAddr) -> bool {
    const HTTP_PORT: u16 = 80;
    let (name, port) = match host.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some((name, "")) => (name, None),
        Some((name, rest)) => match rest.strip_prefix(':') {
            Some(port) => (name, Some(port)),
            None => return false,
        },
        None => match host.split_once(':') {
            Some((name, port)) => (name, Some(port)),
            None => (host, None),
        },
    };
    let port = match port {
        None => HTTP_PORT,
        Some(port) => match port.parse() {
            Ok(port) => port,
            Err(_) => return false,
        },
    };
    let address: Option<IpAddr> = name.parse().ok();
    let name_ok = name.eq_ignore_ascii_case("localhost")
        || address.is_some_and(|address| address.is_loopback() || address == own.ip());
    name_ok && port == own.port()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(pairs: &[(header::HeaderName, &str)]) -> HeaderMap {
        pairs
            .iter()
            .map(|(name, value)| (name.clone(), value.parse().unwrap()))
            .collect()
    }

    #[test]
    fn loopback_names_with_our_port_are_ours() {
        let own = "127.0.0.1:8080".parse().unwrap();
        for host in ["127.0.0.1:8080", "localhost:8080", "LOCALHOST:8080", "[::1]:8080"] {
            assert!(is_own(host, own), "{host}");
        }
        for host in [
            "127.0.0.1",
            "localhost",
            "127.0.0.1:8081",
            "evil.example:8080",
            "localhost.evil.example:8080",
            "127.0.0.1.evil.example:8080",
            "127.0.0.1:8080:8080",
            "10.0.0.1:8080",
            "[::1]8080",
            "",
        ] {
            assert!(!is_own(host, own), "{host}");
        }
        assert!(is_own("localhost", "127.0.0.1:80".parse().unwrap()));
    }

    #[test]
    fn a_foreign_origin_or_host_is_refused_and_none_is_not() {
        let own: SocketAddr = "127.0.0.1:8080".parse().unwrap();
        let host = (header::HOST, "localhost:8080");
        assert!(check(&headers(std::slice::from_ref(&host)), own).is_ok());
        assert!(
            check(
                &headers(&[host.clone(), (header::ORIGIN, "http://localhost:8080")]),
                own
            )
            .is_ok()
        );
        for origin in [
            "http://evil.example",
            "null",
            "https://localhost:8080",
            "http://localhost:9",
        ] {
            let problem = check(&headers(&[host.clone(), (header::ORIGIN, origin)]), own).unwrap_err();
            assert_eq!(problem.status_and_code(), (403, "foreign_origin"), "{origin}");
        }
        let network: SocketAddr = "0.0.0.0:8080".parse().unwrap();
        let by_name = (header::HOST, "mill-1.local:8080");
        for (origin, allowed) in [
            ("http://mill-1.local:8080", true),
            ("http://evil.example", false),
            ("null", false),
        ] {
            let headers = headers(&[by_name.clone(), (header::ORIGIN, origin)]);
            assert_eq!(check(&headers, network).is_ok(), allowed, "{origin}");
        }
        for headers in [headers(&[(header::HOST, "evil.example:8080")]), HeaderMap::new()] {
            let problem = check(&headers, own).unwrap_err();
            assert_eq!(problem.status_and_code(), (403, "foreign_host"));
        }
    }
}
