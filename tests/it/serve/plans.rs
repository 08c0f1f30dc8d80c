//! The plan that a machine in real time reports for a run belongs to this run, even if inputs changed shortly
//! before its start.

use std::time::Duration;

use serde_json::{Value, json};

use crate::support::machine::Machine;
use crate::support::served::{FREE_PORTS, Served};
use crate::support::wait::{until, until_within};

const PROGRAM: u16 = 50;

/// Subprogram called by [`PROGRAM`].
const CALLED: u16 = 1060;

/// Longest time until a plan is complete. Reason: other tests share the processors.
const PLANNED_WITHIN: Duration = Duration::from_mins(2);

/// Inputs that change after planning, and the highest machine position of an axis, mm, that a run then commands.
const CHANGES: [(&str, &str, f64); 13] = [
    ("nothing", "X", 5.0),
    ("P variable", "X", 7.0),
    ("Q variable", "Y", 8.0),
    ("variable that is not read", "X", 5.0),
    ("offset", "X", 8.0),
    ("length of the tool", "Z", 22.0),
    ("tool", "Z", 32.0),
    ("skip", "X", 6.5),
    ("optional stop", "X", 5.0),
    ("dry run", "X", 5.0),
    ("text", "X", 9.0),
    ("text of the called program", "X", 9.5),
    ("position", "X", 8.0),
];

/// Changes that do not affect a planned run.
const UNCHANGED: [&str; 2] = ["nothing", "variable that is not read"];

/// Moves to P10 and Q10, and then back and forth in the given number of blocks; the block `/1` moves to 6.5. A dwell ends in
/// position: corners without one are rounded.
fn text(blocks: usize, last: &str) -> String {
    let back_and_forth = "X1 Y1\nX2 Y2\n".repeat(blocks / 2);
    format!(
        "G54 G90 G43 G01 Z2 F6000\nX[P10] Y[Q10]\nG04 P10\n/1 X6.5\nG04 P10\nM98 P{CALLED}\n{back_and_forth}M01\n{last}M30\n"
    )
}

async fn rehearsal(served: &Served) -> Value {
    let path = format!("/programs/{PROGRAM}/rehearsal");
    until("a rehearsal, while other programs are planned", async || {
        let answer = served.get(&path).await;
        (answer.status != 503).then(|| answer.expect(200).json())
    })
    .await
}

async fn store(served: &Served, number: u16, text: &str) {
    let stored = served.put_program(number, text).await;
    assert!([200, 201].contains(&stored.status), "{stored:?}");
}

async fn load(served: &Served, text: &str) {
    store(served, PROGRAM, text).await;
    let program = json!({"program": PROGRAM});
    served.post("/cs/1/load?wait=1", &program).await.expect(200);
}

async fn set(served: &Served, path: &str, body: Value) {
    let answer = served.put(path, &body).await;
    assert!([200, 204].contains(&answer.status), "{path}: {answer:?}");
}

async fn set_offset(served: &Served, x: f64) {
    let offsets = json!({"work_offsets": {"G54": {"X": x, "Y": 0.0, "Z": 0.0}}});
    set(served, "/cs/1/work_offsets", offsets).await;
}

async fn set_lengths(served: &Served, first: f64) {
    let tool = |id: u16, length: f64| json!({"id": id, "radius": 1.0, "length": length});
    let table = json!({"tools": [tool(1, first), tool(2, 30.0)]});
    set(served, "/tools", table).await;
}

/// Sets every input to its value before a change, and loads the program.
async fn prepare(served: &Served, blocks: usize) {
    set(served, "/variables/p?from=10", json!({"values": [5.0]})).await;
    set(served, "/cs/1/variables/q?from=10", json!({"values": [4.0]})).await;
    set_offset(served, 0.0).await;
    set_lengths(served, 10.0).await;
    set(served, "/cs/1/tool", json!({"id": 1})).await;
    set(served, "/cs/1/inputs/optional_skip/1", json!({"value": true})).await;
    set(served, "/cs/1/inputs/optional_stop", json!({"value": false})).await;
    set(served, "/cs/1/inputs/dry_run", json!({"value": false})).await;
    let move_back = json!({"text": "G49\nG53 G90 G00 X0 Y0 Z0"});
    served.post("/cs/1/mdi?wait=1", &move_back).await.expect(200);
    store(served, CALLED, "X3\nM99\n").await;
    load(served, &text(blocks, "")).await;
}

async fn change(served: &Served, input: &str, blocks: usize) {
    match input {
        "P variable" => set(served, "/variables/p?from=10", json!({"values": [7.0]})).await,
        "Q variable" => set(served, "/cs/1/variables/q?from=10", json!({"values": [8.0]})).await,
        "variable that is not read" => set(served, "/variables/p?from=11", json!({"values": [7.0]})).await,
        "offset" => set_offset(served, 3.0).await,
        "length of the tool" => set_lengths(served, 20.0).await,
        "tool" => set(served, "/cs/1/tool", json!({"id": 2})).await,
        "skip" => set(served, "/cs/1/inputs/optional_skip/1", json!({"value": false})).await,
        "optional stop" => set(served, "/cs/1/inputs/optional_stop", json!({"value": true})).await,
        "dry run" => set(served, "/cs/1/inputs/dry_run", json!({"value": true})).await,
        "text" => load(served, &text(blocks, "X9\nG04 P10\n")).await,
        "text of the called program" => store(served, CALLED, "X9.5\nG04 P10\nM99\n").await,
        "position" => {
            let step = json!({"text": "G53 G90 G00 X8"});
            served.post("/cs/1/mdi?wait=1", &step).await.expect(200);
        }
        _ => {}
    }
}

/// Waits until planning has ended, and returns the result. Checks each report until then.
async fn planned(served: &Served, fits: impl Fn(&Value)) -> Value {
    let complete = until_within(PLANNED_WITHIN, "a plan", async || {
        let answer = rehearsal(served).await;
        fits(&answer);
        (answer["outcome"] != "planning").then_some(answer)
    });
    complete.await
}

/// Changes an input after planning, starts after a delay, and compares every report with the run.
async fn check_change(
    served: &Served,
    blocks: usize,
    (input, axis, highest): (&str, &str, f64),
    delay: Duration,
) {
    prepare(served, blocks).await;
    let before = planned(served, |_| {}).await;
    assert_eq!(before["run_id"], Value::Null);
    change(served, input, blocks).await;
    tokio::time::sleep(delay).await;
    served.command(1, "start").await;
    let state = served.state(1).await;
    let first = rehearsal(served).await["plan"].clone();
    let of_run = planned(served, |answer| {
        assert_eq!(answer["run_id"], state["run_id"], "{input} {delay:?}");
        assert_eq!(answer["hash"], state["hash"], "{input} {delay:?}");
        assert_eq!(answer["plan"], first, "{input} {delay:?}");
    });
    let of_run = of_run.await;
    let is_unchanged = UNCHANGED.contains(&input);
    assert_eq!(
        first == before["plan"],
        is_unchanged,
        "{input} {delay:?}: {first} after {}",
        before["plan"]
    );
    let planned_highest = of_run["axes"][axis]["highest"].as_f64().unwrap();
    assert!(
        (planned_highest - highest).abs() < 1e-9,
        "{input} {delay:?}: {planned_highest}"
    );
    served.command(1, "stop").await;
}

/// With `TANDEM_LONG` programs of 600,000 blocks, and starts up to 6 s after the change.
#[tokio::test]
async fn plan_of_a_run_fits_after_each_change_before_its_start() {
    let is_long = std::env::var_os("TANDEM_LONG").is_some();
    let (blocks, delays_ms): (_, &[u64]) = if is_long {
        (600_000, &[0, 250, 1000, 3000, 6000])
    } else {
        (2_000, &[0])
    };
    let machine = Machine::new(FREE_PORTS);
    let served = Served::start(&machine);
    let watch = served.watch(&["cs/1/time_left", "cs/1/state"]).await;
    for delay_ms in delays_ms {
        for expected in CHANGES {
            check_change(&served, blocks, expected, Duration::from_millis(*delay_ms)).await;
        }
    }
    let runs: Vec<Value> = watch.history.on("cs/1/state");
    for left in watch.history.on("cs/1/time_left") {
        let (run, plan) = (&left["payload"]["run_id"], &left["payload"]["plan"]);
        if plan.is_null() {
            continue;
        }
        let of_run = runs.iter().find(|state| state["payload"]["run_id"] == *run);
        assert_eq!(
            of_run.map(|state| &state["payload"]["hash"]),
            Some(&plan["hash"]),
            "{left}"
        );
    }
}
