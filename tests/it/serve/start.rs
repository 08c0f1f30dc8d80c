//! Starting and ending.

use std::net::TcpListener;
use std::path::Path;
use std::time::Duration;

use plc_api::{Alarm, AuxOutput, Execution, Plc, SequenceProgram};
use serde_json::{Value, json};

use super::{M_CODES, machine, served};
use crate::support::binary::tandem;
use crate::support::machine::{COORDINATE_SYSTEMS, MOTORS, Machine};
use crate::support::served::{FREE_PORTS, Process, Served};
use crate::support::wait::until;

/// Starts with a configuration that must be refused; returns the output.
fn refused(config: &str) -> String {
    let machine = Machine::with_config(config);
    let path = machine.config();
    let arguments = ["serve", "--config", path.to_str().unwrap()];
    let mut process = Process::start(tandem(), Path::new(machine.folder()), &arguments);
    let code = process.exit_code_within(Duration::from_secs(20));
    assert_eq!(code, Some(2), "{}", process.output);
    process.output.clone()
}

fn with_ports(http: &str, mqtt: &str) -> String {
    format!("{MOTORS}{COORDINATE_SYSTEMS}[http]\nlisten = \"{http}\"\n[mqtt]\nlisten = \"{mqtt}\"\n")
}

#[test]
fn a_taken_http_port_is_an_error_that_names_the_address_and_the_setting() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let output = refused(&with_ports(&address, "127.0.0.1:0"));
    assert!(
        output.contains(&address) && output.contains("[http] listen"),
        "{output}"
    );
}

#[test]
fn a_taken_mqtt_port_is_an_error_that_names_the_address_and_the_setting() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let output = refused(&with_ports("127.0.0.1:0", &address));
    assert!(
        output.contains(&address) && output.contains("[mqtt] listen"),
        "{output}"
    );
}

#[test]
fn unknown_config_key_reported_with_nearest_known_and_nothing_starts() {
    let output = refused(&format!(
        "[machine]\nservo_periode_us = 1000\n{MOTORS}{COORDINATE_SYSTEMS}"
    ));
    for word in ["servo_periode_us", "servo_period_us", "tandem.toml", "line 2"] {
        assert!(output.contains(word), "{word} is missing in {output}");
    }
    assert!(!output.contains("http://"), "{output}");
}

#[test]
fn only_loopback_is_listened_on_without_a_token_file() {
    let output = refused(&with_ports("0.0.0.0:0", "127.0.0.1:0"));
    assert!(output.contains("[http]"), "{output}");
}

#[test]
fn command_line_overrides_configured_addresses_folder_and_handlers() {
    let taken = [(); 2].map(|()| TcpListener::bind("127.0.0.1:0").unwrap());
    let [http, mqtt] = taken
        .each_ref()
        .map(|listener| listener.local_addr().unwrap().to_string());
    let machine = Machine::with_config(&with_ports(&http, &mqtt));
    let free = "127.0.0.1:0";
    let arguments = [
        "--config",
        "tandem.toml",
        "--listen",
        free,
        "--mqtt-listen",
        free,
        "--data-dir",
        "kept/here",
        "--demo",
    ];
    let mut process = Process::start(tandem(), machine.folder(), &arguments);
    process.line("the demo", |line| line.contains("Try it"));
    assert!(
        !process.output.contains(&http) && !process.output.contains(&mqtt),
        "{}",
        process.output
    );
    process.signal("TERM");
    assert_eq!(
        process.exit_code_within(Duration::from_secs(20)),
        Some(0),
        "{}",
        process.output
    );
    assert!(machine.path("kept/here").is_dir());
}

/// Starts the demo in a separate folder, while 8080 and 1883 are in use.
fn demo(folder: &Path) -> Served {
    Served::of(Process::start(tandem(), folder, &[]))
}

#[tokio::test]
async fn demo_takes_free_ports_if_its_own_are_taken_and_loads_a_program() {
    // the ports are in use, by this test or by another program
    let taken =
        ["127.0.0.1:8080", "127.0.0.1:1883"].map(|address| (address, TcpListener::bind(address).ok()));
    let folder = tempfile::tempdir().unwrap();
    let mut served = demo(folder.path());
    for (address, _) in &taken {
        assert!(
            ![&served.http, &served.broker].contains(&&(*address).to_owned()),
            "{address}"
        );
        served.process.line("which port is taken", |line| {
            line.contains(address) && line.contains("free port")
        });
    }
    let opened = served
        .state_where(1, "a program", |state| state["program"] == 4)
        .await;
    assert_eq!(opened["execution"], "READY");
    served.process.signal("TERM");
    assert_eq!(served.process.exit_code_within(Duration::from_secs(20)), Some(0));

    let served = demo(folder.path());
    served
        .state_where(1, "the program again", |state| state["program"] == 4)
        .await;
    served.post("/cs/1/start", &Value::Null).await.expect(202);
    served.execution(1, "WAIT").await;
    served.process.killed();
    let served = demo(folder.path());
    until("the demo's handlers", async || {
        let handlers = served.get("/handlers").await.expect(200).body;
        handlers.contains("\"demo\"").then_some(())
    })
    .await;
    let restarted = served.state(1).await;
    assert_eq!(restarted["reason"], "RESTARTED");
    assert_eq!(
        restarted["program"],
        Value::Null,
        "a run that was cut short stays what is shown"
    );
}

#[test]
fn a_port_of_the_demo_that_somebody_has_chosen_must_be_free() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let folder = tempfile::tempdir().unwrap();
    let mut process = Process::start(tandem(), folder.path(), &["--listen", &address]);
    assert_eq!(process.exit_code_within(Duration::from_secs(20)), Some(2));
    assert!(
        process.output.contains("the port is in use"),
        "{}",
        process.output
    );
}

#[tokio::test]
async fn the_printed_addresses_answer() {
    let (_machine, served) = served();
    let machine = served.get("/machine").await.expect(200).json();
    assert_eq!(machine["machine"], "test-1");
    served.get("/health").await.expect(200);
    std::net::TcpStream::connect(&served.broker).expect("the broker answers");
    let page = crate::support::http::request(&served.http, "GET", "/", "", "")
        .await
        .expect(200);
    assert!(page.body.contains("<html"), "the HMI is served");
}

#[test]
fn sigterm_ends_it_with_exit_0_within_seconds() {
    let (_machine, mut served) = served();
    served.process.signal("TERM");
    assert_eq!(
        served.process.exit_code_within(Duration::from_secs(5)),
        Some(0),
        "{}",
        served.process.output
    );
}

#[test]
fn ctrl_c_ends_it_with_exit_0_within_seconds() {
    let (_machine, mut served) = served();
    served.process.signal("INT");
    assert_eq!(
        served.process.exit_code_within(Duration::from_secs(5)),
        Some(0),
        "{}",
        served.process.output
    );
}

#[tokio::test]
async fn sigterm_in_the_middle_of_a_motion_ends_it_in_order() {
    let (_machine, mut served) = served();
    served.load(1, 50, "G01 X200 F600\nM30\n").await;
    served.command(1, "start").await;
    served.execution(1, "ACTIVE").await;
    served.process.signal("TERM");
    assert_eq!(
        served.process.exit_code_within(Duration::from_secs(10)),
        Some(0),
        "{}",
        served.process.output
    );
}

#[tokio::test]
async fn first_start_is_no_program_later_ones_restarted_and_nothing_runs() {
    let machine = machine();
    let mut served = Served::start(&machine);
    let state = served.state(1).await;
    assert_eq!(
        (&state["execution"], &state["reason"]),
        (&json!("STOPPED"), &json!("NO_PROGRAM"))
    );
    let boot_id = state["boot_id"].clone();
    served.load(1, 50, "G01 X200 F600\nM100\nM30\n").await;
    served.command(1, "start").await;
    served.execution(1, "ACTIVE").await;
    served.process.signal("KILL");
    served.process.exit_code_within(Duration::from_secs(5));

    let served = Served::start(&machine);
    for cs in [1, 2] {
        let state = served.state(cs).await;
        assert_eq!(
            (&state["execution"], &state["reason"]),
            (&json!("STOPPED"), &json!("RESTARTED"))
        );
        assert_ne!(state["boot_id"], boot_id);
        assert_eq!(state["waiting_on"], json!(null));
    }
    let programs = served.get("/programs").await.expect(200).json();
    assert!(
        programs.to_string().contains("50"),
        "the program is kept: {programs}"
    );
}

#[test]
fn the_configuration_of_these_tests_is_good() {
    let machine = Machine::new(&format!("{M_CODES}{FREE_PORTS}"));
    let ran = crate::support::simulated::run(machine.folder(), &["check", "--config", "tandem.toml"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
}

#[tokio::test]
async fn the_servo_threads_punctuality_is_on_metrics_while_it_runs() {
    let (_machine, served) = served();
    let of = |text: &str, name: &str| -> f64 {
        let line = text.lines().find(|line| line.starts_with(&format!("{name} ")));
        let line = line.unwrap_or_else(|| panic!("no {name} in {text}"));
        line.rsplit(' ').next().unwrap().parse().unwrap()
    };
    let lateness = "tandem_servo_wakeup_lateness_seconds";
    let count = format!("{lateness}_count");
    let metrics = async || served.get("/metrics").await.expect(200).body;
    let mut text = metrics().await;
    let begun = of(&text, &count);
    while of(&text, &count) < begun + 50.0 {
        tokio::time::sleep(Duration::from_millis(20)).await;
        text = metrics().await;
    }
    let cycles = of(&text, &count);
    assert_eq!(of(&text, &format!("{lateness}_bucket{{le=\"+Inf\"}}")), cycles);
    assert_eq!(of(&text, "tandem_servo_period_seconds"), 0.001);
    assert!(of(&text, &format!("{lateness}_sum")) > 0.0);
    assert!(of(&text, "tandem_servo_cycle_max_seconds") > 0.0);
    assert!(of(&text, "tandem_servo_overruns_total") <= cycles);
}

async fn waits_for_ever(_output: AuxOutput) -> Result<(), Alarm> {
    std::future::pending().await
}

#[tokio::test]
async fn metrics_show_states_pending_m_codes_and_handlers() {
    let (_machine, served) = served();
    served.put_program(77, "M77\nM30\n").await.expect(201);
    let plc = Plc::connect(&served.mqtt_url()).await.unwrap();
    let idle = plc.clone();
    let serving = SequenceProgram::new().handler_id("idle").on(77, waits_for_ever);
    tokio::spawn(async move { serving.run(&idle).await });
    until("the handler is known", async || {
        let handlers = served.get("/handlers").await.expect(200).json();
        (handlers["handlers"]["idle"]["online"] == true).then_some(())
    })
    .await;
    let cs = plc.coordinate_system(1);
    cs.load(77).await.unwrap();
    cs.start().await.unwrap();
    cs.wait_until(Execution::Wait).await.unwrap();
    let text = served.get("/metrics").await.expect(200).body;
    for line in [
        "tandem_execution{cs=\"1\",execution=\"WAIT\"} 1",
        "tandem_m_code_open_seconds{cs=\"1\",m=\"77\",state=\"CLAIMED\"} ",
        "tandem_run_parts{cs=\"1\",program=\"77\"} 1",
        "tandem_handler_online{handler=\"idle\"} 1",
        "process_resident_memory_bytes ",
    ] {
        assert!(
            text.lines().any(|said| said.starts_with(line)),
            "no {line} in {text}"
        );
    }
}

#[tokio::test]
async fn a_skip_input_is_taken_for_a_motor_of_an_axis_and_refused_for_another() {
    let (_machine, served) = served();
    let put = async |motor: u16| {
        let path = format!("/motors/{motor}/skip_input");
        served.put(&path, &json!({"value": true})).await
    };
    assert_eq!(put(3).await.status, 204);
    let refused = put(77).await;
    assert_eq!(refused.status, 404);
    assert!(refused.json()["detail"].to_string().contains("motor 77"));
}
