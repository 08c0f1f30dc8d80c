//! Fixed cycles: one block becomes many items. A cycle is a list of steps. The interpreter creates the items
//! of a block one by one, because a block may have thousands of repetitions.

use std::collections::BTreeSet;

use tandem_model::flow::{Action, AxisWords, Distance, Frame, Tap, TapLeg, ThreadAhead};
use tandem_model::limits::M_CODE_MAX;
use tandem_model::plane::Turn;
use tandem_model::{Axis, AxisSet, AxisVector};
use tandem_syntax::Address;

/// Definition of a fixed cycle.
#[derive(Debug)]
pub struct FixedCycle {
    /// Name of the cycle in messages, with its article.
    pub name: &'static str,
    /// Words that the first block of the cycle needs.
    pub needed: &'static [Address],
    /// Steps of a block in a coordinate system with a spindle.
    pub with_spindle: Steps,
    /// Steps of a block in a coordinate system without a spindle.
    pub without_spindle: Steps,
}

/// Steps of one block of a fixed cycle.
#[derive(Debug, Clone, Copy)]
pub struct Steps {
    head: &'static [CycleStep],
    repetition: &'static [CycleStep],
    tail: &'static [CycleStep],
}

/// A step of a fixed cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CycleStep {
    /// A rapid to the programmed position of all axes except Z. In G91 each repetition adds the distance.
    Position,
    /// A rapid to the R point. If the cycle ends at the R point, only the first repetition has this rapid.
    Approach,
    /// A rapid along Z to this level.
    Rapid(Level),
    /// A straight line along Z to this level, at the feedrate.
    Linear(Level),
    /// A pass in the thread, to the Z point or back to the R point, with this direction of the spindle.
    Thread(TapLeg, Turn),
    /// Cuts to the Z point. Each cut is deeper than the previous cut by the depth of cut, and the tool
    /// retracts to the R point between two cuts.
    Peck,
    /// A dwell for the time in word P.
    Dwell,
    /// Output of an M code without parameters; its setting selects whether the cycle waits for the reset of
    /// the output.
    Output(u16),
}

/// A level on the Z axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// Z of the R point.
    RPoint,
    /// Z of the Z point.
    ZPoint,
    /// The initial level. If the cycle ends at the R point, the step has no motion.
    Initial,
    /// The level at which the cycle ends: the initial level or the R point.
    Return,
}

impl PartialEq for FixedCycle {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::eq(self, other)
    }
}

impl FixedCycle {
    /// Returns the M codes that a block of the cycle outputs, ascending. If `has_spindle` is `None`, returns
    /// the M codes with and without a spindle.
    pub fn outputs(&self, has_spindle: Option<bool>) -> BTreeSet<u16> {
        let forms = [(true, &self.with_spindle), (false, &self.without_spindle)];
        let forms = forms
            .into_iter()
            .filter(|(with, _)| has_spindle.is_none_or(|has| has == *with));
        let steps = forms.flat_map(|(_, steps)| [steps.head, steps.repetition, steps.tail].concat());
        let outputs = steps.filter_map(|step| match step {
            CycleStep::Output(m) => Some(m),
            _ => None,
        });
        outputs.collect()
    }

    /// Returns the direction of the spindle on the pass into a thread, or `None` if the cycle cuts no thread.
    pub fn threads(&self) -> Option<Turn> {
        self.with_spindle.repetition.iter().find_map(|step| match step {
            CycleStep::Thread(TapLeg::In, turn) => Some(*turn),
            _ => None,
        })
    }
}

impl Steps {
    /// Creates steps: `head` before the first repetition, `repetition` in each one, `tail` after the last
    /// one.
    ///
    /// # Panics
    /// Panics if a step outputs an M code above [`M_CODE_MAX`]; in a `static`, the compiler reports an error.
    pub const fn new(
        head: &'static [CycleStep],
        repetition: &'static [CycleStep],
        tail: &'static [CycleStep],
    ) -> Self {
        let parts = [head, repetition, tail];
        let mut part = 0;
        while part < parts.len() {
            let mut at = 0;
            while at < parts[part].len() {
                if let CycleStep::Output(m) = parts[part][at] {
                    assert!(m <= M_CODE_MAX, "no such M code");
                }
                at += 1;
            }
            part += 1;
        }
        Self {
            head,
            repetition,
            tail,
        }
    }
}

/// Data of one block in a fixed cycle; all levels are programmed positions of Z, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Hole {
    /// Axis words of the block; Z is ignored.
    pub(crate) position: AxisWords,
    pub(crate) r_point: f64,
    pub(crate) z_point: f64,
    /// Initial level, if the cycle returns to it.
    pub(crate) initial: Option<f64>,
    pub(crate) dwell_s: f64,
    /// Spindle speed S, r/min; `None` without a spindle.
    pub(crate) spindle_speed_r_min: Option<f64>,
    pub(crate) repetitions: u16,
    /// Division of the hole into cuts. `None` for one cut to the Z point.
    pub(crate) peck: Option<Peck>,
}

/// Division of a hole into cuts, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Peck {
    /// Amount by which each cut is deeper than the cut before; above 0.
    pub(crate) depth: f64,
    /// Distance above the bottom of the last cut at which the next cut begins.
    pub(crate) clearance: f64,
}

/// Place of the tool in a pecking step: a retraction and a return follow each cut except the last.
#[derive(Debug, Clone, Copy, PartialEq)]
enum PeckPlace {
    /// The tool is above the next cut, after this number of cuts.
    Above(u32),
    /// The tool is at the bottom of the last cut, after this number of cuts.
    AtDepth(u32),
    /// The tool is at the R point, after this number of cuts.
    Out(u32),
}

/// Item that a step gives.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum StepResult {
    Motion(Action),
    Output(u16),
}

/// Part of the steps that is being expanded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Part {
    /// Before the first step: the announcement of the thread that the block cuts.
    Ahead,
    Head,
    Repetition,
    Tail,
}

/// A block of a fixed cycle that is being expanded to items.
#[derive(Debug)]
pub(crate) struct Expansion {
    cycle: &'static FixedCycle,
    hole: Hole,
    part: Part,
    /// Index of the next step in the part.
    at: usize,
    repetition: u16,
    /// Place of the tool in a pecking step; `None` outside of such a step.
    pecks: Option<PeckPlace>,
}

impl Expansion {
    pub(crate) fn new(cycle: &'static FixedCycle, mut hole: Hole) -> Self {
        let named = hole.position.named;
        hole.position.named = named.iter().filter(|axis| *axis != Axis::Z).collect();
        hole.position.values[Axis::Z] = 0.0;
        Self {
            cycle,
            hole,
            part: Part::Ahead,
            at: 0,
            repetition: 0,
            pecks: None,
        }
    }

    /// Returns the next result, or `None` after the last result.
    pub(crate) fn advance(&mut self) -> Option<StepResult> {
        if self.hole.repetitions == 0 {
            return None;
        }
        if self.part == Part::Ahead {
            self.part = Part::Head;
            if let Some(turn) = self.cycle.threads() {
                return Some(self.thread_ahead(turn));
            }
        }
        loop {
            if let Some(place) = self.pecks {
                return Some(StepResult::Motion(self.peck(place)));
            }
            let step = self.next_step()?;
            if step == CycleStep::Peck {
                self.pecks = Some(PeckPlace::Above(0));
            } else if let Some(given) = self.expand_step(step) {
                return Some(given);
            }
        }
    }

    /// Returns the next move of a pecking step.
    fn peck(&mut self, place: PeckPlace) -> Action {
        let (r, z) = (self.hole.r_point, self.hole.z_point);
        let Peck { depth, clearance } = self.hole.peck.unwrap_or(Peck {
            depth: f64::INFINITY,
            clearance: 0.0,
        });
        let reached = |cuts: u32| (f64::from(cuts) * depth).min((z - r).abs());
        let at = |way: f64| level(r + way.max(0.0).copysign(z - r));
        match place {
            PeckPlace::Above(cuts) => {
                let way = f64::from(cuts + 1) * depth;
                let last = way >= (z - r).abs();
                self.pecks = (!last).then_some(PeckPlace::AtDepth(cuts + 1));
                Action::Linear(if last { level(z) } else { at(way) })
            }
            PeckPlace::AtDepth(cuts) => {
                self.pecks = Some(PeckPlace::Out(cuts));
                Action::Rapid(level(r))
            }
            PeckPlace::Out(cuts) => {
                self.pecks = Some(PeckPlace::Above(cuts));
                Action::Rapid(at(reached(cuts) - clearance))
            }
        }
    }

    fn next_step(&mut self) -> Option<CycleStep> {
        let steps = match self.hole.spindle_speed_r_min {
            Some(_) => &self.cycle.with_spindle,
            None => &self.cycle.without_spindle,
        };
        loop {
            let (part, following) = match self.part {
                Part::Ahead | Part::Head => (steps.head, Part::Repetition),
                Part::Repetition => (steps.repetition, Part::Tail),
                Part::Tail => (steps.tail, Part::Tail),
            };
            if let Some(step) = part.get(self.at) {
                self.at += 1;
                return Some(*step);
            }
            if self.part == Part::Tail {
                return None;
            }
            self.at = 0;
            if self.part == Part::Repetition && self.repetition + 1 < self.hole.repetitions {
                self.repetition += 1;
            } else {
                self.part = following;
            }
        }
    }

    /// Returns the result of a step, or `None` if the step gives no item in this repetition.
    fn expand_step(&self, step: CycleStep) -> Option<StepResult> {
        let hole = &self.hole;
        let action = match step {
            CycleStep::Output(m) => return Some(StepResult::Output(m)),
            CycleStep::Position if hole.position.named.is_empty() => return None,
            CycleStep::Position => Action::Rapid(hole.position),
            CycleStep::Approach if hole.initial.is_none() && self.repetition > 0 => return None,
            CycleStep::Approach => Action::Rapid(level(hole.r_point)),
            CycleStep::Rapid(to) => Action::Rapid(level(self.level(to)?)),
            CycleStep::Linear(to) => Action::Linear(level(self.level(to)?)),
            CycleStep::Thread(leg, turn) => Action::Tap(Box::new(self.tap(leg, turn))),
            CycleStep::Dwell => Action::Dwell {
                dwell_s: hole.dwell_s,
            },
            CycleStep::Peck => return None,
        };
        Some(StepResult::Motion(action))
    }

    fn level(&self, level: Level) -> Option<f64> {
        let hole = &self.hole;
        match level {
            Level::RPoint => Some(hole.r_point),
            Level::ZPoint => Some(hole.z_point),
            Level::Initial => hole.initial,
            Level::Return => hole.initial.or(Some(hole.r_point)),
        }
    }

    fn tap(&self, leg: TapLeg, turn: Turn) -> Tap {
        Tap {
            target: level(match leg {
                TapLeg::In => self.hole.z_point,
                TapLeg::Out => self.hole.r_point,
            }),
            leg,
            turn,
            spindle_speed_r_min: self.hole.spindle_speed_r_min,
        }
    }

    fn thread_ahead(&self, turn: Turn) -> StepResult {
        let hole = &self.hole;
        StepResult::Motion(Action::ThreadAhead(Box::new(ThreadAhead {
            position: hole.position,
            repetitions: hole.repetitions,
            r_point: level(hole.r_point),
            tap: self.tap(TapLeg::In, turn),
            initial: hole.initial.map(level),
        })))
    }
}

fn level(z: f64) -> AxisWords {
    let mut values = AxisVector::ZERO;
    values[Axis::Z] = z;
    AxisWords {
        values,
        named: AxisSet::from_iter([Axis::Z]),
        distance: Distance::Absolute,
        frame: Frame::Work,
    }
}
