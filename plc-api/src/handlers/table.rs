//! Which handler serves which M code.

use std::collections::BTreeMap;
use std::future::Future;
use std::ops::{Range, RangeInclusive};
use std::sync::Arc;

use crate::alarm::Alarm;
use crate::plc::Plc;
use crate::port::BoxFuture;
use crate::types::CoordinateSystemNumber;

use super::output::AuxOutput;

/// Highest M number.
pub const M_CODE_MAX: u16 = 191;

/// M codes that the runtime handles itself (D35); no handler ever sees them.
pub const RUNTIME_M_CODES: [u16; 6] = [0, 1, 2, 30, 98, 99];

/// A function that works on an output: an async function or closure of the output, or of the output and the machine.
///
/// `Ok` resets the output, and the program goes on. `Err` raises the alarm and stops it; so does a panic. When the
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

pub(super) type Boxed = Arc<dyn Fn(AuxOutput, Plc) -> BoxFuture<'static, Result<(), Alarm>> + Send + Sync>;

/// One M code or a range of them.
pub trait MCodes {
    /// First and last.
    fn m_codes(self) -> RangeInclusive<u16>;
}

impl MCodes for u16 {
    fn m_codes(self) -> RangeInclusive<u16> {
        self..=self
    }
}

impl MCodes for RangeInclusive<u16> {
    fn m_codes(self) -> RangeInclusive<u16> {
        self
    }
}

impl MCodes for Range<u16> {
    fn m_codes(self) -> RangeInclusive<u16> {
        if self.is_empty() {
            #[expect(
                clippy::reversed_empty_ranges,
                reason = "an empty range, refused when the program is built"
            )]
            return 1..=0;
        }
        self.start..=self.end - 1
    }
}

/// Handlers by M code, for every coordinate system and for single ones.
#[derive(Clone, Default)]
pub(super) struct Table {
    everywhere: BTreeMap<u16, Boxed>,
    single: BTreeMap<(CoordinateSystemNumber, u16), Boxed>,
    mistakes: Vec<String>,
}

impl Table {
    pub(super) fn add<A>(
        &mut self,
        cs: Option<CoordinateSystemNumber>,
        codes: RangeInclusive<u16>,
        handler: impl Handler<A>,
    ) {
        let handler = Arc::new(handler);
        let boxed: Boxed = Arc::new(move |output, plc| handler.call(output, plc));
        if codes.is_empty() {
            self.mistakes
                .push("on() got an empty range of M codes".to_owned());
        }
        for m in codes {
            let place = cs.map_or_else(String::new, |cs| format!(" in coordinate system {cs}"));
            if m > M_CODE_MAX {
                self.mistakes
                    .push(format!("M{m}{place}: M codes are 0 to {M_CODE_MAX}"));
                break;
            }
            if RUNTIME_M_CODES.contains(&m) {
                self.mistakes.push(format!(
                    "M{m}{place}: the runtime handles it itself, leave it out"
                ));
                continue;
            }
            let before = match cs {
                None => self.everywhere.insert(m, Arc::clone(&boxed)),
                Some(cs) => self.single.insert((cs, m), Arc::clone(&boxed)),
            };
            if before.is_some() {
                self.mistakes.push(format!("M{m}{place} has two handlers"));
            }
        }
    }

    /// What was wrong in the calls so far, in words.
    pub(super) fn mistakes(&self) -> &[String] {
        &self.mistakes
    }

    /// The handler of an M code there: that of the coordinate system before that of all.
    pub(super) fn find(&self, cs: CoordinateSystemNumber, m: u16) -> Option<&Boxed> {
        self.single.get(&(cs, m)).or_else(|| self.everywhere.get(&m))
    }

    /// All codes served in these coordinate systems.
    pub(super) fn handled(&self, systems: &[CoordinateSystemNumber]) -> Vec<(CoordinateSystemNumber, u16)> {
        let everywhere = systems
            .iter()
            .flat_map(|&cs| self.everywhere.keys().map(move |&m| (cs, m)));
        let mut handled: Vec<_> = everywhere.chain(self.single.keys().copied()).collect();
        handled.sort_unstable();
        handled.dedup();
        handled
    }
}
