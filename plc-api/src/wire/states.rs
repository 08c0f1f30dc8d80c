//! States that can be read: the same messages as on MQTT, with the revision as `ETag`.

use super::route::{Content, Route};
use crate::types::CoordinateSystemNumber;
use crate::types::topic::{CsTopic, Topic};

/// Whose state it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum StateOf {
    /// The machine's.
    Machine(Topic),
    /// A coordinate system's.
    CoordinateSystem(CsTopic),
}

impl StateOf {
    /// The topic of the state; `cs` where it is a coordinate system's.
    pub fn topic(&self, cs: CoordinateSystemNumber) -> Topic {
        match self {
            StateOf::Machine(topic) => topic.clone(),
            StateOf::CoordinateSystem(topic) => Topic::cs(cs, *topic),
        }
    }
}

/// One state with its route.
#[derive(Debug)]
pub struct StateRow {
    /// Which.
    pub of: StateOf,
    /// Where it is read.
    pub route: Route,
}

const fn machine(
    topic: Topic,
    pattern: &'static str,
    summary: &'static str,
    answers: &'static [(u16, Content)],
) -> StateRow {
    StateRow {
        of: StateOf::Machine(topic),
        route: Route::get(pattern, summary, answers),
    }
}

const fn cs(
    topic: CsTopic,
    pattern: &'static str,
    summary: &'static str,
    answers: &'static [(u16, Content)],
) -> StateRow {
    StateRow {
        of: StateOf::CoordinateSystem(topic),
        route: Route::get(pattern, summary, answers),
    }
}

const LOCK: &[(u16, Content)] = &[(200, Content::Json("LockMessage"))];
const SWITCH: &[(u16, Content)] = &[(200, Content::Json("SwitchMessage"))];

/// Every state that has a route.
#[rustfmt::skip]
pub static STATES: [StateRow; 18] = [
    machine(Topic::Birth, "/machine", "What the machine is: coordinate systems, axes, motors, M codes, limits.", &[(200, Content::Json("BirthMessage"))]),
    machine(Topic::AlarmActive, "/alarms", "Active alarms.", &[(200, Content::Json("ActiveAlarmsMessage"))]),
    cs(CsTopic::State, "/cs/{cs}/state", "State of a coordinate system; its ETag is the revision for If-Match.", &[(200, Content::Json("StateMessage"))]),
    cs(CsTopic::Position, "/cs/{cs}/position", "Positions of the last servo cycle.", &[(200, Content::Json("PositionMessage"))]),
    cs(CsTopic::Program, "/cs/{cs}/program", "Where the program is.", &[(200, Content::Json("ProgramPlaceMessage"))]),
    cs(CsTopic::Modal, "/cs/{cs}/modal", "Modal state.", &[(200, Content::Json("ModalMessage"))]),
    cs(CsTopic::Captured, "/cs/{cs}/captured", "Positions captured by the last G31.", &[(200, Content::Json("CapturedMessage"))]),
    cs(CsTopic::Pending, "/cs/{cs}/m_codes", "Auxiliary function outputs that are open.", &[(200, Content::Json("PendingMessage"))]),
    cs(CsTopic::Override, "/cs/{cs}/overrides", "Overrides, percent.", &[(200, Content::Json("OverridesMessage"))]),
    cs(CsTopic::Spindle, "/cs/{cs}/spindle", "The spindle.", &[(200, Content::Json("SpindleMessage"))]),
    cs(CsTopic::Tool, "/cs/{cs}/tool", "The tool in the spindle.", &[(200, Content::Json("ToolMessage"))]),
    cs(CsTopic::Lease, "/cs/{cs}/lease", "Who holds the control lease; all null while nobody does.", &[(200, Content::Json("LeaseStateMessage"))]),
    cs(CsTopic::OptionalSkip, "/cs/{cs}/inputs/optional_skip", "Optional block skips.", &[(200, Content::Json("OptionalSkipMessage"))]),
    cs(CsTopic::OptionalStop, "/cs/{cs}/inputs/optional_stop", "The optional stop input.", SWITCH),
    cs(CsTopic::SingleBlock, "/cs/{cs}/inputs/single_block", "The single block input.", SWITCH),
    cs(CsTopic::DryRun, "/cs/{cs}/inputs/dry_run", "The dry run input.", SWITCH),
    cs(CsTopic::Interlock, "/cs/{cs}/inputs/interlock", "The interlock input.", LOCK),
    cs(CsTopic::StartLock, "/cs/{cs}/inputs/start_lock", "The start lock input.", LOCK),
];
