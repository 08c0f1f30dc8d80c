//! `tandem serve` with a token file from `tandem token`: every transport requires a token.

use std::os::unix::fs::PermissionsExt as _;
use std::process::{Command, Output};

use plc_api::{Alarm, AuxOutput, Execution, MqttOptions, Plc, SequenceProgram};
use serde_json::json;

use crate::support::binary::tandem;
use crate::support::http::{Answer, request_as};
use crate::support::machine::Machine;
use crate::support::served::{FREE_PORTS, Served};
use crate::support::wait::{until, within};

fn run(machine: &Machine, arguments: &[&str]) -> Output {
    let mut command = Command::new(tandem());
    command.args(arguments).current_dir(machine.folder());
    command.output().expect("tandem starts")
}

/// Creates a token in `tokens.toml` and returns it.
pub(super) fn token(machine: &Machine, name: &str, role: &str) -> String {
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

#[tokio::test]
async fn sighup_reads_the_token_file_again_and_ends_nothing() {
    let machine = machine();
    token(&machine, "one", "operate");
    let mut served = Served::start(&machine);
    let late = token(&machine, "late", "operate");
    served.process.signal("HUP");
    served
        .process
        .line("what SIGHUP does", |line| line.contains("SIGHUP"));
    until("the new token counts", async || {
        let answer = post(&served, "/cs/1/hold", Some(&late), &json!({})).await;
        (answer.status != 401).then_some(())
    })
    .await;
    served.process.signal("HUP");
    served
        .process
        .line("what SIGHUP does", |line| line.contains("SIGHUP"));
    served.process.signal("TERM");
    assert_eq!(
        served.process.exit_code_within(std::time::Duration::from_secs(5)),
        Some(0)
    );
}

pub(super) async fn post(
    served: &Served,
    path: &str,
    token: Option<&str>,
    body: &serde_json::Value,
) -> Answer {
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

#[tokio::test]
async fn rest_sequence_program_serves_as_its_user_and_reports_a_refusal() {
    let machine = machine();
    let (operate, handler) = (
        token(&machine, "hmi-1", "operate"),
        token(&machine, "magazine", "handler"),
    );
    let served = Served::start(&machine);
    let url = |user: &str| {
        served
            .http_url()
            .replace("http://0.0.0.0", &format!("http://{user}@127.0.0.1"))
    };
    let program = || SequenceProgram::new().on(100, |_: AuxOutput| async { Ok::<(), Alarm>(()) });
    let plc = connected(&url(&format!("magazine:{handler}"))).await;
    let serving = plc.clone();
    let _handlers = tokio::spawn(async move { program().run(&serving).await });
    let load = json!({"program": 50});
    post(&served, "/cs/1/load?wait=1", Some(&operate), &load)
        .await
        .expect(200);
    post(&served, "/cs/1/start", Some(&operate), &json!({}))
        .await
        .expect(202);
    let system = plc.coordinate_system(1);
    let done = system.wait_for(|state| state.execution == Execution::ProgramCompleted);
    within("its end", done).await.expect("completed");

    let other = connected(&url(&handler)).await;
    let refused = within("a refusal", program().handler_id("other").run(&other)).await;
    let refused = refused
        .expect_err("the token speaks in its own name only")
        .to_string();
    assert!(refused.contains("handler/other/presence"), "{refused}");
}

async fn connected(url: &str) -> Plc {
    within("connect", Plc::connect(url)).await.expect("let in")
}

/// Removes the entry of a name from `tokens.toml`.
fn take_out(machine: &Machine, name: &str) {
    let path = machine.path("tokens.toml");
    let text = std::fs::read_to_string(&path).expect("a token file");
    let its_name = format!("name = \"{name}\"");
    let kept: Vec<_> = text
        .split("[[token]]")
        .filter(|entry| !entry.contains(&its_name))
        .collect();
    std::fs::write(&path, kept.join("[[token]]")).expect("it is written");
}

fn user(name: &str, token: &str) -> MqttOptions {
    MqttOptions {
        username: Some(name.to_owned()),
        password: Some(token.to_owned()),
        ..MqttOptions::default()
    }
}

/// Opens a WebSocket; the returned future waits until it is closed, and returns the close text.
async fn closed_websocket(address: &str, token: &str) -> impl Future<Output = String> + use<> {
    use futures_util::StreamExt as _;
    use tokio_tungstenite::tungstenite::{Message, client::IntoClientRequest as _};
    let url = format!("ws://{address}/api/v1/ws");
    let mut request = url.into_client_request().expect("an address");
    let bearer = format!("Bearer {token}").parse().expect("a header");
    request.headers_mut().insert("authorization", bearer);
    let opened = tokio_tungstenite::connect_async(request).await;
    let (mut socket, _) = opened.expect("a WebSocket");
    async move {
        while let Some(Ok(message)) = socket.next().await {
            if let Message::Close(Some(frame)) = message {
                return frame.reason.to_string();
            }
        }
        String::new()
    }
}

#[tokio::test]
async fn removed_token_ends_its_sessions_and_a_new_one_is_valid_at_once() {
    let machine = machine();
    let admin = token(&machine, "chief", "admin");
    let lent = token(&machine, "lent", "operate");
    let handler = token(&machine, "magazine", "handler");
    let served = Served::start(&machine);
    let address = served.http.replace("0.0.0.0", "127.0.0.1");
    let get = async |path: &str, token: &str| {
        let path = format!("/api/v1{path}");
        request_as(&address, "GET", &path, "", "", Some(token)).await
    };
    let closed = closed_websocket(&address, &lent).await;
    let url = served.mqtt_url().replace("0.0.0.0", "127.0.0.1");
    let plc = within("connect", Plc::connect_with(&url, user("magazine", &handler)))
        .await
        .expect("let in");
    let reset = |_: AuxOutput| async { Ok::<(), Alarm>(()) };
    let handlers = tokio::spawn(async move { SequenceProgram::new().on(100, reset).run(&plc).await });
    let online = async || {
        let handlers = get("/handlers", &admin).await.expect(200).json();
        handlers["handlers"]["magazine"]["online"] == true
    };
    until("the handler is there", async || online().await.then_some(())).await;

    take_out(&machine, "lent");
    take_out(&machine, "magazine");
    assert_eq!(
        within("the WebSocket is closed", closed).await,
        "the token is no longer valid"
    );
    get("/programs", &lent).await.expect(401);
    until("the handler is gone", async || (!online().await).then_some(())).await;
    let again = Plc::connect_with(&url, user("magazine", &handler));
    assert!(within("connect", again).await.is_err());
    handlers.abort();

    // the remaining users are not affected, and a new user needs no restart
    let new = token(&machine, "new", "view");
    until("the new token counts", async || {
        (get("/programs", &new).await.status == 200).then_some(())
    })
    .await;
    get("/programs", &admin).await.expect(200);
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
    assert!(of_user("hmi-1").contains(&format!("topic write {root}/client/hmi-1/cs/+/command/+")));
    assert!(!of_user("hmi-1").contains("claim"));
    let written = of_user("board");
    let written: Vec<_> = written
        .lines()
        .filter(|line| line.starts_with("topic write"))
        .collect();
    assert_eq!(
        written,
        [format!("topic write {root}/client/board/cs/+/variable/get")],
        "it reads"
    );
    assert!(of_user("magazine").contains(&format!("topic write {root}/handler/magazine/presence")));
    assert!(of_user("magazine").contains(&format!(
        "topic write {root}/handler/magazine/cs/+/m_code/+/claim"
    )));
    assert!(!of_user("magazine").contains("command"));
    for name in ["hmi-1", "board", "magazine"] {
        let text = of_user(name);
        let mut written = text.lines().filter(|line| line.starts_with("topic write"));
        assert!(
            written.all(|line| line.contains(&format!("/{name}/"))),
            "in its own name only: {text}"
        );
    }
}

#[tokio::test]
async fn the_journal_names_the_user_of_each_request_that_changes_something() {
    let machine = machine();
    let operate = token(&machine, "hmi-1", "operate");
    let served = Served::start(&machine);
    let alarm = json!({"cs": 1, "code": 7, "text": "coolant"});
    post(&served, "/alarms", Some(&operate), &alarm).await.expect(204);
    let reset = "/cs/1/reset?wait=1";
    post(&served, reset, Some(&operate), &json!({})).await.expect(200);
    post(&served, reset, None, &json!({})).await.expect(401);
    let path = machine.path("tandem-data/journal/journal.jsonl");
    let lines = until("both requests stand in the journal", async || {
        let text = std::fs::read_to_string(&path).unwrap_or_default();
        let lines = text
            .lines()
            .filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
        let lines: Vec<_> = lines.filter(|line| line["event"] == "request").collect();
        (lines.len() >= 2).then_some(lines)
    })
    .await;
    let told: Vec<_> = lines
        .iter()
        .map(|line| {
            let text = |name: &str| line[name].as_str().unwrap_or_default().to_owned();
            (text("user"), text("over"), text("request"), line["cs"].as_u64())
        })
        .collect();
    let line = |request: &str, cs: u64| {
        (
            "hmi-1".to_owned(),
            "rest".to_owned(),
            request.to_owned(),
            Some(cs),
        )
    };
    assert_eq!(
        told,
        [line("POST /alarms", 1), line("POST /cs/1/reset?wait=1", 1)]
    );
    assert_eq!(lines[0]["from"], "127.0.0.1");
    let said: serde_json::Value = serde_json::from_str(lines[0]["said"].as_str().unwrap()).unwrap();
    assert_eq!(said, alarm);
}
