//! REST: one route for each thing that can be read or asked.

mod commands;
mod data;
mod documents;
mod extract;
mod inputs;
mod lease;
mod m_codes;
mod programs;
mod states;

use std::sync::Arc;

use axum::Router;

use crate::shared::Shared;

/// The routes, without the path before all of them.
pub(crate) fn routes() -> Router<Arc<Shared>> {
    Router::new()
        .merge(states::routes())
        .merge(commands::routes())
        .merge(inputs::routes())
        .merge(lease::routes())
        .merge(data::routes())
        .merge(m_codes::routes())
        .merge(programs::routes())
        .merge(documents::routes())
}
