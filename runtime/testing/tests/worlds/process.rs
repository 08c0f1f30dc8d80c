//! One start of the runtime in the world: all parts of the process, until it ends or is killed.

use std::sync::Arc;
use std::time::Duration;

use plc_api::{AuxOutput, Plc, SequenceProgram};
use plc_protocol::hub::Filter;
use plc_protocol::port::Port;
use plc_protocol::server::ServedPort;
use tandem_gateway::{GatewaySettings, MqttEnd, MqttSettings};
use tandem_model::Axis;
use tandem_runtime::{Machine, Runtime, ServoCycles, StartError};
use tandem_store::environment::{Clock, Disk, Environment, Threads};
use tandem_testing::simulated_disk::SimulatedDisk;
use tokio::task::AbortHandle;

use super::MACHINE;
use super::broker::Connector;
use super::clock::PausedTime;
use super::oracle::SharedOracle;
use super::port_observer::PortObserver;
use super::threads::SimulatedThreads;
use plc_protocol::types::BootId;

/// Time between two bursts of servo cycles. Reason: no part of the machine waits for a shorter time.
const BURST: Duration = Duration::from_millis(5);

pub(super) struct Process {
    pub runtime: Option<Runtime>,
    pub witness: Arc<PortObserver>,
    mqtt: Option<MqttEnd>,
    tasks: Vec<AbortHandle>,
    threads: SimulatedThreads,
}

/// Parts of the world that a process uses.
pub(super) struct ProcessParts {
    pub simulated: SimulatedDisk,
    /// The simulated disk as mounted for this process.
    pub disk: Disk,
    pub connector: Connector,
    pub truth: SharedOracle,
}

impl Process {
    pub fn start(machine: &Machine, number: u32, parts: ProcessParts) -> Result<Self, StartError> {
        let ProcessParts {
            simulated,
            disk,
            connector,
            truth,
        } = parts;
        let boot = BootId(format!("boot-{number}"));
        let threads = SimulatedThreads::default();
        let environment = Environment {
            disk,
            threads: Threads::new(threads.clone()),
            clock: Clock::from_source(PausedTime::new(simulated.clone())),
        };
        let started = Runtime::start_in_environment(environment, machine.clone(), boot.clone());
        let (runtime, servo) = started.inspect_err(|_| threads.stop())?;
        truth.lock().boot(&boot);
        let witness = Arc::new(PortObserver {
            port: runtime.served_port(),
            disk: simulated.clone(),
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
            tokio::spawn(observe_messages(
                Arc::clone(&port),
                simulated.clone(),
                truth.clone(),
            ))
            .abort_handle(),
            tokio::spawn(cycle(servo, simulated, truth)).abort_handle(),
            tokio::spawn(serve(port)).abort_handle(),
        ];
        Ok(Self {
            mqtt: Some(MqttEnd::over(served, &settings, connector)),
            runtime: Some(runtime),
            witness,
            tasks,
            threads,
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
        self.threads.stop();
    }
}

/// Passes all messages of the machine to the oracle without delay, independently of the model of the broker.
async fn observe_messages(port: Arc<dyn Port>, disk: SimulatedDisk, truth: SharedOracle) {
    let mut messages = port.subscribe(Filter::All);
    while let Some(message) = messages.next().await {
        if !disk.is_dead() {
            truth.lock().check_message(&message);
        }
    }
}

/// Runs the servo cycles in bursts, and reports each motion of an axis to the oracle.
async fn cycle(mut servo: ServoCycles, disk: SimulatedDisk, truth: SharedOracle) {
    let per_burst = u64::try_from(BURST.as_micros() / servo.period().as_micros().max(1)).unwrap();
    let x = Axis::from_letter('X').unwrap();
    let positions = |servo: &ServoCycles| -> Vec<(u8, f64)> {
        servo
            .setpoints()
            .map(|(cs, setpoint)| (cs, setpoint[x]))
            .collect()
    };
    let mut before = positions(&servo);
    loop {
        tokio::time::sleep(BURST).await;
        servo.execute(per_burst);
        let now = positions(&servo);
        for ((cs, now), (_, before)) in now.iter().zip(&before) {
            if now.to_bits() != before.to_bits() && !disk.is_dead() {
                truth.lock().moved(*cs);
            }
        }
        before = now;
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
