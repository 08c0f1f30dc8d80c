//! A scan program that reads and writes the machine, each transport.

use std::time::Duration;

use plc_api::scan::{Image, Reads, ScanProgram};
use plc_api::{Execution, SequenceProgram};
use plc_protocol::types::request::OverrideChange;

use super::{Reached, in_process, over_mosquitto, over_rest, over_the_embedded_broker};
use crate::support::wait::{until, within};

/// P10 releases the start, M100 is reset at X5, and P21 is set to the number of tools in VA, twice.
struct Cell;

impl ScanProgram for Cell {
    fn reads(&self) -> Reads {
        Reads::default().position(1).p(10, 1)
    }

    fn scan(&mut self, image: &mut Image) {
        let released = image.p(10) == Some(1.0);
        image.set_start_lock(1, !released, "P10 is not 1");
        let feed = Some(50.0);
        image.set_overrides(
            1,
            OverrideChange {
                feed,
                ..OverrideChange::default()
            },
        );
        image.set_optional_skip(1, 3, true);
        let (Some(tool), Some(position)) = (
            image.params(1, 100).and_then(|params| params.a),
            image.position(1),
        ) else {
            return;
        };
        if (position.machine["X"] - 5.0).abs() < 1e-9 {
            image.set_p(21, 2.0 * tool);
            image.select_tool(1, 7);
            image.reset(1, 100);
        }
    }
}

async fn a_scan_program_reads_and_writes_the_machine(reached: &Reached) {
    let plc = reached.plc.clone();
    let serving = plc.clone();
    let program = SequenceProgram::new().scan(100, Duration::from_millis(20), Cell);
    let scanning = tokio::spawn(async move { program.run(&serving).await });
    let system = plc.coordinate_system(1);
    until("the start lock is on", async || {
        let lock = system.start_lock().await.ok()?;
        (lock.value && lock.text == "P10 is not 1").then_some(())
    })
    .await;
    within("load", system.load(50)).await.expect("load");
    let refused = within("start", system.start()).await.expect_err("a start lock");
    assert!(refused.to_string().contains("P10 is not 1"), "{refused}");
    plc.variables().set(10, 1.0).await.expect("P10");
    until("the start lock is off", async || {
        (!system.start_lock().await.ok()?.value).then_some(())
    })
    .await;
    within("start", system.start()).await.expect("start");
    let completed = system.wait_until(Execution::ProgramCompleted);
    let state = within("completed", completed).await.expect("a state");
    assert_eq!(state.optional_skip, [3]);
    assert_eq!(system.overrides().await.expect("overrides").feed, 50.0);
    assert_eq!(plc.variables().get(21).await.expect("P21"), 14.0);
    until("the tool", async || {
        (system.tool().await.ok()?.id == 7).then_some(())
    })
    .await;
    scanning.abort();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_scan_program_reads_and_writes_the_machine_over_every_transport() {
    let reached = in_process().await;
    a_scan_program_reads_and_writes_the_machine(&reached).await;
    reached.end().await;
    let reached = over_the_embedded_broker().await;
    a_scan_program_reads_and_writes_the_machine(&reached).await;
    let (reached, _broker) = over_mosquitto().await;
    a_scan_program_reads_and_writes_the_machine(&reached).await;
    let reached = over_rest().await;
    a_scan_program_reads_and_writes_the_machine(&reached).await;
}
