//! `tandem plot`: draws the tool path of a program as it runs in simulated time.

mod drawing;
mod polyline;

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Context;
use clap::{Args, ValueEnum};
use parking_lot::Mutex;
use tandem_model::profile::TimeBase;
use tandem_model::{Axis, AxisVector};
use tandem_runtime::simulation::OnCycle;

use super::simulate::{SimulationArguments, SimulationPlan, SimulationWatch};
use super::{CommandResult, EXIT_FOUND, EXIT_OK, complain};
pub(super) use drawing::Drawing;
use polyline::{Point, Polyline};

#[derive(Args)]
pub struct PlotArguments {
    #[command(flatten)]
    simulation: SimulationArguments,
    /// Picture to write
    #[arg(short, long, value_name = "OUT.svg")]
    output: PathBuf,
    /// View of the picture
    #[arg(long, value_enum, default_value_t = PlotView::Xy)]
    plane: PlotView,
}

/// Direction from which the path is seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum PlotView {
    /// From above: X to the right, Y up
    Xy,
    /// From the front: X to the right, Z up
    Xz,
    /// From the right: Y to the right, Z up
    Yz,
    /// From above the corner with the lowest X and Y: X goes back to the right, Y back to the left
    Iso,
}

impl PlotView {
    /// Projects a machine position into the picture; the result is in mm, to the right and up.
    pub fn project(self, at: AxisVector) -> Point {
        if let Some(axes) = self.axes() {
            return Point(axes.map(|axis| at[axis]));
        }
        let [x, y, z] = [Axis::X, Axis::Y, Axis::Z].map(|axis| at[axis]);
        let (sin, cos) = 30_f64.to_radians().sin_cos();
        Point([(x - y) * cos, (x + y) * sin + z])
    }

    /// Returns the axes of the machine that point to the right and up; `None` if the view is not along an
    /// axis.
    pub fn axes(self) -> Option<[Axis; 2]> {
        match self {
            Self::Xy => Some([Axis::X, Axis::Y]),
            Self::Xz => Some([Axis::X, Axis::Z]),
            Self::Yz => Some([Axis::Y, Axis::Z]),
            Self::Iso => None,
        }
    }
}

pub(super) fn run(arguments: &PlotArguments) -> CommandResult {
    let Ok(plan) = SimulationPlan::read(&arguments.simulation, false)? else {
        return Ok(EXIT_FOUND);
    };
    let sketch = Arc::new(Mutex::new(Sketch::new(arguments.plane)));
    let (watched, index) = (Arc::clone(&sketch), plan.first_system().0);
    let on_cycle: OnCycle = Box::new(move |servo| {
        let channel = servo.channel(index);
        let rapid = channel.time_base() == Some(TimeBase::Rapid);
        watched.lock().push(channel.setpoint(), rapid);
    });
    let outcome = plan.simulate(SimulationWatch {
        on_cycle: Some(on_cycle),
        every_cycle: true,
        ..SimulationWatch::default()
    })?;
    let lines = sketch.lock().take_lines();
    let name = arguments.simulation.file.file_name().unwrap_or_default();
    let drawing = Drawing {
        title: &name.to_string_lossy(),
        cycle_time_s: outcome.cycle_time_s(),
        axes: arguments.plane.axes(),
        legend: &[Stroke::Feed, Stroke::Rapid],
        lines: &lines,
    };
    let path = &arguments.output;
    std::fs::write(path, drawing.to_svg()).with_context(|| format!("cannot write {}", path.display()))?;
    if outcome.is_completed() {
        return Ok(EXIT_OK);
    }
    complain(outcome.alarm_text());
    Ok(EXIT_FOUND)
}

/// A part of the tool path that is drawn with one stroke.
#[derive(Debug, PartialEq)]
pub(super) struct ToolPathLine {
    pub stroke: Stroke,
    pub points: Vec<Point>,
}

/// Drawing style of a part of the tool path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Stroke {
    Feed,
    Rapid,
    /// Part of the path that both programs have.
    Both,
    /// Part of the path that only the old program has.
    Old,
    /// Part of the path that only the new program has.
    New,
}

impl Stroke {
    fn from_rapid(rapid: bool) -> Self {
        if rapid { Self::Rapid } else { Self::Feed }
    }

    fn class(self) -> &'static str {
        match self {
            Self::Feed => "feed",
            Self::Rapid => "rapid",
            Self::Both => "both",
            Self::Old => "old",
            Self::New => "new",
        }
    }
}

/// The tool path drawn up to now.
struct Sketch {
    view: PlotView,
    rapid: bool,
    line: Polyline,
    lines: Vec<ToolPathLine>,
}

impl Sketch {
    fn new(view: PlotView) -> Self {
        Self {
            view,
            rapid: false,
            line: Polyline::new(view.project(AxisVector::ZERO)),
            lines: Vec::new(),
        }
    }

    fn push(&mut self, setpoint: AxisVector, rapid: bool) {
        let point = self.view.project(setpoint);
        if rapid != self.rapid && point != self.line.end_point() {
            let from = self.line.end_point();
            self.end_line(from);
            self.rapid = rapid;
        }
        self.line.push(point);
    }

    fn end_line(&mut self, next_start: Point) {
        let points = std::mem::replace(&mut self.line, Polyline::new(next_start)).into_points();
        if points.len() > 1 {
            self.lines.push(ToolPathLine {
                stroke: Stroke::from_rapid(self.rapid),
                points,
            });
        }
    }

    fn take_lines(&mut self) -> Vec<ToolPathLine> {
        self.end_line(self.line.end_point());
        std::mem::take(&mut self.lines)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, y: f64) -> AxisVector {
        let mut at = AxisVector::ZERO;
        at[Axis::X] = x;
        at[Axis::Y] = y;
        at
    }

    #[test]
    fn rapid_and_feed_are_lines_of_their_own_that_meet() {
        let mut sketch = Sketch::new(PlotView::Xy);
        for (x, y, rapid) in [
            (1.0, 0.0, true),
            (2.0, 0.0, true),
            (2.0, 0.0, false),
            (2.0, 3.0, false),
        ] {
            sketch.push(at(x, y), rapid);
        }
        let expected = [
            ToolPathLine {
                stroke: Stroke::Rapid,
                points: vec![Point([0.0, 0.0]), Point([2.0, 0.0])],
            },
            ToolPathLine {
                stroke: Stroke::Feed,
                points: vec![Point([2.0, 0.0]), Point([2.0, 3.0])],
            },
        ];
        assert_eq!(sketch.take_lines(), expected);
    }

    #[test]
    fn isometric_view_shows_equal_axes_with_x_and_y_at_60_degrees_to_z() {
        let axis = |axis| {
            let mut at = AxisVector::ZERO;
            at[axis] = 1.0;
            PlotView::Iso.project(at)
        };
        for [first, second] in [[Axis::X, Axis::Z], [Axis::Y, Axis::Z]] {
            let (Point([ax, ay]), Point([bx, by])) = (axis(first), axis(second));
            assert!((ax.hypot(ay) - 1.0).abs() < 1e-12);
            assert!((ax * bx + ay * by - 0.5).abs() < 1e-12);
        }
    }
}
