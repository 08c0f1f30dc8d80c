//! Records a simulation: the lines of the journal and the trace of positions.

use std::collections::BTreeMap;
use std::fmt::{Display, Write as _};
use std::fs::File;
use std::io::{self, BufWriter, IsTerminal, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use parking_lot::Mutex;
use plc_protocol::port::Port;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::message::Payload;
use plc_protocol::types::output::Timing;
use plc_protocol::types::topic::CsTopic;
use serde::Serialize;
use serde_json::{Value, json};
use tandem_model::Axis;
use tandem_runtime::Runtime;
use tandem_runtime::journal::{Event, Line, RaisedAlarm};
use tandem_runtime::simulation::{OnCycle, PlannedMotion};
use tandem_servo::Servo;

use super::SimulationPlan;
use super::measure::{Measure, SimulationMeasurements};
use super::steps::{BlockEndState, UnfinishedBlocks, published};

/// A file of lines. A write error is only reported at the end, because the servo cycle and the journal must
/// not fail.
struct LineFile {
    file: BufWriter<File>,
    failed: Option<io::Error>,
}

impl LineFile {
    fn create(path: &Path) -> io::Result<Self> {
        let file = BufWriter::new(File::create(path)?);
        Ok(Self { file, failed: None })
    }

    fn write(&mut self, line: impl Display) {
        if let Err(error) = writeln!(self.file, "{line}") {
            self.failed.get_or_insert(error);
        }
    }

    /// Flushes the file, and returns the first write error.
    fn finish(&mut self) -> io::Result<()> {
        self.failed.take().map_or(Ok(()), Err)?;
        self.file.flush()
    }
}

/// Events of one coordinate system.
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct Record {
    #[serde(skip)]
    pub start_s: f64,
    #[serde(skip)]
    pub end_s: f64,
    pub blocks: u64,
    /// M codes in the order of their outputs; `reset_s` is null until the reset.
    pub m_codes: Vec<Value>,
    pub stops: Vec<Value>,
    pub warnings: Vec<Value>,
    pub alarm: Value,
    #[serde(flatten)]
    pub measured: SimulationMeasurements,
}

/// A simulated coordinate system and its record.
struct System {
    record: Record,
    measure: Measure,
    steps: Option<UnfinishedBlocks>,
    axes: Vec<Axis>,
    /// M number of the code that changes tools by its word T, if no sequence program selects the tool.
    tool_changer: Option<u16>,
    /// Last tool number that the machine has reported.
    tool: u16,
}

/// Records the journal lines, servo cycles and planned motion of a simulation.
pub(super) struct Recorder {
    systems: BTreeMap<CoordinateSystemNumber, System>,
    port: Option<Arc<dyn Port>>,
    events: Option<LineFile>,
    steps: Option<LineFile>,
}

impl Recorder {
    pub fn new(plan: &SimulationPlan, events: Option<&Path>, steps: Option<&Path>) -> anyhow::Result<Self> {
        let create =
            |path: &Path| LineFile::create(path).with_context(|| format!("cannot write {}", path.display()));
        let systems = plan.systems().map(|(index, system)| {
            let cs = system.settings.number;
            let system = System {
                record: Record::default(),
                measure: Measure::new(
                    index,
                    &system.settings,
                    plan.arguments.feed_override / 100.0,
                    steps.is_some(),
                ),
                steps: steps.map(|_| UnfinishedBlocks::new(cs)),
                axes: system.settings.axes().iter().collect(),
                tool_changer: plan.tool_changer(system.dialect),
                tool: 0,
            };
            (cs, system)
        });
        Ok(Self {
            systems: systems.collect(),
            port: None,
            events: events.map(create).transpose()?,
            steps: steps.map(create).transpose()?,
        })
    }

    /// Sets the machine from which the recorder reads values in force.
    pub fn look_at(&mut self, runtime: &Runtime) {
        self.port = Some(runtime.port());
        for (cs, system) in &mut self.systems {
            if let Some(coordinates) = runtime.transform_of(*cs) {
                system.measure.look_at(Box::new(coordinates));
            }
        }
    }

    pub fn on_cycle(&mut self, servo: &Servo) {
        for system in self.systems.values_mut() {
            system.measure.on_cycle(servo);
        }
    }

    pub fn on_plan(&mut self, cs: CoordinateSystemNumber, planned: PlannedMotion<'_>) {
        if let Some(system) = self.systems.get_mut(&cs) {
            system.measure.plan(planned);
        }
    }

    pub fn on_line(&mut self, line: &Line) {
        // Skips commands, because the simulation itself sends them.
        if matches!(line.event, Event::Command { .. }) {
            return;
        }
        if let Some(events) = &mut self.events {
            events.write(line.to_json());
        }
        let (Some(system), Some(port)) = (self.systems.get_mut(&line.cs), &self.port) else {
            return;
        };
        let over = system.on_line(line, port.as_ref());
        if let Some(steps) = &mut self.steps {
            for step in &over {
                steps.write(step);
            }
        }
    }

    /// Flushes all files, and returns the record of each coordinate system.
    pub fn finish(&mut self) -> anyhow::Result<BTreeMap<CoordinateSystemNumber, Record>> {
        let files = [("--events", &mut self.events), ("--steps", &mut self.steps)];
        for (name, file) in files {
            file.as_mut().map_or(Ok(()), LineFile::finish).context(name)?;
        }
        let systems = std::mem::take(&mut self.systems).into_iter();
        Ok(systems.map(|(cs, system)| (cs, system.finish())).collect())
    }
}

impl System {
    /// Returns the lines for `--steps` of the blocks that a journal line ends.
    fn on_line(&mut self, line: &Line, port: &dyn Port) -> Vec<Value> {
        let over = self.step(line, port);
        match &line.event {
            Event::Start { program, .. } => self.measure.start(line.t_s, *program),
            Event::Block { .. } => self.measure.block(),
            Event::Output(notice) => {
                if notice.timing == Timing::AfterMotion {
                    self.measure.wait();
                }
                let tool = notice.params.a().filter(|_| self.tool_changer == Some(notice.m));
                if let Some(tool) = tool.and_then(|tool| tool.to_string().parse().ok()) {
                    self.measure.select(tool);
                }
            }
            Event::Stop { .. } => self.measure.wait(),
            Event::End(_) => self.measure.end_run(line.t_s),
            _ => {}
        }
        self.follow_tool(line.cs, port);
        self.record.on_line(line);
        over
    }

    fn follow_tool(&mut self, cs: CoordinateSystemNumber, port: &dyn Port) {
        if let Some(Payload::Tool(tool)) = published(port, cs, CsTopic::Tool)
            && tool.id != self.tool
        {
            self.tool = tool.id;
            self.measure.select(tool.id);
        }
    }

    fn step(&mut self, line: &Line, port: &dyn Port) -> Vec<Value> {
        let Some(steps) = &mut self.steps else {
            return Vec::new();
        };
        let [at, target] = self.measure.position();
        // Several blocks may end in one servo cycle; each has its own end.
        let passed = match (&line.event, steps.open_at()) {
            (Event::Block { .. }, Some((program, line))) => self.measure.end_of(program, line),
            _ => None,
        };
        let target = passed.and_then(|passed| passed.target).unwrap_or(target);
        let end = |machine| BlockEndState {
            at_s: line.t_s - self.record.start_s,
            machine,
            transform: self.measure.transform(),
            corner_mm: passed.and_then(|passed| passed.corner_mm),
            axes: &self.axes,
        };
        let over = match &line.event {
            Event::Block { program, line } => steps.block(port, (*program, *line), &end(target)),
            Event::Output(notice) => steps.output(port, notice, &end(at)),
            Event::Reset { seq, .. } => steps.reset(*seq, &end(at)),
            Event::Stop { m, program, line, .. } => {
                let place = (program.unwrap_or_default(), line.unwrap_or_default());
                steps.stop(port, place, *m, &end(at))
            }
            Event::End(_) => return steps.end_run(&end(at)),
            _ => None,
        };
        over.into_iter().collect()
    }

    fn finish(mut self) -> Record {
        self.record.warnings.extend(self.measure.warnings());
        self.record.measured = self.measure.finish();
        self.record
    }
}

impl Record {
    fn on_line(&mut self, line: &Line) {
        let at_s = line.t_s - self.start_s;
        match &line.event {
            Event::Start { .. } => self.start_s = line.t_s,
            Event::Block { .. } => self.blocks += 1,
            Event::Output(notice) => self.m_codes.push(json!({
                "seq": notice.seq, "m": notice.m, "params": notice.params, "program": notice.program,
                "line": notice.line, "output_s": at_s, "reset_s": null,
            })),
            Event::Reset { seq, .. } => {
                let mut outputs = self.m_codes.iter_mut();
                if let Some(output) = outputs.find(|output| output["seq"] == *seq) {
                    output["reset_s"] = json!(at_s);
                }
            }
            Event::Stop { m, line, .. } => self.stops.push(json!({"m": m, "line": line, "at_s": at_s})),
            Event::Warning { program, line, text } => {
                self.warnings
                    .push(json!({"program": program, "line": line, "text": text}));
            }
            Event::Alarm(RaisedAlarm::OfThis(alarm)) => {
                self.alarm = json!({
                    "number": alarm.number, "text": alarm.text, "program": alarm.program, "line": alarm.line,
                    "column": alarm.column,
                });
            }
            Event::Alarm(RaisedAlarm::OfAll { number, text }) => {
                self.alarm =
                    json!({"number": number, "text": text, "program": null, "line": null, "column": null});
            }
            Event::End(_) => self.end_s = line.t_s,
            _ => {}
        }
    }
}

/// Writes the positions of each servo period as CSV, and shows the progress on a terminal.
pub(super) struct CsvTrace(Arc<Mutex<CsvTraceState>>);

struct CsvTraceState {
    file: Option<LineFile>,
    index: usize,
    axes: Vec<Axis>,
    with_spindle: bool,
    program: u16,
    line: u32,
    cycles: u64,
    started: Instant,
    shown: Option<Instant>,
}

impl CsvTrace {
    pub fn new(path: Option<&Path>, with_spindle: bool, plan: &SimulationPlan) -> anyhow::Result<Self> {
        let (index, settings) = plan.first_system();
        let create =
            |path: &Path| LineFile::create(path).with_context(|| format!("--trace {}", path.display()));
        let mut trace = CsvTraceState {
            file: path.map(create).transpose()?,
            index,
            axes: settings.axes().iter().collect(),
            with_spindle,
            program: plan.jobs[0].program,
            line: 0,
            cycles: 0,
            started: Instant::now(),
            shown: None,
        };
        if let Some(file) = &mut trace.file {
            let letters: String = trace.axes.iter().flat_map(|axis| [',', axis.letter()]).collect();
            let spindle = if with_spindle { ",spindle_deg" } else { "" };
            file.write(format_args!("time_s,program,line{letters}{spindle}"));
        }
        trace.write(0.0, &[0.0; tandem_model::AXES_MAX], 0.0);
        Ok(Self(Arc::new(Mutex::new(trace))))
    }

    /// Returns the callback for each servo cycle; `None` if there is neither a file nor a terminal.
    pub fn on_cycle(&self) -> Option<OnCycle> {
        if self.0.lock().file.is_none() && !io::stderr().is_terminal() {
            return None;
        }
        let trace = Arc::clone(&self.0);
        Some(Box::new(move |servo| {
            let mut trace = trace.lock();
            let channel = servo.channel(trace.index);
            if let Some(origin) = channel.executing() {
                (trace.program, trace.line) = (origin.program, origin.line);
            }
            trace.write(servo.time_s(), &channel.setpoint().0, channel.spindle_deg());
            trace.show(servo.time_s());
        }))
    }

    /// Returns true if the trace has a file. Each cycle then needs a row, also if the motors keep their
    /// speeds.
    pub fn is_written(&self) -> bool {
        self.0.lock().file.is_some()
    }

    /// Flushes the file, and returns its first write error.
    pub fn finish(&self) -> anyhow::Result<()> {
        let mut trace = self.0.lock();
        if trace.shown.is_some() {
            crate::cli::complain("");
        }
        let file = trace.file.as_mut();
        file.map_or(Ok(()), LineFile::finish).context("--trace")
    }
}

impl CsvTraceState {
    fn write(&mut self, time_s: f64, position: &[f64], spindle_deg: f64) {
        let Some(file) = &mut self.file else { return };
        let mut line = format!("{time_s:.6},{},{}", self.program, self.line);
        for axis in &self.axes {
            // Adding zero removes the sign of a negative zero. Writing into a `String` never fails.
            let _ = write!(line, ",{:.9}", position[axis.index()] + 0.0);
        }
        if self.with_spindle {
            let _ = write!(line, ",{spindle_deg:.9}");
        }
        file.write(line);
    }

    /// Shows the progress on a terminal: first after one second, then at most five times per second.
    fn show(&mut self, time_s: f64) {
        self.cycles += 1;
        if !self.cycles.is_multiple_of(1024) || !std::io::stderr().is_terminal() {
            return;
        }
        let now = Instant::now();
        let (last, pause) = match self.shown {
            Some(shown) => (shown, Duration::from_millis(200)),
            None => (self.started, Duration::from_secs(1)),
        };
        if now - last >= pause {
            self.shown = Some(now);
            let (program, line) = (self.program, self.line);
            let mut stderr = io::stderr().lock();
            // A closed terminal is not treated as an error.
            let _ = write!(
                stderr,
                "\rsimulated {time_s:.1} s, program {program} line {line}   "
            );
            let _ = stderr.flush();
        }
    }
}
