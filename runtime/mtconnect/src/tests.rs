mod observed;

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::PathBuf;
use std::process::Command;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Body;
use axum::http::{Request, StatusCode};
use http_body_util::BodyExt;
use plc_protocol::supervisor::Supervisor;
use plc_protocol::types::data::ToolData;
use plc_protocol::types::machine::{
    ActiveAlarms, AlarmRecord, AlarmSeverity, Birth, CoordinateSystemInfo, Identification, MotorInfo,
};
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::run::{Run, RunState};
use plc_protocol::types::state::Execution;
use plc_protocol::types::state::{
    Modal, Overrides, Position, ProgramLocation, RunKind, Spindle, State, Tool,
};
use plc_protocol::types::topic::{CsTopic, Topic};
use plc_protocol::types::{BootId, Timestamp};
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
use tokio::net::{TcpListener, TcpStream};
use tokio_util::sync::CancellationToken;
use tower::ServiceExt;

use crate::buffer::{Observation, Value};
use crate::device::{Device, item_id};
use crate::feed::DeviceFeed;
use crate::{Agent, AgentSettings, Version, filter};

/// A mill with a rotary axis and a spindle, and a loader.
fn birth() -> Birth {
    let motor = |number, kind: &str| MotorInfo {
        number,
        kind: kind.into(),
        ..MotorInfo::default()
    };
    let axes = |axes: &[(&str, u16)]| {
        axes.iter()
            .map(|(letter, motor)| ((*letter).to_owned(), *motor))
            .collect()
    };
    Birth {
        machine: "mill-1".into(),
        identification: Identification {
            manufacturer: Some("Example & Works".into()),
            model: Some("M 400".into()),
            serial_number: Some("47 11".into()),
            location: Some("hall 2".into()),
            ..Identification::default()
        },
        motors: vec![
            motor(1, "linear"),
            motor(2, "linear"),
            motor(3, "linear"),
            motor(4, "rotary"),
            motor(5, "spindle"),
            motor(6, "linear"),
            motor(7, "linear"),
        ],
        coordinate_systems: vec![
            CoordinateSystemInfo {
                number: 1,
                axes: axes(&[("X", 1), ("Y", 2), ("Z", 3), ("A", 4)]),
                spindle: Some(5),
                ..CoordinateSystemInfo::default()
            },
            CoordinateSystemInfo {
                number: 2,
                axes: axes(&[("X", 6), ("Z", 7)]),
                ..CoordinateSystemInfo::default()
            },
        ],
        ..Birth::default()
    }
}

fn message(topic: Topic, payload: Payload) -> Message {
    Message {
        topic,
        boot_id: BootId("b".into()),
        ts: Timestamp("2026-01-01T00:00:01.500Z".into()),
        rev: None,
        payload,
    }
}

fn of_mill(topic: CsTopic, payload: Payload) -> Message {
    message(Topic::cs(1, topic), payload)
}

fn state(execution: Execution) -> Message {
    let state = State {
        execution,
        program: Some(7),
        run_kind: Some(RunKind::Program),
        dry_run: true,
        ..State::default()
    };
    of_mill(CsTopic::State, Payload::State(state))
}

fn alarm(number: u16, cs: Option<u8>) -> AlarmRecord {
    AlarmRecord {
        number,
        cs,
        severity: AlarmSeverity::Alarm,
        text: format!("number {number} with <, & and \u{1} in it"),
        ..AlarmRecord::default()
    }
}

fn alarms(active: &[AlarmRecord]) -> Message {
    let active = ActiveAlarms {
        alarms: active.to_vec(),
    };
    message(Topic::AlarmActive, Payload::AlarmActive(active))
}

fn positions(x: f64) -> Message {
    let at: BTreeMap<String, f64> = [("X", x), ("Y", 2.0), ("Z", -3.5), ("A", 90.0)]
        .map(|(axis, at)| (axis.to_owned(), at))
        .into();
    let position = Position {
        machine: at.clone(),
        actual: at,
        feedrate: 600.0,
        spindle_rpm: 1200.0,
        ..Position::default()
    };
    of_mill(CsTopic::Position, Payload::Position(position))
}

/// Every kind of message of a machine, once.
fn everything() -> Vec<Message> {
    let modal = Modal {
        work_offset: Some("G55".into()),
        ..Modal::default()
    };
    let place = ProgramLocation {
        number: Some(1000),
        nest_level: 1,
        line: 12,
        block: "G01 X10 // <fast> & far".into(),
        ..ProgramLocation::default()
    };
    vec![
        state(Execution::Wait),
        run("1", 3, 1),
        of_mill(CsTopic::Program, Payload::Program(place)),
        positions(1.25),
        of_mill(CsTopic::Modal, Payload::Modal(modal)),
        of_mill(CsTopic::Tool, Payload::Tool(Tool { id: 4 })),
        of_mill(CsTopic::Override, Payload::Override(Overrides::default())),
        of_mill(CsTopic::Spindle, Payload::Spindle(Spindle::default())),
        alarms(&[
            alarm(102, Some(1)),
            alarm(300, Some(1)),
            alarm(10_007, Some(1)),
            alarm(402, None),
        ]),
    ]
}

fn feed(version: Version) -> DeviceFeed {
    let settings = AgentSettings {
        version,
        emergency_stop: None,
    };
    DeviceFeed::new(
        Device::from_birth(&birth()),
        &settings,
        &"2026-01-01T00:00:00Z".into(),
    )
}

/// The newest observation of a data item of the mill's path.
fn path_value(feed: &DeviceFeed, kind: &str, sub_type: Option<&str>) -> Option<String> {
    value_of(feed, &item_id("path1", kind, sub_type))
}

fn value_of(feed: &DeviceFeed, id: &str) -> Option<String> {
    let index = feed.device.items.iter().position(|item| item.id == id).unwrap();
    match &feed.buffer.latest(index).last().unwrap().value {
        Value::Text(text) => Some(text.to_string()),
        _ => None,
    }
}

#[test]
fn what_the_machine_says_is_told_in_the_words_and_units_of_the_standard() {
    let mut feed = feed(Version::V2_7);
    assert_eq!(path_value(&feed, "EXECUTION", None), None, "nothing was said yet");
    for message in &everything() {
        assert!(feed.apply_message(message), "{:?}", message.topic);
    }
    for (kind, sub_type, wanted) in [
        ("EXECUTION", None, "WAIT"),
        ("CONTROLLER_MODE", None, "AUTOMATIC"),
        ("PROGRAM", Some("MAIN"), "7"),
        ("PROGRAM", Some("ACTIVE"), "1000"),
        ("LINE_NUMBER", Some("ABSOLUTE"), "12"),
        ("BLOCK", None, "G01 X10 // <fast> & far"),
        ("TOOL_NUMBER", None, "4"),
        ("WORK_OFFSET", None, "2"),
        ("PATH_FEEDRATE", Some("ACTUAL"), "10"),
        ("PATH_POSITION", Some("ACTUAL"), "1.25 2 -3.5"),
        ("PATH_FEEDRATE_OVERRIDE", Some("RAPID"), "100"),
        ("CONTROLLER_MODE_OVERRIDE", Some("DRY_RUN"), "ON"),
    ] {
        assert_eq!(
            path_value(&feed, kind, sub_type).as_deref(),
            Some(wanted),
            "{kind}"
        );
    }
    assert_eq!(value_of(&feed, "ax1A_angle_actual").as_deref(), Some("90"));
    assert_eq!(value_of(&feed, "ax1S_rotary_mode").as_deref(), Some("SPINDLE"));
    assert!(
        !everything().iter().any(|message| feed.apply_message(message)),
        "what is known is no news"
    );
}

#[test]
fn a_wait_is_active_in_versions_that_do_not_know_the_word() {
    for (version, word) in [
        (Version::V1_7, "ACTIVE"),
        (Version::V2_3, "ACTIVE"),
        (Version::V2_7, "WAIT"),
    ] {
        let mut feed = feed(version);
        feed.apply_message(&state(Execution::Wait));
        assert_eq!(path_value(&feed, "EXECUTION", None).as_deref(), Some(word));
    }
}

fn run(id: &str, parts: u32, parts_done: u32) -> Message {
    let run = Run {
        id: id.into(),
        cs: 1,
        program: 7,
        hash: None,
        from_line: None,
        parts,
        parts_done,
        began: Timestamp("2026-01-01T00:00:00Z".into()),
        end: None,
        took_s: 0.0,
        last_part_s: None,
        waits: Vec::new(),
        alarms: Vec::new(),
        waits_for: None,
    };
    of_mill(CsTopic::Run, Payload::Run(RunState { run: Some(run) }))
}

#[test]
fn an_alarm_is_a_fault_of_its_condition_until_it_is_cleared() {
    let mut feed = feed(Version::V2_3);
    let codes = |feed: &DeviceFeed, id: &str| -> Vec<Option<u16>> {
        let index = feed.device.items.iter().position(|item| item.id == id).unwrap();
        let code = |one: &Observation| match &one.value {
            Value::Active(alarm) => Some(alarm.native_code),
            _ => None,
        };
        feed.buffer.latest(index).iter().map(code).collect()
    };
    feed.apply_message(&alarms(&[
        alarm(102, Some(1)),
        alarm(200, Some(1)),
        alarm(300, Some(1)),
        alarm(402, None),
    ]));
    assert_eq!(codes(&feed, "path1_motion_program"), [Some(102), Some(200)]);
    assert_eq!(codes(&feed, "path1_logic_program"), [Some(300)]);
    assert_eq!(codes(&feed, "ctl_system"), [Some(402)]);
    assert_eq!(codes(&feed, "path2_motion_program"), [None]);
    feed.apply_message(&alarms(&[alarm(200, Some(1))]));
    assert_eq!(codes(&feed, "path1_motion_program"), [Some(200)]);
    assert_eq!(codes(&feed, "path1_logic_program"), [None]);
    feed.apply_message(&alarms(&[]));
    assert_eq!(codes(&feed, "path1_motion_program"), [None]);
}

#[test]
fn a_path_wants_data_items_by_component_and_attribute() {
    let device = Device::from_birth(&birth());
    let ids = |path: &str| -> Vec<String> {
        let wanted = filter::wanted(&device, path).unwrap();
        let wanted = device.items.iter().zip(wanted).filter(|(_, wanted)| *wanted);
        wanted.map(|(item, _)| item.id.clone()).collect()
    };
    assert_eq!(
        ids("//DataItem[@type=\"TOOL_NUMBER\"]"),
        ["path1_tool_number", "path2_tool_number"]
    );
    assert_eq!(
        ids("//Path[@id='path2']//DataItem[@type=\"BLOCK\"]|//DataItem[@id=\"dev_availability\"]"),
        ["dev_availability", "path2_block"]
    );
    assert_eq!(ids("//Linear[@name=\"X\"]").len(), 2);
    assert_eq!(
        ids("//Axes//DataItem[@category=\"SAMPLE\" and @subType=\"ACTUAL\"]").len(),
        4 + 1 + 2
    );
    assert_eq!(ids("//Device").len(), device.items.len());
    assert_eq!(ids("//Nothing"), [""; 0]);
    for wrong in [
        "",
        "DataItem",
        "//DataItem[@id=path1]",
        "//DataItem[id=\"a\"]",
        "//[",
        "//a//",
    ] {
        assert!(filter::wanted(&device, wrong).is_err(), "{wrong}");
    }
}

fn tool(id: u16, radius: f64, length: f64) -> ToolData {
    ToolData { id, radius, length }
}

/// Returns the documents of every version.
fn documents() -> Vec<(Version, &'static str, String)> {
    use crate::documents::{ErrorKind, Head, Sequences, assets, devices, error, streams};
    use plc_protocol::types::data::ToolTable;

    let mut all = Vec::new();
    for version in [Version::V1_7, Version::V2_0, Version::V2_3, Version::V2_7] {
        let mut feed = feed(version);
        let unknown = feed.buffer.current();
        for message in &everything() {
            feed.apply_message(message);
        }
        let changed = tool(1, 5.0, 80.0);
        feed.tools(&[], &"2026-01-01T00:00:00Z".into());
        feed.tools(&[changed], &"2026-01-01T00:00:01Z".into());
        feed.tools(&[], &"2026-01-01T00:00:02Z".into());
        let head = Head {
            version,
            model_change_time: "2026-01-01T00:00:00.000Z".into(),
            sender: "tandem".into(),
            instance_id: 1_767_225_600_000,
            creation_time: "2026-01-01T00:00:02.000Z".into(),
        };
        let sequences = Sequences {
            first: feed.buffer.first(),
            last: feed.buffer.last(),
            next: feed.buffer.next(),
        };
        let tools = ToolTable {
            tools: vec![tool(1, 5.0, 80.0), tool(12, 0.0, 0.0)],
        };
        let (sampled, _) = feed.buffer.sample(1, usize::MAX, &|_| true);
        all.push((version, "Devices", devices(&head, &feed.device, 2)));
        for observations in [&unknown, &feed.buffer.current(), &sampled, &Vec::new()] {
            all.push((
                version,
                "Streams",
                streams(&head, &feed.device, sequences, observations),
            ));
        }
        for kind in [
            ErrorKind::OutOfRange("from"),
            ErrorKind::InvalidRequest,
            ErrorKind::InvalidXPath,
            ErrorKind::NoDevice,
            ErrorKind::AssetNotFound("T99".into()),
            ErrorKind::Unsupported,
        ] {
            let document = error(
                &head,
                &kind,
                "/mtconnect/sample?from=9",
                "from is 9, and <1> to 5 are kept",
            );
            all.push((version, "Error", document));
        }
        all.push((version, "Assets", assets(&head, &feed.device, &tools, &|_| true)));
    }
    all
}

/// Unpacks the standard's schemas.
fn schemas() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let packed = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("schemas");
    for entry in std::fs::read_dir(packed).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "gz") {
            let unpacked = Command::new("gzip").arg("-dc").arg(&path).output().unwrap();
            assert!(unpacked.status.success());
            std::fs::write(folder.path().join(path.file_stem().unwrap()), unpacked.stdout).unwrap();
        }
    }
    folder
}

#[test]
fn every_document_is_valid_by_the_schema_of_its_version() {
    let folder = schemas();
    for (version, kind, document) in documents() {
        let file = folder.path().join("document.xml");
        std::fs::File::create(&file)
            .unwrap()
            .write_all(document.as_bytes())
            .unwrap();
        let schema = folder
            .path()
            .join(format!("MTConnect{kind}_{}_1.0.xsd", version.text()));
        let said = Command::new("xmllint")
            .args(["--nonet", "--noout", "--schema"])
            .arg(schema)
            .arg(&file)
            .output()
            .unwrap();
        let says = String::from_utf8_lossy(&said.stderr);
        assert!(said.status.success(), "{version:?} {kind}\n{says}\n{document}");
    }
}

async fn agent() -> (plc_protocol::fake::FakePort, Agent, CancellationToken) {
    let fake = plc_protocol::fake::FakePort::new([1]);
    let stop = CancellationToken::new();
    let agent = Agent::start(
        Arc::new(fake.clone()),
        AgentSettings::default(),
        stop.clone(),
        Supervisor::default(),
    )
    .await;
    (fake, agent, stop)
}

async fn ask(agent: &Agent, path: &str) -> (StatusCode, String) {
    let request = Request::get(path).body(Body::empty()).unwrap();
    let response = agent.router().oneshot(request).await.unwrap();
    let status = response.status();
    let body = response.into_body().collect().await.unwrap().to_bytes();
    (status, String::from_utf8(body.to_vec()).unwrap())
}

/// Returns the value of an attribute at its first occurrence.
fn attribute(document: &str, name: &str) -> u64 {
    let (_, behind) = document.split_once(&format!("{name}=\"")).unwrap();
    behind.split('"').next().unwrap().parse().unwrap()
}

#[tokio::test]
async fn a_reader_that_follows_next_sequence_misses_nothing() {
    let (fake, agent, _stop) = agent().await;
    let (status, now) = ask(&agent, "/current").await;
    assert_eq!(status, StatusCode::OK);
    let mut next = attribute(&now, "nextSequence");
    let mut seen = Vec::new();
    for id in 1..=20_u16 {
        fake.publish_message(1, CsTopic::Tool, Payload::Tool(Tool { id }));
        tokio::task::yield_now().await;
        let (_, sample) = ask(
            &agent,
            &format!("/sample?from={next}&count=1&path=//DataItem[@type=%22TOOL_NUMBER%22]"),
        )
        .await;
        next = attribute(&sample, "nextSequence");
        seen.extend(
            sample
                .split("<ToolNumber")
                .nth(1)
                .and_then(|rest| rest.split(['>', '<']).nth(1)?.parse::<u16>().ok()),
        );
    }
    assert_eq!(seen, (1..=20).collect::<Vec<_>>());
}

#[tokio::test]
async fn what_is_asked_wrongly_is_refused_with_the_codes_of_the_standard() {
    let (_fake, agent, _stop) = agent().await;
    for (path, status, code) in [
        ("/sample?from=99999", 404, "OUT_OF_RANGE"),
        ("/sample?count=0", 404, "OUT_OF_RANGE"),
        ("/sample?count=x", 400, "INVALID_REQUEST"),
        ("/sample?interval=1&heartbeat=0", 404, "OUT_OF_RANGE"),
        ("/current?at=99999", 404, "OUT_OF_RANGE"),
        ("/current?at=1&interval=10", 400, "INVALID_REQUEST"),
        ("/current?path=DataItem", 400, "INVALID_PATH"),
        ("/current?nothing=1", 400, "INVALID_REQUEST"),
        ("/other/current", 404, "NO_DEVICE"),
        ("/asset/T99", 404, "ASSET_NOT_FOUND"),
        ("/a/b/c", 404, "UNSUPPORTED"),
    ] {
        let (said, document) = ask(&agent, path).await;
        assert_eq!(said.as_u16(), status, "{path}");
        assert!(
            document.contains(&format!("errorCode=\"{code}\"")),
            "{path}: {document}"
        );
    }
}

#[tokio::test(start_paused = true)]
async fn a_stream_tells_each_change_and_that_it_is_there() {
    let (fake, agent, stop) = agent().await;
    let path = "/sample?interval=100&heartbeat=1000&path=//DataItem[@type=%22TOOL_NUMBER%22]";
    let response = agent
        .router()
        .oneshot(Request::get(path).body(Body::empty()).unwrap())
        .await
        .unwrap();
    let kind = response.headers()["content-type"].to_str().unwrap().to_owned();
    assert!(kind.starts_with("multipart/x-mixed-replace;boundary="), "{kind}");
    let mut body = response.into_body();
    let mut part = async || {
        let frame = body.frame().await?.unwrap().into_data().unwrap();
        Some(String::from_utf8(frame.to_vec()).unwrap())
    };
    let first = part().await.unwrap();
    let (head, document) = first.split_once("\r\n\r\n").unwrap();
    let length: usize = head.rsplit_once(' ').unwrap().1.parse().unwrap();
    assert_eq!(
        document.len(),
        length + 2,
        "the line end behind the document is not of it"
    );
    let begun = tokio::time::Instant::now();
    assert!(!part().await.unwrap().contains("<ToolNumber"), "a heartbeat");
    assert_eq!(begun.elapsed(), Duration::from_secs(1));
    fake.publish_message(1, CsTopic::Tool, Payload::Tool(Tool { id: 31 }));
    assert!(part().await.unwrap().contains(">31</ToolNumber>"));
    assert_eq!(begun.elapsed(), Duration::from_millis(1100));
    stop.cancel();
    assert_eq!(part().await, None);
}

#[tokio::test]
async fn an_adapter_tells_what_holds_then_what_changes_and_answers_pings() {
    let (fake, agent, stop) = agent().await;
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    agent.serve_shdr(listener);
    let (reader, mut writer) = TcpStream::connect(address).await.unwrap().into_split();
    let mut lines = BufReader::new(reader).lines();
    let first = lines.next_line().await.unwrap().unwrap();
    assert!(first.ends_with("|dev_availability|AVAILABLE"), "{first}");
    writer.write_all(b"* PING\n").await.unwrap();
    while lines.next_line().await.unwrap().unwrap() != "* PONG 10000" {}
    fake.publish_message(1, CsTopic::Tool, Payload::Tool(Tool { id: 8 }));
    let changed = lines.next_line().await.unwrap().unwrap();
    assert!(changed.ends_with("|path1_tool_number|8"), "{changed}");
    stop.cancel();
    while let Ok(Some(_)) = lines.next_line().await {}
}
