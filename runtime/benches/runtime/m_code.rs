//! Times of an M code: output, claim, handler, reset, next block.
//!
//! A program of blocks `M100 VA1` runs, and a handler that returns at once resets each M code: in the runtime's process
//! without any server end, in the same process with server ends, over the embedded broker, and over a Mosquitto. All
//! times begin when the runtime publishes the output. They end when the reset takes effect, and when the next block's
//! output is published, both by the time stamps of the runtime's messages. The output is claimed in the step that
//! issues it (rule H20).
//!
//! If the next block moves, its first setpoint follows in the next servo cycle, up to one servo period later.
//!
//! Measured on a 2-core Xeon virtual machine without other load, bench profile; medians, the lowest and the highest of
//! three runs, and the highest p99:
//!
//! | from the output to | no server end | in process | embedded broker | Mosquitto |
//! | --- | --- | --- | --- | --- |
//! | reset counts | 4 µs, p99 33 µs | 5 to 6 µs, 36 µs | 0.27 to 0.29 ms, 0.87 ms | 0.29 to 0.30 ms, 0.89 ms |
//! | next output | 12 µs, p99 1.1 ms | 14 to 20 µs, 0.8 ms | 0.29 to 0.31 ms, 0.91 ms | 0.31 to 0.32 ms, 0.92 ms |
//!
//! For comparison, measured alternately with these: when the claim was a separate message, and outputs were not written
//! ahead of their notice, the times were 10 to 12 µs in process, 0.62 to 0.65 ms over the embedded broker, and 0.42 to
//! 0.51 ms over Mosquitto. The line that is written ahead takes 2 µs of the 12. The p99 in process is a servo period:
//! sometimes the next block waits for a servo cycle.
//!
//! The runtime reaches its embedded broker without a socket. With TCP, measured alternately with these, it took 0.44 to
//! 0.50 ms to the next output, p99 1.05 ms, with about 50 system calls for each M code.
//!
//! Each message is written while the next one is created. Measured alternately with a version that creates all messages
//! first, on a 2-core AMD EPYC virtual machine, medians of six runs to the next output: embedded broker 0.35 against
//! 0.41 ms, Mosquitto 0.41 against 0.43 ms. With Mosquitto, both processors are busy 86 percent of the time. A quarter
//! of that is in Mosquitto, and 42 percent is sending by the runtime and the handler, because the client library writes
//! each message separately.
//!
//! The position in the program is published at most 5 times a second. Measured alternately with one message for each M
//! code, on the same machine, medians of four runs to the next output: embedded broker 0.31 against 0.34 ms, Mosquitto
//! 0.32 against 0.38 ms; the highest p99 was 1.23 ms.
//!
//! In process, the handler's own thread executes claim, reset and the following steps; nearly all of the time is
//! computing.
//!
//! Over the broker there are two messages in sequence: the pending output and the reset.

use std::time::{Duration, SystemTime};

use plc_api::{Alarm, AuxOutput, Execution, Plc, SequenceProgram};
use plc_protocol::hub::{Filter, Subscription};
use plc_protocol::types::message::Payload;
use plc_protocol::types::output::{HandshakeStatus, OutputAct};
use plc_protocol::types::request::typed::{Handlers, WriteProgram};
use plc_protocol::types::topic::{CsTopic, Topic};

use crate::machine::{self, Machine};
use crate::mosquitto::Mosquitto;
use crate::table::{Durations, say};

/// Number of outputs of a program that are not counted, because connections and memory warm up.
const WARM_UP: usize = 200;

/// Number of outputs of a program that are counted. Reason: all their events fit into a subscription, which is read
/// after the end. Waiting for each message would wake the reader each time and change the measured times.
const OUTPUTS: usize = 1000;

/// Number of runs of the program.
const RUNS: usize = 4;

pub async fn run() -> anyhow::Result<()> {
    say("M code, from output: handler in the runtime's process, nobody on the network");
    let (runtime, folder) = machine::alone(machine::CONFIG).await?;
    let plc = Plc::in_process(runtime.port());
    measure(&plc, plc.clone()).await?;
    runtime.shutdown().await;
    drop(folder);

    say("M code, from output: handler in the runtime's process");
    let machine = Machine::start().await?;
    measure(&machine.in_process(), machine.in_process()).await?;
    machine.stop().await;

    say("M code, from output: handler over the embedded broker");
    let machine = Machine::start().await?;
    measure(&machine.in_process(), machine.over_mqtt().await?).await?;
    machine.stop().await;

    say("M code, from output: handler over Mosquitto");
    let broker = Mosquitto::start()?;
    let machine = Machine::start_at(broker.settings()).await?;
    measure(&machine.in_process(), broker.connect().await?).await?;
    machine.stop().await;
    Ok(())
}

pub async fn at_once(_output: AuxOutput) -> Result<(), Alarm> {
    Ok(())
}

async fn measure(plc: &Plc, handlers: Plc) -> anyhow::Result<()> {
    let serving = tokio::spawn(async move {
        SequenceProgram::new()
            .handler_id("bench")
            .on(100, at_once)
            .run(&handlers)
            .await
    });
    until_served(plc).await?;
    let text = "M100 VA1\n".repeat(WARM_UP + OUTPUTS) + "M30\n";
    plc.port().ask(WriteProgram(1, text)).await?;
    let topics = [CsTopic::Output(100), CsTopic::Result(100)].map(|topic| Topic::cs(1, topic));
    let cs = plc.coordinate_system(1);
    cs.load(1).await?;
    let mut times = Times::default();
    for _ in 0..RUNS {
        let subscription = plc.port().subscribe(Filter::Topics(topics.to_vec()));
        cs.start().await?;
        // polled at intervals, for the same reason
        loop {
            tokio::time::sleep(Duration::from_millis(5)).await;
            if cs.state().await?.execution == Execution::ProgramCompleted {
                break;
            }
        }
        times.add(subscription)?;
    }
    times.say();
    serving.abort();
    Ok(())
}

/// Waits until the handler `bench` is registered at the machine.
pub async fn until_served(plc: &Plc) -> anyhow::Result<()> {
    loop {
        let handlers = plc.port().ask(Handlers).await?;
        if handlers.get("bench").is_some_and(|handler| handler.online) {
            return Ok(());
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

#[derive(Debug, Default)]
struct Times {
    reset: Durations,
    next: Durations,
}

impl Times {
    /// Messages of a program, from its first output to its end.
    fn add(&mut self, mut subscription: Subscription) -> anyhow::Result<()> {
        anyhow::ensure!(subscription.dropped_events() == 0, "messages were lost");
        let mut outputs = 0;
        let mut output_at: Option<SystemTime> = None;
        while let Some(message) = subscription.try_next() {
            let at = message
                .ts
                .to_system_time()
                .ok_or_else(|| anyhow::anyhow!("a message has no time"))?;
            let since = output_at.and_then(|output_at| at.duration_since(output_at).ok());
            let since = since.filter(|_| outputs > WARM_UP);
            match &message.payload {
                Payload::Output(_) => {
                    self.next.push_some(since);
                    outputs += 1;
                    output_at = Some(at);
                }
                Payload::Result(result)
                    if result.status == HandshakeStatus::Accepted && result.of == Some(OutputAct::Reset) =>
                {
                    self.reset.push_some(since);
                }
                other => anyhow::bail!("not expected: {other:?}"),
            }
        }
        anyhow::ensure!(outputs == WARM_UP + OUTPUTS, "{outputs} outputs");
        Ok(())
    }

    fn say(mut self) {
        say(&format!("  reset counts   {}", self.reset.line()));
        say(&format!("  next output    {}", self.next.line()));
    }
}
