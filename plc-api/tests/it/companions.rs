//! Levels and tasks that run together with the handlers, and the end of a program.

use std::sync::{Arc, Mutex};

use plc_api::fake::FakePort;
use plc_api::fake::OutputOutcome;
use plc_api::{Alarm, AuxOutput, CancelReason, HandlerState, Params, Plc, Redelivery, SequenceProgram};
use plc_protocol::types::refusal::{Refusal, RefusalCode};
use tokio::sync::watch;

use crate::{ms, serve};

/// Events that handlers and tasks have recorded, in order.
type Heard = Arc<Mutex<Vec<String>>>;

fn note(heard: &Heard, what: impl Into<String>) {
    heard.lock().unwrap().push(what.into());
}

fn all(heard: &Heard) -> Vec<String> {
    heard.lock().unwrap().clone()
}

/// Returns the active alarms, each with its coordinate system and text.
async fn alarms(fake: &FakePort) -> Vec<(Option<u8>, String)> {
    let alarms = fake.plc().alarms().await.unwrap();
    alarms.into_iter().map(|alarm| (alarm.cs, alarm.text)).collect()
}

fn low(cs: Option<u8>) -> Vec<(Option<u8>, String)> {
    vec![(cs, "low".to_owned())]
}

async fn ok(_output: AuxOutput) -> Result<(), Alarm> {
    Ok(())
}

/// A handler that works for 10 s.
async fn long(_output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    plc.sleep(ms(10_000)).await;
    Ok(())
}

#[tokio::test]
async fn level_alarm_is_raised_once_and_reset_holds_only_without_the_level() {
    let fake = FakePort::new([1, 2]);
    let mill = fake.plc().coordinate_system(1);
    let (air, is_low) = watch::channel(false);
    let program = SequenceProgram::new().alarm_while(is_low, Alarm::user(20, "low"));
    serve(&fake, program).await;
    assert_eq!(alarms(&fake).await, []);
    air.send_replace(true);
    fake.advance(ms(5000)).await;
    assert_eq!(alarms(&fake).await, low(None));
    mill.reset().await.unwrap();
    fake.settle().await;
    assert_eq!(alarms(&fake).await, low(None), "the air is still low");
    air.send_replace(false);
    fake.settle().await;
    assert_eq!(alarms(&fake).await, low(None), "the alarm stays until a reset");
    mill.reset().await.unwrap();
    fake.advance(ms(5000)).await;
    assert_eq!(alarms(&fake).await, []);
}

#[tokio::test]
async fn an_alarm_of_a_level_comes_again_after_a_start_of_the_machine() {
    let fake = FakePort::new([1]);
    let (_air, is_low) = watch::channel(true);
    let program = SequenceProgram::new().alarm_while(is_low, Alarm::user(20, "low"));
    serve(&fake, program).await;
    fake.restart();
    fake.settle().await;
    assert_eq!(alarms(&fake).await, low(None));
}

#[tokio::test]
async fn a_level_that_nobody_sends_any_more_is_an_alarm() {
    let fake = FakePort::new([1]);
    let (air, is_low) = watch::channel(false);
    let program = SequenceProgram::new().alarm_while(is_low, Alarm::user(20, "low"));
    serve(&fake, program).await;
    drop(air);
    fake.settle().await;
    let text = "low, or unknown (the program no longer reports it)".to_owned();
    assert_eq!(alarms(&fake).await, [(None, text)]);
}

#[tokio::test]
async fn an_alarm_of_one_coordinate_system_is_that_coordinate_systems() {
    let fake = FakePort::new([1, 2]);
    let (_oil, is_low) = watch::channel(true);
    let program = SequenceProgram::new()
        .in_coordinate_system(2, |loader| loader.alarm_while(is_low, Alarm::user(20, "low")));
    serve(&fake, program).await;
    assert_eq!(alarms(&fake).await, low(Some(2)));
    let mill = fake.plc().coordinate_system(1).state().await.unwrap();
    assert_eq!(mill.alarm_count, 0);
}

#[test]
fn an_alarm_of_a_level_is_a_users_with_a_text() {
    let level = || watch::channel(false).1;
    let number = Alarm {
        number: 300,
        text: "mine".to_owned(),
    };
    for alarm in [number, Alarm::user(1, "")] {
        let program = SequenceProgram::new().alarm_while(level(), alarm);
        let mistake = program.check().unwrap_err().to_string();
        assert!(mistake.contains("alarm_while() got alarm"), "{mistake}");
    }
}

/// Returns a program with a task that records each start and each drop of the task.
fn with_task(heard: &Heard) -> SequenceProgram {
    struct Dropped(Heard);
    impl Drop for Dropped {
        fn drop(&mut self) {
            note(&self.0, "dropped");
        }
    }
    let heard = Arc::clone(heard);
    SequenceProgram::new().on(10, ok).task(move |plc| {
        let heard = Arc::clone(&heard);
        async move {
            note(&heard, format!("begun in {}", plc.port().boot_id()));
            let _dropped = Dropped(heard);
            let mut tick = plc.interval(ms(100));
            loop {
                tick.tick().await;
            }
        }
    })
}

#[tokio::test]
async fn a_task_begins_with_each_boot_of_the_machine_and_is_dropped_with_it() {
    let fake = FakePort::new([1]);
    let heard = Heard::default();
    let first = fake.plc().port().boot_id();
    let served = serve(&fake, with_task(&heard)).await;
    fake.advance(ms(1000)).await;
    assert_eq!(all(&heard), [format!("begun in {first}")]);
    fake.restart();
    fake.settle().await;
    let second = fake.plc().port().boot_id();
    let begun = [
        format!("begun in {first}"),
        "dropped".to_owned(),
        format!("begun in {second}"),
    ];
    assert_eq!(all(&heard), begun);
    served.abort();
    fake.settle().await;
    assert_eq!(all(&heard).len(), 4, "it is dropped with the program");
}

#[tokio::test]
async fn a_task_begins_when_this_start_of_the_machine_knows_the_handlers() {
    let fake = FakePort::new([1]);
    let heard = Heard::default();
    let (noted, machine) = (Arc::clone(&heard), fake.clone());
    let program = SequenceProgram::new().on(10, ok).task(move |_plc| {
        let known = machine.handlers().values().any(|handler| handler.online);
        note(&noted, format!("known: {known}"));
        async { Ok(()) }
    });
    serve(&fake, program).await;
    fake.restart();
    fake.settle().await;
    assert_eq!(all(&heard), ["known: true", "known: true"]);
}

#[tokio::test]
async fn a_task_that_ends_leaves_the_handlers_alone() {
    let fake = FakePort::new([1]);
    let served = serve(&fake, SequenceProgram::new().on(10, ok).task(async |_plc| Ok(()))).await;
    let seq = fake.issue_output(1, 10, Params::default());
    fake.advance(ms(5000)).await;
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
    assert!(!served.is_finished());
}

#[tokio::test]
async fn a_task_whose_connection_fails_begins_anew_after_a_second() {
    let fake = FakePort::new([1]);
    let heard = Heard::default();
    let noted = Arc::clone(&heard);
    let program = SequenceProgram::new().task(move |plc| {
        note(&noted, format!("{:.0}", plc.now_s()));
        async { Err(Refusal::new(RefusalCode::Unavailable, "no broker").into()) }
    });
    let served = serve(&fake, program).await;
    fake.advance(ms(2500)).await;
    assert_eq!(all(&heard), ["0", "1", "2"]);
    assert!(!served.is_finished());
}

#[tokio::test]
async fn a_task_that_fails_or_panics_ends_the_program_with_its_reason() {
    let failing = SequenceProgram::new()
        .task(async |_plc| Err(Refusal::new(RefusalCode::Invalid, "no such sensor").into()));
    let panicking = SequenceProgram::new().task(async |plc| {
        assert!(plc.now_s() > 0.0, "not calibrated");
        Ok(())
    });
    for (program, text) in [(failing, "no such sensor"), (panicking, "not calibrated")] {
        let fake = FakePort::new([1]);
        let error = serve(&fake, program).await.await.unwrap().unwrap_err();
        assert!(error.to_string().contains(text), "{error}");
        assert_eq!(fake.handlers().values().filter(|one| one.online).count(), 0);
    }
}

#[tokio::test]
async fn a_merged_program_serves_what_both_serve_with_their_states_and_tasks() {
    const COUNT: plc_api::MCode = plc_api::MCode::new(60, "count");
    async fn count(HandlerState(heard): HandlerState<Heard>) -> Result<(), Alarm> {
        note(&heard, "counted");
        Ok(())
    }
    let fake = FakePort::new([1]);
    let heard = Heard::default();
    let counter = SequenceProgram::new().state(Arc::clone(&heard)).on(COUNT, count);
    let program = with_task(&heard).merge(counter).handler_id("mill");
    serve(&fake, program).await;
    let outputs = [10, 60].map(|m| fake.issue_output(1, m, Params::default()));
    fake.settle().await;
    for seq in outputs {
        assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
    }
    assert_eq!(all(&heard).len(), 2, "{:?}", all(&heard));
    assert_eq!(fake.handlers().len(), 1);
}

#[test]
fn programs_that_contradict_each_other_are_not_merged() {
    let both = |one: SequenceProgram, other: SequenceProgram| one.merge(other).check().unwrap_err();
    let program = SequenceProgram::new;
    let handlers = both(program().on(8, ok), program().on(8, ok)).to_string();
    assert_eq!(handlers, "M8 has two handlers");
    let states = both(program().state(1_u8), program().state(2_u8)).to_string();
    assert_eq!(states, "merge() got a second state of type u8");
    let names = both(program().handler_id("a"), program().handler_id("b")).to_string();
    assert_eq!(names, "merge() got two program names, \"a\" and \"b\"");
    let mistakes = both(program(), program().on(30, ok)).to_string();
    assert!(mistakes.starts_with("M30:"), "{mistakes}");
}

#[tokio::test]
async fn of_two_answers_to_a_lost_output_a_merged_program_has_the_stricter() {
    let program = |how: Option<Redelivery>| {
        let program = SequenceProgram::new();
        match how {
            Some(how) => program.on_redelivery(how),
            None => program,
        }
    };
    let (redo, verify) = (Some(Redelivery::Redo), Some(Redelivery::Verify));
    for (one, other, merged) in [
        (redo, redo, redo),
        (redo, verify, verify),
        (redo, None, Some(Redelivery::Ask)),
        (None, None, None),
    ] {
        let fake = FakePort::new([1]);
        let both = program(one).merge(program(other)).on(10, ok).handler_id("both");
        serve(&fake, both).await;
        assert_eq!(fake.handlers()["both"].redelivery, merged, "{one:?} {other:?}");
    }
}

#[tokio::test]
async fn work_has_a_time_limit_on_the_machines_clock() {
    let fake = FakePort::new([1]);
    let plc = fake.plc();
    let task = tokio::spawn(async move {
        let done = plc.timeout(ms(200), plc.sleep(ms(100))).await;
        let late = plc.timeout(ms(200), plc.sleep(ms(300))).await;
        (done, late.unwrap_err().to_string(), plc.now_s())
    });
    fake.advance(ms(1000)).await;
    let (done, late, now_s) = task.await.unwrap();
    assert_eq!(done, Ok(()));
    assert_eq!(late, "the work was not finished within 200ms");
    assert!((now_s - 0.3).abs() < 1e-9, "{now_s}");
}

#[tokio::test]
async fn an_interval_leaves_out_what_it_has_missed_and_keeps_its_phase() {
    let fake = FakePort::new([1]);
    let plc = fake.plc();
    let task = tokio::spawn(async move {
        let (mut tick, mut at) = (plc.interval(ms(100)), Vec::new());
        for pause_ms in [0, 0, 250, 0] {
            tick.tick().await;
            at.push((plc.now_s() * 1e3).round());
            plc.sleep(ms(pause_ms)).await;
        }
        at
    });
    fake.advance(ms(1000)).await;
    assert_eq!(task.await.unwrap(), [0.0, 100.0, 200.0, 450.0]);
}

#[tokio::test]
async fn a_program_that_stops_with_nothing_open_ends_at_once() {
    let fake = FakePort::new([1]);
    let plc = fake.plc();
    let program = SequenceProgram::new().on(10, long);
    let ended = program.run_until(&plc, std::future::ready(())).await;
    assert_eq!(ended, Ok(()));
}

/// Returns a program whose M10 works for 10 s and registers two clean-ups; the second takes one second.
fn with_clean_up(heard: &Heard) -> SequenceProgram {
    let heard = Arc::clone(heard);
    SequenceProgram::new().on(10, move |output: AuxOutput, plc: Plc| {
        let (first, second, slow) = (Arc::clone(&heard), Arc::clone(&heard), plc.clone());
        output.on_cancel(ms(100), async move { note(&first, "valve shut") });
        output.on_cancel(ms(2000), async move {
            slow.sleep(ms(1000)).await;
            note(&second, format!("arm back at {:.0}", slow.now_s()));
        });
        async move {
            plc.sleep(ms(10_000)).await;
            Ok(())
        }
    })
}

#[tokio::test]
async fn what_a_cancelled_handler_wants_done_is_done_last_first() {
    let fake = FakePort::new([1]);
    let heard = Heard::default();
    serve(&fake, with_clean_up(&heard)).await;
    fake.issue_output(1, 10, Params::default());
    fake.advance(ms(4000)).await;
    fake.cancel(1, CancelReason::Stop);
    fake.settle().await;
    assert_eq!(all(&heard), [] as [&str; 0]);
    fake.advance(ms(1000)).await;
    assert_eq!(all(&heard), ["arm back at 5", "valve shut"]);
}

#[tokio::test]
async fn what_a_cancelled_handler_wants_done_is_not_done_when_it_returns() {
    let fake = FakePort::new([1]);
    let heard = Heard::default();
    serve(&fake, with_clean_up(&heard)).await;
    let seq = fake.issue_output(1, 10, Params::default());
    fake.advance(ms(20_000)).await;
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
    assert_eq!(all(&heard), [] as [&str; 0]);
}

#[tokio::test]
async fn clean_up_that_times_out_or_panics_is_cut_short_and_the_next_runs() {
    let fake = FakePort::new([1]);
    let heard = Heard::default();
    let noted = Arc::clone(&heard);
    let program = SequenceProgram::new().on(10, move |output: AuxOutput, plc: Plc| {
        let noted = Arc::clone(&noted);
        output.on_cancel(ms(100), async move { note(&noted, "valve shut") });
        output.on_cancel(ms(100), async { panic!("the arm is gone") });
        output.on_cancel(ms(100), std::future::pending());
        async move {
            plc.sleep(ms(10_000)).await;
            Ok(())
        }
    });
    serve(&fake, program).await;
    fake.issue_output(1, 10, Params::default());
    fake.settle().await;
    fake.cancel(1, CancelReason::Stop);
    fake.advance(ms(99)).await;
    assert_eq!(all(&heard), [] as [&str; 0]);
    fake.advance(ms(1)).await;
    assert_eq!(all(&heard), ["valve shut"]);
}
