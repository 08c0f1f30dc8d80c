//! Transcripts of sequence programs, which all languages share: `tests/transcripts/README.md`.
#![cfg(feature = "mqtt")]
#![allow(
    clippy::expect_used,
    clippy::panic,
    reason = "this crate is tests and nothing else"
)]

mod broker;

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use broker::{FakeBroker, PRESENCE};
use plc_api::{Alarm, AuxOutput, Cancellation, Error, Params, Plc, SequenceProgram};
use serde_json::{Value, json};
use tokio::sync::Notify;
use tokio::task::JoinHandle;

const STEP_MAX: Duration = Duration::from_secs(5);
const SETTINGS: [&str; 6] = [
    "handlers",
    "redelivery",
    "take_over",
    "accepts",
    "returns_within_ms",
    "ends_within_ms",
];
const HANDLER_SETTINGS: [&str; 3] = ["does", "redelivery", "refuses"];
const ACTIONS: [&str; 5] = ["wait", "progress", "checkpoint", "ask", "fault"];

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_transcript_is_that_of_the_table() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/transcripts/handshake.json");
    let text = std::fs::read_to_string(path).expect("the table");
    let table: Value = serde_json::from_str(&text).expect("JSON");
    let cases = list(&table["cases"]).iter().cloned();
    let cases = cases.map(|case| {
        let table = table.clone();
        (
            name(&case["name"]).to_owned(),
            tokio::spawn(Stage::play(table, case)),
        )
    });
    let mut wrong = Vec::new();
    for (name, played) in cases.collect::<Vec<_>>() {
        if let Err(error) = played.await {
            let why = error.into_panic();
            wrong.push(format!(
                "{name}: {}",
                why.downcast_ref::<String>().map_or("", String::as_str)
            ));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

fn name(value: &Value) -> &str {
    value.as_str().expect("a text")
}

fn list(value: &Value) -> &[Value] {
    value.as_array().expect("a list")
}

fn number(value: &Value) -> u64 {
    value.as_u64().expect("a number")
}

/// A member of `settings` that may be absent.
fn given(settings: &Value, name: &str) -> Option<Value> {
    settings.get(name).cloned()
}

fn check_names(settings: &Value, known: &[&str]) {
    for name in settings.as_object().expect("settings").keys() {
        assert!(known.contains(&name.as_str()), "unknown setting {name}");
    }
}

/// Events of handlers, and handlers that wait.
#[derive(Default)]
struct Handlers {
    events: Mutex<VecDeque<Value>>,
    /// M number, and the signal that resumes the handler.
    waiting: Mutex<Vec<(u64, Arc<Notify>)>>,
}

impl Handlers {
    fn note(&self, kind: &str, m: u16, what: impl Into<Value>) {
        let event = json!([kind, m, what.into()]);
        self.events.lock().expect("events").push_back(event);
    }
}

/// Notes that a handler is cancelled, unless it has ended.
struct Work {
    handlers: Arc<Handlers>,
    m: u16,
    cancellation: Cancellation,
    has_ended: bool,
}

impl Drop for Work {
    fn drop(&mut self) {
        if !self.has_ended {
            self.handlers
                .note("cancelled", self.m, json!(self.cancellation.reason()));
        }
    }
}

/// Executes the actions of a handler.
async fn handle(output: AuxOutput, actions: Vec<Value>, handlers: Arc<Handlers>) -> Result<(), Alarm> {
    let checkpoint = output.last_checkpoint::<Value>()?;
    let begun = json!({"redelivered": output.redelivered(), "checkpoint": checkpoint});
    handlers.note("begins", output.m(), begun);
    let mut work = Work {
        handlers: Arc::clone(&handlers),
        m: output.m(),
        cancellation: output.cancellation(),
        has_ended: false,
    };
    for action in &actions {
        let args = &list(action)[1..];
        match name(&action[0]) {
            "wait" => {
                let resume = Arc::new(Notify::new());
                let waits = (u64::from(output.m()), Arc::clone(&resume));
                handlers.waiting.lock().expect("waiting").push(waits);
                resume.notified().await;
            }
            "progress" => output.progress(name(&args[0]), args[1].as_f64()).await?,
            "checkpoint" => output.checkpoint(&args[0]).await?,
            "ask" => {
                let answer = output
                    .ask(name(&args[0]), list(&args[1]).iter().map(name))
                    .await?;
                handlers.note("answered", output.m(), answer);
            }
            _ => {
                work.has_ended = true;
                return Err(alarm(args));
            }
        }
    }
    work.has_ended = true;
    Ok(())
}

fn alarm(args: &[Value]) -> Alarm {
    let code = u16::try_from(number(&args[0])).expect("a code");
    Alarm::user(code, name(&args[1]))
}

fn program(settings: &Value, handlers: &Arc<Handlers>) -> SequenceProgram {
    check_names(settings, &SETTINGS);
    let redelivery = |value| serde_json::from_value(value).expect("a redelivery");
    let ms = |value: Value| Duration::from_millis(number(&value));
    let mut program = SequenceProgram::new().handler_id("cell");
    if let Some(own) = given(settings, "redelivery") {
        program = program.on_redelivery(redelivery(own));
    }
    if settings["take_over"] == true {
        program = program.take_over();
    }
    if let Some(time) = given(settings, "returns_within_ms") {
        program = program.returns_within(ms(time));
    }
    if let Some(time) = given(settings, "ends_within_ms") {
        program = program.ends_within(ms(time));
    }
    for (m, handler) in settings["handlers"].as_object().expect("handlers") {
        check_names(handler, &HANDLER_SETTINGS);
        let m: u16 = m.parse().expect("an M number");
        let actions = list(&handler["does"]).to_vec();
        for action in &actions {
            assert!(ACTIONS.contains(&name(&action[0])), "unknown action {action}");
        }
        let shared = Arc::clone(handlers);
        program = program.on(m, move |output: AuxOutput| {
            handle(output, actions.clone(), Arc::clone(&shared))
        });
        if let Some(own) = given(handler, "redelivery") {
            program = program.redelivery(m, redelivery(own));
        }
        if let Some(refuses) = given(handler, "refuses") {
            program = program.validate(m, move |_: &Params| Err::<(), _>(alarm(list(&refuses))));
        }
    }
    program
}

/// A sequence program of a case, its broker, and the steps.
struct Stage {
    broker: Arc<FakeBroker>,
    handlers: Arc<Handlers>,
    names: HashMap<String, Value>,
    stop: Arc<Notify>,
    ended: JoinHandle<Result<(), Error>>,
}

impl Stage {
    async fn play(table: Value, case: Value) {
        let settings = &case["program"];
        let broker = FakeBroker::open(table, settings["accepts"] != false);
        let handlers = Arc::new(Handlers::default());
        let (program, address) = (program(settings, &handlers), broker.address());
        let stop = Arc::new(Notify::new());
        let leave = Arc::clone(&stop);
        let ended = tokio::spawn(async move {
            let plc = Plc::connect(&address).await?;
            program.run_until(&plc, leave.notified()).await
        });
        let mut stage = Self {
            broker,
            handlers,
            names: HashMap::new(),
            stop,
            ended,
        };
        for (at, step) in list(&case["steps"]).iter().enumerate() {
            if let Err(wrong) = stage.step(name(&step[0]), &list(step)[1..]).await {
                panic!("step {at}, {step}: {wrong}");
            }
        }
        if let Err(left) = stage.nothing() {
            panic!("after the last step: {left}");
        }
        stage.ended.abort();
        stage.broker.state().is_down = true;
        stage.broker.cut();
    }

    async fn step(&mut self, step: &str, args: &[Value]) -> Result<(), String> {
        match step {
            "receives" => {
                let members = self.filled(&args[1]);
                self.broker.publish(name(&args[0]), &members);
                Ok(())
            }
            "publishes" => self.publishes(name(&args[0]), &args[1]).await,
            "publishes_all" => self.publishes_all(list(&args[0]).to_vec()).await,
            "registers" => {
                let mut members = args[0].clone();
                members["online"] = true.into();
                self.publishes(PRESENCE, &members).await
            }
            "nothing" => {
                tokio::time::sleep(Duration::from_millis(number(&args[0]))).await;
                self.nothing()
            }
            "begins" | "answered" | "cancelled" => {
                let expected = json!([step, args[0], args[1]]);
                let next = |stage: &mut Self| stage.handlers.events.lock().expect("events").pop_front();
                let event = self.until(next).await?;
                self.fits(&expected, &event)
                    .then_some(())
                    .ok_or(event.to_string())
            }
            "continues" => {
                let m = number(&args[0]);
                let next = |stage: &mut Self| {
                    let mut waiting = stage.handlers.waiting.lock().expect("waiting");
                    // a cancelled handler has dropped its handle
                    waiting.retain(|(_, resume)| Arc::strong_count(resume) > 1);
                    let at = waiting.iter().position(|(of, _)| *of == m)?;
                    Some(waiting.remove(at).1)
                };
                self.until(next).await?.notify_one();
                Ok(())
            }
            "cuts" => {
                let will = self.broker.state().will.clone();
                self.broker.state().is_down = true;
                self.broker.cut();
                self.fits(&args[0], &will)
                    .then_some(())
                    .ok_or(format!("last will {will}"))
            }
            "restores" => {
                self.skip_presences();
                self.broker.state().is_down = false;
                Ok(())
            }
            "leaves" => {
                self.stop.notify_one();
                Ok(())
            }
            "ends" => self.ends(name(&args[0])).await,
            other => panic!("unknown step {other}"),
        }
    }

    /// Waits until the next message is this one; skips presences with other members.
    async fn publishes(&mut self, topic: &str, members: &Value) -> Result<(), String> {
        loop {
            let (said, payload) = self.until(|stage| stage.broker.state().heard.pop_front()).await?;
            if said == topic && self.fits(members, &payload) {
                return Ok(());
            }
            if said != PRESENCE {
                return Err(format!("published {said} {payload}"));
            }
        }
    }

    /// Waits until the next messages are these, in any order.
    async fn publishes_all(&mut self, mut expected: Vec<Value>) -> Result<(), String> {
        while !expected.is_empty() {
            let next = |stage: &mut Self| {
                stage.skip_presences();
                stage.broker.state().heard.pop_front()
            };
            let (said, payload) = self.until(next).await?;
            let mut is_it = |one: &Value| one[0] == said.as_str() && self.fits(&one[1], &payload);
            let Some(at) = expected.iter().position(&mut is_it) else {
                return Err(format!("published {said} {payload}"));
            };
            expected.remove(at);
        }
        Ok(())
    }

    async fn ends(&mut self, how: &str) -> Result<(), String> {
        let ended = tokio::time::timeout(STEP_MAX, &mut self.ended).await;
        let ended = ended
            .map_err(|_| "it has not ended")?
            .map_err(|error| error.to_string())?;
        match (how, ended) {
            ("left", Ok(())) | ("taken_over", Err(Error::TakenOver { .. })) => Ok(()),
            (_, other) => Err(format!("{other:?}")),
        }
    }

    /// Fails if a message other than a presence, or an event, is left.
    fn nothing(&mut self) -> Result<(), String> {
        self.skip_presences();
        let events = self.handlers.events.lock().expect("events");
        let state = self.broker.state();
        if state.heard.is_empty() && events.is_empty() {
            return Ok(());
        }
        Err(format!("{:?} {events:?}", state.heard))
    }

    fn skip_presences(&self) {
        self.broker.state().heard.retain(|(topic, _)| topic != PRESENCE);
    }

    async fn until<T>(&mut self, found: impl Fn(&mut Self) -> Option<T>) -> Result<T, String> {
        let end = Instant::now() + STEP_MAX;
        loop {
            if let Some(found) = found(self) {
                return Ok(found);
            }
            if Instant::now() > end {
                return Err(format!("not within {STEP_MAX:?}"));
            }
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
    }

    /// Returns a value with the names replaced.
    fn filled(&self, value: &Value) -> Value {
        match value {
            Value::Object(members) => {
                let members = members
                    .iter()
                    .map(|(name, member)| (name.clone(), self.filled(member)));
                Value::Object(members.collect())
            }
            Value::Array(items) => items.iter().map(|item| self.filled(item)).collect(),
            Value::String(text) if text == "$instance" => self.broker.state().instance.clone(),
            Value::String(text) if text.starts_with('$') => self.names[text].clone(),
            other => other.clone(),
        }
    }

    fn fits(&mut self, expected: &Value, value: &Value) -> bool {
        match expected {
            Value::Object(members) => members.iter().all(|(name, one)| self.fits(one, &value[name])),
            Value::Array(items) => {
                let values = value.as_array().filter(|values| values.len() == items.len());
                values
                    .is_some_and(|values| items.iter().zip(values).all(|(one, value)| self.fits(one, value)))
            }
            Value::String(text) if text == "$instance" => *value == self.broker.state().instance,
            Value::String(text) if text.starts_with('$') => {
                self.names.entry(text.clone()).or_insert_with(|| value.clone()) == value
            }
            Value::Number(number) => number.as_f64() == value.as_f64(),
            Value::Bool(false) => value.is_null() || *value == false,
            other => other == value,
        }
    }
}
