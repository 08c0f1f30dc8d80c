mod alarm_texts;
mod background_work;
mod clocks;
mod declared;
mod io;
mod returning;

use std::sync::Arc;
use std::time::{Duration, Instant};

use plc_api::{Alarm, AuxOutput, Plc, Redelivery};
use plc_protocol::types::state::Reason;

use super::*;

/// Waits for VA seconds.
async fn wait(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    let time_s = output.params().a().ok_or(Alarm::user(7, "VA is missing"))?;
    plc.sleep(Duration::from_secs_f64(time_s)).await;
    Ok(())
}

fn bench() -> Bench {
    Bench::new().serve(SequenceProgram::new().on(20..=29, wait))
}

#[test]
fn ten_minutes_of_a_handler_are_over_at_once_and_end_when_they_should() {
    let begun = Instant::now();
    let run = bench().run("M20 VA600\nM30").unwrap().completed().unwrap();
    let output = run.output(20).unwrap();
    assert!((output.took_s().unwrap() - 600.0).abs() < 0.0015, "{output:?}");
    assert_eq!((output.line, output.output_s), (1, 0.0));
    assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());
}

#[test]
fn a_run_repeats_exactly() {
    let run = || {
        let bench = bench()
            .beside(2, 20, "M21 VA0.7\nG00 X30\nM30")
            .at_s(0.5, |scene| async move {
                scene.cs(1).hold().await?;
                scene.plc().sleep(Duration::from_millis(333)).await;
                scene.cs(1).resume().await
            });
        bench
            .run("M03 S1000\nG01 X20 Y3 F1200\nM20 VA0.25\nM05\nM30")
            .unwrap()
            .completed()
            .unwrap()
    };
    let first = run();
    assert_eq!(first, run());
    assert!(first.time_s > 1.0 + 0.333);
}

/// Returns the demo machine with drives that follow their commands late.
fn lagging() -> Bench {
    let mut machine = Config::demo().resolve().unwrap();
    for system in &mut machine.coordinate_systems {
        system.programs.clear();
        for motor in system.settings.motors.iter_mut().flatten() {
            motor.lag_ms = 12.0;
        }
    }
    Bench::on_machine(machine)
}

#[test]
fn probing_tapping_holds_and_sleeping_handlers_repeat_exactly() {
    const TEXT: &str = "S1000 F6000 M03\nwhile (P1 < 5) {\nG01 X20 Z-5\nM20 VA0.5\nG01 X0 Z0\nG31 Z-20\nG01 Z0 F6000\n\
                        M21\nG84 X10 Z-10 R-5 F500 S500\nG80\nG01 X0 Z0 F6000\nM22 VA0.333\nG04 P30000\nP1 = P1 + 1\n}\nM30";
    let run = |bench: Bench| {
        let bench = bench
            .serve(
                SequenceProgram::new()
                    .on(20, wait)
                    .on([21, 22], async |output: AuxOutput, plc: Plc| {
                        output.progress("turns", 50.0).await?;
                        plc.sleep(Duration::from_micros(123_456)).await;
                        Ok(())
                    }),
            )
            .beside(2, 20, "G01 X30 F100\nM21\nG00 X0\nM30")
            .at_s(0.7, |scene| async move {
                scene.cs(1).hold().await?;
                scene.plc().sleep(Duration::from_millis(333)).await;
                scene.cs(1).resume().await
            })
            .at_line(6, |scene| async move {
                scene.plc().sleep(Duration::from_millis(40)).await;
                scene.plc().set_skip_input(3, true).await
            });
        bench.run(TEXT).unwrap().completed().unwrap()
    };
    for machine in [Bench::new, lagging] {
        let first = run(machine());
        assert_eq!(first, run(machine()));
        assert!(first.time_s > 150.0 && first.captured.len() == 5, "{first:?}");
        assert!(
            first.captured.iter().any(|of_block| of_block.captured[2]),
            "{:?}",
            first.captured
        );
    }
}

#[test]
fn what_happens_stands_in_order() {
    let run = bench().run("G90 G01 X1 F600\nM20 VA0.1\nM00\nX2\nM30");
    let run = run.unwrap();
    assert_eq!(run.stopped, RunEndReason::NothingMoves);
    assert_eq!(run.system(1).unwrap().execution, Execution::ProgramStopped);
    assert_eq!(
        run.order(1),
        ["block 1", "output M20 VA0.1", "reset M20", "stop M00"]
    );
    let error = run.completed().unwrap_err().to_string();
    assert!(
        error.contains("no further event is possible") && error.contains("ProgramStopped"),
        "{error}"
    );
}

#[test]
fn a_line_an_output_a_state_and_a_time_are_cues() {
    let seen = Arc::new(std::sync::Mutex::new(Vec::new()));
    let note = |what: &'static str| {
        let seen = Arc::clone(&seen);
        move |scene: Scene| async move {
            seen.lock().unwrap().push((what, scene.plc().now_s()));
            if what == "stopped" {
                scene.cs(1).resume().await?;
            }
            Ok(())
        }
    };
    let run = bench()
        .at_state(1, Execution::ProgramStopped, note("stopped"))
        .at_output(20, note("output"))
        .at_line(4, note("line"))
        .at_s(0.05, note("time"))
        .run("M20 VA0.1\nM00\nG90\nG01 X1 F600\nM30");
    run.unwrap().completed().unwrap();
    let seen = seen.lock().unwrap();
    let order: Vec<_> = seen.iter().map(|(what, _)| *what).collect();
    assert_eq!(order, ["output", "time", "stopped", "line"]);
    assert!((seen[1].1 - 0.05).abs() < 0.0015);
}

#[test]
fn handlers_that_die_leave_the_program_waiting_until_others_come() {
    let run = bench()
        .at_s(1.0, |scene| async move {
            scene.kill_handlers();
            scene
                .cs(1)
                .wait_for(|state| state.reason == Some(Reason::HandlerLost))
                .await?;
            scene.plc().sleep(Duration::from_secs(1)).await;
            let after = SequenceProgram::new().on_redelivery(Redelivery::Verify);
            scene.serve(after.on(20, async |output: AuxOutput| {
                assert!(output.redelivered());
                Ok(())
            }));
            Ok(())
        })
        .run("M20 VA600\nM30");
    let run = run.unwrap().completed().unwrap();
    // The handler is lost at 1 s, and the loss is reported after the grace time of 2 s.
    assert!((run.time_s - 4.0).abs() < 0.01, "{}", run.time_s);
    let words: Vec<_> = run
        .states
        .iter()
        .map(|change| (change.execution, change.reason))
        .collect();
    assert!(
        words.contains(&(Execution::Wait, Some(Reason::HandlerLost))),
        "{words:?}"
    );
}

#[test]
fn a_handler_that_waits_for_something_else_ends_the_run_and_is_named() {
    let lost = SequenceProgram::new().on(40, async |output: AuxOutput| {
        output.progress("looks for the key", None).await?;
        std::future::pending().await
    });
    let error = Bench::new()
        .serve(lost)
        .run("M40\nM30")
        .unwrap()
        .completed()
        .unwrap_err()
        .to_string();
    assert!(error.contains("waits for M40: looks for the key"), "{error}");
}

#[test]
fn a_handler_that_blocks_the_thread_is_reported() {
    let blocking = SequenceProgram::new().on(40, async |_output: AuxOutput| {
        std::thread::sleep(Duration::from_secs(6));
        Ok(())
    });
    let mut bench = Bench::new().serve(blocking);
    bench.standstill_max = Duration::from_secs(2);
    let error = bench.run("M40\nM30").unwrap_err().to_string();
    assert!(error.contains("blocks its thread"), "{error}");
}

#[test]
fn what_is_wrong_with_the_test_is_an_error_that_says_so() {
    let never = bench()
        .at_line(9, |_scene| async { Ok(()) })
        .run("M30")
        .unwrap_err();
    assert!(
        never.to_string().starts_with("at_line(9) never occurred"),
        "{never}"
    );
    let refused = bench().run("G01 X1Y2Z\nM30").unwrap_err();
    assert!(refused.to_string().contains("line 1: E0005"), "{refused}");
    let failed = bench()
        .at_s(0.0, |scene| async move { scene.cs(1).resume().await })
        .run("G04 P100\nM30");
    assert!(failed.unwrap_err().to_string().starts_with("at_s(0): "));
    let twice = Bench::new()
        .serve(SequenceProgram::new().on(5, wait).on(5, wait))
        .run("M30");
    assert!(twice.unwrap_err().to_string().contains("M5 has two handlers"));
}

#[test]
#[should_panic(expected = "the tool is 0")]
fn an_assertion_in_an_action_fails_the_test() {
    let _ = bench()
        .at_s(0.0, |scene| async move {
            let tool = scene.cs(1).tool().await?.id;
            assert_ne!(tool, 0, "the tool is 0");
            Ok(())
        })
        .run("G04 P100\nM30");
}

#[test]
fn files_are_run_with_what_stands_beside_them() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("part.nc"), "M98 P1000\nM30\n").unwrap();
    std::fs::write(folder.path().join("1000.nc"), "M20 VA1\nM99\n").unwrap();
    let run = bench()
        .run_file(folder.path().join("part.nc"))
        .unwrap()
        .completed()
        .unwrap();
    assert_eq!(run.output(20).unwrap().program, 1000);
}

#[test]
fn an_endless_program_ends_at_the_time_limit() {
    let run = bench()
        .max_time_s(3.0)
        .run("while (1 < 2) {\nG04 P500\n}\nM30")
        .unwrap();
    assert_eq!(run.stopped, RunEndReason::TimeLimit);
    assert!((run.time_s - 3.0).abs() < 0.0015, "{}", run.time_s);
}

/// Returns the pocket of the magazine that VA names; the magazine has 8 pockets.
fn pocket(params: &plc_api::Params) -> Result<f64, Alarm> {
    let pocket = params.a().ok_or(Alarm::user(1, "VA is missing"))?;
    if pocket > 8.0 {
        return Err(Alarm::user(2, format!("there is no pocket {pocket}")));
    }
    Ok(pocket)
}

#[test]
fn handlers_refuse_parameters_at_load_before_anything_moves() {
    let program = || SequenceProgram::new().on(20..=29, wait).validate(20..=29, pocket);
    let bench = || Bench::new().serve(program().handler_id("magazine"));
    let refused = bench()
        .subprogram(1000, "M21 VA9\nM99")
        .run("M20 VA3\nM98 P1000\nM22\nM30")
        .unwrap_err()
        .to_string();
    assert!(
        refused.contains("handlers refuse 2 M codes of program 1"),
        "{refused}"
    );
    assert!(refused.contains("line 3: E0190 M22: VA is missing"), "{refused}");
    let called = "line 1: E0190 in program 1000, which is called: M21: there is no pocket 9";
    assert!(refused.contains(called), "{refused}");
    // The value of a variable is known only when the block runs, so the machine loads this program.
    bench()
        .run("P3 = 2\nM20 VA[P3]\nM20 VA0.1\nM30")
        .unwrap()
        .completed()
        .unwrap();
}

#[test]
fn d12_a_load_asks_nothing_of_a_program_that_is_called_no_times() {
    let run = bench().subprogram(1001, "G02 X1\nM99");
    run.run("M98 P1001 L0\nM30").unwrap().completed().unwrap();
    let run = bench().subprogram(1001, "G02 X1\nM99").run("M98 P1001\nM30");
    assert!(run.is_err_and(|why| why.to_string().contains("in program 1001, which is called")));
}

#[test]
fn a_handler_that_does_not_answer_within_2_s_is_a_warning() {
    use plc_protocol::types::output::{HandledCode, HandlerPresence};
    use plc_protocol::types::request::Request;
    let run = bench()
        .at_s(0.0, |scene| async move {
            let handles = vec![HandledCode { cs: 1, m: 40 }];
            let presence = HandlerPresence {
                online: true,
                handles,
                validates: true,
                ..HandlerPresence::default()
            };
            scene
                .plc()
                .port()
                .request(Request::Handler("mute".into(), presence))
                .await?;
            let before_s = scene.plc().now_s();
            let mill = scene.cs(1);
            mill.stop().await?;
            mill.load(2).await?;
            let took_s = scene.plc().now_s() - before_s;
            assert!((2.0..2.01).contains(&took_s), "{took_s}");
            Ok(())
        })
        .subprogram(2, "M40 VA1\nM30")
        .run("G04 P100\nM30")
        .unwrap();
    let warning = &run.alarms[0];
    assert!(
        warning
            .text
            .contains("handler mute did not answer within 2 s whether it accepts M40 of line 1")
    );
    assert_eq!(run.system(1).unwrap().execution, Execution::Ready);
}

#[test]
fn a_question_is_shown_with_the_state_and_ends_with_a_stop() {
    let asks = SequenceProgram::new().on(40, async |output: AuxOutput| {
        let answer = output.ask("Is the door closed?", ["yes", "no"]).await?;
        if answer == "yes" {
            Ok(())
        } else {
            Err(Alarm::user(5, "the door is open"))
        }
    });
    let answered = |choice: &'static str| {
        Bench::new()
            .serve(asks.clone())
            .at_output(40, move |scene| async move {
                let mill = scene.cs(1);
                let asked = mill.question().await?;
                let shown = mill
                    .state()
                    .await?
                    .waiting_on
                    .and_then(|waiting| waiting.question);
                assert_eq!(shown.as_deref(), Some(&asked.question));
                scene.plc().sleep(Duration::from_secs(5)).await;
                mill.answer(&asked, choice).await
            })
    };
    let run = answered("yes").run("M40\nM30").unwrap().completed().unwrap();
    assert!((run.output(40).unwrap().took_s().unwrap() - 5.0).abs() < 0.0015);
    assert_eq!(
        answered("no").run("M40\nM30").unwrap().alarm().unwrap().text,
        "the door is open"
    );
    let stopped = Bench::new().serve(asks).at_s(1.0, |scene| async move {
        let mill = scene.cs(1);
        let asked = mill.question().await?;
        mill.stop().await?;
        assert_eq!(mill.questions().await?, []);
        assert!(mill.answer(&asked, "yes").await.is_err());
        Ok(())
    });
    let run = stopped.run("M40\nM30").unwrap();
    assert_eq!(
        run.output(40).unwrap().ended,
        OutputEnd::Cancelled(plc_api::CancelReason::Stop)
    );
}

#[test]
fn a_scan_program_serves_a_whole_runtime() {
    use plc_api::scan::Image;
    let program = SequenceProgram::new().scan(40, Duration::from_millis(10), |image: &mut Image| {
        if image.output(1, 40).is_some() && image.time_s() >= 3.0 {
            image.reset(1, 40);
        }
    });
    let run = Bench::new()
        .serve(program)
        .run("M40\nM30")
        .unwrap()
        .completed()
        .unwrap();
    let took_s = run.output(40).unwrap().took_s().unwrap();
    assert!((3.0..3.0115).contains(&took_s), "{took_s}");
}

#[test]
fn a_run_tells_variables_and_where_the_machine_was_when() {
    let run = bench()
        .trace_every_s(0.01)
        .run("P100=2.5 Q7=P100*2\nG90 G01 X10 F600\nM20 VA1\nX0\nM30")
        .unwrap()
        .completed()
        .unwrap();
    let variables = [run.p(100), run.q(1, 7), run.q(2, 7)].map(f64::to_bits);
    assert_eq!(variables, [2.5, 5.0, 0.0].map(f64::to_bits));
    // X moves 10 mm at 10 mm/s. Half of the distance takes half of the time, because the ramps are symmetric.
    let output = run.output(20).unwrap();
    let half = run.at_s(1, output.output_s / 2.0).unwrap();
    assert!((half.machine["X"] - 5.0).abs() < 0.11, "{half:?}");
    assert_eq!(half.block, Some((1, 2)));
    let waiting = run.at_s(1, output.output_s + 0.5).unwrap();
    assert!((waiting.machine["X"] - 10.0).abs() < 1e-9, "{waiting:?}");
    assert_eq!(run.trace(2).len(), run.trace(1).len());
    let times: Vec<f64> = run.trace(1).iter().map(|sample| sample.at_s).collect();
    assert!(
        times.windows(2).all(|two| (two[1] - two[0] - 0.01).abs() < 1e-6),
        "{times:?}"
    );
    assert!(times.len() as f64 > run.time_s / 0.01 - 2.0);
}

#[test]
fn position_without_a_trace_is_an_error_naming_trace_every_s() {
    let run = bench().run("M30").unwrap();
    assert!(run.trace(1).is_empty());
    assert!(
        run.at_s(1, 0.0)
            .unwrap_err()
            .to_string()
            .contains("trace_every_s")
    );
}

#[test]
fn interlock_single_block_and_skip_inputs_are_scripted() {
    let run = bench()
        .at_line(2, |scene| async move {
            scene.plc().set_skip_input(1, true).await?;
            scene.cs(1).set_single_block(true).await
        })
        .at_state(1, Execution::Interrupted, |scene| async move {
            let mill = scene.cs(1);
            mill.set_single_block(false).await?;
            mill.set_interlock(true, "the door is open").await?;
            assert!(mill.resume().await.is_err());
            mill.set_interlock(false, "").await?;
            mill.resume().await
        })
        .run("G91\nG01 X5 F600\nG31 X5\nG01 X1\nM30")
        .unwrap()
        .completed()
        .unwrap();
    // The skip input of X is on before the G31 begins.
    assert!(run.captured[0].captured[0], "{:?}", run.captured);
}

#[test]
fn a_sequence_program_that_the_machine_refuses_fails_the_test() {
    let program = |m| SequenceProgram::new().on(m, wait).handler_id("magazine");
    for text in ["M20 VA10\nM30", "M30"] {
        let refused = Bench::new().serve(program(20)).serve(program(21)).run(text);
        let said = refused.unwrap_err().to_string();
        assert!(
            said.contains("sequence program magazine is refused"),
            "{text}: {said}"
        );
        assert!(said.contains("is in use by"), "{text}: {said}");
    }
}
