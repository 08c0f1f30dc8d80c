//! `tandem diff`: finds the differences between two programs in motion, time and output.

mod compare;
mod recorded;

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Args;
use plc_protocol::types::CoordinateSystemNumber;
use serde_json::json;
use tandem_interp::{Dialect, dialects};

use super::plot::{Drawing, PlotView, Stroke, ToolPathLine};
use super::simulate::{Outcome, SimulationArguments, SimulationPlan};
use super::{CommandResult, EXIT_FOUND, EXIT_OK, EXIT_UNREADABLE, print_line, read_config};
use compare::{Comparison, ProgramPart, compare};
use recorded::{Element, record};

#[derive(Args)]
pub struct DiffArguments {
    /// NC program; its subprograms are searched for in its folder, then in the programs of the data folder
    old: PathBuf,
    /// NC program to compare with it
    new: PathBuf,
    /// Configuration file; default: the demo machine
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// NC dialect of the programs; default: that of the configuration
    #[arg(long, value_parser = dialects::find)]
    dialect: Option<&'static Dialect>,
    /// Coordinate system that runs both programs. Without this option, each program runs in the coordinate
    /// system whose `programs` in --config name its file. If no `programs` name the file, the program runs
    /// in the coordinate system of the other file; if no `programs` name either file, in 1
    #[arg(long)]
    cs: Option<CoordinateSystemNumber>,
    /// Path difference below which two programs are equal, in mm or degrees
    #[arg(long, value_name = "MM", default_value_t = 0.001)]
    tolerance: f64,
    /// Difference in the time of a block below which two programs are equal, in seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 0.005)]
    time_tolerance: f64,
    /// Prints one JSON object instead of text
    #[arg(long)]
    json: bool,
    /// Draws both paths and marks their differences
    #[arg(long, value_name = "OUT.svg")]
    svg: Option<PathBuf>,
    /// View of the picture
    #[arg(long, value_enum, default_value_t = PlotView::Xy)]
    plane: PlotView,
}

/// A program and the record of its simulated run.
struct Program<'a> {
    file: &'a Path,
    elements: Vec<Element>,
    outcome: Outcome,
}

pub(super) fn run(arguments: &DiffArguments) -> CommandResult {
    let (_, machine) = read_config(arguments.config.as_deref())?;
    let assigned = |file| Some(machine.system_of_program(file)?.settings.number);
    let read = |file, other| {
        let cs = arguments
            .cs
            .or_else(|| assigned(file))
            .or_else(|| assigned(other));
        Program::read(file, cs, arguments)
    };
    let [old, new] = [&arguments.old, &arguments.new];
    let (Some(old), Some(new)) = (read(old, new)?, read(new, old)?) else {
        return Ok(EXIT_UNREADABLE);
    };
    let tolerances = [arguments.tolerance, arguments.time_tolerance];
    let comparison = compare([&old.elements, &new.elements], tolerances);
    let alarms = [&old, &new].map(|program| program.outcome.alarm_text());
    let is_equal = comparison.differences.is_empty() && alarms[0] == alarms[1];
    if let Some(path) = &arguments.svg {
        let svg = draw(arguments, [&old, &new], &comparison);
        std::fs::write(path, svg).with_context(|| format!("cannot write {}", path.display()))?;
    }
    if arguments.json {
        print_line(json!({
            "equal": is_equal, "old": old.to_json(), "new": new.to_json(), "differences": comparison.differences,
        }));
    } else {
        for difference in &comparison.differences {
            print_line(difference);
        }
        for (name, alarm) in ["old", "new"]
            .iter()
            .zip(&alarms)
            .filter(|(_, alarm)| !alarm.is_empty())
        {
            print_line(format!("{name}: {alarm}"));
        }
        let [old_s, new_s] = [&old, &new].map(|program| program.outcome.cycle_time_s());
        let verdict = if is_equal {
            "no difference in path, M codes and time"
        } else {
            "they differ"
        };
        print_line(format!("{verdict}: old {old_s:.3} s, new {new_s:.3} s"));
    }
    Ok(if is_equal { EXIT_OK } else { EXIT_FOUND })
}

impl<'a> Program<'a> {
    /// Reads and runs a program. Returns `None` if the program has errors, which have been printed.
    fn read(
        file: &'a Path,
        cs: Option<CoordinateSystemNumber>,
        arguments: &DiffArguments,
    ) -> anyhow::Result<Option<Self>> {
        let mut simulated =
            SimulationArguments::for_file(file, arguments.config.as_deref(), arguments.dialect);
        simulated.cs = cs;
        let plan = match SimulationPlan::read(&simulated, arguments.json)? {
            Ok(plan) => plan,
            Err(diagnostics) => {
                if arguments.json {
                    print_line(json!({"file": file.display().to_string(), "diagnostics": diagnostics}));
                }
                return Ok(None);
            }
        };
        let (elements, outcome) = record(plan)?;
        Ok(Some(Self {
            file,
            elements,
            outcome,
        }))
    }

    fn to_json(&self) -> serde_json::Value {
        let alarm = self.outcome.alarm_text();
        json!({
            "file": self.file.display().to_string(), "cycle_time_s": self.outcome.cycle_time_s(),
            "alarm": (!alarm.is_empty()).then_some(alarm),
        })
    }
}

/// Draws the path that both programs have, and over it the parts that only one program has.
fn draw(arguments: &DiffArguments, programs: [&Program<'_>; 2], comparison: &Comparison) -> String {
    let mut lines: Vec<ToolPathLine> = Vec::new();
    let mut draw = |elements: &[Element], stroke: Stroke| {
        let ways = elements.iter().filter_map(Element::path_points);
        lines.extend(ways.map(|points| {
            ToolPathLine {
                stroke,
                points: points
                    .into_iter()
                    .map(|point| arguments.plane.project(point))
                    .collect(),
            }
        }));
    };
    let [old, new] = programs;
    draw(&old.elements, Stroke::Both);
    let of = |part: &Option<ProgramPart>| part.as_ref().map_or(0..0, |part| part.elements.clone());
    for difference in comparison
        .differences
        .iter()
        .filter(|difference| difference.moves())
    {
        draw(&old.elements[of(&difference.old)], Stroke::Old);
        draw(&new.elements[of(&difference.new)], Stroke::New);
    }
    let name = |path: &Path| {
        path.file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned()
    };
    let drawing = Drawing {
        title: &format!("{} and {}", name(old.file), name(new.file)),
        cycle_time_s: new.outcome.cycle_time_s(),
        axes: arguments.plane.axes(),
        legend: &[Stroke::Both, Stroke::Old, Stroke::New],
        lines: &lines,
    };
    drawing.to_svg()
}
