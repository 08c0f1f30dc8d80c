//! Two coordinate systems of one machine with two dialects: a program has one dialect, and keeps it.

use std::fs;

use serde_json::{Value, json};

use super::M_CODES;
use crate::support::http::{Answer, request};
use crate::support::machine::Machine;
use crate::support::served::{FREE_PORTS, Served};
use crate::support::simulated::run;
use crate::support::wait::until;

const MILL: &str = "%\nO12345678 (FLANGE)\nG90\nG00 X1.0\nM30\n%\n";
const LOADER: &str = "// Loader\nG90\nG00 X1\nM30\n";

/// Coordinate system 1 has dialect nj, 2 has dgshape.
fn machine() -> Machine {
    Machine::new(&format!("dialect = \"dgshape\"\n{M_CODES}{FREE_PORTS}"))
}

async fn put(served: &Served, number: u16, query: &str, text: &str) -> Answer {
    let path = format!("/api/v1/programs/{number}{query}");
    request(&served.http, "PUT", &path, "text/plain", text).await
}

async fn load(served: &Served, cs: u8, program: u16) -> Answer {
    let path = format!("/cs/{cs}/load?wait=1");
    served.post(&path, &json!({ "program": program })).await
}

/// Returns the program with a number in the list.
async fn listed(served: &Served, number: u16) -> Option<Value> {
    let list = served.get("/programs").await.expect(200).json();
    let mut programs = list["programs"].as_array().unwrap().iter();
    programs.find(|program| program["number"] == number).cloned()
}

#[tokio::test]
async fn a_program_has_a_dialect_and_loads_only_where_it_is_spoken() {
    let machine = machine();
    let served = Served::start(&machine);
    let stored = put(&served, 7, "?dialect=dgshape", MILL).await.expect(201).json();
    assert_eq!(
        (&stored["dialect"], &stored["o_number"], &stored["diagnostics"]),
        (&json!("dgshape"), &json!(12_345_678), &json!([]))
    );
    let stored = put(&served, 8, "", LOADER).await.expect(201).json();
    assert_eq!(
        (&stored["dialect"], &stored["o_number"]),
        (&json!("nj"), &Value::Null)
    );
    put(&served, 9, "?dialect=iso", LOADER).await.expect(400);
    put(&served, 9, "?dialekt=nj", LOADER).await.expect(400);
    for (cs, program) in [(1, 7), (2, 8)] {
        let refused = load(&served, cs, program).await.expect(422).json();
        let detail = refused["detail"].as_str().unwrap();
        assert_eq!(refused["code"], "wrong_dialect");
        assert!(detail.contains("nj") && detail.contains("dgshape"), "{detail}");
    }
    load(&served, 1, 8).await.expect(200);
    load(&served, 2, 7).await.expect(200);
    let state = served.state(2).await;
    assert_eq!(
        (&state["program"], &state["o_number"]),
        (&json!(7), &json!(12_345_678))
    );
    assert_eq!(served.state(1).await["o_number"], Value::Null);
    let of_list = listed(&served, 7).await.unwrap();
    assert_eq!(
        (
            &of_list["number"],
            &of_list["o_number"],
            &of_list["dialect"],
            &of_list["title"]
        ),
        (&json!(7), &json!(12_345_678), &json!("dgshape"), &json!("FLANGE"))
    );
    served.command(2, "start").await;
    served.execution(2, "PROGRAM_COMPLETED").await;
    // a subprogram of another dialect
    put(&served, 50, "", "M98 P1000\nM30\n").await.expect(201);
    put(&served, 1000, "?dialect=dgshape", MILL).await.expect(201);
    let refused = load(&served, 1, 50).await.expect(422).json();
    assert!(
        refused["detail"]
            .as_str()
            .unwrap()
            .starts_with("program 1000 has dialect dgshape"),
        "{refused}"
    );
    // the same text in the other dialect is another program
    let again = put(&served, 1000, "?dialect=nj", MILL).await.expect(200).json();
    assert_eq!(
        (&again["unchanged"], &again["dialect"]),
        (&Value::Null, &json!("nj"))
    );
}

#[tokio::test]
async fn program_keeps_its_dialect_over_restart_edit_verify_and_repair() {
    let machine = machine();
    let served = Served::start(&machine);
    put(&served, 7, "?dialect=dgshape", MILL).await.expect(201);
    drop(served);
    let served = Served::start(&machine);
    assert_eq!(listed(&served, 7).await.unwrap()["dialect"], "dgshape");
    let file = machine.path("tandem-data/programs/7.nc");
    fs::write(&file, MILL.replace("12345678", "8")).unwrap();
    let changed = until("the change", async || {
        listed(&served, 7)
            .await
            .filter(|program| program["o_number"] == 8)
    });
    assert_eq!(changed.await["dialect"], "dgshape");
    drop(served);
    fs::write(&file, MILL).unwrap();
    let config = machine.config();
    let config = ["--config", config.to_str().unwrap()];
    let store = |arguments: &[&str]| run(machine.folder(), &[&["store"], arguments, &config].concat());
    assert_eq!(store(&["verify"]).code, 0);
    assert_eq!(store(&["repair", "--program", "7"]).code, 0);
    let served = Served::start(&machine);
    assert_eq!(listed(&served, 7).await.unwrap()["dialect"], "dgshape");
    load(&served, 2, 7).await.expect(200);
    drop(served);
    // its dialect is stored with its checksum: if that is damaged, the machine does not guess
    let sums = machine.path("tandem-data/programs/sums");
    let text = fs::read_to_string(&sums).unwrap();
    fs::write(&sums, text.replace("dgshape", "dgshopf")).unwrap();
    for _ in 0..2 {
        let served = Served::start(&machine);
        assert_eq!(listed(&served, 7).await, None);
        let refused = load(&served, 2, 7).await.expect(503).json();
        assert!(
            refused["detail"]
                .as_str()
                .unwrap()
                .contains("its dialect is unknown"),
            "{refused}"
        );
    }
    let served = Served::start(&machine);
    put(&served, 7, "?dialect=dgshape", MILL).await.expect(201);
    load(&served, 2, 7).await.expect(200);
}
