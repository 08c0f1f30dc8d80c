//! Loss of the MQTT broker with `[mqtt] on_bus_loss = "hold_at_wait"`. Motion continues; a run that waits for an output
//! is held, because the handler that resets the output may be unreachable.
//!
//! A run is held once per output and loss, so that an operator may resume the run without a broker. A reset that
//! arrives over another transport during the hold is stored until the run resumes, as during any hold.

use std::sync::atomic::Ordering;

use plc_protocol::types::state::Reason;
use tandem_store::journal::Event;

use crate::coordinate_system::CoordinateSystem;
use crate::coordinate_system::run::causes::Cause;

/// Connection to the MQTT broker, as last seen by this coordinate system.
#[derive(Debug, Default)]
pub(crate) struct Bus {
    is_lost: bool,
    /// Number (`seq`) of the last output at which the run was held since the loss.
    held_at: Option<u64>,
}

impl CoordinateSystem {
    /// Notes a change of the broker connection since the last turn. The MQTT server end reports the connection.
    pub(crate) fn look_at_bus(&mut self) {
        let connected = self.context.shared.bus_connected.load(Ordering::Relaxed);
        if connected != self.inputs.bus.is_lost {
            return;
        }
        self.inputs.bus.is_lost = !connected;
        self.inputs.bus.held_at = None;
        self.context.record(Event::Bus { connected });
    }

    /// Holds the run if the broker is lost, the run waits for an output, and the machine is at rest.
    pub(crate) fn hold_without_bus(&mut self) {
        if !self.inputs.bus.is_lost || !self.context.shared.machine.hold_on_bus_loss {
            return;
        }
        let awaited = self.state.awaited().map(|awaited| awaited.seq);
        let Some(seq) = awaited.filter(|seq| self.inputs.bus.held_at != Some(*seq)) else {
            return;
        };
        // A thread (tapping) is not interrupted.
        if !self.state.is_running() || self.is_moving() || self.pipeline.in_thread {
            return;
        }
        self.inputs.bus.held_at = Some(seq);
        self.hold_for(Cause::BusLoss, Reason::BusLost);
    }
}

#[cfg(test)]
mod tests {
    use plc_api::{Execution, Plc};
    use plc_protocol::server::ServedPort;
    use plc_protocol::server::ServerNotice::BusLink;
    use plc_protocol::types::output::{Reset, ResetResult};
    use plc_protocol::types::request::typed;
    use plc_protocol::types::state::{Reason, State};

    use tandem_runtime::{Config, UnhandledReaction};
    use tandem_store::journal::{Event, Line};
    use tandem_testing::{Bench, kept_journal};

    /// Runs a test on a machine that holds at WAIT, with this program started; returns the journal.
    fn with_run(
        text: &str,
        hold_on_bus_loss: bool,
        test: impl AsyncFnOnce(&Plc, &dyn ServedPort) + Send + 'static,
    ) -> Vec<Line> {
        let mut machine = Config::demo().resolve().unwrap();
        machine.hold_on_bus_loss = hold_on_bus_loss;
        machine.unhandled = UnhandledReaction::Wait;
        let (journal, lines) = kept_journal();
        let bench = Bench::on_machine(machine).journal(journal).subprogram(50, text);
        bench
            .play(async move |scene, runtime| {
                scene.cs(1).load(50).await.unwrap();
                scene.cs(1).start().await.unwrap();
                test(scene.plc(), &*runtime.served_port()).await;
            })
            .unwrap();
        let lines = lines.lock().unwrap();
        lines.iter().filter(|line| line.cs == 1).cloned().collect()
    }

    async fn reset(plc: &Plc) {
        let pending = plc.coordinate_system(1).pending().await.unwrap();
        let reset = Reset {
            boot_id: plc.port().boot_id(),
            seq: pending.outputs[0].output.seq,
            handler_id: "operator".to_owned(),
            result: ResetResult::Ok,
            code: None,
            text: None,
            force: None,
            instance: None,
        };
        plc.port().ask(typed::Reset(1, None, reset)).await.unwrap();
    }

    async fn until(plc: &Plc, execution: Execution) -> State {
        plc.coordinate_system(1).wait_until(execution).await.unwrap()
    }

    #[test]
    fn waiting_run_is_held_when_the_broker_is_lost_and_a_reset_is_latched() {
        let lines = with_run("M77\nM30\n", true, async |plc, served| {
            until(plc, Execution::Wait).await;
            served.notice(BusLink {
                connected: false,
                broker: None,
            });
            let held = until(plc, Execution::FeedHold).await;
            assert_eq!(held.reason, Some(Reason::BusLost));
            assert_eq!(held.waiting_on.map(|on| on.m), Some(77));
            reset(plc).await;
            plc.sleep(std::time::Duration::from_secs(5)).await;
            let held = plc.coordinate_system(1).state().await.unwrap();
            assert_eq!((held.execution, held.waiting_on), (Execution::FeedHold, None));
            served.notice(BusLink {
                connected: true,
                broker: None,
            });
            plc.sleep(std::time::Duration::from_secs(5)).await;
            let held = plc.coordinate_system(1).state().await.unwrap();
            assert_eq!(
                held.execution,
                Execution::FeedHold,
                "nothing resumes without a command"
            );
            plc.coordinate_system(1).resume().await.unwrap();
            until(plc, Execution::ProgramCompleted).await;
        });
        let hold = lines.iter().find_map(|line| match line.event {
            Event::Hold { reason, m, .. } => Some((reason, m)),
            _ => None,
        });
        assert_eq!(hold, Some((Reason::BusLost, Some(77))));
        let connected = lines.iter().filter_map(|line| match line.event {
            Event::Bus { connected } => Some(connected),
            _ => None,
        });
        assert!(connected.eq([false, true]));
    }

    #[test]
    fn motion_continues_without_broker_until_a_wait_and_operator_can_resume() {
        with_run("G01 X50 F600\nM77\nM78\nM30\n", true, async |plc, served| {
            plc.sleep(std::time::Duration::from_secs(1)).await;
            served.notice(BusLink {
                connected: false,
                broker: None,
            });
            plc.sleep(std::time::Duration::from_secs(1)).await;
            let state = plc.coordinate_system(1).state().await.unwrap();
            assert_eq!(state.execution, Execution::Active, "5 s of motion are under way");
            until(plc, Execution::FeedHold).await;
            let position = plc.coordinate_system(1).position().await.unwrap();
            assert!((position.work["X"] - 50.0).abs() < 1e-9, "{position:?}");
            plc.coordinate_system(1).resume().await.unwrap();
            let state = plc.coordinate_system(1).state().await.unwrap();
            assert_eq!(state.execution, Execution::Wait, "once for each output");
            reset(plc).await;
            let held = until(plc, Execution::FeedHold).await;
            assert_eq!(held.waiting_on.map(|on| on.m), Some(78));
        });
    }

    #[test]
    fn unclaimed_output_is_republished_when_the_server_end_reconnects() {
        with_run("M77\nM30\n", false, async |plc, served| {
            until(plc, Execution::Wait).await;
            assert_eq!(
                served.servo_timing(),
                None,
                "in simulated time there is no servo thread"
            );
            served.republish().await;
            let pending = plc.coordinate_system(1).pending().await.unwrap();
            let output = &pending.outputs[0].output;
            assert_eq!((output.m, output.attempt, output.redelivered), (77, 2, true));
        });
    }

    #[test]
    fn without_the_setting_the_program_waits_as_ever() {
        with_run("M77\nM30\n", false, async |plc, served| {
            until(plc, Execution::Wait).await;
            served.notice(BusLink {
                connected: false,
                broker: None,
            });
            reset(plc).await;
            until(plc, Execution::ProgramCompleted).await;
        });
    }
}
