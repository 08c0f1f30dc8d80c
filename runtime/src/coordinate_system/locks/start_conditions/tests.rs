use std::time::Duration;

use plc_api::{Alarm, AuxOutput, Execution, Plc, SequenceProgram};
use plc_protocol::types::message::Payload;
use plc_protocol::types::planned::PlannedLocation;
use plc_protocol::types::request::typed;
use plc_protocol::types::start::{StartObstacle, StartObstacleKind};
use plc_protocol::types::topic::{CsTopic, Topic};

use tandem_testing::{Bench, Scene};

/// Program of a part without M codes that need a handler.
const PART: &str = "G90 G01 X10 F600\nX0\nM30\n";

async fn obstacles(scene: &Scene) -> Vec<StartObstacle> {
    let topic = Topic::cs(1, CsTopic::StartConditions);
    let message = scene.plc().port().read(&topic).await.unwrap();
    match &message.payload {
        Payload::StartConditions(conditions) => conditions.obstacles.clone(),
        other => panic!("{other:?}"),
    }
}

async fn kinds(scene: &Scene) -> Vec<StartObstacleKind> {
    obstacles(scene).await.into_iter().map(|one| one.kind).collect()
}

#[test]
fn each_obstacle_is_published_while_it_prevents_a_start() {
    use StartObstacleKind::{Alarm as Alarmed, Interlock, Lease, NoProgram, Reset, Running, StartLock};
    let play = Bench::new().subprogram(50, PART).play(async |scene, _| {
        let (plc, mill) = (scene.plc(), scene.cs(1));
        assert_eq!(kinds(&scene).await, [NoProgram]);
        mill.load(50).await.unwrap();
        assert_eq!(kinds(&scene).await, []);
        mill.set_interlock(true, "the door is open").await.unwrap();
        assert_eq!(kinds(&scene).await, [Interlock]);
        assert!(obstacles(&scene).await[0].text.contains("the door is open"));
        mill.set_start_lock(true, "no blank").await.unwrap();
        assert_eq!(kinds(&scene).await, [Interlock, StartLock]);
        mill.set_interlock(false, "").await.unwrap();
        mill.set_start_lock(false, "").await.unwrap();
        assert_eq!(kinds(&scene).await, []);
        let lease = mill.take_lease(Duration::from_mins(10)).await.unwrap();
        assert_eq!(kinds(&scene).await, [Lease]);
        lease.release().await.unwrap();
        mill.start().await.unwrap();
        assert_eq!(kinds(&scene).await, [Running]);
        mill.stop().await.unwrap();
        assert_eq!(kinds(&scene).await, [Reset]);
        mill.reset().await.unwrap();
        assert_eq!(kinds(&scene).await, []);
        plc.raise_alarm(Alarm::user(7, "oil")).await.unwrap();
        mill.wait_until(Execution::Stopped).await.unwrap();
        assert_eq!(kinds(&scene).await, [Alarmed]);
        mill.reset().await.unwrap();
        mill.start().await.unwrap();
        mill.wait_until(Execution::ProgramCompleted).await.unwrap();
        assert_eq!(kinds(&scene).await, []);
    });
    play.unwrap();
}

#[test]
fn m_code_without_handler_and_predicted_alarm_refuse_no_start() {
    let beyond = "G90 G01 X10 F600\nP1 = 9000\nX[P1]\nM30\n";
    let bench = Bench::new()
        .subprogram(50, "G90 G01 X10 F600\nM98 P1001\nM30\n")
        .subprogram(1001, "M77\nM99\n")
        .subprogram(51, beyond);
    let play = bench.play(async |scene, _| {
        let mill = scene.cs(1);
        mill.load(50).await.unwrap();
        let found = obstacles(&scene).await;
        assert_eq!((found.len(), found[0].kind), (1, StartObstacleKind::MCode));
        assert_eq!((&found[0].m_codes, found[0].refuses), (&vec![77], false));
        mill.load(51).await.unwrap();
        scene
            .plc()
            .port()
            .ask(typed::Rehearsal(51, Some(1)))
            .await
            .unwrap();
        mill.set_optional_stop(true).await.unwrap();
        let found = obstacles(&scene).await;
        assert_eq!((found.len(), found[0].kind), (1, StartObstacleKind::Prediction));
        let at = PlannedLocation { program: 51, line: 3 };
        assert_eq!((found[0].at, found[0].refuses), (Some(at), false));
        assert!(found[0].text.contains("limit"), "{}", found[0].text);
        mill.load(50).await.unwrap();
        assert_eq!(kinds(&scene).await, [StartObstacleKind::MCode]);
    });
    play.unwrap();
}

#[test]
fn an_m_code_whose_handler_comes_is_no_obstacle_any_more() {
    let bench = Bench::new()
        .subprogram(50, "M77\nM30\n")
        .serve(SequenceProgram::new().on(77, |_: AuxOutput, _: Plc| async { Ok::<(), Alarm>(()) }));
    let play = bench.play(async |scene, _| {
        scene.cs(1).load(50).await.unwrap();
        assert_eq!(kinds(&scene).await, []);
    });
    play.unwrap();
}

#[test]
fn changed_called_program_changes_the_conditions_at_once() {
    let bench = Bench::new()
        .subprogram(50, "G90 G01 X10 F600\nM98 P1001\nM30\n")
        .subprogram(1001, "M99\n");
    let play = bench.play(async |scene, _| {
        scene.cs(1).load(50).await.unwrap();
        assert_eq!(kinds(&scene).await, []);
        for (text, found) in [
            ("G01 X\nM99\n", vec![StartObstacleKind::Program]),
            ("M77\nM99\n", vec![StartObstacleKind::MCode]),
            ("M99\n", vec![]),
        ] {
            let stored = typed::WriteProgram(1001, text.to_owned());
            scene.plc().port().ask(stored).await.unwrap();
            scene.plc().sleep(Duration::from_millis(10)).await;
            assert_eq!(kinds(&scene).await, found, "{text}");
        }
    });
    play.unwrap();
}

#[test]
fn conditions_change_when_an_absent_handler_is_no_longer_expected() {
    let bench = Bench::new().subprogram(50, "M77\nM30\n").serve(
        SequenceProgram::new()
            .handler_id("cell")
            .on(77, |_: AuxOutput, _: Plc| async { Ok::<(), Alarm>(()) }),
    );
    let play = bench.play(async |scene, _| {
        scene.cs(1).load(50).await.unwrap();
        assert_eq!(kinds(&scene).await, []);
        scene.kill_handlers();
        scene.plc().sleep(Duration::from_millis(1900)).await;
        assert_eq!(kinds(&scene).await, [], "within grace_ms");
        scene.plc().sleep(Duration::from_millis(200)).await;
        assert_eq!(kinds(&scene).await, [StartObstacleKind::MCode]);
    });
    play.unwrap();
}
