//! Identity of programs: hashes in states, answers and the journal, conditions on them, and signatures.

use std::fs;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use ring::digest::{SHA256, digest};
use ring::signature::{Ed25519KeyPair, KeyPair as _};
use serde_json::{Value, json};

use super::{M_CODES, served};
use crate::support::http::{Answer, request_with};
use crate::support::machine::Machine;
use crate::support::served::{FREE_PORTS, Served};
use crate::support::wait::until;

/// SHA-256 in hexadecimal digits, by another implementation than the runtime's.
fn hash(text: &str) -> String {
    let digits = |byte: &u8| [byte >> 4, byte & 15].map(|digit| char::from_digit(digit.into(), 16).unwrap());
    let digest = digest(&SHA256, text.as_bytes());
    digest.as_ref().iter().flat_map(digits).collect()
}

async fn send(served: &Served, method: &str, path: &str, body: &str, headers: &str) -> Answer {
    let path = format!("/api/v1{path}");
    let kind = if path.contains("/programs/") {
        "text/plain"
    } else {
        "application/json"
    };
    request_with(&served.http, method, &path, kind, body, headers).await
}

async fn put(served: &Served, number: u16, text: &str, headers: &str) -> Answer {
    send(served, "PUT", &format!("/programs/{number}"), text, headers).await
}

/// Lines of the journal of one event, oldest first.
async fn journal(served: &Served, event: &str) -> Vec<Value> {
    let lines = served.get("/journal?count=1000").await.expect(200).json();
    let lines = lines["lines"].as_array().unwrap().clone();
    lines.into_iter().filter(|line| line["event"] == event).collect()
}

/// Waits for an event, and returns its newest line.
async fn newest(served: &Served, event: &str, fits: impl Fn(&Value) -> bool) -> Value {
    let what = format!("a line of {event}");
    until(&what, async || {
        journal(served, event).await.into_iter().rfind(&fits)
    })
    .await
}

const OLD: &str = "G00 X1\nG04 X1000\nM30\n";
const NEW: &str = "G00 X2\nG04 X1000\nM30\n";

#[tokio::test]
async fn the_hash_of_the_program_is_in_the_answers_the_state_and_the_journal() {
    let (_machine, served) = served();
    assert_eq!(served.state(1).await["hash"], Value::Null);
    let stored = put(&served, 50, OLD, "").await.expect(201);
    let etag = format!("\"{}\"", hash(OLD));
    assert_eq!(
        (&stored.json()["hash"], stored.header("etag")),
        (&json!(hash(OLD)), Some(etag.as_str()))
    );
    let again = put(&served, 50, OLD, "").await.expect(200).json();
    assert_eq!(again["unchanged"], true);
    let list = served.get("/programs").await.expect(200).json();
    assert_eq!(list["programs"][0]["hash"], json!(hash(OLD)));
    let loaded = served
        .post("/cs/1/load?wait=1", &json!({"program": 50}))
        .await
        .expect(200);
    assert_eq!(loaded.json()["hash"], json!(hash(OLD)));
    let accepted = served
        .post("/cs/1/load", &json!({"program": 50}))
        .await
        .expect(202);
    assert_eq!(accepted.json()["hash"], json!(hash(OLD)));
    served
        .state_where(1, "the hash", |state| state["hash"] == json!(hash(OLD)))
        .await;
    // the state names the program that a start would run
    put(&served, 50, NEW, "").await.expect(200);
    served
        .state_where(1, "the new hash", |state| state["hash"] == json!(hash(NEW)))
        .await;
    served.command(1, "start").await;
    assert_eq!(served.state(1).await["hash"], json!(hash(NEW)));
    served.command(1, "stop").await;
    send(&served, "DELETE", "/programs/50", "", "").await.expect(204);
    served
        .state_where(1, "no hash", |state| state["hash"].is_null())
        .await;
    let start = newest(&served, "start", |line| line["program"] == 50).await;
    assert_eq!(start["program_hash"], json!(hash(NEW)));
    let load = newest(&served, "command", |line| line["verb"] == "load").await;
    assert_eq!(
        (&load["program"], &load["program_hash"]),
        (&json!(50), &json!(hash(OLD)))
    );
    newest(&served, "program", |line| line["what"] == "delete").await;
    let edits: Vec<Value> = journal(&served, "program").await;
    let edits: Vec<_> = edits
        .iter()
        .map(|line| {
            (
                line["what"].as_str().unwrap(),
                line["old_hash"].clone(),
                line["new_hash"].clone(),
            )
        })
        .collect();
    let (old, new) = (json!(hash(OLD)), json!(hash(NEW)));
    assert_eq!(
        edits,
        [
            ("upload", Value::Null, old.clone()),
            ("unchanged", old.clone(), old.clone()),
            ("replace", old, new.clone()),
            ("delete", new, Value::Null),
        ]
    );
}

#[tokio::test]
async fn program_is_changed_loaded_and_started_only_if_its_hash_matches() {
    let (machine, served) = served();
    let (is_old, is_new) = (
        format!("If-Match: \"{}\"\r\n", hash(OLD)),
        format!("If-Match: \"{}\"\r\n", hash(NEW)),
    );
    put(&served, 50, OLD, &is_old).await.expect(412);
    put(&served, 50, OLD, "If-None-Match: *\r\n").await.expect(201);
    let refused = put(&served, 50, NEW, "If-None-Match: *\r\n")
        .await
        .expect(412)
        .json();
    assert_eq!(refused["code"], "precondition_failed");
    assert!(
        refused["detail"].as_str().unwrap().contains(&hash(OLD)),
        "{refused}"
    );
    put(&served, 50, NEW, &is_new).await.expect(412);
    let had = format!("If-None-Match: \"{}\"\r\n", hash(OLD));
    send(&served, "GET", "/programs/50", "", &had).await.expect(304);
    let load = json!({"program": 50}).to_string();
    send(&served, "POST", "/cs/1/load", &load, &is_new)
        .await
        .expect(412);
    send(&served, "POST", "/cs/1/load?wait=1", &load, &is_old)
        .await
        .expect(200);
    put(&served, 50, NEW, &is_old).await.expect(200);
    send(&served, "POST", "/cs/1/start", "", &is_old)
        .await
        .expect(412);
    send(&served, "POST", "/cs/1/start?wait=1", "", &is_new)
        .await
        .expect(200);
    send(&served, "POST", "/cs/1/hold?wait=1", "", &is_new)
        .await
        .expect(200);
    send(&served, "POST", "/cs/1/resume", "", &is_old)
        .await
        .expect(412);
    send(&served, "POST", "/cs/1/stop?wait=1", "", "")
        .await
        .expect(200);
    send(&served, "DELETE", "/programs/50", "", &is_old)
        .await
        .expect(412);
    // a file changed outside is valid in its changed form, noticed or not
    fs::write(machine.path("tandem-data/programs/50.nc"), OLD).unwrap();
    send(&served, "DELETE", "/programs/50", "", &is_new)
        .await
        .expect(412);
    send(&served, "DELETE", "/programs/50", "", &is_old)
        .await
        .expect(204);
    let refused = newest(&served, "refused", |line| line["request"] == "start").await;
    assert_eq!(
        (&refused["code"], &refused["program"]),
        (&json!("precondition_failed"), &json!(50))
    );
    newest(&served, "refused", |line| {
        line["request"] == "DELETE /programs/50"
    })
    .await;
}

#[tokio::test]
async fn over_mqtt_a_load_and_a_start_name_the_program_that_they_mean() {
    use plc_protocol::types::command::{Command, CommandMeta, Expect};
    use plc_protocol::types::request::{RefusalCode, typed};
    let (_machine, served) = served();
    put(&served, 50, OLD, "").await.expect(201);
    let plc = plc_api::Plc::connect(&served.mqtt_url()).await.unwrap();
    let ask = async |command, id: &str, hash: String| {
        let expect = Expect {
            hash: Some(hash),
            ..Expect::default()
        };
        let meta = CommandMeta {
            command_id: id.to_owned(),
            client_id: "plc".to_owned(),
            expect: Some(expect),
            ..CommandMeta::default()
        };
        let request = typed::Command {
            cs: 1,
            command,
            meta,
            wait: true,
        };
        plc.port().ask(request).await
    };
    let refusal = ask(Command::Load { program: 50 }, "a", hash(NEW))
        .await
        .unwrap_err();
    assert_eq!(refusal.code, RefusalCode::PreconditionFailed);
    let loaded = ask(Command::Load { program: 50 }, "b", hash(OLD)).await.unwrap();
    assert_eq!(loaded.hash, Some(hash(OLD)));
    assert!(ask(Command::Start, "c", hash(NEW)).await.is_err());
    assert!(ask(Command::Start, "d", hash(OLD)).await.is_ok());
    served.command(1, "abort").await;
}

fn pair() -> Ed25519KeyPair {
    Ed25519KeyPair::from_seed_unchecked(&[3; 32]).unwrap()
}

fn signature(text: &str) -> String {
    let signature = STANDARD.encode(pair().sign(text.as_bytes()));
    format!("Program-Signature: {signature}\r\n")
}

fn signed_machine(more: &str) -> Machine {
    let key = STANDARD.encode(pair().public_key().as_ref());
    Machine::new(&format!(
        "{M_CODES}{FREE_PORTS}\n[programs]\nsigned_by = [\"{key}\"]\n{more}"
    ))
}

#[tokio::test]
async fn machine_with_signers_requires_signed_programs_and_subprograms() {
    let machine = signed_machine("");
    let served = Served::start(&machine);
    let load = async |number: u16| {
        let body = json!({ "program": number });
        served.post("/cs/1/load?wait=1", &body).await
    };
    let stored = put(&served, 50, OLD, "").await.expect(201).json();
    assert_eq!(stored["signature"], "missing");
    let refused = load(50).await.expect(422).json();
    assert_eq!(refused["code"], "not_signed");
    assert!(
        refused["detail"]
            .as_str()
            .unwrap()
            .starts_with("program 50 is not signed"),
        "{refused}"
    );
    let stored = put(&served, 50, OLD, &signature(NEW)).await.expect(200).json();
    assert_eq!(stored["signature"], "wrong");
    load(50).await.expect(422);
    let stored = put(&served, 50, OLD, &signature(OLD)).await.expect(200).json();
    assert_eq!(stored["signature"], "valid");
    load(50).await.expect(200);
    put(&served, 50, OLD, "Program-Signature: AAAA\r\n")
        .await
        .expect(400);
    // a subprogram that it names
    let calls = "M98 P1000\nM30\n";
    put(&served, 51, calls, &signature(calls)).await.expect(201);
    put(&served, 1000, "M99\n", "").await.expect(201);
    let refused = load(51).await.expect(422).json();
    assert!(
        refused["detail"]
            .as_str()
            .unwrap()
            .contains("program 1000 is not signed"),
        "{refused}"
    );
    a_computed_call_is_judged_when_it_is_made(&served).await;
    put(&served, 1000, "M99\n", &signature("M99\n")).await.expect(200);
    load(51).await.expect(200);
    served.post("/cs/1/start?wait=1", &Value::Null).await.expect(200);
    served.execution(1, "PROGRAM_COMPLETED").await;
    let refused = newest(&served, "refused", |line| line["program"] == 51).await;
    assert_eq!(
        (&refused["code"], &refused["request"]),
        (&json!("not_signed"), &json!("load"))
    );
}

/// Program 1000 is not signed.
async fn a_computed_call_is_judged_when_it_is_made(served: &Served) {
    served
        .put("/variables/p?from=1", &json!({"values": [1000]}))
        .await
        .expect(204);
    let computes = "M98 P[P1]\nM30\n";
    put(served, 52, computes, &signature(computes)).await.expect(201);
    served
        .post("/cs/1/load?wait=1", &json!({"program": 52}))
        .await
        .expect(200);
    served.post("/cs/1/start", &Value::Null).await.expect(202);
    let alarms = until("an alarm", async || {
        let alarms = served.get("/alarms").await.expect(200).json();
        alarms["alarms"]
            .as_array()
            .is_some_and(|alarms| !alarms.is_empty())
            .then_some(alarms)
    });
    let alarm = alarms.await["alarms"][0].clone();
    assert_eq!((&alarm["number"], &alarm["line"]), (&json!(24), &json!(1)));
    assert!(
        alarm["text"]
            .as_str()
            .unwrap()
            .contains("program 1000 is not signed"),
        "{alarm}"
    );
    served.command(1, "reset").await;
}

#[tokio::test]
async fn signature_survives_restart_but_not_a_change_outside() {
    let machine = signed_machine("");
    let served = Served::start(&machine);
    put(&served, 50, OLD, &signature(OLD)).await.expect(201);
    drop(served);
    let served = Served::start(&machine);
    let load = json!({"program": 50});
    served.post("/cs/1/load?wait=1", &load).await.expect(200);
    let is = |wanted: &'static str| {
        let served = &served;
        async move || {
            let list = served.get("/programs").await.expect(200).json();
            (list["programs"][0]["signature"] == wanted).then_some(())
        }
    };
    let (program, beside) = ("tandem-data/programs/50.nc", "tandem-data/programs/50.nc.sig");
    fs::write(machine.path(program), NEW).unwrap();
    until("a wrong signature", is("wrong")).await;
    served.post("/cs/1/start", &Value::Null).await.expect(422);
    served.post("/cs/1/load", &load).await.expect(422);
    // signed again, also outside
    fs::write(machine.path(beside), pair().sign(NEW.as_bytes()).as_ref()).unwrap();
    until("a valid signature", is("valid")).await;
    served.post("/cs/1/load?wait=1", &load).await.expect(200);
    fs::remove_file(machine.path(beside)).unwrap();
    until("no signature", is("missing")).await;
    served.post("/cs/1/start", &Value::Null).await.expect(422);
    let outside = newest(&served, "program", |line| line["what"] == "outside").await;
    assert_eq!(outside["new_hash"], json!(hash(NEW)));
}

#[tokio::test]
async fn machine_with_signers_refuses_manual_data_input_unless_configured() {
    let input = json!({"text": "G00 X1"});
    for (more, status) in [("", 422), ("mdi = false\n", 422), ("mdi = true\n", 200)] {
        let machine = signed_machine(more);
        let served = Served::start(&machine);
        put(&served, 50, OLD, &signature(OLD)).await.expect(201);
        served
            .post("/cs/1/load?wait=1", &json!({"program": 50}))
            .await
            .expect(200);
        let answer = served
            .post("/cs/1/mdi?wait=1", &input)
            .await
            .expect(status)
            .json();
        if status == 422 {
            assert_eq!(answer["code"], "not_signed");
            newest(&served, "refused", |line| line["request"] == "mdi").await;
        }
        // homing and jogs have no program text
        served.execution(1, "READY").await;
        served.post("/cs/1/home?wait=1", &json!({})).await.expect(200);
    }
}
