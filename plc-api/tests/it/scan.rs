//! The scan style uses the same handshake as handlers.

use std::sync::{Arc, Mutex};

use plc_api::fake::FakePort;
use plc_api::fake::OutputOutcome;
use plc_api::scan::{Image, Reads, ScanProgram};
use plc_api::{Alarm, CancelReason, Params, Redelivery, SequenceProgram};
use plc_protocol::types::command::Command;
use plc_protocol::types::data::VariableArea;
use plc_protocol::types::io::{IoDeclaration, IoPoint, IoState};
use plc_protocol::types::message::Payload;
use plc_protocol::types::output::OutputState;
use plc_protocol::types::request::{Input, OverrideChange, Request, SpindleCommand};
use plc_protocol::types::state::{CapturedPositions, Lock, LockSet, Position, SpindleDirection};
use plc_protocol::types::topic::CsTopic;

use crate::{ms, serve, va};

#[tokio::test]
async fn an_output_is_a_flag_with_parameters_and_a_reset_is_written_as_one() {
    let fake = FakePort::new([1, 2]);
    let seen = Arc::new(Mutex::new(Vec::new()));
    let noted = Arc::clone(&seen);
    let program = SequenceProgram::new().scan([20, 21], ms(10), move |image: &mut Image| {
        let flag = image.params(1, 20).and_then(|params| params.a);
        noted.lock().unwrap().push((image.time_s(), flag));
        if image.scans() >= 3 {
            image.reset(1, 20);
            image.fail(2, 21, Alarm::user(4, "jammed"));
        }
    });
    let _task = serve(&fake, program.handler_id("plc")).await;
    let (reset, failed) = (
        fake.issue_output(1, 20, va(7.0)),
        fake.issue_output(2, 21, Params::default()),
    );
    fake.advance(ms(25)).await;
    assert_eq!(fake.pending(1)[0].state, OutputState::Claimed);
    assert_eq!(fake.closed(1, reset), None);
    fake.advance(ms(15)).await;
    assert_eq!(fake.closed(1, reset), Some(OutputOutcome::Reset));
    let alarm = Alarm::user(4, "jammed");
    assert_eq!(fake.closed(2, failed), Some(OutputOutcome::Failed { alarm }));
    let seen = seen.lock().unwrap();
    let times: Vec<_> = seen.iter().map(|(time_s, _)| (time_s * 1000.0).round()).collect();
    assert_eq!(times, [0.0, 10.0, 20.0, 30.0, 40.0], "every 10 ms");
    let flags: Vec<_> = seen.iter().map(|(_, flag)| *flag).collect();
    assert_eq!(flags, [None, Some(7.0), Some(7.0), Some(7.0), None]);
}

#[tokio::test]
async fn a_cancelled_output_is_off_and_a_reset_reaches_no_later_one() {
    let fake = FakePort::new([1]);
    let program = SequenceProgram::new().scan(20, ms(10), |image: &mut Image| {
        // the image contains only the first output, and the scan resets only that output
        if image.output(1, 20).is_some_and(|output| output.seq() == 1) {
            image.reset(1, 20);
        }
    });
    let _task = serve(&fake, program).await;
    let first = fake.issue_output(1, 20, Params::default());
    fake.settle().await;
    fake.cancel(1, CancelReason::Stop);
    let second = fake.issue_output(1, 20, Params::default());
    fake.advance(ms(100)).await;
    assert_eq!(
        fake.closed(1, first),
        Some(OutputOutcome::Cancelled(CancelReason::Stop))
    );
    assert_eq!(fake.closed(1, second), None);
}

#[tokio::test]
async fn a_scan_of_the_longest_period_scans_once_and_its_handlers_stay() {
    let fake = FakePort::new([1]);
    let program = SequenceProgram::new().scan(20, std::time::Duration::MAX, |_image: &mut Image| {});
    let task = serve(&fake, program).await;
    let seq = fake.issue_output(1, 20, Params::default());
    fake.advance(ms(100_000)).await;
    assert!(!task.is_finished());
    assert_eq!(fake.closed(1, seq), None);
    assert_eq!(fake.pending(1)[0].state, OutputState::Claimed);
}

#[tokio::test]
async fn what_a_scan_writes_is_carried_out_after_it() {
    let fake = FakePort::new([1]);
    let program = SequenceProgram::new().scan(20, ms(10), |image: &mut Image| {
        image.progress(1, 20, "the door closes", 50.0);
        if image.is_on(1, 20) && image.scans() == 1 {
            image.select_tool(1, 5);
            image.command(1, plc_protocol::types::command::Command::Hold);
        }
    });
    let _task = serve(&fake, program).await;
    fake.issue_output(1, 20, Params::default());
    fake.advance(ms(15)).await;
    assert_eq!(
        fake.pending(1)[0].progress.as_ref().unwrap().text,
        "the door closes"
    );
    let requests = fake.requests();
    assert!(matches!(requests[0], Request::Tool(1, 5)), "{requests:?}");
    assert!(
        matches!(requests[1], Request::Command { cs: 1, .. }),
        "{requests:?}"
    );
    assert_eq!(requests.len(), 2);
}

#[tokio::test]
async fn a_scan_program_that_panics_gives_its_outputs_back() {
    let fake = FakePort::new([1]);
    let program = SequenceProgram::new().scan(20, ms(10), |image: &mut Image| {
        assert!(!image.is_on(1, 20), "not built for M20");
    });
    let task = serve(&fake, program.on_redelivery(Redelivery::Ask)).await;
    fake.issue_output(1, 20, Params::default());
    fake.advance(ms(15)).await;
    let error = task.await.unwrap().unwrap_err().to_string();
    assert!(error.contains("not built for M20"), "{error}");
    assert!(fake.pending(1)[0].lost);
}

#[tokio::test]
async fn handlers_and_scans_share_a_sequence_program_and_no_code() {
    let both = || SequenceProgram::new().scan([20, 21], ms(10), |_: &mut Image| {});
    let nothing = async |_: plc_api::AuxOutput| Ok(());
    assert_eq!(both().on(22, nothing).check(), Ok(()));
    let twice = both().on(21, nothing).check().unwrap_err().to_string();
    assert!(twice.contains("M21 has two handlers"), "{twice}");
    let short = SequenceProgram::new().scan(20, std::time::Duration::ZERO, |_: &mut Image| {});
    assert!(short.check().is_err());
}

#[tokio::test]
async fn a_scan_of_one_coordinate_system_serves_no_other() {
    let fake = FakePort::new([1, 2]);
    let program = SequenceProgram::new().in_coordinate_system(2, |loader| {
        loader.scan(20, ms(10), |image: &mut Image| {
            image.reset(1, 20);
            image.reset(2, 20);
        })
    });
    let _task = serve(&fake, program).await;
    let (mill, loader) = (
        fake.issue_output(1, 20, Params::default()),
        fake.issue_output(2, 20, Params::default()),
    );
    fake.advance(ms(50)).await;
    assert_eq!(fake.closed(1, mill), None);
    assert_eq!(fake.pending(1)[0].state, OutputState::Output, "nobody claims it");
    assert_eq!(fake.closed(2, loader), Some(OutputOutcome::Reset));
}

/// Values that the scan has read from its last image.
#[derive(Default)]
struct ScanSnapshot {
    scans: u64,
    skip: bool,
    single_block: bool,
    feed: f64,
    captured: Option<Vec<f64>>,
    x: Option<f64>,
    variables: Vec<Option<f64>>,
    execution: Option<plc_api::Execution>,
    refused: Vec<String>,
}

struct Watch {
    seen: Arc<Mutex<ScanSnapshot>>,
    write: fn(&mut Image),
}

impl ScanProgram for Watch {
    fn reads(&self) -> Reads {
        Reads::default().position(1).p(100, 2).q(1, 5, 1)
    }

    fn scan(&mut self, image: &mut Image) {
        *self.seen.lock().unwrap() = ScanSnapshot {
            scans: image.scans(),
            skip: image.is_optional_skip(1, 7),
            single_block: image.is_single_block(1),
            feed: image.overrides(1).map_or(0.0, |overrides| overrides.feed),
            captured: image.captured(1).map(|captured| captured.positions.clone()),
            x: image.position(1).map(|position| position.machine["X"]),
            variables: vec![image.p(100), image.p(101), image.p(102), image.q(1, 5)],
            execution: Some(image.execution(1)),
            refused: image.refusals().iter().map(ToString::to_string).collect(),
        };
        (self.write)(image);
    }
}

/// Runs a scan program without M codes every 10 ms; the returned values are those of its last image.
async fn watch(fake: &FakePort, write: fn(&mut Image)) -> Arc<Mutex<ScanSnapshot>> {
    let seen = Arc::new(Mutex::new(ScanSnapshot::default()));
    let program = Watch {
        seen: Arc::clone(&seen),
        write,
    };
    serve(fake, SequenceProgram::new().scan([], ms(10), program)).await;
    seen
}

fn inputs(fake: &FakePort) -> Vec<Input> {
    let requests = fake.requests().into_iter();
    let inputs = requests.filter_map(|request| match request {
        Request::Input(1, input) => Some(input),
        _ => None,
    });
    inputs.collect()
}

#[tokio::test]
async fn image_shows_inputs_overrides_positions_and_requested_variables() {
    let fake = FakePort::new([1]);
    let (plc, mill) = (fake.plc(), fake.plc().coordinate_system(1));
    let position = Position {
        machine: [("X".to_owned(), 12.5)].into(),
        ..Position::default()
    };
    fake.publish_message(1, CsTopic::Position, Payload::Position(position));
    let captured = CapturedPositions {
        positions: vec![1.25],
        ..CapturedPositions::default()
    };
    fake.publish_message(1, CsTopic::Captured, Payload::Captured(captured));
    mill.set_optional_skip(7, true).await.unwrap();
    mill.set_single_block(true).await.unwrap();
    let feed = Some(30.0);
    mill.set_overrides(OverrideChange {
        feed,
        ..OverrideChange::default()
    })
    .await
    .unwrap();
    plc.variables().write(101, &[2.0, 3.0]).await.unwrap();
    mill.variables().set(5, -1.0).await.unwrap();
    let seen = watch(&fake, |_| {}).await;
    let seen = seen.lock().unwrap();
    assert!(seen.skip && seen.single_block);
    assert_eq!((seen.feed, seen.x), (30.0, Some(12.5)));
    assert_eq!(seen.captured, Some(vec![1.25]));
    assert_eq!(
        seen.variables,
        [Some(0.0), Some(2.0), None, Some(-1.0)],
        "P102 was not requested"
    );
    assert_eq!(seen.execution, Some(plc_api::Execution::Ready));
}

#[tokio::test]
async fn flag_written_every_scan_is_sent_on_change_and_wins_over_other_clients() {
    let fake = FakePort::new([1]);
    let mill = fake.plc().coordinate_system(1);
    let _seen = watch(&fake, |image| {
        image.set_interlock(1, true, "a replaced value");
        image.set_interlock(1, image.scans() < 10, "the door is open");
        image.set_optional_skip(1, 3, true);
        image.set_optional_skip(1, 4, false);
    })
    .await;
    fake.advance(ms(55)).await;
    let (owner, instance) = fake
        .handlers()
        .into_iter()
        .next()
        .map(|(id, presence)| (id, presence.instance))
        .unzip();
    let instance = instance.flatten();
    let lock = |value| {
        Input::Interlock(LockSet {
            handler_id: owner.clone(),
            instance: instance.clone(),
            ..LockSet::new(value, "the door is open")
        })
    };
    let skip = |number, value| Input::OptionalSkip([(number, value)].into());
    let once = [lock(true), skip(3, true), skip(4, false)];
    let sent = inputs(&fake);
    assert!(
        sent.len() == once.len() && once.iter().all(|input| sent.contains(input)),
        "once in six scans: {sent:?}"
    );
    // another client writes the flag: the next scan writes the value of the program again
    mill.set_optional_skip(3, false).await.unwrap();
    fake.advance(ms(10)).await;
    assert_eq!(mill.state().await.unwrap().optional_skip, [3]);
    fake.advance(ms(100)).await;
    assert!(!mill.interlock().await.unwrap().value);
}

#[tokio::test]
async fn what_is_written_before_a_reset_is_there_when_the_program_goes_on() {
    let fake = FakePort::new([1]);
    let program = SequenceProgram::new().scan(20, ms(10), |image: &mut Image| {
        if image.is_on(1, 20) {
            image.reset(1, 20);
            image.set_q(1, 9, 3.0);
            image.set_q(1, 8, 2.0);
            image.set_p(9, 1.0);
            image.select_tool(1, 4);
            image.set_spindle(1, SpindleDirection::Cw, 500.0);
        }
    });
    let _task = serve(&fake, program).await;
    let seq = fake.issue_output(1, 20, Params::default());
    fake.advance(ms(15)).await;
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
    let write = |area, from, values: &[f64]| Request::WriteVariables {
        area,
        from,
        values: values.to_vec(),
        meta: None,
    };
    let spindle = SpindleCommand {
        direction: SpindleDirection::Cw,
        rpm: 500.0,
    };
    let expected = [
        write(VariableArea::Global, 9, &[1.0]),
        write(VariableArea::CoordinateSystem(1), 8, &[2.0, 3.0]),
        Request::Tool(1, 4),
        Request::Spindle(1, spindle),
    ];
    assert_eq!(fake.requests(), expected, "neighbours at one moment");
}

#[tokio::test]
async fn what_the_machine_refuses_is_told_to_the_next_scan() {
    let fake = FakePort::new([1]);
    let seen = watch(&fake, |image| {
        if image.scans() == 0 {
            image.command(1, Command::Resume);
            image.set_optional_stop(9, true);
        }
    })
    .await;
    fake.advance(ms(10)).await;
    let refused = seen.lock().unwrap().refused.clone();
    assert_eq!(refused.len(), 2, "{refused:?}");
    assert!(refused[0].contains("coordinate system 9"), "{refused:?}");
    assert!(
        refused[1].contains("resume is not allowed in READY"),
        "{refused:?}"
    );
    fake.advance(ms(10)).await;
    let seen = seen.lock().unwrap();
    assert_eq!((seen.scans, seen.refused.len()), (2, 0));
}

#[tokio::test]
async fn a_flag_is_off_for_a_scan_between_two_outputs_of_one_number() {
    let fake = FakePort::new([1]);
    let (mut was_on, mut edges) = (false, 0);
    let (counted, count) = std::sync::mpsc::channel();
    let program = SequenceProgram::new().scan(20, ms(10), move |image: &mut Image| {
        let is_on = image.is_on(1, 20);
        edges += u32::from(is_on && !was_on);
        was_on = is_on;
        image.reset(1, 20);
        counted.send((edges, is_on)).unwrap();
    });
    let _task = serve(&fake, program).await;
    let all: Vec<_> = (0..3)
        .map(|_| fake.issue_output(1, 20, Params::default()))
        .collect();
    fake.advance(ms(95)).await;
    for seq in all {
        assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
    }
    let scans: Vec<_> = count.try_iter().collect();
    assert_eq!(scans.last().unwrap().0, 3, "{scans:?}");
    let on: String = scans.iter().map(|(_, on)| if *on { '1' } else { '0' }).collect();
    assert!(on.contains("10101"), "{on}");
}

#[tokio::test]
async fn a_scan_sets_sources_of_the_locks_which_are_its_own() {
    let fake = FakePort::new([1]);
    let scan = |image: &mut Image| {
        image.set_interlock(1, image.scans() < 10, "the air is low");
        image.set_interlock_source(1, "door", image.scans() < 20, "the door is open");
        image.set_start_lock_source(1, "pallet", true, "the pallet moves");
    };
    let program = SequenceProgram::new().handler_id("cell");
    let program = program.scan(80, ms(10), scan);
    let plc = fake.plc();
    tokio::spawn(async move { program.run(&plc).await });
    fake.advance(ms(50)).await;
    let mill = fake.plc().coordinate_system(1);
    let on = |lock: Lock| {
        let sources = lock.sources.into_iter().filter(|source| source.value);
        sources
            .map(|one| (one.source, one.handler_id))
            .collect::<Vec<_>>()
    };
    let of = |source: &str| (source.to_owned(), Some("cell".to_owned()));
    assert_eq!(on(mill.interlock().await.unwrap()), [of("default"), of("door")]);
    assert_eq!(on(mill.start_lock().await.unwrap()), [of("pallet")]);
    fake.advance(ms(100)).await;
    assert_eq!(on(mill.interlock().await.unwrap()), [of("door")]);
    fake.advance(ms(100)).await;
    assert_eq!(on(mill.interlock().await.unwrap()), []);
}

fn plant() -> FakePort {
    let fake = FakePort::new([1]);
    fake.declare_io(IoPoint::input("flows"), IoDeclaration::new(false));
    fake.declare_io(IoPoint::output("valve"), IoDeclaration::new(false));
    fake.declare_io(IoPoint::output("pressure"), IoDeclaration::new(0.0));
    fake
}

async fn out(fake: &FakePort, name: &str) -> IoState {
    fake.plc().io_out(name).state().await.unwrap()
}

#[tokio::test]
async fn a_scan_reads_inputs_of_the_plant_and_owns_the_outputs_that_it_writes() {
    let fake = plant();
    let program = SequenceProgram::new()
        .handler_id("cell")
        .scan(8, ms(10), |image: &mut Image| {
            image.set_io_out("valve", image.is_on(1, 8));
            image.set_io_out("pressure", if image.io_in("flows").is_on() { 4.5 } else { 0.0 });
            if image.io_out("pressure") > 4.0 {
                image.reset(1, 8);
            }
        });
    let _task = serve(&fake, program).await;
    let seq = fake.issue_output(1, 8, Params::default());
    fake.advance(ms(50)).await;
    let valve = out(&fake, "valve").await;
    assert_eq!((valve.value, valve.owner.as_deref()), (true.into(), Some("cell")));
    assert_eq!(fake.closed(1, seq), None);
    fake.plc().io_in("flows").set(true).await.unwrap();
    fake.advance(ms(50)).await;
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
    assert_eq!(out(&fake, "pressure").await.value, 4.5);
    assert_eq!(out(&fake, "valve").await.value, false);
    fake.restart();
    fake.plc().io_in("flows").set(true).await.unwrap();
    fake.advance(ms(50)).await;
    let pressure = out(&fake, "pressure").await;
    assert_eq!(
        (pressure.value, pressure.owner.as_deref()),
        (4.5.into(), Some("cell"))
    );
}

#[tokio::test]
async fn scan_sends_an_output_on_change_and_gets_refusals_for_invalid_writes() {
    let fake = plant();
    let said = Arc::new(Mutex::new(Vec::new()));
    let heard = Arc::clone(&said);
    let program = SequenceProgram::new()
        .handler_id("cell")
        .scan([], ms(10), move |image: &mut Image| {
            image.set_io_out("valve", true);
            image.set_io_out("valv", true);
            image.set_io_out("pressure", true);
            let texts = image.refusals().iter().map(|refusal| refusal.text.clone());
            *heard.lock().unwrap() = texts.collect();
        });
    let _task = serve(&fake, program).await;
    fake.advance(ms(200)).await;
    let written = fake
        .requests()
        .into_iter()
        .filter(|request| matches!(request, Request::WriteIo(..)));
    assert_eq!(written.count(), 1, "once, and nothing that cannot be");
    let texts = said.lock().unwrap().clone();
    assert!(
        texts.len() == 2 && texts[0].contains("[io.out.valv]") && texts[1].contains("a number"),
        "{texts:?}"
    );
}
