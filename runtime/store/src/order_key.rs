//! The key that identifies an ordered run.

use plc_protocol::types::command::CommandMeta;
use plc_protocol::types::run::RunOrder;
use serde::{Deserialize, Serialize};

/// Key of an order, stored as long as its run. A repeated order with the same key returns that run and does not start
/// another.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct OrderKey {
    /// User that sent the order; the name is that of the command memory.
    pub user: String,
    /// The `command_id` of the order.
    pub id: String,
    /// The program named in the order.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub program: Option<u16>,
    /// Number of ordered parts.
    pub parts: u32,
}

impl OrderKey {
    /// Returns the key of an order that a command with this meta data requests.
    pub fn new(order: RunOrder, meta: &CommandMeta) -> Self {
        Self {
            user: meta.memory.user.clone(),
            id: meta.command_id.clone(),
            program: order.program,
            parts: order.parts,
        }
    }
}
