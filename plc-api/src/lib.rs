//! Sequence-control API of the Tandem runtime: the PLC side of an NC machine, in Rust.
//!
//! An NC program commands the machine by M codes with parameters, such as `M100 VA3`. Each M code is an
//! *output* of the NC program to the PLC: the program waits until the PLC has done the work and sends the
//! *reset* of that output. A *sequence program* does this work: one async function, a *handler*, for each M
//! code. The same sequence program runs in the runtime's process ([`Plc::in_process`]), in another process
//! over MQTT or REST ([`Plc::connect`]), and in a unit test ([`fake::FakePort`]).
//!
//! # A sequence program
//! `tandem init DIR` creates a project with a sequence program and a test. In any other project, add the
//! dependencies `plc-api` and `tokio` (features `macros`, `rt-multi-thread`). The address below is that of
//! the demo machine, which `tandem` without arguments starts.
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
//! If the handler returns `Ok`, the output is reset and the NC program continues. If the handler returns
//! `Err`, the NC program stops with alarm 10000 + code and the text of the `Err`. A panic also stops the NC
//! program with an alarm. The handlers of several open outputs run concurrently.
//!
//! # Parameters and shared state
//! A handler of an M code with a name, [`MCode`], takes its parameters as [typed arguments](extract):
//! `Va<KiloNewton<1, 20>>`, or a struct with `#[derive(Params)]`. The parameters are checked against these
//! declarations when an NC program is loaded and before the handler starts. Panels show the declarations.
//!
//! For an M code without a name, [`Params`](struct@Params) holds VA to VH; a parameter that is not programmed
//! is `None`. [`validate`](SequenceProgram::validate) adds a check of the parameters at program load: an NC
//! program with invalid parameters is not loaded. Handlers share state by [`handlers::with`].
//! [`Plc::coordinate_system`] gives access to axes, tools and inputs, [`Plc::variables`] to variables,
//! [`Plc::alarms`] to alarms.
//! ```
//! use std::sync::{Arc, Mutex};
//! use plc_api::{Alarm, AuxOutput, Params, Plc, SequenceProgram, handlers::with};
//!
//! /// Parts in the tray, shared by M60 and M61.
//! type Tray = Arc<Mutex<u32>>;
//!
//! /// VA: how many parts, 1 to 20.
//! fn parts(params: &Params) -> Result<u32, Alarm> {
//!     match params.a() {
//!         Some(parts) if (1.0..=20.0).contains(&parts) => Ok(parts as u32),
//!         other => Err(Alarm::user(60, format!("VA is {other:?}; write 1 to 20"))),
//!     }
//! }
//!
//! async fn fill(output: AuxOutput, plc: Plc, tray: Tray) -> Result<(), Alarm> {
//!     let parts = parts(output.params())?;
//!     *tray.lock().unwrap() += parts;
//!     plc.variables().set(200, f64::from(parts)).await?; // the next block reads P200
//!     Ok(())
//! }
//!
//! async fn empty(_output: AuxOutput, _plc: Plc, tray: Tray) -> Result<(), Alarm> {
//!     *tray.lock().unwrap() = 0;
//!     Ok(())
//! }
//!
//! let tray = Tray::default();
//! let program = SequenceProgram::new()
//!     .on(60, with(Arc::clone(&tray), fill))
//!     .validate(60, parts)
//!     .on(61, with(tray, empty));
//! assert_eq!(program.check(), Ok(()));
//! ```
//!
//! # Progress and questions
//! While the NC program waits, [`AuxOutput::progress`] reports how far the work is, and [`AuxOutput::ask`]
//! asks the operator and waits for one of the choices. Panels show both; [`CoordinateSystem::answer`] answers
//! a question.
//! ```
//! # use plc_api::{Alarm, AuxOutput};
//! async fn inspect(output: AuxOutput) -> Result<(), Alarm> {
//!     output.progress("the part is brought to the window", None).await?;
//!     match output.ask("Is the surface good?", ["yes", "no"]).await?.as_str() {
//!         "yes" => Ok(()),
//!         _ => Err(Alarm::user(80, "the operator rejects the part")),
//!     }
//! }
//! ```
//!
//! # Cancellation
//! A stop, a reset of the coordinate system or an alarm cancels open outputs: the future of the handler is
//! dropped at its current await point. Put an action that must happen at once into a destructor, and an
//! action that takes time into [`AuxOutput::on_cancel`]. Work in other tasks watches
//! [`AuxOutput::cancellation`]. Handlers use only the clock of the machine, which runs in simulated time in a
//! simulation: [`Plc::sleep`], [`Plc::timeout`], [`Plc::interval`].
//! ```
//! use std::time::Duration;
//! use plc_api::{Alarm, AuxOutput, CancelReason, Cancellation, Params, Plc, SequenceProgram, fake::FakePort};
//!
//! /// The pump runs until this value is dropped, however its handler ends.
//! struct Pump(Cancellation);
//!
//! impl Drop for Pump {
//!     fn drop(&mut self) {
//!         // switch the pump off here
//!         if self.0.is_cancelled() {
//!             println!("the pump stops: {:?}", self.0.reason());
//!         }
//!     }
//! }
//!
//! async fn rinse(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
//!     let _pump = Pump(output.cancellation());
//!     plc.sleep(Duration::from_secs(30)).await;
//!     Ok(())
//! }
//! # #[tokio::main(flavor = "current_thread")] async fn main() {
//! # let fake = FakePort::new([1]);
//! # let plc = fake.plc();
//! # tokio::spawn(async move { SequenceProgram::new().on(8, rinse).run(&plc).await });
//! # let seq = fake.issue_output(1, 8, Params::default());
//! # fake.advance(Duration::from_secs(1)).await;
//! # fake.cancel(1, CancelReason::Stop);
//! # fake.settle().await;
//! # assert!(fake.pending(1).is_empty());
//! # }
//! ```
//!
//! # Redelivery
//! If the process of a handler ends before the reset, the output is open again, and the NC program waits with
//! reason `HANDLER_LOST`. No work is repeated automatically:
//! [`on_redelivery`](SequenceProgram::on_redelivery) defines the action of the restarted sequence program. By
//! default the output waits for the decision of an operator. With [`Redelivery::Verify`] the handler runs
//! again with [`AuxOutput::redelivered`] true, and checks the machine first.
//! ```
//! use plc_api::{Alarm, AuxOutput, Redelivery, SequenceProgram};
//!
//! async fn close_door(output: AuxOutput) -> Result<(), Alarm> {
//!     if output.redelivered() && door_is_closed() {
//!         return Ok(()); // the door was closed before the process ended
//!     }
//!     // ... close it ...
//!     Ok(())
//! }
//! # fn door_is_closed() -> bool { true }
//!
//! let program = SequenceProgram::new()
//!     .on(40, close_door)
//!     .handler_id("door") // the machine recognizes the restarted program by this name
//!     .on_redelivery(Redelivery::Verify);
//! assert_eq!(program.check(), Ok(()));
//! ```
//!
//! # Levels, alarms and tasks
//! A program can also contain parts that serve no M code. Levels hold the machine
//! ([`SequenceProgram::interlock`]), refuse a start ([`SequenceProgram::start_lock`]) or raise an alarm
//! ([`SequenceProgram::alarm_while`]). Tasks ([`SequenceProgram::task`]) run next to the handlers. These
//! parts continue after every loss of the connection, and start again with each start of the machine.
//! [`SequenceProgram::merge`] combines the programs of several parts of a machine.
//!
//! # Several commanding programs
//! If several programs command one machine, a program takes the control lease of a coordinate system before
//! it starts motion ([`CoordinateSystem::take_lease`]). Until the lease is released or dropped, no other
//! client can start motion in that coordinate system.
//!
//! # Watching each other
//! If the machine must not continue without a program, that program sends heartbeats ([`Plc::heartbeat`]). If
//! the heartbeats stop, the machine holds all runs. A program that moves an actuator itself watches the
//! machine ([`Plc::until_silent`]).
//!
//! # Scan style
//! For a program in the style of PLC scans, write a [`scan::ScanProgram`]. At a fixed period it reads M
//! codes, states, inputs and variables as flags, and writes resets, inputs and commands as flags.
//! [`SequenceProgram::scan`] runs the scan program together with handlers. [`function_blocks`] has the edges,
//! timers and counters of IEC 61131-3.
//!
//! # Without handlers
//! A program with its own loop receives outputs from the raw queue, [`Plc::outputs`], and claims and resets
//! the outputs itself; dropping the queue releases its claims. Every program may also command the machine as
//! a panel does: commands and inputs are methods of [`CoordinateSystem`].
//!
//! # Testing
//! [`fake::FakePort`] is a scripted machine: the test issues outputs and advances the time, as in the example
//! of [`SequenceProgram`]. `tandem_testing` (a dev-dependency) is a whole runtime that runs NC programs with
//! motion in simulated time.
//!
//! # Layers
//! [`port::Port`] is the whole interface as one trait; [`types`] contains the messages and requests that
//! sequence programs use. Programs that implement a transport or a server, or that use further requests of
//! [`Plc::port`], depend on the crate [`plc_protocol`]. That crate contains all messages and requests, the
//! state machine of outputs and resets, and the commands that are allowed in each state. A number such as D16
//! names a decision on how the runtime interprets the NC language; a number such as H4 names a rule of the
//! [handshake](plc_protocol::handshake::rules).
//!
//! # Compatibility
//! A release without a new major version (before 1.0: without a new minor version) may add variants to
//! enumerations that are `#[non_exhaustive]`, and members to messages (the structs of [`types`]). Read
//! members by their names, end a pattern with `..`, and create a message by its constructor or from its
//! `Default`.
//!
//! Features: `mqtt` (default) is the MQTT client, with TLS; `rest` is the client for REST and WebSocket.
//! Without these features the crate has few dependencies except tokio and serde.

// the code that the derive macro generates uses this name of the crate
extern crate self as plc_api;

mod alarm_level;
mod ask;
mod aux_output;
mod changes;
mod claim;
mod coordinate_system;
pub mod extract;
pub mod fake;
pub mod function_blocks;
mod handler_session;
pub mod handlers;
mod heartbeat;
mod identity;
mod io;
mod lease;
mod levels;
mod limited_port;
mod lock_guard;
mod m_codes;
mod outputs;
mod plc;
mod run;
pub mod scan;
mod states;
mod stop_signal;
mod tables;
mod time;
pub mod types;
pub mod units;
mod variables;

/// Subscriptions to the messages of a machine.
pub mod hub {
    pub use plc_protocol::hub::{Filter, Subscription};
}

/// The interface of a machine as one trait.
pub mod port {
    pub use plc_protocol::port::Port;
}

pub use ask::OpenQuestion;
pub use changes::Changes;
pub use coordinate_system::CoordinateSystem;
pub use extract::{HandlerState, Va, Vb, Vc, Vd, Ve, Vf, Vg, Vh};
pub use handlers::{AuxOutput, Cancellation, SequenceProgram};
pub use heartbeat::HeartbeatGuard;
pub use io::{Io, IoChanges};
pub use lease::LeaseGuard;
pub use lock_guard::LockGuard;
pub use m_codes::MCode;
pub use outputs::{Outputs, RawOutput};
pub use plc::Plc;
pub use plc_api_derive::Params;
pub use plc_protocol::alarm::{Alarm, UserAlarm};
pub use plc_protocol::error::{Error, Result};
#[cfg(any(feature = "mqtt", feature = "rest"))]
pub use plc_protocol::transport::options::MqttOptions;
#[cfg(any(feature = "mqtt", feature = "rest"))]
pub use plc_protocol::transport::tls::TlsFiles;
pub use plc_protocol::types::output::{CancelReason, Params, Redelivery};
pub use plc_protocol::types::state::Execution;
pub use run::OrderedRun;
pub use stop_signal::stop_signal;
pub use time::Interval;
pub use variables::Variables;
