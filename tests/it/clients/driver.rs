//! Driver for the actions of `behaviours.toml`, by plc-api: `client_driver ADDRESS REDELIVERY RETURNS_WITHIN_MS
//! ENDS_WITHIN_MS`.
#![allow(clippy::print_stdout, reason = "the test reads it")]

use std::sync::Arc;
use std::time::Duration;

use plc_api::{Alarm, AuxOutput, Cancellation, Error, Params, Plc, Redelivery, SequenceProgram, UserAlarm};
use plc_protocol::types::command::{Command, CommandMeta};
use plc_protocol::types::io::IoValue;
use plc_protocol::types::request::typed;
use tokio::sync::Notify;

const EMPTY: UserAlarm = UserAlarm::new(23, "the tank is empty")
    .remedy("Fill the tank.")
    .in_language("de", "der Tank ist leer", "Tank füllen.");

fn say(text: &str) {
    println!("> {text}");
}

/// Prints how the work ended.
struct Work {
    cancellation: Cancellation,
    ended: bool,
}

impl Drop for Work {
    fn drop(&mut self) {
        if self.ended {
            return;
        }
        let reason = self.cancellation.reason().map(|reason| serde_json::json!(reason));
        let reason = reason.and_then(|reason| reason.as_str().map(str::to_owned));
        say(&format!("cancelled M22 {}", reason.unwrap_or_default()));
    }
}

fn pocket(params: &Params) -> Result<f64, Alarm> {
    match params.a() {
        Some(pocket) if (1.0..=24.0).contains(&pocket) => Ok(pocket),
        other => Err(Alarm::user(
            20,
            format!("VA is {other:?}: write the pocket, 1 to 24"),
        )),
    }
}

async fn change(output: AuxOutput) -> Result<(), Alarm> {
    let b = output
        .params()
        .b()
        .map_or_else(String::new, |b| format!(" VB{b}"));
    say(&format!("work M20 VA{}{b}", pocket(output.params())?));
    Ok(())
}

async fn inspect(output: AuxOutput) -> Result<(), Alarm> {
    let answer = output.ask("Shall it go on?", ["yes", "no"]).await?;
    say(&format!("answer {answer}"));
    Ok(())
}

async fn work(output: AuxOutput, _plc: Plc, go: Arc<Notify>) -> Result<(), Alarm> {
    let mut work = Work {
        cancellation: output.cancellation(),
        ended: false,
    };
    output.progress("it works", 50.0).await?;
    say(if output.redelivered() {
        "work M22 verify"
    } else {
        "work M22"
    });
    go.notified().await;
    work.ended = true;
    say("done M22");
    Ok(())
}

async fn wash(output: AuxOutput, _plc: Plc, go: Arc<Notify>) -> Result<(), Alarm> {
    let done = output.last_checkpoint::<u32>()?.unwrap_or(0);
    output.checkpoint(&(done + 3)).await?;
    output.progress(format!("noted {}", done + 3), None).await?;
    say(&format!("work M25 from {done}"));
    go.notified().await;
    say("done M25");
    Ok(())
}

async fn no_coolant(_output: AuxOutput) -> Result<(), Alarm> {
    Err(EMPTY.into())
}

async fn fails(_output: AuxOutput) -> Result<(), Alarm> {
    let parts: Vec<u8> = Vec::new();
    assert!(!parts.is_empty(), "a mistake of the handler");
    Ok(())
}

/// `NAME on|off|NUMBER` writes an output, `wait on|off` waits for the lamp.
async fn with_io(plc: &Plc, line: &str) -> String {
    let (name, value) = line.split_once(' ').unwrap_or((line, ""));
    let value = match value.parse::<f64>() {
        Ok(number) => IoValue::from(number),
        Err(_) => IoValue::from(value == "on"),
    };
    let done = if name == "wait" {
        let waited = plc.io_out("lamp").wait_until(|now| now == value).await;
        waited.map(|now| if now.is_on() { "io on" } else { "io off" })
    } else {
        plc.io_out(name).set(value).await.map(|()| "io set")
    };
    match done {
        Ok(said) => said.to_owned(),
        Err(Error::Refused(_)) => "io refused".to_owned(),
        Err(error) => error.to_string(),
    }
}

/// One line of the test.
async fn told(plc: &Plc, go: &Notify, line: &str) -> Option<String> {
    let mill = plc.coordinate_system(1);
    let (verb, rest) = line.split_once(' ').unwrap_or((line, ""));
    let command = match verb {
        "go" => {
            go.notify_one();
            return None;
        }
        "interlock" => {
            let set = mill.set_interlock_source("door", rest == "on", "the door is open");
            return Some(
                set.await
                    .map_or_else(|error| error.to_string(), |()| "interlock set".to_owned()),
            );
        }
        "io" => return Some(with_io(plc, rest).await),
        "load" => Command::Load {
            program: rest.parse().unwrap_or_default(),
        },
        "mdi" => Command::Mdi {
            text: rest.to_owned(),
            is_macro: false,
        },
        "resume" => Command::Resume,
        _ => Command::Start,
    };
    let reply = match (&command, rest) {
        (Command::Start, id) if !id.is_empty() => {
            let meta = CommandMeta {
                command_id: id.to_owned(),
                client_id: "driver".to_owned(),
                ..CommandMeta::default()
            };
            let request = typed::Command {
                cs: 1,
                command,
                meta,
                wait: true,
            };
            plc.port().ask(request).await.map(|_| ()).map_err(Error::from)
        }
        _ => mill.command(command).await,
    };
    Some(match reply {
        Ok(()) => format!("{verb} done"),
        Err(Error::Refused(refusal)) => {
            let code = serde_json::json!(refusal.code);
            format!("{verb} refused {}", code.as_str().unwrap_or_default())
        }
        Err(error) => format!("{verb} failed {error}"),
    })
}

fn program(go: &Arc<Notify>) -> SequenceProgram {
    SequenceProgram::new()
        .handler_id("driver")
        .alarms([EMPTY])
        .on(20, change)
        .validate(20, pocket)
        .on(21, inspect)
        .on(22, plc_api::handlers::with(Arc::clone(go), work))
        .on(25, plc_api::handlers::with(Arc::clone(go), wash))
        .redelivery(25, Redelivery::Redo)
        .on(23, no_coolant)
        .on(24, fails)
}

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let mut next = |what| arguments.next().ok_or(what);
    let (address, redelivery) = (next("an address")?, next("ask, redo, verify or none")?);
    let returns_within = Duration::from_millis(next("a time to return")?.parse()?);
    let ends_within = Duration::from_millis(next("a time to end")?.parse()?);
    let plc = Plc::connect(&address).await?;
    let go = Arc::new(Notify::new());
    let mut program = program(&go)
        .returns_within(returns_within)
        .ends_within(ends_within);
    if redelivery != "none" {
        program = program.on_redelivery(serde_json::from_value(redelivery.into())?);
    }
    let leave = Arc::new(Notify::new());
    let told_to_leave = Arc::clone(&leave);
    let (lines, mut heard) = tokio::sync::mpsc::channel(16);
    std::thread::spawn(move || {
        for line in std::io::stdin().lines().map_while(Result::ok) {
            if lines.blocking_send(line).is_err() {
                return;
            }
        }
    });
    let commands = plc.clone();
    let listen = async move {
        while let Some(line) = heard.recv().await.filter(|line| line != "end") {
            if line == "leave" {
                leave.notify_one();
                continue;
            }
            let (plc, go) = (commands.clone(), Arc::clone(&go));
            tokio::spawn(async move {
                if let Some(said) = told(&plc, &go, &line).await {
                    say(&said);
                }
            });
        }
    };
    tokio::select! {
        ended = program.run_until(&plc, told_to_leave.notified()) => ended?,
        () = listen => {}
    }
    say("ended");
    Ok(())
}
