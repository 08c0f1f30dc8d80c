//! Records a simulation: the journal's lines and the trace of positions.

use std::collections::BTreeMap;
use std::fmt::{Display, Write as _};
use std::fs::File;
use std::io::{self, BufWriter, IsTerminal, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use parking_lot::Mutex;
use plc_api::types::CoordinateSystemNumber;
use serde::Serialize;
use serde_json::{Value, json};
use tandem_model::Axis;
use tandem_runtime::journal::{Event, Line, RaisedAlarm};
use tandem_runtime::simulation::OnCycle;

use super::Plan;

/// A file of lines. What cannot be written is reported at the end: a servo cycle and the journal do not fail.
struct Lines {
    file: BufWriter<File>,
    failed: Option<io::Error>,
}

impl Lines {
    fn create(path: &Path) -> io::Result<Self> {
        let file = BufWriter::new(File::create(path)?);
        Ok(Self { file, failed: None })
    }

    fn write(&mut self, line: impl Display) {
        if let Err(error) = writeln!(self.file, "{line}") {
            self.failed.get_or_insert(error);
        }
    }

    /// Everything is in the file when this returns.
    fn finish(&mut self) -> io::Result<()> {
        self.failed.take().map_or(Ok(()), Err)?;
        self.file.flush()
    }
}

/// What happened in one coordinate system.
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct Record {
    #[serde(skip)]
    pub start_s: f64,
    #[serde(skip)]
    pub end_s: f64,
    pub blocks: u64,
    /// In the order of their outputs; `reset_s` is null until the reset.
    pub m_codes: Vec<Value>,
    pub stops: Vec<Value>,
    pub warnings: Vec<Value>,
    pub alarm: Value,
}

/// The journal of a simulation.
pub(super) struct Recorder {
    records: BTreeMap<CoordinateSystemNumber, Record>,
    events: Option<Lines>,
}

impl Recorder {
    pub fn new(
        cs: impl Iterator<Item = CoordinateSystemNumber>,
        events: Option<&Path>,
    ) -> anyhow::Result<Self> {
        let create =
            |path: &Path| Lines::create(path).with_context(|| format!("cannot write {}", path.display()));
        Ok(Self {
            records: cs.map(|cs| (cs, Record::default())).collect(),
            events: events.map(create).transpose()?,
        })
    }

    pub fn on_line(&mut self, line: &Line) {
        // Commands are the simulation's own.
        if matches!(line.event, Event::Command { .. }) {
            return;
        }
        if let Some(events) = &mut self.events {
            events.write(line.to_json());
        }
        if let Some(record) = self.records.get_mut(&line.cs) {
            record.on_line(line);
        }
    }

    /// What happened in each coordinate system. Everything is in the file when this returns.
    pub fn finish(&mut self) -> anyhow::Result<BTreeMap<CoordinateSystemNumber, Record>> {
        if let Some(events) = &mut self.events {
            events.finish().context("--events")?;
        }
        Ok(std::mem::take(&mut self.records))
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

/// Positions of each servo period as CSV, and a sign of life on a terminal.
pub(super) struct Trace(Arc<Mutex<Traced>>);

struct Traced {
    file: Option<Lines>,
    index: usize,
    axes: Vec<Axis>,
    with_spindle: bool,
    program: u16,
    line: u32,
    cycles: u64,
    started: Instant,
    shown: Option<Instant>,
}

impl Trace {
    pub fn new(path: Option<&Path>, with_spindle: bool, plan: &Plan) -> anyhow::Result<Self> {
        let (index, settings) = plan.first_system();
        let create = |path: &Path| Lines::create(path).with_context(|| format!("--trace {}", path.display()));
        let mut trace = Traced {
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

    /// What the simulation calls after each servo cycle; `None`: nothing has to be written or shown.
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

    /// Everything is in the file when this returns.
    pub fn finish(&self) -> anyhow::Result<()> {
        let mut trace = self.0.lock();
        if trace.shown.is_some() {
            crate::cli::complain("");
        }
        let file = trace.file.as_mut();
        file.map_or(Ok(()), Lines::finish).context("--trace")
    }
}

impl Traced {
    fn write(&mut self, time_s: f64, position: &[f64], spindle_deg: f64) {
        let Some(file) = &mut self.file else { return };
        let mut line = format!("{time_s:.6},{},{}", self.program, self.line);
        for axis in &self.axes {
            // The sum takes the sign off a negative zero. Writing into a String never fails.
            let _ = write!(line, ",{:.9}", position[axis.index()] + 0.0);
        }
        if self.with_spindle {
            let _ = write!(line, ",{spindle_deg:.9}");
        }
        file.write(line);
    }

    /// After a second, five times a second, on a terminal.
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
            // A terminal that has gone is no reason to fail.
            let _ = write!(
                stderr,
                "\rsimulated {time_s:.1} s, program {program} line {line}   "
            );
            let _ = stderr.flush();
        }
    }
}
