//! Only the server's own web pages may use it. A page of another site in the same browser must not be able to start a
//! machine, neither by its own request (CSRF) nor by a name that it resolves to the loopback (DNS rebinding). So on the
//! loopback the Host must be a name of the loopback with the server's port, and so must the Origin, if there is one. On
//! the network each request needs a token, which no other page has: there the Host may be any name, and an Origin must
//! match it. Pages of the origins in `[http] allow_origins` may use it as well; they need a token from their user.

use std::collections::HashSet;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::time::Duration;

use axum::extract::Request;
use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, Uri, header};
use tower_http::cors::{AllowOrigin, CorsLayer};

use crate::contract::routes::ROUTES;
use crate::problem::Problem;
use crate::server_state::ServerState;

/// How long a browser remembers the headers that pages of another origin may send.
const PREFLIGHT_AGE: Duration = Duration::from_mins(10);

/// Allows pages of these origins to read responses. They send their token in a header; nothing is sent automatically,
/// as a cookie would be.
pub(crate) fn shared_with(origins: &[HeaderValue]) -> CorsLayer {
    CorsLayer::new()
        .allow_origin(AllowOrigin::list(origins.iter().cloned()))
        .allow_methods([Method::GET, Method::POST, Method::PUT, Method::DELETE])
        .allow_headers(listed_headers())
        .expose_headers([header::ETAG, header::LOCATION, header::RETRY_AFTER])
        .max_age(PREFLIGHT_AGE)
}

/// Returns the headers of the token and of the body's type, and those that routes list.
fn listed_headers() -> Vec<HeaderName> {
    let routes = ROUTES.values().flatten();
    let listed = routes.flat_map(|(route, _)| route.headers.parameters());
    let names = listed.filter_map(|header| HeaderName::try_from(header.name).ok());
    let all: HashSet<_> = [header::AUTHORIZATION, header::CONTENT_TYPE]
        .into_iter()
        .chain(names)
        .collect();
    all.into_iter().collect()
}

/// Admits requests with the server's own Host, and its own Origin or none.
pub(crate) fn admit(shared: &ServerState, request: &Request) -> Result<(), Problem> {
    check(
        request.uri(),
        request.headers(),
        shared.http_addr,
        shared.scheme,
        shared.access.origins(),
    )
}

/// Checks the host of a request, which may be named twice: in its target (`GET http://host/path`) and in the Host
/// header. Both must be the same.
fn check(
    target: &Uri,
    headers: &HeaderMap,
    own: SocketAddr,
    scheme: &str,
    allowed: &[HeaderValue],
) -> Result<(), Problem> {
    let mut hosts = headers.get_all(header::HOST).iter();
    let host = hosts.next().and_then(|host| host.to_str().ok());
    let in_target = target.authority().map(Authority::as_str);
    let is_allowed = |host: &&str| {
        let is_named = in_target.is_none_or(|named| named.eq_ignore_ascii_case(host));
        is_named && (!own.ip().is_loopback() || is_own(host, own, scheme))
    };
    let (Some(host), None) = (host.filter(is_allowed), hosts.next()) else {
        return Err(Problem::new(
            StatusCode::FORBIDDEN,
            "foreign_host",
            format!("the target or the Host header does not name this server; use {scheme}://{own}"),
        ));
    };
    for origin in headers.get_all(header::ORIGIN) {
        if allowed.contains(origin) {
            continue;
        }
        let origin = origin.to_str().unwrap_or_default();
        let (of, page) = origin.split_once("://").unwrap_or_default();
        let is_ours = if own.ip().is_loopback() {
            of == scheme && is_own(page, own, scheme)
        } else {
            // a reverse proxy may use https
            [scheme, "https"].contains(&of) && page == host
        };
        if !is_ours {
            let text =
                "a web page of this origin may not use this machine; add its origin to [http] allow_origins";
            return Err(Problem::new(StatusCode::FORBIDDEN, "foreign_origin", text));
        }
    }
    Ok(())
}

/// Returns true for a loopback name or address with the server's port, or the address listened on.
fn is_own(host: &str, own: SocketAddr, scheme: &str) -> bool {
    let usual = if scheme == "https" { "443" } else { "80" };
    let (name, port) = match host.rsplit_once(':') {
        // a colon of an IPv6 address
        Some((_, port)) if port.ends_with(']') => (host, usual),
        Some(parts) => parts,
        None => (host, usual),
    };
    let address = match name.strip_prefix('[').and_then(|name| name.strip_suffix(']')) {
        Some(name) => name.parse::<Ipv6Addr>().ok().map(Into::into),
        None => name.parse::<Ipv4Addr>().ok().map(Into::into),
    };
    let is_address_own = |address: IpAddr| address.is_loopback() || address == own.ip();
    (name.eq_ignore_ascii_case("localhost") || address.is_some_and(is_address_own))
        && port.parse() == Ok(own.port())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(headers: &HeaderMap, own: SocketAddr) -> Result<(), Problem> {
        super::check(&Uri::from_static("/"), headers, own, "http", &[])
    }

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
            assert!(is_own(host, own, "http"), "{host}");
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
            assert!(!is_own(host, own, "http"), "{host}");
        }
        assert!(is_own("localhost", "127.0.0.1:80".parse().unwrap(), "http"));
        assert!(is_own("localhost", "127.0.0.1:443".parse().unwrap(), "https"));
        assert!(!is_own("localhost", "127.0.0.1:80".parse().unwrap(), "https"));
    }

    #[test]
    fn with_tls_only_our_page_over_https_is_ours() {
        let own = "127.0.0.1:8080".parse().unwrap();
        for (origin, allowed) in [("https://localhost:8080", true), ("http://localhost:8080", false)] {
            let headers = headers(&[(header::HOST, "localhost:8080"), (header::ORIGIN, origin)]);
            let checked = super::check(&Uri::from_static("/"), &headers, own, "https", &[]);
            assert_eq!(checked.is_ok(), allowed, "{origin}");
        }
    }

    #[test]
    fn a_target_that_names_another_host_is_refused() {
        let host = headers(&[(header::HOST, "localhost:8080")]);
        for own in ["127.0.0.1:8080", "0.0.0.0:8080"] {
            let own = own.parse().unwrap();
            for (target, allowed) in [
                ("/api/v1/cs/1/stop", true),
                ("http://localhost:8080/api/v1/cs/1/stop", true),
                ("http://LOCALHOST:8080/api/v1/cs/1/stop", true),
                ("http://evil.example/api/v1/cs/1/stop", false),
                ("http://user@localhost:8080/api/v1/cs/1/stop", false),
                ("http://127.0.0.1:8080/api/v1/cs/1/stop", false),
            ] {
                let checked = super::check(&target.parse().unwrap(), &host, own, "http", &[]);
                assert_eq!(checked.is_ok(), allowed, "{target} at {own}");
            }
        }
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
