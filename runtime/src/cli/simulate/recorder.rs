//! What is written down while a simulation runs: the journal's lines and the trace of positions.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufWriter, IsTerminal, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use parking_lot::Mutex;
use plc_api::types::CoordinateSystemNumber;
use serde_json::{Value, json};
use tandem_model::Axis;
use tandem_runtime::journal::{Event, Line, RaisedAlarm};
use tandem_runtime::simulation::OnCycle;

use super::Plan;

/// What happened in one coordinate system.
#[derive(Debug, Clone, Default)]
pub(super) struct Record {
    pub start_s: f64,
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
    events: Option<BufWriter<File>>,
    failed: Option<std::io::Error>,
}

impl Recorder {
    pub fn new(
        cs: impl Iterator<Item = CoordinateSystemNumber>,
        events: Option<&Path>,
    ) -> anyhow::Result<Self> {
        let open = |path: &Path| {
            let file = File::create(path).with_context(|| format!("cannot write {}", path.display()));
            file.map(BufWriter::new)
        };
        let events = events.map(open).transpose()?;
        Ok(Self {
            records: cs.map(|cs| (cs, Record::default())).collect(),
            events,
            failed: None,
        })
    }

    pub fn record(&self, cs: CoordinateSystemNumber) -> Record {
        self.records.get(&cs).cloned().unwrap_or_default()
    }

    fn take(&mut self, line: &Line) {
        // Commands are the simulation's own.
        if matches!(line.event, Event::Command { .. }) {
            return;
        }
        if let Some(events) = &mut self.events
            && let Err(error) = writeln!(events, "{}", line.to_json())
        {
            self.failed.get_or_insert(error);
        }
        if let Some(record) = self.records.get_mut(&line.cs) {
            record.take(line);
        }
    }
}

impl Record {
    fn take(&mut self, line: &Line) {
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

pub(super) fn record(recorder: &Arc<Mutex<Recorder>>, line: &Line) {
    recorder.lock().take(line);
}

/// Everything is in the file when this returns.
pub(super) fn finish(recorder: &Arc<Mutex<Recorder>>) -> anyhow::Result<()> {
    let mut recorder = recorder.lock();
    if let Some(error) = recorder.failed.take() {
        return Err(error).context("--events");
    }
    recorder
        .events
        .as_mut()
        .map_or(Ok(()), Write::flush)
        .context("--events")
}

/// Positions of each servo period as CSV, and a sign of life on a terminal.
#[derive(Clone)]
pub(super) struct Trace(Arc<Mutex<TraceFile>>);

struct TraceFile {
    file: Option<BufWriter<File>>,
    failed: Option<std::io::Error>,
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
        let (index, axes) = plan.watched();
        let mut trace = TraceFile {
            file: None,
            failed: None,
            index,
            axes,
            with_spindle,
            program: plan.program(),
            line: 0,
            cycles: 0,
            started: Instant::now(),
            shown: None,
        };
        if let Some(path) = path {
            let file = File::create(path).with_context(|| format!("--trace {}", path.display()))?;
            let mut file = BufWriter::new(file);
            let letters: String = trace.axes.iter().flat_map(|axis| [',', axis.letter()]).collect();
            let spindle = if with_spindle { ",spindle_deg" } else { "" };
            writeln!(file, "time_s,program,line{letters}{spindle}")?;
            trace.file = Some(file);
            trace.write(0.0, &[0.0; tandem_model::AXES_MAX], 0.0);
        }
        Ok(Self(Arc::new(Mutex::new(trace))))
    }

    /// What the simulation calls after each servo cycle; `None`: nothing has to be written or shown.
    pub fn on_cycle(&self) -> Option<OnCycle> {
        let trace = Arc::clone(&self.0);
        let wanted = trace.lock().file.is_some();
        if !wanted && !std::io::stderr().is_terminal() {
            return None;
        }
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
            super::complain("");
        }
        if let Some(error) = trace.failed.take() {
            return Err(error).context("--trace");
        }
        trace
            .file
            .as_mut()
            .map_or(Ok(()), Write::flush)
            .context("--trace")
    }
}

impl TraceFile {
    fn write(&mut self, time_s: f64, position: &[f64], spindle_deg: f64) {
        let Some(file) = &mut self.file else { return };
        let mut line = format!("{time_s:.6},{},{}", self.program, self.line);
        for axis in &self.axes {
            // The sum takes the sign off a negative zero.
            // Writing into a String never fails.
            let _ = write!(line, ",{:.9}", position[axis.index()] + 0.0);
        }
        if self.with_spindle {
            let _ = write!(line, ",{spindle_deg:.9}");
        }
        if let Err(error) = writeln!(file, "{line}") {
            self.failed.get_or_insert(error);
        }
    }

    /// After a second, five times a second, on a terminal.
    fn show(&mut self, time_s: f64) {
        self.cycles += 1;
        if !self.cycles.is_multiple_of(1024) || !std::io::stderr().is_terminal() {
            return;
        }
        let now = Instant::now();
        let since_shown = self.shown.map_or(now - self.started, |shown| now - shown);
        let pause = if self.shown.is_some() {
            Duration::from_millis(200)
        } else {
            Duration::from_secs(1)
        };
        if since_shown >= pause {
            self.shown = Some(now);
            let (program, line) = (self.program, self.line);
            let mut stderr = std::io::stderr().lock();
            // A terminal that has gone is no reason to fail.
            let _ = write!(
                stderr,
                "\rsimulated {time_s:.1} s, program {program} line {line}   "
            );
            let _ = stderr.flush();
        }
    }
}
