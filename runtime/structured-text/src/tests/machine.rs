use std::time::Duration;

use plc_api::fake::FakePort;
use plc_api::{Alarm, Params};
use plc_protocol::handshake::OutputOutcome;
use plc_protocol::types::io::{IoDeclaration, IoPoint, IoValue};
use plc_protocol::types::message::Payload;
use plc_protocol::types::state::{CapturedPositions, Lock, Position};
use plc_protocol::types::topic::CsTopic;

use super::{compiled, program};

/// Scans a program with these variables and statements every 10 ms.
async fn serve(fake: &FakePort, variables: &str, body: &str) {
    let plc = fake.plc();
    let program = compiled(&program(variables, body)).sequence_program(Duration::from_millis(10));
    tokio::spawn(async move { program.run(&plc).await });
    fake.settle().await;
}

async fn advance(fake: &FakePort, ms: u64) {
    fake.advance(Duration::from_millis(ms)).await;
}

async fn p(fake: &FakePort, number: u32) -> f64 {
    fake.plc().variables().get(number).await.unwrap()
}

fn va_and_vc(a: f64, c: f64) -> Params {
    Params {
        a: Some(a),
        c: Some(c),
        ..Params::default()
    }
}

#[tokio::test]
async fn mcode_shows_an_output_with_its_parameters_and_resets_it() {
    let fake = FakePort::new([1]);
    let body =
        "m(); IF m.Active THEN SET_P(100, m.A); SET_P(101, SEL(m.HasA AND NOT m.HasB AND m.HasC, 0, 1));
        t(IN := TRUE, PT := T#50ms); END_IF; m(Done := t.Q);";
    serve(&fake, "m : MCODE := (M := 12); t : TON;", body).await;
    let seq = fake.issue_output(1, 12, va_and_vc(2.5, 0.0));
    advance(&fake, 35).await;
    assert_eq!(fake.closed(1, seq), None);
    assert_eq!((p(&fake, 100).await, p(&fake, 101).await), (2.5, 1.0));
    advance(&fake, 50).await;
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
}

#[tokio::test]
async fn mcode_fails_with_its_text_and_code() {
    let body = "a(M := 12, CS := 1, Error := TRUE, Done := TRUE, ErrorText := 'jammed'); b(M := 13, CS := 2, Error := TRUE, ErrorCode := 7);";
    let elsewhere = "test.st serves M12 only in another coordinate system";
    for (cs, m, alarm) in [
        (1, 12, Alarm::user(12, "jammed")),
        (2, 13, Alarm::user(7, "M13 has failed")),
        (2, 12, Alarm::user(12, elsewhere)),
    ] {
        let fake = FakePort::new([1, 2]);
        serve(&fake, "a, b : MCODE;", body).await;
        let seq = fake.issue_output(cs, m, Params::default());
        advance(&fake, 35).await;
        assert_eq!(fake.closed(cs, seq), Some(OutputOutcome::Failed { alarm }));
    }
}

#[tokio::test]
async fn a_program_for_one_coordinate_system_serves_no_other() {
    let fake = FakePort::new([1, 2]);
    serve(&fake, "m : MCODE;", "m(M := 12, CS := 2, Done := TRUE);").await;
    let (other, own) = (
        fake.issue_output(1, 12, Params::default()),
        fake.issue_output(2, 12, Params::default()),
    );
    advance(&fake, 35).await;
    assert_eq!(fake.closed(1, other), None);
    assert_eq!(fake.closed(2, own), Some(OutputOutcome::Reset));
}

#[tokio::test]
async fn progress_is_told_once_for_each_text() {
    let fake = FakePort::new([1]);
    serve(
        &fake,
        "m : MCODE;",
        "m(M := 12, Progress := 50.0, ProgressText := 'closes');",
    )
    .await;
    fake.issue_output(1, 12, Params::default());
    advance(&fake, 100).await;
    let progress = fake.pending(1)[0].progress.clone().unwrap();
    assert_eq!((progress.text.as_str(), progress.percent), ("closes", Some(50.0)));
}

#[tokio::test]
async fn of_several_interlocks_one_that_is_on_is_enough() {
    let fake = FakePort::new([1]);
    let body = "a(On := P(100) > 0.5, Text := 'the door is open'); b(On := P(101) > 0.5, Text := 'the air is low'); s(On := P(100) > 0.5);";
    serve(&fake, "a, b : INTERLOCK; s : START_LOCK;", body).await;
    let mill = fake.plc().coordinate_system(1);
    for (door, air, text) in [
        (1.0, 0.0, "the door is open"),
        (0.0, 1.0, "the air is low"),
        (1.0, 1.0, "the door is open; the air is low"),
    ] {
        fake.plc().variables().write(100, &[door, air]).await.unwrap();
        advance(&fake, 30).await;
        let lock = mill.interlock().await.unwrap();
        assert_eq!((lock.value, lock.text.as_str()), (true, text));
        assert_eq!(mill.start_lock().await.unwrap().value, door > 0.5);
    }
    fake.plc().variables().write(100, &[0.0, 0.0]).await.unwrap();
    advance(&fake, 30).await;
    assert!(!mill.interlock().await.unwrap().value);
}

#[tokio::test]
async fn a_lock_is_of_its_source() {
    let fake = FakePort::new([1]);
    let body = "a(On := TRUE, Text := 'open', Source := 'door'); b(On := P(100) > 0.5, Text := 'low'); s(On := TRUE, Source := 'pallet');";
    serve(&fake, "a, b : INTERLOCK; s : START_LOCK;", body).await;
    advance(&fake, 30).await;
    let mill = fake.plc().coordinate_system(1);
    let of = |lock: Lock| {
        let sources = lock.sources.into_iter();
        sources.map(|one| (one.source, one.value)).collect::<Vec<_>>()
    };
    let source = |name: &str, value| (name.to_owned(), value);
    let sources = of(mill.interlock().await.unwrap());
    assert_eq!(sources, [source("default", false), source("door", true)]);
    assert_eq!(of(mill.start_lock().await.unwrap()), [source("pallet", true)]);
}

#[tokio::test]
async fn inputs_of_the_plant_are_read_and_outputs_written() {
    let fake = FakePort::new([1]);
    fake.declare_io(IoPoint::input("flows"), IoDeclaration::new(false));
    fake.declare_io(IoPoint::input("level"), IoDeclaration::new(0.0));
    fake.declare_io(IoPoint::output("valve"), IoDeclaration::new(false));
    fake.declare_io(IoPoint::output("pressure"), IoDeclaration::new(0.0));
    let body = "f(Name := 'flows'); l(Name := 'level'); n(Name := 'nothing');
        v(Name := 'valve', On := f.On AND f.Valid AND NOT f.Lost AND NOT n.Valid, Number := 9.0);
        p(Name := 'pressure', Number := l.Number * 2.0); x(Name := 'nothing', On := TRUE);
        SET_P(100, SEL(v.Valid AND p.Valid AND NOT x.Valid, 0, 1)); SET_P(101, SEL(v.Forced, 0, 1));";
    serve(&fake, "f, l, n : IO_IN; v, p, x : IO_OUT;", body).await;
    let plc = fake.plc();
    plc.io_in("flows").set(true).await.unwrap();
    plc.io_in("level").set(12.5).await.unwrap();
    advance(&fake, 50).await;
    assert!(plc.io_out("valve").value().await.unwrap().is_on());
    assert_eq!(
        plc.io_out("pressure").value().await.unwrap(),
        IoValue::Number(25.0)
    );
    assert_eq!((p(&fake, 100).await, p(&fake, 101).await), (1.0, 0.0));
    plc.io_in("flows").set(false).await.unwrap();
    plc.io_out("valve").force(true).await.unwrap();
    advance(&fake, 50).await;
    let valve = plc.io_out("valve").state().await.unwrap();
    assert_eq!(
        (valve.value, valve.written),
        (IoValue::Bool(true), IoValue::Bool(false))
    );
    assert!(p(&fake, 101).await > 0.5);
}

#[tokio::test]
async fn an_interlock_that_is_not_called_keeps_its_level() {
    let fake = FakePort::new([1]);
    serve(
        &fake,
        "a : INTERLOCK; s : SCAN_STATE;",
        "s(); IF s.First THEN a(On := TRUE, Text := 'closed for good'); END_IF;",
    )
    .await;
    advance(&fake, 100).await;
    assert!(fake.plc().coordinate_system(1).interlock().await.unwrap().value);
}

#[tokio::test]
async fn alarms_are_raised_while_their_level_is_on() {
    let fake = FakePort::new([1]);
    let body = "a(Code := 20, On := P(100) > 0.5, Text := 'the air is low'); s(); SET_P(101, UDINT_TO_LREAL(s.Count)); SET_P(102, s.Number);";
    serve(&fake, "a : ALARM; s : ALARM_STATE;", body).await;
    advance(&fake, 30).await;
    assert_eq!(fake.plc().alarms().await.unwrap(), []);
    fake.plc().variables().set(100, 1.0).await.unwrap();
    advance(&fake, 50).await;
    let alarms = fake.plc().alarms().await.unwrap();
    assert_eq!(
        (alarms[0].number, alarms[0].text.as_str()),
        (10_020, "the air is low")
    );
    assert_eq!((p(&fake, 101).await, p(&fake, 102).await), (1.0, 10_020.0));
}

#[tokio::test]
async fn a_program_that_stands_is_an_alarm_and_its_m_codes_fail() {
    let fake = FakePort::new([1]);
    serve(
        &fake,
        "m : MCODE; i : INTERLOCK; n : INT;",
        "m(M := 12); i(On := TRUE, Text := 'door'); n := 1 / n;",
    )
    .await;
    let seq = fake.issue_output(1, 12, Params::default());
    advance(&fake, 50).await;
    let text =
        "test.st has stopped: line 3, at n: a division by zero. Correct the program, and start it again";
    assert_eq!(fake.plc().alarms().await.unwrap()[0].text, text);
    let alarm = Alarm::user(Alarm::CODE_OF_ERROR, text);
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Failed { alarm }));
    assert!(
        fake.plc().coordinate_system(1).interlock().await.unwrap().value,
        "the locks of the program stay locked"
    );
}

#[tokio::test]
async fn states_overrides_tools_and_inputs_are_shown_and_set() {
    let fake = FakePort::new([1]);
    let body = "o(Feed := 30.0); t(Enable := TRUE, Tool := 5); b(On := TRUE); k(Number := 3, On := TRUE); w(On := TRUE);
        s(); SET_P(100, s.FeedOverride); SET_P(101, s.Tool);
        IF s.Ready AND s.State = 'READY' AND s.SingleBlock AND s.OptionalStop THEN SET_P(102, 1); END_IF;";
    let variables = "o : OVERRIDE; t : SELECT_TOOL; b : SINGLE_BLOCK; k : OPTIONAL_SKIP; w : OPTIONAL_STOP; s : CS_STATE;";
    serve(&fake, variables, body).await;
    advance(&fake, 50).await;
    assert_eq!(
        (p(&fake, 100).await, p(&fake, 101).await, p(&fake, 102).await),
        (30.0, 5.0, 1.0)
    );
    let state = fake.plc().coordinate_system(1).state().await.unwrap();
    assert_eq!(state.optional_skip, [3]);
}

#[tokio::test]
async fn positions_and_what_a_probe_has_captured_are_shown() {
    let fake = FakePort::new([1]);
    let position = Position {
        machine: [("X".to_owned(), 12.5)].into(),
        feedrate: 600.0,
        ..Position::default()
    };
    fake.publish_message(1, CsTopic::Position, Payload::Position(position));
    let captured = CapturedPositions {
        motors: vec![3],
        positions: vec![1.25],
        captured: vec![true],
        line: 7,
        ..CapturedPositions::default()
    };
    fake.publish_message(1, CsTopic::Captured, Payload::Captured(captured));
    let body = "x(Axis := 'x'); y(Axis := 'Y'); c(Motor := 3);
        IF x.Valid AND NOT y.Valid AND c.Valid AND c.Captured THEN SET_P(100, x.Machine); SET_P(101, x.Feedrate); SET_P(102, c.Position); END_IF;";
    serve(&fake, "x, y : POSITION; c : CAPTURED;", body).await;
    advance(&fake, 30).await;
    assert_eq!(
        (p(&fake, 100).await, p(&fake, 101).await, p(&fake, 102).await),
        (12.5, 600.0, 1.25)
    );
}

#[tokio::test]
async fn the_operator_is_asked_and_answers() {
    let fake = FakePort::new([1]);
    let body =
        "q(Ask := TRUE, Text := 'Is it clean?', Choice1 := 'yes', Choice3 := 'no'); m(Done := q.Answer = 3);";
    serve(&fake, "m : MCODE := (M := 80); q : QUESTION := (M := 80);", body).await;
    let seq = fake.issue_output(1, 80, Params::default());
    advance(&fake, 30).await;
    let mill = fake.plc().coordinate_system(1);
    let question = mill.question().await.unwrap();
    assert_eq!(question.question.choices, ["yes", "no"]);
    mill.answer(&question, "no").await.unwrap();
    advance(&fake, 30).await;
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
}

#[tokio::test]
async fn a_command_is_given_once_at_its_rising_edge() {
    use plc_protocol::types::request::Request;
    let fake = FakePort::new([1]);
    serve(&fake, "c : CS_COMMAND;", "c(Hold := TRUE);").await;
    advance(&fake, 100).await;
    let commands = fake
        .requests()
        .into_iter()
        .filter(|request| matches!(request, Request::Command { .. }));
    assert_eq!(commands.count(), 1);
}

#[tokio::test]
async fn q_variables_are_those_of_their_coordinate_system() {
    let fake = FakePort::new([1, 2]);
    fake.plc()
        .coordinate_system(2)
        .variables()
        .set(5, 7.0)
        .await
        .unwrap();
    serve(&fake, "", "SET_Q(1, 6, Q(2, 5) + 1.0);").await;
    advance(&fake, 30).await;
    let written = fake.plc().coordinate_system(1).variables().get(6).await.unwrap();
    assert!((written - 8.0).abs() < 1e-9, "{written}");
}

#[tokio::test]
async fn spindle_and_skip_input_are_commanded() {
    use plc_protocol::types::request::{Request, SpindleCommand};
    use plc_protocol::types::state::SpindleDirection;
    let fake = FakePort::new([1]);
    serve(
        &fake,
        "s : SPINDLE; k : SKIP_INPUT;",
        "s(Enable := TRUE, Clockwise := TRUE, Speed := 500.0); k(Motor := 3, On := TRUE);",
    )
    .await;
    advance(&fake, 30).await;
    let requests = fake.requests();
    let spindle = SpindleCommand {
        direction: SpindleDirection::Cw,
        rpm: 500.0,
    };
    assert!(requests.contains(&Request::Spindle(1, spindle)), "{requests:?}");
    assert!(requests.contains(&Request::SkipInput(3, true)), "{requests:?}");
}
