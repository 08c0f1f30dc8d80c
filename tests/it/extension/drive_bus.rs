//! A custom bus to drives costs one file: an implementation of `DriveBus`, and a factory that passes it to
//! the runtime.

use std::sync::atomic::{AtomicBool, AtomicU16, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use plc_api::{Execution, Plc};
use plc_protocol::types::message::Payload;
use plc_protocol::types::request::typed;
use plc_protocol::types::state::Reason;
use plc_protocol::types::topic::Topic;
use tandem_runtime::hardware::{
    Command, CoordinateSystemSettings, CycleResult, DriveBus, Feedback, Hardware, HardwareFactory,
};
use tandem_runtime::{Config, Runtime};

use super::costs;
use crate::support::machine::{Machine, bench};

const PROGRAM: &str = "G00 X40 Y10\nG01 Z-5 F3000\nG500\nX50 Y20\nX60 Y10\nG02 X70 Y20 I10\nM30\n";

/// Drives at their commanded positions; a fault of the first motor can be injected.
#[derive(Debug, Default)]
struct Following {
    fault: Arc<AtomicU16>,
}

impl DriveBus for Following {
    fn exchange(&mut self, commands: &[Command], feedback: &mut [Feedback]) -> CycleResult {
        for (command, feedback) in commands.iter().zip(&mut *feedback) {
            feedback.is_enabled = command.enable;
            if command.enable {
                feedback.position = command.position;
            }
        }
        if commands[0].clear_fault {
            self.fault.store(0, Ordering::Relaxed);
        }
        feedback[0].fault = self.fault.load(Ordering::Relaxed);
        CycleResult::OnTime
    }
}

/// Drives with absolute encoders, all at this position except that of the fourth motor.
fn standing_at(position: f64) -> HardwareFactory {
    Box::new(move |systems: &[&CoordinateSystemSettings]| {
        let motors = systems.iter().flat_map(|system| system.motors.iter().flatten());
        let at_start =
            motors.map(|motor| Feedback::following(if motor.number == 5 { 0.0 } else { position }));
        Ok(Hardware {
            bus: Box::new(Following::default()),
            at_start: at_start.collect(),
            spindles: vec![],
        })
    })
}

/// Runs a program; returns the position before its start and those of each servo cycle from its start on, X,
/// Y, Z.
fn run(hardware: Option<HardwareFactory>, program: &'static str) -> ([f64; 3], Vec<[f64; 3]>) {
    let trace = Arc::<Mutex<Vec<_>>>::default();
    let sink = Arc::clone(&trace);
    let bench = bench("").hardware(hardware.unwrap_or_else(Hardware::simulated_factory));
    let bench = bench.subprogram(50, program).on_cycle(move |servo| {
        let [x, y, z, ..] = servo.channel(0).setpoint().0;
        sink.lock().unwrap().push([x, y, z]);
    });
    let played = bench.play(async move |scene, _| {
        let system = scene.cs(1);
        system.load(50).await.unwrap();
        let machine = system.position().await.unwrap().machine;
        let before = ["X", "Y", "Z"].map(|axis| machine[axis]);
        system.start().await.unwrap();
        system.wait_until(Execution::ProgramCompleted).await.unwrap();
        let positions = std::mem::take(&mut *trace.lock().unwrap());
        (before, positions)
    });
    played.unwrap()
}

#[test]
fn a_program_on_a_bus_of_ones_own_has_the_positions_of_the_simulated_one() {
    let (_, simulated) = run(None, PROGRAM);
    let (_, own) = run(Some(standing_at(0.0)), PROGRAM);
    assert!(simulated.len() > 1000);
    assert_eq!(simulated, own);
}

#[test]
fn the_machine_stands_where_its_motors_report_and_moves_from_there() {
    // The first rapid moves X, Y and Z from 12.5 to X 20, 10 mm/s^2 or more: no cycle of 1 ms moves any by 1 mm.
    let (before, positions) = run(Some(standing_at(12.5)), "G00 X20\nM30\n");
    assert_eq!(before, [12.5; 3]);
    assert_eq!(positions.first(), Some(&[12.5; 3]));
    assert_eq!(positions.last(), Some(&[20.0, 12.5, 12.5]));
    assert!(
        positions
            .windows(2)
            .all(|pair| (pair[1][0] - pair[0][0]).abs() < 1.0)
    );
    assert!(positions.is_sorted_by(|a, b| a[0] <= b[0]));
}

#[test]
fn what_a_drive_says_of_its_reference_is_seen_with_the_positions() {
    let bench = bench("").hardware(Box::new(|systems: &[&CoordinateSystemSettings]| {
        let motors = systems.iter().flat_map(|system| system.motors.iter().flatten());
        let at_start = motors.enumerate().map(|(place, _)| Feedback {
            is_homed: place != 1,
            ..Feedback::following(0.0)
        });
        Ok(Hardware {
            bus: Box::new(Following::default()),
            at_start: at_start.collect(),
            spindles: vec![],
        })
    }));
    let played = bench.play(async |scene, _| {
        let system = scene.cs(1);
        let homed = system.position().await.unwrap().homed;
        assert_eq!(["X", "Y", "Z"].map(|axis| homed[axis]), [true, false, true]);
    });
    played.unwrap();
}

#[test]
fn simulated_drives_are_homed_from_the_start() {
    let played = bench("").play(async |scene, _| scene.cs(1).position().await.unwrap().homed);
    let homed = played.unwrap();
    assert_eq!(["X", "Y", "Z"].map(|axis| homed[axis]), [true; 3]);
}

#[test]
fn drive_fault_stops_the_run_and_a_reset_allows_the_next_run() {
    let fault = Arc::<AtomicU16>::default();
    let of_bus = Arc::clone(&fault);
    let bench = bench("").hardware(Box::new(move |systems: &[&CoordinateSystemSettings]| {
        let motors = systems.iter().flat_map(|system| system.motors.iter().flatten());
        Ok(Hardware {
            bus: Box::new(Following { fault: of_bus }),
            at_start: motors.map(|_| Feedback::following(0.0)).collect(),
            spindles: vec![],
        })
    }));
    let bench = bench.subprogram(50, "G01 X60 F600\nM30\n");
    let played = bench.play(async move |scene, _| {
        let (plc, system) = (scene.plc(), scene.cs(1));
        system.load(50).await.unwrap();
        system.start().await.unwrap();
        plc.sleep(Duration::from_secs(2)).await;
        fault.store(0x8611, Ordering::Relaxed);
        let state = system.wait_until(Execution::Stopped).await.unwrap();
        assert_eq!(state.reason, Some(Reason::Alarm));
        let active = plc.port().read(&Topic::AlarmActive).await.unwrap();
        let Payload::AlarmActive(active) = &active.payload else {
            panic!("{active:?}")
        };
        let numbers: Vec<_> = active.alarms.iter().map(|alarm| alarm.number).collect();
        assert_eq!(numbers, [205]);
        system.reset().await.unwrap();
        system.wait_until(Execution::Ready).await.unwrap();
        plc.sleep(Duration::from_millis(10)).await;
        assert_eq!(fault.load(Ordering::Relaxed), 0, "cleared by the reset");
        system.start().await.unwrap();
        system.wait_until(Execution::ProgramCompleted).await.unwrap();
        assert_eq!(system.position().await.unwrap().machine["X"], 60.0);
    });
    played.unwrap();
}

/// Drives that stop without commands; the servo waits in the next exchange.
#[derive(Debug, Default)]
struct Stalling {
    drives: Following,
    stalls: Arc<AtomicBool>,
    heard: Arc<AtomicU64>,
}

impl DriveBus for Stalling {
    fn exchange(&mut self, commands: &[Command], feedback: &mut [Feedback]) -> CycleResult {
        if self.stalls.swap(false, Ordering::Relaxed) {
            std::thread::sleep(Duration::from_secs(1));
        }
        self.drives.exchange(commands, feedback)
    }

    fn heartbeat(&mut self, cycle: u64) {
        self.heard.store(cycle, Ordering::Relaxed);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bus_that_does_not_return_stops_all_and_the_heartbeat_stands() {
    let (stalls, heard) = (Arc::<AtomicBool>::default(), Arc::<AtomicU64>::default());
    let bus = Stalling {
        drives: Following::default(),
        stalls: Arc::clone(&stalls),
        heard: Arc::clone(&heard),
    };
    let factory: HardwareFactory = Box::new(move |systems: &[&CoordinateSystemSettings]| {
        let motors = systems.iter().flat_map(|system| system.motors.iter().flatten());
        Ok(Hardware {
            bus: Box::new(bus),
            at_start: motors.map(|_| Feedback::following(0.0)).collect(),
            spindles: vec![],
        })
    });
    let machine = Machine::new("");
    let mut config = Config::read(&machine.config()).unwrap();
    config.machine.servo_late_ms = 500;
    let runtime = Runtime::start_on(config, factory).await.unwrap();
    let plc = Plc::in_process(runtime.port());
    let system = plc.coordinate_system(1);
    plc.port()
        .ask(typed::WriteProgram(50, "G01 X250 F6000\nM30\n".into()))
        .await
        .unwrap();
    system.load(50).await.unwrap();
    system.start().await.unwrap();
    plc.sleep(Duration::from_millis(500)).await;
    stalls.store(true, Ordering::Relaxed);
    let silence = plc.until_silent(Duration::from_millis(400));
    tokio::time::timeout(Duration::from_millis(900), silence)
        .await
        .expect("heard while the servo stands");
    let beats = heard.load(Ordering::Relaxed);
    // a call of the bus that does not return is a failure of the servo
    let stopped = system.wait_until(Execution::Stopped).await.unwrap();
    assert_eq!(stopped.reason, Some(Reason::Alarm));
    let x = system.position().await.unwrap().machine["X"];
    system.abort().await.unwrap();
    tokio::time::sleep(Duration::from_secs(1)).await;
    // the command of the exchange that stalled is published when it has returned
    let rests = system.position().await.unwrap().machine["X"];
    assert!((0.0..0.15).contains(&(rests - x)), "{x} {rests}");
    assert_eq!(heard.load(Ordering::Relaxed), beats, "the heartbeat stands still");
    runtime.shutdown().await;
}

#[test]
fn hardware_that_does_not_come_up_keeps_the_machine_from_starting() {
    let factory = Box::new(|_: &[&CoordinateSystemSettings]| Err(std::io::Error::other("no link on port 2")));
    let played = bench("").hardware(factory).play(async |_, _| ());
    let error = played.unwrap_err().to_string();
    assert_eq!(error, "the hardware cannot be started: no link on port 2");
}

#[test]
fn the_page_names_the_traits_the_factory_and_nothing_of_ours_to_touch() {
    let seams = ["DriveBus", "Spindle", "HardwareFactory", "Runtime::start_on"];
    assert_eq!(costs("drives or a spindle"), seams);
}
