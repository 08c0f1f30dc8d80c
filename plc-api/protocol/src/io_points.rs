//! Inputs and outputs of the plant, without I/O and clock; the runtime and the scripted machine use this
//! module.
//!
//! A point is one input or output. A point that a handler has written belongs to that handler: no other
//! sender can write the point while the handler is online. If the handler leaves, its outputs keep their
//! values for the time that the handler announced, or without an announcement for the grace time. Then the
//! outputs take the value of their `on_loss`. An input has no grace time, because its value is unknown as
//! soon as no handler reads the sensor. A client without a presence owns nothing, and may write any point
//! that no handler owns. An operator can force a value. Meanwhile the owner can still write the point; the
//! written value applies again when an operator ends the forcing.

use std::collections::BTreeMap;

use crate::types::handler::Departure;
use crate::types::io::{
    IoDeclaration, IoDeclarations, IoForce, IoForced, IoPoint, IoSet, IoSide, IoState, IoValue, refused,
};
use crate::types::refusal::{Refusal, RefusalCode};

/// Largest number of names in the text of a refusal. Reason: the text is shown in one line of a panel.
const NAMED_MAX: usize = 20;

/// All inputs and outputs of a machine.
#[derive(Debug, Default)]
pub struct IoPoints {
    points: BTreeMap<IoPoint, (IoDeclaration, IoState)>,
    /// Owners that have left. The value is the end of the time for which the points wait for the return of
    /// the owner, seconds since the start of the runtime.
    absent: BTreeMap<String, f64>,
}

/// A point whose owner is lost, with that owner and the state of the point after the loss.
#[derive(Debug, Clone, PartialEq)]
pub struct LostPoint {
    /// The point.
    pub point: IoPoint,
    /// The lost owner.
    pub handler_id: String,
    /// State of the point after the loss.
    pub state: IoState,
}

impl IoPoints {
    /// Creates the points at a start of the runtime: each point has its first value, and no owner.
    pub fn new(declared: &IoDeclarations) -> Self {
        let all = declared.points().map(|(point, declaration)| {
            let first = declaration.first_value();
            let state = IoState {
                value: first,
                written: first,
                ..IoState::default()
            };
            (point, (declaration.clone(), state))
        });
        Self {
            points: all.collect(),
            absent: BTreeMap::new(),
        }
    }

    /// Restores the last written value of an output after a restart. `None` means that the stored value is
    /// damaged: the value is then unknown. A value that the declaration no longer allows is ignored.
    pub fn restore(&mut self, point: &IoPoint, last: Option<IoValue>) {
        let Some((declaration, state)) = self.points.get_mut(point) else {
            return;
        };
        match last {
            Some(last) if declaration.check(last).is_ok() => state.write(last),
            Some(_) => {}
            None => state.unknown = true,
        }
    }

    /// Returns all points with their current states.
    pub fn states(&self) -> impl Iterator<Item = (&IoPoint, &IoState)> {
        self.points.iter().map(|(point, (_, state))| (point, state))
    }

    /// Validates a write without changing anything. If a handler writes, `check_writer` validates the
    /// instance that sends the write.
    ///
    /// # Errors
    /// Fails like [`write`](Self::write).
    pub fn check(
        &self,
        point: &IoPoint,
        set: &IoSet,
        judge_writer: impl Fn(&str, Option<&String>) -> Result<(), Refusal>,
    ) -> Result<(), Refusal> {
        set.check()?;
        let (declaration, state) = self.points.get(point).ok_or_else(|| self.not_declared(point))?;
        let wrong = |why| refused(RefusalCode::Invalid, point, why);
        declaration.check(set.value).map_err(wrong)?;
        if let Some(id) = &set.handler_id {
            let judged = judge_writer(id, set.instance.as_ref());
            judged.map_err(|refusal| refused(refusal.code, point, refusal.text))?;
        }
        check_io_owner(point, state, set.handler_id.as_deref())
    }

    /// Writes a value. If a handler writes, `check_writer` validates the instance that sends the write.
    /// Returns the state, and true if the value, the owner or the loss of the owner has changed.
    ///
    /// # Errors
    /// `not_found` if the point is not declared; `invalid` if a value or an id is not valid; `unavailable` if
    /// the handler is offline; `not_allowed` if another handler owns the point, or another instance of the
    /// handler is online.
    pub fn write(
        &mut self,
        point: &IoPoint,
        set: IoSet,
        judge_writer: impl Fn(&str, Option<&String>) -> Result<(), Refusal>,
    ) -> Result<(&IoState, bool), Refusal> {
        self.check(point, &set, judge_writer)?;
        let (_, state) = self.find(point)?;
        let is_news = state.written != set.value || state.owner != set.handler_id || state.lost;
        state.owner = set.handler_id;
        state.lost = false;
        state.unknown = false;
        state.write(set.value);
        Ok((state, is_news))
    }

    /// Forces a value that replaces the written value, or ends the forcing.
    ///
    /// # Errors
    /// `not_found` if the point is not declared; `invalid` if a value or a name is not valid.
    pub fn force(&mut self, point: &IoPoint, force: IoForce) -> Result<&IoState, Refusal> {
        force.check()?;
        let (declaration, state) = self.find(point)?;
        let by = force.by.unwrap_or_else(|| "operator".to_owned());
        if let Some(value) = force.value {
            let wrong = |why| refused(RefusalCode::Invalid, point, why);
            declaration.check(value).map_err(wrong)?;
        }
        state.unknown &= force.value.is_none();
        state.forced = force.value.map(|value| IoForced { value, by });
        state.write(state.written);
        Ok(state)
    }

    /// Handles the departure of a handler: its points wait for its return. Returns the points that changed.
    pub fn mark_handler_offline(&mut self, handler_id: &str, departure: Departure) -> Vec<LostPoint> {
        let Some(until_s) = departure.until_s() else {
            return Vec::new();
        };
        if self.owned(handler_id).next().is_some() {
            self.absent.insert(handler_id.to_owned(), until_s);
        }
        match departure {
            Departure::Unannounced { .. } => self.apply_on_loss(handler_id, |point| point.side == IoSide::In),
            Departure::Announced { .. } | Departure::TakenOver => Vec::new(),
        }
    }

    /// Handles the return of a handler: its points no longer wait for the return.
    pub fn mark_handler_online(&mut self, handler_id: &str) {
        self.absent.remove(handler_id);
    }

    /// Sets the points of each handler whose waiting time has ended to their `on_loss`. `is_there` returns
    /// true if a handler is online. Returns the points that changed.
    pub fn expire(&mut self, now_s: f64, is_there: impl Fn(&str) -> bool) -> Vec<LostPoint> {
        let due = self.absent.extract_if(.., |_, until_s| *until_s <= now_s);
        let due: Vec<_> = due.map(|(id, _)| id).filter(|id| !is_there(id)).collect();
        due.iter()
            .flat_map(|id| self.apply_on_loss(id, |_| true))
            .collect()
    }

    /// Returns the earliest end of a waiting time for a handler that left, seconds since the start of the
    /// runtime.
    pub fn next_deadline_s(&self) -> Option<f64> {
        self.absent.values().copied().reduce(f64::min)
    }

    /// Returns the points that a handler owns, without the points that are marked as lost.
    fn owned(&mut self, handler_id: &str) -> impl Iterator<Item = (&IoPoint, &IoDeclaration, &mut IoState)> {
        let all = self.points.iter_mut();
        let all = all.map(|(point, (declaration, state))| (point, &*declaration, state));
        all.filter(move |(_, _, state)| !state.lost && state.owner.as_deref() == Some(handler_id))
    }

    fn apply_on_loss(&mut self, handler_id: &str, which: impl Fn(&IoPoint) -> bool) -> Vec<LostPoint> {
        let own = self.owned(handler_id).filter(|(point, ..)| which(point));
        let lost = own.map(|(point, declaration, state)| {
            state.lost = true;
            state.write(declaration.on_loss.value().unwrap_or(state.written));
            LostPoint {
                point: point.clone(),
                handler_id: handler_id.to_owned(),
                state: state.clone(),
            }
        });
        lost.collect()
    }

    fn find(&mut self, point: &IoPoint) -> Result<(&IoDeclaration, &mut IoState), Refusal> {
        if !self.points.contains_key(point) {
            return Err(self.not_declared(point));
        }
        let found = self.points.get_mut(point);
        let found = found.map(|(declaration, state)| (&*declaration, state));
        found.ok_or_else(|| not_declared(point, []))
    }

    fn not_declared(&self, point: &IoPoint) -> Refusal {
        not_declared(point, self.points.keys())
    }
}

/// Checks that a sender may write a point in this state. `handler_id` is `None` for a client without a
/// presence.
///
/// # Errors
/// Returns `not_allowed` if another handler owns the point.
pub fn check_io_owner(point: &IoPoint, state: &IoState, handler_id: Option<&str>) -> Result<(), Refusal> {
    let Some(owner) = state.owner.as_deref().filter(|owner| handler_id != Some(owner)) else {
        return Ok(());
    };
    let whose = match (state.lost, handler_id) {
        (true, Some(_)) => return Ok(()),
        (true, None) => format!("it waits for handler {owner} or another handler to write it"),
        (false, _) => format!("handler {owner} owns it, and only this handler may write it while online"),
    };
    let why = format!("{whose}; an operator can force a value");
    Err(refused(RefusalCode::NotAllowed, point, why))
}

/// Checks that the configuration declares an input or output, and that it can have this value.
///
/// # Errors
/// `not_found` if the configuration does not declare the input or output; `invalid` if it cannot have the
/// value.
pub fn check_io_declared(
    io: &IoDeclarations,
    point: &IoPoint,
    value: Option<IoValue>,
) -> Result<(), Refusal> {
    let Some(declared) = io.on_side(point.side).get(&point.name) else {
        let all: Vec<_> = io.points().map(|(point, _)| point).collect();
        return Err(not_declared(point, &all));
    };
    let checked = value.map_or(Ok(()), |value| declared.check(value));
    checked.map_err(|why| refused(RefusalCode::Invalid, point, why))
}

/// Creates the refusal `not_found` for a point that is not declared.
fn not_declared<'a>(point: &IoPoint, all: impl IntoIterator<Item = &'a IoPoint>) -> Refusal {
    let of_side = all.into_iter().filter(|known| known.side == point.side);
    let names: Vec<_> = of_side.take(NAMED_MAX).map(|known| known.name.as_str()).collect();
    let table = format!("[io.{}.{:.64}]", point.side.wire_name(), point.name);
    let text = match names.join(", ") {
        there if there.is_empty() => format!("the configuration declares none; write {table}"),
        there => format!("the configuration has no {table}; there are {there}"),
    };
    Refusal::new(RefusalCode::NotFound, text)
}

impl IoState {
    fn write(&mut self, value: IoValue) {
        self.written = value;
        self.value = self.forced.as_ref().map_or(value, |forced| forced.value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::types::io::IoStart;

    fn door() -> IoPoint {
        IoPoint::input("door_closed")
    }

    fn points() -> IoPoints {
        let mut declared = IoDeclarations::default();
        declared.insert(door(), IoDeclaration::new(false));
        let level = IoDeclaration {
            max: Some(60.0),
            ..IoDeclaration::new(5.0)
        };
        declared.insert(IoPoint::output("level"), level);
        IoPoints::new(&declared)
    }

    fn by(handler: &str, value: bool) -> IoSet {
        IoSet {
            value: value.into(),
            handler_id: Some(handler.to_owned()),
            ..IoSet::default()
        }
    }

    fn anyone(value: bool) -> IoSet {
        IoSet {
            value: value.into(),
            ..IoSet::default()
        }
    }

    fn force(value: Option<bool>) -> IoForce {
        IoForce {
            value: value.map(Into::into),
            by: Some("anna".to_owned()),
        }
    }

    #[allow(clippy::unnecessary_wraps, reason = "same signature as the machine")]
    fn there(_: &str, _: Option<&String>) -> Result<(), Refusal> {
        Ok(())
    }

    fn nobody(_: &str, _: Option<&String>) -> Result<(), Refusal> {
        Err(Refusal::new(
            RefusalCode::Unavailable,
            "handler gateway is not online",
        ))
    }

    fn value(points: &IoPoints) -> (IoValue, Option<String>, bool) {
        let (_, state) = points.states().find(|(point, _)| **point == door()).unwrap();
        (state.value, state.owner.clone(), state.lost)
    }

    const LOST: Departure = Departure::Unannounced { until_s: 12.0 };

    fn clamp() -> IoPoint {
        IoPoint::output("clamp")
    }

    /// Returns a clamp with this declaration, which handler `cell` has closed.
    fn closed(declaration: IoDeclaration) -> IoPoints {
        let mut declared = IoDeclarations::default();
        declared.insert(clamp(), declaration);
        let mut points = IoPoints::new(&declared);
        points.write(&clamp(), by("cell", true), there).unwrap();
        points
    }

    /// Returns for the clamp: the value, the written value, and true if the owner is lost.
    fn of_clamp(points: &IoPoints) -> (bool, bool, bool) {
        let (_, state) = points.states().next().unwrap();
        (state.value.is_on(), state.written.is_on(), state.lost)
    }

    #[test]
    fn an_output_stays_for_the_grace_time_and_then_has_its_on_loss() {
        let open = IoDeclaration::new(false);
        for (declaration, after) in [
            (open.clone(), (false, false, true)),
            (open.kept(IoStart::LAST), (true, true, true)),
        ] {
            let mut points = closed(declaration);
            assert_eq!(points.mark_handler_offline("cell", LOST), []);
            assert_eq!(points.next_deadline_s(), Some(12.0));
            assert_eq!(points.expire(11.9, |_| false), []);
            assert_eq!(of_clamp(&points), (true, true, false));
            let refusal = points.write(&clamp(), by("other", false), there).unwrap_err();
            assert_eq!(refusal.code, RefusalCode::NotAllowed);
            assert_eq!(points.expire(12.0, |_| false).len(), 1);
            assert_eq!(of_clamp(&points), after);
            points.write(&clamp(), by("other", true), there).unwrap();
            assert_eq!(of_clamp(&points), (true, true, false));
        }
    }

    #[test]
    fn an_output_passes_to_the_instance_that_is_back_in_time() {
        for departure in [LOST, Departure::Announced { until_s: 60.0 }, Departure::TakenOver] {
            let mut points = closed(IoDeclaration::new(false));
            assert_eq!(points.mark_handler_offline("cell", departure), []);
            points.mark_handler_online("cell");
            assert_eq!(points.expire(f64::MAX, |_| false), []);
            assert_eq!(of_clamp(&points), (true, true, false));
            points.write(&clamp(), by("cell", false), there).unwrap();
            assert_eq!(of_clamp(&points), (false, false, false));
        }
    }

    #[test]
    fn an_announced_end_keeps_an_output_until_its_time() {
        let mut points = closed(IoDeclaration::new(false));
        points.mark_handler_offline("cell", Departure::Announced { until_s: 60.0 });
        assert_eq!(points.expire(59.9, |_| false), []);
        assert_eq!(points.expire(60.0, |_| true), [], "the handler is online");
        points.mark_handler_offline("cell", Departure::Announced { until_s: 60.0 });
        assert_eq!(points.expire(60.0, |_| false).len(), 1);
        assert_eq!(of_clamp(&points), (false, false, true));
    }

    #[test]
    fn an_output_begins_with_at_start_and_a_damaged_last_value_is_unknown() {
        let begin = |declaration: IoDeclaration| {
            let mut declared = IoDeclarations::default();
            declared.insert(clamp(), declaration);
            IoPoints::new(&declared)
        };
        let open = IoDeclaration::new(false);
        assert!(of_clamp(&begin(open.clone().kept(true))).0);
        let mut points = begin(open.kept(IoStart::LAST));
        assert!(!of_clamp(&points).0, "there is no last value");
        points.restore(&clamp(), Some(true.into()));
        assert_eq!(of_clamp(&points), (true, true, false));
        points.restore(&clamp(), Some(7.0.into()));
        assert!(of_clamp(&points).0, "its declaration has changed");
        let unknown = |points: &IoPoints| points.states().any(|(_, state)| state.unknown);
        points.restore(&clamp(), None);
        assert!(unknown(&points));
        points.write(&clamp(), by("cell", false), there).unwrap();
        assert!(!unknown(&points));
    }

    #[test]
    fn each_begins_with_its_safe_value_and_without_an_owner() {
        let points = points();
        let states: Vec<_> = points
            .states()
            .map(|(point, state)| (point.to_string(), state.value, state.owner.clone()))
            .collect();
        assert_eq!(
            states,
            [
                ("io/in/door_closed".to_owned(), IoValue::Bool(false), None),
                ("io/out/level".to_owned(), IoValue::Number(5.0), None)
            ]
        );
    }

    #[test]
    fn it_is_its_owners_while_that_is_there_and_a_second_one_is_told_whose() {
        let mut points = points();
        points.write(&door(), by("gateway", true), there).unwrap();
        for other in [by("cell", false), anyone(false)] {
            let refusal = points.write(&door(), other, there).unwrap_err();
            assert_eq!(refusal.code, RefusalCode::NotAllowed);
            for word in ["io/in/door_closed", "gateway", "force"] {
                assert!(refusal.text.contains(word), "{refusal}");
            }
        }
        assert_eq!(value(&points), (true.into(), Some("gateway".into()), false));
        points.write(&door(), by("gateway", false), there).unwrap();
        assert_eq!(value(&points).0, false);
    }

    #[test]
    fn without_its_owner_it_has_its_safe_value_until_a_handler_writes_it() {
        let mut points = points();
        points.write(&door(), by("gateway", true), there).unwrap();
        assert_eq!(points.mark_handler_offline("cell", LOST), []);
        let lost = points.mark_handler_offline("gateway", LOST);
        assert_eq!(lost.len(), 1);
        assert_eq!(value(&points), (false.into(), Some("gateway".into()), true));
        assert_eq!(
            points.mark_handler_offline("gateway", LOST),
            [],
            "the loss is reported once"
        );
        let refusal = points.write(&door(), anyone(true), nobody).unwrap_err();
        assert!(refusal.text.contains("waits for handler gateway"), "{refusal}");
        points.write(&door(), by("other", true), there).unwrap();
        assert_eq!(value(&points), (true.into(), Some("other".into()), false));
    }

    #[test]
    fn clients_without_presence_write_unowned_points_and_handlers_take_over() {
        let mut points = points();
        points.write(&door(), anyone(true), there).unwrap();
        points.write(&door(), anyone(false), there).unwrap();
        points.write(&door(), anyone(true), there).unwrap();
        assert_eq!(value(&points), (true.into(), None, false));
        points.write(&door(), by("gateway", true), there).unwrap();
        assert_eq!(value(&points), (true.into(), Some("gateway".into()), false));
    }

    #[test]
    fn a_handler_that_is_not_there_writes_nothing() {
        let mut points = points();
        let refusal = points.write(&door(), by("gateway", true), nobody).unwrap_err();
        assert_eq!(refusal.code, RefusalCode::Unavailable);
        assert!(refusal.text.contains("gateway is not online"), "{refusal}");
    }

    #[test]
    fn a_forced_value_counts_and_the_written_one_goes_on_underneath() {
        let mut points = points();
        points.write(&door(), by("gateway", true), there).unwrap();
        let state = points.force(&door(), force(Some(false))).unwrap();
        assert_eq!(state.forced.as_ref().map(|forced| &*forced.by), Some("anna"));
        assert_eq!((state.value, state.written), (false.into(), true.into()));
        points.write(&door(), by("gateway", false), there).unwrap();
        let (state, _) = points.write(&door(), by("gateway", true), there).unwrap();
        assert_eq!((state.value, state.written), (false.into(), true.into()));
        points.force(&door(), force(Some(true))).unwrap();
        points.mark_handler_offline("gateway", LOST);
        assert_eq!(value(&points).0, true, "a force ends by an operator alone");
        let state = points.force(&door(), force(None)).unwrap();
        assert_eq!((state.value, state.forced.clone()), (false.into(), None));
    }

    #[test]
    fn a_force_is_held_to_the_declaration_as_a_write_is() {
        let (mut points, level) = (points(), IoPoint::output("level"));
        for value in [61.0.into(), IoValue::Bool(true)] {
            let set = IoSet {
                value,
                ..IoSet::default()
            };
            let forced = IoForce {
                value: Some(value),
                by: None,
            };
            let refusals = [
                points.write(&level, set, there).unwrap_err(),
                points.force(&level, forced).unwrap_err(),
            ];
            for refusal in refusals {
                assert_eq!(refusal.code, RefusalCode::Invalid);
                assert!(refusal.text.starts_with("io/out/level: "), "{refusal}");
            }
        }
    }

    #[test]
    fn one_that_is_not_declared_is_refused_with_those_that_are() {
        let mut points = points();
        let wrong = IoPoint::input("door");
        let refusal = points.write(&wrong, anyone(true), there).unwrap_err();
        assert_eq!(refusal.code, RefusalCode::NotFound);
        for word in ["[io.in.door]", "door_closed"] {
            assert!(refusal.text.contains(word), "{refusal}");
        }
        let none = IoPoints::default()
            .write(&wrong, anyone(true), there)
            .unwrap_err();
        assert!(none.text.contains("declares none"), "{none}");
    }
}
