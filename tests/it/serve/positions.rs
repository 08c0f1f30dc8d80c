//! Simulated drives keep their position over starts of the runtime.

#![allow(clippy::print_stdout, reason = "what was measured")]

use std::fs;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use plc_protocol::types::Timestamp;
use serde_json::{Value, json};
use tandem_runtime::Config;

use super::data_folder::{place, rot, text_of_standing};
use crate::support::machine::{COORDINATE_SYSTEMS, MOTORS, Machine};
use crate::support::mqtt::Bus;
use crate::support::served::{FREE_PORTS, Served};
use crate::support::wait::until;

fn machine() -> Machine {
    Machine::new(FREE_PORTS)
}

/// A machine whose first motor has more keys.
fn machine_with(keys: &str) -> Machine {
    let motors = MOTORS.replacen("number = 1\n", &format!("number = 1\n{keys}\n"), 1);
    Machine::with_config(&format!(
        "[machine]\nname = \"test-1\"\nservo_late_ms = 1500\n{motors}{COORDINATE_SYSTEMS}{FREE_PORTS}"
    ))
}

async fn position(served: &Served, cs: u8) -> Value {
    served.get(&format!("/cs/{cs}/position")).await.expect(200).json()
}

async fn mdi(served: &Served, cs: u8, text: &str) {
    let path = format!("/cs/{cs}/mdi?wait=1");
    served.post(&path, &json!({"text": text})).await.expect(200);
}

/// Texts of the active alarms of a number.
async fn active(served: &Served, number: u16) -> Option<String> {
    let active = served.get("/alarms").await.expect(200).json();
    let alarms = active["alarms"].as_array().unwrap().iter();
    let texts = alarms.filter(|alarm| alarm["number"] == number);
    let texts: Vec<&str> = texts.filter_map(|alarm| alarm["text"].as_str()).collect();
    (!texts.is_empty()).then(|| texts.join("; "))
}

/// Ends the process and starts it again.
fn end(mut served: Served, signal: &str, machine: &Machine) -> Served {
    served.process.signal(signal);
    assert!(served.process.exit_code_within(Duration::from_secs(20)).is_some() || signal == "KILL");
    drop(served);
    Served::start(machine)
}

#[tokio::test]
async fn axes_at_rest_stand_exactly_where_they_stood_after_an_end_and_a_kill() {
    let machine = machine();
    let mut served = Served::start(&machine);
    mdi(&served, 1, "G90 G53 X70.1 Y20 Z-40.3").await;
    mdi(&served, 2, "G53 X33.3").await;
    let stood = [position(&served, 1).await, position(&served, 2).await];
    assert_eq!(stood[0]["machine"], json!({"X": 70.1, "Y": 20.0, "Z": -40.3}));
    for signal in ["KILL", "TERM"] {
        served = end(served, signal, &machine);
        for (cs, stood) in (1..).zip(&stood) {
            let stands = position(&served, cs).await;
            assert_eq!(
                stands["machine"], stood["machine"],
                "{signal}, coordinate system {cs}"
            );
            assert_eq!(stands["actual"], stood["machine"]);
            assert_eq!(stands["homed"], stood["homed"]);
        }
    }
    // and a motion begins there
    mdi(&served, 1, "G91 G01 X1 F600").await;
    let moved = position(&served, 1).await["machine"]["X"].as_f64().unwrap();
    assert!((moved - 71.1).abs() < 1e-9, "{moved}");
}

#[tokio::test]
async fn a_kill_as_soon_as_axes_are_heard_to_rest_moves_none_of_them() {
    let machine = machine();
    let mut served = Served::start(&machine);
    let motion = json!({"text": "G91 G01 X20 Y10 F6000"});
    for (command, rests) in [
        (None, "READY"),
        (Some("stop"), "STOPPED"),
        (Some("abort"), "STOPPED"),
        (Some("hold"), "FEED_HOLD"),
    ] {
        for round in 0..3 {
            served.post("/cs/1/mdi", &motion).await.expect(202);
            let begun = position(&served, 1).await["machine"]["X"].clone();
            until("a motion", async || {
                (position(&served, 1).await["machine"]["X"] != begun).then_some(())
            })
            .await;
            if let Some(command) = command {
                served
                    .post(&format!("/cs/1/{command}"), &json!({}))
                    .await
                    .expect(202);
            }
            until("a rest", async || {
                let state = served.state(1).await;
                (state["execution"] == rests && state["transition"].is_null()).then_some(())
            })
            .await;
            let stood = position(&served, 1).await["machine"].clone();
            served = end(served, "KILL", &machine);
            let stands = position(&served, 1).await["machine"].clone();
            assert_eq!(stands, stood, "{rests}, round {round}");
        }
    }
}

#[tokio::test]
async fn a_kill_when_a_rest_arrives_over_mqtt_keeps_the_target() {
    let machine = Machine::new(&format!("{FREE_PORTS}\n[m_code.100]\nunhandled = \"wait\"\n"));
    let mut served = Served::start(&machine);
    let jog = json!({"axis": "X", "velocity": 600.0, "distance": 5.0, "refresh_id": "pendant-1"});
    for (verb, args, rests, target) in [
        ("mdi", json!({"text": "G90 G53 X20.5"}), "READY", 20.5),
        ("jog", jog, "READY", 25.5),
        ("mdi", json!({"text": "G90 G53 X40.25 M100"}), "WAIT", 40.25),
    ] {
        let bus = Bus::connect(&served.broker, "test-1").await;
        let command = json!({"command_id": format!("{verb}-{target}"), "client_id": "pendant", "args": args});
        bus.publish(&format!("cs/1/command/{verb}"), &command).await;
        until(rests, async || {
            let states = bus.history.on("cs/1/state");
            let mut later = states.iter().skip_while(|state| state["execution"] != "ACTIVE");
            later
                .find(|state| state["execution"] == rests && state["transition"].is_null())
                .cloned()
        })
        .await;
        drop(bus);
        served = end(served, "KILL", &machine);
        let stands = position(&served, 1).await;
        assert_eq!(stands["machine"]["X"], target, "{verb}, {rests}");
    }
}

#[tokio::test]
async fn orderly_end_in_motion_keeps_the_axes_where_they_came_to_rest() {
    let machine = machine();
    let served = Served::start(&machine);
    let text = json!({"text": "G91 G01 X200 Y100 Z100 F1200"});
    served.post("/cs/1/mdi", &text).await.expect(202);
    until("a motion", async || {
        let x = position(&served, 1).await["machine"]["X"].as_f64().unwrap();
        (x > 5.0).then_some(())
    })
    .await;
    let served = end(served, "TERM", &machine);
    let stands = position(&served, 1).await["machine"].clone();
    let [x, y, z] = ["X", "Y", "Z"].map(|axis| stands[axis].as_f64().unwrap());
    assert!(
        x > 5.0 && (y - x / 2.0).abs() < 1e-6 && (z - x / 2.0).abs() < 1e-6,
        "{stands}"
    );
}

/// Greatest age of the stored position at a kill in motion, s.
const AGE_MAX_S: f64 = 0.1;

/// Delays of a thread that only sleeps, which the load of the computer causes. Each entry is the end of a sleep with its
/// delay.
#[derive(Clone, Default)]
struct Delays(Arc<Mutex<Vec<(Instant, Duration)>>>);

impl Delays {
    /// Measures until the last clone is dropped.
    fn measure() -> Self {
        const SLEEP: Duration = Duration::from_millis(5);
        let delays = Self::default();
        let sink = Arc::downgrade(&delays.0);
        std::thread::spawn(move || {
            while let Some(delays) = sink.upgrade() {
                let begun = Instant::now();
                std::thread::sleep(SLEEP);
                let late = begun.elapsed().saturating_sub(SLEEP);
                delays.lock().unwrap().push((Instant::now(), late));
            }
        });
        delays
    }

    /// Returns the longest delay in the last half second, s.
    fn longest_s(&self) -> f64 {
        let delays = self.0.lock().unwrap();
        let recent = delays.iter().rev();
        let recent = recent.take_while(|(at, _)| at.elapsed() < Duration::from_millis(500));
        recent.map(|(_, late)| late.as_secs_f64()).fold(0.0, f64::max)
    }
}

fn seconds(ts: &Value) -> f64 {
    let at = Timestamp(ts.as_str().unwrap().to_owned()).to_system_time();
    at.unwrap().duration_since(UNIX_EPOCH).unwrap().as_secs_f64()
}

/// Compares the position after a kill with the positions that were published before it, and their times.
#[tokio::test]
async fn p13_kill_in_motion_keeps_a_point_of_the_path_of_the_last_100_ms() {
    // 20 mm/s along the path, which has the direction 2, 1, 1
    const X_MM_S: f64 = 20.0 * 2.0 / 2.449_489_742_783_178;
    let machine = machine();
    let mut served = Served::start(&machine);
    let delays = Delays::measure();
    for round in 0..5_u32 {
        let begins = position(&served, 1).await["machine"].clone();
        let [x0, y0, z0] = ["X", "Y", "Z"].map(|axis| begins[axis].as_f64().unwrap());
        let bus = Bus::connect(&served.broker, "test-1").await;
        let text = json!({"text": "G91 G01 X60 Y30 Z30 F1200"});
        served.post("/cs/1/mdi", &text).await.expect(202);
        // moments between two published positions
        let far = x0 + 10.0 + 0.4 * f64::from(round);
        until("a motion at constant speed", async || {
            let positions = bus.history.on("cs/1/position");
            let last = positions.last()?["machine"]["X"].as_f64()?;
            (last > far).then_some(())
        })
        .await;
        served.process.signal("KILL");
        let killed_s = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .unwrap()
            .as_secs_f64();
        let late_s = delays.longest_s();
        let published = bus.history.on("cs/1/position").last().unwrap().clone();
        drop(bus);
        served = end(served, "KILL", &machine);
        let stands = position(&served, 1).await;
        let [x, y, z] = ["X", "Y", "Z"].map(|axis| stands["machine"][axis].as_f64().unwrap());
        let is_on_path = |at: f64| (at - (x - x0) / 2.0).abs() < 1e-6;
        assert!(is_on_path(y - y0) && is_on_path(z - z0), "on the path: {stands}");
        assert_eq!(stands["homed"], json!({"X": true, "Y": true, "Z": true}));
        let last_x = published["machine"]["X"].as_f64().unwrap();
        let stored_s = seconds(&published["ts"]) + (x - last_x) / X_MM_S;
        let age_s = killed_s - stored_s;
        println!("round {round}: {age_s:.3} s before the kill, delay of the computer {late_s:.3} s");
        let allowed = -AGE_MAX_S / 2.0 - late_s..=AGE_MAX_S + late_s;
        assert!(allowed.contains(&age_s), "{age_s} s, not within {allowed:?}");
    }
}

#[tokio::test]
async fn incremental_encoders_are_homed_by_the_reset_after_alarm_208() {
    let machine = machine_with("encoder = \"incremental\"\nstart_at = 50.0");
    let mut served = Served::start(&machine);
    for x in [50.0, 60.0] {
        let stands = position(&served, 1).await;
        assert_eq!(
            (&stands["machine"]["X"], &stands["homed"]["X"]),
            (&json!(x), &json!(false))
        );
        assert_eq!(stands["homed"]["Y"], true);
        let text = json!({"text": format!("G53 X{}", x + 10.0)});
        served.post("/cs/1/mdi", &text).await.expect(202);
        until("alarm 208", async || active(&served, 208).await).await;
        served.command(1, "reset").await;
        until("a homed axis", async || {
            (position(&served, 1).await["homed"]["X"] == true).then_some(())
        })
        .await;
        mdi(&served, 1, &format!("G53 X{}", x + 10.0)).await;
        assert_eq!(position(&served, 1).await["machine"]["X"], x + 10.0);
        tokio::time::sleep(Duration::from_millis(500)).await;
        served = end(served, "KILL", &machine);
    }
}

#[tokio::test]
async fn a_lost_position_is_not_homed_and_never_0_without_a_message() {
    let machine = machine();
    let served = Served::start(&machine);
    mdi(&served, 1, "G53 X70.125").await;
    let served_again = end(served, "TERM", &machine);
    drop(end(served_again, "TERM", &machine));
    let store = place(&machine, "state.redb");
    let bytes = fs::read(&store).unwrap();
    let text = b"{\"1\":70.125";
    let places: Vec<usize> = (0..bytes.len() - text.len())
        .filter(|at| bytes[*at..].starts_with(text))
        .collect();
    assert!(!places.is_empty());
    for at in places {
        rot(&store, at + text.len() - 1);
    }
    let served = Served::start(&machine);
    let stands = position(&served, 1).await;
    assert_eq!(stands["homed"], json!({"X": false, "Y": false, "Z": false}));
    until("a warning that names it", async || {
        let text = active(&served, 410).await?;
        text.contains("the motor positions of coordinate system 1 are lost")
            .then_some(())
    })
    .await;
    // a restart before the homing loses it again, and the homing ends that
    let served = end(served, "TERM", &machine);
    assert_eq!(position(&served, 1).await["homed"]["X"], false);
    let text = json!({"text": "G53 X1"});
    served.post("/cs/1/mdi", &text).await.expect(202);
    until("alarm 208", async || active(&served, 208).await).await;
    served.command(1, "reset").await;
    mdi(&served, 1, "G53 X1").await;
    let served = end(served, "TERM", &machine);
    let stands = position(&served, 1).await;
    assert_eq!(
        (&stands["machine"]["X"], &stands["homed"]["X"]),
        (&json!(1.0), &json!(true))
    );
}

#[tokio::test]
async fn an_axis_outside_changed_soft_limits_stands_there_with_a_warning() {
    let machine = machine();
    let served = Served::start(&machine);
    mdi(&served, 1, "G53 X70").await;
    let mut served = served;
    served.process.signal("TERM");
    assert_eq!(served.process.exit_code_within(Duration::from_secs(20)), Some(0));
    drop(served);
    let config = fs::read_to_string(machine.config()).unwrap();
    machine.write(
        "tandem.toml",
        &config.replace("[-100.0, 300.0]", "[-100.0, 50.0]"),
    );
    let served = Served::start(&machine);
    assert_eq!(position(&served, 1).await["machine"]["X"], 70.0);
    let text = text_of_standing(&served, 102).await;
    assert!(
        text.contains("axis X is at 70, outside its soft limits of -100 to 50"),
        "{text}"
    );
}

#[test]
fn start_at_outside_soft_limits_is_refused_and_defaults_within_them() {
    let of = |keys: &str| {
        let machine = machine_with(keys);
        let text = fs::read_to_string(machine.config()).unwrap();
        let text = text.replace("[-100.0, 300.0]", "[10.0, 300.0]");
        Config::from_toml(&text, machine.folder()).unwrap().resolve()
    };
    let refused = of("start_at = 5.0").unwrap_err().to_string();
    assert!(
        refused.contains("start_at = 5: write a position within soft_limits, 10 to 300"),
        "{refused}"
    );
    for (keys, at) in [("", 10.0), ("start_at = 20.5", 20.5)] {
        let machine = of(keys).unwrap();
        let motor = machine.coordinate_systems[0].settings.motors[0].as_ref().unwrap();
        assert_eq!(motor.start_at, at);
    }
}
