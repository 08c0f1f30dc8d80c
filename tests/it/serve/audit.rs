//! Each request that changes something adds a journal line with its user and host.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use plc_api::{Alarm, AuxOutput, Plc, SequenceProgram};
use plc_protocol::types::BootId;
use plc_protocol::types::command::{Command, CommandMeta};
use plc_protocol::types::data::{ToolChange, ToolData, VariableArea, WorkOffsetTable};
use plc_protocol::types::heartbeat::ClientHeartbeat;
use plc_protocol::types::io::{IoForce, IoPoint, IoSet};
use plc_protocol::types::lease::{LeaseRelease, LeaseRequest, LeaseTake};
use plc_protocol::types::machine::AlarmRaise;
use plc_protocol::types::output::{Redeliver, Redelivery, Reset, ResetResult};
use plc_protocol::types::program::ProgramFolder;
use plc_protocol::types::question::OperatorAnswer;
use plc_protocol::types::request::{Input, OverrideChange, Request, SpindleCommand};
use plc_protocol::types::run::RunOrder;
use plc_protocol::types::state::SpindleDirection;
use plc_protocol::types::stored_data::{StoredDataAnswer, StoredDataDecision};
use plc_protocol::wire::{ROWS, mqtt, rest};
use rumqttc::{AsyncClient, MqttOptions, QoS};
use serde_json::{Value, json};
use tandem_runtime::{Config, Runtime};
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;

use crate::support::binary::tandem;
use crate::support::http::request_with;
use crate::support::machine::Machine;
use crate::support::served::{FREE_PORTS, Served};
use crate::support::simulated::run;
use crate::support::wait::until;

/// At least one request of each row that changes something.
fn samples(alarm: u64) -> Vec<Request> {
    let (boot_id, seq) = (BootId("b".into()), 7);
    let id = || {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        format!("audit-{}", COUNT.fetch_add(1, Ordering::Relaxed))
    };
    let meta = || CommandMeta {
        command_id: id(),
        client_id: "boss".into(),
        ..CommandMeta::default()
    };
    let command = |command| Request::Command {
        cs: 1,
        command,
        meta: meta(),
        wait: false,
    };
    let lease = |request| Request::Lease {
        cs: 1,
        request,
        meta: meta(),
    };
    let (holder, ttl_ms) = (None, None);
    let reset = Reset {
        boot_id: boot_id.clone(),
        seq,
        handler_id: "boss".into(),
        result: ResetResult::Ok,
        code: None,
        text: None,
        force: None,
        instance: None,
    };
    let answer = OperatorAnswer {
        boot_id: boot_id.clone(),
        seq,
        question_id: "q".into(),
        choice: "yes".into(),
        client_id: None,
    };
    let redeliver = Redeliver {
        boot_id,
        seq,
        how: Redelivery::Verify,
    };
    let mut samples = of_values();
    samples.extend(of_programs());
    samples.extend([
        Request::Reset(1, Some(100), reset),
        Request::Redeliver(1, Some(100), redeliver),
        Request::AnswerQuestion(1, Some(100), answer),
        command(Command::AlarmAcknowledge { id: alarm }),
        command(Command::Hold),
        command(Command::Run(RunOrder::program(78))),
        lease(LeaseRequest::Take(LeaseTake {
            holder,
            ttl_ms,
            fence: None,
        })),
        lease(LeaseRequest::Release(LeaseRelease { fence: 1 })),
        lease(LeaseRequest::Break),
    ]);
    samples
}

/// Requests that change programs of the store.
fn of_programs() -> Vec<Request> {
    vec![
        Request::WriteProgram(77, "M30\n".into()),
        Request::PutInFolder(
            77,
            ProgramFolder {
                folder: "parts/left".to_owned(),
            },
        ),
        Request::DeleteProgram(77),
    ]
}

/// Requests that set a value, or change stored data.
fn of_values() -> Vec<Request> {
    let tool = ToolData {
        id: 9,
        radius: 1.0,
        length: 2.0,
    };
    vec![
        Request::Input(1, Input::OptionalStop(true)),
        Request::Input(
            1,
            Input::Override(OverrideChange {
                feed: Some(90.0),
                ..OverrideChange::default()
            }),
        ),
        Request::Spindle(
            1,
            SpindleCommand {
                direction: SpindleDirection::Stop,
                rpm: 0.0,
            },
        ),
        Request::Tool(1, 3),
        Request::WriteVariables {
            area: VariableArea::Global,
            from: 5,
            values: vec![1.5],
            meta: None,
        },
        Request::SkipInput(1, true),
        Request::WriteIo(
            IoPoint::output("lamp"),
            IoSet {
                value: true.into(),
                handler_id: None,
                instance: None,
            },
        ),
        Request::ForceIo(
            IoPoint::input("door_closed"),
            IoForce {
                value: Some(true.into()),
                by: None,
            },
        ),
        Request::RaiseAlarm(AlarmRaise {
            cs: Some(1),
            code: 5,
            text: "audit".into(),
        }),
        refuses_stored_data(),
        Request::Heartbeat(
            "boss".into(),
            ClientHeartbeat {
                ttl_ms: 60_000,
                cs: None,
            },
        ),
        Request::WriteTools(ToolChange {
            tools: vec![tool],
            remove: Vec::new(),
        }),
        Request::WriteWorkOffsets(
            1,
            WorkOffsetTable {
                work_offsets: [("G54".to_owned(), [("X".to_owned(), 1.0)].into())].into(),
            },
        ),
    ]
}

fn refuses_stored_data() -> Request {
    Request::AnswerStoredData(StoredDataAnswer {
        decision: StoredDataDecision::Refuse,
    })
}

fn token(machine: &Machine, name: &str, role: &str) -> String {
    let ran = run(
        machine.folder(),
        &["token", name, "--role", role, "--file", "tokens.toml"],
    );
    let token = ran.stdout.lines().find_map(|line| line.strip_prefix("token: "));
    token.unwrap_or_else(|| panic!("{}", ran.stderr)).to_owned()
}

fn machine() -> Machine {
    let http = FREE_PORTS.replace("[http]\n", "[http]\ntoken_file = \"tokens.toml\"\n");
    Machine::new(&format!(
        "[io.in.door_closed]\n[io.out.lamp]\n[m_code.100]\nunhandled = \"wait\"\n{http}"
    ))
}

async fn lines(served: &Served, token: &str, event: &str) -> Vec<Value> {
    let headers = format!("Authorization: Bearer {token}\r\n");
    let answer = request_with(
        &served.http,
        "GET",
        "/api/v1/journal?count=1000",
        "",
        "",
        &headers,
    )
    .await;
    let all = answer.expect(200).json()["lines"].clone();
    let all = all.as_array().unwrap().clone();
    all.into_iter().filter(|line| line["event"] == event).collect()
}

/// Waits until the journal contains all these requests.
async fn all_told(served: &Served, token: &str, over: &str, requests: &[String]) {
    let mut missing = requests.to_vec();
    let what = format!("lines of requests over {over}");
    let told = until(&what, async || {
        let told = lines(served, token, "request").await;
        missing.retain(|request| {
            !told.iter().any(|line| {
                (&line["over"], &line["user"], &line["from"])
                    == (&json!(over), &json!("boss"), &json!("127.0.0.1"))
                    && line["request"] == *request
            })
        });
        if missing.is_empty() {
            return Some(());
        }
        eprintln!("not told: {missing:?}");
        None
    });
    told.await;
}

/// The name of a request in the journal.
fn name(request: &Request) -> String {
    let exchange = rest::encode(request.clone()).unwrap();
    format!("{} {}", exchange.method, exchange.path)
}

async fn ask_over_rest(served: &Served, bearer: &str, samples: &[Request]) {
    for sample in samples {
        let exchange = rest::encode(sample.clone()).unwrap();
        let mut headers = bearer.to_owned();
        for (name, value) in exchange
            .headers
            .iter()
            .filter(|(name, _)| *name != "content-type")
        {
            headers.extend([name, ": ", value, "\r\n"]);
        }
        let kind = match sample {
            Request::WriteProgram(..) => "text/plain",
            _ => "application/json",
        };
        let body = exchange.body.unwrap_or_default();
        let path = format!("/api/v1{}", exchange.path);
        let answer = request_with(&served.http, exchange.method, &path, kind, &body, &headers).await;
        assert!(
            ![400, 401, 403].contains(&answer.status),
            "{sample:?}: {answer:?}"
        );
    }
}

/// Publishes the requests that MQTT carries; returns their names.
async fn publish(served: &Served, token: &str, samples: &[Request]) -> Vec<String> {
    let (host, port) = served.broker.split_once(':').unwrap();
    let mut options = MqttOptions::new("boss", host, port.parse().unwrap());
    options.set_credentials("boss", token);
    let (client, mut events) = AsyncClient::new(options, 100);
    let connection = tokio::spawn(async move { while events.poll().await.is_ok() {} });
    let mut sent = Vec::new();
    for sample in samples {
        let Ok(outgoing) = mqtt::encode(sample.clone(), "boss", |_, _| Some(100)) else {
            continue;
        };
        let topic = format!("tandem/v1/test-1/{}", outgoing.path);
        client
            .publish(topic, QoS::AtLeastOnce, outgoing.retain, outgoing.payload)
            .await
            .unwrap();
        sent.push(name(sample));
    }
    // the client stays connected until all have arrived
    drop(connection);
    sent
}

#[tokio::test]
async fn every_row_that_changes_something_leaves_its_line_with_user_and_address() {
    let machine = machine();
    let token = token(&machine, "boss", "admin");
    let served = Served::start(&machine);
    let bearer = format!("Authorization: Bearer {token}\r\n");
    let raise = json!({"cs": 1, "code": 1, "text": "to be acknowledged"}).to_string();
    let kind = "application/json";
    request_with(&served.http, "POST", "/api/v1/alarms", kind, &raise, &bearer)
        .await
        .expect(204);
    let alarms = request_with(&served.http, "GET", "/api/v1/alarms", "", "", &bearer).await;
    let alarm = alarms.expect(200).json()["alarms"][0]["id"].as_u64().unwrap();
    let samples = samples(alarm);
    for row in ROWS.iter().filter(|row| row.right.is_recorded()) {
        let is_of_row = |sample: &&Request| (row.write)((*sample).clone()).is_ok();
        assert!(
            samples.iter().any(|sample| is_of_row(&sample)),
            "no sample of {row:?}"
        );
    }
    ask_over_rest(&served, &bearer, &samples).await;
    let all: Vec<String> = samples.iter().map(name).collect();
    all_told(&served, &token, "rest", &all).await;
    let forced = lines(&served, &token, "force").await;
    let force = (&forced[0]["io"], &forced[0]["value"], &forced[0]["user"]);
    assert_eq!(force, (&json!("io/in/door_closed"), &json!(true), &json!("boss")));
    let sent = publish(&served, &token, &samples).await;
    assert!(sent.len() >= 14, "{sent:?}");
    all_told(&served, &token, "mqtt", &sent).await;
    let mut upgrade = format!("ws://{}/api/v1/ws", served.http)
        .into_client_request()
        .unwrap();
    let protocols = format!("tandem.v1, bearer.{token}");
    upgrade
        .headers_mut()
        .insert("sec-websocket-protocol", protocols.parse().unwrap());
    let (mut socket, _) = tokio_tungstenite::connect_async(upgrade).await.unwrap();
    let beat = json!({"heartbeat": {"id": "boss", "ttl_ms": 60_000}}).to_string();
    socket.send(Message::text(beat)).await.unwrap();
    all_told(
        &served,
        &token,
        "web_socket",
        &["PUT /clients/boss/heartbeat".to_owned()],
    )
    .await;
    let _ = tokio::time::timeout(Duration::from_millis(1), socket.next()).await;
}

async fn set_a_variable(_: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    plc.variables().set(5, 2.5).await?;
    Ok(())
}

#[tokio::test]
async fn what_a_sequence_program_in_the_process_changes_is_told_in_its_name() {
    let machine = machine();
    let runtime = Runtime::start(Config::read(&machine.config()).unwrap())
        .await
        .unwrap();
    let plc = Plc::in_process(runtime.port());
    let told = async |event: &str, fits: &dyn Fn(&Value) -> bool| {
        until(&format!("a line {event}"), async || {
            let lines = plc.journal(0, 1000).await.unwrap();
            lines
                .into_iter()
                .find(|line| line["event"] == event && fits(line))
        })
        .await
    };
    for sample in samples(1) {
        let _ = plc.port().request_as("pendant", sample.clone()).await;
        match &sample {
            Request::Command { .. } => {
                told("command", &|line| line["client_id"] == "boss").await;
            }
            // about a pending output; these have separate lines
            Request::Reset(..)
            | Request::AnswerQuestion(..)
            | Request::Lease { .. }
            | Request::Heartbeat(..) => {}
            edit => {
                let wanted = name(edit);
                let line = told("request", &|line| line["request"] == *wanted).await;
                assert_eq!(
                    (&line["over"], &line["user"]),
                    (&json!("in_process"), &json!("pendant"))
                );
            }
        }
    }
    plc.coordinate_system(1).reset().await.unwrap();
    let program = SequenceProgram::new().handler_id("clamp").on(100, set_a_variable);
    let write = Request::WriteProgram(50, "M100\nM30\n".into());
    plc.port().request(write).await.unwrap();
    let of_program = plc.clone();
    let serving = tokio::spawn(async move { program.run(&of_program).await });
    until("the handler", async || {
        let handlers = plc
            .port()
            .ask(plc_protocol::types::request::typed::Handlers)
            .await
            .unwrap();
        handlers.contains_key("clamp").then_some(())
    })
    .await;
    plc.coordinate_system(1).load(50).await.unwrap();
    plc.coordinate_system(1).start().await.unwrap();
    told("request", &|line| {
        line["user"] == "clamp" && line["said"].to_string().contains("2.5")
    })
    .await;
    // the presence of a handler is not an edit
    let lines = plc.journal(0, 1000).await.unwrap();
    let of_presence = |line: &&Value| line["request"].to_string().contains("Handler");
    assert_eq!(lines.iter().find(of_presence), None);
    serving.abort();
    runtime.shutdown().await;
}

#[tokio::test]
async fn logins_and_forbidden_requests_have_lines_and_a_flood_of_them_few() {
    let machine = machine();
    let root = token(&machine, "boss", "admin");
    let viewer = token(&machine, "viewer", "view");
    let mut pin = std::process::Command::new(tandem());
    pin.args([
        "token",
        "anna",
        "--role",
        "operate",
        "--file",
        "tokens.toml",
        "--pin",
    ]);
    let mut pin = pin
        .current_dir(machine.folder())
        .stdin(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    std::io::Write::write_all(&mut pin.stdin.take().unwrap(), b"493021\n").unwrap();
    assert!(pin.wait().unwrap().success());
    let served = Served::start(&machine);
    let login = async |pin: &str| {
        let body = json!({"user": "anna", "pin": pin}).to_string();
        request_with(
            &served.http,
            "POST",
            "/api/v1/login",
            "application/json",
            &body,
            "",
        )
        .await
    };
    login("000000").await.expect(401);
    login("493021").await.expect(200);
    let bearer = format!("Authorization: Bearer {viewer}\r\n");
    for _ in 0..100 {
        let answer = request_with(&served.http, "POST", "/api/v1/cs/1/start", "", "", &bearer).await;
        answer.expect(403);
    }
    let told = until("the lines", async || {
        let told = lines(&served, &root, "access").await;
        (told.len() >= 21).then_some(told)
    });
    let told = told.await;
    let of = |what: &str| {
        told.iter()
            .filter(|line| line["what"] == what)
            .collect::<Vec<_>>()
    };
    let (refused, logged_in, forbidden) = (of("login_refused"), of("login"), of("forbidden"));
    for (line, user, request) in [
        (refused[0], "anna", "POST /login"),
        (logged_in[0], "anna", "POST /login"),
        (forbidden[0], "viewer", "POST /cs/1/start"),
    ] {
        assert_eq!(
            (&line["user"], &line["from"], &line["over"], &line["request"]),
            (&json!(user), &json!("127.0.0.1"), &json!("rest"), &json!(request))
        );
    }
    assert_eq!((refused.len(), logged_in.len(), forbidden.len()), (1, 1, 19));
}

#[tokio::test]
async fn token_and_cert_commands_are_recorded_in_the_configured_journal() {
    let machine = machine();
    let ran = run(
        machine.folder(),
        &["token", "boss", "--role", "admin", "--file", "tokens.toml"],
    );
    assert!(
        ran.stderr
            .contains("This command is in no journal: --config names"),
        "{}",
        ran.stderr
    );
    let root = ran
        .stdout
        .lines()
        .find_map(|line| line.strip_prefix("token: "))
        .unwrap()
        .to_owned();
    let config = machine.config();
    let config = config.to_str().unwrap();
    let new = |name| {
        let arguments = [
            "token",
            name,
            "--role",
            "view",
            "--file",
            "tokens.toml",
            "--config",
            config,
        ];
        run(machine.folder(), &arguments)
    };
    assert!(new("early").stderr.contains("the machine has no journal yet"));
    let served = Served::start(&machine);
    assert!(
        new("meanwhile")
            .stderr
            .contains("The journal does not record this command")
    );
    drop(served);
    assert_eq!(new("late").stderr, "");
    let cert = run(machine.folder(), &["cert", "new", "--config", config]);
    assert_eq!((cert.code, cert.stderr.as_str()), (0, ""));
    let served = Served::start(&machine);
    let told = lines(&served, &root, "request").await;
    let told: Vec<&str> = told.iter().filter_map(|line| line["request"].as_str()).collect();
    assert_eq!(
        told,
        ["tandem token late --role view", "tandem cert new: ./cert.pem"]
    );
}
