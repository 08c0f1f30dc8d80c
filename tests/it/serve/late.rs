//! A runtime that gets no processor time while it moves.

use std::time::Duration;

use serde_json::json;

use super::served;
use crate::support::wait::until;

#[tokio::test]
async fn a_process_that_is_suspended_in_motion_holds_on_its_path_and_counts_each_missed_cycle() {
    let (_machine, served) = served();
    served.load(1, 50, "G01 X200 Y20 F6000\nM30\n").await;
    served.command(1, "start").await;
    let position = async || {
        let position = served.get("/cs/1/position").await.expect(200).json();
        let of = |axis: &str| position["work"][axis].as_f64().expect("a position");
        (of("X"), of("Y"))
    };
    let (before, _) = until("motion", async || {
        Some(position().await).filter(|(x, _)| *x > 20.0)
    })
    .await;
    served.process.signal("STOP");
    tokio::time::sleep(Duration::from_secs(2)).await;
    served.process.signal("CONT");
    let held = served.execution(1, "FEED_HOLD").await;
    assert_eq!(held["reason"], "SERVO_LATE", "{held}");
    let (x, y) = position().await;
    assert!(
        x >= before && x < 160.0,
        "2 s at 100 mm/s are not made up for: {before} {x}"
    );
    assert!((y - x / 10.0).abs() < 1e-9, "X{x} Y{y} is off the path");
    let alarms = served.get("/alarms").await.expect(200).json();
    let warning = &alarms["alarms"][0];
    assert_eq!(
        (&warning["number"], &warning["severity"]),
        (&json!(209), &json!("warning")),
        "{alarms}"
    );
    let metrics = served.get("/metrics").await.expect(200);
    let missed = metrics
        .body
        .lines()
        .find_map(|line| line.strip_prefix("tandem_servo_missed_cycles_total "));
    let missed: u64 = missed.expect("the counter").parse().expect("a number");
    assert!((1_900..10_000).contains(&missed), "{missed} of about 2000");
    served.command(1, "resume").await;
    served.execution(1, "PROGRAM_COMPLETED").await;
    assert_eq!(position().await, (200.0, 20.0));
}
