//! The key of an ordered run.

use plc_api::types::command::CommandMeta;
use plc_api::types::run::RunOrder;
use serde::{Deserialize, Serialize};

/// Key of an order while its run is stored: a repeated order returns the existing run and starts no other.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct OrderKey {
    /// The user that sent the order, named as in the memory of commands.
    pub user: String,
    /// Its `command_id`.
    pub id: String,
    /// The program named in the order.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub program: Option<u16>,
    /// Number of ordered parts.
    pub parts: u32,
}

impl OrderKey {
    pub(crate) fn new(order: RunOrder, meta: &CommandMeta) -> Self {
        Self {
            user: meta.memory.user.clone(),
            id: meta.command_id.clone(),
            program: order.program,
            parts: order.parts,
        }
    }
}
