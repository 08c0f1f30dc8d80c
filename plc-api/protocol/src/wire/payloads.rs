//! Payloads and bodies that have no type in [`types`](crate::types), and conversions for rows whose form
//! differs between transports.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::answer::AnswerForm;
use super::parameter::{Fault, QueryValues};
use super::row::{IncomingRequest, PROGRAM_SIGNATURE, RequestParts};
use crate::types::command::Command;
#[cfg(feature = "schema")]
use crate::types::data::VARIABLES_AT_ONCE_MAX;
use crate::types::data::{JournalFilter, JsonNumber, VariableArea, VariableKind};
use crate::types::lease::{LeaseRelease, LeaseRequest};
use crate::types::line_start::Approach;
use crate::types::planned::{PATH_TOLERANCE_MM, PathQuery};
use crate::types::request::{Input, Request};
use crate::types::run::{RUN_WAIT_MAX_S, RUNS_AT_ONCE_MAX, RunQuery};
use crate::types::state::{LockSet, Switch};
use crate::types::trace::{TRACE_SAMPLES_MAX, TraceQuery};
use crate::types::upload::ProgramUpload;

/// Largest number of an optional block skip.
const SKIP_MAX: u8 = 31;

/// Number of runs in an answer if the query contains no number.
const RUNS: u32 = 100;

/// Body of a command without arguments.
#[derive(Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub(super) struct Empty {}

/// Body of the command `start`.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(deny_unknown_fields))]
#[allow(dead_code, reason = "the form of the arguments that Command::parse reads")]
pub(super) struct StartArgs {
    /// Line of the first block, from 1; null for the beginning of the program. The other fields require a
    /// line.
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    from_line: Option<u32>,
    /// The program that contains the line, if it is a subprogram.
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = 9999)))]
    program: Option<u16>,
    /// Number of the pass of the program over the line, from 1.
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    occurrence: Option<u32>,
    /// Order in which the axes approach the start of the block; null for `plane_first`.
    approach: Option<Approach>,
}

/// Body of hold, stop and abort, or of a request that ends a lease; the fields of the body are ignored.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(super) struct NoArgs {}

/// Payload of a command, without its envelope.
#[derive(Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "Command"))]
#[serde(deny_unknown_fields)]
pub(super) struct CommandArgs {
    /// Arguments of the verb.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schemars(with = "serde_json::Map<String, Value>"))]
    pub args: Value,
}

/// Payload that ends the control lease, without its envelope.
#[derive(Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub(super) struct LeaseBreak {}

/// Body that sets an on/off input; other fields are refused.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Toggle {
    value: bool,
}

/// Payload that sets optional block skips.
#[derive(Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub(super) struct Skips {
    /// True or false by number, 1 to 31; numbers that are not in this map do not change.
    set: BTreeMap<u8, bool>,
}

/// Payload that sets an input.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(untagged)]
pub(super) enum InputSet {
    Switch(Switch),
    Lock(LockSet),
    Skips(Skips),
}

/// Body of a request that writes variables.
#[derive(Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub(super) struct VariableWrite {
    /// Letter of the variables as in the answer to `GET`; must be the letter in the path.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kind: Option<VariableKind>,
    /// Number of the first variable as in the answer to `GET`; must be the number in the query.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from: Option<u32>,
    /// Values of the variables, ascending by number.
    #[cfg_attr(feature = "schema", schemars(length(min = 1, max = VARIABLES_AT_ONCE_MAX)))]
    pub values: Vec<JsonNumber>,
}

impl VariableWrite {
    pub(super) fn from_values(values: Vec<JsonNumber>) -> Self {
        Self {
            kind: None,
            from: None,
            values,
        }
    }

    /// Rejects a body that contradicts its path and query in the letter, the first number or the number of
    /// values.
    fn check(&self, area: VariableArea, from: u32, count: Option<u32>) -> Result<(), Fault> {
        if let Some(kind) = self.kind.filter(|kind| *kind != area.kind()) {
            let text = format!(
                "the path names {:?} variables, and kind in the body {kind:?}; write both alike",
                area.kind()
            );
            return Err(Fault::Invalid(text));
        }
        if let Some(other) = self.from.filter(|other| *other != from) {
            let text = format!("from={from} in the query, and {other} in the body; write both alike");
            return Err(Fault::Invalid(text));
        }
        match count.filter(|count| *count as usize != self.values.len()) {
            Some(count) => Err(Fault::Invalid(format!(
                "count={count}, and the body has {} values",
                self.values.len()
            ))),
            None => Ok(()),
        }
    }
}

/// Payload that reads variables, without its envelope.
#[derive(Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub(super) struct VariableGet {
    /// Letter of the variables.
    pub kind: VariableKind,
    /// Number of the first variable.
    pub from: u32,
    /// Number of variables.
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = VARIABLES_AT_ONCE_MAX)))]
    pub count: u32,
}

/// Payload that sets variables, without its envelope.
#[derive(Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub(super) struct VariableSet {
    /// Letter of the variables.
    pub kind: VariableKind,
    /// Number of the first variable.
    pub from: u32,
    /// Values of the variables, ascending by number.
    #[cfg_attr(feature = "schema", schemars(length(min = 1, max = VARIABLES_AT_ONCE_MAX)))]
    pub values: Vec<JsonNumber>,
}

/// Adds the filter of the journal to the query of a request.
pub(super) fn with_filter(parts: RequestParts, filter: JournalFilter) -> RequestParts {
    let JournalFilter {
        since,
        until,
        cs,
        m,
        user,
        run,
    } = filter;
    let values = [
        ("since", since),
        ("until", until),
        ("cs", cs.map(|cs| cs.to_string())),
        ("m", m.map(|m| m.to_string())),
        ("user", user),
        ("run", run),
    ];
    let named = values
        .into_iter()
        .filter_map(|(name, value)| Some((name, value?)));
    named.fold(parts, |parts, (name, value)| parts.query(name, value))
}

pub(super) fn command_answer(request: &Request) -> AnswerForm {
    let wait = matches!(request, Request::Command { wait: true, .. });
    AnswerForm::Command { wait }
}

pub(super) fn handshake(request: &Request) -> AnswerForm {
    let (seq, handler_id) = match request {
        Request::Claim(_, _, claim) => (claim.seq, claim.handler_id.as_str()),
        Request::Reset(_, _, reset) => (reset.seq, reset.handler_id.as_str()),
        Request::Ask(_, _, ask) => (ask.seq, ask.handler_id.as_str()),
        Request::AnswerQuestion(_, _, answer) => {
            (answer.seq, answer.client_id.as_deref().unwrap_or_default())
        }
        _ => return AnswerForm::Nothing,
    };
    AnswerForm::Handshake {
        seq,
        handler_id: handler_id.to_owned(),
        is_answer: matches!(request, Request::AnswerQuestion(..)),
    }
}

pub(super) fn variables(request: &Request) -> AnswerForm {
    match request {
        Request::ReadVariables { area, from, .. } => AnswerForm::Variables {
            kind: area.kind(),
            from: *from,
        },
        _ => AnswerForm::Nothing,
    }
}

pub(super) fn read_command(incoming: &IncomingRequest<'_>, command: Command) -> Result<Request, Fault> {
    let (cs, meta, wait) = (incoming.cs()?, incoming.meta()?, incoming.wait()?);
    Ok(Request::Command {
        cs,
        command,
        meta,
        wait,
    })
}

pub(super) fn lease(
    incoming: &IncomingRequest<'_>,
    request: fn(&IncomingRequest<'_>) -> Result<LeaseRequest, Fault>,
) -> Result<Request, Fault> {
    let (cs, request, meta) = (incoming.cs()?, request(incoming)?, incoming.meta()?);
    Ok(Request::Lease { cs, request, meta })
}

/// Reads the request that releases a lease. Over REST, the header `Lease-Fence` contains the number of the
/// lease.
pub(super) fn release(incoming: &IncomingRequest<'_>) -> Result<LeaseRequest, Fault> {
    if !incoming.is_rest() {
        return incoming.json().map(LeaseRequest::Release);
    }
    let text = "name the lease to release by the header Lease-Fence";
    let fence = incoming.fence()?.ok_or_else(|| Fault::Invalid(text.to_owned()))?;
    Ok(LeaseRequest::Release(LeaseRelease { fence }))
}

/// Reads the request that breaks a lease. Over REST, fields of the body are ignored.
pub(super) fn break_lease(incoming: &IncomingRequest<'_>) -> Result<LeaseRequest, Fault> {
    if incoming.is_rest() {
        incoming.json::<Value>()?;
    } else {
        incoming.json::<LeaseBreak>()?;
    }
    Ok(LeaseRequest::Break)
}

/// Reads an on/off value. Over MQTT, other fields are ignored.
pub(super) fn switch(incoming: &IncomingRequest<'_>) -> Result<bool, Fault> {
    if incoming.is_rest() {
        incoming.json().map(|Toggle { value }| value)
    } else {
        incoming.json().map(|Switch { value }| value)
    }
}

pub(super) fn read_input(incoming: &IncomingRequest<'_>) -> Result<Input, Fault> {
    Ok(match incoming.text("input") {
        "optional_skip" => Input::OptionalSkip(skips(incoming)?),
        "optional_stop" => Input::OptionalStop(switch(incoming)?),
        "single_block" => Input::SingleBlock(switch(incoming)?),
        "dry_run" => Input::DryRun(switch(incoming)?),
        "interlock" => Input::Interlock(incoming.json()?),
        "start_lock" => Input::StartLock(incoming.json()?),
        _ => return Err(Fault::Invalid("there is no such input".to_owned())),
    })
}

/// Reads the request that sets an input. Overrides have a separate row.
#[allow(
    clippy::result_large_err,
    reason = "a request that is not of the row is given back as it is"
)]
pub(super) fn write_input(cs: u8, input: Input) -> Result<RequestParts, Request> {
    let (name, set) = match input {
        Input::OptionalSkip(set) => ("optional_skip", InputSet::Skips(Skips { set })),
        Input::OptionalStop(value) => ("optional_stop", InputSet::Switch(Switch { value })),
        Input::SingleBlock(value) => ("single_block", InputSet::Switch(Switch { value })),
        Input::DryRun(value) => ("dry_run", InputSet::Switch(Switch { value })),
        Input::Interlock(lock) => ("interlock", InputSet::Lock(lock)),
        Input::StartLock(lock) => ("start_lock", InputSet::Lock(lock)),
        Input::Override(_) => return Err(Request::Input(cs, input)),
    };
    let parts = RequestParts::for_coordinate_system(cs)
        .with("input", name)
        .json(&set);
    Ok(match &set {
        InputSet::Skips(Skips { set: skips }) => match skips.first_key_value() {
            Some((number, value)) => {
                let parts = parts.with("number", number).payload(&set);
                parts.json(&Switch { value: *value })
            }
            None => parts,
        },
        _ => parts,
    })
}

/// Reads optional block skips. Over REST, the path contains the number of a single skip.
pub(super) fn skips(incoming: &IncomingRequest<'_>) -> Result<BTreeMap<u8, bool>, Fault> {
    if !incoming.is_rest() {
        return incoming.json().map(|Skips { set }| set);
    }
    let (number, value) = (incoming.number("number")?, switch(incoming)?);
    if !(1..=SKIP_MAX).contains(&number) {
        let text = format!("there is no optional block skip {number}; write 1 to {SKIP_MAX}");
        return Err(Fault::NotFound(text));
    }
    Ok([(number, value)].into())
}

/// Creates the parts of a request for an area of variables. P variables use the topics of coordinate system
/// 1, because the topics of each coordinate system give access to P variables.
pub(super) fn of_area(area: VariableArea, verb: &str) -> RequestParts {
    let (cs, kind) = match area {
        VariableArea::Global => (1, "p"),
        VariableArea::CoordinateSystem(cs) => (cs, "q"),
    };
    RequestParts::for_coordinate_system(cs)
        .with("kind", kind)
        .with("verb", verb)
}

/// Reads the area of variables that a route contains.
pub(super) fn area(incoming: &IncomingRequest<'_>) -> Result<VariableArea, Fault> {
    let cs = incoming.optional_number("cs")?;
    Ok(cs.map_or(VariableArea::Global, VariableArea::CoordinateSystem))
}

/// Reads the wait time, s.
pub(super) fn read_seconds(incoming: &IncomingRequest<'_>) -> Result<u32, Fault> {
    let Some(wait) = &incoming.query.wait else {
        return Ok(0);
    };
    let seconds = wait.parse().ok().filter(|seconds| *seconds <= RUN_WAIT_MAX_S);
    seconds.ok_or_else(|| Fault::Invalid(format!("wait={wait:.16}: write seconds, 0 to {RUN_WAIT_MAX_S}")))
}

/// Reads the filter for runs.
pub(super) fn read_runs(incoming: &IncomingRequest<'_>) -> Result<RunQuery, Fault> {
    let QueryValues { from, count, cs, .. } = incoming.query;
    at_least_one("count", count)?;
    at_least_one("cs", cs.map(u32::from))?;
    Ok(RunQuery {
        cs,
        from: from.unwrap_or_default(),
        count: count.unwrap_or(RUNS).min(RUNS_AT_ONCE_MAX),
    })
}

fn at_least_one(name: &str, value: Option<u32>) -> Result<(), Fault> {
    match value {
        Some(0) => Err(Fault::Invalid(format!("{name}=0: write 1 or more"))),
        _ => Ok(()),
    }
}

/// Reads the query for samples of the recent motion.
pub(super) fn read_trace(incoming: &IncomingRequest<'_>) -> Result<TraceQuery, Fault> {
    let QueryValues {
        from, count, axes, ..
    } = &incoming.query;
    at_least_one("count", *count)?;
    Ok(TraceQuery {
        from: from.unwrap_or_default(),
        count: count.unwrap_or(TRACE_SAMPLES_MAX).min(TRACE_SAMPLES_MAX),
        axes: axes.clone().unwrap_or_default(),
    })
}

/// Reads the query for a part of a planned path.
pub(super) fn read_path(incoming: &IncomingRequest<'_>) -> Result<PathQuery, Fault> {
    let QueryValues {
        from,
        count,
        cs,
        tolerance,
        ..
    } = incoming.query;
    at_least_one("count", count)?;
    if let Some(tolerance) = tolerance
        && !(tolerance >= PATH_TOLERANCE_MM && tolerance.is_finite())
    {
        let text = format!("tolerance={tolerance} is not allowed; write {PATH_TOLERANCE_MM} mm or more");
        return Err(Fault::Invalid(text));
    }
    Ok(PathQuery {
        cs,
        tolerance,
        from: from.unwrap_or_default(),
        count,
    })
}

pub(super) fn read_variables(incoming: &IncomingRequest<'_>) -> Result<Request, Fault> {
    let (area, from, count) = if incoming.is_rest() {
        let QueryValues { from, count, .. } = incoming.query;
        (area(incoming)?, from.unwrap_or_default(), count.unwrap_or(1))
    } else {
        let VariableGet { kind, from, count } = incoming.json()?;
        (VariableArea::from_kind(kind, incoming.cs()?), from, count)
    };
    Ok(Request::ReadVariables {
        area,
        from,
        count,
        meta: incoming.payload_meta(),
    })
}

pub(super) fn write_variables(incoming: &IncomingRequest<'_>) -> Result<Request, Fault> {
    let (area, from, values) = if incoming.is_rest() {
        let write: VariableWrite = incoming.json()?;
        let QueryValues { from, count, .. } = incoming.query;
        let from =
            from.ok_or_else(|| Fault::Invalid("the query names no variable; write ?from=".to_owned()))?;
        let area = area(incoming)?;
        write.check(area, from, count)?;
        (area, from, write.values)
    } else {
        let VariableSet { kind, from, values } = incoming.json()?;
        (VariableArea::from_kind(kind, incoming.cs()?), from, values)
    };
    Ok(Request::WriteVariables {
        area,
        from,
        values: values.into_iter().map(|number| number.0).collect(),
        meta: incoming.payload_meta(),
    })
}

/// Reads a request that stores a program. A request with only a text becomes `WriteProgram`.
pub(super) fn store_program(incoming: IncomingRequest<'_>) -> Result<Request, Fault> {
    let (number, condition, signature) = (
        incoming.number("number")?,
        incoming.condition()?,
        incoming.signature(),
    );
    let dialect = incoming.query.dialect.clone();
    let is_plain = condition.is_none() && signature.is_none() && dialect.is_none();
    let upload = ProgramUpload {
        text: text(incoming)?,
        condition,
        signature,
        dialect,
    };
    if is_plain {
        return Ok(Request::WriteProgram(number, upload.text));
    }
    Ok(Request::StoreProgram(number, upload))
}

/// Reads the request to check a text; the text is the body.
pub(super) fn check_text(incoming: IncomingRequest<'_>) -> Result<Request, Fault> {
    let (number, dialect) = (incoming.number("number")?, incoming.query.dialect.clone());
    Ok(Request::CheckText(number, dialect, text(incoming)?))
}

/// Creates the parts of a request that stores a program.
pub(super) fn upload(number: u16, upload: ProgramUpload) -> RequestParts {
    let parts = RequestParts::default().with("number", number);
    let parts = parts.text(upload.text).condition(&upload.condition);
    let parts = match upload.signature {
        Some(signature) => parts.header(PROGRAM_SIGNATURE, signature),
        None => parts,
    };
    match upload.dialect {
        Some(dialect) => parts.query("dialect", dialect),
        None => parts,
    }
}

/// Reads a request that removes a program. A request without a condition becomes `DeleteProgram`.
pub(super) fn remove_program(incoming: &IncomingRequest<'_>) -> Result<Request, Fault> {
    let (number, condition) = (incoming.number("number")?, incoming.condition()?);
    Ok(if condition.is_none() {
        Request::DeleteProgram(number)
    } else {
        Request::RemoveProgram(number, condition)
    })
}

fn text(incoming: IncomingRequest<'_>) -> Result<String, Fault> {
    String::from_utf8(incoming.body.into_owned()).map_err(|error| {
        let place = error.utf8_error().valid_up_to();
        Fault::Invalid(format!(
            "the text is not UTF-8 at byte {place}; save the program as UTF-8"
        ))
    })
}
