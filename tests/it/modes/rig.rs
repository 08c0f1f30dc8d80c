//! A machine in simulated time, over its port, with the commanded position of each servo cycle.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use plc_api::{CoordinateSystem, Error, Execution, Plc};
use plc_protocol::types::message::Payload;
use plc_protocol::types::request::{Refusal, RefusalCode, Request};
use plc_protocol::types::state::{Reason, State};
use plc_protocol::types::topic::Topic;

use crate::support::machine::bench;

/// X, Y, Z of one servo cycle.
pub type Point = [f64; 3];

pub struct Rig {
    pub plc: Plc,
    pub cs: CoordinateSystem,
    pub trace: Arc<Mutex<Vec<Point>>>,
}

/// Runs a test on the machine of [`bench`] with `more` in its configuration.
pub fn on_machine<T: Send + 'static, F: Future<Output = T>>(
    more: &str,
    test: impl FnOnce(Rig) -> F + Send + 'static,
) -> T {
    let trace = Arc::<Mutex<Vec<_>>>::default();
    let sink = Arc::clone(&trace);
    let bench = bench(more).on_cycle(move |servo| {
        let [x, y, z, ..] = servo.channel(0).setpoint().0;
        sink.lock().unwrap().push([x, y, z]);
    });
    let played = bench.play(async move |scene, _| {
        let rig = Rig {
            cs: scene.cs(1),
            plc: scene.plc().clone(),
            trace,
        };
        rig.cs.wait_for(|_| true).await.unwrap();
        test(rig).await
    });
    played.unwrap()
}

impl Rig {
    /// Writes and loads program 50.
    pub async fn load(&self, text: &str) {
        let write = Request::WriteProgram(50, text.to_owned());
        self.plc.port().request(write).await.unwrap();
        self.cs.load(50).await.unwrap();
    }

    /// Loads and starts program 50.
    pub async fn start(&self, text: &str) {
        self.load(text).await;
        self.cs.start().await.unwrap();
    }

    pub async fn sleep(&self, seconds: f64) {
        self.plc.sleep(Duration::from_secs_f64(seconds)).await;
    }

    pub async fn until(&self, execution: Execution) -> State {
        self.cs.wait_until(execution).await.unwrap()
    }

    /// Waits for INTERRUPTED and its reason.
    pub async fn interrupted(&self, reason: Reason) {
        let state = self.until(Execution::Interrupted).await;
        assert_eq!(state.reason, Some(reason));
    }

    /// Waits until single block interrupts the run, or until the run has ended. Returns true if it is interrupted.
    pub async fn interrupted_or_completed(&self) -> bool {
        let rests = |state: &State| {
            state.transition.is_none() && !matches!(state.execution, Execution::Active | Execution::Wait)
        };
        let state = self.cs.wait_for(rests).await.unwrap();
        state.execution == Execution::Interrupted
    }

    pub async fn state(&self) -> (Execution, Option<Reason>) {
        let state = self.cs.state().await.unwrap();
        (state.execution, state.reason)
    }

    /// Commanded machine position.
    pub async fn at(&self) -> Point {
        let machine = self.cs.position().await.unwrap().machine;
        ["X", "Y", "Z"].map(|axis| machine[axis])
    }

    /// Commanded positions of all servo cycles since the last call.
    pub fn trace(&self) -> Vec<Point> {
        std::mem::take(&mut *self.trace.lock().unwrap())
    }

    /// Numbers of the alarms that are active.
    pub async fn alarms(&self) -> Vec<u16> {
        let message = self.plc.port().read(&Topic::AlarmActive).await.unwrap();
        let Payload::AlarmActive(active) = &message.payload else {
            panic!("{message:?}")
        };
        active.alarms.iter().map(|alarm| alarm.number).collect()
    }
}

/// The refusal in an error of the port.
#[track_caller]
pub fn refused<T: std::fmt::Debug>(result: Result<T, Error>, code: RefusalCode) -> Refusal {
    match result {
        Err(Error::Refused(refusal)) if refusal.code == code => refusal,
        other => panic!("{other:?} is not {code:?}"),
    }
}

#[track_caller]
pub fn close(a: Point, b: Point) {
    assert!(distance(a, b) < 1e-9, "{a:?} is not {b:?}");
}

pub fn distance(a: Point, b: Point) -> f64 {
    let [x, y, z] = std::array::from_fn(|i| a[i] - b[i]);
    f64::hypot(x, y).hypot(z)
}
