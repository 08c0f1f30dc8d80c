//! Routes of `/api/v1`: those of the rows of the wire, and those that the server answers without the machine.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use axum::http::Method;
use plc_protocol::types::form::Form;
use plc_protocol::wire::ROWS;
use plc_protocol::wire::hmi::Hmi;
use plc_protocol::wire::login::{CurrentUser, Login, LoginRequest};
use plc_protocol::wire::machines::Machines;
use plc_protocol::wire::path_parameter::CS;
use plc_protocol::wire::right::Right;
use plc_protocol::wire::route::{Content, Headers, Route};
use plc_protocol::wire::row::Row;
use plc_protocol::wire::states::{AllIo, CoordinateSystems, Health, Inputs, STATES, StateRow};
use plc_protocol::wire::subject::Subject;

/// Path before all routes of the interface.
pub(crate) const API: &str = "/api/v1";

/// Service of a route.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Serves {
    Request(&'static Row),
    State(&'static StateRow),
    /// Data of the server itself, for users with this right. With `None` for every client, because it contains nothing
    /// of the machine.
    Own(Option<Right>),
}

impl Serves {
    /// Returns the right that a caller needs; `None` if it needs no user.
    pub(crate) fn right(self) -> Option<Right> {
        match self {
            Serves::Request(row) => Some(row.right),
            Serves::State(_) => Some(Right::Read),
            Serves::Own(right) => right,
        }
    }
}

/// Routes of the server itself, and the rights that they need.
static OWN: [(Option<Right>, Route); 13] = [
    (
        Some(Right::Read),
        Route::get(
            Subject::Machine,
            "/cs",
            &[],
            "All coordinate systems with their states.",
        )
        .gives::<CoordinateSystems>(),
    ),
    (
        Some(Right::Read),
        Route::get(Subject::Inputs, "/cs/{cs}/inputs", &[CS], "All inputs.").gives::<Inputs>(),
    ),
    (
        Some(Right::Read),
        Route::get(
            Subject::Inputs,
            "/io",
            &[],
            "All inputs and outputs of the plant.",
        )
        .gives::<AllIo>(),
    ),
    (
        Some(Right::Read),
        Route::get(
            Subject::Machine,
            "/hmi",
            &[],
            "Buttons and cards that the machine builder has added to the HMI.",
        )
        .gives::<Hmi>(),
    ),
    (
        Some(Right::Read),
        Route::get(
            Subject::Machine,
            "/machines",
            &[],
            "Other machines: the addresses in the configuration, and the states of the machines at the \
             shared MQTT broker.",
        )
        .gives::<Machines>(),
    ),
    (
        None,
        Route::get(
            Subject::Machine,
            "/health",
            &[],
            "Condition of the server, of the connection to the MQTT broker, and of the tasks of the runtime.",
        )
        .gives::<Health>(),
    ),
    (
        Some(Right::Read),
        Route::get(Subject::Machine, "/metrics", &[], "Counters, as Prometheus text.")
            .answered(200, Content::Text),
    ),
    (
        None,
        Route::get(Subject::Machine, "/openapi.json", &[], "This document.").answered(200, Content::Document),
    ),
    (
        None,
        Route::get(
            Subject::Machine,
            "/asyncapi.json",
            &[],
            "The document of the MQTT interface.",
        )
        .answered(200, Content::Document),
    ),
    (
        None,
        Route::new(
            "POST",
            Subject::Machine,
            "/login",
            &[],
            "Returns a token, valid for some hours, to a person with a name and a PIN.",
        )
        .takes(Content::Json(Form::for_type::<LoginRequest>()))
        .gives::<Login>()
        .refusals(&[401, 404, 429, 503]),
    ),
    (
        Some(Right::Read),
        Route::get(Subject::Machine, "/login", &[], "Name and role of the caller.").gives::<CurrentUser>(),
    ),
    (
        Some(Right::Read),
        Route::new(
            "DELETE",
            Subject::Machine,
            "/login",
            &[],
            "Ends the login of the token in the request.",
        )
        .refusals(&[404]),
    ),
    (
        Some(Right::Read),
        Route::get(
            Subject::Machine,
            "/ws",
            &[],
            "WebSocket: messages of the topics that the client names.",
        )
        .answered(101, Content::Nothing)
        .headers(Headers::WebSocket)
        .refusals(&[400, 426]),
    ),
];

/// A route and its service.
type ServedRoute = (&'static Route, Serves);

/// All routes by path.
pub(crate) static ROUTES: LazyLock<BTreeMap<String, Vec<ServedRoute>>> = LazyLock::new(|| {
    let of_rows = ROWS
        .iter()
        .flat_map(|row| row.routes.iter().map(move |route| (route, Serves::Request(row))));
    let of_states = STATES.iter().map(|row| (&row.route, Serves::State(row)));
    let own = OWN.iter().map(|(right, route)| (route, Serves::Own(*right)));
    let mut routes: BTreeMap<String, Vec<ServedRoute>> = BTreeMap::new();
    for place in of_rows.chain(of_states).chain(own) {
        routes.entry(place.0.path()).or_default().push(place);
    }
    routes
});

/// Result of looking up a request in the tables.
pub(crate) enum RouteMatch {
    /// A route that needs this right.
    Route(Option<Right>),
    /// The path exists, but with these methods only.
    OtherMethods(String),
    Nothing,
}

/// Finds the row of a method and a path with its names in braces, below `/api/v1`.
pub(crate) fn find(method: &Method, path: &str) -> RouteMatch {
    let method = if method == Method::HEAD {
        "GET"
    } else {
        method.as_str()
    };
    let Some(places) = ROUTES.get(path) else {
        return RouteMatch::Nothing;
    };
    if let Some((_, serves)) = places.iter().find(|(route, _)| route.method == method) {
        return RouteMatch::Route(serves.right());
    }
    let mut methods: Vec<_> = places.iter().map(|(route, _)| route.method).collect();
    methods.sort_by_key(|method| METHODS.iter().position(|known| known == method));
    if methods.contains(&"GET") {
        methods.push("HEAD");
    }
    RouteMatch::OtherMethods(methods.join(", "))
}

/// Methods in the order in which they are named.
const METHODS: [&str; 4] = ["GET", "POST", "PUT", "DELETE"];
