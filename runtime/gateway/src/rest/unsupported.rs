//! Routes of the interface that this version refuses: 501 with code `not_supported`, never a pretended success.

use std::future::{Ready, ready};
use std::sync::Arc;

use axum::Router;
use axum::routing::post;
use plc_api::types::command::Command;

use crate::problem::Problem;
use crate::shared::Shared;

pub(super) fn routes() -> Router<Arc<Shared>> {
    let mut router = Router::new();
    for verb in Command::NOT_SUPPORTED {
        router = router.route(&format!("/cs/{{cs}}/{verb}"), post(move || refuse(verb)));
    }
    router
}

fn refuse(what: &'static str) -> Ready<Problem> {
    ready(Problem::not_supported(what))
}
