//! Runs the commands of README and book unchanged, in the order of their page.
//!
//! The word after a block's language selects the treatment:
//! - `sh`: run, and must succeed, except blocks in which every command is in [`NOT_RUN`];
//!   `sh,background`: runs during the rest of the page;
//! - `text,output`: lines that the preceding commands print; `text,background`: awaited lines of background commands;
//!   `...` stands for anything;
//! - `file=PATH`: content that the reader writes to a file.
//!
//! A page without its own `tandem serve` uses the demo machine, which the test serves. Every machine has free
//! ports here, which are written where a page says 8080 and 1883.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use plc_api::Plc;
use tandem_runtime::demo_sequence_program;

use super::page::{Block, blocks, pages, read};
use crate::support::binary::{build_beside, example, forget_package, root, select_features_of_tests, tandem};

const HTTP: &str = "127.0.0.1:8080";
const MQTT: &str = "127.0.0.1:1883";

/// Number of pages tested at the same time, because they wait more than they compute.
const READERS: usize = 3;

/// The longest wait is the cold build of a reader's project.
const PATIENCE: Duration = Duration::from_mins(5);

/// Commands that are not run: they change the computer, need another computer, run all tests, or are a
/// pattern.
const NOT_RUN: [&str; 27] = [
    "./tests/quick",
    "git clone",
    "RUSTFLAGS=",
    "TANDEM_TRACE=",
    "export CARGO_TARGET_",
    "cd tandem",
    "cd editors/vscode",
    "cargo run --release",
    "cargo install",
    "cargo test -p",
    "tandem fleet",
    // the OPC UA server has separate tests: runtime/opcua/tests
    "cargo build --release --locked --manifest-path runtime/opcua",
    "install runtime/opcua",
    "tandem opcua",
    // run by structured_text.rs in the folder above
    "tandem st door.st --run",
    "./tests/run",
    "sudo ",
    "podman ",
    "rustup ",
    "scp ",
    // clients/python/tests/test_page.py runs the Python commands
    "python3 -m venv",
    "venv/bin/",
    // clients/node/tests/package.test.js runs the Node commands
    "npm ci --prefix",
    "npm install",
    "node ",
    "mosquitto_pub -t tandem/v1/mill-1/cs/1/m_code/80/answer",
    "curl -X POST https://mill:8080/api/v1/login",
];

/// A command in the background.
struct Background {
    child: Child,
    log: PathBuf,
    /// Lines that have been waited for already.
    read: usize,
}

impl Background {
    fn start(mut command: Command, log: PathBuf) -> Self {
        let file = std::fs::File::create(&log).unwrap();
        command.stdout(file.try_clone().unwrap()).stderr(file);
        Self {
            child: command.stdin(Stdio::null()).spawn().unwrap(),
            log,
            read: 0,
        }
    }

    /// Waits for a line after the lines that have been read.
    fn line(&mut self, what: &str, fits: impl Fn(&str) -> bool) -> String {
        let end = Instant::now() + PATIENCE;
        loop {
            let ended = self.child.try_wait().unwrap();
            let log = std::fs::read_to_string(&self.log).unwrap();
            let lines = log.split_inclusive('\n').filter(|line| line.ends_with('\n'));
            let found = lines
                .enumerate()
                .skip(self.read)
                .find(|(_, line)| fits(line.trim_end()));
            if let Some((number, line)) = found {
                self.read = number + 1;
                return line.trim_end().to_owned();
            }
            assert!(ended.is_none(), "it ended before `{what}`:\n{log}");
            assert!(Instant::now() < end, "`{what}` is not printed:\n{log}");
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        // The process may already have ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A reader of a page, who types its commands.
struct Reader {
    home: tempfile::TempDir,
    folder: PathBuf,
    http: String,
    mqtt: String,
    going_on: Vec<Background>,
    output: String,
    demo_handlers: Option<tokio::task::JoinHandle<()>>,
}

impl Drop for Reader {
    fn drop(&mut self) {
        if let Some(handlers) = &self.demo_handlers {
            handlers.abort();
        }
    }
}

impl Reader {
    fn new() -> Self {
        let home = tempfile::tempdir().unwrap();
        let bin = home.path().join("bin");
        std::fs::create_dir(&bin).unwrap();
        std::os::unix::fs::symlink(tandem(), bin.join("tandem")).unwrap();
        // an answer of 4xx is a failure here
        let curl = "#!/bin/bash\nexec /usr/bin/env -S curl --fail-with-body --silent --show-error \"$@\"\n";
        let path = std::env::var("PATH").unwrap();
        let curl = curl.replace("/usr/bin/env -S curl", &format!("env PATH='{path}' curl"));
        std::fs::write(bin.join("curl"), curl).unwrap();
        let mode = std::os::unix::fs::PermissionsExt::from_mode(0o755);
        std::fs::set_permissions(bin.join("curl"), mode).unwrap();
        build_beside(home.path());
        let folder = home.path().join("tandem");
        std::fs::create_dir(&folder).unwrap();
        std::os::unix::fs::symlink(root().join("examples"), folder.join("examples")).unwrap();
        Self {
            home,
            folder,
            http: HTTP.to_owned(),
            mqtt: MQTT.to_owned(),
            going_on: Vec::new(),
            output: String::new(),
            demo_handlers: None,
        }
    }

    /// Returns a text of the page with the ports of this machine, and with the built examples.
    fn here(&self, text: &str) -> String {
        let (_, port) = self.mqtt.rsplit_once(':').unwrap();
        let mut text = text.replace(HTTP, &self.http).replace(MQTT, &self.mqtt);
        for command in ["mosquitto_pub ", "mosquitto_sub "] {
            text = text.replace(command, &format!("{command}-p {port} "));
        }
        while let Some((before, rest)) = text.split_once("cargo run --example ") {
            let end = rest.find(char::is_whitespace).unwrap_or(rest.len());
            let (name, arguments) = rest.split_at(end);
            let arguments = arguments.strip_prefix(" --").unwrap_or(arguments);
            text = format!("{before}{}{arguments}", example(name).display());
        }
        text
    }

    fn bash(&self, script: &str) -> Command {
        let mut bash = Command::new("bash");
        bash.args(["-euo", "pipefail", "-c", script])
            .current_dir(&self.folder);
        forget_package(&mut bash);
        bash.env_remove("CARGO_TARGET_DIR");
        let cargo = Path::new(env!("CARGO")).parent().unwrap();
        let path = std::env::var("PATH").unwrap();
        let bin = self.home.path().join("bin");
        bash.env("PATH", format!("{}:{}:{path}", bin.display(), cargo.display()));
        bash
    }

    /// Runs commands; the next ones start in the folder in which these end.
    fn run(&mut self, script: &str) {
        let place = self.home.path().join("folder");
        let script = format!("{}\npwd >'{}'", self.here(script), place.display());
        let ran = self.bash(&script).stdin(Stdio::null()).output().unwrap();
        let said = String::from_utf8_lossy(&ran.stdout);
        let complained = String::from_utf8_lossy(&ran.stderr);
        assert!(ran.status.success(), "{script}\nfails:\n{said}{complained}");
        self.output = format!("{said}{complained}");
        self.folder = PathBuf::from(std::fs::read_to_string(place).unwrap().trim_end());
        if self.folder.join("Cargo.toml").is_file() {
            select_features_of_tests(&self.folder);
        }
    }

    /// Starts a command in the background.
    fn start(&mut self, script: &str) {
        let lines: Vec<&str> = script.lines().collect();
        let [line] = lines[..] else {
            panic!("one command goes on, not {lines:?}");
        };
        if line == "tandem" || line.starts_with("tandem serve") {
            self.serve(line);
            return;
        }
        let command = self.bash(&format!("exec {}", self.here(line)));
        self.background(command);
    }

    fn background(&mut self, command: Command) {
        let log = self.home.path().join(format!("log-{}", self.going_on.len()));
        self.going_on.push(Background::start(command, log));
    }

    /// Serves a machine on free ports: that of a configuration, or the demo with its handlers.
    fn serve(&mut self, line: &str) {
        let config = line
            .split_once("--config ")
            .map(|(_, file)| self.folder.join(file.trim()));
        let is_demo = config.is_none();
        let config = config.unwrap_or_else(|| root().join("examples/config/demo.toml"));
        let mut text = std::fs::read_to_string(&config)
            .unwrap()
            .replace("../nc/", &format!("{}/examples/nc/", root().display()))
            .replace(HTTP, "127.0.0.1:0")
            .replace(MQTT, "127.0.0.1:0");
        for table in ["[http]", "[mqtt]"] {
            if !text.contains(table) {
                writeln!(text, "\n{table}\nlisten = \"127.0.0.1:0\"").unwrap();
            }
        }
        let served = if is_demo {
            self.folder.join("demo.toml")
        } else {
            config
        };
        std::fs::write(&served, text).unwrap();
        let mut command = self.bash("exec tandem serve --config \"$0\"");
        command.arg(&served);
        self.background(command);
        let machine = self.going_on.last_mut().unwrap();
        let address = |line: &str, before: &str| {
            let rest = line.split_once(before).unwrap().1;
            rest.split(['/', ' ']).next().unwrap().to_owned()
        };
        self.http = address(&machine.line("REST", |line| line.contains("REST")), "http://");
        self.mqtt = address(&machine.line("MQTT", |line| line.contains("MQTT")), "mqtt://");
        machine.read = 0;
        if is_demo {
            let url = format!("mqtt://{}/mill-1", self.mqtt);
            self.demo_handlers = Some(tokio::spawn(async move {
                let plc = Plc::connect(&url).await.unwrap();
                // the machine ends after the page
                let _ = demo_sequence_program().run(&plc).await;
            }));
        }
    }

    fn write(&self, file: &str, text: &str) {
        let path = self.folder.join(file);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }

    /// Runs a block.
    fn follow(&mut self, block: &Block) {
        if block.is("sh", "background") {
            self.start(&block.text);
        } else if block.info == "sh" {
            if !is_not_run(&block.text) {
                self.run(&block.text);
            }
        } else if block.is("text", "output") {
            let mut output = self.output.lines();
            for expected in lines(&self.here(&block.text)) {
                let is_there = output.any(|line| fits(&expected, line));
                assert!(is_there, "`{expected}` is not in\n{}", self.output);
            }
        } else if block.is("text", "background") {
            let expected = lines(&self.here(&block.text));
            let going_on = self.going_on.last_mut().expect("something goes on");
            for line in expected {
                going_on.line(&line, |said| fits(&line, said));
            }
        } else if let Some(file) = block.file() {
            self.write(file, &block.text);
        } else {
            let language = block.info.split(',').next().unwrap();
            assert!(
                ["text", "toml", "rust", "nc", "json", "js", "ini"].contains(&language),
                "{}",
                block.info
            );
        }
    }
}

/// Returns true if no command of a block can be run here.
fn is_not_run(text: &str) -> bool {
    let is_not_run = |line: &String| NOT_RUN.iter().any(|begin| line.starts_with(begin));
    commands(text).iter().all(is_not_run)
}

/// Returns the commands of a block: its lines without comments; lines that end with `\` are joined with the
/// next one.
fn commands(text: &str) -> Vec<String> {
    let joined = text.replace("\\\n", " ");
    let lines = joined.lines().map(str::trim);
    lines
        .filter(|line| !line.is_empty() && !line.starts_with('#'))
        .map(str::to_owned)
        .collect()
}

/// Returns the expected lines; a line `...` matches any number of lines.
fn lines(text: &str) -> Vec<String> {
    let lines = text.lines().map(str::trim);
    lines
        .filter(|line| !line.is_empty() && *line != "...")
        .map(str::to_owned)
        .collect()
}

/// Returns true if a line matches the expected one, in which `...` matches any text.
fn fits(expected: &str, line: &str) -> bool {
    let mut rest = line.trim();
    let mut parts = expected.split("...").peekable();
    let mut is_first = true;
    while let Some(part) = parts.next() {
        let is_last = parts.peek().is_none();
        let at = match (is_first, is_last) {
            (true, _) => rest.starts_with(part).then_some(0),
            (false, true) => rest.ends_with(part).then(|| rest.len() - part.len()),
            (false, false) => rest.find(part),
        };
        let Some(at) = at else {
            return false;
        };
        rest = &rest[at + part.len()..];
        is_first = false;
    }
    rest.is_empty()
}

/// Returns true if a page uses the demo machine without starting it.
fn needs_demo(blocks: &[Block]) -> bool {
    let runs = |block: &&Block| block.info == "sh" || block.is("sh", "background");
    let speaks = |block: &Block| block.text.contains(HTTP) || block.text.contains("mosquitto_");
    let serves = |block: &Block| block.is("sh", "background") && block.text.starts_with("tandem");
    blocks.iter().filter(runs).any(speaks) && !blocks.iter().any(serves)
}

/// Tests a page; returns its number of command blocks.
fn follow(path: &str) -> usize {
    let blocks = blocks(&read(path));
    let count = blocks.iter().filter(|block| block.info.starts_with("sh")).count();
    if count == 0 {
        return 0;
    }
    let mut reader = Reader::new();
    if needs_demo(&blocks) {
        reader.serve("tandem");
    }
    for block in &blocks {
        eprintln!("{path}:{}", block.line);
        reader.follow(block);
    }
    count
}

/// Returns the next page, after releasing the lock.
fn next(pages: &Mutex<impl Iterator<Item = String>>) -> Option<String> {
    pages.lock().unwrap().next()
}

#[tokio::test(flavor = "multi_thread")]
async fn every_command_of_readme_and_book_does_what_its_page_says() {
    let others = ["README.md", "CONTRIBUTING.md"].map(str::to_owned);
    let pages = Mutex::new(pages().into_iter().chain(others));
    let (followed, wrong) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let of_test = tokio::runtime::Handle::current();
    std::thread::scope(|scope| {
        for _ in 0..READERS {
            scope.spawn(|| {
                let _entered = of_test.enter();
                while let Some(page) = next(&pages) {
                    // a failure in one page does not hide failures in others
                    match std::panic::catch_unwind(|| follow(&page)) {
                        Ok(blocks) => _ = followed.fetch_add(blocks, Ordering::Relaxed),
                        Err(_) => wrong.lock().unwrap().push(page),
                    }
                }
            });
        }
    });
    let (followed, wrong) = (followed.into_inner(), wrong.into_inner().unwrap());
    assert!(wrong.is_empty(), "{wrong:?}");
    assert!(followed > 20, "only {followed} blocks of commands found");
}

#[test]
fn a_line_fits_where_three_dots_stand_for_anything() {
    assert!(fits("completed after ... s", "  completed after 2.388 s"));
    assert!(fits("a...c...e", "abcde") && fits("...", "") && fits("ab", "ab"));
    assert!(!fits("a...c", "abcd") && !fits("ab", "abc") && !fits("b...", "abc"));
}

#[test]
fn a_block_is_left_out_only_if_no_command_of_it_can_be_run() {
    assert!(is_not_run("./tests/run\nsudo reboot   # later\n"));
    assert!(!is_not_run("./tests/run\ntandem check\n"));
}

#[test]
#[should_panic(expected = "fails")]
fn a_command_that_fails_is_found() {
    let page = "```sh\ntandem explain E9999\n```\n";
    Reader::new().follow(&blocks(page)[0]);
}

#[test]
#[should_panic(expected = "is not in")]
fn a_line_that_is_not_printed_is_found() {
    let mut reader = Reader::new();
    for block in blocks("```sh\ntandem --version\n```\n```text,output\ntandem 99\n```\n") {
        reader.follow(&block);
    }
}
