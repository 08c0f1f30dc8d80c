//! A runtime that gets no processor time while it moves.

use std::time::Duration;

use futures_util::SinkExt;
use serde_json::json;
use tokio_tungstenite::tungstenite::Message;

use super::served;
use crate::support::mqtt::Bus;
use crate::support::wait::until;

#[tokio::test]
async fn suspended_process_holds_on_its_path_and_counts_missed_cycles() {
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

#[tokio::test]
async fn the_heartbeat_is_published_while_the_servo_is_alive_and_stops_with_it() {
    let (_machine, served) = served();
    let watch = served.watch(&["heartbeat"]).await;
    let cycles = || {
        watch
            .history
            .on("heartbeat")
            .iter()
            .map(|beat| beat["cycle"].as_u64())
            .collect::<Vec<_>>()
    };
    until("heartbeats", async || (cycles().len() > 20).then_some(())).await;
    assert!(cycles().is_sorted_by(|a, b| a < b), "{:?}", cycles());
    served.process.signal("STOP");
    tokio::time::sleep(Duration::from_millis(300)).await;
    let stopped = cycles().len();
    tokio::time::sleep(Duration::from_secs(1)).await;
    assert_eq!(cycles().len(), stopped);
    served.process.signal("CONT");
    until("heartbeats again", async || {
        (cycles().len() > stopped + 5).then_some(())
    })
    .await;
    let now = served.get("/heartbeat").await.expect(200).json();
    assert!(now["cycle"].as_u64() > cycles()[0]);
}

#[tokio::test]
async fn silent_watched_client_holds_the_run_over_every_transport() {
    let (_machine, served) = served();
    let bus = Bus::connect(&served.broker, "test-1").await;
    let url = format!("ws://{}/api/v1/ws", served.http);
    let (mut socket, _) = tokio_tungstenite::connect_async(url).await.expect("a WebSocket");
    served.load(1, 50, "G04 X600\nM30\n").await;
    served.command(1, "start").await;
    for (n, transport) in ["REST", "MQTT", "WebSocket"].into_iter().enumerate() {
        for _ in 0..4 {
            match transport {
                "REST" => {
                    let answer = served
                        .put("/clients/panel/heartbeat", &json!({"ttl_ms": 1000}))
                        .await;
                    answer.expect(204);
                }
                "MQTT" => {
                    bus.publish("client/cell/heartbeat", &json!({"ttl_ms": 1000, "cs": 1}))
                        .await;
                }
                _ => {
                    let beat = json!({"heartbeat": {"id": "page", "ttl_ms": 1000}});
                    socket
                        .send(Message::text(beat.to_string()))
                        .await
                        .expect("a frame");
                }
            }
            tokio::time::sleep(Duration::from_millis(300)).await;
            assert_eq!(served.state(1).await["execution"], "ACTIVE", "{transport}");
        }
        let held = served.execution(1, "FEED_HOLD").await;
        assert_eq!(held["reason"], "CLIENT_LOST", "{transport}: {held}");
        let alarms = served.get("/alarms").await.expect(200).json();
        assert_eq!(alarms["alarms"][n]["number"], 421, "{transport}: {alarms}");
        served.command(1, "resume").await;
    }
    let refused = served
        .put("/clients/panel/heartbeat", &json!({"ttl_ms": 10}))
        .await;
    assert_eq!(refused.expect(400).json()["code"], "invalid");
}
