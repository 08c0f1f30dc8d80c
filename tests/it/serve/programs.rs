//! The program store over REST.

use serde_json::{Value, json};

use super::{served, served_with};
use crate::support::machine::Machine;
use crate::support::simulated::run;

#[tokio::test]
async fn program_with_errors_is_stored_with_diagnostics_and_not_loadable() {
    let (_machine, served) = served();
    let stored = served
        .put_program(50, "G00 X1 X2\nG05\nM30\n")
        .await
        .expect(201)
        .json();
    let lines = |body: &Value| {
        let found = body["diagnostics"].as_array().expect("diagnostics").clone();
        found
            .iter()
            .map(|one| one["line"].as_u64().unwrap())
            .collect::<Vec<_>>()
    };
    assert_eq!(lines(&stored), [1, 2]);
    let before = served.state(1).await;
    let refused = served
        .post("/cs/1/load", &json!({"program": 50}))
        .await
        .expect(422)
        .json();
    assert_eq!(lines(&refused), [1, 2]);
    let after = served.state(1).await;
    assert_eq!(
        (&after["execution"], &after["program"]),
        (&before["execution"], &before["program"])
    );
    served.put_program(50, "G00 X1\nM30\n").await.expect(200);
    served
        .post("/cs/1/load?wait=1", &json!({"program": 50}))
        .await
        .expect(200);
}

#[tokio::test]
async fn errors_of_a_called_subprogram_refuse_the_load_too() {
    let (_machine, served) = served();
    served.put_program(50, "M98 P1000\nM30\n").await.expect(201);
    served.put_program(1000, "G05\nM99\n").await.expect(201);
    let refused = served
        .post("/cs/1/load", &json!({"program": 50}))
        .await
        .expect(422)
        .json();
    assert!(
        refused["diagnostics"][0]["message"]
            .as_str()
            .unwrap()
            .contains("1000"),
        "{refused}"
    );
}

#[tokio::test]
async fn what_was_stored_is_read_again_letter_by_letter() {
    let (_machine, served) = served();
    let text = "// ä comment\r\nG00 X1\n\n/* two\nlines */ M30\n";
    served.put_program(7, text).await.expect(201);
    let read = served.get("/programs/7").await.expect(200);
    assert_eq!(read.body, text);
}

#[tokio::test]
async fn a_program_that_does_not_exist_is_404() {
    let (_machine, served) = served();
    served.get("/programs/8").await.expect(404);
    served
        .post("/cs/1/load", &json!({"program": 8}))
        .await
        .expect(404);
    served.get("/cs/9/state").await.expect(404);
    served.post("/cs/9/start", &Value::Null).await.expect(404);
}

#[tokio::test]
async fn program_beyond_the_total_size_is_refused_with_the_limit_no_alarm() {
    let (_machine, served) = served_with("[programs]\ntotal_max_mib = 1\n");
    let large = format!("{}M30\n", "G00 X1\n".repeat(100_000));
    served.put_program(50, &large).await.expect(201);
    let refused = served.put_program(51, &large).await.expect(413).json();
    assert_eq!(refused["code"], "too_large", "{refused}");
    for part in ["1048576", "delete a program first", "total_max_mib"] {
        assert!(refused["detail"].as_str().unwrap().contains(part), "{refused}");
    }
    served.get("/programs/51").await.expect(404);
    let active = served.get("/alarms").await.expect(200).json();
    assert_eq!(active["alarms"], json!([]));
    // a replacement uses the space of the old program, and a deletion frees it
    served.put_program(50, &large).await.expect(200);
    served.put_program(50, "M30\n").await.expect(200);
    served.put_program(51, &large).await.expect(201);
}

#[tokio::test]
async fn a_program_that_runs_cannot_be_overwritten() {
    let (_machine, served) = served();
    served.load(1, 50, "M100\nM30\n").await;
    served.command(1, "start").await;
    served.execution(1, "WAIT").await;
    served.put_program(50, "M30\n").await.expect(409);
    served.reset_output(1, "test", false).await.expect(200);
    served.execution(1, "PROGRAM_COMPLETED").await;
    served.put_program(50, "M30\n").await.expect(200);
}

#[tokio::test]
async fn the_intermediate_code_of_a_stored_program_is_what_compile_writes() {
    let (_machine, served) = served();
    let text = "G00 X5\nM100 VA3\nM99\n";
    for (number, header) in [(50, "open prog 50\n"), (1000, "open subprog 1000\n")] {
        served.put_program(number, text).await.expect(201);
        let code = served.get(&format!("/programs/{number}/intermediate")).await;
        let code = code.expect(200);
        assert_eq!(code.header("content-type"), Some("text/plain; charset=utf-8"));
        let machine = Machine::new("");
        let file = format!("{number}.nc");
        machine.write(&file, text);
        let compiled = run(machine.folder(), &["compile", &file]);
        assert_eq!(code.body, compiled.stdout);
        assert!(code.body.starts_with(header), "{}", code.body);
    }
}

#[tokio::test]
async fn program_with_errors_has_diagnostics_and_no_intermediate_code() {
    let (_machine, served) = served();
    served.put_program(50, "G00 X5\nG999\nM30\n").await.expect(201);
    let refused = served.get("/programs/50/intermediate").await.expect(422).json();
    assert_eq!(refused["code"], "program_has_errors");
    assert_eq!(refused["diagnostics"][0]["line"], 2);
    served.get("/programs/51/intermediate").await.expect(404);
}
