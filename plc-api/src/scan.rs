//! Scan style: a program that runs cyclically at a fixed period, as in a PLC.
//!
//! Before each scan the state of the machine is copied into an [`Image`]: M codes as flags with their
//! parameters, state words, inputs, inputs and outputs of the plant, overrides, captured positions, and the
//! positions and variables that [`ScanProgram::reads`] requests. The values in the image do not change during
//! the scan. The scan reads these values, and writes resets, failures, inputs, overrides and commands into
//! the image. These writes are executed after the scan.
//!
//! Claims, resets and cancellations work as for handlers. If an output is cancelled, its M code is off in the
//! next image. A reset applies only to the output that the image shows, and never to another output.
//!
//! ```
//! use std::time::Duration;
//! use plc_api::scan::{Image, ScanProgram};
//! use plc_api::{Alarm, Params, SequenceProgram, fake::{FakePort, OutputOutcome}};
//!
//! /// M10 closes the clamp, M11 opens the clamp; each takes half a second.
//! #[derive(Default)]
//! struct Clamp {
//!     since_s: Option<f64>,
//! }
//!
//! impl ScanProgram for Clamp {
//!     fn scan(&mut self, image: &mut Image) {
//!         let moves = image.is_on(1, 10) || image.is_on(1, 11);
//!         let since_s = *self.since_s.get_or_insert(image.time_s());
//!         if !moves {
//!             self.since_s = None;
//!         } else if image.time_s() - since_s >= 0.5 {
//!             image.reset(1, 10);
//!             image.reset(1, 11);
//!         }
//!     }
//! }
//!
//! # #[tokio::main(flavor = "current_thread")] async fn main() {
//! # let fake = FakePort::new([1]);
//! # let plc = fake.plc();
//! let program = SequenceProgram::new().scan(10..=11, Duration::from_millis(10), Clamp::default());
//! # tokio::spawn(async move { program.run(&plc).await });
//! # let seq = fake.issue_output(1, 10, Params::default());
//! # fake.advance(Duration::from_millis(490)).await;
//! # assert_eq!(fake.closed(1, seq), None);
//! # fake.advance(Duration::from_millis(30)).await;
//! # assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
//! # }
//! ```
//!
//! Write a flag of the machine like an output of a PLC: in every scan, with the value that the flag must
//! have. The flag is sent only if this value differs from the current value of the machine.
//!
//! ```
//! use plc_api::scan::{Image, Reads, ScanProgram};
//! use plc_api::types::request::OverrideChange;
//! # use std::time::Duration;
//! # use plc_api::{SequenceProgram, fake::FakePort};
//!
//! /// An open door holds the motion, and P100 is the highest feed override.
//! struct Guard;
//!
//! impl ScanProgram for Guard {
//!     fn reads(&self) -> Reads {
//!         Reads::default().p(100, 1)
//!     }
//!
//!     fn scan(&mut self, image: &mut Image) {
//!         let door_is_open = door_input();
//!         image.set_interlock(1, door_is_open, "the door is open");
//!         if let Some(allowed) = image.p(100).filter(|allowed| *allowed > 0.0) {
//!             let feed = Some(allowed.min(100.0));
//!             image.set_overrides(1, OverrideChange { feed, ..OverrideChange::default() });
//!         }
//!     }
//! }
//! # fn door_input() -> bool { true }
//!
//! # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
//! # let fake = FakePort::new([1]);
//! # let plc = fake.plc();
//! # plc.variables().set(100, 30.0).await?;
//! let program = SequenceProgram::new().scan([], Duration::from_millis(10), Guard);
//! # tokio::spawn(async move { program.run(&plc).await });
//! # fake.advance(Duration::from_millis(15)).await;
//! # let mill = fake.plc().coordinate_system(1);
//! # assert!(mill.interlock().await?.value);
//! # assert_eq!(mill.overrides().await?.feed, 30.0);
//! # Ok(()) }
//! ```

mod flags;
mod image;
mod operator;
mod scan_question;
mod watch;
mod writer;
mod writes;

use std::panic::AssertUnwindSafe;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use plc_protocol::error::{Error, Result};
use plc_protocol::lock::lock;
use plc_protocol::supervisor::panic_text;

use crate::handlers::{AuxOutput, MCodes, SequenceProgram};
use crate::plc::Plc;

use flags::Flags;
use image::Camera;
pub use image::{Image, Reads};
use watch::CycleWatch;
use writer::Writer;

/// Shortest period of a scan. Reason: the clocks have a resolution of 1 ms.
pub const SCAN_PERIOD_MIN: Duration = Duration::from_millis(1);

/// A program in scan style. A scan must not block: a program that needs several scans for its work keeps the
/// state of the work from scan to scan.
///
/// A closure `FnMut(&mut Image)` implements this trait.
pub trait ScanProgram: Send + 'static {
    /// Returns the positions and variables to read before each scan. Called once, before the first scan.
    fn reads(&self) -> Reads {
        Reads::default()
    }

    /// Returns the time limit of a scan, from its image to its last write; `None` means the period of the
    /// scan. Called once, before the first scan. A scan that takes longer than the limit causes a warning in
    /// the log and increments [`Image::late_scans`]. A period in which no scan can start is skipped and
    /// increments [`Image::overruns`].
    fn cycle_limit(&self) -> Option<Duration> {
        None
    }

    /// Executes one scan: reads and writes the image.
    fn scan(&mut self, image: &mut Image);
}

impl<F: FnMut(&mut Image) + Send + 'static> ScanProgram for F {
    fn scan(&mut self, image: &mut Image) {
        self(image);
    }
}

impl<Scope> SequenceProgram<Scope> {
    /// Adds a program in scan style for these M codes, see [`scan`](crate::scan). In the image of this
    /// program, the M codes can be on only for the coordinate systems of this scope. The list of M codes may
    /// be empty, `[]`. The period is at least 1 ms.
    #[must_use]
    pub fn scan(mut self, codes: impl MCodes, period: Duration, program: impl ScanProgram) -> Self {
        let flags = Flags::default();
        let codes = codes.m_codes();
        if !codes.is_empty() {
            let of_scan = flags.clone();
            self.serve(&codes, move |output: AuxOutput| of_scan.clone().on(output));
        }
        if period < SCAN_PERIOD_MIN {
            self.add_mistake(format!("the period of a scan is at least {SCAN_PERIOD_MIN:?}"));
        }
        let scan = Scan {
            flags,
            period,
            program: Arc::new(Mutex::new(program)),
        };
        self.add_companion(move |plc| Box::pin(scan.clone().run(plc)))
    }
}

/// A scan program with the flags of its M codes.
#[derive(Clone)]
struct Scan {
    flags: Flags,
    period: Duration,
    program: Arc<Mutex<dyn ScanProgram>>,
}

impl Scan {
    /// Runs the scan program at its period; does not return except with an error.
    ///
    /// # Errors
    /// Fails if the scan program panics.
    async fn run(self, plc: Plc) -> Result<()> {
        let period_s = self.period.as_secs_f64();
        let (mut scans, mut overruns) = (0, 0);
        let mut writer = Writer::default();
        let (reads, limit) = guarded(|| {
            let program = lock(&self.program);
            (program.reads(), program.cycle_limit())
        })?;
        let mut camera = Camera::new(&plc, reads);
        let mut watch = CycleWatch::new(limit.unwrap_or(self.period));
        let mut next_s = plc.now_s();
        loop {
            let refusals = writer.take_refusals();
            let begin_s = plc.now_s();
            let counts = (scans, overruns, watch.times);
            let mut image = camera.image(&self.flags, counts, refusals).await;
            guarded(|| lock(&self.program).scan(&mut image))?;
            writer.execute_writes(&plc, &self.flags, image).await;
            scans += 1;
            let end_s = plc.now_s();
            if let Some(report) = watch.ended(end_s - begin_s, end_s) {
                tracing::warn!(period = ?self.period, "{report}");
            }
            next_s += period_s;
            while next_s < plc.now_s() {
                next_s += period_s;
                overruns += 1;
            }
            let left_s = (next_s - plc.now_s()).max(0.0);
            plc.sleep(Duration::try_from_secs_f64(left_s).unwrap_or(Duration::MAX))
                .await;
        }
    }
}

/// Calls a function of the scan program. A panic of this function ends the sequence program, not the process.
fn guarded<T>(use_it: impl FnOnce() -> T) -> Result<T> {
    std::panic::catch_unwind(AssertUnwindSafe(use_it)).map_err(|panicked| {
        Error::SequenceProgram(format!("the scan program panicked: {}", panic_text(&*panicked)))
    })
}
