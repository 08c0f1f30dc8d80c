//! Tests of injected faults of the servo thread, of a bus to the drives and of a spindle: at rest and in motion, in
//! real and in simulated time.

use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering::SeqCst};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use plc_api::{Execution, Plc};
use plc_protocol::supervisor::Consequence;
use plc_protocol::types::message::Payload;
use plc_protocol::types::request::typed;
use plc_protocol::types::state::Reason;
use plc_protocol::types::topic::Topic;
use tandem_model::alarm::SERVO_FAILED;
use tandem_model::settings::CoordinateSystemSettings;
use tandem_servo::{
    Command, Cutoff, CycleResult, DriveBus, Feedback, Hardware, HardwareFactory, Spindle, SpindleDirection,
    SpindleState, ThreadStep,
};

use tandem_runtime::{Config, Runtime};
use tandem_testing::Bench;

const NONE: u8 = 0;
const PANICS: u8 = 1;
const PANICS_ONCE: u8 = 2;
const STALLS: u8 = 3;
const SPINDLE_PANICS: u8 = 4;

/// Fault to inject, and counts of the commands that the drives received.
#[derive(Debug, Default)]
struct InjectedFault {
    fault: AtomicU8,
    /// Commands with power since the fault.
    powered: AtomicU64,
    /// Commands without power since the fault.
    unpowered: AtomicU64,
    beats: AtomicU64,
    cut: Mutex<Option<Instant>>,
    released: AtomicBool,
}

#[derive(Debug)]
struct FaultyBus {
    inner: Box<dyn DriveBus>,
    injected: Arc<InjectedFault>,
}

impl DriveBus for FaultyBus {
    fn exchange(&mut self, commands: &[Command], feedback: &mut [Feedback]) -> CycleResult {
        match self.injected.fault.load(SeqCst) {
            PANICS => panic!("an injected fault of the bus"),
            PANICS_ONCE => {
                self.injected.fault.store(SPINDLE_PANICS, SeqCst);
                panic!("an injected fault of the bus");
            }
            STALLS => {
                while !self.injected.released.load(SeqCst) {
                    std::thread::sleep(Duration::from_millis(1));
                }
            }
            NONE => {}
            _ => {
                let is_powered = commands.iter().any(|command| command.enable);
                let count = if is_powered {
                    &self.injected.powered
                } else {
                    &self.injected.unpowered
                };
                count.fetch_add(1, SeqCst);
            }
        }
        self.inner.exchange(commands, feedback)
    }

    fn heartbeat(&mut self, cycle: u64) {
        self.injected.beats.store(cycle, SeqCst);
    }

    fn keeps_speed(&self) -> bool {
        true
    }

    fn cutoff(&mut self) -> Option<Cutoff> {
        let injected = Arc::clone(&self.injected);
        Some(Box::new(move || {
            *injected.cut.lock().unwrap() = Some(Instant::now());
        }))
    }
}

#[derive(Debug)]
struct FaultySpindle {
    inner: Box<dyn Spindle>,
    injected: Arc<InjectedFault>,
}

impl Spindle for FaultySpindle {
    fn power(&mut self, enable: bool, clear_fault: bool) {
        self.inner.power(enable, clear_fault);
    }

    fn command(&mut self, direction: SpindleDirection, rpm: f64) {
        self.inner.command(direction, rpm);
    }

    fn follow(&mut self, step: ThreadStep) {
        self.inner.follow(step);
    }

    fn cycle(&mut self) -> SpindleState {
        assert_ne!(
            self.injected.fault.load(SeqCst),
            SPINDLE_PANICS,
            "an injected fault of the spindle"
        );
        self.inner.cycle()
    }

    fn state(&self) -> SpindleState {
        self.inner.state()
    }
}

fn hardware(injected: &Arc<InjectedFault>) -> HardwareFactory {
    let injected = Arc::clone(injected);
    Box::new(move |systems: &[&CoordinateSystemSettings]| {
        let simulated = Hardware::simulated(systems);
        let spindles = simulated.spindles.into_iter().map(|spindle| {
            let inner = spindle?;
            let injected = Arc::clone(&injected);
            Some(Box::new(FaultySpindle { inner, injected }) as Box<dyn Spindle>)
        });
        Ok(Hardware {
            at_start: simulated.at_start,
            spindles: spindles.collect(),
            bus: Box::new(FaultyBus {
                inner: simulated.bus,
                injected: Arc::clone(&injected),
            }),
        })
    })
}

async fn has_alarm(plc: &Plc) -> bool {
    let message = plc.port().read(&Topic::AlarmActive).await.unwrap();
    match &message.payload {
        Payload::AlarmActive(active) => active
            .alarms
            .iter()
            .any(|alarm| alarm.number == SERVO_FAILED.number),
        other => panic!("{other:?}"),
    }
}

/// Checks the conditions that must hold after every kind of failure of the servo.
async fn check_failed(plc: &Plc, runtime: &Runtime, ran: bool) {
    let system = plc.coordinate_system(1);
    if ran {
        let stopped = system.wait_until(Execution::Stopped).await.unwrap();
        assert_eq!((stopped.reason, stopped.transition), (Some(Reason::Alarm), None));
    }
    assert!(has_alarm(plc).await);
    system.abort().await.unwrap();
    system.stop().await.unwrap();
    system.hold().await.unwrap();
    let refused = system.reset().await.unwrap_err().to_string();
    assert!(refused.contains("restart the runtime"), "{refused}");
    assert!(system.mdi("G00 X0").await.is_err());
    assert!(has_alarm(plc).await, "no reset clears it");
    let at = system.position().await.unwrap().machine["X"];
    plc.sleep(Duration::from_millis(50)).await;
    assert!((system.position().await.unwrap().machine["X"] - at).abs() < 1e-9);
    let faults = runtime.served_port().supervisor().faults();
    assert_eq!(faults.len(), 1, "{faults:?}");
    assert_eq!(
        (faults[0].task.as_str(), faults[0].consequence),
        ("servo", Consequence::StopsAll)
    );
}

async fn under_way(plc: &Plc) {
    let program = typed::WriteProgram(50, "M03 S500\nG01 X290 F600\nM30\n".into());
    plc.port().ask(program).await.unwrap();
    plc.coordinate_system(1).load(50).await.unwrap();
    plc.coordinate_system(1).start().await.unwrap();
    plc.sleep(Duration::from_millis(300)).await;
}

#[test]
fn p11_fault_of_bus_or_spindle_in_simulated_time_stops_all() {
    for ran in [true, false] {
        for fault in [PANICS, PANICS_ONCE, SPINDLE_PANICS] {
            let injected = Arc::<InjectedFault>::default();
            let faulty = Arc::clone(&injected);
            let bench = Bench::new().hardware(hardware(&injected));
            let play = bench.play(async move |scene, runtime| {
                let plc = scene.plc();
                // the servo calls a spindle only in motion, or while the spindle turns
                plc.coordinate_system(1).mdi("M03 S100").await.unwrap();
                if ran {
                    under_way(plc).await;
                }
                let from_s = plc.now_s();
                faulty.fault.store(fault, SeqCst);
                while !has_alarm(plc).await {
                    plc.sleep(Duration::from_millis(1)).await;
                }
                let took_s = plc.now_s() - from_s;
                assert!(took_s < 0.1, "{took_s}");
                check_failed(plc, runtime, ran).await;
            });
            assert_eq!(play, Ok(()), "fault {fault}, in motion: {ran}");
            assert_eq!(
                injected.powered.load(SeqCst),
                0,
                "fault {fault}: drives have no power"
            );
        }
    }
}

/// Starts the demo machine in real time with a data folder.
async fn in_real_time(injected: &Arc<InjectedFault>) -> (Runtime, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let mut config = Config::demo();
    config.machine.data_dir = folder.path().to_owned();
    let runtime = Runtime::start_on(config, hardware(injected)).await.unwrap();
    (runtime, folder)
}

#[tokio::test(flavor = "multi_thread")]
async fn p11_panic_of_the_relay_cuts_power() {
    let injected = Arc::<InjectedFault>::default();
    let (runtime, _folder) = in_real_time(&injected).await;
    let plc = Plc::in_process(runtime.port());
    under_way(&plc).await;
    runtime.served_port().supervisor().inject("servo-relay");
    // the end of the hold is an event of the servo, which no longer arrives
    let holding = plc.coordinate_system(1);
    let holding = tokio::spawn(async move { holding.hold().await });
    let from = Instant::now();
    while !has_alarm(&plc).await {
        tokio::time::sleep(Duration::from_millis(1)).await;
        assert!(from.elapsed() < Duration::from_secs(2));
    }
    assert!(injected.cut.lock().unwrap().is_some(), "the power is cut");
    check_failed(&plc, &runtime, true).await;
    holding.abort();
    runtime.shutdown().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn p11_panic_or_stall_of_the_bus_in_real_time_cuts_power() {
    for fault in [PANICS, PANICS_ONCE, STALLS] {
        let injected = Arc::<InjectedFault>::default();
        let (runtime, _folder) = in_real_time(&injected).await;
        let plc = Plc::in_process(runtime.port());
        under_way(&plc).await;
        injected.fault.store(fault, SeqCst);
        let from = Instant::now();
        while !has_alarm(&plc).await {
            tokio::time::sleep(Duration::from_millis(1)).await;
            assert!(from.elapsed() < Duration::from_secs(20), "fault {fault}");
        }
        let took = from.elapsed();
        let cut = injected.cut.lock().unwrap().expect("the power is cut");
        let cut = cut.saturating_duration_since(from);
        // the limit is 100 ms; on a computer that runs other tests it may be later
        let late = took.max(cut);
        assert!(
            late < Duration::from_secs(2),
            "fault {fault}: alarm after {took:?}, power cut after {cut:?}"
        );
        let beats = injected.beats.load(SeqCst);
        check_failed(&plc, &runtime, true).await;
        injected.released.store(true, SeqCst);
        if fault == STALLS {
            injected.fault.store(SPINDLE_PANICS, SeqCst);
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
        assert_eq!(injected.beats.load(SeqCst), beats, "the heartbeat stands still");
        assert_eq!(injected.powered.load(SeqCst), 0);
        if fault != PANICS {
            assert!(
                injected.unpowered.load(SeqCst) > 0,
                "fault {fault}: the bus takes the power"
            );
        }
        runtime.shutdown().await;
    }
}
