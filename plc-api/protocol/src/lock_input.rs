//! An interlock or start lock of one coordinate system, without I/O and clock. The runtime and the scripted
//! machine use this module.
//!
//! The input is on while any of its sources is on. A source that a handler has set belongs to that handler:
//! no other sender can clear the source. If the handler leaves, its sources keep their values for the time
//! that the handler announced, or without an announcement for the grace time. Then the sources take the value
//! of their `on_loss`. A source with `on_loss = "on"` has no grace time: an unannounced loss sets the source
//! on at once. A client without a presence owns nothing, and may clear a source that another such client has
//! set. An operator can force a source; the state shows the forcing until the owner writes the source again.

use std::collections::BTreeMap;

use crate::types::handler::Departure;
use crate::types::lock::{Lock, LockSet, LockSource, OnLoss};
use crate::types::refusal::{Refusal, RefusalCode};

/// Largest number of sources of one input of a coordinate system. A further source is refused.
pub const SOURCES_MAX: usize = 64;

/// Values of the sources of an input while their owners are lost.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct LockRules {
    /// `on_loss` of sources that the configuration does not declare.
    pub on_loss: OnLoss,
    /// Sources that the configuration declares, each with its `on_loss`. At a start of the runtime such a
    /// source has no owner; the source is on if its `on_loss` is [`OnLoss::On`], otherwise off. The state
    /// always shows every declared source.
    pub sources: BTreeMap<String, OnLoss>,
}

/// An interlock or a start lock with its sources.
#[derive(Debug, Default)]
pub struct LockInput {
    /// Name of the input in texts for people.
    name: &'static str,
    rules: LockRules,
    // sorted by name; each name has one entry for each owner, and at most one entry without an owner
    sources: Vec<LockSource>,
    /// Owners that have left. The value is the end of the time for which the sources wait for the return of
    /// the owner, seconds since the start of the runtime.
    absent: BTreeMap<String, f64>,
}

impl LockInput {
    /// Creates the input at a start of the runtime: declared sources have no owner yet.
    pub fn new(name: &'static str, rules: LockRules) -> Self {
        let sources = rules.sources.iter().map(|(source, on_loss)| LockSource {
            source: source.clone(),
            value: *on_loss == OnLoss::On,
            text: match on_loss {
                OnLoss::On => format!("no handler has set {source} since the start"),
                OnLoss::Keep | OnLoss::Off => String::new(),
            },
            lost: true,
            ..LockSource::default()
        });
        Self {
            name,
            sources: sources.collect(),
            rules,
            absent: BTreeMap::new(),
        }
    }

    /// Returns true while any source is on.
    pub fn is_on(&self) -> bool {
        self.sources.iter().any(|source| source.value)
    }

    /// Returns the reasons why the input is on, or an empty text while the input is off.
    pub fn text(&self) -> String {
        let on = self.sources.iter().filter(|source| source.value);
        let texts = on.map(|source| match source.text.as_str() {
            "" if self.sources.len() > 1 => source.source.as_str(),
            text => text,
        });
        texts.collect::<Vec<_>>().join("; ")
    }

    /// Returns the payload of the topic of this input.
    pub fn state(&self) -> Lock {
        Lock {
            value: self.is_on(),
            text: self.text(),
            sources: self.sources.clone(),
        }
    }

    /// Sets a source. If a handler sends the write, `check_writer` validates the sending instance.
    ///
    /// # Errors
    /// Fails if a name or a text is not valid, or if the input has too many sources. `unavailable` if the
    /// handler is offline; `not_allowed` if another instance of the handler is online, or if the source stays
    /// on because a handler owns the source.
    pub fn set(
        &mut self,
        set: LockSet,
        judge_writer: impl Fn(&str, Option<&String>) -> Result<(), Refusal>,
    ) -> Result<(), Refusal> {
        set.check()?;
        if set.is_forced() {
            return self.force(set);
        }
        if let Some(id) = &set.handler_id {
            let judged = judge_writer(id, set.instance.as_ref());
            judged
                .map_err(|refusal| Refusal::new(refusal.code, format!("{}: {}", self.name, refusal.text)))?;
        }
        let place = self.index_of(&set);
        if place.is_none() && set.handler_id.is_none() && !set.value {
            return self.check_clear(set.source());
        }
        let new = LockSource {
            source: set.source().to_owned(),
            value: set.value,
            text: set.text,
            handler_id: set.handler_id,
            ..LockSource::default()
        };
        match place {
            Some(place) => self.sources[place] = new,
            None => self.add(new)?,
        }
        self.tidy();
        Ok(())
    }

    /// Handles the departure of a handler: its sources wait for its return. Returns true if a source has
    /// changed.
    pub fn mark_handler_offline(&mut self, handler_id: &str, departure: Departure) -> bool {
        if let Some(until_s) = departure.until_s().filter(|_| self.owns(handler_id)) {
            self.absent.insert(handler_id.to_owned(), until_s);
        }
        let is_sudden = matches!(departure, Departure::Unannounced { .. });
        is_sudden && self.apply_on_loss(handler_id, |on_loss| on_loss == OnLoss::On)
    }

    /// Handles the return of a handler: its sources no longer wait for the return.
    pub fn mark_handler_online(&mut self, handler_id: &str) {
        self.absent.remove(handler_id);
    }

    /// Sets the sources of each handler whose waiting time has ended to their `on_loss`. `is_there` returns
    /// true if a handler is online. Returns true if a source has changed.
    pub fn expire(&mut self, now_s: f64, is_there: impl Fn(&str) -> bool) -> bool {
        let due = self.absent.extract_if(.., |_, until_s| *until_s <= now_s);
        let due: Vec<_> = due.map(|(id, _)| id).filter(|id| !is_there(id)).collect();
        due.iter()
            .fold(false, |any, id| self.apply_on_loss(id, |_| true) | any)
    }

    /// Returns the earliest end of a waiting time for a handler that left, seconds since the start of the
    /// runtime.
    pub fn next_deadline_s(&self) -> Option<f64> {
        self.absent.values().copied().reduce(f64::min)
    }

    fn owns(&self, handler_id: &str) -> bool {
        let mut owned = self.sources.iter().filter(|source| !source.lost);
        owned.any(|source| source.handler_id.as_deref() == Some(handler_id))
    }

    /// Marks the sources of a handler as lost if `which` returns true for their `on_loss`, and sets these
    /// sources to their `on_loss`. Returns true if a source was marked.
    fn apply_on_loss(&mut self, handler_id: &str, which: impl Fn(OnLoss) -> bool) -> bool {
        let Self { sources, rules, .. } = self;
        let mut any = false;
        let of_handler =
            |source: &&mut LockSource| !source.lost && source.handler_id.as_deref() == Some(handler_id);
        for source in sources.iter_mut().filter(of_handler) {
            let on_loss = *rules.sources.get(&source.source).unwrap_or(&rules.on_loss);
            if !which(on_loss) {
                continue;
            }
            any = true;
            source.lost = true;
            source.forced_by = None;
            match on_loss {
                OnLoss::Keep => {}
                OnLoss::Off => source.value = false,
                OnLoss::On => {
                    source.value = true;
                    source.text = format!("handler {handler_id}, which sets {}, is lost", source.source);
                }
            }
        }
        self.tidy();
        any
    }

    /// Returns the index of the entry that a message replaces. This is the entry of the sender; if the sender
    /// is a handler without an entry, this is an entry without an owner or with a lost owner.
    fn index_of(&self, set: &LockSet) -> Option<usize> {
        let of_source = |source: &LockSource| source.source == set.source();
        let is_own =
            |source: &LockSource| of_source(source) && !source.lost && source.handler_id == set.handler_id;
        let own = self.sources.iter().position(is_own);
        let is_free = |source: &LockSource| {
            set.handler_id.is_some() && of_source(source) && (source.lost || source.handler_id.is_none())
        };
        own.or_else(|| self.sources.iter().position(is_free))
    }

    /// Rejects a client without a presence that tries to clear the source of a handler.
    fn check_clear(&self, name: &str) -> Result<(), Refusal> {
        let mut on = self
            .sources
            .iter()
            .filter(|source| source.source == name && source.value);
        let Some(source) = on.next() else { return Ok(()) };
        let owner = match &source.handler_id {
            Some(id) => format!("belongs to handler {id}, and only this handler can clear it"),
            None => "waits for its handler, and only a handler can clear it".to_owned(),
        };
        let text = format!(
            "source {name} of the {} {owner}; an operator can clear it with force: true",
            self.name
        );
        Err(Refusal::new(RefusalCode::NotAllowed, text))
    }

    fn force(&mut self, set: LockSet) -> Result<(), Refusal> {
        let by = set.handler_id.clone().unwrap_or_else(|| "operator".to_owned());
        let mut any = false;
        for source in self
            .sources
            .iter_mut()
            .filter(|source| source.source == set.source())
        {
            any = true;
            source.value = set.value;
            source.text.clone_from(&set.text);
            source.forced_by = Some(by.clone());
        }
        if !any && set.value {
            self.add(LockSource {
                source: set.source().to_owned(),
                value: true,
                text: set.text,
                forced_by: Some(by),
                ..LockSource::default()
            })?;
        }
        self.tidy();
        Ok(())
    }

    fn add(&mut self, source: LockSource) -> Result<(), Refusal> {
        if self.sources.len() >= SOURCES_MAX {
            let text = format!(
                "the {} has {SOURCES_MAX} sources, which is the limit; clear a source, or use fewer names",
                self.name
            );
            return Err(Refusal::new(RefusalCode::Unavailable, text));
        }
        let place = self
            .sources
            .partition_point(|known| known.source <= source.source);
        self.sources.insert(place, source);
        Ok(())
    }

    /// Removes entries that are off and that are neither declared nor owned by an online handler.
    fn tidy(&mut self) {
        let declared = &self.rules.sources;
        let mut seen = Vec::new();
        self.sources.retain(|source| {
            let is_first = !seen.contains(&source.source);
            seen.push(source.source.clone());
            let is_owned = source.handler_id.is_some() && !source.lost;
            source.value || is_owned || (is_first && declared.contains_key(&source.source))
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rules(on_loss: OnLoss, declared: &[(&str, OnLoss)]) -> LockRules {
        let sources = declared
            .iter()
            .map(|(name, on_loss)| ((*name).to_owned(), *on_loss));
        LockRules {
            on_loss,
            sources: sources.collect(),
        }
    }

    fn input(on_loss: OnLoss, declared: &[(&str, OnLoss)]) -> LockInput {
        LockInput::new("interlock", rules(on_loss, declared))
    }

    fn by(handler: &str, source: &str, value: bool) -> LockSet {
        LockSet {
            handler_id: Some(handler.to_owned()),
            ..LockSet::new(value, format!("{source} of {handler}")).of_source(source)
        }
    }

    fn anyone(source: &str, value: bool) -> LockSet {
        LockSet::new(value, "by hand").of_source(source)
    }

    #[allow(clippy::unnecessary_wraps, reason = "same signature as the machine")]
    fn there(_: &str, _: Option<&String>) -> Result<(), Refusal> {
        Ok(())
    }

    fn nobody(_: &str, _: Option<&String>) -> Result<(), Refusal> {
        Err(Refusal::new(RefusalCode::Unavailable, "it is not online"))
    }

    /// Reports the loss of a handler to the lock, and ends the grace time of the handler.
    fn lose(lock: &mut LockInput, handler_id: &str) -> bool {
        lock.mark_handler_offline(handler_id, Departure::Unannounced { until_s: 0.0 })
            | lock.expire(0.0, |_| false)
    }

    /// Creates a source of handler `a` for each `on_loss`: on if the loss of the handler clears the source,
    /// otherwise off.
    fn of_each_on_loss() -> LockInput {
        let declared = [("door", OnLoss::On), ("air", OnLoss::Off), ("oil", OnLoss::Keep)];
        let mut lock = input(OnLoss::Keep, &declared);
        for (source, value) in [("door", false), ("air", true), ("oil", false)] {
            lock.set(by("a", source, value), there).unwrap();
        }
        lock
    }

    /// Returns for each of the sources `air`, `door` and `oil`: the value, and true if its owner is lost.
    fn shown(lock: &LockInput) -> Vec<(bool, bool)> {
        let sources = lock.state().sources;
        sources.iter().map(|source| (source.value, source.lost)).collect()
    }

    const AS_SET: [(bool, bool); 3] = [(true, false), (false, false), (false, false)];

    #[test]
    fn an_unannounced_loss_sets_on_sources_at_once_and_others_after_the_grace() {
        let mut lock = of_each_on_loss();
        assert!(lock.mark_handler_offline("a", Departure::Unannounced { until_s: 12.0 }));
        let at_once = [(true, false), (true, true), (false, false)];
        assert_eq!(shown(&lock), at_once);
        assert_eq!(lock.next_deadline_s(), Some(12.0));
        assert!(!lock.expire(11.9, |_| false));
        assert!(lock.expire(12.0, |_| false));
        assert_eq!(shown(&lock), [(false, true), (true, true), (false, true)]);
        assert_eq!(lock.next_deadline_s(), None);
    }

    #[test]
    fn a_handler_that_is_back_within_the_grace_keeps_its_sources() {
        let mut lock = of_each_on_loss();
        lock.mark_handler_offline("a", Departure::Unannounced { until_s: 12.0 });
        lock.mark_handler_online("a");
        assert!(!lock.expire(20.0, |_| false));
        lock.set(by("a", "door", false), there).unwrap();
        assert_eq!(shown(&lock), AS_SET);
        lock.mark_handler_offline("a", Departure::Unannounced { until_s: 32.0 });
        assert!(!lock.expire(32.0, |_| true), "the handler is online");
    }

    #[test]
    fn announced_departure_keeps_sources_until_its_time_takeover_for_good() {
        let mut lock = of_each_on_loss();
        assert!(!lock.mark_handler_offline("a", Departure::Announced { until_s: 60.0 }));
        assert!(!lock.expire(59.9, |_| false));
        assert_eq!(shown(&lock), AS_SET);
        assert!(lock.expire(60.0, |_| false));
        assert_eq!(shown(&lock), [(false, true), (true, true), (false, true)]);
        let mut lock = of_each_on_loss();
        assert!(!lock.mark_handler_offline("a", Departure::TakenOver));
        assert!(!lock.expire(f64::MAX, |_| false));
        assert_eq!(shown(&lock), AS_SET);
    }

    #[test]
    fn it_is_on_while_any_source_is_and_says_why_each_is() {
        let mut lock = input(OnLoss::Keep, &[]);
        lock.set(by("a", "door", true), there).unwrap();
        lock.set(by("b", "air", true), there).unwrap();
        assert_eq!(lock.text(), "air of b; door of a");
        lock.set(by("a", "door", false), there).unwrap();
        assert_eq!((lock.is_on(), lock.text().as_str()), (true, "air of b"));
        lock.set(by("b", "air", false), there).unwrap();
        assert_eq!((lock.is_on(), lock.text().as_str()), (false, ""));
    }

    #[test]
    fn clients_without_presence_share_a_source_and_own_nothing() {
        let mut lock = input(OnLoss::On, &[]);
        lock.set(LockSet::new(true, "x"), there).unwrap();
        assert_eq!(lock.state().sources[0].source, "default");
        lock.set(LockSet::new(false, ""), there).unwrap();
        assert_eq!(lock.state(), Lock::default());
    }

    #[test]
    fn a_source_is_cleared_by_its_owner_alone() {
        let mut lock = input(OnLoss::Keep, &[]);
        lock.set(by("a", "door", true), there).unwrap();
        let refusal = lock.set(anyone("door", false), there).unwrap_err();
        assert_eq!(refusal.code, RefusalCode::NotAllowed);
        assert!(
            refusal.text.contains("handler a") && refusal.text.contains("force"),
            "{refusal}"
        );
        lock.set(by("b", "door", true), there).unwrap();
        lock.set(by("b", "door", false), there).unwrap();
        assert!(lock.is_on(), "a handler clears only its own entry");
        lock.set(anyone("door", true), there).unwrap();
        lock.set(anyone("door", false), there).unwrap();
        assert!(lock.is_on());
        lock.set(by("a", "door", false), there).unwrap();
        assert!(!lock.is_on());
    }

    #[test]
    fn an_operator_sets_any_source_with_a_mark_that_its_owner_ends() {
        let mut lock = input(OnLoss::Keep, &[("door", OnLoss::On)]);
        let force = |value| LockSet {
            handler_id: Some("panel".to_owned()),
            force: Some(true),
            ..anyone("door", value)
        };
        lock.set(force(false), nobody).unwrap();
        assert!(!lock.is_on());
        assert_eq!(lock.state().sources[0].forced_by.as_deref(), Some("panel"));
        lock.set(by("a", "door", true), there).unwrap();
        assert_eq!(
            (lock.is_on(), lock.state().sources[0].forced_by.clone()),
            (true, None)
        );
    }

    #[test]
    fn a_source_without_its_owner_has_the_value_of_its_on_loss() {
        for (on_loss, was, is) in [
            (OnLoss::On, false, true),
            (OnLoss::Off, true, false),
            (OnLoss::Keep, true, true),
            (OnLoss::Keep, false, false),
        ] {
            let mut lock = input(on_loss, &[]);
            lock.set(by("a", "door", was), there).unwrap();
            assert!(!lose(&mut lock, "b"));
            assert!(lose(&mut lock, "a"));
            assert_eq!(lock.is_on(), is, "{on_loss:?} {was}");
            lock.set(by("c", "door", false), there).unwrap();
            assert!(!lock.is_on(), "the handler that sets the source now owns it");
        }
    }

    #[test]
    fn declared_sources_begin_at_their_on_loss_and_wait_for_an_owner() {
        let mut lock = input(OnLoss::Keep, &[("air", OnLoss::Off), ("door", OnLoss::On)]);
        assert_eq!(
            (lock.is_on(), lock.text().as_str()),
            (true, "no handler has set door since the start")
        );
        assert_eq!(lock.state().sources.len(), 2);
        let refusal = lock.set(anyone("door", false), there).unwrap_err();
        assert_eq!(refusal.code, RefusalCode::NotAllowed);
        let refusal = lock.set(by("a", "door", false), nobody).unwrap_err();
        assert_eq!(refusal.code, RefusalCode::Unavailable);
        lock.set(by("a", "door", false), there).unwrap();
        assert!(!lock.is_on());
        lose(&mut lock, "a");
        assert!(lock.is_on());
        assert_eq!(lock.state().sources.len(), 2);
    }

    #[test]
    fn of_too_many_sources_a_further_one_is_refused_and_a_known_one_is_set() {
        let mut lock = input(OnLoss::Keep, &[]);
        for n in 0..SOURCES_MAX {
            lock.set(by("a", &n.to_string(), false), there).unwrap();
        }
        assert!(lock.set(anyone("x", true), there).is_err());
        lock.set(by("a", "0", true), there).unwrap();
        assert!(lock.set(LockSet::new(false, "x".repeat(501)), there).is_err());
        assert!(lock.set(anyone("a/b", true), there).is_err());
    }
}
