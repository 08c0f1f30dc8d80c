//! Tests that tokio's clock is the clock of the machine.

use std::time::Duration;

use plc_api::{Alarm, AuxOutput, Plc, SequenceProgram};
use tokio::time::{Instant, MissedTickBehavior};

use super::super::{Bench, Config, Run, RunEndReason, TestError};

const SECONDS_100: Duration = Duration::from_secs(100);

fn took_s(run: &Run) -> f64 {
    run.output(20).unwrap().took_s().unwrap()
}

#[test]
fn a_timeout_of_tokio_comes_at_its_simulated_time() {
    let program = SequenceProgram::new().on(20, async |_output: AuxOutput, plc: Plc| {
        let limit = Duration::from_secs(2);
        let done = tokio::time::timeout(limit, plc.sleep(SECONDS_100)).await;
        done.map_err(|_| Alarm::user(1, "too late"))
    });
    let run = Bench::new().serve(program).run("M20\nM30").unwrap();
    assert_eq!(run.alarm().unwrap().text, "too late");
    assert!((run.time_s - 2.0).abs() < 0.01, "{}", run.time_s);
}

#[test]
fn a_sleep_of_tokio_takes_its_simulated_time_and_its_instants_tell_it() {
    let program = SequenceProgram::new().on(20, async |_output: AuxOutput, plc: Plc| {
        let (begun, begun_s) = (Instant::now(), plc.now_s());
        tokio::time::sleep(SECONDS_100).await;
        plc.sleep(SECONDS_100).await;
        let both_s = [begun.elapsed().as_secs_f64(), plc.now_s() - begun_s];
        let are_right = both_s.iter().all(|took_s| (took_s - 200.0).abs() < 0.002);
        are_right
            .then_some(())
            .ok_or(Alarm::user(1, format!("{both_s:?}")))
    });
    let run = Bench::new()
        .serve(program)
        .run("M20\nM30")
        .unwrap()
        .completed()
        .unwrap();
    assert!((took_s(&run) - 200.0).abs() < 0.002);
}

#[test]
fn tasks_plants_and_actions_have_tokios_clock_too() {
    let program = SequenceProgram::new()
        .task(async |plc: Plc| {
            tokio::time::sleep(Duration::from_secs(3)).await;
            plc.coordinate_system(1).hold().await
        })
        .on(20, async |_output: AuxOutput| Ok(()));
    let run = Bench::new()
        .serve(program)
        .plant(async |scene| {
            tokio::time::sleep(Duration::from_secs(5)).await;
            scene.cs(1).resume().await
        })
        .at_s(6.0, async |scene| {
            tokio::time::sleep(Duration::from_secs(1)).await;
            scene.cs(1).hold().await?;
            tokio::time::sleep(Duration::from_secs(1)).await;
            scene.cs(1).resume().await
        })
        .run("G04 X10\nM20\nM30")
        .unwrap()
        .completed()
        .unwrap();
    // The time consists of a dwell of 10 s and two holds of 2 s and 1 s.
    assert!((run.time_s - 13.0).abs() < 0.02, "{}", run.time_s);
}

/// Returns the position of X when this time has passed on tokio's clock. X moves along 100 mm at 10 mm/s.
fn x_at(lag_ms: f64, servo_period_us: u64, at: Duration) -> f64 {
    let mut config = Config::demo();
    config.machine.servo_period_us = servo_period_us;
    for motor in &mut config.motor {
        motor.lag_ms = lag_ms;
    }
    let bench = Bench::on_machine(config.resolve().unwrap()).subprogram(1, "G90 G01 X100 F600\nM30");
    bench
        .play(async move |scene, _runtime| {
            scene.cs(1).load(1).await.unwrap();
            scene.cs(1).start().await.unwrap();
            tokio::time::sleep(at).await;
            scene.cs(1).position().await.unwrap().machine["X"]
        })
        .unwrap()
}

#[test]
fn a_timer_in_the_middle_of_a_motion_finds_the_machine_there() {
    for (lag_ms, servo_period_us) in [(0.0, 1000), (0.0, 4000), (0.0, 250), (5.0, 1000)] {
        let (at_2_s, at_5_s) = (
            x_at(lag_ms, servo_period_us, Duration::from_secs(2)),
            x_at(lag_ms, servo_period_us, Duration::from_secs(5)),
        );
        // Between the ramps X moves 10 mm per second; the tolerance is the distance in one servo cycle.
        let tolerance = 10.0 * (servo_period_us as f64 / 1e6 + 0.001);
        let way = at_5_s - at_2_s;
        assert!(
            (way - 30.0).abs() <= tolerance,
            "{lag_ms} {servo_period_us}: {way}"
        );
        assert!(
            at_2_s < 20.0 && at_2_s > 19.0,
            "{lag_ms} {servo_period_us}: {at_2_s}"
        );
    }
}

/// Every servo period of this table is in the range of `servo_period_us`, 125 to 10000.
const PERIODS_US: [u64; 9] = [125, 250, 400, 500, 750, 999, 1000, 4000, 10_000];

#[test]
fn sleeping_code_runs_at_every_servo_period() {
    let run = |servo_period_us: u64| {
        let mut config = Config::demo();
        config.machine.servo_period_us = servo_period_us;
        let program = SequenceProgram::new()
            .task(async |plc: Plc| {
                plc.sleep(Duration::from_millis(70)).await;
                tokio::time::sleep(Duration::from_millis(30)).await;
                plc.coordinate_system(1).hold().await
            })
            .on(20, async |_output: AuxOutput, plc: Plc| {
                plc.sleep(Duration::from_millis(100)).await;
                Ok(())
            });
        Bench::on_machine(config.resolve().unwrap())
            .serve(program)
            .plant(async |scene| {
                scene.plc().sleep(Duration::from_millis(300)).await;
                scene.cs(1).resume().await
            })
            .at_s(0.6, async |scene| {
                scene.plc().sleep(Duration::from_millis(10)).await;
                scene.cs(1).hold().await?;
                tokio::time::sleep(Duration::from_millis(50)).await;
                scene.cs(1).resume().await
            })
            .run("G91 G01 X5 F600\nM20\nG01 X5\nM30")
            .unwrap()
            .completed()
            .unwrap()
    };
    let expected_s = run(1000).time_s;
    for servo_period_us in PERIODS_US {
        let run = run(servo_period_us);
        let off_s = run.time_s - expected_s;
        // Each of some ten events waits for the next cycle, or for the next millisecond of tokio's clock.
        let tolerance_s = 10.0 * (servo_period_us as f64 / 1e6 + 0.001);
        assert!(off_s.abs() < tolerance_s, "{servo_period_us}: {off_s} s");
        let took_s = took_s(&run);
        assert!(
            (took_s - 0.1).abs() < 2e-3 + servo_period_us as f64 / 1e6,
            "{servo_period_us}: {took_s}"
        );
    }
}

#[test]
fn equal_tests_with_both_clocks_are_equal() {
    let run = || {
        let program = SequenceProgram::new()
            .task(async |plc: Plc| {
                let mut tick = tokio::time::interval(Duration::from_millis(70));
                tick.set_missed_tick_behavior(MissedTickBehavior::Skip);
                loop {
                    tick.tick().await;
                    plc.sleep(Duration::from_millis(13)).await;
                }
            })
            .on(20, async |_output: AuxOutput, plc: Plc| {
                let _either =
                    tokio::time::timeout(Duration::from_millis(130), plc.sleep(Duration::from_millis(130)))
                        .await;
                Ok(())
            });
        let run = Bench::new().serve(program).trace_every_s(0.01);
        let run = run.run("G90 G01 X10 F6000\nM20\nG01 X0\nM20\nM30").unwrap();
        format!("{:?}", run.completed().unwrap())
    };
    assert_eq!(run(), run());
}

#[test]
fn endless_ticking_task_prevents_neither_the_end_nor_the_time_limit() {
    let bench = || {
        let program = SequenceProgram::new()
            .task(async |_plc: Plc| {
                let mut tick = tokio::time::interval(Duration::from_millis(10));
                loop {
                    tick.tick().await;
                }
            })
            .on(20, async |_output: AuxOutput| std::future::pending().await);
        Bench::new().serve(program)
    };
    let ended = bench().run("G04 X1\nM30").unwrap().completed().unwrap();
    assert!((ended.time_s - 1.0).abs() < 0.01, "{}", ended.time_s);
    let waits = bench().max_time_s(60.0).run("M20\nM30").unwrap();
    assert_eq!(waits.stopped, RunEndReason::TimeLimit);
}

/// Runs M40 with a handler that calls `work` immediately.
fn run_with(work: fn()) -> Result<Run, TestError> {
    let handler = move |_output: AuxOutput| async move {
        work();
        Ok::<(), Alarm>(())
    };
    Bench::new()
        .serve(SequenceProgram::new().on(40, handler))
        .run("M40\nM30")
}

/// Linux only: other systems do not distinguish a sleep from a busy computer.
#[cfg(target_os = "linux")]
#[test]
fn handler_blocking_in_real_time_ends_the_run_with_advice() {
    let error = run_with(|| std::thread::sleep(Duration::from_millis(600))).unwrap_err();
    let text = error.to_string();
    for word in [
        "a sequence program was blocked for 0.6 s",
        "std::thread::sleep",
        "plc.sleep(..).await",
    ] {
        assert!(text.contains(word), "{text}");
    }
}

#[test]
fn a_handler_that_computes_for_long_does_not_stand_still() {
    let run = run_with(|| {
        let begun = std::time::Instant::now();
        while begun.elapsed() < Duration::from_millis(600) {
            std::hint::spin_loop();
        }
    });
    run.unwrap().completed().unwrap();
}

#[test]
fn a_run_is_the_same_whether_or_not_the_clock_of_tokio_goes_along() {
    let texts = [
        "G64 G01 X20 F1200\nY3\nX0\nG04 P1500\nG61 Y0\nX5\nM30",
        "G01 X20 F1200\nM20\nM30",
        "G01 X20 F1200\nG04 P60000\nM30",
        "G01 X20 F1200\nM00\nM30",
    ];
    for text in texts {
        let run = |bench: Bench| {
            let beside = bench.beside(2, 20, "G00 X30\nG01 Z5 F300\nM30").max_time_s(30.0);
            beside.run(text).unwrap()
        };
        let along = run(Bench::new().plant(|_| async { Ok(()) }));
        assert_eq!(run(Bench::new()), along, "{text}");
    }
}
