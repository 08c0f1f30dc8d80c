//! `tandem serve` with a token file: made by `tandem token`, asked for on every way in.

use std::os::unix::fs::PermissionsExt as _;
use std::process::{Command, Output};

use plc_api::{Alarm, AuxOutput, Execution, MqttOptions, Plc, SequenceProgram};
use serde_json::json;

use crate::support::binary::tandem;
use crate::support::http::{Answer, request_as};
use crate::support::machine::Machine;
use crate::support::served::{FREE_PORTS, Served};
use crate::support::wait::within;

fn run(machine: &Machine, arguments: &[&str]) -> Output {
    let mut command = Command::new(tandem());
    command.args(arguments).current_dir(machine.folder());
    command.output().expect("tandem starts")
}

/// Makes a token in `tokens.toml` and gives it.
fn token(machine: &Machine, name: &str, role: &str) -> String {
    let output = run(machine, &["token", name, "--role", role, "--file", "tokens.toml"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{text}");
    let token = text.lines().find_map(|line| line.strip_prefix("token: "));
    token.expect("a token").to_owned()
}

fn machine() -> Machine {
    let ports = FREE_PORTS.replace("127.0.0.1", "0.0.0.0");
    let http = ports.replace("[http]\n", "[http]\ntoken_file = \"tokens.toml\"\n");
    let machine = Machine::new(&format!(
        "programs = {{ 50 = \"tool.nc\" }}\n[m_code.100]\nunhandled = \"wait\"\n{http}"
    ));
    machine.write("tool.nc", "M100 VA7\nM30\n");
    machine
}

async fn post(served: &Served, path: &str, token: Option<&str>, body: &serde_json::Value) -> Answer {
    let path = format!("/api/v1{path}");
    let address = served.http.replace("0.0.0.0", "127.0.0.1");
    request_as(
        &address,
        "POST",
        &path,
        "application/json",
        &body.to_string(),
        token,
    )
    .await
}

#[tokio::test]
async fn users_start_handlers_reset_viewers_look_and_no_token_stands_in_a_log() {
    let machine = machine();
    let operate = token(&machine, "hmi-1", "operate");
    let view = token(&machine, "board", "view");
    let handler = token(&machine, "magazine", "handler");
    let mut served = Served::start(&machine);
    let load = json!({"program": 50});
    post(&served, "/cs/1/load?wait=1", None, &load).await.expect(401);
    post(&served, "/cs/1/load?wait=1", Some(&view), &load)
        .await
        .expect(403);
    post(&served, "/cs/1/load?wait=1", Some(&operate), &load)
        .await
        .expect(200);

    let options = MqttOptions {
        username: Some("magazine".into()),
        password: Some(handler.clone()),
        ..MqttOptions::default()
    };
    let url = served.mqtt_url().replace("0.0.0.0", "127.0.0.1");
    let plc = within("connect", Plc::connect_with(&url, options))
        .await
        .expect("let in");
    let serving = plc.clone();
    let reset = |_: AuxOutput| async { Ok::<(), Alarm>(()) };
    let _handlers = tokio::spawn(async move { SequenceProgram::new().on(100, reset).run(&serving).await });
    post(&served, "/cs/1/start", Some(&handler), &json!({}))
        .await
        .expect(403);
    post(&served, "/cs/1/start", Some(&operate), &json!({}))
        .await
        .expect(202);
    let system = plc.coordinate_system(1);
    let done = system.wait_for(|state| state.execution == Execution::ProgramCompleted);
    within("its end", done).await.expect("completed");

    let guessed = "f".repeat(64);
    post(&served, "/cs/1/start", Some(&guessed), &json!({}))
        .await
        .expect(401);
    let wrong = MqttOptions {
        username: Some("magazine".into()),
        password: Some(guessed.clone()),
        ..MqttOptions::default()
    };
    assert!(within("connect", Plc::connect_with(&url, wrong)).await.is_err());
    served.process.signal("TERM");
    assert_eq!(
        served
            .process
            .exit_code_within(std::time::Duration::from_secs(10)),
        Some(0)
    );
    for secret in [operate, view, handler, guessed] {
        assert!(
            !served.process.output.contains(&secret),
            "{}",
            served.process.output
        );
    }
}

#[test]
fn a_token_file_is_made_for_its_owner_only_and_each_name_is_there_once() {
    let machine = machine();
    let token = token(&machine, "hmi-1", "operate");
    let path = machine.path("tokens.toml");
    let mode = std::fs::metadata(&path).unwrap().permissions().mode() & 0o777;
    assert_eq!(mode, 0o600);
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(text.contains("name = \"hmi-1\"\nrole = \"operate\"\nsha256 = ") && !text.contains(&token));
    let again = run(
        &machine,
        &["token", "hmi-1", "--role", "view", "--file", "tokens.toml"],
    );
    assert_eq!(again.status.code(), Some(1));
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o644)).unwrap();
    let serve = run(&machine, &["serve", "--config", "tandem.toml"]);
    assert_eq!(serve.status.code(), Some(2));
    let error = String::from_utf8_lossy(&serve.stderr).into_owned();
    assert!(error.contains("chmod 600"), "{error}");
}

#[test]
fn the_rules_for_mosquitto_name_every_user_with_its_topics() {
    let machine = machine();
    for (name, role) in [("hmi-1", "operate"), ("board", "view"), ("magazine", "handler")] {
        token(&machine, name, role);
    }
    let output = run(&machine, &["mqtt-acl", "--config", "tandem.toml"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let of_user = |name: &str| {
        let from = text.find(&format!("user {name}\n")).expect("the user");
        let rest = &text[from..];
        rest[..rest.find("\n\n").unwrap_or(rest.len())].to_owned()
    };
    let root = "tandem/v1/test-1";
    assert!(of_user("hmi-1").contains(&format!("topic write {root}/cs/+/command/+")));
    assert!(!of_user("hmi-1").contains("claim"));
    assert!(!of_user("board").contains("topic write"));
    assert!(of_user("magazine").contains(&format!("topic write {root}/handler/magazine/presence")));
    assert!(!of_user("magazine").contains("command"));
}
