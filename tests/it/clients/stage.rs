//! A machine with a driver, and the actions on them.

use std::path::PathBuf;
use std::time::Duration;

use serde_json::{Value, json};

use super::Behaviour;
use crate::support::broker::Mosquitto;
use crate::support::machine::Machine;
use crate::support::mqtt::Bus;
use crate::support::served::{FREE_PORTS, Process, Served};
use crate::support::wait::{until, until_within, within};
use crate::support::wire::Wire;

/// Number of the program of each behaviour.
const PROGRAM: u16 = 60;

/// A source of the interlock that is on while it has no owner.
const DOOR: &str = r#"
[input.interlock.source.door]
on_loss = "on"
coordinate_systems = [1]
"#;

/// An output of the plant.
const LAMP: &str = "[io.out.lamp]\n";

/// Longest time until a level has its value. Reason: a client detects a lost connection within 7.5 s.
const LEVEL_MAX: Duration = Duration::from_secs(20);

/// M codes of the driver, which wait for it.
const M_CODES: &str = r#"
[m_code.20]
unhandled = "wait"
[m_code.21]
unhandled = "wait"
[m_code.23]
unhandled = "wait"
[m_code.24]
unhandled = "wait"
[m_code.22]
unhandled = "wait"
"#;

/// How the driver of a client is started.
#[derive(Clone)]
pub struct Driver {
    pub program: PathBuf,
    pub arguments: Vec<String>,
}

pub struct Stage {
    machine: Machine,
    served: Option<Served>,
    broker: Option<Mosquitto>,
    wire: Wire,
    driver: Driver,
    running: Option<Process>,
    /// Output of earlier drivers.
    said_before: Vec<String>,
}

impl Stage {
    pub async fn set(behaviour: &Behaviour, mut driver: Driver) -> Self {
        let broker = behaviour.broker.then(Mosquitto::start);
        let mqtt = match &broker {
            Some(broker) => super::super::transports::broker_at(&broker.address()),
            None => FREE_PORTS.to_owned(),
        };
        let door = if behaviour.door { DOOR } else { "" };
        let plant = if behaviour.plant { LAMP } else { "" };
        let configured = behaviour.configured.as_deref();
        let configured = configured.map_or_else(String::new, |how| format!("redelivery = \"{how}\"\n"));
        let machine = Machine::new(&format!("{door}{plant}{M_CODES}{configured}{mqtt}"));
        let served = Served::start(&machine);
        let wire = Wire::to(&served.broker).await;
        driver.arguments.extend([
            format!("mqtt://{}/test-1", wire.address()),
            behaviour.redelivery.clone(),
            behaviour.returns_within_ms.to_string(),
            behaviour.ends_within_ms.to_string(),
        ]);
        let mut stage = Self {
            machine,
            served: Some(served),
            broker,
            wire,
            driver,
            running: None,
            said_before: Vec::new(),
        };
        stage.start_driver().await;
        stage
    }

    fn served(&self) -> &Served {
        self.served.as_ref().expect("a machine that runs")
    }

    async fn start_driver(&mut self) {
        let arguments: Vec<&str> = self.driver.arguments.iter().map(String::as_str).collect();
        let folder = self.machine.folder();
        self.running = Some(Process::start_listening(&self.driver.program, folder, &arguments));
        until("the driver serves the machine", async || {
            let handlers = self.served().get("/handlers").await.expect(200).json();
            (handlers["handlers"]["driver"]["online"] == true).then_some(())
        })
        .await;
    }

    /// Executes the actions of a behaviour, and compares the output.
    pub async fn play(mut self, behaviour: &Behaviour) {
        self.served()
            .put_program(PROGRAM, &behaviour.program)
            .await
            .expect(201);
        for step in &behaviour.steps {
            eprintln!("{}: {step}", behaviour.name);
            let (verb, rest) = step.split_once(' ').unwrap_or((step, ""));
            self.step(verb, rest).await;
        }
        let (mut said, mut expected) = (self.end(), behaviour.driver.clone());
        if !behaviour.ordered {
            said.sort();
            expected.sort();
        }
        assert_eq!(said, expected, "{}: what the driver said", behaviour.name);
        if !behaviour.journal.is_empty() {
            self.compare_journal(behaviour).await;
        }
    }

    async fn step(&mut self, verb: &str, rest: &str) {
        match verb {
            "load" => drop(self.load().await.expect(200)),
            "start" if rest.is_empty() => {
                self.load().await.expect(200);
                self.served().command(1, "start").await;
            }
            "refused" => self.is_refused(rest).await,
            "say" => self.running().say(rest),
            "see" => self.see(rest),
            "leaving" => self.is_leaving().await,
            "gone" => self.said_before_its_end(),
            "remedy" | "in" => self.alarm_says(verb, rest).await,
            "state" => {
                let (word, reason) = rest.split_once(' ').unwrap_or((rest, ""));
                let fits = |state: &Value| {
                    state["execution"] == word && state["reason"].as_str().unwrap_or_default() == reason
                };
                self.served().state_where(1, rest, fits).await;
            }
            "progress" => {
                let fits = |state: &Value| state["waiting_on"]["progress"]["text"] == rest;
                self.served().state_where(1, rest, fits).await;
            }
            "asks" => {
                let fits = |state: &Value| state["waiting_on"]["question"]["text"] == rest;
                self.served().state_where(1, rest, fits).await;
            }
            "answer" => self.answer(rest).await,
            "operator" => self.served().command(1, rest).await,
            "by" => drop(self.served().reset_output(1, "operator", true).await.expect(200)),
            "redeliver" => self.redeliver(rest).await,
            "repeat" => self.repeat_the_last_reset().await,
            "lock" => self.lock(rest).await,
            "lamp" => self.lamp(rest).await,
            "force" => self.force_lamp(rest).await,
            _ => self.fault(verb, rest).await,
        }
    }

    /// Breaks or restores a part.
    async fn fault(&mut self, verb: &str, what: &str) {
        match (verb, what) {
            ("kill", "driver") => {
                let process = self.running.take().expect("a driver");
                self.said_before.extend(lines(&process.killed()));
            }
            ("start", "driver") => self.start_driver().await,
            ("suspend", "driver") => self.running().signal("STOP"),
            ("continue", "driver") => self.running().signal("CONT"),
            ("suspend", "machine") => self.served().process.signal("STOP"),
            ("continue", "machine") => self.served().process.signal("CONT"),
            // only real time reveals a suspended process
            ("for", ms) => tokio::time::sleep(Duration::from_millis(ms.parse().expect("ms"))).await,
            ("cut", "") => self.wire.cut(),
            ("tear", "") => self.wire.tear(),
            ("mend", "") => self.wire.mend(),
            ("kill", "broker") => self.broker.as_mut().expect("a broker").kill(),
            ("start", "broker") => self.broker.as_mut().expect("a broker").start_again(),
            ("restart", "machine") => {
                self.served = None;
                self.served = Some(Served::start(&self.machine));
            }
            _ => panic!("there is no step `{verb} {what}`"),
        }
    }

    fn running(&mut self) -> &mut Process {
        self.running.as_mut().expect("a driver that runs")
    }

    fn see(&mut self, said: &str) {
        let line = format!("> {said}");
        self.running().line(said, |said| said == line);
    }

    /// Waits until the machine claims no further output for the driver.
    async fn is_leaving(&self) {
        until("the machine knows that the driver leaves", async || {
            let handlers = self.served().get("/handlers").await.expect(200).json();
            (handlers["handlers"]["driver"]["exclusive"] != true).then_some(())
        })
        .await;
    }

    async fn alarm_says(&self, what: &str, said: &str) {
        let alarms = self.served().get("/alarms").await.expect(200).json();
        let alarm = &alarms["alarms"][0];
        match said.split_once(' ').filter(|_| what == "in") {
            Some((language, text)) => assert_eq!(alarm["languages"][language]["text"], text, "{alarm}"),
            None => assert_eq!(alarm["remedy"], said, "{alarm}"),
        }
    }

    async fn load(&self) -> crate::support::http::Answer {
        let load = json!({"program": PROGRAM});
        self.served().post("/cs/1/load?wait=1", &load).await
    }

    async fn is_refused(&self, said: &str) {
        let refused = self.load().await.expect(422).json();
        let (line, code) = said.split_once(' ').expect("a line and a code");
        let found = &refused["diagnostics"][0];
        let found = (
            found["line"].to_string(),
            found["code"].as_str().unwrap_or_default(),
        );
        assert_eq!(found, (line.to_owned(), code), "{refused}");
    }

    async fn answer(&self, choice: &str) {
        let state = self.served().state(1).await;
        let waiting = &state["waiting_on"];
        let (seq, question) = (&waiting["seq"], &waiting["question"]["id"]);
        let answer = json!({"boot_id": state["boot_id"], "question_id": question, "choice": choice});
        let path = format!("/cs/1/m_codes/{seq}/answer");
        self.served().post(&path, &answer).await.expect(200);
    }

    async fn redeliver(&self, how: &str) {
        let state = self.served().state(1).await;
        let path = format!("/cs/1/m_codes/{}/redeliver", state["waiting_on"]["seq"]);
        let how = json!({"boot_id": state["boot_id"], "how": how});
        self.served().post(&path, &how).await.expect(204);
    }

    /// Sends the reset of the output that was reset last once more.
    async fn repeat_the_last_reset(&self) {
        let reset = until("a reset in the journal", async || {
            let journal = self.journal().await;
            journal.into_iter().rfind(|line| line["event"] == "reset")
        });
        let reset = reset.await;
        let bus = Bus::connect(&self.served().broker, "test-1").await;
        let boot_id = &self.served().state(1).await["boot_id"];
        let again = json!({"boot_id": boot_id, "seq": reset["seq"], "handler_id": "driver", "result": "ok"});
        let path = format!("cs/1/m_code/{}", reset["m"]);
        bus.publish(&format!("{path}/reset"), &again).await;
        let said = bus.history.find(&format!("{path}/result"), |_| true).await;
        assert_eq!(said["status"], "duplicate", "H3: it was reset before");
    }

    async fn lock(&self, what: &str) {
        let (value, lost) = what
            .split_once(' ')
            .map_or((what, false), |(value, _)| (value, true));
        until_within(LEVEL_MAX, &format!("the interlock is {what}"), async || {
            let inputs = self.served().get("/cs/1/inputs").await.expect(200).json();
            let source = &inputs["interlock"]["sources"][0];
            let is = (source["value"] == (value == "on")) && (source["lost"] == lost);
            is.then_some(())
        })
        .await;
    }

    async fn lamp(&self, what: &str) {
        until(&format!("the lamp is {what}"), async || {
            let lamp = self.served().get("/io/out/lamp").await.expect(200).json();
            let is = (lamp["value"] == what.starts_with("on")) && (lamp["lost"] == what.ends_with("lost"));
            is.then_some(())
        })
        .await;
    }

    async fn force_lamp(&self, what: &str) {
        let value = match what {
            "lamp on" => json!(true),
            "lamp off" => json!(false),
            _ => Value::Null,
        };
        let force = json!({ "value": value });
        self.served().put("/io/out/lamp/force", &force).await.expect(204);
    }

    /// Ends the driver, and returns all its output.
    fn end(&mut self) -> Vec<String> {
        if let Some(process) = &mut self.running {
            process.say("end");
            self.said_before_its_end();
        }
        let mut said = std::mem::take(&mut self.said_before);
        said.retain(|line| line != "ended");
        said
    }

    /// Waits until the driver has ended.
    fn said_before_its_end(&mut self) {
        self.see("ended");
        let process = self.running.take().expect("a driver");
        self.said_before.extend(lines(&process.killed()));
    }

    async fn journal(&self) -> Vec<Value> {
        let journal = self
            .served()
            .get("/journal?count=1000&cs=1")
            .await
            .expect(200)
            .json();
        journal["lines"].as_array().expect("lines").clone()
    }

    /// Compares the journal, which is written a little later than states are published.
    async fn compare_journal(&self, behaviour: &Behaviour) {
        let mut last = Vec::new();
        let comparing = until("the journal", async || {
            last = self.journal().await.iter().filter_map(told).collect();
            (last == behaviour.journal).then_some(())
        });
        let patience = Duration::from_secs(5);
        if tokio::time::timeout(patience, within("the journal", comparing))
            .await
            .is_err()
        {
            assert_eq!(last, behaviour.journal, "{}: the journal", behaviour.name);
        }
    }
}

/// Returns the output lines of a driver.
fn lines(output: &str) -> Vec<String> {
    let said = output.lines().filter_map(|line| line.strip_prefix("> "));
    said.map(str::to_owned).collect()
}

/// Returns a line of the journal in the words of the list.
fn told(line: &Value) -> Option<String> {
    let word = |name: &str| line[name].as_str().unwrap_or_default();
    match word("event") {
        "output" if line["redelivered"] == false => Some(format!("output M{}", line["m"])),
        "reset" => Some(format!(
            "reset M{} {} by {}",
            line["m"],
            word("result"),
            word("handler_id")
        )),
        "alarm" if line["cleared_at"].is_null() && word("severity") == "alarm" => {
            Some(format!("alarm {} {}", line["number"], word("text")))
        }
        "end" => Some(
            format!("end {} {}", word("outcome"), word("reason"))
                .trim_end()
                .to_owned(),
        ),
        _ => None,
    }
}
