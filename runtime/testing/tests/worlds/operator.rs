//! Operators that change stored data, run programs, move axes manually and stop programs, at random times.

use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use plc_protocol::port::Port;
use plc_protocol::server::{Origin, ServedPort, ServerTransport};
use plc_protocol::types::command::{Command, CommandMeta};
use plc_protocol::types::data::{ToolChange, ToolData, VariableArea, WorkOffsetTable};
use plc_protocol::types::message::Payload;
use plc_protocol::types::output::{Redeliver, Redelivery};
use plc_protocol::types::request::{Answer, Refusal, RefusalCode, Request};
use plc_protocol::types::topic::{CsTopic, Topic};
use plc_protocol::wire::right::Right;

use super::oracle::{LOST, SharedOracle};
use super::port_observer::PortObserver;
use super::random::Random;
use super::trace::Trace;

/// Access to the machine that runs at present: the number of its start, and its port.
#[derive(Clone, Default)]
pub(super) struct Current(Arc<Mutex<(u32, Option<Arc<PortObserver>>)>>);

impl Current {
    pub fn set(&self, witness: Option<Arc<PortObserver>>) {
        let mut current = self.0.lock();
        current.0 += 1;
        current.1 = witness;
    }

    fn get(&self) -> Option<(u32, Arc<PortObserver>)> {
        let current = self.0.lock();
        Some((current.0, current.1.clone()?))
    }

    /// Sends a request to the machine. Returns `None` if the result is unknown, because the machine ended or
    /// did not answer within 20 s.
    pub async fn ask(&self, request: Request) -> Option<Result<Answer, Refusal>> {
        let (start, witness) = self.get()?;
        let origin = Origin {
            user: Some("operator".to_owned()),
            from: None,
            over: ServerTransport::Rest,
            right: Right::Operate,
            not_after: None,
        };
        let asked = witness.request_from(origin, request);
        let answer = tokio::time::timeout(Duration::from_secs(20), asked).await;
        let is_same = self.0.lock().0 == start && !witness.disk.is_dead();
        answer.ok().filter(|_| is_same)
    }
}

pub(super) struct Operator {
    pub current: Current,
    pub truth: SharedOracle,
    pub random: Random,
    pub trace: Trace,
    pub count: u64,
    /// Longest pause between two actions, ms.
    pub pace_ms: u64,
}

/// Programs that operators run, by number.
pub(super) const PROGRAMS: [(u16, &str); 4] = [
    (80, "G91\nG01 X4 F6000\nM100\nG01 X-4\nM30\n"),
    (
        81,
        "G91\nM08\nG01 X2 F3000\nM100 VA2\nG01 X-2\nM101 VA1\nM102\nM09\nM30\n",
    ),
    (
        82,
        "P5 = 0\nwhile (P5 < 3) {\nP5 = P5 + 1\nG91 G01 X1 F6000\nM101\nG01 X-1\n}\nM30\n",
    ),
    (83, "G91\nG00 X3\nG04 P0.2\nM98 P80\nG00 X-3\nM30\n"),
];

impl Operator {
    pub async fn run(mut self) {
        loop {
            let pause = self.random.ms(5, self.pace_ms);
            tokio::time::sleep(pause).await;
            self.count += 1;
            match self.random.below(100) {
                0..30 => self.change().await,
                30..50 => self.run_a_program().await,
                50..56 => self.decide().await,
                _ => self.command().await,
            }
        }
    }

    /// Writes a random variable, tool, work offset or program.
    async fn change(&mut self) {
        let (name, value, request) = match self.random.below(4) {
            0 => {
                let (place, value) = (1000 + self.random.below(300), self.count);
                variable(place, value)
            }
            1 => tool(1 + self.random.below(3), self.count),
            2 => offset(54 + self.random.below(6), self.count),
            _ => {
                let number = 90 + u16::try_from(self.random.below(4)).unwrap();
                if self.random.percent(25) {
                    (
                        format!("O{number}"),
                        "none".to_owned(),
                        Request::DeleteProgram(number),
                    )
                } else {
                    let size = 1 + self.random.below(120);
                    let text = format!(
                        "(copy {})\n{}M30\n",
                        self.count,
                        "G04 P0.1\n".repeat(usize::try_from(size).unwrap())
                    );
                    program(number, &text)
                }
            }
        };
        change(&self.current, &self.truth, &self.trace, (name, value, request)).await;
    }

    /// Runs a random program: resets, loads and starts it.
    async fn run_a_program(&mut self) {
        let program = self.random.pick(&PROGRAMS).0;
        for command in [Command::Reset, Command::Load { program }, Command::Start] {
            self.count += 1;
            self.ask(1, command, true).await;
        }
    }

    /// Decides that outputs of a lost handler are repeated.
    async fn decide(&mut self) {
        let Some((_, witness)) = self.current.get() else {
            return;
        };
        let pending = witness.read(&Topic::cs(1, CsTopic::Pending)).await;
        let Some(Payload::Pending(pending)) = pending.as_deref().map(|message| &message.payload) else {
            return;
        };
        for lost in pending.outputs.iter().filter(|open| open.lost) {
            let redeliver = Redeliver {
                boot_id: witness.boot_id(),
                seq: lost.output.seq,
                how: Redelivery::Redo,
            };
            let answer = self.current.ask(Request::Redeliver(1, None, redeliver)).await;
            self.trace.line(format_args!("operator: redeliver: {answer:?}"));
        }
    }

    async fn command(&mut self) {
        let cs = if self.random.percent(80) { 1 } else { 2 };
        let command = match self.random.below(100) {
            0..20 => Command::Load {
                program: self.random.pick(&PROGRAMS).0,
            },
            20..55 => Command::Start,
            55..62 => Command::Hold,
            62..72 => Command::Resume,
            72..77 => Command::Stop,
            77..79 => Command::Abort,
            79..89 => Command::Reset,
            89..94 => Command::Mdi {
                text: "G91 G01 X0.5 F3000\nM100\nG01 X-0.5".to_owned(),
                is_macro: false,
            },
            94..97 => Command::Jog {
                axis: 'X',
                velocity: if self.random.percent(50) { 600.0 } else { -600.0 },
                distance: Some(1.0),
                refresh_id: format!("jog-{}", self.count),
            },
            _ => Command::Home { axes: vec!['X'] },
        };
        let wait = self.random.percent(20);
        self.ask(cs, command, wait).await;
    }

    async fn ask(&mut self, cs: u8, command: Command, wait: bool) {
        let meta = CommandMeta {
            command_id: format!("rest-{}", self.count),
            client_id: "operator".to_owned(),
            ..CommandMeta::default()
        };
        let text = format!("{command:?}");
        let request = Request::Command {
            cs,
            command,
            meta,
            wait,
        };
        let answer = self.current.ask(request).await;
        self.trace.line(format_args!("operator: {cs} {text}: {answer:?}"));
    }
}

type StoredValueChange = (String, String, Request);

fn variable(place: u64, value: u64) -> StoredValueChange {
    let request = Request::WriteVariables {
        area: VariableArea::Global,
        from: u32::try_from(place).unwrap(),
        values: vec![value as f64],
        meta: None,
    };
    (format!("P{place}"), value.to_string(), request)
}

fn tool(id: u64, value: u64) -> StoredValueChange {
    let tool = ToolData {
        id: u16::try_from(id).unwrap(),
        radius: 1.0,
        length: value as f64,
    };
    let change = ToolChange {
        tools: vec![tool],
        remove: Vec::new(),
    };
    (format!("T{id}"), value.to_string(), Request::WriteTools(change))
}

fn offset(number: u64, value: u64) -> StoredValueChange {
    let axes = [("X".to_owned(), value as f64)].into();
    let change = WorkOffsetTable {
        work_offsets: [(format!("G{number}"), axes)].into(),
    };
    (
        format!("G{number}"),
        value.to_string(),
        Request::WriteWorkOffsets(1, change),
    )
}

pub(super) fn program(number: u16, text: &str) -> StoredValueChange {
    let request = Request::WriteProgram(number, text.to_owned());
    (format!("O{number}"), text.to_owned(), request)
}

pub(super) async fn change(
    current: &Current,
    truth: &SharedOracle,
    trace: &Trace,
    (name, value, request): StoredValueChange,
) {
    truth.lock().attempt(&name, &value);
    let answer = current.ask(request).await;
    trace.line(format_args!("operator: {name} = {value:.30?}: {answer:?}"));
    match answer {
        Some(Ok(_)) => truth.lock().acknowledge(&name, &value),
        // It is unknown whether the disk has stored the value.
        Some(Err(refusal)) if refusal.code == RefusalCode::Unavailable => {}
        Some(Err(refusal)) if refusal.code == RefusalCode::NotFound && value == "none" => {
            truth.lock().refused(&name, &value);
        }
        Some(Err(_)) => truth.lock().refused(&name, &value),
        None => {}
    }
}

/// Returns the current value of a variable, tool, work offset or program on the machine.
pub(super) async fn read(port: &dyn Port, name: &str) -> String {
    let (kind, number) = name.split_at(1);
    let number: u16 = number.parse().unwrap();
    let shown = |value: f64| {
        if value.is_nan() {
            LOST.to_owned()
        } else {
            value.to_string()
        }
    };
    let request = match kind {
        "P" => Request::ReadVariables {
            area: VariableArea::Global,
            from: u32::from(number),
            count: 1,
            meta: None,
        },
        "T" => Request::Tools,
        "G" => Request::WorkOffsets(1),
        _ => Request::ReadProgram(number),
    };
    match port.request(request).await {
        Ok(Answer::Variables(values)) => shown(values[0]),
        Ok(Answer::Tools(table)) => {
            let tool = table.tools.iter().find(|tool| tool.id == number);
            tool.map_or("none".to_owned(), |tool| shown(tool.length))
        }
        Ok(Answer::WorkOffsets(table)) => {
            let axes = table.work_offsets.get(name);
            // If the offset of an axis is lost, the axis is missing from the table.
            axes.and_then(|axes| axes.get("X"))
                .map_or(LOST.to_owned(), |x| shown(*x))
        }
        Ok(Answer::ProgramText(text)) => text,
        Err(refusal) if refusal.code == RefusalCode::NotFound => "none".to_owned(),
        Err(refusal) if refusal.code == RefusalCode::Unavailable => LOST.to_owned(),
        other => format!("{other:?}"),
    }
}
