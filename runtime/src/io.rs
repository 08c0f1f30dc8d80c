//! Inputs and outputs of the plant: writes, forces and losses are published and journalled.

use plc_api::types::io::{IoForce, IoPoint, IoSet, IoState};
use plc_api::types::message::Payload;
use plc_api::types::request::Refusal;
use plc_api::types::topic::Topic;

use crate::journal::Event;
use crate::shared::Shared;

impl Shared {
    /// Publishes all of them, at a start.
    pub fn publish_io(&self) {
        let io = self.io.lock();
        for (point, state) in io.states() {
            self.publish_point(point, state);
        }
    }

    /// A handler or a client writes one.
    ///
    /// # Errors
    /// As of [`IoPoints::write`](plc_api::io_points::IoPoints::write).
    pub fn write_io(&self, point: &IoPoint, set: IoSet) -> Result<(), Refusal> {
        let mut io = self.io.lock();
        let state = io.write(point, set, |id| self.is_online(id))?;
        self.publish_point(point, state);
        Ok(())
    }

    /// An operator puts a value in the place of the written one, or takes it back.
    ///
    /// # Errors
    /// As of [`IoPoints::force`](plc_api::io_points::IoPoints::force).
    pub fn force_io(&self, point: &IoPoint, force: IoForce) -> Result<(), Refusal> {
        let (value, user) = (force.value, force.by.clone());
        let mut io = self.io.lock();
        let state = io.force(point, force)?;
        let io = point.to_string();
        self.record(0, Event::Force { io, value, user });
        self.publish_point(point, state);
        Ok(())
    }

    /// A handler is not there any more: what it owned has its safe value.
    pub fn lose_io(&self, handler_id: &str) {
        let mut io = self.io.lock();
        for (point, state) in io.lose(handler_id) {
            let event = Event::IoLost {
                io: point.to_string(),
                value: state.written,
                handler_id: handler_id.to_owned(),
            };
            self.record(0, event);
            self.publish_point(&point, &state);
        }
    }

    fn publish_point(&self, point: &IoPoint, state: &IoState) {
        self.publish(Topic::Io(point.clone()), Payload::Io(state.clone()));
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use plc_api::Plc;
    use plc_api::server::{Origin, ServerTransport};
    use plc_api::types::io::IoForced;
    use plc_api::types::output::HandlerPresence;
    use plc_api::types::request::{RefusalCode, Request, typed};
    use plc_api::wire::right::Right;

    use super::*;
    use crate::test::Bench;
    use crate::{Config, Runtime};

    const PLANT: &str = "[[motor]]\nnumber = 1\nkind = \"linear\"\nmax_velocity = 5\nmax_acceleration = 5\n\
                         [[coordinate_system]]\nnumber = 1\naxes = { X = 1 }\n\
                         [io.in.door_closed]\n[io.out.lamp]\non_loss = true\n";

    fn with_plant<T: Send + 'static>(test: impl AsyncFnOnce(&Runtime) -> T + Send + 'static) -> T {
        let machine = Config::from_toml(PLANT, "").unwrap().resolve().unwrap();
        let bench = Bench::on_machine(machine);
        bench.play(async move |_, runtime| test(runtime).await).unwrap()
    }

    fn presence(instance: &str, online: bool) -> HandlerPresence {
        HandlerPresence {
            online,
            instance: Some(instance.to_owned()),
            take_over: online,
            ..HandlerPresence::default()
        }
    }

    fn write(value: bool, handler_id: &str) -> typed::WriteIo {
        let handler_id = Some(handler_id.to_owned());
        let value = value.into();
        typed::WriteIo(IoPoint::output("lamp"), IoSet { value, handler_id })
    }

    #[test]
    fn at_a_start_each_has_its_safe_value_and_birth_tells_what_there_is() {
        with_plant(async |runtime| {
            let plc = Plc::in_process(runtime.port());
            for (io, value) in [(plc.io_in("door_closed"), false), (plc.io_out("lamp"), true)] {
                let state = io.state().await.unwrap();
                assert_eq!(
                    (state.value, state.owner, state.lost),
                    (value.into(), None, false)
                );
            }
            let birth = runtime.port().read(&Topic::Birth).await.unwrap();
            let Payload::Birth(birth) = &birth.payload else {
                panic!("{birth:?}");
            };
            let all: Vec<_> = birth.io.points().map(|(point, _)| point.to_string()).collect();
            assert_eq!(all, ["io/in/door_closed", "io/out/lamp"]);
        });
    }

    #[test]
    fn with_its_owner_a_value_goes_when_it_says_so_and_when_another_instance_takes_over() {
        with_plant(async |runtime| {
            let port = runtime.port();
            let lamp = Plc::in_process(Arc::clone(&port)).io_out("lamp");
            let refused = port.ask(write(false, "cell")).await.unwrap_err();
            assert_eq!(refused.code, RefusalCode::Unavailable);
            for (instance, goes) in [("a", presence("a", false)), ("b", presence("c", true))] {
                port.ask(typed::Handler("cell".into(), presence(instance, true)))
                    .await
                    .unwrap();
                port.ask(write(false, "cell")).await.unwrap();
                assert_eq!(lamp.value().await.unwrap(), false);
                port.ask(typed::Handler("cell".into(), goes)).await.unwrap();
                let state = lamp.state().await.unwrap();
                assert_eq!((state.value, state.lost), (true.into(), true), "{instance}");
            }
            port.ask(typed::Handler("other".into(), presence("a", false)))
                .await
                .unwrap();
            port.ask(write(false, "cell")).await.unwrap();
            assert_eq!(lamp.value().await.unwrap(), false, "the new instance writes it");
        });
    }

    #[test]
    fn a_force_is_in_the_name_of_the_user_whom_the_server_knows() {
        with_plant(async |runtime| {
            let port = runtime.served_port();
            let force = IoForce {
                value: Some(false.into()),
                by: Some("somebody".to_owned()),
            };
            for (user, by) in [(Some("anna"), "anna"), (None, "somebody")] {
                let origin = Origin {
                    user: user.map(ToOwned::to_owned),
                    from: None,
                    over: ServerTransport::Rest,
                    right: Right::Operate,
                };
                let request = Request::ForceIo(IoPoint::output("lamp"), force.clone());
                port.request_from(origin, request).await.unwrap();
                let state = Plc::in_process(runtime.port()).io_out("lamp").state().await;
                let forced = IoForced {
                    value: false.into(),
                    by: by.to_owned(),
                };
                assert_eq!(state.unwrap().forced, Some(forced));
            }
        });
    }
}
