//! The sender of a request, as far as the execution depends on it.

use plc_protocol::server::{Origin, ServerTransport};
use plc_protocol::types::not_after::NotAfter;
use plc_protocol::types::request::{MachineRequest, Refusal};

use super::RuntimePort;

/// Sender of a request: the user whose command memory applies, and the age limit of the request.
#[derive(Debug, Clone)]
pub(super) struct Sender {
    /// The authenticated user. Without users the host; if the host is unknown, the transport.
    pub user: String,
    pub not_after: Option<NotAfter>,
}

impl Sender {
    /// Returns the sender of requests of a program in this process.
    pub fn in_process() -> Self {
        Self {
            user: "in process".to_owned(),
            not_after: None,
        }
    }

    /// Returns the sender that a server end has identified.
    pub fn from_origin(origin: &Origin) -> Self {
        let user = match (&origin.user, origin.from, origin.over) {
            (Some(user), ..) => format!("user {user}"),
            (None, Some(host), _) => format!("host {host}"),
            (None, None, ServerTransport::InProcess) => return Self::in_process(),
            (None, None, _) => "broker".to_owned(),
        };
        Self {
            user,
            not_after: origin.not_after.clone(),
        }
    }
}

impl RuntimePort {
    /// Rejects a request that is older than its age limit. Requests with a stored reply are excluded; their age is
    /// checked after the memory.
    pub(super) fn check_sender(&self, request: &MachineRequest, sender: &Sender) -> Result<(), Refusal> {
        match request {
            MachineRequest::WriteVariables { meta: Some(_), .. } => Ok(()),
            _ => self.shared.check_not_after(sender.not_after.as_ref()),
        }
    }
}
