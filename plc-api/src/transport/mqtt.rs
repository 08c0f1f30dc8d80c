//! The MQTT client.
use crate::port::Port;
use std::sync::Arc;
/// x
/// # Errors
/// x
#[allow(clippy::unused_async)]
pub async fn connect(_address: &str) -> crate::Result<Arc<dyn Port>> {
    Err(crate::Error::Closed)
}
