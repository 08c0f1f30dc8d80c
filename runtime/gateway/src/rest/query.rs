//! The query of a route; an unknown parameter is answered with 400.

use axum::extract::Query;
use axum::http::Uri;
use plc_api::types::CoordinateSystemNumber;
use plc_api::types::data::JournalFilter;
use plc_api::wire::route::{self, Route};
use plc_api::wire::row::QueryValues;
use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::problem::Problem;

/// Kinds of queries, each with the fields that it reads.
macro_rules! queries {
    ($($(#[$attribute:meta])* $name:ident { $($field:ident: $type:ty),* } => $values:expr;)*) => {$(
        #[derive(Deserialize)]
        $(#[$attribute])*
        struct $name {
            $(#[serde(default)] $field: $type,)*
        }

        impl From<$name> for QueryValues {
            fn from($name { $($field),* }: $name) -> Self {
                $values
            }
        }
    )*};
}

queries! {
    #[serde(deny_unknown_fields)]
    Range { from: u32, count: Option<u32> } => QueryValues { from, count, ..QueryValues::default() };
    Wait { wait: Option<String> } => QueryValues { wait, ..QueryValues::default() };
    #[serde(deny_unknown_fields)]
    Upload { dialect: Option<String> } => QueryValues { dialect, ..QueryValues::default() };
    #[serde(deny_unknown_fields)]
    RunBy { cs: Option<CoordinateSystemNumber> } => QueryValues { cs, ..QueryValues::default() };
    #[serde(deny_unknown_fields)]
    Seconds { wait: Option<String> } => QueryValues { wait, ..QueryValues::default() };
    #[serde(deny_unknown_fields)]
    Runs { cs: Option<CoordinateSystemNumber>, from: u32, count: Option<u32> } =>
        QueryValues { cs, from, count, ..QueryValues::default() };
    #[serde(deny_unknown_fields)]
    Samples { from: u32, count: Option<u32>, axes: Option<String> } => QueryValues { from, count, axes, ..QueryValues::default() };
    #[serde(deny_unknown_fields)]
    Path { cs: Option<CoordinateSystemNumber>, tolerance: Option<f64>, from: u32, count: Option<u32> } =>
        QueryValues { cs, tolerance, from, count, ..QueryValues::default() };
    #[serde(deny_unknown_fields)]
    Lines {
        from: u32, count: Option<u32>, since: Option<String>, until: Option<String>,
        cs: Option<CoordinateSystemNumber>, m: Option<u16>, user: Option<String>, run: Option<String>
    } => QueryValues {
        from,
        count,
        filter: JournalFilter { since, until, cs, m, user, run },
        ..QueryValues::default()
    };
}

/// The query of a URL.
pub(super) fn read(route: &Route, uri: &Uri) -> Result<QueryValues, Problem> {
    match route.query {
        route::Query::Nothing => Ok(QueryValues::default()),
        route::Query::Range => read_as::<Range>(uri),
        route::Query::Journal => read_as::<Lines>(uri),
        route::Query::Wait => read_as::<Wait>(uri),
        route::Query::Dialect => read_as::<Upload>(uri),
        route::Query::Seconds => read_as::<Seconds>(uri),
        route::Query::Runs => read_as::<Runs>(uri),
        route::Query::Trace => read_as::<Samples>(uri),
        route::Query::RunBy => read_as::<RunBy>(uri),
        route::Query::Path => read_as::<Path>(uri),
    }
}

fn read_as<T: DeserializeOwned + Into<QueryValues>>(uri: &Uri) -> Result<QueryValues, Problem> {
    let read = Query::<T>::try_from_uri(uri);
    read.map(|Query(values)| values.into())
        .map_err(|refusal| Problem::invalid(refusal.body_text()))
}
