//! Dialect dgshape, by the sections of its manual: checks, outputs, and tool positions. Expected positions are
//! calculated by hand from the manual's text.

mod arcs_and_offsets;
mod by_hand;
mod coordinates;
mod cycles;
mod machine;
mod program_form;
mod simulated;
mod tool_diameter;

use std::collections::BTreeMap;
use std::sync::{Arc, LazyLock};

use tandem_interp::dialects::dgshape;
use tandem_interp::{CheckContext, Dialect, Inputs, Interpreter, Modal, check_source};
use tandem_model::flow::{Item, Output, Path, Segment, SegmentMotion};
use tandem_model::settings::{CoordinateSystemSettings, Tool, WorkOffsets};
use tandem_model::variables::Variables;
use tandem_model::{AXES_MAX, Alarm, Axis, AxisVector, MachinePosition};
use tandem_path::PathStage;
use tandem_runtime::Config;
use tandem_syntax::parse;

/// A machine with X, Y, Z from -100 to 100 and A, whose speeds are 100 mm/s, 100 mm/s, 50 mm/s and 90 degrees/s; G54 is at X 10,
/// tools 1 and 2 have the radii 3 and 2 and the lengths 8 and 5.
pub static MACHINE: LazyLock<String> = LazyLock::new(|| {
    let ends = [
        ("LIMITS_OF_X", "[-100.0, 100.0]"),
        ("LIMITS_OF_Y", "[-100.0, 100.0]"),
        ("LIMITS_OF_Z", "[-100.0, 100.0]"),
        ("REFERENCE_OF_X", "-90.0"),
        ("REFERENCE_OF_Y", "-80.0"),
        ("REFERENCE_OF_Z", "100.0"),
    ];
    let base = include_str!("../../runtime/tests/mill.toml").to_owned();
    let fill = |text: String, (mark, value)| text.replace(mark, value);
    ends.into_iter().fold(base, fill)
});

/// Returns the settings of [`MACHINE`] with more keys of `[coordinate_system.dgshape]`.
pub fn settings(keys: &str) -> CoordinateSystemSettings {
    let (before, tools) = MACHINE.split_at(MACHINE.find("[[tool]]").unwrap());
    machine_settings(&format!("{before}[coordinate_system.dgshape]\n{keys}\n{tools}"))
}

/// The settings of the first coordinate system of a configuration.
pub fn machine_settings(config: &str) -> CoordinateSystemSettings {
    let machine = Config::from_toml(config, "").unwrap().resolve().unwrap();
    machine.coordinate_systems[0].settings.clone()
}

/// Blocks as a whole program in mm.
pub fn program(blocks: &str) -> String {
    format!("%\nG21\n{blocks}\nM30\n%\n")
}

/// The codes of the findings in a program of these blocks.
pub fn findings(blocks: &str) -> Vec<&'static str> {
    findings_of(&program(blocks))
}

/// The codes of the findings in a text.
pub fn findings_of(text: &str) -> Vec<&'static str> {
    let settings = settings("");
    let (_, check) = check_source(text, dgshape(), &CheckContext::from_settings(&settings));
    check.diagnostics.iter().map(|finding| finding.code).collect()
}

/// Returns the tool motion and the outputs of blocks, with the keys of `[coordinate_system.dgshape]`.
///
/// # Errors
/// Fails with the alarm that ends the program.
pub fn run_with(blocks: &str, keys: &str) -> Result<Vec<String>, Alarm> {
    let mut done = Vec::new();
    each_step(blocks, keys, |step| {
        done.push(match step {
            Step::Segment(segment) => shown(segment),
            Step::Output(output) => {
                let parameter = output.params[0].map_or(String::new(), |value| format!(" {value}"));
                format!("M{}{parameter}", output.m)
            }
        });
    })?;
    Ok(done)
}

/// One step of a program.
enum Step<'a> {
    Segment(&'a Segment),
    Output(&'a Output),
}

/// Runs blocks with the tools and offsets of the machine, from machine position 0.
///
/// The modal state at the end; the alarm that ends the program.
fn each_step(blocks: &str, keys: &str, each: impl FnMut(Step<'_>)) -> Result<Modal, Alarm> {
    each_step_of(&program(blocks), dgshape(), &settings(keys), each)
}

/// Returns the motions of a text with a distance, and its outputs, in any dialect.
///
/// # Errors
/// The alarm that ends the program.
pub fn steps(
    text: &str,
    dialect: &'static Dialect,
    settings: &CoordinateSystemSettings,
) -> Result<Vec<String>, Alarm> {
    let mut done = Vec::new();
    let mut at = String::new();
    each_step_of(text, dialect, settings, |step| match step {
        Step::Segment(segment) => {
            let end = match &segment.motion {
                SegmentMotion::Rapid { to, .. }
                | SegmentMotion::Feed {
                    path: Path::Line { to, .. },
                    ..
                } => Some(place(*to)),
                SegmentMotion::Feed {
                    path: Path::Arc(arc), ..
                } => {
                    at = place(arc.end());
                    None
                }
                _ => None,
            };
            let stays = end.as_ref() == Some(&at);
            at = end.unwrap_or_else(|| at.clone());
            if !stays {
                done.push(shown(segment));
            }
        }
        Step::Output(output) => done.push(format!("M{} {:?}", output.m, output.params[0])),
    })?;
    Ok(done)
}

fn each_step_of(
    text: &str,
    dialect: &'static Dialect,
    settings: &CoordinateSystemSettings,
    mut each: impl FnMut(Step<'_>),
) -> Result<Modal, Alarm> {
    let (tree, found) = parse(text, (dialect.grammar)());
    assert!(found.is_empty(), "{found:?}");
    let mut tool = None;
    let tools: BTreeMap<u16, Tool> = [(1, 8.0, 3.0), (2, 5.0, 2.0)]
        .map(|(id, length, radius)| (id, Tool { length, radius }))
        .into();
    let mut work_offsets = WorkOffsets::default();
    work_offsets.0[1][Axis::X] = 10.0;
    let mut path = PathStage::new(settings, MachinePosition::default());
    let mut interpreter = Interpreter::new(settings, dialect);
    interpreter.start(Arc::new(tree), 1);
    loop {
        let item = interpreter.next(&Inputs {
            programs: &BTreeMap::new(),
            optional_skip: 1,
            work_offsets: &work_offsets,
            variables: &Variables::default(),
            tool,
            tools: &tools,
            captured: Some([0.0; AXES_MAX]),
            position: Some(path.counts_from().0),
        })?;
        let mut segments = Vec::new();
        match &item {
            Item::Block(block) => path.push(block, &mut segments)?,
            Item::Output(_) => path.flush(&mut segments),
            Item::End(_) => path.finish(&mut segments)?,
            Item::Stop(_) | Item::NeedsStandstill(_) | Item::Warning(..) => {}
        }
        for segment in &segments {
            each(Step::Segment(segment));
        }
        match &item {
            Item::Output(output) => {
                // the sequence program changes tools
                let changed = output.params[0].filter(|_| output.m == 6);
                let named = |(id, _): &(&u16, &Tool)| Some(f64::from(**id)) == changed;
                tool = tools.iter().find(named).map(|(_, tool)| *tool).or(tool);
                each(Step::Output(output));
            }
            Item::End(_) => return Ok(interpreter.modal().clone()),
            _ => {}
        }
    }
}

/// Works as above, without additional settings.
pub fn run(blocks: &str) -> Vec<String> {
    run_with(blocks, "").unwrap_or_else(|alarm| panic!("{blocks:?}: {alarm:?}"))
}

/// Returns the number of the alarm that ends the blocks.
pub fn alarm(blocks: &str) -> u16 {
    match run_with(blocks, "") {
        Ok(done) => panic!("{blocks:?}: {done:?}"),
        Err(alarm) => alarm.entry.number,
    }
}

/// Describes a segment by the machine position of its end, in mm and degrees, omitting zeros.
fn shown(segment: &Segment) -> String {
    match &segment.motion {
        SegmentMotion::Rapid { to, .. } => format!("rapid{}", place(*to)),
        SegmentMotion::Feed {
            path: Path::Line { to, .. },
            feed,
        } => {
            format!("line{} F{}", place(*to), rounded(feed.feedrate_mm_min))
        }
        SegmentMotion::Feed {
            path: Path::Arc(arc), ..
        } => {
            let [x, y] = arc.centre();
            let turn = if arc.sweep() > 0.0 { "ccw" } else { "cw" };
            format!("{turn}{} about {} {}", place(arc.end()), rounded(x), rounded(y))
        }
        SegmentMotion::Dwell { dwell_s, .. } => format!("dwell {}", rounded(*dwell_s)),
        other => format!("{other:?}"),
    }
}

fn place(at: AxisVector) -> String {
    let named = Axis::ALL.into_iter().filter(|axis| rounded(at[*axis]) != 0.0);
    let words = named.map(|axis| format!(" {}{}", axis.letter(), rounded(at[axis])));
    words.collect::<Vec<_>>().concat()
}

/// Six decimals; no sign of zero.
fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6 + 0.0
}

/// The spindle speed at the end of these blocks, with the keys of `[coordinate_system.dgshape]`, r/min.
pub fn speed(blocks: &str, keys: &str) -> f64 {
    let modal = each_step(blocks, keys, |_| {});
    modal.unwrap().spindle_speed_r_min
}

/// Returns the length on which F applies in the last line of these blocks, and its feedrate.
pub fn last_line(blocks: &str) -> (f64, f64) {
    let mut last = None;
    let ran = each_step(blocks, "", |step| {
        if let Step::Segment(Segment {
            motion: SegmentMotion::Feed { path, feed },
            ..
        }) = step
        {
            last = Some((path.length(), feed.feedrate_mm_min));
        }
    });
    ran.unwrap();
    last.unwrap()
}
