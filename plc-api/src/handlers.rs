//! Sequence programs made of handlers: one async function for each M code.
//!
//! A handler gets the output and the machine, does its work, and returns: `Ok` resets the output, `Err` raises an alarm
//! with its text. Several open outputs run their handlers at the same time, all within [`SequenceProgram::run`].

mod output;
mod run;
mod table;
#[cfg(test)]
mod tests;
mod work;

pub use output::{AuxOutput, Cancellation};
pub use table::{Handler, M_CODE_MAX, MCodes, RUNTIME_M_CODES, with};

use std::sync::{Arc, Mutex};
use std::time::Duration;

use futures_util::FutureExt;
use futures_util::stream::{FuturesUnordered, StreamExt};

use crate::alarm::Alarm;
use crate::error::{Error, Result};
use crate::plc::Plc;
use crate::presence::mistake_in_id;
use crate::scan::{Flags, SCAN_PERIOD_MIN, Scan, ScanProgram};
use crate::types::CoordinateSystemNumber;
use crate::types::output::{Params, Redelivery};

use table::{Check, Table};
pub(crate) use work::{until_answered, words as panic_words};

/// A sequence program: handlers by M code.
///
/// ```
/// use plc_api::{Alarm, AuxOutput, Params, Plc, SequenceProgram, fake::FakePort, handshake::Closed};
///
/// async fn clamp(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
///     let force = output.params().a().ok_or(Alarm::user(1, "M10 needs VA"))?;
///     output.progress(format!("clamping with {force} kN"), None).await?;
///     plc.sleep(std::time::Duration::from_millis(300)).await;
///     Ok(())
/// }
///
/// # #[tokio::main(flavor = "current_thread")] async fn main() {
/// let fake = FakePort::new([1]);
/// let plc = fake.plc();
/// tokio::spawn(async move { SequenceProgram::new().on(10, clamp).run(&plc).await });
/// let good = fake.put_out(1, 10, Params { a: Some(5.0), ..Params::default() });
/// fake.advance(std::time::Duration::from_millis(300)).await;
/// assert_eq!(fake.closed(1, good), Some(Closed::Reset));
/// let bad = fake.put_out(1, 10, Params::default());
/// fake.settle().await;
/// let alarm = Alarm::user(1, "M10 needs VA");
/// assert_eq!(fake.closed(1, bad), Some(Closed::Failed { alarm }));
/// # }
/// ```
#[derive(Clone, Default)]
pub struct SequenceProgram {
    table: Table,
    on_redelivery: Redelivery,
    handler_id: Option<String>,
    scans: Vec<Scan>,
}

impl std::fmt::Debug for SequenceProgram {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SequenceProgram")
            .field("handler_id", &self.handler_id)
            .field("on_redelivery", &self.on_redelivery)
            .finish_non_exhaustive()
    }
}

impl SequenceProgram {
    /// A sequence program without handlers.
    pub fn new() -> Self {
        Self::default()
    }

    /// A handler for an M code or a range of them, in every coordinate system. What it shares with others it owns:
    /// a closure that clones an `Arc`.
    ///
    /// A second handler for the same code, a code above 191, and one that the runtime handles itself (M00, M01, M02,
    /// M30, M98, M99) are errors of [`SequenceProgram::run`].
    #[must_use]
    pub fn on<A>(mut self, codes: impl MCodes, handler: impl Handler<A>) -> Self {
        self.table.add(None, &codes.m_codes(), handler);
        self
    }

    /// Checks the parameters of an M code when a program is loaded, before anything moves: a program with parameters
    /// that are refused is not loaded, and the refusal names their lines. Parameters that the program takes from
    /// variables are known only when the block runs; so a handler checks them itself, by the same function.
    ///
    /// ```
    /// # use plc_api::{Alarm, AuxOutput, Params, SequenceProgram};
    /// /// The pocket of tool VA.
    /// fn pocket(params: &Params) -> Result<u8, Alarm> {
    ///     let tool = params.a().ok_or(Alarm::user(1, "M100 needs VA: the tool"))?;
    ///     (1..=8)
    ///         .find(|pocket| f64::from(*pocket) == tool)
    ///         .ok_or_else(|| Alarm::user(2, format!("the magazine has no tool {tool}")))
    /// }
    ///
    /// async fn change_tool(output: AuxOutput) -> Result<(), Alarm> {
    ///     let pocket = pocket(output.params())?;
    ///     // ... turn the magazine to the pocket ...
    ///     Ok(())
    /// }
    ///
    /// let program = SequenceProgram::new().on(100, change_tool).validate(100, pocket);
    /// # assert_eq!(program.check(), Ok(()));
    /// ```
    ///
    /// The check answers at once and within two seconds; a later answer is a warning, and the program is loaded. Two
    /// checks of one code, and a check of a code without a handler, are errors of [`SequenceProgram::run`].
    #[must_use]
    pub fn validate<T>(
        mut self,
        codes: impl MCodes,
        check: impl Fn(&Params) -> Result<T, Alarm> + Send + Sync + 'static,
    ) -> Self {
        self.table.add_check(None, &codes.m_codes(), &boxed_check(check));
        self
    }

    /// A program in the scan-cycle style for these M codes, in every coordinate system: see [`scan`](crate::scan). One
    /// that only looks after inputs serves none, `[]`. The period is at least 1 ms.
    #[must_use]
    pub fn scan(mut self, codes: impl MCodes, period: Duration, program: impl ScanProgram) -> Self {
        let scan = scanned(&mut self.table, None, codes, period, program);
        self.scans.push(scan);
        self
    }

    /// Handlers for one coordinate system only. There they come before those for all.
    #[must_use]
    pub fn in_coordinate_system(
        mut self,
        number: CoordinateSystemNumber,
        build: impl FnOnce(InCoordinateSystem) -> InCoordinateSystem,
    ) -> Self {
        let scope = build(InCoordinateSystem {
            number,
            table: std::mem::take(&mut self.table),
            scans: std::mem::take(&mut self.scans),
        });
        self.table = scope.table;
        self.scans = scope.scans;
        self
    }

    /// What happens with an output that a handler had claimed and then left without an answer, because its process died
    /// or its connection was lost. Default [`Redelivery::Ask`]: nothing, until an operator decides.
    #[must_use]
    pub fn on_redelivery(mut self, on_redelivery: Redelivery) -> Self {
        self.on_redelivery = on_redelivery;
        self
    }

    /// Name of this sequence program on the machine: 1 to 64 characters without `/ + #`, one program at a time by each
    /// name. Default: the user's name where it connects with one, else a random one.
    #[must_use]
    pub fn handler_id(mut self, handler_id: impl Into<String>) -> Self {
        self.handler_id = Some(handler_id.into());
        self
    }

    /// What would be refused by [`SequenceProgram::run`].
    ///
    /// # Errors
    /// [`Error::SequenceProgram`] names every mistake.
    pub fn check(&self) -> Result<()> {
        let mut mistakes = self.table.mistakes();
        mistakes.extend(self.handler_id.as_deref().and_then(mistake_in_id));
        if self.scans.iter().any(|scan| scan.period < SCAN_PERIOD_MIN) {
            mistakes.push(format!("the period of a scan is at least {SCAN_PERIOD_MIN:?}"));
        }
        if mistakes.is_empty() {
            return Ok(());
        }
        Err(Error::SequenceProgram(mistakes.join("; ")))
    }

    /// Serves the machine: tells it what is handled here, claims outputs, runs their handlers, resets. Ends when the
    /// machine's side ends; over MQTT it goes on through every loss of the connection.
    ///
    /// When this future is dropped, handlers are dropped where they wait, and the machine is told that they have gone.
    ///
    /// # Errors
    /// What [`SequenceProgram::check`] finds; a scan program that panics; the machine does not take the name, or over MQTT
    /// the connection serves another sequence program: connect once for each.
    pub async fn run(self, plc: &Plc) -> Result<()> {
        self.check()?;
        let handler_id = self.handler_id.unwrap_or_else(|| plc.default_handler_id());
        let serving = run::run(self.table, self.on_redelivery, plc, handler_id.into());
        let scans = self.scans.into_iter().map(|scan| scan.run(plc.clone()));
        tokio::select! {
            ended = Box::pin(serving) => ended,
            // without scans there is nothing that could end
            Some(ended) = scans.collect::<FuturesUnordered<_>>().into_future().map(|(ended, _)| ended) => ended,
        }
    }
}

/// Handlers of one coordinate system, within [`SequenceProgram::in_coordinate_system`].
pub struct InCoordinateSystem {
    number: CoordinateSystemNumber,
    table: Table,
    scans: Vec<Scan>,
}

impl std::fmt::Debug for InCoordinateSystem {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("InCoordinateSystem")
            .field("number", &self.number)
            .finish_non_exhaustive()
    }
}

fn boxed_check<T>(check: impl Fn(&Params) -> Result<T, Alarm> + Send + Sync + 'static) -> Check {
    Arc::new(move |params| check(params).map(|_| ()))
}

/// A scan program that serves these codes.
fn scanned(
    table: &mut Table,
    cs: Option<CoordinateSystemNumber>,
    codes: impl MCodes,
    period: Duration,
    program: impl ScanProgram,
) -> Scan {
    let flags = Flags::default();
    let of_scan = flags.clone();
    let codes = codes.m_codes();
    // one that only guards the machine serves none
    if !codes.is_empty() {
        table.add(cs, &codes, move |output: AuxOutput| of_scan.clone().on(output));
    }
    Scan {
        flags,
        period,
        program: Arc::new(Mutex::new(program)),
    }
}

impl InCoordinateSystem {
    /// A handler for an M code or a range of them, in this coordinate system. See [`SequenceProgram::on`].
    #[must_use]
    pub fn on<A>(mut self, codes: impl MCodes, handler: impl Handler<A>) -> Self {
        self.table.add(Some(self.number), &codes.m_codes(), handler);
        self
    }

    /// A program in the scan-cycle style for these M codes, in this coordinate system: in no other are they on in its
    /// image. See [`SequenceProgram::scan`].
    #[must_use]
    pub fn scan(mut self, codes: impl MCodes, period: Duration, program: impl ScanProgram) -> Self {
        let scan = scanned(&mut self.table, Some(self.number), codes, period, program);
        self.scans.push(scan);
        self
    }

    /// Checks the parameters of an M code of this coordinate system when a program is loaded. See
    /// [`SequenceProgram::validate`].
    #[must_use]
    pub fn validate<T>(
        mut self,
        codes: impl MCodes,
        check: impl Fn(&Params) -> Result<T, Alarm> + Send + Sync + 'static,
    ) -> Self {
        let check = boxed_check(check);
        self.table.add_check(Some(self.number), &codes.m_codes(), &check);
        self
    }
}
