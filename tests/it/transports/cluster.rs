//! A broker of three nodes, with runtime, handler and HMI at one node each. A node is killed, or separated
//! from the others, during a program of M codes. Every run tests NATS Server: each node is killed once, and
//! one is separated. With `TANDEM_LONG` each node is also separated, and every broker is tested, which takes
//! minutes.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use plc_api::{Alarm, AuxOutput, MqttOptions, Plc, Redelivery, SequenceProgram};
use serde_json::json;

use super::machine;
use crate::support::aedes::aedes;
use crate::support::cluster::{Cluster, NODES};
use crate::support::mqtt::Bus;
use crate::support::nats::nats;
use crate::support::rmqtt::rmqtt;
use crate::support::served::Served;
use crate::support::wait::{until, until_within};

/// M codes of one run of the program.
const OUTPUTS: usize = 100;
/// The M code of the program, which waits for each output.
const PROGRAM: &str = "L0 = 0\nwhile (L0 < 100) {\nM100 VA[L0]\nL0 = L0 + 1\n}\nM30\n";
/// Time for which a node is offline.
const AWAY: Duration = Duration::from_secs(2);
/// Time for which a node is separated from the others: longer than nodes wait for each other.
const PARTED: Duration = Duration::from_secs(6);
/// Time limit for the nodes: on a busy computer they elect a leader repeatedly, and in the meantime refuse
/// and drop requests.
const NODES_PATIENCE: Duration = Duration::from_mins(5);
/// Nodes of the runtime, of the HMI and of the handler.
const RUNTIME: usize = 0;
const HMI: usize = 1;
const HANDLER: usize = 2;

/// Event of a node in the middle of a run.
#[derive(Debug, Clone, Copy)]
enum Trouble {
    /// The node is killed and started again.
    Dies(usize),
    /// The node is separated from the others, and joined again.
    IsParted(usize),
}

const SOME: [Trouble; 4] = [
    Trouble::Dies(RUNTIME),
    Trouble::Dies(HANDLER),
    Trouble::Dies(HMI),
    Trouble::IsParted(HANDLER),
];
const ALL: [Trouble; 6] = [
    Trouble::Dies(RUNTIME),
    Trouble::Dies(HANDLER),
    Trouble::Dies(HMI),
    Trouble::IsParted(RUNTIME),
    Trouble::IsParted(HANDLER),
    Trouble::IsParted(HMI),
];

/// Number of times that each output was executed, by its id.
type Done = Arc<Mutex<BTreeMap<String, u32>>>;

fn count(done: &Done) -> usize {
    done.lock().unwrap().len()
}

/// Runs the handler of M100 at its node, and at the others when that node is lost.
async fn serve(cluster: &Cluster, done: &Done) -> tokio::task::JoinHandle<()> {
    let order = [HANDLER, RUNTIME, HMI]
        .map(|node| cluster.address(node))
        .join(",");
    let options = MqttOptions {
        presence_expires: Duration::from_secs(15),
        ..MqttOptions::default()
    };
    let address = format!("mqtt://{order}/test-1");
    let plc = until("a machine there", async || {
        Plc::connect_with(&address, options.clone()).await.ok()
    })
    .await;
    let done = Arc::clone(done);
    tokio::spawn(async move {
        // an output that was pending at the loss is inspected before it is executed again
        let handler = move |output: AuxOutput| {
            let mut done = done.lock().unwrap();
            let times = done.entry(output.id().to_owned()).or_default();
            if *times == 0 || !output.redelivered() {
                *times += 1;
            }
            async { Ok::<(), Alarm>(()) }
        };
        let program = SequenceProgram::new()
            .handler_id("tool")
            .on_redelivery(Redelivery::Verify)
            .on(100, handler);
        let _ = program.run(&plc).await;
    })
}

fn is_long() -> bool {
    std::env::var_os("TANDEM_LONG").is_some()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nats_cluster_handles_each_output_once_at_node_loss_or_partition() {
    let rounds: &[Trouble] = if is_long() { &ALL } else { &SOME };
    each_output_is_done_once(nats().await, rounds).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn aedes_cluster_handles_each_output_once_at_node_loss_or_partition() {
    if is_long() {
        each_output_is_done_once(aedes().await, &ALL).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn rmqtt_cluster_handles_each_output_once_at_node_loss_or_partition() {
    if is_long() {
        each_output_is_done_once(rmqtt().await, &ALL).await;
    }
}

async fn befall(cluster: &mut Cluster, trouble: Trouble) {
    match trouble {
        Trouble::Dies(node) => {
            cluster.kill(node);
            // with a node offline NATS Server 2.9 may not answer new subscribers; requests wait
            tokio::time::sleep(AWAY).await;
            cluster.start_again(node);
        }
        Trouble::IsParted(node) => {
            cluster.part(node);
            tokio::time::sleep(PARTED).await;
            cluster.join(node);
        }
    }
}

async fn until_so(what: &str, mut is_so: impl AsyncFnMut() -> bool) {
    until_within(NODES_PATIENCE, what, async || is_so().await.then_some(())).await;
}

async fn completed(served: &Served, what: &str) {
    until_so(what, async || {
        served.state(1).await["execution"] == "PROGRAM_COMPLETED"
    })
    .await;
}

async fn each_output_is_done_once(mut cluster: Cluster, rounds: &[Trouble]) {
    let addresses: Vec<_> = (0..NODES)
        .map(|node| format!("\"mqtt://{}\"", cluster.address(node)))
        .collect();
    let machine = machine(&format!(
        "[http]\nlisten = \"127.0.0.1:0\"\n[mqtt]\nbroker = [{}]\n",
        addresses.join(", ")
    ));
    let config = std::fs::read_to_string(machine.config()).expect("its configuration");
    let config = config.replace("[machine]\n", "[machine]\npresence_expires_ms = 3000\n");
    machine.write(
        "tandem.toml",
        &config.replace("52 = \"twice.nc\"", "52 = \"hundred.nc\""),
    );
    machine.write("hundred.nc", PROGRAM);
    let served = Served::start(&machine);
    let hmi = Bus::connect(&cluster.address(HMI), "test-1").await;
    hmi.history.find("cs/1/state", |_| true).await;
    hmi.history.find("cs/1/m_code/pending", |_| true).await;

    let done = Done::default();
    let handlers = serve(&cluster, &done).await;
    served
        .post("/cs/1/load?wait=1", &json!({"program": 52}))
        .await
        .expect(200);
    served.command(1, "start").await;
    completed(&served, "the end of the first run").await;
    assert_eq!(count(&done), OUTPUTS);

    for (round, trouble) in rounds.iter().enumerate() {
        served.command(1, "start").await;
        let begun = (round + 1) * OUTPUTS;
        let before = format!("some outputs before {trouble:?}");
        until_so(&before, async || count(&done) >= begun + 20).await;
        befall(&mut cluster, *trouble).await;
        completed(&served, &format!("the end of the run after {trouble:?}")).await;
        assert_eq!(count(&done), begun + OUTPUTS, "after {trouble:?}");
        until_so(&format!("a node for the runtime after {trouble:?}"), async || {
            served.get("/health").await.expect(200).json()["status"] == "ok"
        })
        .await;
        let run = served.state(1).await["run_id"].clone();
        until_so(
            &format!("the end of the run at the HMI after {trouble:?}"),
            async || {
                let states = hmi.history.on("cs/1/state");
                let mut states = states.iter().filter(|state| state["run_id"] == run);
                states.any(|state| state["execution"] == "PROGRAM_COMPLETED")
            },
        )
        .await;
    }
    let twice: Vec<_> = done
        .lock()
        .unwrap()
        .iter()
        .filter(|(_, times)| **times > 1)
        .map(|(id, _)| id.clone())
        .collect();
    assert_eq!(twice, [] as [String; 0], "nothing is done twice");
    handlers.abort();
}
