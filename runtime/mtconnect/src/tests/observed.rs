//! Parts, the emergency stop, and tools that change.

use plc_protocol::types::io::{IoPoint, IoState};

use super::*;

#[test]
fn parts_are_those_that_the_runs_have_completed_since_the_start() {
    let mut feed = feed(Version::V2_3);
    let mut counts = |message: Message| {
        feed.apply_message(&message);
        let count = |sub_type| path_value(&feed, "PART_COUNT", sub_type);
        [None, Some("TARGET"), Some("REMAINING")].map(|sub_type| count(sub_type).unwrap())
    };
    assert_eq!(
        counts(run("a", 5, 2)),
        ["0", "5", "3"],
        "two were completed before"
    );
    assert_eq!(counts(run("a", 5, 3)), ["1", "5", "2"]);
    assert_eq!(counts(run("a", 5, 3)), ["1", "5", "2"]);
    assert_eq!(
        counts(run("a", 5, 5)),
        ["3", "5", "0"],
        "none is lost where a message is"
    );
    assert_eq!(counts(run("b", 1, 0)), ["3", "1", "1"]);
    assert_eq!(counts(run("b", 1, 1)), ["4", "1", "0"]);
    assert_eq!(counts(run("c", 2, 1)), ["5", "2", "1"]);
}

#[test]
fn the_emergency_stop_is_what_its_input_says_while_somebody_writes_that() {
    let settings = AgentSettings {
        version: Version::V2_3,
        emergency_stop: Some("e_stop_ok".into()),
    };
    let mut feed = DeviceFeed::new(
        Device::from_birth(&birth()),
        &settings,
        &"2026-01-01T00:00:00Z".into(),
    );
    let mut said = |name: &str, value: bool, lost: bool| {
        let state = IoState {
            value: value.into(),
            written: value.into(),
            owner: Some("plc".into()),
            lost,
            unknown: false,
            forced: None,
        };
        feed.apply_message(&message(Topic::Io(IoPoint::input(name)), Payload::Io(state)));
        value_of(&feed, "ctl_emergency_stop")
    };
    assert_eq!(
        said("door", true, false),
        None,
        "another input does not change the item"
    );
    assert_eq!(said("e_stop_ok", true, false).as_deref(), Some("ARMED"));
    assert_eq!(said("e_stop_ok", false, false).as_deref(), Some("TRIGGERED"));
    assert_eq!(
        said("e_stop_ok", false, true),
        None,
        "the input is not written any more"
    );
}

#[test]
fn asset_changes_with_a_new_or_changed_tool_and_is_removed_with_it() {
    let mut feed = feed(Version::V2_3);
    let tool = |id, length| ToolData {
        id,
        radius: 1.0,
        length,
    };
    let mut observed = |tools: Vec<ToolData>| {
        let from = feed.buffer.next();
        feed.tools(&tools, &"2026-01-01T00:00:02Z".into());
        let (observations, _) = feed.buffer.sample(from, usize::MAX, &|_| true);
        let told = observations.iter().map(|one| {
            let Value::Text(asset) = &one.value else {
                panic!("an asset has an id");
            };
            format!("{} {asset}", feed.device.items[one.item].kind)
        });
        told.collect::<Vec<_>>()
    };
    assert_eq!(
        observed(vec![tool(1, 10.0), tool(2, 20.0)]),
        [""; 0],
        "these were there"
    );
    assert_eq!(observed(vec![tool(1, 10.0), tool(2, 20.0)]), [""; 0]);
    assert_eq!(observed(vec![tool(1, 11.0), tool(2, 20.0)]), ["ASSET_CHANGED T1"]);
    assert_eq!(
        observed(vec![tool(1, 12.0), tool(2, 20.0)]),
        ["ASSET_CHANGED T1"],
        "again"
    );
    let expected = ["ASSET_CHANGED T3", "ASSET_REMOVED T2"];
    assert_eq!(observed(vec![tool(1, 12.0), tool(3, 5.0)]), expected);
}
