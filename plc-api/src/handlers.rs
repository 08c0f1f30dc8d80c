//! Sequence programs made of handlers: one async function for each M code.
//!
//! A handler receives the output and a handle to the machine, does its work, and returns. `Ok` resets the
//! output; `Err` raises an alarm with the text of the `Err`. The handlers of several open outputs run
//! concurrently, all in the future of [`SequenceProgram::run`].

mod background;
mod device;
mod followed_level;
mod merge;
mod run;
mod table;
#[cfg(test)]
mod tests;

pub use device::{Device, DeviceHandler};
pub use table::{Handler, with};

pub use crate::aux_output::{AuxOutput, Cancellation};
pub use crate::m_codes::{ByName, ByNumber, MCodes};

use std::marker::PhantomData;
use std::ops::RangeInclusive;
use std::sync::Arc;
use std::time::Duration;

use futures_util::FutureExt;
use futures_util::stream::{FuturesUnordered, StreamExt};
use plc_protocol::alarm::{Alarm, UserAlarm};
use plc_protocol::error::{Error, Result};
use plc_protocol::names::mistake_in_id;
use plc_protocol::port::BoxFuture;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::alarm_text::AlarmText;
use plc_protocol::types::machine::{ServedMCode, ServedMCodesFile};
use plc_protocol::types::output::{Params, Redelivery};
use tokio::sync::watch;

use crate::levels::LockKind;
use crate::plc::Plc;

use followed_level::FollowedLevel;
use run::LifecycleOptions;
use table::{Check, Table};

/// Scope of a program whose handlers serve every coordinate system.
#[derive(Debug, Clone, Copy)]
pub struct Everywhere;

/// Scope of a program whose handlers serve one coordinate system.
#[derive(Debug, Clone, Copy)]
pub struct OneCoordinateSystem;

/// Handlers of one coordinate system, within [`SequenceProgram::in_coordinate_system`].
pub type InCoordinateSystem = SequenceProgram<OneCoordinateSystem>;

/// A function that returns a task, which runs together with the handlers.
type Companion = Arc<dyn Fn(Plc) -> BoxFuture<'static, Result<()>> + Send + Sync>;

/// A sequence program: the handlers that serve M codes.
///
/// ```
/// use plc_api::{Alarm, AuxOutput, Params, Plc, SequenceProgram, fake::{FakePort, OutputOutcome}};
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
/// let good = fake.issue_output(1, 10, Params { a: Some(5.0), ..Params::default() });
/// fake.advance(std::time::Duration::from_millis(300)).await;
/// assert_eq!(fake.closed(1, good), Some(OutputOutcome::Reset));
/// let bad = fake.issue_output(1, 10, Params::default());
/// fake.settle().await;
/// let alarm = Alarm::user(1, "M10 needs VA");
/// assert_eq!(fake.closed(1, bad), Some(OutputOutcome::Failed { alarm }));
/// # }
/// ```
#[derive(Clone)]
pub struct SequenceProgram<Scope = Everywhere> {
    table: Table,
    companions: Vec<Companion>,
    how: LifecycleOptions,
    handler_id: Option<String>,
    // coordinate system of the handlers that the next calls add; `None` means all coordinate systems
    cs: Option<CoordinateSystemNumber>,
    scope: PhantomData<Scope>,
}

impl<Scope> std::fmt::Debug for SequenceProgram<Scope> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SequenceProgram")
            .field("handler_id", &self.handler_id)
            .field("on_redelivery", &self.how.on_redelivery)
            .field("coordinate_system", &self.cs)
            .finish_non_exhaustive()
    }
}

impl Default for SequenceProgram {
    fn default() -> Self {
        Self::new()
    }
}

/// Methods for a program of any scope.
impl<Scope> SequenceProgram<Scope> {
    /// Adds a handler for one or several M codes. To share state with other handlers see [`with`].
    ///
    /// The handler of an M code with a name ([`MCode`](crate::MCode)) takes [extractors](crate::extract): the
    /// parameters are checked against the declarations of the extractors when an NC program is loaded, and
    /// before the handler starts.
    ///
    /// [`SequenceProgram::run`] refuses a second handler for a code, a code above 191, and the codes that the
    /// runtime handles itself: M00, M01, M02, M30, M98, M99.
    #[must_use]
    pub fn on<A, By>(mut self, codes: impl MCodes<By>, handler: impl Handler<A, By>) -> Self {
        self.add(codes, handler);
        self
    }

    fn add<A, By, OfCodes>(&mut self, codes: impl MCodes<OfCodes>, handler: impl Handler<A, By>) {
        let names = codes.names();
        self.table.add(self.cs, (&codes.m_codes(), &names), handler);
    }

    pub(crate) fn serve<A>(&mut self, codes: &[RangeInclusive<u16>], handler: impl Handler<A>) {
        self.table.add(self.cs, (codes, &[]), handler);
    }

    /// Adds a check of the parameters of an M code at program load, before any motion: an NC program with
    /// invalid parameters is not loaded, and the refusal names the lines. Parameters that come from variables
    /// are known only when the block runs. Therefore the handler calls the same function again.
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
    /// The check must not block: if the result arrives after more than two seconds, the NC program is loaded
    /// with a warning. [`SequenceProgram::run`] refuses two checks of one code, and a check of a code without
    /// a handler.
    #[must_use]
    pub fn validate<T, By>(
        mut self,
        codes: impl MCodes<By>,
        check: impl Fn(&Params) -> Result<T, Alarm> + Send + Sync + 'static,
    ) -> Self {
        let check: Check = Arc::new(move |params| check(params).map(|_| ()));
        self.table.add_check(self.cs, &codes.m_codes(), &check);
        self
    }

    /// Sets the treatment of outputs of these M codes after the loss of their handler. This setting overrides
    /// [`on_redelivery`](SequenceProgram::on_redelivery), which covers all M codes. Choose
    /// [`Redelivery::Redo`] if the work is recorded under [`AuxOutput::id`] and can therefore be repeated.
    /// Choose [`Redelivery::Verify`] if the handler can check whether the work is done, such as the marking
    /// of a part. Choose [`Redelivery::Ask`] if the work moves an actuator.
    ///
    /// ```
    /// # use plc_api::{Alarm, AuxOutput, Redelivery, SequenceProgram};
    /// # async fn count(_output: AuxOutput) -> Result<(), Alarm> { Ok(()) }
    /// # async fn mark(_output: AuxOutput) -> Result<(), Alarm> { Ok(()) }
    /// # async fn clamp(_output: AuxOutput) -> Result<(), Alarm> { Ok(()) }
    /// let program = SequenceProgram::new()
    ///     .on(60, count)
    ///     .redelivery(60, Redelivery::Redo)
    ///     .on(95, mark)
    ///     .redelivery(95, Redelivery::Verify)
    ///     .on(10, clamp);
    /// # assert_eq!(program.check(), Ok(()));
    /// ```
    ///
    /// The stricter of this setting and the configuration of the M code applies. [`SequenceProgram::run`]
    /// refuses two settings for one code, and a setting for a code without a handler.
    #[must_use]
    pub fn redelivery<By>(mut self, codes: impl MCodes<By>, redelivery: Redelivery) -> Self {
        self.table.add_redelivery(self.cs, &codes.m_codes(), redelivery);
        self
    }

    /// Adds a state that handlers take as an argument [`HandlerState<T>`](crate::HandlerState). Each call of
    /// a handler receives a clone of the state, for example of an `Arc`. A program has at most one state of
    /// each type.
    ///
    /// [`SequenceProgram::run`] refuses a second state of the same type, and a handler that takes a state
    /// that was not added.
    #[must_use]
    pub fn state<T: Clone + Send + Sync + 'static>(mut self, state: T) -> Self {
        if !self.table.states.add(state) {
            let name = std::any::type_name::<T>();
            self.add_mistake(format!("state() got two states of type {name}"));
        }
        self
    }

    /// Adds a task that runs together with the handlers. If the task ends, the program ends, too.
    pub(crate) fn add_companion(
        mut self,
        companion: impl Fn(Plc) -> BoxFuture<'static, Result<()>> + Send + Sync + 'static,
    ) -> Self {
        self.companions.push(Arc::new(companion));
        self
    }

    /// Records a mistake for which [`SequenceProgram::run`] will refuse the program.
    pub(crate) fn add_mistake(&mut self, mistake: String) {
        self.table.mistakes.push(mistake);
    }

    fn into_scope<Other>(self, cs: Option<CoordinateSystemNumber>) -> SequenceProgram<Other> {
        SequenceProgram {
            table: self.table,
            companions: self.companions,
            how: self.how,
            handler_id: self.handler_id,
            cs,
            scope: PhantomData,
        }
    }
}

impl SequenceProgram {
    /// Creates a sequence program without handlers.
    pub fn new() -> Self {
        Self {
            table: Table::default(),
            companions: Vec::new(),
            how: LifecycleOptions::new(),
            handler_id: None,
            cs: None,
            scope: PhantomData,
        }
    }

    /// Adds handlers for one coordinate system only. In that coordinate system they take precedence over the
    /// handlers for all coordinate systems.
    #[must_use]
    pub fn in_coordinate_system(
        self,
        number: CoordinateSystemNumber,
        build: impl FnOnce(InCoordinateSystem) -> InCoordinateSystem,
    ) -> Self {
        build(self.into_scope(Some(number))).into_scope(None)
    }

    /// Holds a coordinate system while a level is true, by a source of its interlock: motion is held on its
    /// path and no motion starts; `text` is the reason. The source belongs to this program, which writes the
    /// source again on every connection and at every boot of the machine. No other sender can clear the
    /// source.
    ///
    /// If the sender of `level` is dropped, the source is set on. If the program is lost, the source takes
    /// its `on_loss` value. For a source that `[input.interlock]` declares, this is the configured value, by
    /// default on. For any other source, this is the `on_loss` of `[input.interlock]`, by default the last
    /// value.
    ///
    /// ```
    /// # use plc_api::{SequenceProgram, fake::FakePort};
    /// # use tokio::sync::watch;
    /// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
    /// # let fake = FakePort::new([1]);
    /// # let plc = fake.plc();
    /// let (door, is_open) = watch::channel(true);
    /// let program = SequenceProgram::new().interlock(1, "door", is_open, "the door is open");
    /// # tokio::spawn(async move { program.run(&plc).await });
    /// # fake.settle().await;
    /// # assert_eq!(fake.plc().coordinate_system(1).interlock().await?.text, "the door is open");
    /// door.send_replace(false);
    /// # fake.settle().await;
    /// # assert!(!fake.plc().coordinate_system(1).interlock().await?.value);
    /// # Ok(()) }
    /// ```
    #[must_use]
    pub fn interlock(
        self,
        cs: CoordinateSystemNumber,
        source: impl Into<String>,
        level: watch::Receiver<bool>,
        text: impl Into<String>,
    ) -> Self {
        self.follow(LockKind::Interlock, (cs, source.into()), level, text.into())
    }

    /// Refuses program starts in a coordinate system while a level is true, by a source of its start lock.
    /// The owner and the loss of the source are treated as for [`SequenceProgram::interlock`].
    #[must_use]
    pub fn start_lock(
        self,
        cs: CoordinateSystemNumber,
        source: impl Into<String>,
        level: watch::Receiver<bool>,
        text: impl Into<String>,
    ) -> Self {
        self.follow(LockKind::StartLock, (cs, source.into()), level, text.into())
    }

    fn follow(
        self,
        kind: LockKind,
        (cs, source): (CoordinateSystemNumber, String),
        level: watch::Receiver<bool>,
        text: String,
    ) -> Self {
        let followed = FollowedLevel {
            cs,
            kind,
            source,
            level,
            text,
        };
        self.add_companion(move |plc| Box::pin(followed.clone().run(plc)))
    }

    /// Sets the treatment of an output whose handler is lost before the reset, because its process ended or
    /// its connection broke. The configuration of the M code may also have a `redelivery`; the stricter of
    /// the two applies ([`Redelivery::Ask`], then [`Redelivery::Verify`], then [`Redelivery::Redo`]). If
    /// neither is set, the output waits until an operator decides.
    #[must_use]
    pub fn on_redelivery(mut self, on_redelivery: Redelivery) -> Self {
        self.how.on_redelivery = Some(on_redelivery);
        self
    }

    /// Takes over from a running program of the same name, such as the version before an update. The earlier
    /// program is notified, drops its handlers, and ends with [`Error::TakenOver`]. The open outputs of the
    /// earlier program are treated according to [`SequenceProgram::on_redelivery`]. Without this call the
    /// machine refuses a second program of the same name.
    ///
    /// ```
    /// use plc_api::{Error, SequenceProgram, fake::FakePort};
    ///
    /// # #[tokio::main(flavor = "current_thread")] async fn main() {
    /// let fake = FakePort::new([1]);
    /// let program = || SequenceProgram::new().handler_id("cell").on(10, |_output| async { Ok(()) });
    /// let plc = fake.plc();
    /// let old = tokio::spawn(async move { program().run(&plc).await });
    /// fake.settle().await;
    /// let plc = fake.plc();
    /// tokio::spawn(async move { program().take_over().run(&plc).await });
    /// fake.settle().await;
    /// assert!(matches!(old.await.unwrap(), Err(Error::TakenOver { .. })));
    /// # }
    /// ```
    #[must_use]
    pub fn take_over(mut self) -> Self {
        self.how.takes_over = true;
        self
    }

    /// Adds remedies and translations of alarms; the machine shows them when such an alarm is raised. The
    /// table `[alarm.N]` in the configuration of the machine takes precedence. For an example see
    /// [`UserAlarm`].
    #[must_use]
    pub fn alarms(mut self, alarms: impl IntoIterator<Item = UserAlarm>) -> Self {
        self.table.add_alarms(alarms.into_iter().map(AlarmText::from));
        self
    }

    /// Sets the time for which the machine waits for this program to return after
    /// [`run_until`](SequenceProgram::run_until) has stopped it, such as for an update: 1 ms to 1 h, by
    /// default one minute. During this time the M codes of the program are treated as served, and NC programs
    /// wait for them. Zero means that the program does not return.
    #[must_use]
    pub fn returns_within(mut self, time: Duration) -> Self {
        self.how.returns_within = time;
        self
    }

    /// Limits the time for which handlers may continue after the stop of
    /// [`run_until`](SequenceProgram::run_until). Handlers that are still at work at this limit are dropped
    /// at their current await points, and their outputs are treated as lost, see
    /// [`redelivery`](SequenceProgram::redelivery). By default there is no limit.
    #[must_use]
    pub fn ends_within(mut self, time: Duration) -> Self {
        self.how.ends_within = Some(time);
        self
    }

    /// Sets the name of this sequence program on the machine: 1 to 64 characters without `/ + #`. One program
    /// may use a name at a time: the machine refuses a second program of the same name, unless the second
    /// program calls [`take_over`](SequenceProgram::take_over). Default: the user name of the connection,
    /// otherwise a random name.
    #[must_use]
    pub fn handler_id(mut self, handler_id: impl Into<String>) -> Self {
        self.handler_id = Some(handler_id.into());
        self
    }

    /// Returns a description of the M codes that this program serves, for the file that `[machine] served` of
    /// a configuration names. With this file, `tandem check`, `tandem explain` and editors know the M codes
    /// while the program does not run.
    ///
    /// ```no_run
    /// # use plc_api::SequenceProgram;
    /// # fn program() -> SequenceProgram { SequenceProgram::new() }
    /// std::fs::write("served.json", program().served().to_string())?;
    /// # Ok::<(), std::io::Error>(())
    /// ```
    pub fn served(&self) -> ServedMCodesFile {
        let codes = self.table.codes();
        let declarations = self.table.declarations();
        let serves = codes.into_iter().map(|(cs, m)| {
            let mut said = declarations.iter();
            let said = said.find(|said| (said.cs, said.m) == (cs, m));
            ServedMCode {
                m,
                cs: cs.into_iter().collect(),
                handler_id: self.handler_id.clone(),
                name: said.and_then(|said| said.name.clone()),
                params: said.and_then(|said| said.params.clone()),
            }
        });
        let mut serves: Vec<_> = serves.collect();
        serves.sort_by_key(|one| one.m);
        ServedMCodesFile { serves }
    }

    /// Checks this program for mistakes, as [`SequenceProgram::run`] does before it starts.
    ///
    /// # Errors
    /// Fails with [`Error::SequenceProgram`], which names every mistake.
    pub fn check(&self) -> Result<()> {
        let mut mistakes = self.table.all_mistakes();
        mistakes.extend(self.handler_id.as_deref().and_then(mistake_in_id));
        if mistakes.is_empty() {
            return Ok(());
        }
        Err(Error::SequenceProgram(mistakes.join("; ")))
    }

    /// Serves the machine: announces the handled M codes, claims outputs, runs their handlers and resets the
    /// outputs. The program continues after every loss of the connection. It ends when the machine has ended
    /// the connection permanently.
    ///
    /// If this future is dropped, handlers are dropped at their current await points, and the machine is
    /// notified that the program is offline.
    ///
    /// # Errors
    /// - [`Error::SequenceProgram`] if [`SequenceProgram::check`] finds a mistake, a scan program panics, or
    ///   a [`task`](SequenceProgram::task) fails.
    /// - [`Error::Refused`] if the machine refuses the presence of this program, such as with `handler_taken`
    ///   while another program uses its name. Over MQTT also if the connection already serves another
    ///   sequence program: use a separate connection for each program.
    /// - [`Error::TakenOver`] if another program of the same name takes over.
    pub async fn run(self, plc: &Plc) -> Result<()> {
        self.run_until(plc, std::future::pending::<()>()).await
    }

    /// Serves the machine as [`SequenceProgram::run`] does, until `stop` completes, such as
    /// [`stop_signal`](crate::stop_signal). Then the program accepts no further output, and ends when the
    /// running handlers have finished, so that no work is lost; [`ends_within`](SequenceProgram::ends_within)
    /// limits their time. Tasks and alarms continue until that end. The program announces to the machine that
    /// it will return within [`returns_within`](SequenceProgram::returns_within).
    ///
    /// ```no_run
    /// # use plc_api::{Plc, SequenceProgram};
    /// # async fn main_of(program: SequenceProgram, plc: Plc) -> plc_api::Result<()> {
    /// program.run_until(&plc, plc_api::stop_signal()).await
    /// # }
    /// ```
    ///
    /// # Errors
    /// Fails as [`SequenceProgram::run`].
    pub async fn run_until<T>(self, plc: &Plc, stop: impl Future<Output = T>) -> Result<()> {
        self.check()?;
        let handler_id = self.handler_id.unwrap_or_else(|| plc.default_handler_id());
        let plc = &plc.of_handler(&handler_id);
        let serving = run::run(self.table, self.how, plc, handler_id.into(), stop);
        let companions: FuturesUnordered<_> = self.companions.iter().map(|run| run(plc.clone())).collect();
        tokio::select! {
            // the handlers first, because they own the levels that companions set
            biased;
            ended = Box::pin(serving) => ended,
            // if the program has no companions, this branch never completes
            Some(ended) = companions.into_future().map(|(ended, _)| ended) => ended,
        }
    }
}
