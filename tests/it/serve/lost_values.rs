//! Damaged values of the store are not used, and a person can recover from them.

use std::fs;
use std::time::Duration;

use serde_json::{Value, json};

use super::data_folder::{machine, place, rot, standing, text_of_standing, until_gone};
use crate::support::machine::Machine;
use crate::support::served::Served;
use crate::support::simulated::run;

/// Flips a bit in the newest bytes of the store that hold a text.
fn rot_store(machine: &Machine, text: &str) {
    let path = place(machine, "state.redb");
    let bytes = fs::read(&path).unwrap();
    let places: Vec<usize> = (0..bytes.len() - text.len())
        .filter(|at| bytes[*at..].starts_with(text.as_bytes()))
        .collect();
    assert!(!places.is_empty(), "{text} is not in the store");
    for at in places {
        rot(&path, at + text.len() - 1);
    }
}

/// Returns the output of the command `store`, and its exit code.
fn store(machine: &Machine, arguments: &[&str]) -> (i32, String) {
    let all = [&["store"], arguments, &["--config", "tandem.toml"]].concat();
    let ran = run(machine.folder(), &all);
    (ran.code, ran.stdout + &ran.stderr)
}

#[tokio::test]
async fn damaged_tool_is_unusable_until_written_again_and_the_rest_works() {
    let machine = machine();
    let served = Served::start(&machine);
    let tools = json!({"tools": [{"id": 18, "length": 18.5}, {"id": 19, "length": 19.25}]});
    served.put("/tools", &tools).await.expect(204);
    served
        .put_program(50, "G43 G01 Z50 F600\nM30\n")
        .await
        .expect(201);
    let mut served = served;
    served.process.signal("TERM");
    assert_eq!(served.process.exit_code_within(Duration::from_secs(10)), Some(0));
    drop(served);
    assert_eq!(store(&machine, &["verify"]).0, 0);
    rot_store(&machine, "\"length\":19.25");
    let (code, said) = store(&machine, &["verify"]);
    assert!(code == 1 && said.contains("damaged: tool 19: lost"), "{said}");
    let served = Served::start(&machine);
    let text = text_of_standing(&served, 406).await;
    assert!(text.ends_with(": tool 19"), "{text}");
    let text = text_of_standing(&served, 410).await;
    assert!(text.contains("state.redb.damaged-1"), "{text}");
    let tools = served.get("/tools").await.expect(200).json();
    assert_eq!(tools["tools"].as_array().unwrap().len(), 1, "{tools}");
    served
        .post("/cs/1/load?wait=1", &json!({"program": 50}))
        .await
        .expect(200);
    served.command(1, "reset").await;
    for (tool, ended, reason) in [
        (19, "STOPPED", json!("ALARM")),
        (18, "PROGRAM_COMPLETED", Value::Null),
    ] {
        served.put("/cs/1/tool", &json!({"id": tool})).await.expect(204);
        served.command(1, "start").await;
        let state = served.execution(1, ended).await;
        assert_eq!(state["reason"], reason, "{state}");
        if tool == 19 {
            assert!(
                text_of_standing(&served, 412)
                    .await
                    .contains("length of the tool")
            );
            assert_eq!(
                served.get("/cs/1/position").await.expect(200).json()["machine"]["Z"],
                0.0
            );
            served.command(1, "reset").await;
            assert!(standing(&served, 406).await.is_some(), "no reset makes it right");
        }
    }
    served
        .put("/tools", &json!({"tools": [{"id": 19, "length": 19.25}]}))
        .await
        .expect(204);
    until_gone(&served, 406).await;
    drop(served);
    assert_eq!(store(&machine, &["verify"]).0, 0);
}

/// Programs, and whether one of them needs a value that is lost.
const PROGRAMS: [(&str, bool); 7] = [
    ("P1=2\nG54 G00 X1\nM30\n", false),
    ("P600=P500\nM30\n", true),
    ("if (P500 > 0) {\nG00 X5\n}\nM30\n", true),
    ("G00 X[P500]\nM30\n", true),
    ("G55 G00 X1\nM30\n", true),
    ("G43 G00 Z1\nM30\n", true),
    ("P500=1\nP600=P500\nG00 X2\nM30\n", false),
];

async fn run_one(served: &Served, program: &str, is_refused: bool) {
    served.put_program(50, program).await;
    served
        .post("/cs/1/load?wait=1", &json!({"program": 50}))
        .await
        .expect(200);
    served.command(1, "start").await;
    let state = served
        .execution(
            1,
            if is_refused {
                "STOPPED"
            } else {
                "PROGRAM_COMPLETED"
            },
        )
        .await;
    if is_refused {
        assert_eq!(state["reason"], "ALARM", "{program}");
        text_of_standing(served, 412).await;
        served.command(1, "reset").await;
    }
}

#[tokio::test]
async fn lost_variables_and_offsets_stop_only_the_programs_that_need_them() {
    let machine = machine();
    let served = Served::start(&machine);
    served
        .put("/variables/p?from=500", &json!({"values": [1234.56789]}))
        .await
        .expect(204);
    served
        .put(
            "/cs/1/work_offsets",
            &json!({"work_offsets": {"G55": {"X": 77.125}}}),
        )
        .await
        .expect(204);
    served.put("/cs/1/tool", &json!({"id": 7777})).await.expect(204);
    let mut served = served;
    served.process.signal("TERM");
    assert_eq!(served.process.exit_code_within(Duration::from_secs(10)), Some(0));
    drop(served);
    let bytes = 1234.56789_f64.to_le_bytes();
    let path = place(&machine, "state.redb");
    let content = fs::read(&path).unwrap();
    let places = (0..content.len() - 8).filter(|at| content[*at..].starts_with(&bytes));
    for at in places.collect::<Vec<_>>() {
        rot(&path, at);
    }
    rot_store(&machine, "\"X\":77.125");
    rot_store(&machine, "tool/17777");
    let served = Served::start(&machine);
    let text = text_of_standing(&served, 406).await;
    for what in [
        "P384 to P511",
        "G55 X",
        "the tool in the spindle of coordinate system 1",
    ] {
        assert!(text.contains(what), "{what} in {text}");
    }
    let modal = served.get("/cs/1/modal").await.expect(200).json();
    assert_eq!(modal["tool"], Value::Null, "nobody knows which it is");
    served.get("/variables/p?from=500").await.expect(503);
    served.get("/variables/p?from=512").await.expect(200);
    for (program, is_refused) in PROGRAMS {
        run_one(&served, program, is_refused).await;
    }
    let p = served.get("/variables/p?from=600").await.expect(200).json();
    assert_eq!(p["values"], json!([1.0]), "a refused assignment changes nothing");
    served
        .put("/variables/p?from=384", &json!({"values": vec![0; 128]}))
        .await
        .expect(204);
    served
        .put(
            "/cs/1/work_offsets",
            &json!({"work_offsets": {"G55": {"X": 1, "Y": 0, "Z": 0}}}),
        )
        .await
        .expect(204);
    served.put("/cs/1/tool", &json!({"id": 0})).await.expect(204);
    until_gone(&served, 406).await;
    let modal = served.get("/cs/1/modal").await.expect(200).json();
    assert_eq!(modal["tool"], 0);
}

#[tokio::test]
async fn an_empty_store_is_told_and_a_person_takes_the_last_good_generation() {
    let machine = machine();
    let served = Served::start(&machine);
    served
        .put("/tools", &json!({"tools": [{"id": 19, "length": 19.25}]}))
        .await
        .expect(204);
    served
        .put("/variables/p?from=3", &json!({"values": ["NaN", -0.0]}))
        .await
        .expect(204);
    served.put("/cs/1/tool", &json!({"id": 19})).await.expect(204);
    assert_eq!(store(&machine, &["verify"]).0, 2, "it runs");
    let mut served = served;
    served.process.signal("TERM");
    assert_eq!(served.process.exit_code_within(Duration::from_secs(10)), Some(0));
    drop(served);
    let (code, exported) = store(&machine, &["export"]);
    assert_eq!(code, 0, "{exported}");
    fs::write(place(&machine, "state.redb"), "").unwrap();
    let served = Served::start(&machine);
    let text = text_of_standing(&served, 406).await;
    assert!(text.contains("tool 19") && text.contains("P0 to P127"), "{text}");
    assert!(
        text_of_standing(&served, 410)
            .await
            .contains("the store is empty")
    );
    let mut served = served;
    served.process.signal("TERM");
    assert_eq!(served.process.exit_code_within(Duration::from_secs(10)), Some(0));
    drop(served);
    let (code, said) = store(&machine, &["repair"]);
    assert!(
        code == 1 && said.contains("tool 19: {") && said.contains("19.25"),
        "{said}"
    );
    let (code, said) = store(&machine, &["repair", "--yes"]);
    assert!(code == 0 && said.contains("check them"), "{said}");
    assert_eq!(store(&machine, &["verify"]).0, 0);
    let served = Served::start(&machine);
    assert!(standing(&served, 406).await.is_none());
    assert_eq!(
        served.get("/tools").await.expect(200).json()["tools"][0]["length"],
        19.25
    );
    let p = served.get("/variables/p?from=3&count=2").await.expect(200).json();
    assert_eq!(p["values"], json!(["NaN", -0.0]));
    drop(served);
    // likewise for an exported file, into an empty folder
    fs::remove_dir_all(machine.path("tandem-data")).unwrap();
    drop(Served::start(&machine));
    machine.write("kept.json", &exported);
    let (code, said) = store(&machine, &["import", "kept.json"]);
    assert_eq!(code, 0, "{said}");
    let served = Served::start(&machine);
    assert_eq!(
        served.get("/tools").await.expect(200).json()["tools"][0]["id"],
        19
    );
    assert_eq!(served.get("/cs/1/tool").await.expect(200).json()["id"], 19);
}

#[tokio::test]
async fn journal_records_values_imported_or_repaired_at_the_command_line() {
    let machine = machine();
    let mut served = Served::start(&machine);
    served
        .put("/tools", &json!({"tools": [{"id": 19, "length": 19.25}]}))
        .await
        .expect(204);
    let journal = |arguments: &[&str]| {
        let all = [&["journal"], arguments, &["--config", "tandem.toml"]].concat();
        let ran = run(machine.folder(), &all);
        (ran.code, ran.stdout + &ran.stderr)
    };
    served.process.signal("TERM");
    assert_eq!(served.process.exit_code_within(Duration::from_secs(10)), Some(0));
    drop(served);
    let (code, verified) = journal(&["verify"]);
    assert!(
        code == 0 && verified.contains("The chain is intact"),
        "{verified}"
    );
    let head = verified
        .lines()
        .find_map(|line| line.strip_prefix("head: "))
        .unwrap();
    let (code, exported) = store(&machine, &["export"]);
    assert_eq!(code, 0, "{exported}");
    machine.write("kept.json", &exported);
    assert_eq!(store(&machine, &["import", "kept.json"]).0, 0);
    let (code, told) = journal(&["show", "--json"]);
    assert_eq!(code, 0, "{told}");
    let lines: Vec<Value> = told
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let request = |of: &str| lines.iter().find(|line| line["request"] == of).unwrap();
    assert_eq!(request("PUT /tools")["from"], "127.0.0.1");
    let import = request("tandem store import kept.json");
    assert_eq!(import["over"], "command_line");
    assert!(
        import["user"].as_str().is_some_and(|user| !user.is_empty()),
        "{import}"
    );
    // earlier records remain while it runs, too
    let served = Served::start(&machine);
    let (code, verified) = journal(&["verify", "--head", head]);
    assert_eq!(code, 0, "{verified}");
    let lines = served.get("/journal?since=1h&cs=0").await.expect(200).json();
    let lines = lines["lines"].as_array().unwrap();
    assert!(
        lines.iter().any(|line| line["request"] == "PUT /tools"),
        "{lines:?}"
    );
    served.get("/journal?since=soon").await.expect(400);
    served.get("/journal?user=nobody").await.expect(200);
    drop(served);
    let path = place(&machine, "journal/journal.jsonl");
    let text = fs::read_to_string(&path)
        .unwrap()
        .replace("PUT /tools", "PUT /tolls");
    fs::write(&path, text).unwrap();
    let (code, said) = journal(&["verify"]);
    assert!(
        code == 1 && said.contains("journal.jsonl:") && said.contains("damaged"),
        "{said}"
    );
}
