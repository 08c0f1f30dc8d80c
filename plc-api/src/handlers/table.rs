//! The handlers of a sequence program, by M code.

use std::any::TypeId;
use std::collections::{BTreeMap, BTreeSet};
use std::future::{Future, ready};
use std::ops::RangeInclusive;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;

use plc_protocol::alarm::Alarm;
use plc_protocol::port::BoxFuture;
use plc_protocol::supervisor::panic_text;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::alarm_text::AlarmText;
use plc_protocol::types::m_code::MCodeDeclaration;
use plc_protocol::types::m_code::{M_CODE_MAX, RUNTIME_M_CODES};
use plc_protocol::types::output::{Params, Redelivery};

use crate::aux_output::AuxOutput;
use crate::extract::{FromOutput, Takes};
use crate::handler_session::ServedCode;
use crate::m_codes::{ByName, ByNumber, MCode};
use crate::plc::Plc;
use crate::states::States;

/// A handler: an async function or closure with the output as its argument, or with the output and the
/// machine. A handler of an M code with a name ([`MCode`](crate::MCode)) instead has up to six
/// [extractors](crate::extract) as arguments.
///
/// If the handler returns `Ok`, the output is reset and the NC program continues. If it returns `Err`, the
/// alarm is raised, which stops the NC program; a panic also raises an alarm. If the output is cancelled, the
/// future is dropped at its current await point.
#[diagnostic::on_unimplemented(
    message = "this is no handler of an M code",
    label = "no handler of an M code",
    note = "an M code by its number takes an `async fn` of `(AuxOutput)` or `(AuxOutput, Plc)`",
    note = "an M code by its name, `const CLAMP: MCode = MCode::new(12, \"clamp\");`, takes an `async fn` of up to 6 arguments in any order: `Va<T>` to `Vh<T>`, structs with `#[derive(Params)]`, `HandlerState<T>`, `AuxOutput`, `Plc`, `CoordinateSystem`",
    note = "both give `Result<(), Alarm>`, and their future is `Send`: it keeps no `Rc`, `RefCell` or guard of a lock over an `.await`"
)]
pub trait Handler<Arguments, By = ByNumber>: Send + Sync + 'static {
    /// Starts the work of the handler, and returns its future.
    fn call(&self, output: AuxOutput, plc: Plc) -> BoxFuture<'static, Result<(), Alarm>>;

    /// Returns the parameters and states that the arguments of this handler take.
    fn takes(&self) -> Takes {
        Takes::default()
    }
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

macro_rules! by_name {
    ($($Argument:ident $argument:ident),*) => {
        impl<F, Work, $($Argument),*> Handler<($($Argument,)*), ByName> for F
        where
            F: Fn($($Argument),*) -> Work + Send + Sync + 'static,
            Work: Future<Output = Result<(), Alarm>> + Send + 'static,
            $($Argument: FromOutput,)*
        {
            #[allow(unused_variables, reason = "a handler may have no arguments")]
            fn call(&self, output: AuxOutput, plc: Plc) -> BoxFuture<'static, Result<(), Alarm>> {
                $(
                    let $argument = match $Argument::from_output(&output, &plc) {
                        Ok(argument) => argument,
                        Err(alarm) => return Box::pin(ready(Err(alarm))),
                    };
                )*
                Box::pin(self($($argument),*))
            }

            fn takes(&self) -> Takes {
                #[allow(unused_mut, reason = "a handler may have no arguments")]
                let mut takes = Takes::default();
                $($Argument::takes(&mut takes);)*
                takes
            }
        }
    };
}

by_name!();
by_name!(A a);
by_name!(A a, B b);
by_name!(A a, B b, C c);
by_name!(A a, B b, C c, D d);
by_name!(A a, B b, C c, D d, E e);
by_name!(A a, B b, C c, D d, E e, G g);

/// Creates a handler with shared state: each call receives a clone of `shared`, such as an `Arc`. For an
/// example see [parameters and shared state](crate#parameters-and-shared-state).
pub fn with<S, F, Work>(
    shared: S,
    handler: F,
) -> impl Handler<(AuxOutput, Plc)> + Handler<(AuxOutput, Plc), ByName>
where
    S: Clone + Send + Sync + 'static,
    F: Fn(AuxOutput, Plc, S) -> Work + Send + Sync + 'static,
    Work: Future<Output = Result<(), Alarm>> + Send + 'static,
{
    move |output: AuxOutput, plc: Plc| handler(output, plc, shared.clone())
}

pub(super) type Check = Arc<dyn Fn(&Params) -> Result<(), Alarm> + Send + Sync>;

pub(super) type BoxedHandler =
    Arc<dyn Fn(AuxOutput, Plc) -> BoxFuture<'static, Result<(), Alarm>> + Send + Sync>;

/// Returns the M codes of a range, but at most one M code above the highest, which causes one mistake.
fn within_limits(codes: RangeInclusive<u16>) -> impl Iterator<Item = u16> {
    let first_above = (M_CODE_MAX + 1).max(*codes.start());
    codes.take_while(move |m| *m <= first_above)
}

fn scope_text(cs: Option<CoordinateSystemNumber>) -> String {
    cs.map_or_else(String::new, |cs| format!(" in coordinate system {cs}"))
}

/// Handlers by M code, for all coordinate systems or for one coordinate system.
#[derive(Clone, Default)]
pub(super) struct Table {
    handlers: BTreeMap<ServedCode, BoxedHandler>,
    /// Declarations of the M codes with names, as their handlers take the parameters.
    declared: BTreeMap<ServedCode, MCodeDeclaration>,
    /// States that handlers take as arguments: the M code, and the type of the state with its name.
    wanted: Vec<(MCode, TypeId, &'static str)>,
    pub(super) states: States,
    checks: BTreeMap<ServedCode, Check>,
    /// Treatment of lost outputs, for each M code that has its own setting.
    redeliveries: BTreeMap<ServedCode, Redelivery>,
    /// Texts of the alarms of the program, by their codes.
    pub(super) alarms: BTreeMap<u16, AlarmText>,
    // mistakes that a call of the builder finds at once; `check` reports them with those of the whole program
    pub(super) mistakes: Vec<String>,
}

impl Table {
    pub(super) fn add<A, By>(
        &mut self,
        cs: Option<CoordinateSystemNumber>,
        (codes, names): (&[RangeInclusive<u16>], &[MCode]),
        handler: impl Handler<A, By>,
    ) {
        let handler = Arc::new(handler);
        let takes = handler.takes();
        let boxed: BoxedHandler = Arc::new(move |output, plc| handler.call(output, plc));
        if codes.iter().all(RangeInclusive::is_empty) {
            self.mistakes
                .push("on() got an empty range of M codes".to_owned());
        }
        for m in codes.iter().cloned().flat_map(within_limits) {
            let place = scope_text(cs);
            if m > M_CODE_MAX {
                self.mistakes
                    .push(format!("M{m}{place}: M codes are 0 to {M_CODE_MAX}"));
                continue;
            }
            if RUNTIME_M_CODES.contains(&m) {
                let mistake = format!("M{m}{place}: the runtime handles this M code itself; remove it");
                self.mistakes.push(mistake);
                continue;
            }
            if let Some(name) = names.iter().find(|name| name.m() == m) {
                self.declare(cs, *name, &takes);
            }
            self.insert((cs, m), Arc::clone(&boxed));
        }
    }

    fn insert(&mut self, (cs, m): ServedCode, handler: BoxedHandler) {
        if self.handlers.insert((cs, m), handler).is_some() {
            self.mistakes
                .push(format!("M{m}{} has two handlers", scope_text(cs)));
        }
    }

    /// Records the declaration of an M code with a name, as its handler takes the parameters.
    fn declare(&mut self, cs: Option<CoordinateSystemNumber>, code: MCode, takes: &Takes) {
        let declaration = MCodeDeclaration {
            m: code.m(),
            cs,
            name: Some(code.name().to_owned()),
            params: takes.params.clone(),
            redelivery: None,
        };
        let of_takes = takes.mistakes.iter().map(|mistake| format!("{code}: {mistake}"));
        self.mistakes.extend(of_takes.chain(declaration.mistake().err()));
        let wanted = takes.states.iter().map(|(state, name)| (code, *state, *name));
        self.wanted.extend(wanted);
        self.declared.insert((cs, code.m()), declaration);
    }

    /// Returns an alarm if the parameters do not match the declaration, so that the handler must not start.
    fn refuses(&self, cs: CoordinateSystemNumber, m: u16, params: &Params) -> Option<Alarm> {
        let declaration = self.declared.get(&self.handler_key(Some(cs), m))?;
        let fault = declaration.check(params).err()?;
        Some(Alarm::user(Alarm::CODE_OF_PARAMS, fault.text))
    }

    /// Returns the declarations of the M codes. If a handler for one coordinate system has no declaration,
    /// its entry is empty and hides the declaration for all coordinate systems.
    pub(super) fn declarations(&self) -> Vec<MCodeDeclaration> {
        let hidden = self.handlers.keys().filter(|(cs, m)| {
            let of_all = (None, *m);
            cs.is_some() && (self.declared.contains_key(&of_all) || self.redeliveries.contains_key(&of_all))
        });
        let said = self.declared.keys().chain(self.redeliveries.keys());
        let said: BTreeSet<ServedCode> = said.chain(hidden).copied().collect();
        let of = |(cs, m): ServedCode| {
            let place = self.handler_key(cs, m);
            MCodeDeclaration {
                m,
                cs,
                redelivery: self.redelivery(cs, m),
                ..self.declared.get(&place).cloned().unwrap_or_default()
            }
        };
        said.into_iter().map(of).collect()
    }

    /// Returns the key of the handler of an M code. The handler for the coordinate system precedes the
    /// handler for all coordinate systems.
    fn handler_key(&self, cs: Option<CoordinateSystemNumber>, m: u16) -> ServedCode {
        let has_its_own = self.handlers.contains_key(&(cs, m));
        (cs.filter(|_| has_its_own), m)
    }

    /// Returns the treatment of a lost output of an M code, or `None` if the setting for all M codes applies.
    pub(super) fn redelivery(&self, cs: Option<CoordinateSystemNumber>, m: u16) -> Option<Redelivery> {
        let said = self.redeliveries.get(&(cs, m));
        said.or_else(|| self.redeliveries.get(&self.handler_key(cs, m)))
            .copied()
    }

    pub(super) fn add_redelivery(
        &mut self,
        cs: Option<CoordinateSystemNumber>,
        codes: &[RangeInclusive<u16>],
        redelivery: Redelivery,
    ) {
        for m in codes.iter().cloned().flat_map(within_limits) {
            if self.redeliveries.insert((cs, m), redelivery).is_some() {
                let place = scope_text(cs);
                self.mistakes.push(format!("M{m}{place} has two redeliveries"));
            }
        }
    }

    /// Adds the handlers, checks, states and settings of another program.
    pub(super) fn merge(&mut self, other: Self) {
        for (code, handler) in other.handlers {
            self.insert(code, handler);
        }
        for ((cs, m), check) in other.checks {
            self.add_check(cs, &[m..=m], &check);
        }
        for ((cs, m), redelivery) in other.redeliveries {
            self.add_redelivery(cs, &[m..=m], redelivery);
        }
        let twice = self.states.merge(&other.states).into_iter();
        let twice = twice.map(|name| format!("merge() got a second state of type {name}"));
        self.mistakes.extend(twice.chain(other.mistakes));
        self.declared.extend(other.declared);
        self.wanted.extend(other.wanted);
        self.add_alarms(other.alarms.into_values());
    }

    /// Adds texts of alarms. Two different texts of one alarm are a mistake.
    pub(super) fn add_alarms(&mut self, texts: impl IntoIterator<Item = AlarmText>) {
        for text in texts {
            let code = text.code;
            if let Err(why) = text.mistake() {
                self.mistakes.push(format!("alarm {code}: {why}"));
            }
            let said = self.alarms.entry(code).or_insert_with(|| text.clone());
            if *said != text {
                self.mistakes.push(format!(
                    "alarm {code} has two texts: {:?} and {:?}",
                    said.text, text.text
                ));
            }
        }
    }

    /// Adds the handlers of another program, moved into a range of M codes. These handlers keep their own
    /// states.
    pub(super) fn merge_at(
        &mut self,
        codes: &RangeInclusive<u16>,
        part: Self,
        on_redelivery: Option<Redelivery>,
    ) {
        let (first, last) = (*codes.start(), *codes.end());
        self.mistakes.extend(part.all_mistakes());
        self.add_alarms(part.alarms.values().cloned());
        let Some(lowest) = part.handlers.keys().map(|(_, m)| *m).min() else {
            self.mistakes.push(format!(
                "merge_at({first}..={last}) got a program without handlers"
            ));
            return;
        };
        let moved = |m: u16| (m - lowest).saturating_add(first);
        for ((cs, m), handler) in part.handlers {
            let (there, states) = (moved(m), part.states.clone());
            let place = scope_text(cs);
            if !codes.contains(&there) || there > M_CODE_MAX || RUNTIME_M_CODES.contains(&there) {
                self.mistakes.push(format!(
                    "merge_at({first}..={last}): M{m}{place} of the part would be M{there}, which is not allowed there"
                ));
                continue;
            }
            let own: BoxedHandler =
                Arc::new(move |output, plc| handler(output.with_states(states.clone()), plc));
            self.insert((cs, there), own);
            let said = part.redeliveries.get(&(cs, m)).copied().or(on_redelivery);
            if let Some(said) = said {
                self.add_redelivery(cs, &[there..=there], said);
            }
        }
        for ((cs, m), check) in part.checks {
            let there = moved(m);
            self.add_check(cs, &[there..=there], &check);
        }
        for ((cs, m), declared) in part.declared {
            let m = moved(m);
            self.declared.insert((cs, m), MCodeDeclaration { m, ..declared });
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
                let place = scope_text(cs);
                self.mistakes.push(format!("M{m}{place} is validated twice"));
            }
        }
    }

    /// Returns all mistakes in the calls so far, as texts.
    pub(super) fn all_mistakes(&self) -> Vec<String> {
        let is_handled = |cs: Option<CoordinateSystemNumber>, m| match cs {
            None => self.handlers.keys().any(|(_, handled)| *handled == m),
            Some(cs) => self.find(cs, m).is_some(),
        };
        let idle = self.checks.keys().filter(|(cs, m)| !is_handled(*cs, *m));
        let idle = idle.map(|(cs, m)| format!("M{m}{} is validated and has no handler", scope_text(*cs)));
        let unserved = self.redeliveries.keys().filter(|(cs, m)| !is_handled(*cs, *m));
        let unserved =
            unserved.map(|(cs, m)| format!("M{m}{} has a redelivery and no handler", scope_text(*cs)));
        let idle = idle.chain(unserved);
        let missing = self
            .wanted
            .iter()
            .filter(|(_, state, _)| !self.states.has(*state));
        let missing = missing.map(|(code, _, name)| {
            format!("{code} takes HandlerState<{name}>, which the program does not have: add it by state(..)")
        });
        let mistakes = self.mistakes.iter().cloned();
        mistakes.chain(idle).chain(missing).collect()
    }

    pub(super) fn validates(&self) -> bool {
        !self.checks.is_empty()
    }

    /// Calls the check for the parameters of an M code. If the check panics, the parameters are refused.
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

    /// Returns the handler of an M code: the handler for the coordinate system, otherwise the handler for all
    /// coordinate systems.
    pub(super) fn find(&self, cs: CoordinateSystemNumber, m: u16) -> Option<&BoxedHandler> {
        self.handlers.get(&self.handler_key(Some(cs), m))
    }

    /// Returns the handler to run for an output with these parameters. If the parameters do not match the
    /// declaration, returns a handler that raises an alarm.
    pub(super) fn work(&self, cs: CoordinateSystemNumber, m: u16, params: &Params) -> Option<BoxedHandler> {
        let handler = self.find(cs, m)?;
        Some(match self.refuses(cs, m, params) {
            None => Arc::clone(handler),
            Some(alarm) => Arc::new(move |_, _| Box::pin(ready(Err(alarm.clone())))),
        })
    }

    pub(super) fn codes(&self) -> BTreeSet<ServedCode> {
        self.handlers.keys().copied().collect()
    }
}
