//! If the disk refuses every write, the machine continues and reports this.

use serde_json::json;

use crate::support::machine::Machine;
use crate::support::served::{FREE_PORTS, Served};
use crate::support::wait::until;

#[tokio::test]
async fn disk_failure_continues_motion_and_refuses_persistent_changes() {
    let machine = Machine::new(&format!("[m_code.100]\nunhandled = \"wait\"\n{FREE_PORTS}"));
    let served = Served::start_with_failing_disk(&machine);
    served.load(1, 7, "M100\nG91 G01 X3 F600\nM30\n").await;
    served.command(1, "start").await;
    served.execution(1, "WAIT").await;

    served.process.limit_file_bytes("1:");
    let tool = |radius: f64| json!({"tools": [{"id": 1, "radius": radius}]});
    let refused = served.put("/tools", &tool(2.0)).await.expect(503).json();
    assert!(
        refused["detail"].as_str().unwrap().contains("state.redb"),
        "{refused}"
    );
    assert_eq!(
        served.get("/tools").await.expect(200).json()["tools"],
        json!([]),
        "nothing of it counts"
    );
    served.put_program(8, "M30\n").await.expect(503);
    until("alarm 402", async || {
        let explained = served.get("/explain/alarm%20402").await.expect(200).json();
        assert!(
            explained["text"]
                .as_str()
                .unwrap()
                .contains("Remedy: Check the disk of data_dir")
        );
        let history = served.get("/alarms/history").await.expect(200).json();
        let alarms = history["alarms"].as_array().unwrap();
        alarms.iter().any(|alarm| alarm["number"] == 402).then_some(())
    })
    .await;

    served.reset_output(1, "op", true).await.expect(200);
    served.execution(1, "PROGRAM_COMPLETED").await;
    let position = served.get("/cs/1/position").await.expect(200).json();
    assert_eq!(position["machine"]["X"], 3.0);

    served.process.limit_file_bytes("unlimited:");
    until("the disk takes it again", async || {
        (served.put("/tools", &tool(3.0)).await.status == 204).then_some(())
    })
    .await;
    drop(served);
    let served = Served::start(&machine);
    let tools = served.get("/tools").await.expect(200).json();
    assert_eq!(tools["tools"][0]["radius"], 3.0);
}

#[tokio::test]
async fn the_journal_is_served_newest_lines_last() {
    let machine = Machine::new(&format!("[m_code.100]\nunhandled = \"wait\"\n{FREE_PORTS}"));
    let served = Served::start(&machine);
    served.load(1, 7, "M100 VA3\nM30\n").await;
    served.command(1, "start").await;
    served.execution(1, "WAIT").await;
    let events = async |query: &str| -> Vec<String> {
        let answer = served.get(&format!("/journal{query}")).await.expect(200).json();
        let lines = answer["lines"].as_array().unwrap().iter();
        lines
            .map(|line| line["event"].as_str().unwrap().to_owned())
            .collect()
    };
    until("the output stands in the journal", async || {
        let events = events("").await;
        (events.last().is_some_and(|event| event == "output")).then_some(())
    })
    .await;
    let newest = served.get("/journal?count=1").await.expect(200).json();
    assert_eq!(newest["lines"][0]["m"], 100);
    assert_eq!(newest["lines"][0]["params"]["A"], 3.0);
    let (all, older) = (events("?count=1000").await, events("?from=1&count=1000").await);
    assert_eq!(all[..all.len() - 1], older);
    for wrong in ["?count=0", "?count=1001", "?count=x"] {
        served.get(&format!("/journal{wrong}")).await.expect(400);
    }
}

#[tokio::test]
async fn an_operator_fails_an_output_that_another_owns_and_the_journal_keeps_it() {
    let machine = Machine::new(&format!("[m_code.100]\nunhandled = \"wait\"\n{FREE_PORTS}"));
    let served = Served::start(&machine);
    served.load(1, 7, "M100 VA3\nM30\n").await;
    served.command(1, "start").await;
    let state = served.execution(1, "WAIT").await;
    let path = |what: &str| format!("/cs/1/m_codes/{}/{what}", state["waiting_on"]["seq"]);
    let presence = json!({"online": true, "instance": "a", "expires_ms": 60_000});
    served.put("/handlers/h1", &presence).await.expect(204);
    let claim = json!({"boot_id": state["boot_id"], "handler_id": "h1", "instance": "a"});
    served.post(&path("claim"), &claim).await.expect(200);
    let mut fault = json!({
        "boot_id": state["boot_id"], "handler_id": "operator", "result": "fault", "code": 12, "text": "given up",
    });
    let refused = served.post(&path("reset"), &fault).await.expect(409).json();
    assert_eq!(refused["code"], "not_owner");
    fault["force"] = json!(true);
    served.post(&path("reset"), &fault).await.expect(200);
    let stopped = served.execution(1, "STOPPED").await;
    assert_eq!(stopped["reason"], "ALARM");
    let alarms = served.get("/alarms").await.expect(200).json();
    let alarm = &alarms["alarms"][0];
    assert_eq!(
        (&alarm["number"], &alarm["text"]),
        (&json!(10_012), &json!("given up"))
    );
    let forced = async || {
        let journal = served.get("/journal").await.expect(200).json();
        let lines = journal["lines"].as_array().unwrap().clone();
        lines
            .into_iter()
            .find(|line| line["event"] == "reset" && line["force"] == true)
    };
    let line = until("the forced reset stands in the journal", forced).await;
    assert_eq!(
        (&line["handler_id"], &line["result"], &line["code"], &line["m"]),
        (&json!("operator"), &json!("fault"), &json!(12), &json!(100))
    );
}
