//! The scripts of the README, with the port of the test's own machine.

use std::process::Command;

use serde_json::{Value, json};

use crate::support::binary::root;
use crate::support::machine::Machine;
use crate::support::served::{FREE_PORTS, Process, Served};
use crate::support::wait::until;

/// The demo machine on free ports.
fn demo() -> Machine {
    let examples = root().join("examples");
    let config = std::fs::read_to_string(examples.join("config/demo.toml")).unwrap();
    let programs = format!("{}/nc/", examples.display());
    Machine::with_config(&(config.replace("../nc/", &programs) + FREE_PORTS))
}

/// Lines of the README that begin with a command, `\` at the end of a line joined, with a broker's port.
fn lines(command: &str, served: &Served) -> Vec<String> {
    let readme = std::fs::read_to_string(root().join("README.md")).unwrap();
    let (_, port) = served.broker.rsplit_once(':').unwrap();
    let lines = readme.lines().filter(|line| line.starts_with(command));
    lines
        .map(|line| line.replacen(command, &format!("{command} -p {port}"), 1))
        .collect()
}

#[tokio::test]
async fn the_mosquitto_commands_of_the_readme_do_what_it_says() {
    let machine = demo();
    let served = Served::start(&machine);
    let listen = lines("mosquitto_sub", &served).remove(0);
    // it ends by itself
    let listen = listen.trim_end_matches(" &").replacen("-v", "-v -W 60", 1);
    let mut heard = Process::start("bash".as_ref(), root(), &["-c", &format!("exec {listen}")]);
    heard.line("the state", |line| {
        line.starts_with("tandem/v1/mill-1/cs/1/state {") && line.contains("\"execution\":\"STOPPED\"")
    });
    let said = lines("mosquitto_pub", &served);
    // those with dots in the place of ids are patterns, and no script
    let said: Vec<_> = said
        .into_iter()
        .filter(|line| !line.contains("\"...\""))
        .collect();
    let effects: [(&str, &str, Value); 6] = [
        ("/commands/a1", "/status", json!("done")),
        ("/commands/a2", "/status", json!("done")),
        ("/cs/1/inputs/optional_skip", "/requested", json!([1])),
        ("/commands/a3", "/status", json!("done")),
        ("/cs/1/variables/q?from=10&count=2", "/values", json!([1.5, 2.0])),
        ("/cs/1/overrides", "/feed", json!(50.0)),
    ];
    for line in said {
        let status = Command::new("bash").args(["-c", &line]).status().unwrap();
        assert!(status.success(), "{line}");
        if let Some(id) = line.split("\"command_id\":\"").nth(1) {
            let id = id.split('"').next().unwrap();
            heard.line("the reply", |line| {
                line.starts_with("tandem/v1/mill-1/reply/panel {") && line.contains(&format!("\"{id}\""))
            });
        }
    }
    for (path, pointer, expected) in effects {
        until(path, async || {
            let answer = served.get(path).await;
            let found = answer.json().pointer(pointer) == Some(&expected);
            (answer.status == 200 && found).then_some(())
        })
        .await;
    }
}
