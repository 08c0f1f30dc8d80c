//! The request for the recent motion of the axes.

use super::answer::json_of;
use super::parameter::Query;
use super::path_parameter::CS;
use super::payloads::read_trace;
use super::right::Right::Read;
use super::route::Route;
use super::row::{RequestParts, Row};
use super::row_macros::written;
use super::subject::Subject;
use crate::types::request::Request;
use crate::types::trace::{Trace, TraceQuery};

/// Row of the request for the samples of the last minute.
#[allow(
    clippy::result_large_err,
    reason = "a request that is not of the row is given back as it is"
)]
pub(super) const TRACE: Row = Row {
    routes: &[Route::get(
        Subject::States,
        "/cs/{cs}/trace",
        &[CS],
        "Position, velocity, acceleration and following error of the axes in the last minute, 100 samples a second.",
    )
    .gives::<Trace>()
    .query(Query::TRACE)
    .refusals(&[400])],
    answer: json_of::<Trace>,
    ..Row::new(
        Read,
        |incoming| Ok(Request::Trace(incoming.cs()?, read_trace(&incoming)?)),
        written!(Request::Trace(cs, TraceQuery { from, count, axes }) => {
            let parts = RequestParts::for_coordinate_system(cs).query("from", from).query("count", count);
            if axes.is_empty() { parts } else { parts.query("axes", axes) }
        }),
    )
};
