//! Interruption of a run and its continuation: feed hold, the interlock, single block, a late servo, a lost broker
//! (`bus`).
//!
//! Single block ends each block with a stop of its own. Blocks that were planned before single block is switched on
//! keep their path. Such a block is held at its end point if it stops there, otherwise on the path shortly after its
//! joint with the next block.

use plc_protocol::types::handler::Departure;
use plc_protocol::types::output::HandlerPresence;
use plc_protocol::types::request::{Refusal, RefusalCode};
use plc_protocol::types::state::{Reason, Transition};
use tandem_interp::Modal;
use tandem_model::alarm::{COMPENSATION_REFUSED, HANDLER_LOST, SERVO_LATE};
use tandem_servo::Control;
use tandem_store::journal::Event;

use super::causes::{Cause, EarlyEndCause, JogStop};
use super::run_state::{Phase, RunEvent, Then};
use crate::coordinate_system::{CoordinateSystem, InputValues};

/// Reason for the alarm if single block would stop between blocks of cutter compensation.
pub(crate) const SINGLE_BLOCK_REFUSED: &str =
    "single block is on, and the motion cannot stop between blocks of cutter compensation";

impl CoordinateSystem {
    /// Starts feed hold; a jog is ended instead. Returns true if the caller need not wait: no run is active, or the run
    /// is at rest.
    pub(crate) fn hold(&mut self, cause: Cause) -> bool {
        if self.state.run().is_some_and(|run| run.is_jog()) {
            return self.end_run(EarlyEndCause::JogEnded(JogStop::Held(cause)));
        }
        self.drive(RunEvent::Hold(cause));
        self.state.transition() != Some(Transition::Holding)
    }

    /// Holds the run on behalf of the runtime and writes a journal line. A jog is ended instead; its client has to
    /// start a new jog. If an earlier hold still waits for the end of a thread, a cause that acts in the thread stops the
    /// motion at once.
    pub(crate) fn hold_for(&mut self, cause: Cause, reason: Reason) {
        let is_sooner = cause.acts_in_thread() && self.state.hold_may_wait();
        if !self.state.is_running() && !is_sooner {
            return;
        }
        let seq = self.state.awaited().map(|awaited| awaited.seq);
        self.hold(cause);
        // no journal line: a run at a program stop was at rest before the hold, and a jog is ended
        if self.state.is_running() || !self.state.has_run() {
            return;
        }
        let open = seq.and_then(|seq| self.outputs.ledger.get(seq));
        let m = open.map(|open| open.notice.m);
        self.context.record(Event::Hold { reason, m, seq });
    }

    /// Processes the servo's report that it was late by `cycles` servo cycles and therefore holds the motion. Raises a
    /// warning and holds the run; if no motion is pending, makes the servo resume instead.
    pub(crate) fn on_servo_late(&mut self, cycles: u64) {
        if self.rests_by_itself() {
            // the servo holds a motion that has just ended, so the run has no motion to hold
            self.servo.control(Control::Resume);
            return;
        }
        let late_s = cycles as f64 * self.context.configured.settings.servo_period_s;
        let text = format!(
            "the motors received no setpoints for {late_s:.3} s ({cycles} servo cycles); the motion is held \
             on its path"
        );
        self.context
            .warn_standing(&SERVO_LATE, Some(self.context.number), &text);
        self.inputs.clients.excuse(self.context.now_s());
        self.hold_for(Cause::ServoLate, Reason::ServoLate);
    }

    /// Returns true if no motion is pending: no run is active, or the run waits for an output or at a program stop.
    fn rests_by_itself(&self) -> bool {
        let waits = self.state.awaited().is_some() || matches!(self.state.phase(), Some(Phase::Paused(_)));
        self.state.is_idle() || self.state.is_running() && waits && !self.is_moving()
    }

    /// Does the work that a hold has delayed, when the run resumes: issues outputs and arms the hold of single block.
    pub(crate) fn resume_held_work(&mut self) {
        self.issue_queued_outputs();
        self.hold_after_planned_block();
    }

    /// Processes the servo's report that the motion rests in feed hold.
    pub(crate) fn on_servo_held(&mut self) {
        let steps = self.state.run_mut().map(|run| &mut run.steps);
        let behind_block = steps.is_some_and(|steps| std::mem::take(&mut steps.armed));
        self.drive(RunEvent::ServoHeld { behind_block });
    }

    /// Starts a hold if the interlock is on.
    pub(crate) fn follow_interlock(&mut self) {
        if self.inputs.interlock.is_on() {
            self.hold(Cause::Interlock);
        }
    }

    /// Processes the report that a handler is online.
    pub(crate) fn on_handler_online(&mut self, handler_id: &str, presence: &HandlerPresence) {
        self.inputs.interlock.mark_handler_online(handler_id);
        self.inputs.start_lock.mark_handler_online(handler_id);
        let now = self.context.now();
        self.outputs.ledger.handler_online(now, handler_id, presence);
        self.await_handler();
    }

    /// Processes the loss of a handler instance. Its outputs, interlocks and start locks wait for its return. After an
    /// unannounced loss, locks with `on_loss = "on"` are set on at once.
    pub(crate) fn on_handler_left(&mut self, handler_id: &str, instance: Option<&str>, departure: Departure) {
        let InputValues {
            interlock,
            start_lock,
            ..
        } = &mut self.inputs;
        // the locks come first: a fault in the outputs must not leave a lost source off
        let locks = interlock.mark_handler_offline(handler_id, departure)
            | start_lock.mark_handler_offline(handler_id, departure);
        let (now, grace_s) = (self.context.now(), self.context.shared.machine.handler_grace_s);
        self.outputs
            .on_handler_left(now, (handler_id, instance), departure, grace_s);
        self.await_handler();
        if locks {
            self.follow_interlock();
            self.publish_inputs();
        }
    }

    /// Raises the warnings about lost handlers that are due. If a lost handler has not returned within its time limit,
    /// its interlocks and start locks take the value of their `on_loss`.
    pub(crate) fn look_at_losses(&mut self, now_s: f64) {
        for (origin, text) in self.outputs.take_losses(now_s) {
            self.context.warn_of(&HANDLER_LOST, origin, &text);
        }
        let Self { inputs, context, .. } = self;
        let is_there = |id: &str| context.shared.is_online(id);
        let now_s = now_s + 1e-9;
        if inputs.interlock.expire(now_s, is_there) | inputs.start_lock.expire(now_s, is_there) {
            self.follow_interlock();
            self.publish_inputs();
        }
    }

    /// Refuses motion while the interlock is on.
    pub(crate) fn check_interlock(&self) -> Result<(), Refusal> {
        if !self.inputs.interlock.is_on() {
            return Ok(());
        }
        let why = self.inputs.interlock.text();
        let text = format!("the interlock is on: {why}");
        Err(Refusal::new(RefusalCode::StartLocked, text))
    }

    pub(crate) fn set_single_block(&mut self, on: bool) -> Result<(), Refusal> {
        if on == self.inputs.single_block {
            return Ok(());
        }
        if on && self.state.has_run() {
            let compensates = |modal: &Modal| modal.compensates().then_some("cutter compensation");
            let cycles = |modal: &Modal| modal.fixed_cycle().map(|cycle| cycle.name);
            let within = self.pipeline.anywhere(compensates);
            if let Some(within) = within.or_else(|| self.pipeline.anywhere(cycles)) {
                let text = format!(
                    "single block cannot be switched on within {within}, nor if {within} has already been \
                     read ahead; wait for its end"
                );
                return Err(Refusal::new(RefusalCode::NotAllowed, text));
            }
        }
        self.inputs.single_block = on;
        if self.state.run().is_some_and(|run| run.is_jog()) {
            // a jog is one block and ends at rest without single block
            return Ok(());
        }
        if on {
            if !self.single_block_waits() {
                self.stop_behind_what_is_planned();
            }
        } else if let Some(run) = self.state.run_mut()
            && std::mem::take(&mut run.steps.armed)
        {
            self.servo.control(Control::HoldAfterBlock(false));
        }
        Ok(())
    }

    /// Ends the planned motion at rest and holds it at the end of each planned block. The interpreter waits until then.
    pub(crate) fn stop_behind_what_is_planned(&mut self) {
        match self.state.phase() {
            None | Some(Phase::Standstill(Then::BlockEnd)) => return,
            Some(Phase::Interpret) => self.stand_still_then(Then::Interpret),
            Some(_) => {}
        }
        let moves = self.is_moving();
        if let Some(run) = self.state.run_mut()
            && moves
        {
            run.steps.planned_ahead = self.pipeline.planner.last_segment();
            run.steps.in_block = !self.pipeline.interpreter.is_between_blocks();
            if self.state.is_running() {
                self.hold_after_planned_block();
            }
        }
    }

    /// Includes blocks that were interpreted before single block was switched on in the hold at each block end.
    pub(crate) fn plan_ahead_of_single_block(&mut self) {
        if let Some(run) = self.state.run_mut()
            && self.inputs.single_block
        {
            run.steps.planned_ahead = self.pipeline.planner.last_segment();
        }
    }

    fn hold_after_planned_block(&mut self) {
        let Some(run) = self.state.run_mut() else { return };
        if self.inputs.single_block && self.servo.finished_segment < run.steps.planned_ahead {
            run.steps.armed = true;
            self.servo.control(Control::HoldAfterBlock(true));
        }
    }

    /// Returns true while planned motion has not reached its end.
    pub(crate) fn is_moving(&self) -> bool {
        !self.pipeline.ready.is_empty() || self.servo.finished_segment < self.pipeline.planner.last_segment()
    }

    /// At a standstill: if a hold was due at the end of the last block, ends that block without further reports of the
    /// servo.
    /// Returns true if this interrupts the run.
    pub(crate) fn end_planned_block(&mut self) -> bool {
        let Some(run) = self.state.run_mut() else {
            return false;
        };
        if !std::mem::take(&mut run.steps.armed) {
            return false;
        }
        self.drive(RunEvent::BlockEnded);
        self.servo.control(Control::HoldAfterBlock(false));
        true
    }

    /// In single block, interrupts the run after a block that ended with its own stop.
    pub(crate) fn on_block_ended(&mut self) {
        if !self.inputs.single_block {
            return;
        }
        // after M98, lines of the called program are still 0 because it has not begun
        let begun = self.pipeline.interpreter.call_stack();
        let origin = begun.filter(|at| at.line > 0).last();
        if let Some(origin) = origin {
            self.context.view.update(|place| place.executing = origin);
        }
        if self.pipeline.interpreter.modal().compensates() {
            return self.raise_entry(&COMPENSATION_REFUSED, SINGLE_BLOCK_REFUSED, origin);
        }
        self.drive(RunEvent::BlockEnded);
        let event = Event::Stop {
            m: None,
            reason: origin.map(|_| Reason::SingleBlock),
            program: origin.map(|at| at.program),
            line: origin.map(|at| at.line),
        };
        self.context.record(event);
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use plc_api::{Execution, Plc};
    use plc_protocol::types::machine::{AlarmRecord, AlarmSeverity};
    use plc_protocol::types::request::typed;
    use plc_protocol::types::state::Reason;
    use plc_protocol::types::topic::Topic;
    use tandem_model::alarm::SERVO_LATE;

    use tandem_runtime::Runtime;
    use tandem_store::journal::Event;
    use tandem_testing::{Bench, kept_journal};

    #[track_caller]
    fn close(position: f64, expected: f64) {
        assert!((position - expected).abs() < 1e-9, "{position} is not {expected}");
    }

    /// Delays the servo of a machine by `ms` milliseconds.
    fn delay(runtime: &Runtime, ms: u64) {
        runtime
            .simulation()
            .unwrap()
            .delay_servo(Duration::from_millis(ms));
    }

    async fn standing(plc: &Plc) -> Vec<AlarmRecord> {
        let message = plc.port().read(&Topic::AlarmActive).await.unwrap();
        match &message.payload {
            plc_protocol::types::message::Payload::AlarmActive(active) => active.alarms.clone(),
            other => panic!("{other:?}"),
        }
    }

    async fn x(plc: &Plc) -> f64 {
        plc.coordinate_system(1).position().await.unwrap().machine["X"]
    }

    /// Starts a program that moves X at 100 mm/s for one second.
    async fn under_way(plc: &Plc) {
        plc.coordinate_system(1).load(50).await.unwrap();
        plc.coordinate_system(1).start().await.unwrap();
        plc.sleep(Duration::from_secs(1)).await;
    }

    #[test]
    fn late_servo_in_motion_holds_with_a_warning_until_reset_and_can_resume() {
        let (journal, lines) = kept_journal();
        let bench = Bench::new()
            .journal(journal)
            .subprogram(50, "G01 X290 Y29 F6000\nM30\n");
        let play = bench.play(async |scene, runtime| {
            let (plc, system) = (scene.plc(), scene.cs(1));
            under_way(plc).await;
            let stood = x(plc).await;
            delay(runtime, 2000);
            let held = system.wait_until(Execution::FeedHold).await.unwrap();
            assert_eq!(held.reason, Some(Reason::ServoLate));
            let position = system.position().await.unwrap();
            let rests = position.machine["X"];
            assert!(
                rests > stood && rests < stood + 25.0,
                "it brakes on: {stood} {rests}"
            );
            close(position.machine["Y"], rests / 10.0);
            let warnings = standing(plc).await;
            assert_eq!(warnings.len(), 1);
            let warning = &warnings[0];
            assert_eq!(
                (warning.number, warning.severity),
                (SERVO_LATE.number, AlarmSeverity::Warning)
            );
            assert!(
                warning.text.contains("2.000 s") && warning.text.contains("2000 servo cycles"),
                "{warning:?}"
            );
            assert_eq!(warning.cs, Some(1));
            plc.sleep(Duration::from_secs(10)).await;
            close(x(plc).await, rests);
            system.resume().await.unwrap();
            system.wait_until(Execution::ProgramCompleted).await.unwrap();
            close(x(plc).await, 290.0);
            assert_eq!(standing(plc).await.len(), 1, "until a reset");
            system.reset().await.unwrap();
            assert!(standing(plc).await.is_empty());
            let history = plc.port().ask(typed::AlarmHistory).await.unwrap();
            assert_eq!(history.len(), 1);
        });
        play.unwrap();
        let lines = lines.lock().unwrap();
        let hold = lines.iter().find_map(|line| match line.event {
            Event::Hold { reason, m, seq } => Some((reason, m, seq)),
            _ => None,
        });
        assert_eq!(hold, Some((Reason::ServoLate, None, None)));
    }

    #[test]
    fn what_is_allowed_holds_nothing_and_one_cycle_more_holds() {
        for (ms, execution) in [(99, Execution::Active), (100, Execution::FeedHold)] {
            let bench = Bench::new().subprogram(50, "G01 X290 F6000\nM30\n");
            let play = bench.play(async move |scene, runtime| {
                under_way(scene.plc()).await;
                delay(runtime, ms);
                scene.plc().sleep(Duration::from_secs(1)).await;
                scene.cs(1).state().await.unwrap().execution
            });
            assert_eq!(play, Ok(execution), "{ms} ms");
        }
    }

    #[test]
    fn a_servo_that_is_late_at_rest_holds_nothing() {
        let bench = Bench::new().subprogram(50, "G04 X60\nG01 X10 F6000\nM30\n");
        let play = bench.play(async |scene, runtime| {
            delay(runtime, 30_000);
            scene.plc().sleep(Duration::from_secs(1)).await;
            under_way(scene.plc()).await;
            delay(runtime, 30_000);
            scene.cs(1).wait_until(Execution::ProgramCompleted).await.unwrap();
            assert!(standing(scene.plc()).await.is_empty());
        });
        play.unwrap();
    }

    #[test]
    fn late_servo_ends_a_jog_and_holds_manual_data_input_and_homing() {
        let play = Bench::new().play(async |scene, runtime| {
            let (plc, system) = (scene.plc(), scene.cs(1));
            let jogger = scene.cs(1);
            let jog = tokio::spawn(async move { jogger.jog('X', 6000.0, None, "j").await });
            plc.sleep(Duration::from_millis(150)).await;
            let stood = x(plc).await;
            delay(runtime, 120);
            let ended = jog.await.unwrap().unwrap_err();
            assert!(ended.to_string().contains("the servo was late"), "{ended}");
            assert_eq!(system.state().await.unwrap().execution, Execution::Ready);
            let rests = x(plc).await;
            assert!(rests < stood + 25.0, "{stood} {rests}");
            let refused = system.jog('X', 6000.0, None, "j").await;
            assert!(refused.is_err(), "a refresh does not restart the jog");
            assert_eq!(standing(plc).await.len(), 1);
            for home in [false, true] {
                let moving = scene.cs(1);
                let run = tokio::spawn(async move {
                    if home {
                        moving.home(&['X']).await
                    } else {
                        moving.mdi("G90 G01 X290 F6000").await
                    }
                });
                plc.sleep(Duration::from_millis(200)).await;
                delay(runtime, 2000);
                let held = system.wait_until(Execution::FeedHold).await.unwrap();
                assert_eq!(held.reason, Some(Reason::ServoLate), "home: {home}");
                system.resume().await.unwrap();
                run.await.unwrap().unwrap();
                close(x(plc).await, if home { 0.0 } else { 290.0 });
            }
        });
        play.unwrap();
    }
}
