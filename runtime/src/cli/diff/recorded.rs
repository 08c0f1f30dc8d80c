//! Records the actions of a program in order: paths, dwells, outputs and stops.

use std::sync::Arc;

use parking_lot::Mutex;
use plc_protocol::types::output::Params;
use tandem_model::flow::{Path, Segment, SegmentMotion};
use tandem_model::{AxisVector, Origin};
use tandem_runtime::journal::{Event, Line};
use tandem_runtime::simulation::PlannedMotion;

use crate::cli::simulate::{Outcome, SimulationPlan, SimulationWatch};

/// Number of lines that represent an arc in the drawing.
const LINES_OF_ARC: u32 = 64;

/// An action of a program.
#[derive(Debug, Clone)]
pub struct Element {
    pub program: u16,
    /// First and last line of the program that belong to the action.
    pub lines: (u32, u32),
    pub time_s: f64,
    pub does: Does,
}

/// Kind of the action.
#[derive(Debug, Clone)]
pub enum Does {
    /// Motion along a path at the feedrate.
    Feed(Path),
    /// Motion in which the motors move independently: a rapid, or a motion that a signal may end.
    Alone {
        skips: bool,
        from: AxisVector,
        to: AxisVector,
    },
    /// Motion of an axis in phase with the spindle, in a thread.
    Tap {
        from: AxisVector,
        to: AxisVector,
        revolutions: f64,
    },
    Rest,
    Output {
        m: u16,
        params: Params,
    },
    Stop {
        m: Option<u16>,
    },
}

impl Does {
    /// Returns true if the action is a motion.
    pub fn moves(&self) -> bool {
        matches!(self, Self::Feed(_) | Self::Alone { .. } | Self::Tap { .. })
    }
}

impl Element {
    fn from_segment(segment: &Segment) -> Self {
        let Origin { program, line, .. } = segment.origin;
        let (does, time_s) = match &segment.motion {
            SegmentMotion::Feed { path, .. } => (Does::Feed(path.clone()), 0.0),
            SegmentMotion::Rapid { from, to } => (alone(false, *from, *to), 0.0),
            SegmentMotion::Skip { from, to } => (alone(true, *from, *to), 0.0),
            SegmentMotion::Tap {
                from,
                to,
                revolutions,
                ..
            } => {
                let (from, to, revolutions) = (*from, *to, *revolutions);
                (
                    Does::Tap {
                        from,
                        to,
                        revolutions,
                    },
                    0.0,
                )
            }
            SegmentMotion::Dwell { .. } => (Does::Rest, 0.0),
        };
        Self {
            program,
            lines: (line, line),
            time_s,
            does,
        }
    }

    /// Returns true if the motion has no length.
    fn is_nothing(&self) -> bool {
        let stays = |from: &AxisVector, to: &AxisVector| from == to;
        match &self.does {
            Does::Feed(Path::Line { from, to, .. }) | Does::Alone { from, to, .. } => stays(from, to),
            Does::Rest => self.time_s <= 0.0,
            _ => false,
        }
    }

    /// Returns the points of the element's path for the drawing; `None` if it has no path.
    pub fn path_points(&self) -> Option<Vec<AxisVector>> {
        match &self.does {
            Does::Feed(Path::Line { from, to, .. })
            | Does::Alone { from, to, .. }
            | Does::Tap { from, to, .. } => Some(vec![*from, *to]),
            Does::Feed(path @ Path::Arc(_)) => {
                let step = path.length() / f64::from(LINES_OF_ARC);
                Some(
                    (0..=LINES_OF_ARC)
                        .map(|i| path.point_at(step * f64::from(i)))
                        .collect(),
                )
            }
            _ => None,
        }
    }

    /// Extends a straight path by the next element, if it continues in the same direction. Returns true if it
    /// does.
    fn extend_line(&mut self, next: &Self) -> bool {
        let (
            Does::Feed(Path::Line { from, to, length }),
            Does::Feed(Path::Line {
                from: start,
                to: end,
                length: more,
            }),
        ) = (&mut self.does, &next.does)
        else {
            return false;
        };
        let whole = *length + more;
        let straight = from.plus(end.minus(*from).scaled(*length / whole)).minus(*start);
        let is_straight =
            self.program == next.program && to == start && straight.0.iter().all(|off| off.abs() < 1e-9);
        if is_straight {
            (*to, *length) = (*end, whole);
            self.lines = (self.lines.0.min(next.lines.0), self.lines.1.max(next.lines.1));
            self.time_s += next.time_s;
        }
        is_straight
    }
}

fn alone(skips: bool, from: AxisVector, to: AxisVector) -> Does {
    Does::Alone { skips, from, to }
}

/// Elements recorded up to now, with the segment number of each motion.
#[derive(Default)]
struct Recording(Vec<(u64, Element)>);

impl Recording {
    fn plan(&mut self, planned: PlannedMotion<'_>) {
        match planned {
            PlannedMotion::Segment { number, segment, .. } => {
                self.0.push((number, Element::from_segment(segment)));
            }
            PlannedMotion::Profile(profile) => {
                let mut latest = self.0.iter_mut().rev();
                let element = latest.find(|(segment, _)| *segment == profile.segment);
                if let Some((_, element)) = element {
                    element.time_s += profile.duration_s;
                }
            }
        }
    }

    fn record_line(&mut self, line: &Line) {
        let (program, line, does) = match &line.event {
            Event::Output(notice) => {
                let (m, params) = (notice.m, notice.params);
                (notice.program, notice.line, Does::Output { m, params })
            }
            Event::Stop { m, program, line, .. } => {
                let at = (program.unwrap_or_default(), line.unwrap_or_default());
                (at.0, at.1, Does::Stop { m: *m })
            }
            _ => return,
        };
        let element = Element {
            program,
            lines: (line, line),
            time_s: 0.0,
            does,
        };
        self.0.push((0, element));
    }

    fn finish(self) -> Vec<Element> {
        let mut elements: Vec<Element> = Vec::new();
        let moving = self.0.into_iter().map(|(_, element)| element);
        for element in moving.filter(|element| !element.is_nothing()) {
            if !elements.last_mut().is_some_and(|last| last.extend_line(&element)) {
                elements.push(element);
            }
        }
        elements
    }
}

/// Runs a program in simulated time and records its elements.
///
/// # Errors
/// Returns an error if the machine rejects a command.
pub fn record(plan: SimulationPlan) -> anyhow::Result<(Vec<Element>, Outcome)> {
    let recording = Arc::new(Mutex::new(Recording::default()));
    let (planned, heard) = (Arc::clone(&recording), Arc::clone(&recording));
    let outcome = plan.simulate(SimulationWatch {
        on_plan: Some(Box::new(move |of_plan| planned.lock().plan(of_plan))),
        on_line: Some(Box::new(move |line| heard.lock().record_line(line))),
        ..SimulationWatch::default()
    })?;
    let recording = std::mem::take(&mut *recording.lock());
    Ok((recording.finish(), outcome))
}
