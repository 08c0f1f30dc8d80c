//! The key of an ordered run.

use plc_api::types::command::CommandMeta;
use plc_api::types::run::RunOrder;
use serde::{Deserialize, Serialize};

/// What an order is known by, as long as its run is kept: the same one again gets that run, and begins none.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct OrderKey {
    /// The user that ordered, as the memory of commands has it.
    pub user: String,
    /// Its `command_id`.
    pub id: String,
    /// The program that was named.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub program: Option<u16>,
    /// Parts that were ordered.
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
