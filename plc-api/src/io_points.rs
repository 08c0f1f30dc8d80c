//! Inputs and outputs of the plant. Pure; the runtime and the scripted machine share it.
//!
//! A point that a handler has written belongs to that handler: nobody else can write it while the handler is present, and when the
//! handler has gone, the point takes the safe value of its declaration. Clients without a presence own nothing: any of them may write
//! a point that no handler owns. An operator can force a value; the program keeps writing underneath, and its value counts again when
//! an operator removes the force.

use std::collections::BTreeMap;

use crate::types::io::{
    IoDeclaration, IoDeclarations, IoForce, IoForced, IoPoint, IoSet, IoState, IoValue, refused,
};
use crate::types::refusal::{Refusal, RefusalCode};

/// Names in the text of a refusal. Reason: it is one line of a panel.
const NAMED_MAX: usize = 20;

/// All of a machine.
#[derive(Debug, Default)]
pub struct IoPoints(BTreeMap<IoPoint, (IoDeclaration, IoState)>);

impl IoPoints {
    /// At a start: each has its safe value, and no owner yet.
    pub fn new(declared: &IoDeclarations) -> Self {
        let all = declared.points().map(|(point, declaration)| {
            let state = IoState {
                value: declaration.on_loss,
                written: declaration.on_loss,
                ..IoState::default()
            };
            (point, (declaration.clone(), state))
        });
        Self(all.collect())
    }

    /// All of them as they are now.
    pub fn states(&self) -> impl Iterator<Item = (&IoPoint, &IoState)> {
        self.0.iter().map(|(point, (_, state))| (point, state))
    }

    /// Writes a value. `is_there` says whether a handler is online.
    ///
    /// # Errors
    /// `not_found`: none is declared by this name; `invalid`: a value or an id that is none; `unavailable`: the handler is not
    /// there; `not_allowed`: it is another's.
    pub fn write(
        &mut self,
        point: &IoPoint,
        set: IoSet,
        is_there: impl Fn(&str) -> bool,
    ) -> Result<&IoState, Refusal> {
        set.check()?;
        let (declaration, state) = self.find(point)?;
        let wrong = |why| refused(RefusalCode::Invalid, point, why);
        declaration.check(set.value).map_err(wrong)?;
        if let Some(id) = set.handler_id.as_deref().filter(|id| !is_there(id)) {
            let why = format!("handler {id} is not online: announce its presence before it writes");
            return Err(refused(RefusalCode::Unavailable, point, why));
        }
        judge_owner(point, state, set.handler_id.as_deref())?;
        state.owner = set.handler_id;
        state.lost = false;
        state.write(set.value);
        Ok(state)
    }

    /// Puts a value in the place of the written one, or takes it back.
    ///
    /// # Errors
    /// `not_found`: none is declared by this name; `invalid`: a value or a name that is none.
    pub fn force(&mut self, point: &IoPoint, force: IoForce) -> Result<&IoState, Refusal> {
        force.check()?;
        let (declaration, state) = self.find(point)?;
        let by = force.by.unwrap_or_else(|| "operator".to_owned());
        if let Some(value) = force.value {
            let wrong = |why| refused(RefusalCode::Invalid, point, why);
            declaration.check(value).map_err(wrong)?;
        }
        state.forced = force.value.map(|value| IoForced { value, by });
        state.write(state.written);
        Ok(state)
    }

    /// A handler is not there any more. What it owned.
    pub fn lose(&mut self, handler_id: &str) -> Vec<(IoPoint, IoState)> {
        let is_own = |state: &IoState| !state.lost && state.owner.as_deref() == Some(handler_id);
        let own = self.0.iter_mut().filter(|(_, (_, state))| is_own(state));
        let lost = own.map(|(point, (declaration, state))| {
            state.lost = true;
            state.write(declaration.on_loss);
            (point.clone(), state.clone())
        });
        lost.collect()
    }

    fn find(&mut self, point: &IoPoint) -> Result<(&IoDeclaration, &mut IoState), Refusal> {
        if !self.0.contains_key(point) {
            return Err(not_declared(point, self.0.keys()));
        }
        let found = self.0.get_mut(point);
        let found = found.map(|(declaration, state)| (&*declaration, state));
        found.ok_or_else(|| not_declared(point, []))
    }
}

/// Whether a handler, or a client without presence, may write what is in this state.
///
/// # Errors
/// `not_allowed`: it is another's.
pub(crate) fn judge_owner(point: &IoPoint, state: &IoState, handler_id: Option<&str>) -> Result<(), Refusal> {
    let Some(owner) = state.owner.as_deref().filter(|owner| handler_id != Some(owner)) else {
        return Ok(());
    };
    let whose = match (state.lost, handler_id) {
        (true, Some(_)) => return Ok(()),
        (true, None) => format!("it waits for handler {owner}, or another one, to write it"),
        (false, _) => format!("it is handler {owner}'s, which alone writes it while it is there"),
    };
    let why = format!("{whose}; an operator puts a value in its place by force");
    Err(refused(RefusalCode::NotAllowed, point, why))
}

/// Whether a machine has such an input or output, and whether that can have a value.
///
/// # Errors
/// `not_found`: the configuration does not declare it; `invalid`: it cannot have the value.
pub(crate) fn judge_declared(
    io: &IoDeclarations,
    point: &IoPoint,
    value: Option<IoValue>,
) -> Result<(), Refusal> {
    let Some(declared) = io.of(point.side).get(&point.name) else {
        let all: Vec<_> = io.points().map(|(point, _)| point).collect();
        return Err(not_declared(point, &all));
    };
    let checked = value.map_or(Ok(()), |value| declared.check(value));
    checked.map_err(|why| refused(RefusalCode::Invalid, point, why))
}

/// `not_found`: it is none of these.
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
        }
    }

    fn anyone(value: bool) -> IoSet {
        IoSet {
            value: value.into(),
            handler_id: None,
        }
    }

    fn force(value: Option<bool>) -> IoForce {
        IoForce {
            value: value.map(Into::into),
            by: Some("anna".to_owned()),
        }
    }

    fn there(_: &str) -> bool {
        true
    }

    fn value(points: &IoPoints) -> (IoValue, Option<String>, bool) {
        let (_, state) = points.states().find(|(point, _)| **point == door()).unwrap();
        (state.value, state.owner.clone(), state.lost)
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
        assert_eq!(points.lose("cell"), []);
        let lost = points.lose("gateway");
        assert_eq!(lost.len(), 1);
        assert_eq!(value(&points), (false.into(), Some("gateway".into()), true));
        assert_eq!(points.lose("gateway"), [], "it is told once");
        let refusal = points.write(&door(), anyone(true), |_| false).unwrap_err();
        assert!(refusal.text.contains("waits for handler gateway"), "{refusal}");
        points.write(&door(), by("other", true), there).unwrap();
        assert_eq!(value(&points), (true.into(), Some("other".into()), false));
    }

    #[test]
    fn clients_without_presence_write_what_nobody_owns_and_a_handler_takes_it_over() {
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
        let refusal = points.write(&door(), by("gateway", true), |_| false).unwrap_err();
        assert_eq!(refusal.code, RefusalCode::Unavailable);
        assert!(refusal.text.contains("presence"), "{refusal}");
    }

    #[test]
    fn a_forced_value_counts_and_the_written_one_goes_on_underneath() {
        let mut points = points();
        points.write(&door(), by("gateway", true), there).unwrap();
        let state = points.force(&door(), force(Some(false))).unwrap();
        assert_eq!(state.forced.as_ref().map(|forced| &*forced.by), Some("anna"));
        assert_eq!((state.value, state.written), (false.into(), true.into()));
        points.write(&door(), by("gateway", false), there).unwrap();
        let state = points.write(&door(), by("gateway", true), there).unwrap();
        assert_eq!((state.value, state.written), (false.into(), true.into()));
        points.force(&door(), force(Some(true))).unwrap();
        points.lose("gateway");
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
                handler_id: None,
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
