//! The query of a route.

use axum::extract::Query;
use axum::http::Uri;
use plc_protocol::wire::parameter::QueryValues;
use plc_protocol::wire::route::Route;

use super::problem_of;
use crate::problem::Problem;

/// Reads the query of a URL.
pub(super) fn read(route: &Route, uri: &Uri) -> Result<QueryValues, Problem> {
    let pairs = Query::<Vec<(String, String)>>::try_from_uri(uri);
    let Query(pairs) = pairs.map_err(|refusal| Problem::invalid(refusal.body_text()))?;
    let pairs = pairs.iter().map(|(name, value)| (name.as_str(), value.as_str()));
    route.query.read(pairs).map_err(|fault| problem_of(fault, uri))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use axum::http::Uri;

    use super::*;
    use crate::contract::routes::ROUTES;
    use crate::contract::tests::parameters_in_document;

    /// A value that each parameter of this name takes.
    const VALUE: &str = "1";

    #[test]
    fn each_query_parameter_that_a_route_reads_is_in_the_document() {
        let routes = || {
            ROUTES
                .iter()
                .flat_map(|(path, places)| places.iter().map(move |(route, _)| (path, *route)))
        };
        let all: BTreeSet<String> = routes()
            .flat_map(|(path, route)| parameters_in_document(route.method, path, "query"))
            .collect();
        assert!(all.len() > 8, "{all:?}");
        let nothing = format!("{:?}", QueryValues::default());
        for (path, route) in routes() {
            let listed = parameters_in_document(route.method, path, "query");
            let needed = if route.method == "PUT" && listed.contains("from") {
                "from=1&"
            } else {
                ""
            };
            let is_read = |name: &&String| {
                let query = if *name == "from" {
                    "from=1".to_owned()
                } else {
                    format!("{needed}{name}={VALUE}")
                };
                let uri: Uri = format!("/?{query}").parse().unwrap();
                read(route, &uri).is_ok_and(|values| format!("{values:?}") != nothing)
            };
            let read: BTreeSet<String> = all.iter().filter(is_read).cloned().collect();
            assert_eq!(read, listed, "{} {path}", route.method);
        }
    }
}
