//! One start of the runtime in the world: all parts of the process, until it ends or is killed.

use std::sync::Arc;
use std::time::{Duration, SystemTime};

use plc_api::hub::Filter;
use plc_api::port::Port;
use plc_api::server::ServedPort;
use plc_api::{AuxOutput, Plc, SequenceProgram};
use tandem_gateway::{GatewaySettings, MqttEnd, MqttSettings};
use tandem_model::Axis;
use tandem_servo::Servo;
use tokio::task::AbortHandle;

use super::MACHINE;
use super::broker::Connector;
use super::oracle::SharedOracle;
use super::port_observer::PortObserver;
use crate::Runtime;
use crate::clock::Clock;
use crate::config::Machine;
use crate::coordinator::StartError;
use crate::disk::simulated::memory::Mount;
use crate::servo_thread::cycle_after;
use crate::shared::SharedState;
use crate::threads;
use plc_api::types::BootId;

/// Time between two bursts of servo cycles. Reason: no part of the machine waits for a shorter time.
const BURST: Duration = Duration::from_millis(5);

pub(super) struct Process {
    pub runtime: Option<Runtime>,
    pub witness: Arc<PortObserver>,
    mqtt: Option<MqttEnd>,
    tasks: Vec<AbortHandle>,
}

impl Process {
    pub fn start(
        machine: &Machine,
        number: u32,
        wall: SystemTime,
        connector: Connector,
        truth: &SharedOracle,
    ) -> Result<Self, StartError> {
        threads::simulate();
        let boot = BootId(format!("boot-{number}"));
        let clock = Clock::paused(wall);
        let (runtime, servo, shared) = Runtime::start_in_world(machine.clone(), boot.clone(), clock)?;
        truth.lock().boot(&boot);
        let witness = Arc::new(PortObserver {
            port: runtime.served_port(),
            truth: truth.clone(),
            boot,
        });
        let served: Arc<dyn ServedPort> = Arc::<PortObserver>::clone(&witness);
        let port: Arc<dyn Port> = Arc::<PortObserver>::clone(&witness);
        let settings = GatewaySettings {
            machine: MACHINE.to_owned(),
            mqtt: MqttSettings {
                embedded_listen: None,
                accept_unverified_senders: true,
                ..MqttSettings::default()
            },
            position_interval_ms: 1000,
            ..GatewaySettings::default()
        };
        let tasks = vec![
            tokio::spawn(observe_messages(Arc::clone(&port), truth.clone())).abort_handle(),
            tokio::spawn(cycle(servo, shared, truth.clone())).abort_handle(),
            tokio::spawn(serve(port)).abort_handle(),
        ];
        Ok(Self {
            mqtt: Some(MqttEnd::over(served, &settings, connector)),
            runtime: Some(runtime),
            witness,
            tasks,
        })
    }

    /// Ends the process in an orderly way.
    pub async fn shutdown(mut self) {
        if let Some(mqtt) = self.mqtt.take() {
            mqtt.stop().await;
        }
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown().await;
        }
    }
}

impl Drop for Process {
    /// Ends the process as a kill does; its disk has already ended.
    fn drop(&mut self) {
        if let Some(mqtt) = self.mqtt.take() {
            mqtt.crash();
        }
        self.tasks.iter().for_each(AbortHandle::abort);
        drop(self.runtime.take());
        threads::stop_simulating();
    }
}

/// Passes all messages of the machine to the oracle without delay, independently of the model of the broker.
async fn observe_messages(port: Arc<dyn Port>, truth: SharedOracle) {
    let mut messages = port.subscribe(Filter::All);
    while let Some(message) = messages.next().await {
        if !Mount::is_dead() {
            truth.lock().check_message(&message);
        }
    }
}

/// Runs the servo cycles in bursts, and reports each motion of an axis to the oracle.
async fn cycle(mut servo: Servo, shared: Arc<SharedState>, truth: SharedOracle) {
    let numbers: Vec<_> = shared.machine.coordinate_systems.iter().collect();
    let numbers: Vec<_> = numbers.iter().map(|system| system.settings.number).collect();
    let period = shared.machine.servo_period();
    let per_burst = u64::try_from(BURST.as_micros() / period.as_micros().max(1)).unwrap();
    let x = Axis::from_letter('X').unwrap();
    let mut before: Vec<f64> = servo
        .channels()
        .iter()
        .map(|channel| channel.setpoint()[x])
        .collect();
    loop {
        tokio::time::sleep(BURST).await;
        let mut left = per_burst;
        let mut told = false;
        while left > 0 {
            let passed = servo.cycles_to_pass(left - 1);
            servo.pass(passed);
            left -= passed + 1;
            told |= cycle_after(&mut servo, 0, 1, &shared.servo);
        }
        for (place, channel) in servo.channels().iter().enumerate() {
            let now = channel.setpoint()[x];
            if now.to_bits() != before[place].to_bits() && !Mount::is_dead() {
                truth.lock().moved(numbers[place]);
            }
            before[place] = now;
        }
        if told {
            shared.wake_all();
        }
    }
}

/// Runs a sequence program in the process of the machine.
async fn serve(port: Arc<dyn Port>) {
    async fn work(_output: AuxOutput, plc: Plc) -> Result<(), plc_api::Alarm> {
        plc.sleep(Duration::from_millis(120)).await;
        Ok(())
    }
    let plc = Plc::in_process(port);
    let program = SequenceProgram::new()
        .in_coordinate_system(1, |program| program.on(102, work))
        .handler_id("built-in");
    // The sequence program ends when the machine ends.
    let _ = program.run(&plc).await;
}
