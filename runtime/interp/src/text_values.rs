//! Values of variables that the checker knows at a place of a program.

use std::collections::BTreeMap;
use std::sync::Arc;

use tandem_syntax::{Variable, VariableKind};

use crate::range::Range;

/// Maximum number of P and Q variables that are tracked; further variables are treated as unknown.
const FOLLOWED_MAX: usize = 1024;

/// Known values: L of the current call, zero until the program writes them (D12), and the values that the
/// program has written into Q and P.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Values {
    locals: Arc<BTreeMap<u16, Range>>,
    shared: Arc<BTreeMap<(u8, u16), Range>>,
    /// True if the program has written Q or P, and no time has passed since.
    fresh: bool,
    /// True if no L is known, because the checker has not followed the program from its start.
    unknown: bool,
}

impl Values {
    /// Creates values with all variables unknown.
    pub fn unknown() -> Self {
        Self {
            unknown: true,
            ..Self::default()
        }
    }

    /// Returns the range of a variable as far as it is known.
    pub fn get(&self, variable: Variable) -> Range {
        let shared = || self.shared.get(&(variable.kind as u8, variable.index));
        match variable.kind {
            VariableKind::Local => match self.locals.get(&variable.index) {
                Some(range) => *range,
                None if self.unknown => Range::ANY,
                None => Range::from_value(0.0),
            },
            VariableKind::CapturedPosition => Range::ANY,
            VariableKind::CoordinateSystem | VariableKind::Global => shared().copied().unwrap_or(Range::ANY),
        }
    }

    /// Sets the range of a variable.
    pub fn set(&mut self, variable: Variable, range: Range) {
        match variable.kind {
            VariableKind::Local => {
                Arc::make_mut(&mut self.locals).insert(variable.index, range);
            }
            VariableKind::CapturedPosition => {}
            VariableKind::CoordinateSystem | VariableKind::Global => {
                let key = (variable.kind as u8, variable.index);
                let shared = Arc::make_mut(&mut self.shared);
                if shared.len() < FOLLOWED_MAX || shared.contains_key(&key) {
                    shared.insert(key, range);
                }
                self.fresh = true;
            }
        }
    }

    /// Records that time passes, so that other writers may have changed Q and P.
    pub fn pass_time(&mut self) {
        if std::mem::take(&mut self.fresh) {
            for range in Arc::make_mut(&mut self.shared).values_mut() {
                range.own = false;
            }
        }
    }

    /// Sets all Q and P to unknown.
    pub fn forget_shared(&mut self) {
        self.shared = Arc::default();
    }

    /// Starts a call with all L zero. Returns the L of the caller.
    pub fn enter(&mut self) -> Locals {
        Locals {
            values: std::mem::take(&mut self.locals),
            unknown: std::mem::take(&mut self.unknown),
        }
    }

    /// Restores the L of the caller.
    pub fn leave(&mut self, caller: &Locals) {
        self.locals = Arc::clone(&caller.values);
        self.unknown = caller.unknown;
    }

    /// Sets all L to zero, for a further repetition of a call.
    pub fn repeat(&mut self) {
        self.locals = Arc::default();
    }

    /// Widens each range to include the range in `other`. Returns `true` if a range changes.
    pub fn widen(&mut self, other: &Self) -> bool {
        let before = self.clone();
        let kinds = |values: &Self| {
            let locals = values.locals.keys().map(|index| (VariableKind::Local, *index));
            let shared = values.shared.keys().map(|(kind, index)| {
                let of = if *kind == VariableKind::Global as u8 {
                    VariableKind::Global
                } else {
                    VariableKind::CoordinateSystem
                };
                (of, *index)
            });
            locals.chain(shared).collect::<Vec<_>>()
        };
        let mut all = kinds(self);
        all.extend(kinds(other));
        for (kind, index) in all {
            let variable = Variable { kind, index };
            let range = before.get(variable).widened(other.get(variable));
            self.set(variable, range);
        }
        self.unknown |= other.unknown;
        self.fresh |= other.fresh;
        *self != before
    }
}

/// L variables of a caller.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Locals {
    values: Arc<BTreeMap<u16, Range>>,
    unknown: bool,
}
