//! Programs follow the changes of variables, tools and offsets.

use std::time::Duration;

use plc_api::fake::FakePort;
use plc_api::{Error, Plc};
use plc_protocol::types::data::{ToolData, VariableArea};

fn published() -> (FakePort, Plc) {
    let fake = FakePort::new([1, 2]);
    fake.publish_variables(VariableArea::Global, 200, 4);
    fake.publish_variables(VariableArea::CoordinateSystem(2), 10, 1);
    let plc = fake.plc();
    (fake, plc)
}

#[tokio::test]
async fn variables_are_published_initially_and_after_each_change() {
    let (_fake, plc) = published();
    let mut changes = plc.variables().changes(201, 2).await.unwrap();
    assert_eq!(changes.next().await, Some(vec![0.0, 0.0]));
    plc.variables().write(200, &[9.0]).await.unwrap(); // another variable
    plc.variables().write(202, &[f64::NAN]).await.unwrap();
    let bits = |values: Option<Vec<f64>>| values.unwrap().into_iter().map(f64::to_bits).collect::<Vec<_>>();
    assert_eq!(bits(changes.next().await), bits(Some(vec![0.0, f64::NAN])));
    plc.variables().write(200, &[8.0]).await.unwrap(); // NaN has not changed
    plc.variables().write(201, &[1.0, 2.0]).await.unwrap();
    assert_eq!(changes.next().await, Some(vec![1.0, 2.0]));
}

#[tokio::test]
async fn of_what_changes_faster_than_it_is_read_the_latest_is_published() {
    let (_fake, plc) = published();
    let mut changes = plc.variables().changes(200, 1).await.unwrap();
    for value in 1..=9 {
        plc.variables().set(200, f64::from(value)).await.unwrap();
    }
    assert_eq!(changes.next().await, Some(vec![9.0]));
}

#[tokio::test]
async fn variables_that_are_not_published_are_refused_with_what_to_write() {
    let (_fake, plc) = published();
    let of = |cs| plc.coordinate_system(cs).variables();
    for (variables, from, count, says) in [
        (
            plc.variables(),
            203,
            2,
            "2 variables from P203 on are not published",
        ),
        (plc.variables(), 199, 1, "from = \"P199\", count = 1"),
        (plc.variables(), u32::MAX, 2, "not published"),
        (plc.variables(), 0, u32::MAX, "not published"),
        (of(1), 10, 1, "Q10 is not published by this machine: name them"),
    ] {
        let refused = variables.changes(from, count).await.unwrap_err();
        assert!(
            matches!(&refused, Error::Refused(refusal) if refusal.text.contains(says)),
            "{refused}"
        );
    }
    assert!(of(2).changes(10, 1).await.is_ok());
}

#[tokio::test]
async fn a_value_is_waited_for_whoever_writes_it() {
    let (fake, plc) = published();
    let waits = tokio::spawn(async move { plc.variables().wait_until(203, |value| value >= 2.0).await });
    for value in [1.0, 3.0] {
        fake.advance(Duration::from_millis(10)).await;
        assert!(!waits.is_finished());
        fake.plc().variables().set(203, value).await.unwrap();
    }
    assert_eq!(waits.await.unwrap().unwrap().to_bits(), 3.0_f64.to_bits());
}

#[tokio::test]
async fn tools_and_work_offsets_are_published_each_time_that_they_change() {
    let (_fake, plc) = published();
    let loader = plc.coordinate_system(2);
    let (mut tools, mut offsets) = (plc.tool_changes(), loader.work_offset_changes());
    assert_eq!(tools.next().await, Some(Vec::new()));
    assert!(offsets.next().await.unwrap().is_empty());
    let tool = ToolData {
        id: 3,
        radius: 2.0,
        length: 41.25,
    };
    plc.set_tool(tool).await.unwrap();
    assert_eq!(tools.next().await, Some(vec![tool]));
    plc.coordinate_system(1)
        .set_work_offset("G54", [("X", 1.0)])
        .await
        .unwrap();
    loader.set_work_offset("G55", [("X", 12.5)]).await.unwrap();
    assert_eq!(offsets.next().await.unwrap()["G55"].get("X"), Some(&12.5));
}
