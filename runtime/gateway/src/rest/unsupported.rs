//! Routes of the interface that this version refuses: 501 with code `not_supported`, never a pretended success.

use std::future::{Ready, ready};
use std::sync::Arc;

use axum::Router;
use axum::routing::{MethodRouter, get, post, put};
use plc_api::types::command::Command;

use crate::problem::Problem;
use crate::shared::Shared;

pub(super) fn routes() -> Router<Arc<Shared>> {
    let mut router = Router::new();
    for verb in Command::NOT_SUPPORTED {
        router = router.route(&format!("/cs/{{cs}}/{verb}"), post(move || refuse(verb)));
    }
    router
        .route(
            "/motors/{number}/skip_input",
            put(|| refuse("setting a skip input")),
        )
        .route("/variables/p", read_write("reading and writing P variables"))
        .route(
            "/cs/{cs}/variables/q",
            read_write("reading and writing Q variables"),
        )
        .route(
            "/cs/{cs}/work_offsets",
            read_write("reading and writing work offsets"),
        )
        .route("/tools", read_write("reading and writing the tool table"))
        .route("/cs/{cs}/tools", read_write("reading and writing the tool table"))
        .route(
            "/programs/{number}/intermediate",
            get(|| refuse("intermediate code")),
        )
        .route("/openapi.json", get(|| refuse("the OpenAPI document")))
        .route("/asyncapi.json", get(|| refuse("the AsyncAPI document")))
}

fn read_write(what: &'static str) -> MethodRouter<Arc<Shared>> {
    get(move || refuse(what)).put(move || refuse(what))
}

fn refuse(what: &'static str) -> Ready<Problem> {
    ready(Problem::not_supported(what))
}
