//! `tandem serve` as a separate process, and requests to it.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use tokio_tungstenite::tungstenite::Message;

use super::binary::tandem;
use super::http::{Answer, request};
use super::machine::Machine;
use super::schemas::{check_asked, check_frame};
use super::wait::{History, PATIENCE, until};

/// Free ports, as a part of a configuration.
pub const FREE_PORTS: &str = "[http]\nlisten = \"127.0.0.1:0\"\n[mqtt]\nlisten = \"127.0.0.1:0\"\n";

/// Number of bytes of the last output of a process that a failing test shows.
const SHOWN_MAX: usize = 64 * 1024;

/// A process whose output is read line by line; killed when it is dropped.
pub struct Process {
    child: Child,
    lines: Receiver<String>,
    /// Both outputs so far.
    pub output: String,
}

impl Process {
    pub fn start(program: &Path, folder: &Path, arguments: &[&str]) -> Self {
        Self::start_with(program, folder, arguments, Stdio::null())
    }

    /// Starts a process that receives input by [`Process::say`].
    pub fn start_listening(program: &Path, folder: &Path, arguments: &[&str]) -> Self {
        Self::start_with(program, folder, arguments, Stdio::piped())
    }

    fn start_with(program: &Path, folder: &Path, arguments: &[&str], input: Stdio) -> Self {
        let mut child = Command::new(program)
            .args(arguments)
            .current_dir(folder)
            .stdin(input)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| panic!("{} does not start: {error}", program.display()));
        let (sender, lines) = channel();
        let read = |stream: Box<dyn std::io::Read + Send>| {
            let sender = sender.clone();
            std::thread::spawn(move || {
                for line in BufReader::new(stream).lines().map_while(Result::ok) {
                    if sender.send(line).is_err() {
                        return;
                    }
                }
            });
        };
        read(Box::new(child.stdout.take().expect("a pipe")));
        read(Box::new(child.stderr.take().expect("a pipe")));
        Self {
            child,
            lines,
            output: String::new(),
        }
    }

    /// Limits the size of files that the process writes, in bytes; with `unlimited` the disk accepts all
    /// writes again.
    pub fn limit_file_bytes(&self, bytes: &str) {
        let limited = Command::new("prlimit")
            .arg(format!("--pid={}", self.child.id()))
            .arg(format!("--fsize={bytes}"))
            .status();
        assert!(limited.is_ok_and(|status| status.success()), "prlimit");
    }

    /// Sends a line to the process.
    pub fn say(&mut self, line: &str) {
        let input = self.child.stdin.as_mut().expect("a process that listens");
        writeln!(input, "{line}").expect("it listens");
    }

    /// Kills the process, and returns its whole output.
    pub fn killed(mut self) -> String {
        self.child.kill().expect("a process of ours");
        self.exit_code_within(PATIENCE);
        std::mem::take(&mut self.output)
    }

    /// Reads until a line matches.
    pub fn line(&mut self, what: &str, fits: impl Fn(&str) -> bool) -> String {
        let end = Instant::now() + PATIENCE;
        loop {
            match self
                .lines
                .recv_timeout(end.saturating_duration_since(Instant::now()))
            {
                Ok(line) => {
                    self.output.push_str(&line);
                    self.output.push('\n');
                    if fits(&line) {
                        return line;
                    }
                }
                Err(RecvTimeoutError::Timeout) => panic!("{what}: not printed in time\n{}", self.output),
                Err(RecvTimeoutError::Disconnected) => panic!("{what}: not printed\n{}", self.output),
            }
        }
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    pub fn signal(&self, name: &str) {
        let kill = Command::new("kill")
            .arg(format!("-{name}"))
            .arg(self.child.id().to_string())
            .status();
        assert!(kill.expect("kill starts").success());
    }

    /// Returns the exit code if the process ends within a time.
    pub fn exit_code_within(&mut self, limit: Duration) -> Option<i32> {
        let end = Instant::now() + limit;
        loop {
            if let Some(status) = self.child.try_wait().expect("a process of ours") {
                self.read_to_the_end();
                return status.code();
            }
            if Instant::now() >= end {
                return None;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    fn read_to_the_end(&mut self) {
        while let Ok(line) = self.lines.recv_timeout(Duration::from_secs(1)) {
            self.output.push_str(&line);
            self.output.push('\n');
        }
    }
}

impl Drop for Process {
    /// In a failing test, shows the last output of the process.
    fn drop(&mut self) {
        // The process may already have ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
        if std::thread::panicking() {
            self.read_to_the_end();
            let hidden = self.output.len().saturating_sub(SHOWN_MAX);
            let shown = String::from_utf8_lossy(&self.output.as_bytes()[hidden..]);
            eprintln!(
                "process {}, without its first {hidden} bytes:\n{shown}",
                self.child.id()
            );
        }
    }
}

/// A machine that is served.
pub struct Served {
    pub process: Process,
    pub http: String,
    pub broker: String,
}

impl Served {
    /// Starts `tandem serve` with a machine's configuration and waits until it has printed its addresses.
    pub fn start(machine: &Machine) -> Self {
        let config = machine.config();
        let arguments = ["serve", "--config", config.to_str().expect("a path in UTF-8")];
        Self::of(Process::start(tandem(), machine.folder(), &arguments))
    }

    /// Starts a process whose disk can be made to fail: [`Process::limit_file_bytes`].
    pub fn start_with_failing_disk(machine: &Machine) -> Self {
        let config = machine.config();
        let path = |path: &Path| path.to_str().expect("a path in UTF-8").to_owned();
        let script = "trap '' XFSZ; exec \"$0\" serve --config \"$1\"";
        let arguments = ["-c", script, &path(tandem()), &path(&config)];
        Self::of(Process::start(Path::new("/bin/sh"), machine.folder(), &arguments))
    }

    /// Waits until a process of `tandem serve` has printed its addresses.
    pub fn of(mut process: Process) -> Self {
        let after = |line: &str, what: &str| {
            let rest = line.split_once(what).expect("an address").1;
            rest.split(['/', ' ']).next().expect("an address").to_owned()
        };
        let rest = process.line("the HTTP address", |line| line.trim_start().starts_with("REST"));
        let http = after(&rest, "://");
        let mqtt = process.line("the MQTT address", |line| line.trim_start().starts_with("MQTT"));
        let broker = after(&mqtt, "://");
        Self {
            process,
            http,
            broker,
        }
    }

    /// Returns the address for `Plc::connect`.
    pub fn mqtt_url(&self) -> String {
        format!("mqtt://{}/test-1", self.broker)
    }

    /// Returns the address for `Plc::connect` over REST and WebSocket.
    pub fn http_url(&self) -> String {
        format!("http://{}", self.http)
    }

    pub async fn get(&self, path: &str) -> Answer {
        request(&self.http, "GET", &format!("/api/v1{path}"), "", "").await
    }

    pub async fn post(&self, path: &str, body: &Value) -> Answer {
        let body = if body.is_null() {
            String::new()
        } else {
            body.to_string()
        };
        request(
            &self.http,
            "POST",
            &format!("/api/v1{path}"),
            "application/json",
            &body,
        )
        .await
    }

    pub async fn put(&self, path: &str, body: &Value) -> Answer {
        let path = format!("/api/v1{path}");
        request(&self.http, "PUT", &path, "application/json", &body.to_string()).await
    }

    pub async fn put_program(&self, number: u16, text: &str) -> Answer {
        request(
            &self.http,
            "PUT",
            &format!("/api/v1/programs/{number}"),
            "text/plain",
            text,
        )
        .await
    }

    /// Writes a program and loads it.
    pub async fn load(&self, cs: u8, number: u16, text: &str) {
        self.put_program(number, text).await.expect(201);
        self.post(&format!("/cs/{cs}/load?wait=1"), &json!({"program": number}))
            .await
            .expect(200);
    }

    /// Sends a command that must be executed.
    pub async fn command(&self, cs: u8, verb: &str) {
        self.post(&format!("/cs/{cs}/{verb}?wait=1"), &Value::Null)
            .await
            .expect(200);
    }

    pub async fn state(&self, cs: u8) -> Value {
        self.get(&format!("/cs/{cs}/state")).await.expect(200).json()
    }

    /// Waits for a matching state.
    pub async fn state_where(&self, cs: u8, what: &str, fits: impl Fn(&Value) -> bool) -> Value {
        let mut last = Value::Null;
        let waiting = until(what, async || {
            last = self.state(cs).await;
            fits(&last).then(|| last.clone())
        });
        waiting.await
    }

    /// Waits for a state word.
    pub async fn execution(&self, cs: u8, word: &str) -> Value {
        self.state_where(cs, word, |state| state["execution"] == word)
            .await
    }

    /// Resets the output that a coordinate system waits for, as `handler_id`.
    pub async fn reset_output(&self, cs: u8, handler_id: &str, force: bool) -> Answer {
        let state = self.state(cs).await;
        let seq = &state["waiting_on"]["seq"];
        let mut body = json!({"boot_id": state["boot_id"], "handler_id": handler_id, "result": "ok"});
        if force {
            body["force"] = json!(true);
        }
        self.post(&format!("/cs/{cs}/m_codes/{seq}/reset"), &body).await
    }

    /// Returns all messages of a WebSocket about topics, from now on.
    pub async fn watch(&self, topics: &[&str]) -> Watch {
        let url = format!("ws://{}/api/v1/ws", self.http);
        let (mut socket, _) = tokio_tungstenite::connect_async(url).await.expect("a WebSocket");
        let ask = json!({"subscribe": topics});
        assert_eq!(check_asked(&ask), Ok(()));
        let asked = socket.send(Message::text(ask.to_string())).await;
        asked.expect("a subscription");
        let watch = Watch::default();
        let (sink, wrong) = (watch.history.clone(), watch.wrong.clone());
        tokio::spawn(async move {
            while let Some(Ok(message)) = socket.next().await {
                let Message::Text(text) = message else { continue };
                let value: Value = serde_json::from_str(&text).expect("JSON");
                if let Err(error) = check_frame(&value) {
                    wrong.push("wrong".into(), Value::from(error));
                }
                sink.push(value["topic"].as_str().unwrap_or_default().to_owned(), value);
            }
        });
        watch
    }
}

/// Messages of a WebSocket; dropping it fails a test in which a frame was invalid.
#[derive(Default)]
pub struct Watch {
    pub history: History,
    wrong: History,
}

impl Drop for Watch {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            assert_eq!(
                self.wrong.on("wrong"),
                [] as [Value; 0],
                "frames that are not of their form"
            );
        }
    }
}
