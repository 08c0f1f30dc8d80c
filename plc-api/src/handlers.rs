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
pub use table::{Handler, M_CODE_MAX, MCodes, RUNTIME_M_CODES};

use crate::error::{Error, Result};
use crate::handshake::HANDLER_ID_MAX;
use crate::plc::{Plc, unique_name};
use crate::types::CoordinateSystemNumber;
use crate::types::output::Redelivery;

use table::Table;

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
/// let bad = fake.put_out(1, 10, Params::default());
/// fake.advance(std::time::Duration::from_millis(300)).await;
/// assert_eq!(fake.closed(1, good), Some(Closed::Reset));
/// let alarm = Alarm::user(1, "M10 needs VA");
/// assert_eq!(fake.closed(1, bad), Some(Closed::Failed { alarm }));
/// # }
/// ```
#[derive(Clone, Default)]
pub struct SequenceProgram {
    table: Table,
    on_redelivery: Redelivery,
    handler_id: Option<String>,
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
        self.table.add(None, codes.m_codes(), handler);
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
        });
        self.table = scope.table;
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
    /// name. Default: a random one.
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
        let mut mistakes = self.table.mistakes().to_vec();
        if let Some(id) = &self.handler_id
            && (id.is_empty() || id.chars().count() > HANDLER_ID_MAX || id.contains(['/', '+', '#']))
        {
            mistakes.push(format!(
                "handler_id {id:?}: write 1 to {HANDLER_ID_MAX} characters without / + #"
            ));
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
    /// What [`SequenceProgram::check`] finds.
    pub async fn run(self, plc: &Plc) -> Result<()> {
        self.check()?;
        let handler_id = self.handler_id.unwrap_or_else(|| unique_name("handler"));
        Box::pin(run::run(self.table, self.on_redelivery, plc, handler_id.into())).await
    }
}

/// Handlers of one coordinate system, within [`SequenceProgram::in_coordinate_system`].
pub struct InCoordinateSystem {
    number: CoordinateSystemNumber,
    table: Table,
}

impl std::fmt::Debug for InCoordinateSystem {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("InCoordinateSystem")
            .field("number", &self.number)
            .finish_non_exhaustive()
    }
}

impl InCoordinateSystem {
    /// A handler for an M code or a range of them, in this coordinate system. See [`SequenceProgram::on`].
    #[must_use]
    pub fn on<A>(mut self, codes: impl MCodes, handler: impl Handler<A>) -> Self {
        self.table.add(Some(self.number), codes.m_codes(), handler);
        self
    }
}
