//! A request that is written and then read is equal to the original, for requests of every row and on every
//! transport that carries them.

use std::borrow::Cow;
use std::collections::BTreeMap;

use proptest::prelude::*;

use super::pattern::take_apart;
use super::row::{IncomingRequest, ParsedRequest, Sender, Source};
use super::{ROWS, json_object, mqtt, rest, takes_not_after, websocket};
use crate::types::command::{Command, CommandMeta, Expect, MemoryKey};
use crate::types::data::{JournalFilter, ToolChange, ToolData, VariableArea, WorkOffsetTable};
use crate::types::heartbeat::ClientHeartbeat;
use crate::types::io::{IoForce, IoPoint, IoSet};
use crate::types::lease::{LeaseRelease, LeaseRequest, LeaseTake};
use crate::types::line_start::LineStart;
use crate::types::machine::AlarmRaise;
use crate::types::not_after::{NOT_AFTER_MAX_MS, NotAfter};
use crate::types::output::{
    CheckpointReport, Claim, HandledCode, HandlerPresence, ProgressReport, Redeliver, Redelivery, Reset,
    ResetResult,
};
use crate::types::planned::{ManualText, PathQuery};
use crate::types::program::ProgramFolder;
use crate::types::question::{Ask, OperatorAnswer, ValidateResult};
use crate::types::request::{Input, OverrideChange, Request, SpindleCommand};
use crate::types::run::{PARTS_MAX, RunOrder, RunQuery};
use crate::types::state::{LockSet, SpindleDirection};
use crate::types::stored_data::{StoredDataAnswer, StoredDataDecision};
use crate::types::trace::TraceQuery;
use crate::types::upload::{Hashes, ProgramCondition, ProgramUpload};
use crate::types::{BootId, Timestamp};

const CLIENT: &str = "plc-1";

#[derive(Debug, Clone, Copy, PartialEq)]
enum Transport {
    Rest,
    Mqtt,
    WebSocket,
}
use Transport::{Mqtt, Rest, WebSocket};

/// Returns the transports that carry a request. The list is complete, because the match does not compile
/// without a request.
fn carried(request: &Request) -> &'static [Transport] {
    match request {
        Request::Command { .. }
        | Request::Lease { .. }
        | Request::Claim(..)
        | Request::Reset(..)
        | Request::Progress(..)
        | Request::Checkpoint(..)
        | Request::Redeliver(..)
        | Request::Ask(..)
        | Request::AnswerQuestion(..)
        | Request::Input(..)
        | Request::Spindle(..)
        | Request::Tool(..)
        | Request::SkipInput(..)
        | Request::WriteIo(..)
        | Request::ForceIo(..)
        | Request::ReadVariables { .. }
        | Request::WriteVariables { .. }
        | Request::RaiseAlarm(_)
        | Request::AnswerStoredData(_) => &[Rest, Mqtt],
        Request::Heartbeat(..) => &[Rest, Mqtt, WebSocket],
        Request::ValidateResult(..) | Request::Handler(..) => &[Mqtt, WebSocket],
        Request::CommandStatus(_)
        | Request::Handlers
        | Request::Tools
        | Request::WriteTools(_)
        | Request::WorkOffsets(_)
        | Request::WriteWorkOffsets(..)
        | Request::LastRun(_)
        | Request::Journal { .. }
        | Request::Programs
        | Request::ReadProgram(_)
        | Request::WriteProgram(..)
        | Request::DeleteProgram(_)
        | Request::FetchProgram(_)
        | Request::StoreProgram(..)
        | Request::RemoveProgram(..)
        | Request::CheckProgram(_)
        | Request::CheckText(..)
        | Request::PutInFolder(..)
        | Request::ManualPath(..)
        | Request::ManualRehearsal(..)
        | Request::IntermediateCode(_)
        | Request::PlannedPath(..)
        | Request::Rehearsal(..)
        | Request::LineState(..)
        | Request::Trace(..)
        | Request::Run { .. }
        | Request::Runs(_)
        | Request::Explain(_)
        | Request::AlarmHistory => &[Rest],
    }
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        (-1_000_000..1_000_000).prop_map(|number| f64::from(number) / 8.0),
        Just(f64::INFINITY),
        Just(f64::NEG_INFINITY)
    ]
}

fn finite() -> impl Strategy<Value = f64> {
    (1..1_000_000).prop_map(|number| f64::from(number) / 8.0)
}

fn text() -> impl Strategy<Value = String> {
    "\\PC{0,12}"
}

/// Returns identity and conditions of a command, as far as the transport carries them.
fn meta(transport: Transport) -> impl Strategy<Value = CommandMeta> {
    let ids = (
        "[ -~]{1,12}",
        proptest::option::of(any::<u64>()),
        proptest::option::of(any::<u64>()),
        proptest::option::of("[0-9a-f]{64}"),
    );
    ids.prop_map(move |(command_id, state_rev, number, hash)| CommandMeta {
        command_id,
        client_id: CLIENT.into(),
        issued_at: number
            .filter(|_| transport == Mqtt)
            .map(|_| Timestamp("2026-01-01T00:00:00Z".into())),
        ttl_ms: number.filter(|_| transport == Mqtt),
        expect: state_rev.map(|rev| Expect {
            boot_id: (transport == Mqtt).then(|| BootId("b".into())),
            state_rev: Some(rev),
            hash,
        }),
        not_after: None,
        fence: number,
        memory: MemoryKey::default(),
    })
}

fn id_only(meta: CommandMeta) -> CommandMeta {
    CommandMeta {
        command_id: meta.command_id,
        client_id: meta.client_id,
        ..CommandMeta::default()
    }
}

fn command() -> impl Strategy<Value = Command> {
    prop_oneof![
        any::<u16>().prop_map(|program| Command::Load { program }),
        Just(Command::Start),
        any::<u32>().prop_map(|line| Command::StartFrom(LineStart::line(line.max(1)))),
        (proptest::option::of(any::<u16>()), 1..=PARTS_MAX)
            .prop_map(|(program, parts)| Command::Run(RunOrder { program, parts })),
        Just(Command::Hold),
        Just(Command::Resume),
        any::<bool>().prop_map(|on| Command::BackTrace { on }),
        Just(Command::Stop),
        Just(Command::Abort),
        Just(Command::Reset),
        any::<u64>().prop_map(|id| Command::AlarmAcknowledge { id }),
        "G0[0-3] X[1-9]".prop_map(|text| Command::Mdi {
            text,
            is_macro: false
        }),
        (finite(), proptest::option::of(finite()), "[a-z]{1,8}").prop_map(
            |(velocity, distance, refresh_id)| {
                Command::Jog {
                    axis: 'X',
                    velocity,
                    distance,
                    refresh_id,
                }
            }
        ),
        proptest::collection::vec(proptest::char::range('A', 'Z'), 0..4)
            .prop_map(|axes| Command::Home { axes }),
    ]
}

/// A request about an output: coordinate system, M number, sequence number, and two texts.
type Output = (u8, Option<u16>, u64, String, String);

fn output(transport: Transport) -> impl Strategy<Value = Output> {
    let output = (1..=255_u8, any::<u16>(), any::<u64>(), text(), text());
    output.prop_map(move |(cs, m, seq, id, said)| (cs, (transport != Rest).then_some(m), seq, id, said))
}

#[rustfmt::skip]
fn of_outputs(transport: Transport) -> impl Strategy<Value = Request> {
    let boot_id = || BootId("b".into());
    (output(transport), proptest::option::of(text()), 0..5).prop_map(move |((cs, m, seq, handler_id, said), text, which)| match which {
        0 => Request::Claim(cs, m, Claim { boot_id: boot_id(), seq, handler_id, instance: None, }),
        1 => {
            let (result, code, force) = (ResetResult::Fault, text.as_ref().map(|_| 7), Some(true));
            Request::Reset(cs, m, Reset { boot_id: boot_id(), seq, handler_id, result, code, text, force, instance: None, })
        }
        2 => Request::Progress(cs, m, ProgressReport { boot_id: boot_id(), seq, handler_id, text: said, percent: text.map(|_| 12.5), instance: None, }),
        3 => Request::Checkpoint(cs, m, CheckpointReport { boot_id: boot_id(), seq, handler_id, checkpoint: serde_json::json!({"at": said}), instance: None, }),
        _ => Request::Redeliver(cs, m, Redeliver { boot_id: boot_id(), seq, how: Redelivery::Verify }),
    })
}

#[rustfmt::skip]
fn of_questions(transport: Transport) -> impl Strategy<Value = Request> {
    let boot_id = || BootId("b".into());
    (output(transport), proptest::option::of(text()), 0..3).prop_map(move |((cs, m, seq, id, said), text, which)| match which {
        0 => Request::Ask(cs, m, Ask {
            boot_id: boot_id(), seq, handler_id: id.clone(), question_id: id, text: said, choices: text.into_iter().collect(), instance: None, }),
        1 => Request::AnswerQuestion(cs, m, OperatorAnswer { boot_id: boot_id(), seq, question_id: id, choice: said, client_id: text }),
        _ => Request::ValidateResult(cs, m, ValidateResult { request_id: id, handler_id: said, ok: text.is_none(), text }),
    })
}

fn of_inputs(transport: Transport) -> impl Strategy<Value = Request> {
    let skips = if transport == Rest { 1..2_usize } else { 0..5 };
    let skips = proptest::collection::btree_map(1..=31_u8, any::<bool>(), skips);
    let common = (
        1..=255_u8,
        any::<u16>(),
        any::<bool>(),
        text(),
        skips,
        finite(),
        0..12,
    );
    common.prop_map(|(cs, number, value, text, skips, speed, which)| {
        let lock = LockSet {
            value,
            text,
            source: value.then(|| "door".to_owned()),
            handler_id: (number > 9).then(|| "h".to_owned()),
            instance: (number > 19).then(|| "i-1".to_owned()),
            force: (number == 3).then_some(true),
        };
        let change = OverrideChange {
            feed: Some(speed),
            rapid: None,
            spindle: value.then_some(speed),
        };
        match which {
            0 => Request::Input(cs, Input::OptionalSkip(skips)),
            1 => Request::Input(cs, Input::OptionalStop(value)),
            2 => Request::Input(cs, Input::SingleBlock(value)),
            3 => Request::Input(cs, Input::DryRun(value)),
            4 => Request::Input(cs, Input::Interlock(lock)),
            5 => Request::Input(cs, Input::StartLock(lock)),
            6 => Request::Input(cs, Input::Override(change)),
            7 => Request::Spindle(
                cs,
                SpindleCommand {
                    direction: SpindleDirection::Ccw,
                    rpm: speed,
                },
            ),
            8 => Request::Tool(cs, number),
            9 => Request::WriteIo(
                IoPoint::input(format!("door {number}")),
                IoSet {
                    value: value.into(),
                    handler_id: lock.handler_id,
                    instance: lock.instance,
                },
            ),
            10 => Request::ForceIo(
                IoPoint::output("höhe"),
                IoForce {
                    value: value.then_some(speed.into()),
                    by: lock.source,
                },
            ),
            _ => Request::SkipInput(number, value),
        }
    })
}

fn of_data(transport: Transport) -> impl Strategy<Value = Request> {
    let area = prop_oneof![
        Just(VariableArea::Global),
        (1..=255_u8).prop_map(VariableArea::CoordinateSystem)
    ];
    let values = proptest::collection::vec(number(), 1..5);
    let common = (
        area,
        any::<u32>(),
        any::<u32>(),
        values,
        meta(transport),
        finite(),
        0..9,
    );
    common.prop_map(move |(area, from, count, values, meta, value, which)| {
        let meta = (transport == Mqtt).then(|| id_only(meta));
        let axes = BTreeMap::from([("X".to_owned(), value)]);
        let table = WorkOffsetTable {
            work_offsets: [("G54".to_owned(), axes)].into(),
        };
        match which {
            0 => Request::ReadVariables {
                area,
                from,
                count,
                meta,
            },
            1 => Request::WriteVariables {
                area,
                from,
                values,
                meta,
            },
            2 => Request::Tools,
            3 => Request::WriteTools(ToolChange {
                tools: vec![ToolData {
                    id: 3,
                    radius: value,
                    length: 0.5,
                }],
                remove: vec![4],
            }),
            4 => Request::WorkOffsets(7),
            5 => Request::WriteWorkOffsets(7, table),
            6 => Request::LastRun(255),
            7 => Request::AlarmHistory,
            _ => Request::Journal {
                from,
                count,
                filter: JournalFilter {
                    since: meta.as_ref().map(|meta| meta.client_id.clone()),
                    cs: area.coordinate_system(),
                    m: u16::try_from(from).ok(),
                    run: meta.map(|meta| meta.command_id),
                    ..JournalFilter::default()
                },
            },
        }
    })
}

#[rustfmt::skip]
fn of_programs() -> impl Strategy<Value = Request> {
    let hashes = || prop_oneof![
        Just(Hashes::Any),
        proptest::collection::vec("[0-9a-f]{64}", 1..4).prop_map(Hashes::OneOf),
    ];
    let condition = (hashes(), proptest::option::of(hashes()), any::<bool>()).prop_map(|(one, other, is_match)| {
        let (if_match, if_none_match) = if is_match { (Some(one), other) } else { (other, Some(one)) };
        ProgramCondition { if_match, if_none_match }
    });
    let parts = (any::<u16>(), text(), condition, proptest::option::of("[A-Za-z0-9+/]{86}=="), proptest::option::of("[a-z &]{1,8}"), 0..5);
    parts.prop_map(|(number, text, condition, signature, dialect, which)| match which {
        0 => Request::FetchProgram(number),
        1 => Request::WriteProgram(number, text),
        2 => Request::DeleteProgram(number),
        3 => Request::StoreProgram(number, ProgramUpload { text, condition, signature, dialect }),
        _ => Request::RemoveProgram(number, condition),
    })
}

#[rustfmt::skip]
fn of_machine() -> impl Strategy<Value = Request> {
    let parts = (any::<u16>(), text(), proptest::option::of(1..=255_u8), "[a-z0-9]{1,8}", any::<bool>(), 0..20);
    parts.prop_map(|(number, text, cs, id, online, which)| match which {
        0 => Request::Programs,
        1 => Request::CheckProgram(number),
        2 => Request::IntermediateCode(number),
        3 => Request::RaiseAlarm(AlarmRaise { cs, code: number, text }),
        4 => Request::Handler(id, HandlerPresence { online, handles: vec![HandledCode { cs: 1, m: number }], validates: !online , ..HandlerPresence::default()}),
        5 => Request::Heartbeat(id, ClientHeartbeat { ttl_ms: u64::from(number), cs }),
        6 => Request::CommandStatus(text + "/ %?"),
        7 => Request::Explain(text + "/ %?"),
        8 => Request::PlannedPath(number, PathQuery { cs, tolerance: online.then_some(0.25), from: number.into(), count: cs.map(Into::into) }),
        9 => Request::Rehearsal(number, cs),
        10 => Request::LineState(cs.unwrap_or(1), LineStart { program: online.then_some(number), ..LineStart::line(u32::from(number) + 1) }),
        11 => Request::Run { id: text + "/ %?", wait_s: u32::from(number % 61) },
        13 => Request::CheckText(number, online.then_some(id), text),
        14 => Request::PutInFolder(number, ProgramFolder { folder: text }),
        15 => Request::ManualPath(cs.unwrap_or(1), ManualText { text }),
        16 => Request::ManualRehearsal(cs.unwrap_or(1), ManualText { text }),
        17 => Request::Trace(cs.unwrap_or(1), TraceQuery { from: number.into(), count: u32::from(number % 6000) + 1, axes: if online { "XZ".into() } else { String::new() } }),
        18 => Request::AnswerStoredData(StoredDataAnswer { decision: if online { StoredDataDecision::Accept } else { StoredDataDecision::Refuse } }),
        12 => Request::Runs(RunQuery { cs, from: number.into(), count: u32::from(number % 1000) + 1 }),
        _ => Request::Handlers,
    })
}

#[rustfmt::skip]
fn of_commands(transport: Transport) -> impl Strategy<Value = Request> {
    let commands = (1..=255_u8, command(), meta(transport), any::<bool>());
    let commands = commands.prop_map(move |(cs, command, meta, wait)| {
        // over REST, the order of a run is always answered when the command is done
        let wait = (wait || matches!(command, Command::Run(_))) && transport == Rest;
        Request::Command { cs, command, meta, wait }
    });
    let leases = (1..=255_u8, proptest::option::of(text()), any::<u64>(), meta(transport), 0..3);
    let leases = leases.prop_map(move |(cs, holder, fence, meta, which)| {
        let (request, mut meta) = match which {
            0 => (LeaseRequest::Take(LeaseTake { holder, ttl_ms: Some(fence), fence: Some(fence) }), id_only(meta)),
            1 => (LeaseRequest::Release(LeaseRelease { fence }), id_only(meta)),
            _ => (LeaseRequest::Break, id_only(meta)),
        };
        // the header with the lease is also a condition
        meta.fence = (transport == Rest && which == 1).then_some(fence);
        Request::Lease { cs, request, meta }
    });
    prop_oneof![commands, leases]
}

fn any_request(transport: Transport) -> impl Strategy<Value = Request> {
    let of_outputs = prop_oneof![of_outputs(transport), of_questions(transport)];
    prop_oneof![
        of_outputs,
        of_inputs(transport),
        of_data(transport),
        of_machine(),
        of_programs(),
        of_commands(transport)
    ]
}

struct TestHeaders(Vec<(&'static str, String)>);

impl Sender for TestHeaders {
    fn header(&self, name: &str) -> Option<&str> {
        let mut headers = self.0.iter();
        headers
            .find(|(known, _)| *known == name)
            .map(|(_, value)| value.as_str())
    }

    fn client_id(&self) -> String {
        CLIENT.to_owned()
    }

    fn new_command_id(&self) -> String {
        unreachable!("a client names its commands")
    }
}

fn decoded(level: &str) -> String {
    let level = percent_encoding::percent_decode_str(level);
    level.decode_utf8().unwrap().into_owned()
}

/// Reads a request from HTTP as a server does. `cs` is the coordinate system that the server has found for an
/// alarm.
fn read_rest(exchange: rest::Exchange, cs: u8) -> ParsedRequest {
    let (path, query) = exchange.path.split_once('?').unwrap_or((&exchange.path, ""));
    let routes = ROWS
        .iter()
        .flat_map(|row| row.routes.iter().map(move |route| (row, route)));
    let mut of_path = routes.filter_map(|(row, route)| Some((row, route, take_apart(route.pattern, path)?)));
    let (row, route, params) = of_path
        .find(|(_, route, _)| route.method == exchange.method)
        .unwrap();
    let cs = cs.to_string();
    let decoded: Vec<_> = params
        .iter()
        .map(|(name, value)| (*name, decoded(value)))
        .collect();
    let mut params: Vec<_> = decoded
        .iter()
        .map(|(name, value)| (*name, value.as_str()))
        .collect();
    if params.iter().any(|(name, _)| *name == "id") {
        params.push(("cs", &cs));
    }
    let query: Vec<_> = query
        .split('&')
        .filter_map(|pair| pair.split_once('='))
        .map(|(name, value)| {
            (
                name,
                percent_encoding::percent_decode_str(value).decode_utf8().unwrap(),
            )
        })
        .collect();
    let query = query.iter().map(|(name, value)| (*name, &**value));
    let incoming = IncomingRequest {
        params: &params,
        body: Cow::Owned(exchange.body.unwrap_or_default().into_bytes()),
        query: route.query.read(query).unwrap(),
        source: Source::Http(&TestHeaders(exchange.headers)),
        not_after_is_apart: false,
    };
    row.parse(incoming).unwrap()
}

#[test]
fn an_invalid_age_limit_prevents_no_end_of_a_jog_over_rest() {
    let command = Command::JogEnd {
        refresh_id: "r".to_owned(),
    };
    let request = Request::Command {
        cs: 1,
        command: command.clone(),
        meta: CommandMeta {
            command_id: "j".to_owned(),
            client_id: "p".to_owned(),
            ..CommandMeta::default()
        },
        wait: false,
    };
    let mut exchange = rest::encode(request).unwrap();
    exchange.body = Some(r#"{"refresh_id":"r","end":true,"not_after":5}"#.to_owned());
    let read = read_rest(exchange, 1);
    assert!(matches!(read.request(), Request::Command { command: read, .. } if *read == command));
    assert_eq!(read.not_after(), None);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    #[test]
    fn a_request_over_rest_is_read_as_it_was_written(request in any_request(Rest)) {
        let cs = if let Request::Command { cs, .. } = &request { *cs } else { 0 };
        match rest::encode(request.clone()) {
            Ok(exchange) => prop_assert_eq!(read_rest(exchange, cs).into_request(), request),
            Err(_) => prop_assert!(!carried(&request).contains(&Rest), "{:?}", request),
        }
    }

    #[test]
    fn a_request_over_mqtt_is_read_as_it_was_written(request in any_request(Mqtt)) {
        match mqtt::encode(request.clone(), CLIENT, |_, _| None) {
            Ok(sent) => match mqtt::decode(&sent.path, sent.payload.as_bytes(), sent.retain) {
                mqtt::Inbound::Ask { request: read, .. } => prop_assert_eq!(read.into_request(), request),
                other => prop_assert!(false, "{:?}", other),
            },
            Err(_) => prop_assert!(!carried(&request).contains(&Mqtt), "{:?}", request),
        }
    }

    #[test]
    fn age_limit_is_read_as_written_if_the_request_can_cause_motion(
        (request, transport) in prop_oneof![
            any_request(Rest).prop_map(|request| (request, Rest)),
            any_request(Mqtt).prop_map(|request| (request, Mqtt)),
        ],
        heartbeat in any::<u64>(),
        within_ms in 1..=NOT_AFTER_MAX_MS,
    ) {
        let not_after = NotAfter { boot_id: BootId("b".into()), heartbeat, within_ms };
        let read = if transport == Rest {
            let cs = if let Request::Command { cs, .. } = &request { *cs } else { 0 };
            let written = rest::encode_not_after(request.clone(), Some(&not_after));
            written.ok().map(|exchange| read_rest(exchange, cs))
        } else {
            let written = mqtt::encode_not_after(request.clone(), Some(&not_after), CLIENT, |_, _| None);
            written.ok().map(|sent| match mqtt::decode(&sent.path, sent.payload.as_bytes(), sent.retain) {
                mqtt::Inbound::Ask { request, .. } => request,
                other => panic!("{other:?}"),
            })
        };
        let is_urgent = matches!(&request, Request::Command { command, .. } if command.is_urgent());
        if let Some(read) = read {
            let expected = (takes_not_after(&request) && !is_urgent).then_some(&not_after);
            prop_assert_eq!(read.not_after(), expected, "{:?}", request);
            if let Request::Command { meta, .. } = read.request() {
                prop_assert_eq!(meta.not_after.as_ref(), expected);
            }
        }
    }

    #[test]
    fn a_request_over_a_websocket_is_read_as_it_was_written(request in any_request(WebSocket)) {
        match websocket::encode(request.clone()) {
            Ok(frame) => {
                let read: websocket::ClientFrame = json_object(frame.to_json().as_bytes()).unwrap();
                prop_assert_eq!(&read, &frame);
                let read = read.requests().map(ParsedRequest::into_request);
                prop_assert_eq!(read.collect::<Vec<_>>(), [request]);
            }
            Err(_) => prop_assert!(!carried(&request).contains(&WebSocket), "{:?}", request),
        }
    }
}
