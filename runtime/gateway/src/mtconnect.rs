//! MTConnect below `/mtconnect`, for users who may read, and its adapter.

use std::sync::Arc;

use axum::Router;
use axum::middleware;
use plc_protocol::port::Port;
use plc_protocol::supervisor::Supervisor;
use tandem_mtconnect::{Agent, AgentSettings};
use tokio_util::sync::CancellationToken;

use crate::access::guard::guard_reading;
use crate::error::GatewayError;
use crate::server_state::ServerState;
use crate::settings::{GatewaySettings, SHDR_LISTEN, bind};

/// Path of the agent.
pub(crate) const ROOT: &str = "/mtconnect";

/// Starts the configured agent with its adapter. Returns `None` if none is configured.
///
/// # Errors
/// Returns an error if the adapter cannot listen.
pub(crate) async fn start(
    settings: &GatewaySettings,
    port: Arc<dyn Port>,
    supervisor: Supervisor,
    stop: &CancellationToken,
) -> Result<Option<Agent>, GatewayError> {
    let Some(mtconnect) = &settings.mtconnect else {
        return Ok(None);
    };
    let adapter = settings
        .shdr_address()?
        .map(|address| bind(SHDR_LISTEN, address))
        .transpose()?;
    let of_agent = AgentSettings {
        version: mtconnect.version,
        emergency_stop: mtconnect.emergency_stop.clone(),
    };
    let agent = Agent::start(port, of_agent, stop.clone(), supervisor).await;
    if let Some(listener) = adapter {
        agent.serve_shdr(listener);
    }
    Ok(Some(agent))
}

/// Its routes.
pub(crate) fn routes(agent: Option<&Agent>, shared: &Arc<ServerState>) -> Router<Arc<ServerState>> {
    let Some(agent) = agent else { return Router::new() };
    let guarded = agent
        .router()
        .layer(middleware::from_fn_with_state(Arc::clone(shared), guard_reading));
    Router::new().nest_service(ROOT, guarded)
}
