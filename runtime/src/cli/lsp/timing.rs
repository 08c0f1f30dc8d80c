//! Determines the run time of a program: `tandem simulate` runs in a separate process, which the next change
//! ends.

use std::collections::BTreeMap;
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender, after, never, unbounded};
use lsp_types::{CodeLens, Range};
use serde::Deserialize;

use super::document::Document;

/// Time limit of a simulation; the server then ends the process.
const LIMIT: Duration = Duration::from_secs(20);

/// Run times of the open programs.
pub(super) struct Timing {
    /// Path of this executable.
    command: PathBuf,
    /// Text for each program, by URI: its run time, or the reason why the run time is unknown.
    titles: BTreeMap<String, String>,
    running: Option<Running>,
    /// Receives results of ended simulations: the number of the simulation, and the printed text.
    pub ended: Receiver<(u64, String)>,
    tell: Sender<(u64, String)>,
    /// Reports when the running simulation has exceeded its time limit.
    pub late: Receiver<Instant>,
    started: u64,
}

struct Running {
    child: Child,
    uri: String,
}

/// Part of the simulation result that the server uses.
#[derive(Deserialize)]
struct SimulationSummary {
    outcome: String,
    cycle_time_s: f64,
    alarm: Option<Alarm>,
}

#[derive(Deserialize)]
struct Alarm {
    number: u16,
    text: String,
    line: Option<u32>,
}

/// Part of the result that the server uses if a called program has errors.
#[derive(Deserialize)]
struct RefusedSimulation {
    diagnostics: Vec<ReportedDiagnostic>,
}

#[derive(Deserialize)]
struct ReportedDiagnostic {
    file: String,
    line: u32,
    message: String,
}

impl Timing {
    pub fn new(command: PathBuf) -> Self {
        let (tell, ended) = unbounded();
        Self {
            command,
            titles: BTreeMap::new(),
            running: None,
            ended,
            tell,
            late: never(),
            started: 0,
        }
    }

    /// Discards the run time of a program that has changed, and ends its simulation.
    pub fn forget(&mut self, uri: &str) {
        self.titles.remove(uri);
        if self.running.as_ref().is_some_and(|running| running.uri == uri) {
            self.stop_simulation();
        }
    }

    /// Records that a program is not simulated because it has errors.
    pub fn refuse(&mut self, uri: &str) {
        let title = "no time: correct the errors first".to_owned();
        self.titles.insert(uri.to_owned(), title);
    }

    /// Starts the simulation of a program without errors; ends a simulation that is still running.
    pub fn start(&mut self, document: &Document) {
        let uri = document.uri.as_str().to_owned();
        self.stop_simulation();
        let mut command = Command::new(&self.command);
        command.args([
            "simulate",
            "-",
            "--json",
            "--dialect",
            document.target.dialect.name,
        ]);
        if let Some(config) = &document.target.config {
            command.arg("--config").arg(config);
        }
        let folder = document.path.parent().filter(|folder| folder.is_dir());
        command.current_dir(folder.unwrap_or(Path::new(".")));
        command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null());
        let Ok(mut child) = command.spawn() else {
            self.titles
                .insert(uri, "no time: the simulation cannot be started".to_owned());
            return;
        };
        self.started += 1;
        let (number, tell) = (self.started, self.tell.clone());
        let (text, stdin, stdout) = (
            document.text().to_owned(),
            child.stdin.take(),
            child.stdout.take(),
        );
        std::thread::spawn(move || {
            if let Some(mut stdin) = stdin {
                // The write fails if the simulation is ended before it has read all input; this error is
                // ignored.
                let _ = stdin.write_all(text.as_bytes());
            }
            let mut printed = String::new();
            if let Some(mut stdout) = stdout {
                let _ = stdout.read_to_string(&mut printed);
            }
            // If the server has ended, the receiver no longer exists.
            let _ = tell.send((number, printed));
        });
        self.running = Some(Running { child, uri });
        self.late = after(LIMIT);
    }

    /// Handles the end of a simulation. Returns true if the simulation is the current one, so that a new time
    /// is known.
    pub fn accept_result(&mut self, (number, printed): (u64, String)) -> bool {
        if number != self.started {
            return false;
        }
        let Some(uri) = self.running.as_ref().map(|running| running.uri.clone()) else {
            return false;
        };
        self.stop_simulation();
        self.titles.insert(uri, title(&printed));
        true
    }

    /// Ends the running simulation, because it has exceeded its time limit.
    pub fn give_up(&mut self) {
        if let Some(running) = &self.running {
            let title = format!("no time: the simulation takes longer than {} s", LIMIT.as_secs());
            self.titles.insert(running.uri.clone(), title);
        }
        self.stop_simulation();
    }

    fn stop_simulation(&mut self) {
        self.late = never();
        if let Some(mut running) = self.running.take() {
            // The process may already have ended.
            let _ = running.child.kill();
            let _ = running.child.wait();
        }
    }

    /// Returns the code lens with the time of a program; the editor shows it above the first line.
    pub fn lens(&self, document: &Document) -> CodeLens {
        let title = self.titles.get(document.uri.as_str());
        CodeLens {
            range: Range::default(),
            command: Some(lsp_types::Command {
                title: title.map_or("time: ...", String::as_str).to_owned(),
                command: String::new(),
                arguments: None,
            }),
            data: None,
        }
    }
}

impl Drop for Timing {
    fn drop(&mut self) {
        self.stop_simulation();
    }
}

fn title(printed: &str) -> String {
    let Ok(simulated) = serde_json::from_str::<SimulationSummary>(printed) else {
        let refused = serde_json::from_str::<RefusedSimulation>(printed).ok();
        let found = refused.and_then(|refused| refused.diagnostics.into_iter().next());
        return found.map_or_else(
            || "no time: the program cannot be simulated".to_owned(),
            |ReportedDiagnostic { file, line, message }| format!("no time: {file}, line {line}: {message}"),
        );
    };
    let time = format!("{:.3} s", simulated.cycle_time_s);
    match simulated.alarm {
        Some(Alarm { number, text, line }) => {
            let line = line.map(|line| format!(" in line {line}")).unwrap_or_default();
            format!("stops after {time}{line}: alarm {number}, {text}")
        }
        None if simulated.outcome == "completed" => format!("takes {time}"),
        None => format!("ends after {time}"),
    }
}
