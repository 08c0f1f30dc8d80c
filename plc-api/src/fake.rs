//! A scripted machine for unit tests of handlers.

#[cfg(test)]
mod tests;

use std::ops::Deref;
use std::sync::Arc;

use plc_protocol::types::CoordinateSystemNumber;

pub use plc_protocol::handshake::OutputOutcome;

use crate::plc::Plc;

/// A scripted machine with the handle of a sequence program. Clones are handles to the same machine.
///
/// The test issues outputs ([`issue_output`](plc_protocol::fake::FakePort::issue_output)). It reads how each
/// output ended ([`closed`](plc_protocol::fake::FakePort::closed)) and which other requests this machine
/// received ([`requests`](plc_protocol::fake::FakePort::requests)). The time advances only when the test calls
/// [`advance`](plc_protocol::fake::FakePort::advance). The [module](plc_protocol::fake) of the scripted machine
/// describes its behaviour.
///
/// ```
/// # use plc_api::{Execution, Params, fake::FakePort};
/// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
/// let fake = FakePort::new([1]);
/// let mill = fake.plc().coordinate_system(1);
/// mill.start().await?;
/// fake.issue_output(1, 100, Params::default());
/// assert_eq!(mill.state().await?.execution, Execution::Wait);
/// # Ok(()) }
/// ```
#[derive(Debug, Clone)]
pub struct FakePort(plc_protocol::fake::FakePort);

impl FakePort {
    /// Creates a machine that is online and has these coordinate systems.
    pub fn new(coordinate_systems: impl IntoIterator<Item = CoordinateSystemNumber>) -> Self {
        Self(plc_protocol::fake::FakePort::new(coordinate_systems))
    }

    /// Returns a handle to this machine for a sequence program.
    pub fn plc(&self) -> Plc {
        Plc::in_process(Arc::new(self.0.clone()))
    }
}

/// Gives access to the outputs, requests and messages of the scripted machine.
impl Deref for FakePort {
    type Target = plc_protocol::fake::FakePort;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}
