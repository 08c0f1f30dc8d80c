//! Sequence-control API of the Tandem runtime: the PLC side of an NC machine, in Rust.
//!
//! An NC program puts out M codes with parameters (`M100 VA3`), and waits until each is reset. A *sequence program* is
//! what works on them: one async function for each M code. It runs in the runtime's own process
//! ([`Plc::in_process`]), in another process over MQTT or REST ([`Plc::connect`]) and in a unit test ([`fake::FakePort`]),
//! unchanged.
//!
//! # A sequence program
//! ```no_run
//! use plc_api::{Alarm, AuxOutput, Plc, SequenceProgram};
//!
//! #[tokio::main]
//! async fn main() -> plc_api::Result<()> {
//!     let plc = Plc::connect("mqtt://127.0.0.1:1883/mill-1").await?;
//!     SequenceProgram::new()
//!         .on(100, change_tool)                               // one M code
//!         .on(10..=13, clamp)                                 // a range
//!         .in_coordinate_system(2, |cs| cs.on(20, eject))     // in one coordinate system only
//!         .run(&plc)
//!         .await
//! }
//!
//! async fn change_tool(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
//!     let tool = output.params().a().ok_or(Alarm::user(1, "M100 needs VA"))? as u16;
//!     output.progress("the magazine turns", 50.0).await?;
//!     plc.coordinate_system(output.coordinate_system()).select_tool(tool).await?;
//!     Ok(())
//! }
//! # async fn clamp(_: AuxOutput) -> Result<(), Alarm> { Ok(()) }
//! # async fn eject(_: AuxOutput) -> Result<(), Alarm> { Ok(()) }
//! ```
//!
//! `Ok` resets the output, and the NC program goes on. `Err` raises alarm 10000 + code with its text and stops the
//! program; a panic does the same. Several open outputs run their handlers at the same time.
//!
//! What a handler shares with others it gets by [`handlers::with`]. Which parameters it takes it may say beforehand:
//! with [`validate`](SequenceProgram::validate) a program with wrong ones is refused when it is loaded.
//!
//! # While the program waits
//! [`AuxOutput::progress`] says how far the work is. [`Plc::ask`] asks the operator and waits for one of the choices;
//! panels show the question with the M code, and [`CoordinateSystem::answer`] answers it.
//! ```
//! # use plc_api::{Alarm, AuxOutput, Plc};
//! async fn inspect(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
//!     output.progress("the part is brought to the window", None).await?;
//!     match plc.ask("Is the surface good?", ["yes", "no"]).await?.as_str() {
//!         "yes" => Ok(()),
//!         _ => Err(Alarm::user(80, "the operator rejects the part")),
//!     }
//! }
//! ```
//!
//! # Cancel
//! A stop, a reset or an alarm cancels open outputs: the handler's future is dropped where it waits, and what it
//! started elsewhere sees it by [`AuxOutput::cancellation`]. Handlers sleep by [`Plc::sleep`], never by another clock.
//!
//! # Redelivery
//! A handler whose process dies gives its output back: the program waits, with reason `HANDLER_LOST`. Nothing is done
//! twice without being asked: what happens when the sequence program is there again is its
//! [`on_redelivery`](SequenceProgram::on_redelivery), by default to wait for an operator. With
//! [`Redelivery::Verify`] the handler runs again with [`AuxOutput::redelivered`] true, and looks at the machine first.
//!
//! # Two commanders
//! A program that starts and stops a machine which others command, too, takes its control lease first
//! ([`CoordinateSystem::take_lease`]): until that is released or dropped, nobody else starts motion there.
//!
//! # Scan style
//! Who thinks in PLC scans writes a [`scan::ScanProgram`]: at a fixed period it sees M codes as flags with parameters
//! and writes resets as flags. [`SequenceProgram::scan`] serves it beside handlers.
//!
//! # Testing
//! [`fake::FakePort`] is a scripted machine: outputs are made by hand, and time goes on by hand. A whole runtime that
//! runs NC programs in simulated time is `tandem_runtime::test`, a dev-dependency.
//! ```
//! use std::time::Duration;
//! use plc_api::{Alarm, AuxOutput, Params, Plc, SequenceProgram, fake::FakePort, handshake::Closed};
//!
//! async fn drill(_output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
//!     plc.sleep(Duration::from_secs(600)).await;
//!     Ok(())
//! }
//!
//! # #[tokio::main(flavor = "current_thread")] async fn main() {
//! let fake = FakePort::new([1]);
//! let plc = fake.plc();
//! tokio::spawn(async move { SequenceProgram::new().on(20, drill).run(&plc).await });
//! let seq = fake.put_out(1, 20, Params::default());
//! fake.advance(Duration::from_secs(599)).await;
//! assert_eq!(fake.closed(1, seq), None);
//! fake.advance(Duration::from_secs(1)).await;
//! assert_eq!(fake.closed(1, seq), Some(Closed::Reset));
//! # }
//! ```
//!
//! # Layers
//! [`port::Port`] is the whole interface as one trait; [`types`] is all that crosses a wire; [`handshake`] is the state
//! machine of outputs and resets that every transport goes through; [`hub`] hands messages out.
//! Features: `mqtt` (default) is the MQTT client, with TLS; `schema` derives JSON Schemas of the types.

pub mod alarm;
mod ask;
mod coordinate_system;
mod error;
pub mod fake;
pub mod handlers;
pub mod handshake;
pub mod hub;
mod lease;
mod outputs;
mod plc;
pub mod port;
pub mod scan;
mod tables;
mod text;
pub mod transport;
pub mod types;
mod variables;

pub use alarm::Alarm;
pub use ask::OpenQuestion;
pub use coordinate_system::CoordinateSystem;
pub use error::{Error, Result};
pub use handlers::{AuxOutput, Cancellation, SequenceProgram};
pub use lease::Lease;
pub use outputs::{Outputs, RawOutput};
pub use plc::Plc;
#[cfg(feature = "mqtt")]
pub use transport::mqtt::MqttOptions;
#[cfg(feature = "mqtt")]
pub use transport::tls::TlsFiles;
pub use types::output::{CancelReason, Params, Redelivery};
pub use types::state::Execution;
pub use variables::Variables;
