//! Faults in each supervised task and thread, at rest and in motion: the consequences follow `runtime/ARCHITECTURE.md`.

use std::net::SocketAddr;
use std::path::Path;
use std::time::Duration;

use plc_api::Plc;
use plc_protocol::supervisor::{Consequence, Supervisor};
use plc_protocol::types::planned::PathQuery;
use plc_protocol::types::request::typed::{PlannedPath, WriteProgram};
use plc_protocol::types::state::{Execution, Reason};
use serde_json::json;
use tandem_gateway::{Gateway, GatewaySettings, MqttSettings, MtconnectSettings};
use tandem_runtime::{Config, Runtime};
use tempfile::TempDir;
use tokio::io::AsyncReadExt;
use tokio::net::TcpStream;

use crate::support::broker::Mosquitto;
use crate::support::http::try_request;
use crate::support::mqtt::Bus;
use crate::support::wait::{PATIENCE, until, until_within, within};
use Consequence::{Contained, Exits, Restarted};
use Trigger::{Get, MqttClient, MqttHold, MqttRequest, Nothing, Post, Reconnection, Shdr};

/// Condition for a task to run and reach its fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Trigger {
    /// The task runs without a trigger.
    Nothing,
    /// A request that reads over HTTP.
    Get,
    /// A command over HTTP.
    Post,
    /// A client of the embedded broker connects.
    MqttClient,
    MqttRequest,
    MqttHold,
    /// A reader connects to the adapter of MTConnect.
    Shdr,
    /// The external broker is lost and returns.
    Reconnection,
}

/// Tasks and threads of a machine with an embedded broker, and the consequence of a fault in each.
const TASKS: [(&str, Consequence, Trigger); 22] = [
    ("journal", Restarted, Nothing),
    ("state-writer", Restarted, Nothing),
    ("data-watch", Restarted, Nothing),
    ("preview", Restarted, Nothing),
    ("publisher of positions", Restarted, Nothing),
    ("publisher of presence", Restarted, Nothing),
    ("publisher of the time left", Restarted, Nothing),
    ("watch over outputs of the plant", Restarted, Nothing),
    ("watch over handlers over REST", Restarted, Nothing),
    ("HTTP connection", Contained, Get),
    ("request over REST", Contained, Post),
    ("request over MQTT", Contained, MqttRequest),
    ("urgent request over MQTT", Contained, MqttHold),
    ("MQTT connection", Contained, MqttClient),
    ("observer of MTConnect", Restarted, Nothing),
    ("tools of MTConnect", Restarted, Nothing),
    ("reader of SHDR", Contained, Shdr),
    ("adapter of MTConnect", Restarted, Nothing),
    ("task of a coordinate system", Exits, Nothing),
    ("embedded broker", Exits, Nothing),
    ("HTTP server", Exits, Nothing),
    ("replies to urgent MQTT commands", Exits, Nothing),
];

/// Tasks and threads of a machine with an external broker only.
const TASKS_AT_A_BROKER: [(&str, Consequence, Trigger); 3] = [
    ("listener to other machines", Restarted, Nothing),
    ("republisher of outputs", Contained, Reconnection),
    ("link to the MQTT broker", Exits, Nothing),
];

/// Tasks without a fault here, and the tests that inject their faults.
const ELSEWHERE: [(&str, &str); 4] = [
    ("last will of the link", "contained: supervisor::tests"),
    ("reader of the token file", "essential: supervisor::tests"),
    ("reader of the certificate", "essential: supervisor::tests"),
    ("sequence program of the demo", "contained: supervisor::tests"),
];

/// Returns the names of all tasks and threads.
pub fn names() -> impl Iterator<Item = &'static str> {
    let here = TASKS.iter().chain(&TASKS_AT_A_BROKER).map(|(name, ..)| *name);
    here.chain(ELSEWHERE.iter().map(|(name, _)| *name))
}

/// Two coordinate systems of one axis each.
const CONFIG: &str = r#"
[machine]
name = "faults"
servo_late_ms = 1500
data_dir = "data"

[[motor]]
number = 1
kind = "linear"
max_velocity = 500.0
max_acceleration = 5000.0

[[motor]]
number = 2
kind = "linear"
max_velocity = 500.0
max_acceleration = 5000.0

[[coordinate_system]]
number = 1
axes = { X = 1 }

[[coordinate_system]]
number = 2
axes = { X = 2 }
"#;

/// A program that moves for longer than any of these tests.
const PROGRAM: &str = "P1 = 0\nwhile (P1 < 1000) {\nP1 = P1 + 1\nG90 G01 X100 F600\nX0\n}\nM30\n";

/// A machine in this process with all its server ends.
struct Faulty {
    runtime: Runtime,
    gateway: Gateway,
    supervisor: Supervisor,
    plc: Plc,
    shdr: SocketAddr,
    mqtt: String,
    _folder: TempDir,
}

impl Faulty {
    async fn start() -> Self {
        let embedded = MqttSettings {
            embedded_listen: Some("127.0.0.1:0".to_owned()),
            ..MqttSettings::default()
        };
        Self::start_with(embedded).await
    }

    async fn start_at(broker: &Mosquitto) -> Self {
        let (host, port) = broker
            .address()
            .rsplit_once(':')
            .map(|(host, port)| (host.to_owned(), port.parse().unwrap()))
            .unwrap();
        let external = MqttSettings {
            embedded_listen: None,
            brokers: vec![(host, port)],
            ..MqttSettings::default()
        };
        let machine = Self::start_with(external).await;
        Bus::connect(&machine.mqtt, "faults").await;
        machine
    }

    async fn start_with(mqtt: MqttSettings) -> Self {
        let folder = TempDir::new().unwrap();
        let config = Config::from_toml(CONFIG, folder.path() as &Path).unwrap();
        let runtime = Runtime::start(config).await.unwrap();
        let shdr = free_address().await;
        let settings = GatewaySettings {
            machine: "faults".to_owned(),
            http_listen: "127.0.0.1:0".to_owned(),
            mtconnect: Some(MtconnectSettings {
                shdr_listen: Some(shdr.to_string()),
                ..MtconnectSettings::default()
            }),
            mqtt: mqtt.clone(),
            ..GatewaySettings::default()
        };
        let gateway = Gateway::start(runtime.served_port(), settings).await.unwrap();
        let mqtt = gateway.mqtt_addr().map_or_else(
            || format!("{}:{}", mqtt.brokers[0].0, mqtt.brokers[0].1),
            |address| address.to_string(),
        );
        let plc = Plc::in_process(runtime.port());
        let program = WriteProgram(1, PROGRAM.to_owned());
        plc.port().ask(program).await.unwrap();
        for cs in [1, 2] {
            plc.coordinate_system(cs).load(1).await.unwrap();
        }
        Self {
            supervisor: runtime.served_port().supervisor(),
            runtime,
            gateway,
            plc,
            shdr,
            mqtt,
            _folder: folder,
        }
    }

    async fn stop(self) {
        self.runtime.shutdown().await;
        self.gateway.shutdown().await;
    }

    async fn x(&self, cs: u8) -> f64 {
        self.plc.coordinate_system(cs).position().await.unwrap().machine["X"]
    }

    async fn moves(&self, cs: u8) {
        let before = self.x(cs).await;
        until("motion", async || {
            (self.x(cs).await.to_bits() != before.to_bits()).then_some(())
        })
        .await;
    }

    async fn run_all(&self) {
        for cs in [1, 2] {
            self.plc.coordinate_system(cs).start().await.unwrap();
            self.moves(cs).await;
        }
    }

    fn count(&self, task: &str) -> u64 {
        let faults = self.supervisor.faults().into_iter();
        faults
            .filter(|fault| fault.task == task)
            .map(|fault| fault.count)
            .sum()
    }

    /// Injects a fault, waits until it has occurred, and returns its consequence.
    async fn fault(&self, task: &str, trigger: Trigger) -> Consequence {
        let before = self.count(task);
        let bus = match trigger {
            MqttClient | MqttRequest | MqttHold => Some(Bus::connect(&self.mqtt, "faults").await),
            _ => None,
        };
        self.supervisor.inject(task);
        self.trigger(trigger, bus.as_ref()).await;
        until(task, async || (self.count(task) > before).then_some(())).await;
        let mut faults = self.supervisor.faults().into_iter();
        faults.find(|fault| fault.task == task).unwrap().consequence
    }

    async fn trigger(&self, trigger: Trigger, bus: Option<&Bus>) {
        let http = self.gateway.http_addr().to_string();
        let so_far: u64 = self.supervisor.faults().iter().map(|fault| fault.count).sum();
        let command = json!({"command_id": format!("command-{so_far}"), "client_id": "faults"});
        match trigger {
            // the answer is ignored, because the task of the request fails
            Get => drop(try_request(&http, "GET", "/api/v1/health", "", "").await),
            Post => {
                let path = "/api/v1/cs/2/resume";
                drop(try_request(&http, "POST", path, "application/json", "{}").await);
            }
            MqttRequest => bus.unwrap().publish("cs/2/command/resume", &command).await,
            MqttHold => bus.unwrap().publish("cs/1/command/hold", &command).await,
            Shdr => drop(
                TcpStream::connect(self.shdr)
                    .await
                    .unwrap()
                    .read(&mut [0; 64])
                    .await,
            ),
            Nothing | MqttClient | Reconnection => {}
        }
    }
}

async fn free_address() -> SocketAddr {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    listener.local_addr().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_contained_or_restarted_fault_stops_no_motion() {
    let machine = Faulty::start().await;
    for in_motion in [false, true] {
        if in_motion {
            machine.run_all().await;
        }
        for (task, follows, trigger) in TASKS.iter().filter(|(_, follows, _)| *follows < Exits) {
            assert_eq!(machine.fault(task, *trigger).await, *follows, "{task}");
            for cs in [1, 2] {
                let state = machine.plc.coordinate_system(cs).state().await.unwrap();
                let is_wanted = match (in_motion, *trigger) {
                    (false, _) => state.execution == Execution::Ready,
                    // the hold itself may have been executed
                    (true, MqttHold) if cs == 1 => true,
                    (true, _) => state.execution == Execution::Active,
                };
                assert!(is_wanted, "{task}: {state:?}");
                if in_motion && state.execution == Execution::Active {
                    machine.moves(cs).await;
                }
            }
            if in_motion && *trigger == MqttHold {
                // without the hold there is nothing to resume
                let _ = machine.plc.coordinate_system(1).resume().await;
                machine.moves(1).await;
            }
        }
    }
    for cs in [1, 2] {
        machine.plc.coordinate_system(cs).stop().await.unwrap();
    }
    machine.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fault_during_planning_begins_the_plan_again() {
    let machine = Faulty::start().await;
    let port = machine.plc.port();
    let endless = "while (1 == 1) {\nG90 G01 X1 F6000\nX0\n}\nM30\n";
    port.ask(WriteProgram(2, endless.to_owned())).await.unwrap();
    machine.plc.coordinate_system(1).load(2).await.unwrap();
    let tag = async || {
        port.ask(PlannedPath(2, PathQuery::default()))
            .await
            .ok()
            .map(|path| path.tag)
    };
    let planned = until("the beginning of the plan", &tag).await;
    assert_eq!(machine.fault("preview", Nothing).await, Restarted);
    // the plan in which the fault occurred may be the one that is returned first
    let limit = 4 * PATIENCE; // the planning thread has a low priority, so other tests take most of its time
    let new_plan = async || tag().await.filter(|tag| *tag != planned);
    let first = until_within(limit, "the new plan", new_plan).await;
    until_within(limit, "its growth", async || {
        tag().await.filter(|tag| *tag != first)
    })
    .await;
    machine.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fault_of_one_coordinate_system_stops_it_alone() {
    let machine = Faulty::start().await;
    let [first, second] = [1, 2].map(|cs| machine.plc.coordinate_system(cs));
    for in_motion in [false, true] {
        if in_motion {
            machine.run_all().await;
        } else {
            second.start().await.unwrap();
        }
        let follows = machine.fault("coordinate system 1", Nothing).await;
        assert_eq!(follows, Consequence::StopsCoordinateSystem);
        let stopped = within("the stop", first.wait_until(Execution::Stopped))
            .await
            .unwrap();
        assert_eq!(stopped.reason, Some(Reason::Alarm));
        let rest = machine.x(1).await;
        machine.moves(2).await;
        second.hold().await.unwrap();
        within("the hold", second.wait_until(Execution::FeedHold))
            .await
            .unwrap();
        second.resume().await.unwrap();
        machine.moves(2).await;
        assert_eq!(machine.x(1).await.to_bits(), rest.to_bits());
        second.stop().await.unwrap();
        within("the stop", second.wait_until(Execution::Stopped))
            .await
            .unwrap();
        for system in [&first, &second] {
            system.reset().await.unwrap();
            system.load(1).await.unwrap();
        }
    }
    machine.run_all().await;
    machine.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fault_of_an_essential_task_ends_the_runtime_in_order_with_its_name() {
    for (task, follows, trigger) in TASKS.iter().filter(|(_, follows, _)| *follows == Exits) {
        for in_motion in [false, true] {
            let machine = Faulty::start().await;
            if in_motion {
                machine.run_all().await;
            }
            assert_eq!(machine.fault(task, *trigger).await, *follows, "{task}");
            let why = within("the reason", machine.runtime.failed()).await;
            assert!(why.starts_with(task), "{why}");
            within("the end", machine.stop()).await;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn faults_of_tasks_at_an_external_broker_have_their_consequences() {
    for (task, follows, trigger) in TASKS_AT_A_BROKER {
        let mut broker = Mosquitto::start();
        let machine = Faulty::start_at(&broker).await;
        machine.run_all().await;
        machine.supervisor.inject(task);
        if trigger == Reconnection {
            broker.kill();
            tokio::time::sleep(Duration::from_millis(200)).await;
            broker.start_again();
        }
        until(task, async || (machine.count(task) > 0).then_some(())).await;
        assert_eq!(machine.supervisor.faults()[0].consequence, follows, "{task}");
        if follows == Exits {
            within("the reason", machine.runtime.failed()).await;
        } else {
            for cs in [1, 2] {
                machine.moves(cs).await;
            }
        }
        within("the end", machine.stop()).await;
    }
}
