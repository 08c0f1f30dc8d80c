//! The identity of a handler towards the machine.

use std::sync::Arc;

use plc_protocol::names::unique_name;

/// A handler and one of its instances, as the sender of claims, resets and writes of levels.
#[derive(Debug, Clone)]
pub(crate) struct Identity {
    pub(crate) handler_id: Arc<str>,
    pub(crate) instance: Arc<str>,
}

impl Identity {
    /// Creates the identity of a new instance of a handler.
    pub(crate) fn new(handler_id: Arc<str>) -> Self {
        Self {
            handler_id,
            instance: unique_name("i").into(),
        }
    }

    pub(crate) fn id(&self) -> String {
        self.handler_id.to_string()
    }

    pub(crate) fn instance(&self) -> String {
        self.instance.to_string()
    }
}
