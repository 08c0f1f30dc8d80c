//! Requests for inputs and outputs of the plant.

use super::path_parameter::IO_NAME;
use super::right::Right::{Operate, SetInput};
use super::route::Route;
use super::row::{InboundTopic, RequestParts, Row};
use super::row_macros::written;
use super::subject::Subject;
use crate::types::io::{IoForce, IoSet};
use crate::types::request::Request;

/// Row of the request by which a handler or a client writes an input or output.
#[allow(
    clippy::result_large_err,
    reason = "a request that is not of the row is given back as it is"
)]
pub(super) const WRITE: Row = Row {
    routes: &[
        Route::put::<IoSet>(
            Subject::Inputs,
            "/io/{side=in}/{name}",
            &[IO_NAME],
            "Writes an input of the plant.",
        ),
        Route::put::<IoSet>(
            Subject::Inputs,
            "/io/{side=out}/{name}",
            &[IO_NAME],
            "Writes an output of the plant.",
        ),
    ],
    topic: Some(InboundTopic::new::<IoSet>(
        "io/{side}/{name}/set",
        "Writes an input or output of the plant. The sender is the handler that owns it or, if it has no owner, any client without presence.",
    )),
    ..Row::new(
        SetInput,
        |incoming| Ok(Request::WriteIo(incoming.io_point()?, incoming.json()?)),
        written!(Request::WriteIo(point, set) => RequestParts::for_io(&point).json(&set)),
    )
};

/// Row of the request by which an operator forces an input or output.
#[allow(
    clippy::result_large_err,
    reason = "a request that is not of the row is given back as it is"
)]
pub(super) const FORCE: Row = Row {
    routes: &[
        Route::put::<IoForce>(
            Subject::Inputs,
            "/io/{side=in}/{name}/force",
            &[IO_NAME],
            "Forces a value of an input of the plant; null ends the forcing.",
        ),
        Route::put::<IoForce>(
            Subject::Inputs,
            "/io/{side=out}/{name}/force",
            &[IO_NAME],
            "Forces a value of an output of the plant; null ends the forcing.",
        ),
    ],
    topic: Some(InboundTopic::new::<IoForce>(
        "io/{side}/{name}/force",
        "Forces a value that replaces the written value of an input or output of the plant; null ends the forcing.",
    )),
    ..Row::new(
        Operate,
        |incoming| Ok(Request::ForceIo(incoming.io_point()?, incoming.json()?)),
        written!(Request::ForceIo(point, force) => RequestParts::for_io(&point).json(&force)),
    )
};
