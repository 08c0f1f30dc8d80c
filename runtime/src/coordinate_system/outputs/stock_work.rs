//! Work of the stock sequence program: tool changes and the spindle, for M codes without a handler.

use plc_protocol::handshake::Now;
use plc_protocol::types::output::{Reset, ResetResult};
use plc_protocol::types::request::{OutputRequest, Refusal, RefusalCode};
use plc_protocol::types::state::SpindleDirection;
use tandem_servo::Control;

use super::output_ledger::{SpindleGoal, StockWork};
use crate::coordinate_system::CoordinateSystem;
use crate::sequence::stock::StockAction;

/// Handler id of the stock sequence program.
const STOCK_HANDLER: &str = "stock";

impl CoordinateSystem {
    /// Starts the work for an output; the output is reset when the work is done.
    pub(crate) fn start_stock_work(&mut self, seq: u64, action: StockAction, simulated_s: f64) {
        let mut awaits = None;
        match action {
            StockAction::Nothing => {}
            StockAction::SelectTool(id) => {
                self.inputs.tool = Some(id);
                self.publish_tool();
            }
            StockAction::Spindle(SpindleDirection::Orient) => {
                self.turn_spindle(SpindleDirection::Orient, 0.0);
                awaits = Some(SpindleGoal::Orientation);
            }
            StockAction::Spindle(direction) => {
                let rpm = self.pipeline.interpreter.modal().spindle_speed_r_min;
                self.turn_spindle(direction, rpm);
                if matches!(direction, SpindleDirection::Cw | SpindleDirection::Ccw) {
                    self.inputs.spindle_at_s_from = Some(self.pipeline.next_segment());
                }
                awaits = Some(SpindleGoal::Speed { id: 0 });
            }
        }
        self.outputs.stock.push(StockWork {
            seq,
            due_s: self.context.now_s() + simulated_s,
            awaits,
        });
        self.await_spindle();
    }

    pub(crate) fn do_stock_work(&mut self, now: Now) {
        self.finish_stock_work(|work| work.awaits.is_none() && work.due_s <= now.monotonic_s + 1e-9);
    }

    pub(crate) fn on_oriented(&mut self) {
        self.publish_spindle();
        self.end_waits_for_spindle(|goal| goal == SpindleGoal::Orientation);
    }

    /// Processes the servo's report that the spindle has reached the speed commanded before the wait `id` began.
    pub(crate) fn on_spindle_reached(&mut self, id: u64) {
        self.publish_spindle();
        self.end_waits_for_spindle(|goal| matches!(goal, SpindleGoal::Speed { id: of } if of <= id));
    }

    fn end_waits_for_spindle(&mut self, is_reached: impl Fn(SpindleGoal) -> bool) {
        for work in &mut self.outputs.stock {
            if work.awaits.is_some_and(&is_reached) {
                work.awaits = None;
            }
        }
        self.do_stock_work(self.context.now());
    }

    /// Makes the outputs that wait for a spindle speed wait for the speed that is commanded now. At override 0 percent
    /// they wait until the override is raised, because a spindle at rest would already be at the commanded speed.
    fn await_spindle(&mut self) {
        let Some(spindle) = &self.context.configured.settings.spindle else {
            return;
        };
        self.inputs.spindle_waits += 1;
        let id = self.inputs.spindle_waits;
        let mut waiting = Vec::new();
        for work in &mut self.outputs.stock {
            if let Some(SpindleGoal::Speed { id: of }) = &mut work.awaits {
                *of = id;
                waiting.push(work.seq);
            }
        }
        if waiting.is_empty() {
            return;
        }
        let within = spindle.at_speed_percent / 100.0;
        let turns = self.is_to_turn();
        let rpm = self.commanded_rpm().min(spindle.max_velocity);
        let text = if turns && rpm == 0.0 {
            "the spindle override is 0 percent; raise it".to_owned()
        } else {
            self.servo.control(Control::AwaitSpindle { id, within });
            if turns {
                format!(
                    "the spindle must reach {rpm:.0} r/min within {:.0} percent",
                    within * 100.0
                )
            } else {
                "the spindle must stop".to_owned()
            }
        };
        for seq in waiting {
            self.outputs.ledger.set_wait_text(seq, Some(&text));
        }
    }

    /// Returns true if a speed above 0 is programmed, before the override.
    fn is_to_turn(&self) -> bool {
        let (direction, programmed) = self.inputs.spindle;
        matches!(direction, SpindleDirection::Cw | SpindleDirection::Ccw) && programmed > 0.0
    }

    /// Returns true if the program waits for the speed of the spindle, and the spindle override is 0 percent.
    pub(crate) fn awaits_stopped_spindle(&self) -> bool {
        let Some(awaited) = self.state.awaited() else {
            return false;
        };
        let is_awaited = |work: &StockWork| {
            work.seq == awaited.seq && matches!(work.awaits, Some(SpindleGoal::Speed { .. }))
        };
        self.outputs.stock.iter().any(is_awaited) && self.is_to_turn() && self.commanded_rpm() == 0.0
    }

    /// Returns the commanded speed with the override applied, in r/min.
    fn commanded_rpm(&self) -> f64 {
        let (_, rpm) = self.inputs.spindle;
        let wanted = rpm * self.inputs.overrides.spindle / 100.0;
        if rpm > 0.0 {
            let options = &self.context.configured.settings.nc;
            options.spindle_speed_within(wanted)
        } else {
            wanted
        }
    }

    fn finish_stock_work(&mut self, is_done: impl Fn(&StockWork) -> bool) {
        for work in self.outputs.take_stock_work(is_done) {
            let reset = Reset {
                boot_id: self.context.shared.boot_id.clone(),
                seq: work.seq,
                handler_id: STOCK_HANDLER.to_owned(),
                result: ResetResult::Ok,
                code: None,
                text: None,
                force: None,
                instance: None,
            };
            // the reset is rejected if the output has been closed in the meantime
            let _ = self
                .outputs
                .execute_request(&self.context, None, OutputRequest::Reset(reset));
            self.apply_effects();
        }
    }

    /// Executes a spindle command of a sequence program.
    pub(crate) fn command_spindle(&mut self, direction: SpindleDirection, rpm: f64) -> Result<(), Refusal> {
        let Some(spindle) = &self.context.configured.settings.spindle else {
            let text = format!("coordinate system {} has no spindle", self.context.number);
            return Err(Refusal::new(RefusalCode::NotFound, text));
        };
        if !(0.0..=spindle.max_velocity).contains(&rpm) {
            let text = format!("spindle speed {rpm}: write 0 to {} r/min", spindle.max_velocity);
            return Err(Refusal::new(RefusalCode::Invalid, text));
        }
        self.turn_spindle(direction, rpm);
        Ok(())
    }

    fn turn_spindle(&mut self, direction: SpindleDirection, rpm: f64) {
        self.inputs.spindle = (direction, rpm);
        self.inputs.spindle_at_s_from = None;
        self.send_spindle();
    }

    /// Applies a changed S when the segment after the change starts. If the stock sequence program turns the spindle by
    /// M03 or M04, the spindle takes the new speed at once (manual, S function). Any other sequence program has to do
    /// this itself (D35).
    pub(crate) fn follow_spindle_speed(&mut self, segment: u64, rpm: f64) {
        if self.inputs.spindle_at_s_from.is_some_and(|from| segment >= from) {
            self.inputs.spindle.1 = rpm;
            self.send_spindle();
        }
    }

    pub(crate) fn send_spindle(&mut self) {
        use tandem_servo::SpindleDirection as Direction;
        if self.context.configured.settings.spindle.is_none() {
            return;
        }
        let direction = match self.inputs.spindle.0 {
            SpindleDirection::Cw => Direction::Cw,
            SpindleDirection::Ccw => Direction::Ccw,
            SpindleDirection::Stop => Direction::Stop,
            SpindleDirection::Orient => Direction::Orient,
        };
        let rpm = self.commanded_rpm();
        self.servo.control(Control::Spindle { direction, rpm });
        self.await_spindle();
        self.publish_spindle();
    }
}
