//! The table of handlers by M code.

use std::collections::{BTreeMap, BTreeSet};
use std::future::Future;
use std::ops::RangeInclusive;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;

use crate::alarm::Alarm;
use crate::m_codes::{M_CODE_MAX, RUNTIME_M_CODES};
use crate::plc::Plc;
use crate::port::BoxFuture;
use crate::presence::ServedCode;
use crate::text::panic_text;
use crate::types::CoordinateSystemNumber;
use crate::types::output::Params;

use super::output::AuxOutput;

/// A handler: an async function or closure of the output, or of the output and the machine.
///
/// `Ok` resets the output, and the program continues. `Err` raises the alarm, which stops it; so does a panic. When the
/// output is cancelled, the future is dropped where it waits.
pub trait Handler<Arguments>: Send + Sync + 'static {
    /// Starts the work.
    fn call(&self, output: AuxOutput, plc: Plc) -> BoxFuture<'static, Result<(), Alarm>>;
}

impl<F, Work> Handler<(AuxOutput, Plc)> for F
where
    F: Fn(AuxOutput, Plc) -> Work + Send + Sync + 'static,
    Work: Future<Output = Result<(), Alarm>> + Send + 'static,
{
    fn call(&self, output: AuxOutput, plc: Plc) -> BoxFuture<'static, Result<(), Alarm>> {
        Box::pin(self(output, plc))
    }
}

impl<F, Work> Handler<(AuxOutput,)> for F
where
    F: Fn(AuxOutput) -> Work + Send + Sync + 'static,
    Work: Future<Output = Result<(), Alarm>> + Send + 'static,
{
    fn call(&self, output: AuxOutput, _plc: Plc) -> BoxFuture<'static, Result<(), Alarm>> {
        Box::pin(self(output))
    }
}

/// A handler with shared state: each call receives a clone of `shared`, such as an `Arc`. For an example see
/// [parameters and shared state](crate#parameters-and-shared-state).
pub fn with<S, F, Work>(shared: S, handler: F) -> impl Handler<(AuxOutput, Plc)>
where
    S: Clone + Send + Sync + 'static,
    F: Fn(AuxOutput, Plc, S) -> Work + Send + Sync + 'static,
    Work: Future<Output = Result<(), Alarm>> + Send + 'static,
{
    move |output: AuxOutput, plc: Plc| handler(output, plc, shared.clone())
}

pub(super) type Check = Arc<dyn Fn(&Params) -> Result<(), Alarm> + Send + Sync>;

pub(super) type Boxed = Arc<dyn Fn(AuxOutput, Plc) -> BoxFuture<'static, Result<(), Alarm>> + Send + Sync>;

/// The codes of a range, of those above the highest only the first.
fn within_limits(codes: RangeInclusive<u16>) -> impl Iterator<Item = u16> {
    let first_above = (M_CODE_MAX + 1).max(*codes.start());
    codes.take_while(move |m| *m <= first_above)
}

fn place(cs: Option<CoordinateSystemNumber>) -> String {
    cs.map_or_else(String::new, |cs| format!(" in coordinate system {cs}"))
}

/// Handlers by M code, for every coordinate system and for single ones.
#[derive(Clone, Default)]
pub(super) struct Table {
    handlers: BTreeMap<ServedCode, Boxed>,
    checks: BTreeMap<ServedCode, Check>,
    // of single calls
    pub(super) mistakes: Vec<String>,
}

impl Table {
    pub(super) fn add<A>(
        &mut self,
        cs: Option<CoordinateSystemNumber>,
        codes: &[RangeInclusive<u16>],
        handler: impl Handler<A>,
    ) {
        let handler = Arc::new(handler);
        let boxed: Boxed = Arc::new(move |output, plc| handler.call(output, plc));
        if codes.iter().all(RangeInclusive::is_empty) {
            self.mistakes
                .push("on() got an empty range of M codes".to_owned());
        }
        for m in codes.iter().cloned().flat_map(within_limits) {
            let place = place(cs);
            if m > M_CODE_MAX {
                self.mistakes
                    .push(format!("M{m}{place}: M codes are 0 to {M_CODE_MAX}"));
                continue;
            }
            if RUNTIME_M_CODES.contains(&m) {
                let mistake = format!("M{m}{place}: the runtime handles it itself, leave it out");
                self.mistakes.push(mistake);
                continue;
            }
            if self.handlers.insert((cs, m), Arc::clone(&boxed)).is_some() {
                self.mistakes.push(format!("M{m}{place} has two handlers"));
            }
        }
    }

    pub(super) fn add_check(
        &mut self,
        cs: Option<CoordinateSystemNumber>,
        codes: &[RangeInclusive<u16>],
        check: &Check,
    ) {
        for m in codes.iter().cloned().flat_map(within_limits) {
            if self.checks.insert((cs, m), Arc::clone(check)).is_some() {
                let place = place(cs);
                self.mistakes.push(format!("M{m}{place} is validated twice"));
            }
        }
    }

    /// All mistakes in the calls so far, as texts.
    pub(super) fn all_mistakes(&self) -> Vec<String> {
        let is_handled = |cs: Option<CoordinateSystemNumber>, m| match cs {
            None => self.handlers.keys().any(|(_, handled)| *handled == m),
            Some(cs) => self.find(cs, m).is_some(),
        };
        let idle = self.checks.keys().filter(|(cs, m)| !is_handled(*cs, *m));
        let idle = idle.map(|(cs, m)| format!("M{m}{} is validated and has no handler", place(*cs)));
        self.mistakes.iter().cloned().chain(idle).collect()
    }

    pub(super) fn validates(&self) -> bool {
        !self.checks.is_empty()
    }

    /// Checks parameters of an M code. A check that panics refuses them.
    pub(super) fn validate(&self, cs: CoordinateSystemNumber, m: u16, params: &Params) -> Result<(), Alarm> {
        let everywhere = || {
            self.checks
                .get(&(None, m))
                .filter(|_| !self.handlers.contains_key(&(Some(cs), m)))
        };
        let Some(check) = self.checks.get(&(Some(cs), m)).or_else(everywhere) else {
            return Ok(());
        };
        std::panic::catch_unwind(AssertUnwindSafe(|| check(params))).unwrap_or_else(|panicked| {
            let text = format!("the validation of M{m} panicked: {}", panic_text(&*panicked));
            Err(Alarm::user(Alarm::CODE_OF_PANIC, text))
        })
    }

    /// The handler of an M code: one for the coordinate system, else one for all.
    pub(super) fn find(&self, cs: CoordinateSystemNumber, m: u16) -> Option<&Boxed> {
        let of_all = || self.handlers.get(&(None, m));
        self.handlers.get(&(Some(cs), m)).or_else(of_all)
    }

    pub(super) fn codes(&self) -> BTreeSet<ServedCode> {
        self.handlers.keys().copied().collect()
    }
}
