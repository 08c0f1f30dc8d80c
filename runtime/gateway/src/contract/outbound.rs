//! Topics that the runtime publishes, with example numbers in their paths.

use plc_protocol::types::io::IoPoint;
use plc_protocol::types::topic::{CsTopic, Topic};

/// Numbers that stand for a name in a path.
pub(super) const CS: u8 = 251;
pub(super) const M: u16 = 60_001;

/// Returns every topic that the runtime publishes.
pub(super) fn outbound() -> Vec<Topic> {
    let states = CsTopic::STATES.into_iter().map(|(topic, _)| topic);
    let of_cs = states.chain(CsTopic::events(M));
    let machine = [
        Topic::Presence,
        Topic::Birth,
        Topic::Heartbeat,
        Topic::AlarmEvent,
        Topic::AlarmActive,
        Topic::Reply("{client_id}".into()),
        Topic::HandlerResult("{id}".into()),
        Topic::Io(IoPoint::input("{name}")),
        Topic::Io(IoPoint::output("{name}")),
        Topic::Variables,
        Topic::Tools,
        Topic::StoredData,
    ];
    let of_cs = of_cs.map(|topic| Topic::cs(CS, topic));
    machine.into_iter().chain(of_cs).collect()
}
