//! The standard function blocks of IEC 61131-3, for programs in scan style.
//!
//! | IEC 61131-3 | here | |
//! | --- | --- | --- |
//! | `R_TRIG`, `F_TRIG` | [`RisingEdge`], [`FallingEdge`] | edges |
//! | `SR`, `RS` | [`SetDominant`], [`ResetDominant`] | bistable elements |
//! | `TON`, `TOF`, `TP` | [`OnDelay`], [`OffDelay`], [`Pulse`] | timers |
//! | `CTU`, `CTD`, `CTUD` | [`UpCounter`], [`DownCounter`], [`UpDownCounter`] | counters |
//!
//! A function block is a value that a program keeps from scan to scan. The program calls `update` once in
//! each scan with the inputs of the block. `update` returns the output of the block, which stays readable
//! until the next call. Timers receive the time of the scan, [`Image::now`]. Thus in a simulation the timers
//! run in simulated time, and all timers of a scan use the same time.
//!
//! ```
//! use std::time::Duration;
//! use plc_api::function_blocks::{OnDelay, RisingEdge, UpCounter};
//! use plc_api::scan::{Image, ScanProgram};
//! use plc_api::{Alarm, Params, SequenceProgram, fake::{FakePort, OutputOutcome}};
//!
//! /// M50 counts a part, and is done when the gripper has been closed for 0.2 s.
//! struct Gripper {
//!     counted: RisingEdge,
//!     parts: UpCounter,
//!     settled: OnDelay,
//! }
//!
//! impl ScanProgram for Gripper {
//!     fn scan(&mut self, image: &mut Image) {
//!         let is_on = image.is_on(1, 50);
//!         let is_new = self.counted.update(is_on);
//!         if self.parts.update(is_new, false) {
//!             image.fail(1, 50, Alarm::user(50, "the tray is full"));
//!         } else if self.settled.update(is_on, image.now()) {
//!             image.reset(1, 50);
//!         }
//!     }
//! }
//!
//! # #[tokio::main(flavor = "current_thread")] async fn main() {
//! # let fake = FakePort::new([1]);
//! # let plc = fake.plc();
//! let gripper = Gripper {
//!     counted: RisingEdge::default(),
//!     parts: UpCounter::new(2),
//!     settled: OnDelay::new(Duration::from_millis(200)),
//! };
//! let program = SequenceProgram::new().scan(50, Duration::from_millis(10), gripper);
//! # tokio::spawn(async move { program.run(&plc).await });
//! # fake.settle().await;
//! # let first = fake.issue_output(1, 50, Params::default());
//! # fake.advance(Duration::from_millis(200)).await;
//! # assert_eq!(fake.closed(1, first), None);
//! # fake.advance(Duration::from_millis(20)).await;
//! # assert_eq!(fake.closed(1, first), Some(OutputOutcome::Reset));
//! # let second = fake.issue_output(1, 50, Params::default());
//! # fake.advance(Duration::from_millis(20)).await;
//! # assert!(matches!(fake.closed(1, second), Some(OutputOutcome::Failed { .. })));
//! # }
//! ```
//!
//! [`Image::now`]: crate::scan::Image::now

mod bistable;
mod counter;
mod edge;
mod timer;

pub use bistable::{ResetDominant, SetDominant};
pub use counter::{DownCounter, UpCounter, UpDownCounter};
pub use edge::{FallingEdge, RisingEdge};
pub use timer::{OffDelay, OnDelay, Pulse};
