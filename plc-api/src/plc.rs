//! A machine as a sequence program sees it.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use crate::coordinate_system::CoordinateSystem;
use crate::error::{Error, Result};
use crate::outputs::Outputs;
use crate::port::Port;
use crate::types::CoordinateSystemNumber;
use crate::types::program::ProgramInfo;
use crate::types::request::{Answer, Refusal, RefusalCode, Request};

/// A machine: one runtime with its coordinate systems. Cloning gives another handle to the same machine.
///
/// ```
/// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
/// let plc = plc_api::fake::FakePort::new([1]).plc();
/// plc.coordinate_system(1).select_tool(3).await?;
/// assert_eq!(plc.coordinate_system(1).tool().await?.id, 3);
/// # Ok(()) }
/// ```
#[derive(Clone)]
pub struct Plc {
    port: Arc<dyn Port>,
    client_id: Arc<str>,
    commands: Arc<AtomicU64>,
}

impl std::fmt::Debug for Plc {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Plc")
            .field("client_id", &self.client_id)
            .finish_non_exhaustive()
    }
}

impl Plc {
    /// A machine in this process, such as `runtime.port()`.
    pub fn in_process(port: Arc<dyn Port>) -> Self {
        Self {
            port,
            client_id: unique_name("plc").into(),
            commands: Arc::default(),
        }
    }

    /// A machine at an address: `mqtt://host:port/machine`, with a topic prefix `mqtt://host:port/prefix/machine`,
    /// with a user `mqtt://user:password@host:port/machine`. The port is 1883 where none is named. Waits up to 10 s
    /// until the runtime is present there; after that the connection is made again by itself for ever.
    ///
    /// # Errors
    /// The address is not one, no broker answers there, it refuses the user, or no runtime is online under that name.
    #[cfg_attr(
        not(feature = "mqtt"),
        expect(clippy::unused_async, reason = "only transports wait")
    )]
    pub async fn connect(address: &str) -> Result<Self> {
        let wrong = |reason: &str| Error::Address {
            address: address.to_owned(),
            reason: reason.to_owned(),
        };
        match address.split_once("://") {
            #[cfg(feature = "mqtt")]
            Some(("mqtt", _)) => {
                let port = crate::transport::mqtt::connect(address).await?;
                Ok(Self::in_process(port))
            }
            #[cfg(not(feature = "mqtt"))]
            Some(("mqtt", _)) => Err(wrong("plc-api was built without its feature mqtt")),
            Some(("mqtts", _)) => Err(wrong("TLS is not built yet, use mqtt://")),
            Some(("http" | "https", _)) => Err(wrong("the REST transport is not built yet, use mqtt://")),
            _ => Err(wrong("write mqtt://host:port/machine")),
        }
    }

    /// The port under this machine, for requests that have no method here.
    pub fn port(&self) -> &Arc<dyn Port> {
        &self.port
    }

    /// One CNC coordinate system, by its number from 1. A number that does not exist is an error of each call on it.
    pub fn coordinate_system(&self, number: CoordinateSystemNumber) -> CoordinateSystem {
        CoordinateSystem::new(self.clone(), number)
    }

    /// Programs of the store, ascending.
    ///
    /// # Errors
    /// A refusal, such as over a transport that does not carry programs.
    pub async fn programs(&self) -> Result<Vec<ProgramInfo>> {
        match self.request(Request::Programs).await? {
            Answer::Programs(programs) => Ok(programs),
            other => Err(unexpected(&other)),
        }
    }

    /// Sleeps on the machine's clock: simulated time in a simulation. Handlers sleep by this and nothing else.
    pub async fn sleep(&self, duration: Duration) {
        self.port.sleep(duration).await;
    }

    /// Seconds since the start on the machine's clock.
    pub fn now_s(&self) -> f64 {
        self.port.now_s()
    }

    /// The raw queue of auxiliary function outputs of all coordinate systems, for programs that are not made of
    /// handlers. [`SequenceProgram`](crate::SequenceProgram) is the usual way.
    pub fn outputs(&self) -> Outputs {
        Outputs::new(self, unique_name("queue"))
    }

    pub(crate) async fn request(&self, request: Request) -> Result<Answer> {
        Ok(self.port.request(request).await?)
    }

    /// Client id and a fresh command id.
    pub(crate) fn command_names(&self) -> (String, String) {
        let number = self.commands.fetch_add(1, Ordering::Relaxed);
        (self.client_id.to_string(), format!("{}-{number}", self.client_id))
    }
}

pub(crate) fn unexpected(answer: &Answer) -> Error {
    let text = format!("the machine gave an answer of another kind: {answer:?}");
    Error::Refused(Refusal::new(RefusalCode::Invalid, text))
}

/// A name that no other process and no other call has.
pub(crate) fn unique_name(kind: &str) -> String {
    use std::hash::{BuildHasher, Hasher, RandomState};
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let mut hasher = RandomState::new().build_hasher();
    hasher.write_u32(std::process::id());
    hasher.write_u64(COUNT.fetch_add(1, Ordering::Relaxed));
    format!("{kind}-{:012x}", hasher.finish() & 0xffff_ffff_ffff)
}
