//! Inputs and outputs of the plant of the scripted machine.

use super::{FakeMachine, FakePort};
use crate::lock::lock;
use crate::types::handler::Departure;
use crate::types::io::{IoForce, IoPoint, IoSet, IoState};
use crate::types::message::Payload;
use crate::types::request::{Answer, Refusal};
use crate::types::topic::Topic;

impl FakePort {
    pub(super) fn write_io(&self, point: IoPoint, set: IoSet) -> Result<Answer, Refusal> {
        let mut inner = lock(&self.inner);
        let FakeMachine { io, handlers, .. } = &mut *inner;
        let (state, _) = io.write(&point, set, |id, instance| handlers.check_writer(id, instance))?;
        let state = state.clone();
        self.publish_io(&mut inner, point, state);
        Ok(Answer::Done)
    }

    pub(super) fn force_io(&self, point: IoPoint, force: IoForce) -> Result<Answer, Refusal> {
        let mut inner = lock(&self.inner);
        let state = inner.io.force(&point, force)?.clone();
        self.publish_io(&mut inner, point, state);
        Ok(Answer::Done)
    }

    /// Notifies the inputs and outputs of the plant that their owner is offline, and publishes the changes.
    pub(super) fn mark_io_owner_offline(
        &self,
        inner: &mut FakeMachine,
        handler_id: &str,
        departure: Departure,
    ) {
        for lost in inner.io.mark_handler_offline(handler_id, departure) {
            self.publish_io(inner, lost.point, lost.state);
        }
        self.expire_io(inner);
    }

    /// Sets the inputs and outputs of owners whose waiting time has ended to their `on_loss`.
    pub(super) fn expire_io(&self, inner: &mut FakeMachine) {
        for lost in inner.io.expire(inner.now_s, |_| false) {
            self.publish_io(inner, lost.point, lost.state);
        }
    }

    pub(super) fn publish_all_io(&self, inner: &mut FakeMachine) {
        let all: Vec<_> = inner
            .io
            .states()
            .map(|(point, state)| (point.clone(), state.clone()))
            .collect();
        for (point, state) in all {
            self.publish_io(inner, point, state);
        }
    }

    fn publish_io(&self, inner: &mut FakeMachine, point: IoPoint, state: IoState) {
        self.publish(inner, Topic::Io(point), Payload::Io(state));
    }
}
