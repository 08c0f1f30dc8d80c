//! The requests that are activity of a login. Pure: no I/O.
//!
//! A login without activity ends. A page or a program repeats some requests while the person is absent: these are no
//! activity.

use axum::http::Method;

use crate::contract::topics::inbound;

/// Ends of the patterns of routes whose requests are repeated automatically: a lease, a watched client and a registered
/// handler are renewed.
const RENEWED_ROUTES: [&str; 3] = ["/lease", "/heartbeat", "/handlers/{id}"];

/// Ends of topics whose messages are repeated automatically.
const RENEWED_TOPICS: [&str; 2] = ["/lease/take", "/heartbeat"];

/// Returns true for a request that a person causes: any request that does more than read and is not repeated
/// automatically, and the query of the own login, which the HMI sends while a person uses it. `route` is the pattern of
/// its route.
pub(super) fn is_activity(method: &Method, route: Option<&str>) -> bool {
    let ends_with = |end: &&str| route.is_some_and(|route| route.ends_with(*end));
    match *method {
        Method::GET | Method::HEAD => ends_with(&"/login"),
        _ => !RENEWED_ROUTES.iter().any(ends_with),
    }
}

/// Returns true for a topic below the machine's root on which a person commands the machine or sets a value.
pub(crate) fn is_activity_over_mqtt(path: &str) -> bool {
    let is_renewed = RENEWED_TOPICS.iter().any(|end| path.ends_with(end));
    !is_renewed && inbound(path).is_some_and(|(_, right)| right.is_recorded())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn renewals_and_reading_are_no_activity_and_acts_are() {
        for (method, route, expected) in [
            (Method::GET, "/api/v1/cs/{cs}/state", false),
            (Method::GET, "/api/v1/login", true),
            (Method::POST, "/api/v1/cs/{cs}/start", true),
            (Method::PUT, "/api/v1/tools", true),
            (Method::POST, "/api/v1/cs/{cs}/lease/break", true),
            (Method::POST, "/api/v1/cs/{cs}/lease", false),
            (Method::PUT, "/api/v1/clients/{id}/heartbeat", false),
            (Method::PUT, "/api/v1/handlers/{id}", false),
        ] {
            assert_eq!(is_activity(&method, Some(route)), expected, "{method} {route}");
        }
        for (path, expected) in [
            ("cs/1/command/start", true),
            ("client/anna/cs/1/command/stop", true),
            ("client/anna/cs/1/override/set", true),
            ("cs/1/lease/break", true),
            ("client/anna/cs/1/lease/take", false),
            ("client/anna/heartbeat", false),
            ("handler/anna/presence", false),
            ("client/anna/cs/1/variable/get", false),
            ("cs/1/state", false),
        ] {
            assert_eq!(is_activity_over_mqtt(path), expected, "{path}");
        }
    }
}
