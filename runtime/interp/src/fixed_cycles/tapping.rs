//! The tapping cycles G74 and G84 (manual 2, utilities; D42).
//!
//! M19, rapid moves to X, Y and to the R point, the thread in, dwell, the thread out; with G98 back to the initial level.
//! With a spindle in the coordinate system the thread is locked to it; without one M codes turn it between.
//!
//! All levels are programmed positions. The initial level is Z where the cycle began, not where each of its blocks
//! does: in the manual's examples the last hole returns with G98 to the level before the first one, and in G91 all
//! holes have the same R and Z point.

use tandem_model::alarm::FIXED_CYCLE_REFUSED;
use tandem_model::flow::{Action, AxisWords, Distance, Frame, Tap, TapLeg, ThreadAhead};
use tandem_model::plane::Turn;
use tandem_model::{Alarm, Axis, AxisSet, AxisVector};
use tandem_syntax::Address;

use crate::execution::Execution;
use crate::meaning::ReturnLevel;

/// The step that each repetition begins with.
const FIRST_OF_REPETITION: u8 = 2;

/// What a step of a cycle gives.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Step {
    Motion(Action),
    Output(u16),
}

/// One block of a tapping cycle while it expands, step by step: it may have thousands of repetitions.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Tapping {
    position: AxisWords,
    r_point: AxisWords,
    z_point: AxisWords,
    /// The initial level, when the cycle returns to it (G98).
    initial: Option<AxisWords>,
    dwell_s: f64,
    turn: Turn,
    spindle_speed_r_min: f64,
    has_spindle: bool,
    repetitions: u16,
    repetition: u16,
    step: u8,
}

/// Takes over the words of a block in a tapping cycle, and begins to expand it.
pub(crate) fn tapping(execution: &mut Execution<'_>, words: AxisWords, turn: Turn) {
    take_words(execution);
    let kept = execution.modal().cycle;
    let (Some(z), Some(r)) = (kept.z, kept.r) else {
        let text = "the fixed cycle has no Z point or no R point";
        execution.refuse(Alarm::new(&FIXED_CYCLE_REFUSED, text));
        return;
    };
    let initial = kept.initial.unwrap_or_else(|| initial_level(execution));
    execution.modal_mut().cycle.initial = Some(initial);
    let (r, z) = match words.distance {
        Distance::Absolute => (r, z),
        Distance::Incremental => (initial + r, initial + r + z),
    };
    let mut position = words;
    position.named = words.named.iter().filter(|axis| *axis != Axis::Z).collect();
    position.values[Axis::Z] = 0.0;
    let returns = execution.modal().in_force.return_level == Some(ReturnLevel::Initial);
    let has_spindle = execution.limits().has_spindle;
    let speed = execution.modal().spindle_speed_r_min;
    let repetitions = kept.repetitions.unwrap_or(1);
    let cycle = Tapping {
        position,
        r_point: level(r),
        z_point: level(z),
        initial: returns.then(|| level(initial)),
        dwell_s: kept.dwell_s.unwrap_or_default(),
        turn,
        spindle_speed_r_min: speed,
        has_spindle,
        repetitions,
        repetition: 0,
        step: 0,
    };
    execution.run_cycle(cycle);
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the range has been checked, and a cast saturates"
)]
fn take_words(execution: &mut Execution<'_>) {
    let (z, r) = (execution.length(Address::Z), execution.length(Address::R));
    let dwell_s = execution.words().get(Address::P).map(|time| time / 1000.0);
    let repetitions = execution.words().get(Address::K).map(|count| count as u16);
    let kept = &mut execution.modal_mut().cycle;
    kept.z = z.or(kept.z);
    kept.r = r.or(kept.r);
    kept.dwell_s = dwell_s.or(kept.dwell_s);
    kept.repetitions = repetitions.or(kept.repetitions);
}

/// The M codes that a tapping cycle puts out, ascending; all that it may put out where it is not known whether there
/// is a spindle.
pub(crate) fn outputs(has_spindle: Option<bool>) -> &'static [u16] {
    match has_spindle {
        Some(true) => &[5, 19],
        Some(false) => &[3, 4, 19],
        None => &[3, 4, 5, 19],
    }
}

/// Z where the tool is, as a programmed position.
fn initial_level(execution: &mut Execution<'_>) -> f64 {
    let position = execution.position();
    execution.modal().transform.inverse(position)[Axis::Z]
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

impl Tapping {
    /// The next step; `None` at the end.
    pub(crate) fn advance(&mut self) -> Option<Step> {
        if self.repetitions == 0 {
            return None;
        }
        loop {
            let step = self.step;
            self.step = self.step.saturating_add(1);
            let found = if self.has_spindle {
                self.with_spindle(step)
            } else {
                self.without_spindle(step)
            };
            match found {
                Found::Step(step) => return Some(step),
                Found::Nothing => {}
                Found::Repeat => {
                    self.repetition += 1;
                    if self.repetition < self.repetitions {
                        self.step = FIRST_OF_REPETITION;
                    }
                }
                Found::End => {
                    self.step = step;
                    return None;
                }
            }
        }
    }

    /// True where this repetition goes down to the R point: always with G98, with G99 once.
    fn goes_to_r(&self) -> bool {
        self.initial.is_some() || self.repetition == 0
    }

    fn with_spindle(&self, step: u8) -> Found {
        match step {
            0 => self.thread_ahead(),
            1 => Found::Step(Step::Output(19)),
            FIRST_OF_REPETITION => self.to_position(),
            3 => self.to_r_point(),
            4 => self.thread(TapLeg::In),
            5 => self.dwell(),
            6 => self.thread(TapLeg::Out),
            7 => self
                .initial
                .map_or(Found::Nothing, |level| motion(Action::Rapid(level))),
            8 => Found::Repeat,
            9 => Found::Step(Step::Output(5)),
            _ => Found::End,
        }
    }

    fn without_spindle(&self, step: u8) -> Found {
        let (inward, outward) = match self.turn {
            Turn::Clockwise => (3, 4),
            Turn::CounterClockwise => (4, 3),
        };
        match step {
            0 => self.thread_ahead(),
            1 => Found::Nothing,
            FIRST_OF_REPETITION => self.to_position(),
            3 => self.to_r_point(),
            4 => Found::Step(Step::Output(19)),
            5 | 10 => Found::Step(Step::Output(inward)),
            6 => self.thread(TapLeg::In),
            7 => self.dwell(),
            8 => Found::Step(Step::Output(outward)),
            9 => self.thread(TapLeg::Out),
            11 => self
                .initial
                .map_or(Found::Nothing, |level| motion(Action::Linear(level))),
            12 => Found::Repeat,
            _ => Found::End,
        }
    }

    fn thread(&self, leg: TapLeg) -> Found {
        motion(Action::Tap(Box::new(self.tap(leg))))
    }

    fn thread_ahead(&self) -> Found {
        motion(Action::ThreadAhead(Box::new(ThreadAhead {
            position: self.position,
            repetitions: self.repetitions,
            r_point: self.r_point,
            tap: self.tap(TapLeg::In),
            initial: self.initial,
        })))
    }

    fn tap(&self, leg: TapLeg) -> Tap {
        let (target, turn) = match leg {
            TapLeg::In => (self.z_point, self.turn),
            TapLeg::Out => (self.r_point, self.turn.reversed()),
        };
        Tap {
            target,
            leg,
            turn,
            spindle_speed_r_min: self.has_spindle.then_some(self.spindle_speed_r_min),
        }
    }

    fn dwell(&self) -> Found {
        motion(Action::Dwell {
            dwell_s: self.dwell_s,
        })
    }

    fn to_position(&self) -> Found {
        // in G90 the first repetition is there already; in G91 each one goes on by the distance
        if self.position.named.is_empty() {
            Found::Nothing
        } else {
            motion(Action::Rapid(self.position))
        }
    }

    fn to_r_point(&self) -> Found {
        if self.goes_to_r() {
            motion(Action::Rapid(self.r_point))
        } else {
            Found::Nothing
        }
    }
}

fn motion(action: Action) -> Found {
    Found::Step(Step::Motion(action))
}

enum Found {
    Step(Step),
    /// Go on with the next step.
    Nothing,
    /// A repetition is over.
    Repeat,
    /// The cycle is over.
    End,
}
