//! Tests of work that runs concurrently with a test.

use std::sync::atomic::{AtomicU32, Ordering};

use tokio::sync::watch;

use super::*;

/// Returns a sequence program with a task that never ends and counts its cycles in `ticks`.
fn endless(ticks: &Arc<AtomicU32>) -> SequenceProgram {
    let ticks = Arc::clone(ticks);
    SequenceProgram::new().on(20, wait).task(move |plc| {
        let ticks = Arc::clone(&ticks);
        async move {
            let mut tick = plc.interval(Duration::from_millis(100));
            loop {
                tick.tick().await;
                ticks.fetch_add(1, Ordering::Relaxed);
            }
        }
    })
}

#[test]
fn a_task_that_never_ends_runs_in_simulated_time_and_is_not_waited_for() {
    let ticks = Arc::default();
    let run = Bench::new()
        .serve(endless(&ticks))
        .run("M20 VA10\nM30")
        .unwrap()
        .completed()
        .unwrap();
    assert!((run.time_s - 10.0).abs() < 0.1, "{}", run.time_s);
    let ticks = ticks.load(Ordering::Relaxed);
    assert!((100..=102).contains(&ticks), "{ticks}");
}

#[test]
fn a_run_that_waits_for_ever_beside_a_task_ends_at_its_time_limit() {
    let program = endless(&Arc::default()).on(21, async |_output: AuxOutput| std::future::pending().await);
    let run = Bench::new()
        .serve(program)
        .max_time_s(60.0)
        .run("M21\nM30")
        .unwrap();
    assert_eq!(run.stopped, RunEndReason::TimeLimit);
}

#[test]
fn a_plant_runs_beside_the_handlers_and_is_not_waited_for() {
    let (valve, opened) = watch::channel(false);
    let (switch, is_on) = watch::channel(false);
    let program = SequenceProgram::new().on(20, move |_output: AuxOutput| {
        let mut is_on = is_on.clone();
        valve.send_replace(true);
        async move {
            let closed = is_on.wait_for(|is_on| *is_on).await.map(|_| ());
            closed.map_err(|_| Alarm::user(1, "the switch has gone"))
        }
    });
    let run = Bench::new()
        .serve(program)
        .plant(|scene| async move {
            let mut opened = opened;
            while opened.changed().await.is_ok() {
                scene.plc().sleep(Duration::from_secs(2)).await;
                switch.send_replace(true);
            }
            std::future::pending().await
        })
        .run("M20\nM30")
        .unwrap()
        .completed()
        .unwrap();
    assert!((run.output(20).unwrap().took_s().unwrap() - 2.0).abs() < 0.01);
}

#[test]
fn an_error_of_a_plant_or_a_task_is_that_of_the_test() {
    let plant = Bench::new().plant(|scene| async move { scene.cs(9).stop().await });
    let error = plant.run("G04 X100\nM30").unwrap_err().to_string();
    assert!(error.starts_with("a plant ended: "), "{error}");
    let task = SequenceProgram::new().task(async |plc: Plc| plc.coordinate_system(9).stop().await);
    let error = Bench::new()
        .serve(task)
        .run("G04 X100\nM30")
        .unwrap_err()
        .to_string();
    assert!(
        error.starts_with("a sequence program ended: a task has failed: "),
        "{error}"
    );
}

#[test]
#[should_panic(expected = "the model knows no such valve")]
fn a_panic_of_a_plant_is_that_of_the_test() {
    let bench = Bench::new().plant(async |_scene| panic!("the model knows no such valve"));
    let _panics = bench.run("G04 X100\nM30");
}

/// Returns the error of a run; the error text contains the remedy.
fn foreign(bench: Bench) -> String {
    let error = bench.run("M20\nG04 X1\nM30").unwrap_err().to_string();
    assert!(error.contains("Bench::plant"), "{error}");
    error
}

#[test]
fn a_socket_ends_the_test_wherever_it_is_used() {
    async fn connects() {
        let _panics = tokio::net::TcpStream::connect("127.0.0.1:9").await;
    }
    let program = SequenceProgram::new().on(20, async |_output: AuxOutput| {
        connects().await;
        Ok(())
    });
    let error = foreign(Bench::new().serve(program));
    assert!(error.starts_with("the handler of M20 used a socket"), "{error}");
    let task = SequenceProgram::new().task(async |_plc| {
        connects().await;
        Ok(())
    });
    foreign(bench().serve(task));
    foreign(bench().plant(async |_scene| {
        connects().await;
        Ok(())
    }));
    foreign(bench().at_s(0.0, async |_scene| {
        connects().await;
        Ok(())
    }));
}

#[test]
fn work_on_another_thread_fails_the_test_with_the_reason() {
    let program = SequenceProgram::new().on(20, async |_output: AuxOutput| {
        let computed = tokio::task::spawn_blocking(|| 1).await;
        computed.map(|_| ()).map_err(|_| Alarm::user(1, "it has gone"))
    });
    let error = foreign(Bench::new().serve(program));
    assert!(error.starts_with("some work runs on another thread"), "{error}");
}

#[test]
fn errors_of_a_stuck_handler_recommend_plc_sleep() {
    let program = SequenceProgram::new().on(20, async |_output: AuxOutput| std::future::pending().await);
    let run = Bench::new().serve(program).run("M20\nM30").unwrap();
    let (alarm, output) = (run.alarm().unwrap_err(), run.output(21).unwrap_err());
    for error in [alarm, output, run.completed().unwrap_err()] {
        let error = error.to_string();
        assert!(error.contains("must sleep by plc.sleep"), "{error}");
    }
}
