//! A custom spindle costs one file: an implementation of `Spindle`, and a factory that passes it to the
//! runtime.

use std::sync::atomic::{AtomicBool, AtomicU16, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use plc_api::Execution;
use plc_protocol::types::message::Payload;
use plc_protocol::types::state::Reason;
use plc_protocol::types::topic::Topic;
use tandem_runtime::hardware::{
    CoordinateSystemSettings, Hardware, HardwareFactory, Orientation, Spindle, SpindleDirection,
    SpindleState, ThreadStep,
};
use tandem_testing::Bench;

use crate::support::machine::bench;

/// Externally visible state of the drive, which can also trigger a fault.
#[derive(Debug, Default)]
struct Drive {
    is_enabled: AtomicBool,
    fault: AtomicU16,
    /// r/min, clockwise positive; bits of a number.
    rpm: AtomicU64,
    /// Revolutions in a thread, clockwise positive; bits of a number.
    revolutions: AtomicU64,
}

/// A spindle that has the commanded speed at once.
#[derive(Debug, Default)]
struct Own {
    drive: Arc<Drive>,
    orientation: Orientation,
}

impl Spindle for Own {
    fn power(&mut self, enable: bool, clear_fault: bool) {
        self.drive.is_enabled.store(enable, Relaxed);
        if clear_fault {
            self.drive.fault.store(0, Relaxed);
        }
    }

    fn command(&mut self, direction: SpindleDirection, rpm: f64) {
        let (rpm, orientation) = match direction {
            SpindleDirection::Cw => (rpm, Orientation::Open),
            SpindleDirection::Ccw => (-rpm, Orientation::Open),
            SpindleDirection::Stop => (0.0, Orientation::Open),
            SpindleDirection::Orient => (0.0, Orientation::Pending),
        };
        self.drive.rpm.store(rpm.to_bits(), Relaxed);
        self.orientation = orientation;
    }

    fn follow(&mut self, step: ThreadStep) {
        if let ThreadStep::Turn(Some(revolutions)) = step {
            self.drive.revolutions.store(revolutions.to_bits(), Relaxed);
        }
    }

    fn cycle(&mut self) -> SpindleState {
        if self.orientation == Orientation::Pending {
            self.orientation = Orientation::Reached;
        }
        self.state()
    }

    fn state(&self) -> SpindleState {
        let rpm = f64::from_bits(self.drive.rpm.load(Relaxed));
        SpindleState {
            rpm,
            orientation: self.orientation,
            rests: rpm == 0.0,
            is_enabled: self.drive.is_enabled.load(Relaxed),
            fault: self.drive.fault.load(Relaxed),
            ..SpindleState::default()
        }
    }
}

/// Simulated drives, and this spindle in the first coordinate system.
fn with(drive: Arc<Drive>) -> HardwareFactory {
    Box::new(|systems: &[&CoordinateSystemSettings]| {
        let mut hardware = Hardware::simulated(systems);
        hardware.spindles[0] = Some(Box::new(Own {
            drive,
            ..Own::default()
        }));
        Ok(hardware)
    })
}

/// A machine with this spindle and this program.
fn machine(drive: &Arc<Drive>, program: &str) -> Bench {
    bench("")
        .hardware(with(Arc::clone(drive)))
        .subprogram(50, program)
}

#[test]
fn a_spindle_of_ones_own_turns_with_m03_and_follows_the_thread_of_g84() {
    let drive = Arc::<Drive>::default();
    let (seen, of_cycle) = (Arc::clone(&drive), Arc::new(Mutex::new(Vec::new())));
    let sink = Arc::clone(&of_cycle);
    // 300 r/min at F100: 3 revolutions a mm from R at Z -5 to Z -10
    let program = "S500 M03\nG04 P500\nM05\nF100 S300\nG84 Z-10 R-5\nG80\nM30\n";
    let bench = machine(&drive, program).on_cycle(move |servo| {
        let [_, _, z, ..] = servo.channel(0).setpoint().0;
        let number = |bits: &AtomicU64| f64::from_bits(bits.load(Relaxed));
        let values = [z, number(&seen.rpm), number(&seen.revolutions)];
        sink.lock().unwrap().push(values);
    });
    let played = bench.play(async move |scene, _| {
        let system = scene.cs(1);
        system.load(50).await.unwrap();
        system.start().await.unwrap();
        system.wait_until(Execution::ProgramCompleted).await.unwrap();
        assert!(drive.is_enabled.load(Relaxed));
        let of_cycle = of_cycle.lock().unwrap();
        assert!(of_cycle.iter().any(|[_, rpm, _]| *rpm == 500.0));
        let deepest = of_cycle.iter().map(|[z, ..]| *z).fold(f64::INFINITY, f64::min);
        assert_eq!(deepest, -10.0);
        let mut in_thread = of_cycle.iter().filter(|[z, ..]| *z < -5.000_001).peekable();
        assert!(in_thread.peek().is_some());
        for [z, rpm, revolutions] in in_thread {
            // in the retract they count from the bottom
            let (on_the_way_in, on_the_way_out) = (3.0 * (-5.0 - z), -3.0 * (z + 10.0));
            let off = |expected: f64| (revolutions - expected).abs();
            assert!(
                off(on_the_way_in).min(off(on_the_way_out)) < 1e-6,
                "{revolutions} revolutions at {z}"
            );
            assert_eq!(*rpm, 0.0, "no speed of its own");
        }
    });
    played.unwrap();
}

#[test]
fn spindle_drive_fault_stops_the_run_and_a_reset_lets_it_turn_again() {
    let drive = Arc::<Drive>::default();
    let played = machine(&drive, "S500 M03\nG01 X60 F600\nM30\n").play(async move |scene, _| {
        let (plc, system) = (scene.plc(), scene.cs(1));
        system.load(50).await.unwrap();
        system.start().await.unwrap();
        plc.sleep(Duration::from_secs(2)).await;
        drive.fault.store(0x2310, Relaxed);
        let state = system.wait_until(Execution::Stopped).await.unwrap();
        assert_eq!(state.reason, Some(Reason::Alarm));
        let active = plc.port().read(&Topic::AlarmActive).await.unwrap();
        let Payload::AlarmActive(active) = &active.payload else {
            panic!("{active:?}")
        };
        let alarms: Vec<_> = active
            .alarms
            .iter()
            .map(|alarm| (alarm.number, alarm.text.as_str()))
            .collect();
        let text = "The drive of motor 4 (spindle) reports fault 8976 (16#2310)";
        assert_eq!(alarms, [(205, text)]);
        assert!(!drive.is_enabled.load(Relaxed));
        system.reset().await.unwrap();
        system.wait_until(Execution::Ready).await.unwrap();
        plc.sleep(Duration::from_millis(10)).await;
        assert_eq!(drive.fault.load(Relaxed), 0, "cleared by the reset");
        system.start().await.unwrap();
        system.wait_until(Execution::ProgramCompleted).await.unwrap();
        assert!(drive.is_enabled.load(Relaxed));
        assert_eq!(f64::from_bits(drive.rpm.load(Relaxed)), 500.0);
    });
    played.unwrap();
}
