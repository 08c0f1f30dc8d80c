//! Outputs, levels and M codes of handlers that go offline, for each kind of departure.

use std::sync::Arc;
use std::time::Duration;

use plc_api::{Execution, Plc};
use plc_protocol::port::Port;
use plc_protocol::server::{Origin, ServerTransport};
use plc_protocol::types::io::{IoForced, IoSet};
use plc_protocol::types::lock::LockSet;
use plc_protocol::types::output::{Claim, HandledCode, HandlerPresence, Redelivery};
use plc_protocol::types::request::{Input, RefusalCode, Request, typed};
use plc_protocol::types::state::{Reason, State};
use plc_protocol::wire::right::Right;
use tandem_model::alarm::M_CODE_UNHANDLED;
use tandem_runtime::{Config, Machine, Runtime};
use tandem_testing::{Bench, Scene, kept_journal};

use super::*;

/// Machine with an interlock source `door`, a start lock source `gas`, one input and three outputs.
const PLANT: &str = "[[motor]]\nnumber = 1\nkind = \"linear\"\nmax_velocity = 100\nmax_acceleration = 1000\n\
                     [[coordinate_system]]\nnumber = 1\naxes = { X = 1 }\ndefault_feedrate = 600\n\
                     [input.interlock.source.door]\n[input.start_lock.source.gas]\n\
                     [io.in.door_closed]\n[io.out.lamp]\non_loss = true\n[io.out.clamp]\n[io.out.vice]\n\
                     on_loss = \"keep\"\nat_start = false\n";

fn machine() -> Machine {
    Config::from_toml(PLANT, "").unwrap().resolve().unwrap()
}

/// Runs a test on a machine. Its program 50 moves for 60 s, then waits for M77.
fn with_plant<T: Send + 'static>(test: impl AsyncFnOnce(&Scene, &Runtime) -> T + Send + 'static) -> T {
    let bench = Bench::on_machine(machine()).subprogram(50, "G01 X600 F600\nM77\nM30\n");
    bench
        .play(async move |scene, runtime| test(&scene, runtime).await)
        .unwrap()
}

fn presence(instance: &str, online: bool) -> HandlerPresence {
    HandlerPresence {
        online,
        instance: Some(instance.to_owned()),
        take_over: online,
        handles: vec![HandledCode { cs: 1, m: 77 }],
        ..HandlerPresence::default()
    }
}

async fn send_presence(port: &Arc<dyn Port>, presence: HandlerPresence) {
    port.ask(typed::Handler("cell".into(), presence)).await.unwrap();
}

/// Returns a write of an output by an instance of `cell`.
fn write(name: &str, value: bool, instance: &str) -> typed::WriteIo {
    let set = IoSet {
        value: value.into(),
        handler_id: Some("cell".to_owned()),
        instance: Some(instance.to_owned()),
    };
    typed::WriteIo(IoPoint::output(name), set)
}

/// Clears the interlock source `door` and the start lock source `gas` as this handler.
async fn clear_levels(port: &Arc<dyn Port>, handler_id: &str, instance: Option<&str>) {
    let set = |source: &str| LockSet {
        source: Some(source.to_owned()),
        handler_id: Some(handler_id.to_owned()),
        instance: instance.map(str::to_owned),
        ..LockSet::new(false, "")
    };
    for input in [Input::Interlock(set("door")), Input::StartLock(set("gas"))] {
        port.ask(typed::Input(1, input)).await.unwrap();
    }
}

/// Makes another handler, `watch`, the owner of both locks; this handler stays online.
async fn watch_levels(port: &Arc<dyn Port>) {
    let watch = HandlerPresence {
        online: true,
        ..HandlerPresence::default()
    };
    port.ask(typed::Handler("watch".into(), watch)).await.unwrap();
    clear_levels(port, "watch", None).await;
}

/// Brings `cell` online, makes it close clamp and vice and clear its locks, and starts the program, which moves.
async fn under_way(scene: &Scene) -> Arc<dyn Port> {
    let port = Arc::clone(scene.plc().port());
    send_presence(&port, presence("a", true)).await;
    clear_levels(&port, "cell", Some("a")).await;
    for name in ["clamp", "vice"] {
        port.ask(write(name, true, "a")).await.unwrap();
    }
    scene.cs(1).load(50).await.unwrap();
    scene.cs(1).start().await.unwrap();
    scene.plc().sleep(Duration::from_secs(1)).await;
    port
}

/// Returns, for clamp and vice, true if it is closed, and true if its owner is lost.
async fn clamped(plc: &Plc) -> [(bool, bool); 2] {
    let mut all = Vec::new();
    for name in ["clamp", "vice"] {
        let state = plc.io_out(name).state().await.unwrap();
        all.push((state.value.is_on(), state.lost));
    }
    [all[0], all[1]]
}

const CLOSED: [(bool, bool); 2] = [(true, false), (true, false)];

async fn state(scene: &Scene) -> State {
    scene.cs(1).state().await.unwrap()
}

/// Returns the orderly ways of replacing an instance of `cell`: name, presence of the old instance, and of the next
/// one.
fn orderly() -> [(&'static str, Option<HandlerPresence>, HandlerPresence); 2] {
    let leaves = HandlerPresence {
        returns_within_ms: Some(10_000),
        ..HandlerPresence::offline(Some("a".to_owned()))
    };
    let next = HandlerPresence {
        take_over: false,
        ..presence("b", true)
    };
    [
        ("update", Some(leaves), next),
        ("take-over", None, presence("b", true)),
    ]
}

#[test]
fn a_closed_clamp_and_a_run_outlast_an_update_and_a_take_over() {
    for (way, leaves, next) in orderly() {
        with_plant(async move |scene, _| {
            let port = under_way(scene).await;
            if let Some(leaves) = leaves {
                send_presence(&port, leaves).await;
                send_presence(&port, HandlerPresence::offline(Some("a".to_owned()))).await;
                scene.plc().sleep(Duration::from_millis(9900)).await;
            }
            assert_eq!(clamped(scene.plc()).await, CLOSED, "{way}");
            send_presence(&port, next).await;
            scene.plc().sleep(Duration::from_secs(20)).await;
            assert_eq!(clamped(scene.plc()).await, CLOSED, "{way}");
            assert_eq!(state(scene).await.execution, Execution::Active, "{way}");
            port.ask(write("clamp", false, "b")).await.unwrap();
            assert!(
                !clamped(scene.plc()).await[0].0,
                "{way}: the new instance opens it"
            );
        });
    }
}

/// Returns the requests with which an instance of `cell` sets an output, an interlock and a start lock.
fn sets(instance: Option<&str>) -> [Request; 3] {
    let lock = |source: &str| LockSet {
        source: Some(source.to_owned()),
        handler_id: Some("cell".to_owned()),
        instance: instance.map(str::to_owned),
        ..LockSet::new(true, "set by an old instance")
    };
    let set = IoSet {
        value: false.into(),
        handler_id: Some("cell".to_owned()),
        instance: instance.map(str::to_owned),
    };
    [
        Request::WriteIo(IoPoint::output("clamp"), set),
        Request::Input(1, Input::Interlock(lock("door"))),
        Request::Input(1, Input::StartLock(lock("gas"))),
    ]
}

#[test]
fn a_superseded_instance_writes_no_output_and_no_level() {
    with_plant(async |scene, _| {
        let port = under_way(scene).await;
        send_presence(&port, presence("b", true)).await;
        for (instance, says) in [
            (Some("a"), "is in use by instance b"),
            (None, "name the instance"),
        ] {
            for request in sets(instance) {
                let refusal = port.request(request.clone()).await.unwrap_err();
                assert_eq!(refusal.code, RefusalCode::NotAllowed, "{request:?}");
                assert!(refusal.text.contains(says), "{refusal}");
            }
        }
        assert_eq!(clamped(scene.plc()).await, CLOSED);
        assert!(!scene.cs(1).interlock().await.unwrap().value);
        assert!(!scene.cs(1).start_lock().await.unwrap().value);
        for request in sets(Some("b")) {
            port.request(request).await.unwrap();
        }
        assert!(scene.cs(1).interlock().await.unwrap().value);
    });
}

#[test]
fn handler_with_announced_return_that_stays_offline_is_lost_then() {
    let [(_, leaves, _), _] = orderly();
    with_plant(async move |scene, _| {
        let port = under_way(scene).await;
        send_presence(&port, leaves.unwrap()).await;
        scene.plc().sleep(Duration::from_millis(10_001)).await;
        assert_eq!(clamped(scene.plc()).await, [(false, true), (true, true)]);
        let held = scene.cs(1).wait_until(Execution::Interrupted).await.unwrap();
        assert_eq!(held.reason, Some(Reason::Interlock));
        send_presence(&port, presence("b", true)).await;
        port.ask(write("clamp", true, "b")).await.unwrap();
        assert_eq!(clamped(scene.plc()).await, [(true, false), (true, true)]);
    });
}

#[test]
fn closed_clamp_survives_loss_shorter_than_grace_and_new_instance() {
    for (away_ms, instance) in [(200, "a"), (1900, "b")] {
        with_plant(async move |scene, _| {
            let port = under_way(scene).await;
            send_presence(&port, HandlerPresence::offline(Some("a".to_owned()))).await;
            scene.plc().sleep(Duration::from_millis(away_ms)).await;
            assert_eq!(clamped(scene.plc()).await, CLOSED);
            send_presence(&port, presence(instance, true)).await;
            scene.plc().sleep(Duration::from_secs(10)).await;
            assert_eq!(clamped(scene.plc()).await, CLOSED, "{instance}");
        });
    }
}

#[test]
fn after_the_grace_an_output_has_its_on_loss_and_keep_keeps() {
    with_plant(async |scene, _| {
        let port = under_way(scene).await;
        send_presence(&port, HandlerPresence::offline(Some("a".to_owned()))).await;
        scene.plc().sleep(Duration::from_millis(1999)).await;
        assert_eq!(clamped(scene.plc()).await, CLOSED);
        scene.plc().sleep(Duration::from_millis(2)).await;
        assert_eq!(clamped(scene.plc()).await, [(false, true), (true, true)]);
    });
}

#[test]
fn an_unannounced_loss_sets_a_source_with_on_loss_on_at_once() {
    with_plant(async |scene, _| {
        let port = under_way(scene).await;
        send_presence(&port, HandlerPresence::offline(Some("a".to_owned()))).await;
        let inputs = scene.cs(1).interlock().await.unwrap();
        assert!(inputs.value && inputs.sources[0].lost, "{inputs:?}");
        let held = scene.cs(1).wait_until(Execution::Interrupted).await.unwrap();
        assert_eq!(held.reason, Some(Reason::Interlock));
    });
}

#[test]
fn an_instance_that_does_not_confirm_that_it_lives_is_an_unannounced_loss() {
    with_plant(async |scene, _| {
        let port = under_way(scene).await;
        let next = HandlerPresence {
            take_over: false,
            ..presence("b", true)
        };
        let refused = port.ask(typed::Handler("cell".into(), next.clone())).await;
        assert_eq!(refused.unwrap_err().code, RefusalCode::HandlerTaken);
        scene.plc().sleep(Duration::from_millis(2100)).await;
        send_presence(&port, next).await;
        assert!(
            scene.cs(1).interlock().await.unwrap().value,
            "the door was not watched"
        );
        assert_eq!(clamped(scene.plc()).await, CLOSED);
    });
}

/// Loads and starts a program with this text.
async fn run(scene: &Scene, text: &str) {
    let program = typed::WriteProgram(51, text.to_owned());
    scene.plc().port().ask(program).await.unwrap();
    scene.cs(1).load(51).await.unwrap();
    scene.cs(1).start().await.unwrap();
}

/// Starts a program that reaches M77 after one second. The handler of M77 goes offline half a second earlier.
async fn lose_before_m77(scene: &Scene) -> Arc<dyn Port> {
    let port = Arc::clone(scene.plc().port());
    send_presence(&port, presence("a", true)).await;
    watch_levels(&port).await;
    run(scene, "G04 P1000\nM77\nM30\n").await;
    scene.plc().sleep(Duration::from_millis(500)).await;
    send_presence(&port, HandlerPresence::offline(Some("a".to_owned()))).await;
    port
}

#[test]
fn m_code_of_lost_handler_waits_for_grace_then_unhandled_alarm() {
    with_plant(async |scene, _| {
        lose_before_m77(scene).await;
        scene.plc().sleep(Duration::from_millis(1990)).await;
        assert_eq!(state(scene).await.execution, Execution::Wait);
        scene.plc().sleep(Duration::from_millis(20)).await;
        let stopped = state(scene).await;
        assert_eq!(
            (stopped.execution, stopped.reason),
            (Execution::Stopped, Some(Reason::Alarm))
        );
        let alarms = scene.plc().port().ask(typed::AlarmHistory).await.unwrap();
        assert_eq!(
            alarms.last().map(|alarm| alarm.number),
            Some(M_CODE_UNHANDLED.number)
        );
    });
}

#[test]
fn m_code_that_a_new_presence_no_longer_serves_has_no_handler() {
    for instance in ["a", "b"] {
        with_plant(async move |scene, _| {
            let port = Arc::clone(scene.plc().port());
            send_presence(&port, presence("a", true)).await;
            watch_levels(&port).await;
            run(scene, "M77\nM30\n").await;
            scene.plc().sleep(Duration::from_secs(1)).await;
            assert_eq!(state(scene).await.execution, Execution::Wait);
            send_presence(&port, presence("a", true)).await;
            scene.plc().sleep(Duration::from_secs(1)).await;
            assert_eq!(state(scene).await.execution, Execution::Wait);
            let next = HandlerPresence {
                handles: Vec::new(),
                ..presence(instance, true)
            };
            send_presence(&port, next).await;
            scene.plc().sleep(Duration::from_millis(100)).await;
            let stopped = state(scene).await;
            assert_eq!(stopped.execution, Execution::Stopped, "instance {instance}");
            let alarms = scene.plc().port().ask(typed::AlarmHistory).await.unwrap();
            let last = alarms.last().map(|alarm| alarm.number);
            assert_eq!(last, Some(M_CODE_UNHANDLED.number));
        });
    }
}

/// Claims the pending output as `cell`.
async fn claim(scene: &Scene, instance: &str) {
    let pending = scene.cs(1).pending().await.unwrap();
    let claim = Claim {
        boot_id: scene.plc().port().boot_id(),
        seq: pending.outputs[0].output.seq,
        handler_id: "cell".to_owned(),
        instance: Some(instance.to_owned()),
    };
    scene
        .plc()
        .port()
        .ask(typed::Claim(1, None, claim))
        .await
        .unwrap();
}

#[test]
fn an_m_code_goes_to_a_handler_that_is_back_within_the_grace() {
    with_plant(async |scene, _| {
        let port = lose_before_m77(scene).await;
        scene.plc().sleep(Duration::from_millis(1900)).await;
        send_presence(&port, presence("b", true)).await;
        scene.plc().sleep(Duration::from_secs(10)).await;
        assert_eq!(state(scene).await.execution, Execution::Wait);
        claim(scene, "b").await;
        let pending = scene.cs(1).pending().await.unwrap();
        assert_eq!(pending.outputs[0].instance.as_deref(), Some("b"));
    });
}

#[test]
fn claimed_m_code_reported_lost_after_grace_unless_claimed_again() {
    for (redelivery, reported) in [
        (Redelivery::Redo, None),
        (Redelivery::Ask, Some(Reason::HandlerLost)),
    ] {
        with_plant(async move |scene, _| {
            let port = Arc::clone(scene.plc().port());
            let said = |instance| HandlerPresence {
                redelivery: Some(redelivery),
                ..presence(instance, true)
            };
            send_presence(&port, said("a")).await;
            watch_levels(&port).await;
            run(scene, "M77\nM30\n").await;
            claim(scene, "a").await;
            send_presence(&port, HandlerPresence::offline(Some("a".to_owned()))).await;
            scene.plc().sleep(Duration::from_secs(1)).await;
            assert_eq!(state(scene).await.reason, None);
            send_presence(&port, said("b")).await;
            if redelivery == Redelivery::Redo {
                claim(scene, "b").await;
            }
            scene.plc().sleep(Duration::from_millis(999)).await;
            assert_eq!(state(scene).await.reason, None);
            scene.plc().sleep(Duration::from_millis(2)).await;
            assert_eq!(state(scene).await.reason, reported);
        });
    }
}

#[test]
fn the_journal_names_the_owner_of_each_change_of_an_output() {
    let (journal, lines) = kept_journal();
    let bench = Bench::on_machine(machine()).journal(journal);
    let play = bench.play(async |scene, _| {
        let port = Arc::clone(scene.plc().port());
        send_presence(&port, presence("a", true)).await;
        let anyone = IoSet {
            value: true.into(),
            ..IoSet::default()
        };
        port.ask(typed::WriteIo(IoPoint::output("clamp"), anyone))
            .await
            .unwrap();
        for value in [true, false, false] {
            port.ask(write("clamp", value, "a")).await.unwrap();
        }
    });
    play.unwrap();
    let lines = lines.lock().unwrap();
    let writes: Vec<_> = (lines.iter())
        .filter_map(|line| match &line.event {
            Event::IoWrite {
                io,
                value,
                handler_id,
            } => Some((io.as_str(), value.is_on(), handler_id.as_deref())),
            _ => None,
        })
        .collect();
    let of_clamp = |value, owner| ("io/out/clamp", value, owner);
    assert_eq!(
        writes,
        [
            of_clamp(true, None),
            of_clamp(true, Some("cell")),
            of_clamp(false, Some("cell"))
        ],
        "a write that changes nothing has no line"
    );
}

#[test]
fn at_a_start_each_has_its_safe_value_and_birth_tells_what_there_is() {
    with_plant(async |_, runtime| {
        let plc = Plc::in_process(runtime.port());
        for (io, value) in [(plc.io_in("door_closed"), false), (plc.io_out("lamp"), true)] {
            let state = io.state().await.unwrap();
            assert_eq!(
                (state.value, state.owner, state.lost),
                (value.into(), None, false)
            );
        }
        let birth = runtime.port().read(&Topic::Birth).await.unwrap();
        let Payload::Birth(birth) = &birth.payload else {
            panic!("{birth:?}");
        };
        let all: Vec<_> = birth.io.points().map(|(point, _)| point.to_string()).collect();
        let expected = ["io/in/door_closed", "io/out/clamp", "io/out/lamp", "io/out/vice"];
        assert_eq!(all, expected);
    });
}

#[test]
fn a_handler_that_is_not_online_writes_nothing() {
    with_plant(async |scene, _| {
        let refused = scene.plc().port().ask(write("lamp", false, "a")).await;
        assert_eq!(refused.unwrap_err().code, RefusalCode::Unavailable);
    });
}

#[test]
fn a_force_is_in_the_name_of_the_user_whom_the_server_knows() {
    with_plant(async |_, runtime| {
        let port = runtime.served_port();
        let force = IoForce {
            value: Some(false.into()),
            by: Some("somebody".to_owned()),
        };
        for (user, by) in [(Some("anna"), "anna"), (None, "somebody")] {
            let origin = Origin {
                user: user.map(ToOwned::to_owned),
                from: None,
                over: ServerTransport::Rest,
                right: Right::Operate,
                not_after: None,
            };
            let request = Request::ForceIo(IoPoint::output("lamp"), force.clone());
            port.request_from(origin, request).await.unwrap();
            let state = Plc::in_process(runtime.port()).io_out("lamp").state().await;
            let forced = IoForced {
                value: false.into(),
                by: by.to_owned(),
            };
            assert_eq!(state.unwrap().forced, Some(forced));
        }
    });
}
