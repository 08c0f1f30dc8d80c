//! Inputs and outputs of the plant. Publishes and journals writes, forced values and losses of the owner.

use std::collections::BTreeMap;

use plc_protocol::io_points::LostPoint;
use plc_protocol::types::handler::Departure;
use plc_protocol::types::io::{IoForce, IoPoint, IoSet, IoSide, IoState, IoValue};
use plc_protocol::types::message::Payload;
use plc_protocol::types::request::Refusal;
use plc_protocol::types::topic::Topic;
use tandem_store::journal::Event;

use crate::shared::SharedState;

/// Difference in s below which two times are equal. Reason: sums of times are rounded.
const ROUNDING_S: f64 = 1e-9;

impl SharedState {
    /// Publishes all inputs and outputs at the start of the runtime.
    pub fn publish_io(&self) {
        let io = self.io.lock();
        for (point, state) in io.states() {
            self.publish_point(point, state);
        }
    }

    /// Restores the stored values of outputs before they are published. `None` marks a value that is damaged.
    pub fn restore_outputs(&self, last: BTreeMap<IoPoint, Option<IoValue>>) {
        let mut io = self.io.lock();
        for (point, last) in last {
            io.restore(&point, last);
        }
    }

    /// Validates a write without changing anything. Returns the last written value.
    ///
    /// # Errors
    /// Returns an error in the cases of [`IoPoints::write`](plc_protocol::io_points::IoPoints::write).
    pub fn check_io(&self, point: &IoPoint, set: &IoSet) -> Result<IoValue, Refusal> {
        let io = self.io.lock();
        io.check(point, set, |id, instance| self.check_writer(id, instance))?;
        let written = io.states().find(|(known, _)| *known == point);
        Ok(written.map_or(set.value, |(_, state)| state.written))
    }

    /// Writes an input or output for a handler or a client.
    ///
    /// # Errors
    /// Returns an error in the cases of [`IoPoints::write`](plc_protocol::io_points::IoPoints::write).
    pub fn write_io(&self, point: &IoPoint, set: IoSet) -> Result<(), Refusal> {
        let (value, handler_id) = (set.value, set.handler_id.clone());
        let mut io = self.io.lock();
        let (state, is_news) = io.write(point, set, |id, instance| self.check_writer(id, instance))?;
        if is_news && point.side == IoSide::Out {
            let io = point.to_string();
            self.record(
                0,
                Event::IoWrite {
                    io,
                    value,
                    handler_id,
                },
            );
        }
        self.publish_point(point, state);
        Ok(())
    }

    /// Forces a value for an operator, which replaces the written value, or ends the forcing.
    ///
    /// # Errors
    /// Returns an error in the cases of [`IoPoints::force`](plc_protocol::io_points::IoPoints::force).
    pub fn force_io(&self, point: &IoPoint, force: IoForce) -> Result<(), Refusal> {
        let (value, user) = (force.value, force.by.clone());
        let mut io = self.io.lock();
        let state = io.force(point, force)?;
        let io = point.to_string();
        self.record(0, Event::Force { io, value, user });
        self.publish_point(point, state);
        Ok(())
    }

    /// Processes the departure of a handler that may own inputs and outputs.
    pub fn leave_io(&self, handler_id: &str, departure: Departure) {
        let mut io = self.io.lock();
        let lost = io.mark_handler_offline(handler_id, departure);
        self.report_lost(lost);
        self.io_absences.notify_one();
    }

    /// Processes the return of a handler: its inputs and outputs no longer wait for it.
    pub fn end_io_absence(&self, handler_id: &str) {
        self.io.lock().mark_handler_online(handler_id);
    }

    /// Waits for handlers that have left. If a handler does not return within its time limit, its points take their
    /// safe values.
    pub async fn watch_io(&self) {
        loop {
            let next_s = self.io.lock().next_deadline_s();
            tokio::select! {
                biased;
                () = self.closing.cancelled() => return,
                () = self.io_absences.notified() => {}
                () = self.clock.sleep_until_s(next_s.unwrap_or(0.0)), if next_s.is_some() => {}
            }
            let now_s = self.clock.now_s() + ROUNDING_S;
            let mut io = self.io.lock();
            let lost = io.expire(now_s, |id| self.is_online(id));
            self.report_lost(lost);
        }
    }

    /// Journals and publishes points whose owner is lost. The caller holds the lock of all points.
    fn report_lost(&self, lost: Vec<LostPoint>) {
        for LostPoint {
            point,
            handler_id,
            state,
        } in lost
        {
            let (io, value) = (point.to_string(), state.written);
            self.record(
                0,
                Event::IoLost {
                    io,
                    value,
                    handler_id,
                },
            );
            self.publish_point(&point, &state);
        }
    }

    fn publish_point(&self, point: &IoPoint, state: &IoState) {
        self.publish(Topic::Io(point.clone()), Payload::Io(state.clone()));
    }
}

#[cfg(test)]
mod tests;
