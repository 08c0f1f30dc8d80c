//! `tandem simulate` and `tandem check` as processes, and their results.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

use super::binary::tandem;
use super::machine::Machine;

/// Runs `tandem` to its end in a folder.
pub fn run(folder: &Path, arguments: &[&str]) -> Ran {
    let output = Command::new(tandem())
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("tandem starts");
    Ran::new(output)
}

/// An ended process.
pub struct Ran {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

impl Ran {
    pub fn new(output: Output) -> Self {
        Self {
            code: output.status.code().expect("an exit code"),
            stdout: String::from_utf8(output.stdout).expect("text"),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }

    /// Standard output as the one JSON object that it must be.
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.stdout)
            .unwrap_or_else(|error| panic!("{error} in {}\n{}", self.stdout, self.stderr))
    }
}

/// One line of a trace.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    pub time_s: f64,
    pub program: u16,
    pub line: u32,
    /// Values in the order of the header.
    pub axes: Vec<f64>,
}

/// A finished simulation.
pub struct Simulated {
    pub ran: Ran,
    pub json: Value,
    pub trace: Vec<Row>,
    pub events: Vec<Value>,
}

/// Simulates a program on the machine of `Machine::new("")`, starting there at machine zero.
pub fn simulate(program: &str) -> Simulated {
    simulate_on(&Machine::new(""), program, &[])
}

/// Simulates a program on a machine, with further arguments. It must not be refused.
pub fn simulate_on(machine: &Machine, program: &str, arguments: &[&str]) -> Simulated {
    machine.write("main.nc", program);
    let mut all = vec!["simulate", "main.nc", "--config", "tandem.toml", "--json"];
    all.extend(["--trace", "trace.csv", "--events", "events.jsonl"]);
    all.extend(arguments);
    let ran = run(machine.folder(), &all);
    let json = ran.json();
    Simulated {
        trace: read_trace(&machine.path("trace.csv")),
        events: read_events(&machine.path("events.jsonl")),
        ran,
        json,
    }
}

fn read_trace(path: &Path) -> Vec<Row> {
    let text = std::fs::read_to_string(path).unwrap_or_default();
    let row = |line: &str| {
        let mut cells = line.split(',');
        let mut cell = || cells.next().expect("a cell");
        let (time_s, program, line) = (cell(), cell(), cell());
        Row {
            time_s: time_s.parse().expect("seconds"),
            program: program.parse().expect("a program number"),
            line: line.parse().expect("a line number"),
            axes: cells.map(|cell| cell.parse().expect("a position")).collect(),
        }
    };
    text.lines().skip(1).map(row).collect()
}

fn read_events(path: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(path).unwrap_or_default();
    text.lines()
        .map(|line| serde_json::from_str(line).expect("a JSON object a line"))
        .collect()
}

impl Simulated {
    /// Checks that the run has ended without an alarm.
    pub fn completed(self) -> Self {
        assert_eq!(self.json["outcome"], "completed", "{}", self.json);
        assert_eq!(self.ran.code, 0, "{}", self.ran.stderr);
        self
    }

    /// Checks that the run has ended with an alarm; returns its number.
    pub fn alarm(&self) -> u64 {
        assert_eq!(self.json["outcome"], "alarm", "{} {}", self.json, self.ran.stderr);
        assert_eq!(self.ran.code, 1, "{}", self.ran.stderr);
        self.json["alarm"]["number"].as_u64().expect("an alarm number")
    }

    pub fn cycle_time_s(&self) -> f64 {
        self.json["cycle_time_s"].as_f64().expect("cycle_time_s")
    }

    pub fn machine(&self, axis: &str) -> f64 {
        self.json["machine"][axis].as_f64().expect("a machine position")
    }

    pub fn work(&self, axis: &str) -> f64 {
        self.json["work"][axis].as_f64().expect("a work position")
    }

    /// Returns the position of an axis at the issue of each M code.
    pub fn at_outputs(&self, axis: usize) -> Vec<f64> {
        let outputs = self.events.iter().filter(|event| event["event"] == "output");
        let times = outputs.map(|output| output["t_s"].as_f64().expect("a time"));
        let before = |t_s: f64| self.trace.partition_point(|row| row.time_s <= t_s);
        times
            .map(|t_s| self.trace[before(t_s).saturating_sub(1)].axes[axis])
            .collect()
    }

    /// Returns positions of an axis during a line of a program and the one before: sample 0 is at rest.
    pub fn samples(&self, program: u16, line: u32, axis: usize) -> Vec<f64> {
        let positions = |rows: &[Row]| rows.iter().map(|row| row.axes[axis]).collect::<Vec<_>>();
        let first = self
            .trace
            .iter()
            .position(|row| (row.program, row.line) == (program, line));
        let first = first.unwrap_or_else(|| panic!("line {line} of program {program} is not in the trace"));
        let last = self
            .trace
            .iter()
            .rposition(|row| (row.program, row.line) == (program, line));
        let all = positions(&self.trace[first.saturating_sub(1)..=last.unwrap_or(first)]);
        // The last sample at rest is sample 0.
        let rest = all.iter().take_while(|position| **position == all[0]).count();
        all[rest.saturating_sub(1)..].to_vec()
    }

    /// Events of a kind.
    pub fn events(&self, kind: &str) -> Vec<&Value> {
        self.events
            .iter()
            .filter(|event| event["event"] == kind)
            .collect()
    }

    /// Kinds of events and the M code or line that belongs to them, in order: `output 8`, `block 3`, `end`.
    pub fn story(&self, kinds: &[&str]) -> Vec<String> {
        let of_interest = self
            .events
            .iter()
            .filter(|event| kinds.contains(&text(event, "event")));
        of_interest
            .map(|event| {
                let kind = text(event, "event");
                match kind {
                    "output" | "reset" => format!("{kind} {}", event["m"]),
                    "block" => format!("{kind} {}", event["line"]),
                    _ => kind.to_owned(),
                }
            })
            .collect()
    }

    /// Returns the time of the first event of a kind with this value in a field.
    pub fn at_s(&self, kind: &str, field: &str, value: u64) -> f64 {
        let found = self
            .events
            .iter()
            .find(|event| event["event"] == kind && event[field] == value);
        let found = found.unwrap_or_else(|| panic!("no {kind} with {field} {value} in {:?}", self.events));
        found["t_s"].as_f64().expect("t_s")
    }
}

fn text<'a>(event: &'a Value, field: &str) -> &'a str {
    event[field].as_str().unwrap_or_default()
}
