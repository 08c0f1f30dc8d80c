//! Two coordinate systems at the same time, each with its own M-code queue.

use serde_json::json;

use super::served;
use crate::support::machine::Machine;
use crate::support::mqtt::Bus;
use crate::support::served::{FREE_PORTS, Served};

#[tokio::test]
async fn a_program_is_rehearsed_by_the_coordinate_system_that_names_it() {
    // it belongs to the last coordinate system of the configuration, the second one
    let machine = Machine::new(&format!("programs = {{ 60 = \"two.nc\" }}\n{FREE_PORTS}"));
    machine.write("two.nc", "G54 G00 X2\nM30\n");
    let served = Served::start(&machine);
    let rehearsal = served.get("/programs/60/rehearsal").await.expect(200).json();
    assert_eq!(rehearsal["axes"]["X"]["motor"], 5, "{rehearsal}");
}

#[tokio::test]
async fn both_coordinate_systems_run_and_wait_at_once_with_own_queues() {
    let (_machine, served) = served();
    let bus = Bus::connect(&served.broker, "test-1").await;
    served.load(1, 50, "G00 X20\nM100 VA1\nG00 X0\nM30\n").await;
    served.load(2, 60, "G00 X30\nM100 VA2\nG00 X0\nM30\n").await;
    served.command(1, "start").await;
    served.command(2, "start").await;
    let (first, second) = (
        served.execution(1, "WAIT").await,
        served.execution(2, "WAIT").await,
    );
    assert_eq!((&first["program"], &second["program"]), (&json!(50), &json!(60)));
    for (cs, params) in [(1, json!({"A": 1.0})), (2, json!({"A": 2.0}))] {
        let output = bus
            .history
            .find(&format!("cs/{cs}/m_code/100/output"), |_| true)
            .await;
        assert_eq!(output["params"], params);
        let pending = served.get(&format!("/cs/{cs}/m_codes")).await.expect(200).json();
        assert_eq!(pending["outputs"].as_array().unwrap().len(), 1);
    }
    // One reset frees its own coordinate system and no other.
    served.reset_output(2, "test", false).await.expect(200);
    served.execution(2, "PROGRAM_COMPLETED").await;
    let state = served.state(1).await;
    assert_eq!(
        (&state["execution"], &state["waiting_on"]["m"]),
        (&json!("WAIT"), &json!(100))
    );
    served.reset_output(1, "test", false).await.expect(200);
    served.execution(1, "PROGRAM_COMPLETED").await;
}

#[tokio::test]
async fn d32_several_outputs_are_pending_together_and_m30_waits_for_all() {
    let (_machine, served) = served();
    served.load(1, 50, "M20\nM100\nM30\n").await;
    served.command(1, "start").await;
    let state = served
        .state_where(1, "M100 is waited for", |state| state["waiting_on"]["m"] == 100)
        .await;
    let pending = served.get("/cs/1/m_codes").await.expect(200).json();
    let m: Vec<_> = pending["outputs"]
        .as_array()
        .unwrap()
        .iter()
        .map(|output| output["m"].as_u64())
        .collect();
    assert_eq!(m, [Some(20), Some(100)]);
    served.reset_output(1, "test", false).await.expect(200);
    let state = served
        .state_where(1, "M20 is waited for", |now| {
            now["execution"] == "WAIT" && now["waiting_on"]["seq"] != state["waiting_on"]["seq"]
        })
        .await;
    assert_eq!(state["waiting_on"]["m"], 20);
    served.reset_output(1, "test", false).await.expect(200);
    served.execution(1, "PROGRAM_COMPLETED").await;
}

#[tokio::test]
async fn an_alarm_of_one_coordinate_system_leaves_the_other_running() {
    let (_machine, served) = served();
    served.load(1, 50, "G00 X900\nM30\n").await;
    served.load(2, 60, "M100\nM30\n").await;
    served.command(2, "start").await;
    served.execution(2, "WAIT").await;
    served.command(1, "start").await;
    served.execution(1, "STOPPED").await;
    assert_eq!(served.state(2).await["execution"], "WAIT");
}
