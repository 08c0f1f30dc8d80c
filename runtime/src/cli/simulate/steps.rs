//! `simulate --steps`: writes a line for each block that moves, dwells, outputs or stops, when the block
//! ends.

use futures_util::FutureExt;
use plc_protocol::port::Port;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::message::Payload;
use plc_protocol::types::output::{OutputNotice, Timing};
use plc_protocol::types::topic::{CsTopic, Topic};
use serde_json::{Map, Value, json};
use tandem_model::flow::Transform;
use tandem_model::{Axis, AxisVector};

/// Returns the latest message on a topic of a coordinate system.
pub(super) fn published(port: &dyn Port, cs: CoordinateSystemNumber, topic: CsTopic) -> Option<Payload> {
    let message = port.read(&Topic::cs(cs, topic)).now_or_never()??;
    Some(message.payload.clone())
}

/// A block that has begun and not ended.
#[derive(Debug)]
struct ExecutingBlock {
    program: u16,
    line: u32,
    start_s: f64,
    modal: Value,
    outputs: Vec<Value>,
    stop: Value,
}

impl ExecutingBlock {
    fn is_at(&self, program: u16, line: u32) -> bool {
        (self.program, self.line) == (program, line)
    }

    fn output(&mut self, notice: &OutputNotice, at_s: f64) {
        self.outputs.push(json!({
            "seq": notice.seq, "m": notice.m, "params": notice.params, "output_s": at_s, "reset_s": null,
        }));
    }

    fn reset(&mut self, seq: u64, at_s: f64) -> bool {
        let mut outputs = self.outputs.iter_mut();
        let found = outputs.find(|output| output["seq"] == seq);
        let is_found = found.is_some();
        if let Some(output) = found {
            output["reset_s"] = json!(at_s);
        }
        is_found
    }
}

/// State of a coordinate system at the end of a block.
pub(super) struct BlockEndState<'a> {
    pub at_s: f64,
    pub machine: AxisVector,
    pub transform: Transform,
    /// Distance of the path from the end of the block, where the next block begins without a stop, mm.
    pub corner_mm: Option<f64>,
    pub axes: &'a [Axis],
}

impl BlockEndState<'_> {
    fn by_letter(&self, values: AxisVector) -> Value {
        let values = self.axes.iter().map(|axis| {
            // Adding zero removes the sign of a negative zero.
            (axis.letter().to_string(), json!(values[*axis] + 0.0))
        });
        Value::Object(values.collect::<Map<_, _>>())
    }

    fn line(&self, cs: CoordinateSystemNumber, step: &ExecutingBlock) -> Value {
        let transform = &self.transform;
        json!({
            "cs": cs, "program": step.program, "line": step.line, "start_s": step.start_s, "end_s": self.at_s,
            "machine": self.by_letter(self.machine),
            "programmed": self.by_letter(transform.inverse(self.machine)),
            "corner_mm": self.corner_mm,
            "modal": step.modal,
            "offsets": {
                "work": self.by_letter(transform.work_offset), "local": self.by_letter(transform.local),
                "tool_length": transform.tool_length,
            },
            "outputs": step.outputs, "stop": step.stop,
        })
    }
}

/// Blocks of a coordinate system that have begun and not ended.
#[derive(Debug)]
pub(super) struct UnfinishedBlocks {
    cs: CoordinateSystemNumber,
    open: Option<ExecutingBlock>,
    /// Outputs for which the program does not wait, each as a separate block.
    beside: Vec<ExecutingBlock>,
}

impl UnfinishedBlocks {
    pub fn new(cs: CoordinateSystemNumber) -> Self {
        Self {
            cs,
            open: None,
            beside: Vec::new(),
        }
    }

    /// Returns the program and line of the block that has begun and not ended.
    pub fn open_at(&self) -> Option<(u16, u32)> {
        self.open.as_ref().map(|step| (step.program, step.line))
    }

    fn step(&self, port: &dyn Port, (program, line): (u16, u32), start_s: f64) -> ExecutingBlock {
        let mut modal = match published(port, self.cs, CsTopic::Modal) {
            Some(Payload::Modal(modal)) => json!(modal),
            _ => Value::Null,
        };
        if let Some(Payload::Spindle(spindle)) = published(port, self.cs, CsTopic::Spindle) {
            modal["spindle"] = json!({"direction": spindle.direction, "rpm": spindle.rpm});
        }
        ExecutingBlock {
            program,
            line,
            start_s,
            modal,
            outputs: Vec::new(),
            stop: Value::Null,
        }
    }

    /// Records the start of a motion; returns the line of the previous block, which has ended.
    pub fn block(&mut self, port: &dyn Port, at: (u16, u32), end: &BlockEndState<'_>) -> Option<Value> {
        let over = self.close(end);
        self.open = Some(self.step(port, at, end.at_s));
        over
    }

    /// Records an output; returns the line of the previous block if the output belongs to another block.
    pub fn output(
        &mut self,
        port: &dyn Port,
        notice: &OutputNotice,
        end: &BlockEndState<'_>,
    ) -> Option<Value> {
        let at = (notice.program, notice.line);
        if notice.timing == Timing::WithMotion {
            let mut step = self.step(port, at, end.at_s);
            step.output(notice, end.at_s);
            self.beside.push(step);
            return None;
        }
        let over = self.enter(port, at, end);
        if let Some(step) = &mut self.open {
            step.output(notice, end.at_s);
        }
        over
    }

    /// Records a pause of the program; returns the line of the previous block if the pause belongs to another
    /// block.
    pub fn stop(
        &mut self,
        port: &dyn Port,
        at: (u16, u32),
        m: Option<u16>,
        end: &BlockEndState<'_>,
    ) -> Option<Value> {
        let over = self.enter(port, at, end);
        if let Some(step) = &mut self.open {
            step.stop = json!({"m": m, "at_s": end.at_s});
        }
        over
    }

    /// Records the reset of an output; returns the output's line if the program did not wait for it.
    pub fn reset(&mut self, seq: u64, end: &BlockEndState<'_>) -> Option<Value> {
        let of_block = self.open.as_mut().is_some_and(|step| step.reset(seq, end.at_s));
        if of_block {
            return None;
        }
        let index = self
            .beside
            .iter_mut()
            .position(|step| step.reset(seq, end.at_s))?;
        Some(end.line(self.cs, &self.beside.remove(index)))
    }

    /// Records the end of the run; returns the lines of all blocks that have not ended.
    pub fn end_run(&mut self, end: &BlockEndState<'_>) -> Vec<Value> {
        let beside = std::mem::take(&mut self.beside);
        let beside = beside.iter().map(|step| end.line(self.cs, step));
        let beside: Vec<Value> = beside.collect();
        self.close(end).into_iter().chain(beside).collect()
    }

    /// Assigns an event to the block at this line. Begins a new block, unless the current one is at this line
    /// and has neither output nor stop.
    fn enter(&mut self, port: &dyn Port, at: (u16, u32), end: &BlockEndState<'_>) -> Option<Value> {
        let goes_on =
            |step: &ExecutingBlock| step.is_at(at.0, at.1) && step.outputs.is_empty() && step.stop.is_null();
        if self.open.as_ref().is_some_and(goes_on) {
            return None;
        }
        self.block(port, at, end)
    }

    fn close(&mut self, end: &BlockEndState<'_>) -> Option<Value> {
        let step = self.open.take()?;
        Some(end.line(self.cs, &step))
    }
}
