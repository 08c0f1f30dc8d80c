//! On each transport, the same calls set every input and read every value.

use plc_api::{CoordinateSystem, Error, Execution, Plc};
use plc_protocol::types::data::ToolData;
use plc_protocol::types::io::IoValue;
use plc_protocol::types::request::{OverrideChange, RefusalCode};
use plc_protocol::types::state::{Lock, Overrides, SpindleDirection};

use super::{Reached, in_process, over_mosquitto, over_rest, over_the_embedded_broker};
use crate::support::wait::{until, within};

async fn inputs_are_set_and_read_back(system: &CoordinateSystem) {
    within("skip", system.set_optional_skip(31, true))
        .await
        .expect("skip");
    within("stop", system.set_optional_stop(true))
        .await
        .expect("stop");
    within("block", system.set_single_block(true))
        .await
        .expect("block");
    within("dry run", system.set_dry_run(true))
        .await
        .expect("dry run");
    until("the state shows the inputs", async || {
        let state = system.state().await.ok()?;
        let inputs = state.optional_stop && state.single_block && state.dry_run;
        (inputs && state.optional_skip == [31]).then_some(())
    })
    .await;
    let skip = within("skip", system.optional_skip()).await.expect("skip");
    assert_eq!((skip.requested, skip.effective), (vec![31], vec![31]));
    within("block", system.set_single_block(false))
        .await
        .expect("block");
    within("dry run", system.set_dry_run(false))
        .await
        .expect("dry run");

    let change = OverrideChange {
        feed: Some(30.0),
        rapid: None,
        spindle: Some(50.0),
    };
    within("overrides", system.set_overrides(change))
        .await
        .expect("overrides");
    let overrides = Overrides {
        feed: 30.0,
        rapid: 100.0,
        spindle: 50.0,
    };
    until("overrides", async || {
        (system.overrides().await.ok()? == overrides).then_some(())
    })
    .await;
    let change = OverrideChange {
        feed: Some(100.0),
        rapid: None,
        spindle: Some(100.0),
    };
    within("overrides", system.set_overrides(change))
        .await
        .expect("overrides");
}

async fn locks_are_set_and_read_back_with_their_words(system: &CoordinateSystem) {
    within("interlock", system.set_interlock(true, "the door is open"))
        .await
        .expect("interlock");
    within("start lock", system.set_start_lock(true, "no pressure"))
        .await
        .expect("start lock");
    let is_on = |lock: &Lock, text: &str| lock.value && lock.text == text;
    until("the locks are on, with their words", async || {
        let interlock = is_on(&system.interlock().await.ok()?, "the door is open");
        (interlock && is_on(&system.start_lock().await.ok()?, "no pressure")).then_some(())
    })
    .await;
    within("interlock", system.set_interlock(false, ""))
        .await
        .expect("interlock");
    within("start lock", system.set_start_lock(false, ""))
        .await
        .expect("start lock");
    until("the locks are off", async || {
        let interlock = system.interlock().await.ok()?.value;
        (!interlock && !system.start_lock().await.ok()?.value).then_some(())
    })
    .await;
}

async fn inputs_and_outputs_of_the_plant_are_written_forced_and_read(plc: &Plc) {
    let (level, lamp) = (plc.io_in("level"), plc.io_out("lamp"));
    let begin = until("the level", async || level.state().await.ok()).await;
    assert_eq!(
        (begin.value, begin.owner),
        (0.0.into(), None),
        "safe, and nobody's"
    );
    within("level", level.set(12.5)).await.expect("level");
    within("lamp", lamp.set(true)).await.expect("lamp");
    let read = within("level", level.wait_until(|litres| litres > 10.0)).await;
    assert_eq!(read.expect("a level"), IoValue::from(12.5));
    within("lamp", lamp.wait_until(IoValue::is_on))
        .await
        .expect("lamp");
    within("force", lamp.force(false)).await.expect("force");
    let forced = until("the mark of the force", async || {
        let state = lamp.state().await.ok()?;
        state.forced.is_some().then_some(state)
    })
    .await;
    assert_eq!((forced.value, forced.written), (false.into(), true.into()));
    within("release", lamp.release()).await.expect("release");
    until("the written value", async || {
        let state = lamp.state().await.ok()?;
        (state.forced.is_none() && state.value.is_on()).then_some(())
    })
    .await;
}

async fn variables_tools_and_offsets_are_published(plc: &Plc, system: &CoordinateSystem) {
    let (mut tools, mut offsets) = (plc.tool_changes(), system.work_offset_changes());
    within("tools", tools.next()).await.expect("tools");
    let now = within("offsets", offsets.next()).await.expect("offsets");
    assert_eq!(now["G54"].get("X"), Some(&10.0));
    let variables = plc.variables();
    let mut changes = within("P300", variables.changes(300, 2))
        .await
        .expect("they are published");
    assert_eq!(within("values", changes.next()).await, Some(vec![0.0, 0.0]));
    within("P301", variables.set(301, 4.5)).await.expect("P301");
    assert_eq!(within("values", changes.next()).await, Some(vec![0.0, 4.5]));
    let read = within("P301", variables.wait_until(301, |value| value > 4.0)).await;
    assert_eq!(read.ok(), Some(4.5));
    let refused = within("P302", variables.changes(301, 2)).await.err();
    assert!(
        matches!(&refused, Some(Error::Refused(refusal)) if refusal.code == RefusalCode::NotFound),
        "{refused:?}"
    );
}

async fn spindle_and_tool_are_commanded_and_read(system: &CoordinateSystem) {
    within("spindle", system.set_spindle(SpindleDirection::Ccw, 500.0))
        .await
        .expect("spindle");
    until("the spindle turns", async || {
        let spindle = system.spindle().await.ok()?;
        let turns = spindle.direction == SpindleDirection::Ccw
            && (spindle.rpm - 500.0).abs() < 1e-9
            && (spindle.actual_rpm + 500.0).abs() < 1e-6;
        (turns && (system.position().await.ok()?.spindle_rpm + 500.0).abs() < 1e-6).then_some(())
    })
    .await;
    within("spindle", system.set_spindle(SpindleDirection::Stop, 0.0))
        .await
        .expect("spindle");
    within("tool", system.select_tool(9)).await.expect("tool");
    until("the tool", async || {
        (system.tool().await.ok()?.id == 9).then_some(())
    })
    .await;
}

async fn the_machine_is_moved_by_hand_and_its_readings_follow(plc: &Plc, system: &CoordinateSystem) {
    within("skip input", plc.set_skip_input(1, true))
        .await
        .expect("skip input");
    within("mdi", system.mdi("G90 G31 X3")).await.expect("mdi");
    let captured = until("captured", async || {
        let captured = system.captured().await.ok()?;
        captured.run_id.is_some().then_some(captured)
    })
    .await;
    assert_eq!(
        (captured.motors, captured.captured),
        (vec![1, 2, 3], vec![true, false, false])
    );
    assert!(captured.positions[0] < 3.0, "{:?}", captured.positions);
    within("skip input", plc.set_skip_input(1, false))
        .await
        .expect("skip input");
    within("mdi", system.mdi("G55 G91 G01 X2 F1200"))
        .await
        .expect("mdi");
    until("modal codes", async || {
        let modal = system.modal().await.ok()?;
        let g = |group: &str| modal.g.get(group).cloned().unwrap_or_default();
        let is_so = g("01") == "G01" && modal.work_offset.as_deref() == Some("G55");
        (is_so && (modal.f - 1200.0).abs() < 1e-9).then_some(())
    })
    .await;
    within("home", system.home(&['X'])).await.expect("home");
    within("jog", system.jog('X', 6000.0, Some(1.5), "a"))
        .await
        .expect("jog");
    until("X is at 1.5 mm", async || {
        let position = system.position().await.ok()?;
        ((position.machine["X"] - 1.5).abs() < 1e-9 && position.feedrate.abs() < 1e-9).then_some(())
    })
    .await;
    let ready = within("READY", system.wait_until(Execution::Ready))
        .await
        .expect("a state");
    assert_eq!(ready.waiting_on, None);
    until("the place in the program", async || system.program().await.ok()).await;
}

/// Over MQTT there are no topics for these requests: they are refused for this reason.
async fn tools_offsets_and_programs(reached: &Reached, carries: bool) {
    let (plc, system) = (&reached.plc, reached.plc.coordinate_system(1));
    let tool = ToolData {
        id: 4,
        radius: 1.5,
        length: 30.0,
    };
    let set = within("tool", plc.set_tool(tool)).await;
    let offset = within("offset", system.set_work_offset("G54", [("Y", 12.5)])).await;
    if carries {
        set.expect("a tool");
        offset.expect("an offset");
        assert_eq!(within("tools", plc.tools()).await.expect("tools"), [tool]);
        let offsets = within("offsets", system.work_offsets()).await.expect("offsets");
        assert_eq!((offsets["G54"]["X"], offsets["G54"]["Y"]), (10.0, 12.5));
        assert_eq!(
            within("last run", system.last_run()).await.expect("last run"),
            None
        );
        let programs = within("programs", plc.programs()).await.expect("programs");
        let numbers: Vec<u16> = programs.iter().map(|program| program.number).collect();
        assert_eq!(numbers, [50, 51, 52]);
        return;
    }
    for refused in [
        set.err(),
        offset.err(),
        plc.tools().await.err(),
        system.last_run().await.err(),
    ] {
        assert!(
            matches!(&refused, Some(Error::Refused(refusal)) if refusal.code == RefusalCode::NotSupported),
            "{refused:?}"
        );
    }
}

async fn everything(reached: &Reached, carries_tables: bool) {
    let system = reached.plc.coordinate_system(1);
    inputs_are_set_and_read_back(&system).await;
    locks_are_set_and_read_back_with_their_words(&system).await;
    inputs_and_outputs_of_the_plant_are_written_forced_and_read(&reached.plc).await;
    variables_tools_and_offsets_are_published(&reached.plc, &system).await;
    spindle_and_tool_are_commanded_and_read(&system).await;
    tools_offsets_and_programs(reached, carries_tables).await;
    the_machine_is_moved_by_hand_and_its_readings_follow(&reached.plc, &system).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn in_process_every_input_is_set_and_every_reading_read() {
    let reached = in_process().await;
    everything(&reached, true).await;
    reached.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn over_the_embedded_broker_every_input_is_set_and_every_reading_read() {
    everything(&over_the_embedded_broker().await, false).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn over_mosquitto_every_input_is_set_and_every_reading_read() {
    let (reached, _broker) = over_mosquitto().await;
    everything(&reached, false).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn over_rest_every_input_is_set_and_every_reading_read() {
    everything(&over_rest().await, true).await;
}
