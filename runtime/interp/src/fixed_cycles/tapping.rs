//! The tapping cycles G74 and G84 (manual 2, utilities; D42).
//!
//! With a spindle in the coordinate system the cut is one [`Tap`], its phase locked to the spindle; without one it is
//! M codes and G01 moves. The way back to the initial level is in machine coordinates: it is where the block began.

use tandem_model::alarm::FIXED_CYCLE_REFUSED;
use tandem_model::flow::{Action, AxisWords, Distance, Frame, Tap, Turn};
use tandem_model::{Alarm, Axis, AxisSet, AxisVector};
use tandem_syntax::Address;

use crate::codes::ModalGroup;
use crate::execution::Execution;

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
    depth: AxisWords,
    retract: AxisWords,
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
    let distance = words.distance;
    let mut position = words;
    position.named = words.named.iter().filter(|axis| *axis != Axis::Z).collect();
    position.values[Axis::Z] = 0.0;
    let level = |value, distance, frame| AxisWords {
        values: along_z(value),
        named: AxisSet::from_iter([Axis::Z]),
        distance,
        frame,
    };
    let retract = if distance == Distance::Incremental { -z } else { r };
    let returns = execution.modal().is(ModalGroup::ReturnLevel, &["G98"]);
    let start = execution.inputs().position[Axis::Z];
    let has_spindle = execution.limits().has_spindle;
    let cycle = Tapping {
        position,
        r_point: level(r, distance, Frame::Work),
        depth: level(z, distance, Frame::Work),
        retract: level(retract, distance, Frame::Work),
        initial: returns.then(|| level(start, Distance::Absolute, Frame::Machine)),
        dwell_s: kept.dwell_s.unwrap_or_default(),
        turn,
        spindle_speed_r_min: execution.modal().spindle_speed_r_min,
        has_spindle,
        repetitions: kept.repetitions.unwrap_or(1),
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

fn along_z(value: f64) -> AxisVector {
    let mut values = AxisVector::ZERO;
    values[Axis::Z] = value;
    values
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
                        self.step = 1;
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
            0 => Found::Step(Step::Output(19)),
            1 => self.to_position(),
            2 => self.to_r_point(),
            3 => Found::Step(Step::Motion(Action::Tap(Box::new(Tap {
                depth: self.depth,
                retract: self.retract,
                dwell_s: self.dwell_s,
                turn: self.turn,
                spindle_speed_r_min: self.spindle_speed_r_min,
            })))),
            4 => self
                .initial
                .map_or(Found::Nothing, |level| motion(Action::Rapid(level))),
            5 => Found::Repeat,
            6 => Found::Step(Step::Output(5)),
            _ => Found::End,
        }
    }

    fn without_spindle(&self, step: u8) -> Found {
        let (inward, outward) = match self.turn {
            Turn::Clockwise => (3, 4),
            Turn::CounterClockwise => (4, 3),
        };
        match step {
            0 => Found::Nothing,
            1 => self.to_position(),
            2 => self.to_r_point(),
            3 => Found::Step(Step::Output(19)),
            4 | 9 => Found::Step(Step::Output(inward)),
            5 => motion(Action::Linear(self.depth)),
            6 => motion(Action::Dwell {
                dwell_s: self.dwell_s,
            }),
            7 => Found::Step(Step::Output(outward)),
            8 => motion(Action::Linear(self.retract)),
            10 => self
                .initial
                .map_or(Found::Nothing, |level| motion(Action::Linear(level))),
            11 => Found::Repeat,
            _ => Found::End,
        }
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
