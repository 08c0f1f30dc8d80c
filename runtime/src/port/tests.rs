//! Tests of the port on the demo machine in simulated time.

use plc_protocol::types::Timestamp;
use plc_protocol::types::command::{CommandReply, CommandStatus, Expect, Verb};
use plc_protocol::types::output::HandledCode;
use plc_protocol::types::output::HandlerPresence;
use plc_protocol::types::question::ValidateResult;
use plc_protocol::types::request::{Input, typed};
use plc_protocol::types::state::{LockSet, ProgramLocation};

use super::*;
mod absent_handler;
mod memory;
mod not_after;

use tandem_runtime::Config;
use tandem_testing::Bench;

fn start(command_id: &str) -> typed::Command {
    let meta = CommandMeta {
        command_id: command_id.into(),
        client_id: "test".into(),
        ..CommandMeta::default()
    };
    typed::Command {
        cs: 1,
        command: Command::Start,
        meta,
        wait: false,
    }
}

/// Runs a test on the demo machine in simulated time. A program that waits for 1000 s is loaded.
fn with_machine<T: Send + 'static>(test: impl AsyncFnOnce(Arc<dyn Port>) -> T + Send + 'static) -> T {
    let machine = Config::demo().resolve().unwrap();
    let bench = Bench::on_machine(machine).subprogram(50, "G04 X1000\nM30\n");
    bench
        .play(async move |_, runtime| {
            let port = runtime.port();
            let typed::Command { meta, .. } = start("load");
            let command = Command::Load { program: 50 };
            port.ask(typed::Command {
                cs: 1,
                command,
                meta,
                wait: true,
            })
            .await
            .unwrap();
            test(port).await
        })
        .unwrap()
}

fn status(answer: &Result<CommandReply, Refusal>) -> Option<CommandStatus> {
    answer.as_ref().ok().map(|reply| reply.status)
}

#[test]
fn a_command_that_comes_twice_at_once_is_carried_out_once() {
    with_machine(async move |port| {
        let both = futures_util::future::join(port.ask(start("s1")), port.ask(start("s1")));
        let (first, second) = both.await;
        assert_eq!(status(&first), Some(CommandStatus::Accepted));
        assert!(
            matches!(
                status(&second),
                Some(CommandStatus::Accepted | CommandStatus::Done)
            ),
            "{second:?}"
        );
        let other = port.ask(start("s2")).await;
        assert_eq!(other.unwrap_err().code, RefusalCode::NotAllowed);
    });
}

fn command(command: Command, command_id: &str, client_id: &str) -> typed::Command {
    typed::Command {
        cs: 1,
        command,
        meta: CommandMeta {
            command_id: command_id.into(),
            client_id: client_id.into(),
            ..CommandMeta::default()
        },
        wait: true,
    }
}

#[test]
fn an_id_of_another_command_is_refused_and_keeps_its_reply() {
    with_machine(async move |port| {
        port.ask(start("1")).await.unwrap();
        let mut replies = port.subscribe(Filter::Topics(vec![Topic::Reply("hmi".into())]));
        for other in [Command::Reset, Command::Load { program: 50 }] {
            let refusal = port.ask(command(other, "1", "hmi")).await.unwrap_err();
            assert_eq!(refusal.code, RefusalCode::CommandIdReused);
            assert!(
                refusal.text.contains("start of coordinate system 1"),
                "{}",
                refusal.text
            );
            let said = replies.try_next().map(|message| message.payload.clone());
            assert!(
                matches!(&said, Some(Payload::Reply(reply)) if reply.code == "command_id_reused" && reply.state_rev > 0),
                "{said:?}"
            );
        }
        let known = port.ask(typed::CommandStatus("1".into())).await;
        assert_eq!(status(&known), Some(CommandStatus::Done));
    });
}

/// Returns the state word of coordinate system 1.
async fn execution(port: &Arc<dyn Port>) -> Execution {
    let state = port.read(&Topic::cs(1, CsTopic::State)).await.unwrap();
    match &state.payload {
        Payload::State(state) => state.execution,
        other => panic!("{other:?}"),
    }
}

#[test]
fn what_was_commanded_before_a_stop_or_abort_does_not_move_behind_it() {
    for passing in [Command::Stop, Command::Abort] {
        with_machine(async move |port| {
            // a handler that never answers delays the load, and all commands after it
            let silent = HandlerPresence {
                online: true,
                handles: vec![HandledCode { cs: 1, m: 60 }],
                validates: true,
                ..HandlerPresence::default()
            };
            port.ask(typed::Handler("silent".into(), silent)).await.unwrap();
            let text = "M60 VA1\nM30\n".to_owned();
            port.ask(typed::WriteProgram(60, text)).await.unwrap();
            let stopped = async {
                port.sleep(Duration::from_millis(500)).await;
                let stopped = port.ask(command(passing.clone(), "4", "hmi")).await;
                let later = command(
                    Command::Mdi {
                        text: "G04 X1".into(),
                        is_macro: false,
                    },
                    "5",
                    "hmi",
                );
                (stopped, port.ask(later).await)
            };
            let (load, start, home, (stopped, later)) = futures_util::join!(
                port.ask(command(Command::Load { program: 60 }, "1", "hmi")),
                port.ask(command(Command::Start, "2", "hmi")),
                port.ask(command(Command::Home { axes: Vec::new() }, "3", "hmi")),
                stopped,
            );
            for done in [load, stopped, later] {
                assert_eq!(status(&done), Some(CommandStatus::Done), "{done:?}");
            }
            for refused in [start, home] {
                let refusal = refused.unwrap_err();
                assert_eq!(refusal.code, RefusalCode::NotAllowed, "{}", refusal.text);
                assert_eq!(refusal.state, Some(Execution::Ready));
            }
            assert_eq!(execution(&port).await, Execution::Ready);
        });
    }
}

#[test]
fn lock_refusal_contains_the_state_and_the_allowed_verbs() {
    with_machine(async move |port| {
        let interlock = LockSet::new(true, "the door is open");
        port.ask(typed::Input(1, Input::Interlock(interlock)))
            .await
            .unwrap();
        let refusal = port.ask(start("1")).await.unwrap_err();
        assert_eq!(refusal.code, RefusalCode::StartLocked);
        assert_eq!(refusal.state, Some(Execution::Ready));
        let moving: Vec<_> = refusal.allowed.iter().filter(|verb| verb.moves()).collect();
        assert!(moving.is_empty(), "{moving:?}");
        assert!(refusal.allowed.contains(&Verb::Load));
    });
}

#[test]
fn hold_and_stop_are_carried_out_whatever_their_id_was_used_for() {
    with_machine(async move |port| {
        let execution = || execution(&port);
        port.ask(start("1")).await.unwrap();
        port.ask(command(Command::Hold, "1", "test")).await.unwrap();
        assert_eq!(execution().await, Execution::FeedHold);
        port.ask(command(Command::Resume, "2", "test")).await.unwrap();
        // the first command of another client
        port.ask(command(Command::Hold, "1", "hmi")).await.unwrap();
        assert_eq!(execution().await, Execution::FeedHold);
        port.ask(command(Command::Stop, "1", "hmi")).await.unwrap();
        assert_eq!(execution().await, Execution::Stopped);
        // a repeated command is not executed again
        port.ask(command(Command::Load { program: 50 }, "3", "hmi"))
            .await
            .unwrap();
        port.ask(start("4")).await.unwrap();
        port.ask(command(Command::Stop, "1", "hmi")).await.unwrap();
        assert_eq!(execution().await, Execution::Active);
    });
}

#[test]
fn expired_or_foreign_boot_command_refused_and_reply_published() {
    with_machine(async move |port| {
        let typed::Command { mut meta, .. } = start("old");
        (meta.ttl_ms, meta.issued_at) = (Some(500), Some(Timestamp("1999-12-31T23:59:59Z".into())));
        let mut replies = port.subscribe(Filter::Topics(vec![Topic::Reply("test".into())]));
        let command = Command::Start;
        let late = typed::Command {
            cs: 1,
            command: command.clone(),
            meta,
            wait: false,
        };
        assert_eq!(port.ask(late).await.unwrap_err().code, RefusalCode::Expired);
        let said = replies.try_next().map(|message| message.payload.clone());
        assert!(matches!(said, Some(Payload::Reply(reply)) if reply.status == CommandStatus::Rejected));
        let typed::Command { mut meta, .. } = start("elsewhere");
        meta.expect = Some(Expect {
            boot_id: Some(BootId("another".into())),
            state_rev: None,
            ..Expect::default()
        });
        let other = typed::Command {
            cs: 1,
            command,
            meta,
            wait: false,
        };
        assert_eq!(
            port.ask(other).await.unwrap_err().code,
            RefusalCode::PreconditionFailed
        );
    });
}

#[test]
fn skip_input_requires_a_motor_of_an_axis() {
    with_machine(async move |port| {
        // skip inputs exist for axes; motor 4 of the demo is the spindle
        assert_eq!(port.ask(typed::SkipInput(3, true)).await, Ok(()));
        for motor in [4, 77] {
            let refusal = port.ask(typed::SkipInput(motor, true)).await.unwrap_err();
            assert_eq!(refusal.code, RefusalCode::NotFound, "{}", refusal.text);
        }
    });
}

#[test]
fn a_program_cannot_be_written_while_it_runs() {
    with_machine(async move |port| {
        port.ask(start("s1")).await.unwrap();
        let write = port.ask(typed::WriteProgram(50, "M30\n".into())).await;
        assert_eq!(write.unwrap_err().code, RefusalCode::ProgramRuns);
        assert!(port.ask(typed::WriteProgram(51, "M30\n".into())).await.is_ok());
    });
}

#[test]
fn program_is_not_said_to_run_while_the_axes_move_by_hand() {
    with_machine(async move |port| {
        let text = "G01 X100 F600".to_owned();
        let mdi = Command::Mdi {
            text,
            is_macro: false,
        };
        let moving = typed::Command {
            wait: false,
            ..command(mdi, "mdi", "hmi")
        };
        port.ask(moving).await.unwrap();
        let write = port.ask(typed::WriteProgram(50, "M30\n".into())).await;
        let refusal = write.unwrap_err();
        assert_eq!(refusal.code, RefusalCode::ProgramRuns);
        assert!(refusal.text.contains("moves by hand"), "{}", refusal.text);
    });
}

/// Answers the next validation of M60 as handler `picky`, after `before` has been done.
async fn answer_validation(
    port: &Arc<dyn Port>,
    asked: &mut Subscription,
    ok: bool,
    before: impl AsyncFnOnce(),
) {
    let asked = asked.next().await.unwrap();
    let Payload::Validate(validate) = &asked.payload else {
        panic!("{asked:?}");
    };
    before().await;
    let result = ValidateResult {
        request_id: validate.request_id.clone(),
        handler_id: "picky".into(),
        ok,
        text: None,
    };
    let answer = port.ask(typed::ValidateResult(1, Some(60), result)).await;
    assert_eq!(answer, Ok(()));
}

#[test]
fn handlers_validate_again_after_the_loaded_program_is_rewritten() {
    with_machine(async move |port| {
        let picky = HandlerPresence {
            online: true,
            handles: vec![HandledCode { cs: 1, m: 60 }],
            validates: true,
            ..HandlerPresence::default()
        };
        port.ask(typed::Handler("picky".into(), picky)).await.unwrap();
        let write = |force: u32| {
            let text = format!("M98 P1061\nM60 VA{force}\nM30\n");
            port.ask(typed::WriteProgram(60, text))
        };
        write(1).await.unwrap();
        let called = || port.ask(typed::WriteProgram(1061, "M99\n".to_owned()));
        called().await.unwrap();
        let load = || port.ask(command(Command::Load { program: 60 }, "0", "hmi"));
        let topic = Topic::cs(1, CsTopic::Validate(60));
        let mut asked = port.subscribe(Filter::Topics(vec![topic]));
        // the program is rewritten while the load waits for the answer, so the new text is validated again
        let twice = async {
            answer_validation(&port, &mut asked, true, async || {
                write(2).await.unwrap();
            })
            .await;
            answer_validation(&port, &mut asked, true, async || {}).await;
        };
        let (loaded, ()) = futures_util::join!(load(), twice);
        assert_eq!(status(&loaded), Some(CommandStatus::Done));

        write(9).await.unwrap();
        let (refused, ()) = futures_util::join!(
            port.ask(start("1")),
            answer_validation(&port, &mut asked, false, async || {})
        );
        assert_eq!(refused.unwrap_err().code, RefusalCode::ProgramHasErrors);
        assert_eq!(execution(&port).await, Execution::Ready);
        called().await.unwrap();
        let (started, ()) = futures_util::join!(
            port.ask(start("2")),
            answer_validation(&port, &mut asked, true, async || {})
        );
        assert_eq!(status(&started), Some(CommandStatus::Accepted));
        port.ask(command(Command::Stop, "3", "hmi")).await.unwrap();
        port.ask(command(Command::Reset, "4", "hmi")).await.unwrap();
        // the program was not rewritten, so no handler is asked and the command does not wait
        let begun_s = port.now_s();
        port.ask(start("5")).await.unwrap();
        assert!(port.now_s() - begun_s < 0.01);
    });
}

#[test]
fn program_position_is_the_head_of_the_program_after_load_and_reset() {
    with_machine(async move |port| {
        let place = async || {
            let message = port.read(&Topic::cs(1, CsTopic::Program)).await.unwrap();
            match &message.payload {
                Payload::Program(place) => place.clone(),
                other => panic!("{other:?}"),
            }
        };
        let head = |number| ProgramLocation {
            number: Some(number),
            ..ProgramLocation::default()
        };
        assert_eq!(place().await, head(50));
        port.ask(start("1")).await.unwrap();
        port.sleep(Duration::from_secs(1)).await;
        assert_eq!(place().await.line, 1);
        port.ask(command(Command::Stop, "2", "hmi")).await.unwrap();
        assert_eq!(place().await.line, 1, "where it was stopped");
        port.ask(command(Command::Reset, "3", "hmi")).await.unwrap();
        assert_eq!(place().await, head(50));
        port.ask(typed::WriteProgram(61, "M30\n".into())).await.unwrap();
        port.ask(command(Command::Load { program: 61 }, "4", "hmi"))
            .await
            .unwrap();
        assert_eq!(place().await, head(61));
    });
}

#[test]
fn program_position_published_at_most_5_times_a_second() {
    with_machine(async move |port| {
        let topics = vec![Topic::cs(1, CsTopic::State), Topic::cs(1, CsTopic::Program)];
        let text = "M03\nG04 X0.001\n".repeat(200) + "M30\n";
        port.ask(typed::WriteProgram(61, text)).await.unwrap();
        port.ask(command(Command::Load { program: 61 }, "1", "hmi"))
            .await
            .unwrap();
        let begun = std::time::Instant::now();
        let mut said = port.subscribe(Filter::Topics(topics));
        port.ask(start("2")).await.unwrap();
        let (mut states, mut places, mut is_completed) = (0, 0, false);
        while !is_completed {
            let message = said.next().await.unwrap();
            match &message.payload {
                Payload::State(state) => {
                    states += 1;
                    is_completed = state.execution == Execution::ProgramCompleted;
                }
                Payload::Program(_) => places += 1,
                other => panic!("{other:?}"),
            }
        }
        let most = 2 + begun.elapsed().as_millis() / 200;
        assert!(places <= most, "{places} of {most}, with {states} states");
        assert!(states > 100, "{states} states");
    });
}

#[test]
fn an_alarm_that_stands_is_not_raised_again_and_the_oldest_24_stand() {
    with_machine(async move |port| {
        let raise = |code: u16| {
            port.ask(typed::RaiseAlarm(AlarmRaise {
                cs: Some(1),
                code,
                text: format!("number {code}"),
            }))
        };
        for code in 0..30 {
            raise(code).await.unwrap();
            raise(code).await.unwrap();
        }
        let active = port.read(&Topic::AlarmActive).await.unwrap();
        let Payload::AlarmActive(active) = &active.payload else {
            panic!("{active:?}");
        };
        let numbers: Vec<_> = active.alarms.iter().map(|alarm| alarm.number).collect();
        assert_eq!(numbers, (10_000..10_024).collect::<Vec<_>>());
        let history = port.ask(typed::AlarmHistory).await.unwrap();
        let last = history.iter().map(|alarm| alarm.number).max();
        assert_eq!(last, Some(10_029));
        // alarms of another coordinate system stay active
        let other = AlarmRaise {
            cs: Some(2),
            code: 1,
            text: "other".into(),
        };
        port.ask(typed::RaiseAlarm(other)).await.unwrap();
        let state = port.read(&Topic::cs(2, CsTopic::State)).await.unwrap();
        assert!(matches!(&state.payload, Payload::State(state) if state.alarm_count == 1));
    });
}

#[test]
fn p10_source_of_a_handler_that_did_not_notice_its_loss_is_written_again() {
    let play = Bench::new().play(async |scene, runtime| {
        let plc = scene.plc().clone();
        scene.serve(plc_api::SequenceProgram::new().handler_id("door"));
        plc.sleep(Duration::from_millis(200)).await;
        let of_handler = runtime.port();
        let presence = of_handler.ask(typed::Handlers).await.unwrap()["door"].clone();
        let gone = HandlerPresence::offline(presence.instance.clone());
        scene
            .cs(1)
            .set_interlock_source("door", false, "closed")
            .await
            .unwrap();
        // as after a SIGSTOP: the machine has received the last will and the next presence before the handler reads
        // anything
        let port = runtime.port();
        port.ask(typed::Handler("door".into(), gone)).await.unwrap();
        port.ask(typed::Handler("door".into(), presence)).await.unwrap();
        plc.sleep(Duration::from_millis(500)).await;
        let message = port.read(&Topic::cs(1, CsTopic::Interlock)).await.unwrap();
        let Payload::Lock(lock) = &message.payload else {
            panic!("{message:?}");
        };
        let source = lock
            .sources
            .iter()
            .find(|source| source.source == "door")
            .unwrap();
        assert!(!source.lost && !source.value, "{source:?}");
    });
    play.unwrap();
}
