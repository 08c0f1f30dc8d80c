//! The scan-cycle style: a program that is run over and over at a fixed period, as in a PLC.
//!
//! Before each scan everything from outside is copied into an [`Image`]; outputs of the NC program stand there as flags
//! with their parameters. The scan reads flags and writes flags: a reset, a failure, a command. What it has written is
//! carried out after the scan. Between two scans nothing in the image changes.
//!
//! Underneath are the same handshake, claims and cancels as for handlers: an output that is cancelled is off in the next
//! image, and a reset never reaches another output than the one that the image shows.
//!
//! ```
//! use std::time::Duration;
//! use plc_api::scan::{Image, ScanProgram};
//! use plc_api::{Alarm, Params, SequenceProgram, fake::FakePort, handshake::Closed};
//!
//! /// M10 closes the clamp, M11 opens it; each takes half a second.
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
//! # let seq = fake.put_out(1, 10, Params::default());
//! # fake.advance(Duration::from_millis(490)).await;
//! # assert_eq!(fake.closed(1, seq), None);
//! # fake.advance(Duration::from_millis(30)).await;
//! # assert_eq!(fake.closed(1, seq), Some(Closed::Reset));
//! # }
//! ```

use std::collections::BTreeMap;
use std::panic::AssertUnwindSafe;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::oneshot;

use crate::alarm::Alarm;
use crate::error::{Error, Result};
use crate::handlers::{AuxOutput, panic_words};
use crate::plc::Plc;
use crate::types::CoordinateSystemNumber;
use crate::types::command::{Command, CommandMeta};
use crate::types::message::Payload;
use crate::types::output::Params;
use crate::types::request::{Request, SpindleCommand};
use crate::types::state::{Execution, SpindleDirection, State};
use crate::types::topic::{CsTopic, Topic};

/// Shortest period of a scan. Reason: the clocks that it sleeps on count milliseconds.
pub const SCAN_PERIOD_MIN: Duration = Duration::from_millis(1);

/// A program in the scan-cycle style. It must not wait: what takes time is a state that a later scan looks at.
///
/// A closure `FnMut(&mut Image)` is one, too.
pub trait ScanProgram: Send + 'static {
    /// One scan: reads the image and writes into it.
    fn scan(&mut self, image: &mut Image);
}

impl<F: FnMut(&mut Image) + Send + 'static> ScanProgram for F {
    fn scan(&mut self, image: &mut Image) {
        self(image);
    }
}

/// The machine as one scan sees it, and what the scan writes. Coordinate systems are named by number; one that does not
/// exist has no output on, and what is written to it goes nowhere.
#[derive(Debug, Default)]
pub struct Image {
    time_s: f64,
    scans: u64,
    overruns: u64,
    on: BTreeMap<(CoordinateSystemNumber, u16), AuxOutput>,
    states: BTreeMap<CoordinateSystemNumber, State>,
    answers: BTreeMap<(CoordinateSystemNumber, u16), std::result::Result<(), Alarm>>,
    progress: Vec<(AuxOutput, String, Option<f64>)>,
    requests: Vec<(CoordinateSystemNumber, Wanted)>,
}

/// What a scan has written, beside answers.
#[derive(Debug)]
enum Wanted {
    Command(Command),
    Tool(u16),
    Spindle(SpindleCommand),
}

impl Image {
    /// Seconds on the machine's clock when the image was made.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Scans before this one; 0 in the first.
    pub fn scans(&self) -> u64 {
        self.scans
    }

    /// Periods that passed without a scan because the one before took too long.
    pub fn overruns(&self) -> u64 {
        self.overruns
    }

    /// True while an M code is put out and not answered. Only codes that were given to the scan program are ever on.
    pub fn is_on(&self, cs: CoordinateSystemNumber, m: u16) -> bool {
        self.output(cs, m).is_some()
    }

    /// The output of an M code that is on, with program, line, and whether it was delivered before.
    pub fn output(&self, cs: CoordinateSystemNumber, m: u16) -> Option<&AuxOutput> {
        self.on.get(&(cs, m))
    }

    /// VA to VH of an M code that is on.
    pub fn params(&self, cs: CoordinateSystemNumber, m: u16) -> Option<&Params> {
        self.output(cs, m).map(AuxOutput::params)
    }

    /// State word of a coordinate system; STOPPED where there is none.
    pub fn execution(&self, cs: CoordinateSystemNumber) -> Execution {
        self.state(cs).map(|state| state.execution).unwrap_or_default()
    }

    /// State of a coordinate system.
    pub fn state(&self, cs: CoordinateSystemNumber) -> Option<&State> {
        self.states.get(&cs)
    }

    /// Writes the reset flag of an M code: its program goes on. Without effect while it is off, so that it may be
    /// written in every scan.
    pub fn reset(&mut self, cs: CoordinateSystemNumber, m: u16) {
        self.answer(cs, m, Ok(()));
    }

    /// Fails an M code: the alarm stops its program. Without effect while it is off.
    pub fn fail(&mut self, cs: CoordinateSystemNumber, m: u16, alarm: Alarm) {
        self.answer(cs, m, Err(alarm));
    }

    /// Tells how far the work on an M code is: [`AuxOutput::progress`]. Without effect while it is off.
    pub fn progress(
        &mut self,
        cs: CoordinateSystemNumber,
        m: u16,
        text: impl Into<String>,
        percent: impl Into<Option<f64>>,
    ) {
        if let Some(output) = self.on.get(&(cs, m)) {
            self.progress.push((output.clone(), text.into(), percent.into()));
        }
    }

    /// Commands a coordinate system. A refusal goes to the log; whether it had its effect the state tells.
    pub fn command(&mut self, cs: CoordinateSystemNumber, command: Command) {
        self.requests.push((cs, Wanted::Command(command)));
    }

    /// Tells which tool is in the spindle; 0: none.
    pub fn select_tool(&mut self, cs: CoordinateSystemNumber, id: u16) {
        self.requests.push((cs, Wanted::Tool(id)));
    }

    /// Commands the spindle; `rpm` counts for `Cw` and `Ccw`.
    pub fn set_spindle(&mut self, cs: CoordinateSystemNumber, direction: SpindleDirection, rpm: f64) {
        let command = SpindleCommand { direction, rpm };
        self.requests.push((cs, Wanted::Spindle(command)));
    }

    fn answer(&mut self, cs: CoordinateSystemNumber, m: u16, how: std::result::Result<(), Alarm>) {
        if self.is_on(cs, m) {
            self.answers.insert((cs, m), how);
        }
    }
}

/// Outputs that are on, and where their answers go.
#[derive(Clone, Default)]
pub(crate) struct Flags(Arc<Mutex<Vec<Flag>>>);

struct Flag {
    output: AuxOutput,
    answer: oneshot::Sender<std::result::Result<(), Alarm>>,
}

/// Takes a flag down when its output has ended, however it ended.
struct Down {
    flags: Flags,
    key: (CoordinateSystemNumber, u64),
}

impl Drop for Down {
    fn drop(&mut self) {
        self.flags.lock().retain(|flag| key(&flag.output) != self.key);
    }
}

fn key(output: &AuxOutput) -> (CoordinateSystemNumber, u64) {
    (output.coordinate_system(), output.seq())
}

impl Flags {
    /// The handler of every output of a scan program: on, until a scan answers.
    pub(crate) async fn on(self, output: AuxOutput) -> std::result::Result<(), Alarm> {
        let (answer, answered) = oneshot::channel();
        let _down = Down {
            key: key(&output),
            flags: self.clone(),
        };
        self.lock().push(Flag { output, answer });
        match answered.await {
            Ok(answer) => answer,
            // the program has ended, and this future ends with it
            Err(_) => std::future::pending().await,
        }
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Flag>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Gives an answer to the output that the image showed, and to no other.
    fn answer(&self, output: &AuxOutput, how: std::result::Result<(), Alarm>) {
        let mut flags = self.lock();
        if let Some(place) = flags.iter().position(|flag| key(&flag.output) == key(output)) {
            // cancelled meanwhile: nobody waits for the answer
            let _cancelled = flags.remove(place).answer.send(how);
        }
    }
}

/// A scan program and what it works on.
#[derive(Clone)]
pub(crate) struct Scan {
    pub(crate) flags: Flags,
    pub(crate) period: Duration,
    pub(crate) program: Arc<Mutex<dyn ScanProgram>>,
}

impl Scan {
    /// Scans at the period for ever.
    ///
    /// # Errors
    /// The scan program panicked.
    pub(crate) async fn run(self, plc: Plc) -> Result<()> {
        let period_s = self.period.as_secs_f64();
        let (mut scans, mut overruns) = (0, 0);
        let mut next_s = plc.now_s();
        loop {
            let mut image = self.image(&plc).await;
            (image.scans, image.overruns) = (scans, overruns);
            self.scan(&mut image)?;
            self.carry_out(&plc, image).await;
            scans += 1;
            next_s += period_s;
            while next_s < plc.now_s() {
                next_s += period_s;
                overruns += 1;
            }
            let left_s = (next_s - plc.now_s()).max(0.0);
            plc.sleep(Duration::from_secs_f64(left_s)).await;
        }
    }

    async fn image(&self, plc: &Plc) -> Image {
        let mut image = Image {
            time_s: plc.now_s(),
            ..Image::default()
        };
        let birth = plc.port().read(&Topic::Birth).await;
        if let Some(Payload::Birth(birth)) = birth.as_deref().map(|message| &message.payload) {
            for system in &birth.coordinate_systems {
                let state = plc.port().read(&Topic::cs(system.number, CsTopic::State)).await;
                if let Some(Payload::State(state)) = state.as_deref().map(|message| &message.payload) {
                    image.states.insert(system.number, state.clone());
                }
            }
        }
        for flag in self.flags.lock().iter() {
            let output = flag.output.clone();
            let place = (output.coordinate_system(), output.m());
            // of several with the same number the first is answered first
            image.on.entry(place).or_insert(output);
        }
        image
    }

    fn scan(&self, image: &mut Image) -> Result<()> {
        let mut program = self.program.lock().unwrap_or_else(PoisonError::into_inner);
        std::panic::catch_unwind(AssertUnwindSafe(|| program.scan(image))).map_err(|panicked| {
            Error::SequenceProgram(format!("the scan program panicked: {}", panic_words(&*panicked)))
        })
    }

    async fn carry_out(&self, plc: &Plc, image: Image) {
        for (output, text, percent) in image.progress {
            if let Err(error) = output.progress(text, percent).await {
                tracing::debug!(%error, m = output.m(), "progress of a scan program was not taken");
            }
        }
        for (cs, wanted) in image.requests {
            let request = match wanted {
                Wanted::Tool(id) => Request::Tool(cs, id),
                Wanted::Spindle(command) => Request::Spindle(cs, command),
                Wanted::Command(command) => {
                    let (client_id, command_id) = plc.command_names();
                    let meta = CommandMeta {
                        command_id,
                        client_id,
                        ..CommandMeta::default()
                    };
                    Request::Command {
                        cs,
                        command,
                        meta,
                        wait: false,
                    }
                }
            };
            if let Err(error) = plc.request(request).await {
                tracing::warn!(%error, cs, "what a scan program wrote was refused");
            }
        }
        for (place, how) in image.answers {
            if let Some(output) = image.on.get(&place) {
                self.flags.answer(output, how);
            }
        }
    }
}
