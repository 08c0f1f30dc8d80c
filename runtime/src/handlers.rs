//! The registered handlers, and the M codes that each serves.

use std::collections::BTreeMap;

use plc_api::types::CoordinateSystemNumber;
use plc_api::types::output::HandlerPresence;

/// Handlers that are or were there. A further one is refused.
pub const HANDLERS_MAX: usize = 256;

/// Handlers by their ids.
#[derive(Debug, Default)]
pub(crate) struct Handlers(BTreeMap<String, HandlerPresence>);

/// There are too many handlers.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct TooMany;

impl Handlers {
    /// Notes a handler; gives the one that was forgotten for it: one that is not there any more.
    ///
    /// # Errors
    /// All are there.
    pub fn set(&mut self, id: &str, presence: HandlerPresence) -> Result<Option<String>, TooMany> {
        let mut forgotten = None;
        if self.0.len() >= HANDLERS_MAX && !self.0.contains_key(id) {
            let gone = self.0.iter().find(|(_, presence)| !presence.online);
            let gone = gone.map(|(id, _)| id.clone()).ok_or(TooMany)?;
            self.0.remove(&gone);
            forgotten = Some(gone);
        }
        self.0.insert(id.to_owned(), presence);
        Ok(forgotten)
    }

    /// All that are or were there.
    pub fn all(&self) -> BTreeMap<String, HandlerPresence> {
        self.0.clone()
    }

    /// True while a handler is there.
    pub fn is_online(&self, id: &str) -> bool {
        self.0.get(id).is_some_and(|handler| handler.online)
    }

    /// True when a handler that is there serves this M code.
    pub fn serve(&self, cs: CoordinateSystemNumber, m: u16) -> bool {
        let mut handlers = self.0.values().filter(|handler| handler.online);
        handlers.any(|handler| handler.handles.iter().any(|code| (code.cs, code.m) == (cs, m)))
    }
}

#[cfg(test)]
mod tests {
    use plc_api::types::output::HandledCode;

    use super::*;

    fn presence(online: bool) -> HandlerPresence {
        HandlerPresence {
            online,
            handles: vec![HandledCode { cs: 1, m: 100 }],
            validates: false,
        }
    }

    #[test]
    fn a_code_is_served_in_its_coordinate_system_while_its_handler_is_there() {
        let mut handlers = Handlers::default();
        handlers.set("gripper", presence(true)).unwrap();
        assert!(handlers.serve(1, 100));
        assert!(!handlers.serve(2, 100) && !handlers.serve(1, 101));
        handlers.set("gripper", presence(false)).unwrap();
        assert!(!handlers.serve(1, 100) && !handlers.is_online("gripper") && !handlers.is_online("x"));
        assert_eq!(handlers.all().len(), 1);
    }

    #[test]
    fn of_too_many_handlers_one_that_has_gone_is_forgotten_and_one_that_is_there_never() {
        let mut handlers = Handlers::default();
        for n in 0..HANDLERS_MAX {
            assert_eq!(handlers.set(&n.to_string(), presence(n != 7)), Ok(None));
        }
        assert_eq!(handlers.set("0", presence(true)), Ok(None), "known already");
        assert_eq!(handlers.set("a", presence(true)), Ok(Some("7".to_owned())));
        assert_eq!(handlers.set("b", presence(true)), Err(TooMany));
    }
}
