//! Several machines on one broker, and on two brokers with a bridge between them: nothing of one reaches another.

use std::sync::{Arc, Mutex};

use plc_api::{Alarm, AuxOutput, Execution, Plc, SequenceProgram};
use plc_protocol::types::state::Reason;

use super::connect;
use crate::support::broker::Mosquitto;
use crate::support::machine::{COORDINATE_SYSTEMS, MOTORS, Machine};
use crate::support::served::Served;
use crate::support::wait::within;

/// Outputs of M100 in a program.
const OUTPUTS: u32 = 20;

/// Returns a machine whose program 50 issues M100 with VA 1 to [`OUTPUTS`] and its own number in VB.
fn machine(name: &str, number: u32, broker: &Mosquitto) -> (Machine, Served) {
    below("", name, number, broker)
}

/// Returns this machine below a topic prefix.
fn below(prefix: &str, name: &str, number: u32, broker: &Mosquitto) -> (Machine, Served) {
    let lines: Vec<String> = (1..=OUTPUTS)
        .map(|n| format!("M100 VA{n} VB{number}\n"))
        .collect();
    let machine = Machine::with_config(&format!(
        "[machine]\nname = \"{name}\"\n{MOTORS}{COORDINATE_SYSTEMS}programs = {{ 50 = \"main.nc\" }}\n\
         [m_code.100]\nunhandled = \"wait\"\n[http]\nlisten = \"127.0.0.1:0\"\n[mqtt]\nbroker = \"mqtt://{}\"\n\
         prefix = \"{prefix}\"\n",
        broker.address()
    ));
    machine.write("main.nc", &format!("{}M30\n", lines.concat()));
    let served = Served::start(&machine);
    (machine, served)
}

/// VA and VB of the outputs that a handler served.
type Seen = Arc<Mutex<Vec<[Option<f64>; 2]>>>;

/// Serves M100 under one common handler id, and records the machine of each output.
fn serve(plc: &Plc) -> (Seen, tokio::task::JoinHandle<()>) {
    let seen = Seen::default();
    let sink = Arc::clone(&seen);
    let handler = move |output: AuxOutput| {
        let params = output.params();
        sink.lock().unwrap().push([params.a(), params.b()]);
        async { Ok::<(), Alarm>(()) }
    };
    let serving = plc.clone();
    let handlers = tokio::spawn(async move {
        let program = SequenceProgram::new().handler_id("clamp").on(100, handler);
        program.run(&serving).await.expect("it serves until it is ended");
    });
    (seen, handlers)
}

/// Both machines run at once, each with a handler of the same name; then one is stopped and raises an alarm.
async fn nothing_of_one_machine_reaches_the_other(first: Plc, second: Plc) {
    let (first_seen, first_handlers) = serve(&first);
    let (second_seen, second_handlers) = serve(&second);
    let systems = [first.coordinate_system(1), second.coordinate_system(1)];
    for system in &systems {
        within("load", system.load(50)).await.expect("load");
    }
    for system in &systems {
        within("start", system.start()).await.expect("start");
    }
    for system in &systems {
        let completed = system.wait_until(Execution::ProgramCompleted);
        within("completed", completed).await.expect("a state");
    }
    for (number, seen) in [(1.0, first_seen), (2.0, second_seen)] {
        let expected: Vec<_> = (1..=OUTPUTS)
            .map(|n| [Some(f64::from(n)), Some(number)])
            .collect();
        assert_eq!(
            *seen.lock().unwrap(),
            expected,
            "machine {number}: its own, each once"
        );
    }
    first_handlers.abort();
    let _ = first_handlers.await;

    within("start", systems[1].start()).await.expect("start");
    within("start", systems[0].start()).await.expect("start");
    let waits = systems[0].wait_until(Execution::Wait);
    within("nobody handles M100 of the first one", waits)
        .await
        .expect("a state");
    within("stop", systems[0].stop()).await.expect("stop");
    let completed = systems[1].wait_until(Execution::ProgramCompleted);
    let state = within("the other one completes", completed)
        .await
        .expect("a state");
    assert_eq!((state.reason, state.alarm_count), (None, 0));
    let state = within("state", systems[0].state()).await.expect("a state");
    assert_eq!(
        (state.execution, state.reason),
        (Execution::Stopped, Some(Reason::Stop))
    );
    second_handlers.abort();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn on_one_broker_nothing_of_one_machine_reaches_another() {
    let broker = Mosquitto::start();
    let (_first, first) = machine("mill-a", 1, &broker);
    let (_second, second) = machine("mill-b", 2, &broker);
    let reach =
        async |served: &Served, name: &str| connect(&format!("mqtt://{}/{name}", served.broker)).await;
    nothing_of_one_machine_reaches_the_other(reach(&first, "mill-a").await, reach(&second, "mill-b").await)
        .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn machines_of_one_name_are_told_apart_by_their_topic_prefixes() {
    let broker = Mosquitto::start();
    let (_first, first) = below("", "mill-a", 1, &broker);
    let (_second, second) = below("hall/cell-2", "mill-a", 2, &broker);
    let (first, second) = (&first.broker, &second.broker);
    let first = connect(&format!("mqtt://{first}/mill-a")).await;
    let second = connect(&format!("mqtt://{second}/hall/cell-2/mill-a")).await;
    nothing_of_one_machine_reaches_the_other(first, second).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn over_a_bridge_handlers_reach_their_machine_and_no_other() {
    let hall = Mosquitto::start();
    let cell = Mosquitto::bridged_to(&hall);
    let (_first, _first_served) = machine("mill-a", 1, &hall);
    let (_second, _second_served) = machine("mill-b", 2, &cell);
    // Each handler is on the other side of the bridge.
    let first = connect(&format!("mqtt://{}/mill-a", cell.address())).await;
    let second = connect(&format!("mqtt://{}/mill-b", hall.address())).await;
    nothing_of_one_machine_reaches_the_other(first, second).await;
}
