//! The same sequence program over every transport: in process, over the embedded broker, over a Mosquitto, over REST.

mod acl;
mod alarms;
mod broker_loss;
mod cancel;
mod cluster;
mod control_lease;
mod crowd;
mod delayed;
mod handler_loss;
mod inputs;
mod instances;
mod late;
mod link_loss;
mod many_machines;
mod nodes;
mod operator;
mod presence;
mod private;
mod program;
mod raw_queue;
mod rest_handlers;
mod scan;
mod soak;
mod strict_broker;
mod tls;

use std::sync::Arc;

use plc_api::Plc;
use tandem_runtime::{Config, Runtime};

use crate::support::broker::Mosquitto;
use crate::support::machine::Machine;
use crate::support::served::{FREE_PORTS, Served};
use crate::support::wait::within;

/// Programs that come with the configuration: the keys belong to the coordinate system above them.
const PROGRAMS: &str = "programs = { 50 = \"tool.nc\", 51 = \"clamp.nc\", 52 = \"twice.nc\" }\n";

/// Without a handler M100 and M12 wait, so that a handler may connect later.
const M_CODES: &str =
    "[m_code.100]\nunhandled = \"wait\"\nwait_state = \"TOOL_LOAD\"\n[m_code.12]\nunhandled = \"wait\"\n";

/// Inputs and outputs of the plant, and published variables.
const IO: &str = "[io.in.level]\nkind = \"number\"\nunit = \"l\"\nmax = 60\n[io.out.lamp]\n\
                  [[variables.published]]\nfrom = \"P300\"\ncount = 2\n";

fn machine(mqtt: &str) -> Machine {
    let machine = Machine::new(&format!("{PROGRAMS}{M_CODES}{IO}{mqtt}"));
    machine.write("tool.nc", "G00 X5\nM100 VA7 VB-0.5\nG00 X9\nM30\n");
    machine.write("clamp.nc", "G00 X5\nM12 VA5\nG00 X9\nM30\n");
    machine.write("twice.nc", "M100 VA1\nM100 VA2\nM30\n");
    machine
}

/// An external broker, as a part of a configuration. Tests publish on topics without a sender as well.
pub fn broker_at(address: &str) -> String {
    format!(
        "[http]\nlisten = \"127.0.0.1:0\"\n[mqtt]\nbroker = \"mqtt://{address}\"\naccept_unverified_senders = true\n"
    )
}

/// A machine and its address. Dropping it ends the machine.
struct Reached {
    plc: Plc,
    /// Address for `Plc::connect`; empty in process.
    url: String,
    _keep: Vec<Arc<dyn Send + Sync>>,
    served: Option<Served>,
    runtime: Option<Runtime>,
}

async fn in_process() -> Reached {
    let machine = machine("");
    let config = Config::read(&machine.config()).expect("the configuration is good");
    let runtime = Runtime::start(config).await.expect("a runtime");
    Reached {
        plc: Plc::in_process(runtime.port()),
        url: String::new(),
        _keep: vec![Arc::new(machine)],
        served: None,
        runtime: Some(runtime),
    }
}

async fn over_the_embedded_broker() -> Reached {
    let machine = machine(FREE_PORTS);
    let served = Served::start(&machine);
    Reached {
        plc: connect(&served.mqtt_url()).await,
        url: served.mqtt_url(),
        _keep: vec![Arc::new(machine)],
        served: Some(served),
        runtime: None,
    }
}

async fn over_mosquitto() -> (Reached, Mosquitto) {
    over(Mosquitto::start()).await
}

async fn over(broker: Mosquitto) -> (Reached, Mosquitto) {
    let machine = machine(&broker_at(&broker.address()));
    let served = Served::start(&machine);
    let reached = Reached {
        plc: connect(&served.mqtt_url()).await,
        url: served.mqtt_url(),
        _keep: vec![Arc::new(machine)],
        served: Some(served),
        runtime: None,
    };
    (reached, broker)
}

async fn over_rest() -> Reached {
    let machine = machine(FREE_PORTS);
    let served = Served::start(&machine);
    Reached {
        plc: connect(&served.http_url()).await,
        url: served.http_url(),
        _keep: vec![Arc::new(machine)],
        served: Some(served),
        runtime: None,
    }
}

async fn connect(url: &str) -> Plc {
    within("Plc::connect", Plc::connect(url))
        .await
        .expect("a machine there")
}

impl Reached {
    fn served(&self) -> &Served {
        self.served.as_ref().expect("a served machine")
    }

    async fn end(self) {
        if let Some(runtime) = self.runtime {
            runtime.shutdown().await;
        }
    }
}
