//! Data that outlives a kill of the runtime at any moment, and the reports at the next start.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use serde_json::{Value, json};

use crate::support::http::{Answer, request, try_request};
use crate::support::machine::Machine;
use crate::support::served::{FREE_PORTS, Served};
use crate::support::simulated::run;
use crate::support::wait::until;

/// Maximum age of changes that a kill may lose.
const BEHIND: Duration = Duration::from_millis(100);

fn machine() -> Machine {
    Machine::new(&format!("[m_code.100]\nunhandled = \"wait\"\n{FREE_PORTS}"))
}

async fn put(http: &str, path: &str, body: &Value) -> Answer {
    let path = format!("/api/v1{path}");
    request(http, "PUT", &path, "application/json", &body.to_string()).await
}

/// Kills the process and starts it again.
fn kill(served: Served, machine: &Machine) -> Served {
    drop(served);
    Served::start(machine)
}

/// Returns the tool table with one tool whose two values are `n`, and a similar work offset.
fn tool(n: u32) -> Value {
    json!({"tools": [{"id": 1, "radius": n, "length": n}]})
}

fn offset(n: u32) -> Value {
    json!({"work_offsets": {"G54": {"X": n, "Y": n, "Z": n}}})
}

/// Progress of a client before the machine was killed.
#[derive(Default)]
struct Progress {
    tool: AtomicU32,
    offset: AtomicU32,
    program: AtomicU32,
    /// The last acknowledged range.
    range: AtomicU32,
    /// The last range acknowledged before a change of the tool table was sent that was also acknowledged. The
    /// second acknowledgement proves that all earlier values are on disk.
    owed: AtomicU32,
}

/// Writes increasing numbers, one after another, until the machine stops: whole ranges, tools, offsets, programs.
async fn write_on(http: String, progress: Arc<Progress>, first: u32) {
    let put = async |path: &str, kind: &str, body: &str| {
        let path = format!("/api/v1{path}");
        let answer = try_request(&http, "PUT", &path, kind, body).await?;
        assert!((200..300).contains(&answer.status), "{answer:?}");
        Some(())
    };
    let ranges = async {
        for n in first.. {
            let values = json!({"values": vec![n; 1024]}).to_string();
            put("/variables/p?from=100", "application/json", &values).await?;
            progress.range.store(n, Ordering::SeqCst);
        }
        Some(())
    };
    let tables = async {
        for n in first.. {
            let range = progress.range.load(Ordering::SeqCst);
            put("/tools", "application/json", &tool(n).to_string()).await?;
            progress.owed.store(range, Ordering::SeqCst);
            progress.tool.store(n, Ordering::SeqCst);
            let body = offset(n).to_string();
            put("/cs/1/work_offsets", "application/json", &body).await?;
            progress.offset.store(n, Ordering::SeqCst);
            let text = format!("// {n}\n").repeat(500) + "M30\n";
            put("/programs/7", "text/plain", &text).await?;
            progress.program.store(n, Ordering::SeqCst);
        }
        Some(())
    };
    // Both processes end with the machine.
    let _ = tokio::join!(ranges, tables);
}

/// Checks the data that a killed machine has stored.
async fn check_kept(served: &Served, progress: &Progress) {
    let answered = |counter: &AtomicU32| f64::from(counter.load(Ordering::SeqCst));
    let number = |value: &Value| value.as_f64().unwrap_or(0.0);
    let range = served.get("/variables/p?from=100&count=1024").await;
    let values = range.expect(200).json()["values"].clone();
    let values: Vec<f64> = serde_json::from_value(values).unwrap();
    assert!(
        values.iter().all(|value| *value == values[0]),
        "a torn range: {values:?}"
    );
    let owed = answered(&progress.owed);
    assert!(values[0] >= owed, "P100 is {} and {owed} was owed", values[0]);

    let tools = served.get("/tools").await.expect(200).json()["tools"].clone();
    let (radius, length) = (number(&tools[0]["radius"]), number(&tools[0]["length"]));
    let owed = answered(&progress.tool);
    assert!(
        radius == length && radius >= owed,
        "{tools}, and {owed} was answered"
    );
    let owed = answered(&progress.offset);
    if owed > 0.0 {
        let table = served.get("/cs/1/work_offsets").await.expect(200).json();
        let g54 = &table["work_offsets"]["G54"];
        let whole = g54["X"] == g54["Y"] && g54["X"] == g54["Z"];
        assert!(
            whole && number(&g54["X"]) >= owed,
            "{g54}, and {owed} was answered"
        );
    }
    let owed = answered(&progress.program);
    if owed > 0.0 {
        let text = served.get("/programs/7").await.expect(200).body;
        let first = text.lines().next().unwrap_or_default();
        let whole = text.lines().filter(|line| *line == first).count() == 500 && text.ends_with("M30\n");
        assert!(whole, "a torn program: {text:.100}");
        let n: f64 = first.trim_start_matches("// ").parse().unwrap();
        assert!(n >= owed, "program {n}, and {owed} was answered");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn kill_at_any_moment_loses_no_acknowledged_change_and_tears_none() {
    let rounds = if std::env::var_os("TANDEM_LONG").is_some() {
        300
    } else {
        12
    };
    let machine = machine();
    let mut served = Served::start(&machine);
    for round in 0..rounds {
        let progress = Arc::new(Progress::default());
        let writing = tokio::spawn(write_on(
            served.http.clone(),
            Arc::clone(&progress),
            1 + round * 100_000,
        ));
        // from 0 to half a second, each time at another moment of the 50 ms between two checks
        tokio::time::sleep(Duration::from_millis(u64::from(round * 137 % 500))).await;
        served = kill(served, &machine);
        writing.await.unwrap();
        check_kept(&served, &progress).await;
        let state = served.state(1).await;
        assert_eq!(
            (&state["execution"], &state["reason"]),
            (&json!("STOPPED"), &json!("RESTARTED"))
        );
    }
}

#[tokio::test]
async fn values_survive_a_kill_and_changed_configuration_overrides_them() {
    let machine = machine();
    let served = Served::start(&machine);
    let http = served.http.clone();
    put(&http, "/cs/1/tool", &json!({"id": 7})).await.expect(204);
    put(&http, "/variables/p?from=32766", &json!({"values": ["NaN", 0.1]}))
        .await
        .expect(204);
    put(&http, "/cs/2/variables/q?from=4095", &json!({"values": ["-inf"]}))
        .await
        .expect(204);
    let measured = json!({"work_offsets": {"G54": {"X": 10.5, "Y": 20.5}}});
    put(&http, "/cs/1/work_offsets", &measured).await.expect(204);
    tokio::time::sleep(3 * BEHIND).await;
    drop(served);
    // Y of G54 is edited, X is not
    let config = std::fs::read_to_string(machine.config()).unwrap();
    let edited = config.replace("Y = 20.0", "Y = 25.0");
    assert_ne!(config, edited);
    machine.write("tandem.toml", &edited);
    let served = Served::start(&machine);
    assert_eq!(served.get("/cs/1/tool").await.expect(200).json()["id"], 7);
    let p = served
        .get("/variables/p?from=32765&count=3")
        .await
        .expect(200)
        .json();
    assert_eq!(p["values"], json!([0.0, "NaN", 0.1]));
    let q = served.get("/cs/2/variables/q?from=4095").await.expect(200).json();
    assert_eq!(q["values"], json!(["-inf"]));
    let g54 = served.get("/cs/1/work_offsets").await.expect(200).json()["work_offsets"]["G54"].clone();
    assert_eq!(g54, json!({"X": 10.5, "Y": 25.0, "Z": 30.0}));
}

/// Runs a program until it waits at a claimed M100, and kills the machine.
async fn killed_at_m100(machine: &Machine) -> Served {
    let served = Served::start(machine);
    served.load(1, 50, "G00 X5\nM100 VA3\nG00 X9\nM30\n").await;
    served.command(1, "start").await;
    let state = served.execution(1, "WAIT").await;
    let seq = state["waiting_on"]["seq"].clone();
    let presence = json!({"online": true, "instance": "a", "expires_ms": 60_000});
    served.put("/handlers/arm", &presence).await.expect(204);
    let claim = json!({"boot_id": state["boot_id"], "handler_id": "arm", "instance": "a"});
    let path = format!("/cs/1/m_codes/{seq}/claim");
    served.post(&path, &claim).await.expect(200);
    tokio::time::sleep(3 * BEHIND).await;
    kill(served, machine)
}

async fn alarms(served: &Served) -> Value {
    served.get("/alarms").await.expect(200).json()["alarms"].clone()
}

/// Returns the lines of the journal, all complete.
fn journal(machine: &Machine) -> Vec<Value> {
    let text = std::fs::read_to_string(machine.path("tandem-data/journal/journal.jsonl")).unwrap();
    // the last line may not be on disk yet
    let whole = text.rfind('\n').map_or("", |end| &text[..end]);
    whole
        .lines()
        .map(|line| serde_json::from_str(line).expect("a whole line"))
        .collect()
}

#[tokio::test]
async fn output_and_run_ids_are_unique_over_restarts_of_one_folder() {
    let machine = machine();
    let mut served = Served::start(&machine);
    let mut names = Vec::new();
    served.put_program(50, "M100 VA3\nM30\n").await.expect(201);
    for _ in 0..2 {
        let load = served.post("/cs/1/load?wait=1", &json!({"program": 50})).await;
        load.expect(200);
        served.command(1, "start").await;
        let state = served.execution(1, "WAIT").await;
        let pending = served.get("/cs/1/m_codes").await.expect(200).json();
        let output = pending["outputs"][0].clone();
        assert_eq!((&output["seq"], &output["run_id"]), (&json!(1), &state["run_id"]));
        names.push([output["id"].clone(), output["run_id"].clone()]);
        served = kill(served, &machine);
    }
    assert!(
        names
            .iter()
            .flatten()
            .all(|name| name.as_str().is_some_and(|name| !name.is_empty()))
    );
    assert_ne!(names[0][0], names[1][0]);
    assert_ne!(names[0][1], names[1][1]);
    let lines = journal(&machine);
    let told = lines.iter().filter(|line| line["event"] == "output");
    let told: Vec<Value> = told.map(|line| line["id"].clone()).collect();
    assert_eq!(told, [names[0][0].clone(), names[1][0].clone()]);
}

#[tokio::test]
async fn after_a_kill_nothing_starts_and_pending_outputs_are_reported() {
    let machine = machine();
    let served = killed_at_m100(&machine).await;
    let state = served.state(1).await;
    assert_eq!(
        (&state["execution"], &state["reason"]),
        (&json!("STOPPED"), &json!("RESTARTED"))
    );
    let last_run = served.get("/cs/1/last_run").await.expect(200).json()["last_run"].clone();
    assert_eq!(
        (&last_run["execution"], &last_run["program"], &last_run["line"]),
        (&json!("WAIT"), &json!(50), &json!(2))
    );
    let open = &last_run["outputs"][0];
    assert_eq!((&open["m"], &open["handler_id"]), (&json!(100), &json!("arm")));
    let other = served.get("/cs/2/last_run").await.expect(200).json();
    assert_eq!(other, json!({"last_run": null}));

    let alarms = alarms(&served).await;
    let warning = &alarms[0];
    assert_eq!(
        (&warning["severity"], &warning["cs"]),
        (&json!("warning"), &json!(1))
    );
    let text = warning["text"].as_str().unwrap();
    assert!(text.contains("M100 VA3") && text.contains("arm"), "{text}");
    let told = [
        "boot",
        "command",
        "command",
        "start",
        "output",
        "claim",
        "boot",
        "interrupted",
    ];
    // the file lags by a moment
    let events = until("the journal tells of the restart", async || {
        let events: Vec<Value> = (journal(&machine).iter())
            .filter(|line| line["cs"] == 1 && line["event"] != "request")
            .map(|line| line["event"].clone())
            .collect();
        (events.len() >= told.len()).then_some(events)
    });
    assert_eq!(events.await, told);
}

#[tokio::test]
async fn killed_as_soon_as_the_journal_has_an_output_it_tells_that_it_was_open() {
    let machine = machine();
    let mut served = Served::start(&machine);
    served.load(1, 50, "M100 VA3\nM30\n").await;
    // enough rounds to hit each moment between two writes
    for round in 0..8 {
        let made = |line: &Value| line["event"] == "output";
        let before = journal(&machine).iter().filter(|line| made(line)).count();
        served.command(1, "start").await;
        while journal(&machine).iter().filter(|line| made(line)).count() == before {
            tokio::task::yield_now().await;
        }
        served = kill(served, &machine);
        let last_run = served.get("/cs/1/last_run").await.expect(200).json()["last_run"].clone();
        assert_eq!(last_run["execution"], "WAIT", "round {round}: {last_run}");
        assert_eq!(last_run["outputs"][0]["m"], 100, "round {round}: {last_run}");
        let warning = alarms(&served).await[0]["text"].clone();
        assert!(warning.as_str().unwrap().contains("M100 VA3"), "{warning}");
        // reported again at a start, although the journal no longer contains it
        served = kill(served, &machine);
        let again = served.get("/cs/1/last_run").await.expect(200).json()["last_run"].clone();
        assert_eq!(again, last_run);
        served.command(1, "reset").await;
        let load = served.post("/cs/1/load?wait=1", &json!({"program": 50})).await;
        load.expect(200);
    }
}

#[tokio::test]
async fn interrupted_run_blocks_nothing_and_is_reported_until_a_reset() {
    let machine = machine();
    let served = kill(killed_at_m100(&machine).await, &machine);
    assert_eq!(
        alarms(&served).await[0]["severity"],
        "warning",
        "nobody has looked yet"
    );
    let load = served.post("/cs/1/load?wait=1", &json!({"program": 50})).await;
    load.expect(200);
    served.command(1, "reset").await;
    assert_eq!(alarms(&served).await, json!([]));
    tokio::time::sleep(3 * BEHIND).await;
    let served = kill(served, &machine);
    assert_eq!(alarms(&served).await, json!([]));
    let state = served.state(1).await;
    assert_eq!(state["reason"], "RESTARTED");
}

#[test]
fn a_second_runtime_with_the_same_folder_is_refused() {
    let machine = machine();
    let _served = Served::start(&machine);
    let second = run(machine.folder(), &["serve", "--config", "tandem.toml"]);
    assert_eq!(second.code, 2);
    assert!(second.stderr.contains("another runtime"), "{}", second.stderr);
}

#[test]
fn a_simulation_neither_reads_nor_writes_the_data_folder() {
    let machine = machine();
    machine.write("main.nc", "P5=7\nM30\n");
    let ran = run(
        machine.folder(),
        &["simulate", "main.nc", "--config", "tandem.toml"],
    );
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    assert!(!machine.path("tandem-data").exists());
}

#[tokio::test]
async fn parts_that_were_published_are_counted_after_each_kill() {
    let machine = machine();
    let mut served = Served::start(&machine);
    served.put_program(60, "G04 P0.02\nM30\n").await.expect(201);
    for round in 0..5 {
        let order = json!({"program": 60, "parts": 10_000});
        let ordered = served.post("/cs/1/runs", &order).await.expect(201).json();
        let id = ordered["run_id"].as_str().unwrap().to_owned();
        let published = async |served: &Served| {
            let run = served.get("/cs/1/run").await.expect(200).json();
            run["run"]["parts_done"].as_u64().unwrap_or(0)
        };
        until("some parts", async || {
            (published(&served).await >= 10 + round).then_some(())
        })
        .await;
        let parts = published(&served).await;
        let before = served.get("/runs").await.expect(200).json();
        served = kill(served, &machine);
        let run = served.get(&format!("/runs/{id}")).await.expect(200).json();
        assert!(
            run["parts_done"].as_u64().unwrap() >= parts,
            "{parts} were published: {run}"
        );
        let after = served.get("/runs").await.expect(200).json();
        let made = |runs: &Value| runs["production"][0]["parts"].as_u64().unwrap_or(0);
        assert!(made(&after) >= made(&before), "{before} {after}");
        assert_eq!(after["production"][0]["cut_short"], round + 1);
        let warning = alarms(&served).await[0]["text"].clone();
        assert!(warning.as_str().unwrap().contains(&id), "{id}: {warning}");
    }
}
