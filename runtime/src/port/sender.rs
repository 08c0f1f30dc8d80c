//! The sender of a request.

use plc_api::server::{Origin, ServerTransport};
use plc_api::types::not_after::NotAfter;
use plc_api::types::request::{MachineRequest, Refusal};

use super::RuntimePort;

/// Sender whose memory of executed commands applies to a request, with the age limit of the request.
#[derive(Debug, Clone)]
pub(super) struct Sender {
    /// The authenticated user; without users the host, or the transport if the host is unknown.
    pub user: String,
    pub not_after: Option<NotAfter>,
}

impl Sender {
    /// Returns the sender for a program in this process.
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
    /// Rejects a request that is too old. A remembered request is looked up before this check.
    pub(super) fn check_sender(&self, request: &MachineRequest, sender: &Sender) -> Result<(), Refusal> {
        match request {
            MachineRequest::WriteVariables { meta: Some(_), .. } => Ok(()),
            _ => self.shared.check_not_after(sender.not_after.as_ref()),
        }
    }
}
