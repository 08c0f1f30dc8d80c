//! A custom transport: a client end that implements `Port`, and a server end that serves any `Port`. Between
//! them only texts and requests pass, as over a wire. The sequence program is independent of the transport.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use plc_api::{Alarm, AuxOutput, Execution, Plc, SequenceProgram};
use plc_protocol::hub::{Filter, Hub, Subscription};
use plc_protocol::port::{BoxFuture, Port};
use plc_protocol::types::BootId;
use plc_protocol::types::message::Message;
use plc_protocol::types::request::{Answer, Refusal, RefusalCode, Request};
use plc_protocol::types::topic::Topic;
use tandem_testing::Bench;
use tokio::sync::{mpsc, oneshot};

use super::{costs, files_where};

type Asked = (Request, oneshot::Sender<Result<Answer, Refusal>>);

/// The client end.
struct Wire {
    hub: Hub,
    requests: mpsc::Sender<Asked>,
    // time does not pass over this wire: both ends keep the machine's clock
    clock: Arc<dyn Port>,
}

/// Connects a client end to any port; both ends run until the port ends.
async fn connect(server: Arc<dyn Port>) -> Arc<Wire> {
    let (requests, mut asked) = mpsc::channel::<Asked>(64);
    let (texts, mut heard) = mpsc::channel::<(String, String)>(64);
    let hub = Hub::new();
    // server end
    let mut said = server.subscribe(Filter::All);
    tokio::spawn(async move {
        while let Some(message) = said.next().await {
            if texts
                .send((message.topic.path(), message.to_json()))
                .await
                .is_err()
            {
                return;
            }
        }
    });
    let answering = Arc::clone(&server);
    tokio::spawn(async move {
        while let Some((request, answer)) = asked.recv().await {
            let port = Arc::clone(&answering);
            tokio::spawn(async move { answer.send(port.request(request).await) });
        }
    });
    // client end
    let (client, (present, online)) = (hub.clone(), oneshot::channel());
    tokio::spawn(async move {
        let mut present = Some(present);
        while let Some((path, text)) = heard.recv().await {
            let topic = Topic::parse(&path).expect("a topic of the interface");
            let message = Message::from_json(topic, text.as_bytes()).expect("a message of the interface");
            client.publish(message);
            if client.read(&Topic::Presence).is_some()
                && let Some(present) = present.take()
            {
                let _ = present.send(());
            }
        }
    });
    online.await.expect("the machine is present");
    Arc::new(Wire {
        hub,
        requests,
        clock: server,
    })
}

impl Port for Wire {
    fn boot_id(&self) -> BootId {
        self.hub
            .read(&Topic::Presence)
            .map(|message| message.boot_id.clone())
            .unwrap_or_default()
    }

    fn read<'a>(&'a self, topic: &'a Topic) -> BoxFuture<'a, Option<Arc<Message>>> {
        Box::pin(std::future::ready(self.hub.read(topic)))
    }

    fn subscribe(&self, filter: Filter) -> Subscription {
        self.hub.subscribe(filter)
    }

    fn request(&self, request: Request) -> BoxFuture<'_, Result<Answer, Refusal>> {
        Box::pin(async move {
            let gone = || Refusal::new(RefusalCode::Unavailable, "the wire is cut");
            let (answer, answered) = oneshot::channel();
            self.requests.send((request, answer)).await.map_err(|_| gone())?;
            answered.await.unwrap_or_else(|_| Err(gone()))
        })
    }

    fn sleep(&self, duration: Duration) -> BoxFuture<'_, ()> {
        self.clock.sleep(duration)
    }

    fn now_s(&self) -> f64 {
        self.clock.now_s()
    }
}

async fn take_tool(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    output.progress("half of it", 50.0).await?;
    plc.sleep(Duration::from_millis(250)).await;
    let tool = output.params().a().unwrap_or_default();
    plc.coordinate_system(output.coordinate_system())
        .select_tool(if tool > 8.0 { 9 } else { 5 })
        .await?;
    Ok(())
}

#[test]
fn a_sequence_program_runs_unchanged_over_a_transport_of_ones_own() {
    let program = "G00 X5\nM100 VA9\nG00 X0\nM30\n";
    let played = Bench::new().subprogram(500, program).play(async |_, runtime| {
        let wire = connect(runtime.port()).await;
        let plc = Plc::in_process(wire);
        let serving = plc.clone();
        let handlers =
            tokio::spawn(async move { SequenceProgram::new().on(100, take_tool).run(&serving).await });
        plc.sleep(Duration::from_millis(10)).await;
        let system = plc.coordinate_system(1);
        system.load(500).await.unwrap();
        system.start().await.unwrap();
        let waiting = system.wait_until(Execution::Wait).await.unwrap();
        assert_eq!(waiting.waiting_on.unwrap().m, 100);
        system.wait_until(Execution::ProgramCompleted).await.unwrap();
        assert_eq!(system.tool().await.unwrap().id, 9);
        handlers.abort();
    });
    played.unwrap();
}

#[test]
fn a_client_end_is_named_by_the_address_that_leads_to_it_and_nowhere_else() {
    for transport in ["rest", "mqtt"] {
        let path = format!("transport::{transport}::connect");
        let mut found = files_where("plc-api", ".rs", |code| code.contains(&path));
        found.extend(files_where("runtime", ".rs", |code| code.contains(&path)));
        assert_eq!(found, [Path::new("plc-api/src/plc.rs")], "{path}");
    }
    assert_eq!(
        costs("a transport"),
        ["Port", "Port", "Plc::connect", "plc-api/src/plc.rs"]
    );
}
