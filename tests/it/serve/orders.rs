//! Orders of runs that are repeated after a kill: the key identifies the run that the order started.

use serde_json::{Value, json};

use crate::support::http::{Answer, request_with};
use crate::support::machine::Machine;
use crate::support::served::{FREE_PORTS, Served};

async fn order(served: &Served, key: &str, parts: u32) -> Answer {
    let body = json!({"program": 60, "parts": parts}).to_string();
    let headers = format!("Idempotency-Key: {key}\r\n");
    let path = "/api/v1/cs/1/runs";
    request_with(&served.http, "POST", path, "application/json", &body, &headers).await
}

async fn runs(served: &Served) -> Vec<Value> {
    let runs = served.get("/runs").await.expect(200).json();
    runs["runs"].as_array().cloned().unwrap_or_default()
}

#[tokio::test]
async fn order_repeated_after_a_kill_returns_its_run_and_starts_none() {
    let machine = Machine::new(FREE_PORTS);
    let served = Served::start(&machine);
    served.load(1, 60, "G04 X0.2\nM30\n").await;
    let first = order(&served, "job-1", 1).await.expect(201).json();
    served.execution(1, "PROGRAM_COMPLETED").await;
    // killed at once: the journal's lines of starts are written ahead, and the store may lag
    let second = order(&served, "job-2", 3).await.expect(201).json();
    drop(served);

    let served = Served::start(&machine);
    for (key, parts, run) in [("job-1", 1, &first), ("job-2", 3, &second)] {
        let again = order(&served, key, parts).await.expect(201).json();
        assert_eq!(again["run_id"], run["run_id"], "{key}");
    }
    let other = order(&served, "job-1", 2).await.expect(422).json();
    assert_eq!(other["code"], "command_id_reused");
    assert_eq!(served.state(1).await["execution"], "STOPPED", "nothing has begun");
    let known = runs(&served).await;
    let ids: Vec<_> = known.iter().map(|run| &run["id"]).collect();
    assert_eq!(ids, [&second["run_id"], &first["run_id"]], "the newest first");
    let new = order(&served, "job-3", 1).await.expect(201).json();
    served.execution(1, "PROGRAM_COMPLETED").await;
    assert_eq!(runs(&served).await[0]["id"], new["run_id"]);
}
