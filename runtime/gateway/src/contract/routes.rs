//! Routes of `/api/v1`.

use axum::http::Method;

use crate::access::Right;

/// Path before all routes of the interface.
pub(crate) const API: &str = "/api/v1";

/// What a request or an answer carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(not(test), allow(dead_code, reason = "for the generated documents"))]
pub(crate) enum Content {
    Nothing,
    /// JSON, by name of its schema.
    Json(&'static str),
    /// Text: an NC program, or metrics.
    Text,
    /// Any JSON object: a document.
    Document,
}

/// One route.
#[derive(Debug)]
#[cfg_attr(not(test), allow(dead_code, reason = "for the generated documents"))]
pub(crate) struct Route {
    pub(crate) method: &'static str,
    /// Path below `/api/v1`, with names in braces.
    pub(crate) path: &'static str,
    /// What it asks of its caller; `None`: nothing, since it tells nothing of the machine.
    pub(crate) right: Option<Right>,
    pub(crate) summary: &'static str,
    pub(crate) body: Content,
    /// Status of success, and what it carries.
    pub(crate) answers: &'static [(u16, Content)],
    /// True for commands, which take `?wait`, `Idempotency-Key` and `If-Match`.
    pub(crate) command: bool,
}

use Content::{Document, Json, Nothing, Text};
use Right::{Administrate, Handle, Operate, Raise, Read, Reset};

const fn get(path: &'static str, summary: &'static str, answers: &'static [(u16, Content)]) -> Route {
    route("GET", path, Some(Read), summary, Nothing, answers)
}

const fn open(path: &'static str, summary: &'static str, answers: &'static [(u16, Content)]) -> Route {
    route("GET", path, None, summary, Nothing, answers)
}

const fn put(path: &'static str, right: Right, summary: &'static str, body: Content) -> Route {
    route("PUT", path, Some(right), summary, body, NO_CONTENT)
}

const fn post(
    path: &'static str,
    right: Right,
    summary: &'static str,
    body: Content,
    answers: &'static [(u16, Content)],
) -> Route {
    route("POST", path, Some(right), summary, body, answers)
}

const fn command(path: &'static str, summary: &'static str, body: Content) -> Route {
    Route {
        command: true,
        ..post(path, Operate, summary, body, COMMANDED)
    }
}

/// Of the control lease: answered when it is done, and again where the same id comes twice.
const fn lease(
    method: &'static str,
    path: &'static str,
    right: Right,
    summary: &'static str,
    body: Content,
) -> Route {
    route(method, path, Some(right), summary, body, LEASED)
}

const fn route(
    method: &'static str,
    path: &'static str,
    right: Option<Right>,
    summary: &'static str,
    body: Content,
    answers: &'static [(u16, Content)],
) -> Route {
    Route {
        method,
        path,
        right,
        summary,
        body,
        answers,
        command: false,
    }
}

const NO_CONTENT: &[(u16, Content)] = &[(204, Nothing)];
const COMMANDED: &[(u16, Content)] = &[(200, Json("CommandReply")), (202, Json("CommandAccepted"))];
const LEASED: &[(u16, Content)] = &[(200, Json("CommandReply"))];
const HANDSHAKE: &[(u16, Content)] = &[(200, Json("HandshakeResult"))];
const CHECKED: &[(u16, Content)] = &[(200, Json("ProgramCheck"))];
const LOCKED: &[(u16, Content)] = &[(200, Json("LockMessage"))];
const SWITCHED: &[(u16, Content)] = &[(200, Json("SwitchMessage"))];
const A_DOCUMENT: &[(u16, Content)] = &[(200, Document)];
const A_TEXT: &[(u16, Content)] = &[(200, Text)];

/// Every route.
#[rustfmt::skip]
pub(crate) const ROUTES: &[Route] = &[
    get("/machine", "What the machine is: coordinate systems, axes, motors, M codes, limits.", &[(200, Json("BirthMessage"))]),
    get("/cs", "All coordinate systems with their states.", &[(200, Json("CoordinateSystems"))]),
    get("/cs/{cs}/state", "State of a coordinate system; its ETag is the revision for If-Match.", &[(200, Json("StateMessage"))]),
    get("/cs/{cs}/position", "Positions of the last servo cycle.", &[(200, Json("PositionMessage"))]),
    get("/cs/{cs}/program", "Where the program is.", &[(200, Json("ProgramPlaceMessage"))]),
    get("/cs/{cs}/modal", "Modal state.", &[(200, Json("ModalMessage"))]),
    get("/cs/{cs}/captured", "Positions captured by the last G31.", &[(200, Json("CapturedMessage"))]),
    get("/cs/{cs}/m_codes", "Auxiliary function outputs that are open.", &[(200, Json("PendingMessage"))]),
    get("/cs/{cs}/overrides", "Overrides, percent.", &[(200, Json("OverridesMessage"))]),
    get("/cs/{cs}/spindle", "The spindle.", &[(200, Json("SpindleMessage"))]),
    get("/cs/{cs}/tool", "The tool in the spindle.", &[(200, Json("ToolMessage"))]),
    get("/cs/{cs}/lease", "Who holds the control lease; all null while nobody does.", &[(200, Json("LeaseStateMessage"))]),
    get("/cs/{cs}/inputs", "All inputs.", &[(200, Json("Inputs"))]),
    get("/cs/{cs}/inputs/optional_skip", "Optional block skips.", &[(200, Json("OptionalSkipMessage"))]),
    get("/cs/{cs}/inputs/optional_stop", "The optional stop input.", SWITCHED),
    get("/cs/{cs}/inputs/single_block", "The single block input.", SWITCHED),
    get("/cs/{cs}/inputs/dry_run", "The dry run input.", SWITCHED),
    get("/cs/{cs}/inputs/interlock", "The interlock input.", LOCKED),
    get("/cs/{cs}/inputs/start_lock", "The start lock input.", LOCKED),
    command("/cs/{cs}/load", "Loads a program of the store.", Json("LoadArgs")),
    command("/cs/{cs}/start", "Starts the loaded program from its head.", Json("NoArgs")),
    command("/cs/{cs}/hold", "Feed hold.", Json("NoArgs")),
    command("/cs/{cs}/resume", "Goes on after a pause.", Json("NoArgs")),
    command("/cs/{cs}/stop", "Decelerates on the path and ends the run.", Json("NoArgs")),
    command("/cs/{cs}/reset", "Ends the run, cancels outputs, clears alarms.", Json("NoArgs")),
    command("/cs/{cs}/abort", "Brakes each motor at once and ends the run.", Json("NoArgs")),
    command("/cs/{cs}/mdi", "Runs a text of NC blocks.", Json("MdiArgs")),
    command("/cs/{cs}/jog", "Moves one axis by hand.", Json("JogArgs")),
    command("/cs/{cs}/home", "Returns axes to their reference points.", Json("HomeArgs")),
    command("/cs/{cs}/back_trace", "Goes back along the passed path, or ends that.", Json("BackTraceArgs")),
    lease("POST", "/cs/{cs}/lease", Operate, "Takes the control lease, or renews it with its fence.", Json("LeaseTake")),
    lease("DELETE", "/cs/{cs}/lease", Operate, "Gives the control lease back; Lease-Fence says which.", Nothing),
    lease("POST", "/cs/{cs}/lease/break", Administrate, "Ends the control lease, whoever holds it.", Nothing),
    command("/alarms/{id}/acknowledge", "Acknowledges an alarm.", Json("NoArgs")),
    get("/commands/{id}", "How far a command is.", &[(200, Json("CommandReply"))]),
    put("/cs/{cs}/inputs/optional_skip/{number}", Operate, "Sets one optional block skip, 1 to 31.", Json("Switch")),
    put("/cs/{cs}/inputs/optional_stop", Operate, "Sets the optional stop input.", Json("Switch")),
    put("/cs/{cs}/inputs/single_block", Operate, "Sets the single block input.", Json("Switch")),
    put("/cs/{cs}/inputs/dry_run", Operate, "Sets the dry run input.", Json("Switch")),
    put("/cs/{cs}/inputs/interlock", Operate, "Sets the interlock input.", Json("Lock")),
    put("/cs/{cs}/inputs/start_lock", Operate, "Sets the start lock input.", Json("Lock")),
    put("/cs/{cs}/overrides", Operate, "Sets overrides, percent; those left out stay.", Json("OverrideChange")),
    put("/cs/{cs}/spindle", Operate, "Commands the spindle.", Json("SpindleCommand")),
    put("/cs/{cs}/tool", Operate, "Selects a tool.", Json("Tool")),
    put("/motors/{number}/skip_input", Operate, "Sets the skip input of a motor; not real time.", Json("Switch")),
    post("/cs/{cs}/m_codes/{seq}/claim", Handle, "Claims an output. It is given back when the presence of this handler_id, told over a WebSocket or MQTT, ends.", Json("ClaimBody"), HANDSHAKE),
    post("/cs/{cs}/m_codes/{seq}/reset", Reset, "Resets an output, or tells its fault.", Json("ResetBody"), HANDSHAKE),
    post("/cs/{cs}/m_codes/{seq}/progress", Handle, "Tells how far an output's work is.", Json("ProgressBody"), NO_CONTENT),
    post("/cs/{cs}/m_codes/{seq}/redeliver", Operate, "Gives an output whose handler was lost to a handler again.", Json("RedeliverBody"), NO_CONTENT),
    post("/cs/{cs}/m_codes/{seq}/ask", Handle, "Asks the operator about an output.", Json("AskBody"), HANDSHAKE),
    post("/cs/{cs}/m_codes/{seq}/answer", Operate, "Answers a question of a handler.", Json("AnswerBody"), HANDSHAKE),
    get("/cs/{cs}/last_run", "The last run before this start of the runtime.", &[(200, Json("LastRunAnswer"))]),
    get("/journal", "The newest count lines of the journal but for the from newest, in the order of time.", &[(200, Json("JournalAnswer"))]),
    get("/variables/p", "P variables.", &[(200, Json("VariableValues"))]),
    put("/variables/p", Operate, "Sets P variables, all or none.", Json("VariableWrite")),
    get("/cs/{cs}/variables/q", "Q variables.", &[(200, Json("VariableValues"))]),
    put("/cs/{cs}/variables/q", Operate, "Sets Q variables, all or none.", Json("VariableWrite")),
    get("/cs/{cs}/work_offsets", "Work offsets.", &[(200, Json("WorkOffsetTable"))]),
    put("/cs/{cs}/work_offsets", Operate, "Sets work offsets; what is not named stays.", Json("WorkOffsetTable")),
    get("/tools", "The tool table.", &[(200, Json("ToolTable"))]),
    put("/tools", Operate, "Sets and removes tools; those not named stay.", Json("ToolChange")),
    get("/programs", "Programs of the store.", &[(200, Json("Programs"))]),
    get("/programs/{number}", "Text of a program.", A_TEXT),
    route("PUT", "/programs/{number}", Some(Administrate), "Stores a program, even with errors.", Text, &[(200, Json("ProgramCheck")), (201, Json("ProgramCheck"))]),
    route("DELETE", "/programs/{number}", Some(Administrate), "Deletes a program.", Nothing, NO_CONTENT),
    post("/programs/{number}/check", Read, "Checks a program of the store.", Nothing, CHECKED),
    get("/programs/{number}/intermediate", "Intermediate code of a program.", A_TEXT),
    get("/alarms", "Active alarms.", &[(200, Json("ActiveAlarmsMessage"))]),
    post("/alarms", Raise, "Raises an alarm of a coordinate system, or of all.", Json("AlarmRaise"), NO_CONTENT),
    get("/alarms/history", "Alarms of the past.", &[(200, Json("AlarmHistory"))]),
    get("/handlers", "Handlers of auxiliary function outputs.", &[(200, Json("Handlers"))]),
    open("/health", "Whether the server answers.", &[(200, Json("Health"))]),
    get("/metrics", "Counters, as Prometheus text.", A_TEXT),
    open("/openapi.json", "This document.", A_DOCUMENT),
    open("/asyncapi.json", "The document of the MQTT interface.", A_DOCUMENT),
    get("/ws", "WebSocket: messages of the topics that the client names.", &[(101, Nothing)]),
];

/// What stands in the tables for a request.
pub(crate) enum Found {
    Route(&'static Route),
    /// The path is there, with these methods only.
    OtherMethods(String),
    Nothing,
}

/// The row of a method and a path with its names in braces, below `/api/v1`.
pub(crate) fn find(method: &Method, path: &str) -> Found {
    let method = if method == Method::HEAD {
        "GET"
    } else {
        method.as_str()
    };
    let of_path = || ROUTES.iter().filter(|route| route.path == path);
    if let Some(route) = of_path().find(|route| route.method == method) {
        return Found::Route(route);
    }
    let mut methods: Vec<_> = of_path().map(|route| route.method).collect();
    if methods.is_empty() {
        return Found::Nothing;
    }
    if methods.contains(&"GET") {
        methods.push("HEAD");
    }
    Found::OtherMethods(methods.join(", "))
}
