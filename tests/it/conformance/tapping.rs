//! Tapping, G74 and G84: levels, times, M codes, and the spindle in phase with Z (M1, D42).

use std::sync::{Arc, Mutex};
use std::time::Duration;

use plc_api::{Execution, Plc};
use plc_protocol::types::request::Request;
use plc_protocol::types::state::Transition;
use tandem_testing::Bench;

use crate::support::formula::{Block, LATE_S, assert_samples};
use crate::support::machine::{COORDINATE_SYSTEMS, MOTORS, Machine};
use crate::support::simulated::{Simulated, simulate, simulate_on};

const Z: usize = 2;

/// The manual's first example in G90 and G91, with words of ours: three holes, a dwell of 0.2 s.
const ABSOLUTE: &str = "G90 F100 S300\nG99 G84 X10 Y0 Z-10 R-5 P200\nG99 X20\nG98 X30\nG80\nG00 X40\nM30\n";
const INCREMENTAL: &str =
    "G91 F100 S300\nG99 G84 X10 Y0 Z-10 R-5 P200\nG99 X10\nG98 X10\nG80\nG00 X10\nM30\n";

/// One pass in the thread at F100 with the default ramps; 300 r/min need 0.1 s at 3000 r/min per second, like
/// ta.
fn way(length: f64) -> Block {
    Block::new(length, 100.0 / 60.0, 0.1, 0.1, 0.05)
}

/// Z of a line, from the last sample before it moves below `level` on.
fn below(run: &Simulated, line: u32, level: f64) -> Vec<f64> {
    let of_line = run.trace.iter().filter(|row| row.line == line);
    let positions: Vec<f64> = of_line.map(|row| row.axes[Z]).collect();
    let first = positions.iter().position(|z| *z < level).expect("a thread");
    positions[first - 1..].to_vec()
}

#[test]
fn m1h_the_way_in_the_dwell_and_the_way_out_follow_their_formulas() {
    let run = simulate(ABSOLUTE).completed();
    let way = way(5.0);
    assert!((way.end_s - 3.15).abs() < 1e-12);
    for line in [2, 3, 4] {
        let z = below(&run, line, -5.0);
        // 3.15 s of the formula
        let in_samples = 3150;
        assert_samples(&z[..=in_samples], -5.0, -1.0, way.end_s, |t| way.way(t));
        let rest = z.iter().skip(in_samples).take_while(|z| **z == -10.0).count();
        // the dwell, and at most 3 periods each for the beginning of the dwell and of the retract
        assert!((200..=207).contains(&rest), "{rest} samples at the Z point");
        let out = &z[in_samples + rest - 1..];
        assert_samples(&out[..=in_samples], -10.0, 1.0, way.end_s, |t| way.way(t));
    }
}

#[test]
fn d42_all_holes_have_the_levels_of_the_manuals_figures() {
    for (program, depth) in [(ABSOLUTE, -10.0), (INCREMENTAL, -15.0)] {
        let run = simulate(program).completed();
        assert_eq!((run.machine("X"), run.machine("Z")), (40.0, 0.0));
        let lowest = |line: u32| {
            let of_line = run.trace.iter().filter(|row| row.line == line);
            of_line.map(|row| row.axes[Z]).fold(0.0, f64::min)
        };
        assert_eq!([lowest(2), lowest(3), lowest(4)], [depth; 3]);
        let last = |line: u32| {
            run.trace
                .iter()
                .rfind(|row| row.line == line)
                .map(|row| row.axes[Z])
        };
        // G99, G99, G98
        assert_eq!([last(2), last(3), last(4)], [Some(-5.0), Some(-5.0), Some(0.0)]);
        let codes = run.story(&["output"]);
        assert_eq!(codes, ["output 19", "output 5"].repeat(3));
    }
}

#[test]
fn d42_a_hole_takes_both_ways_and_the_dwell_between_m19_and_m05() {
    let run = simulate("F100 S300\nG99 G84 Z-10 R0 P500 K2\nG80\nM30\n").completed();
    let took_s = run.at_s("output", "m", 5) - run.at_s("reset", "m", 19);
    let expected_s = 2.0 * (2.0 * way(10.0).end_s + 0.5);
    assert!(
        (expected_s..expected_s + 6.0 * LATE_S).contains(&took_s),
        "{took_s} s are not {expected_s} s"
    );
}

#[test]
fn d42_levels_count_in_work_coordinates() {
    // G54 has Z30: the cycle begins at machine Z0, which is work Z-30
    let run = simulate("G54 F1000 S300\nG98 G84 X5 Z-40 R-35\nG80\nM30\n").completed();
    let depth = run.trace.iter().map(|row| row.axes[Z]).fold(0.0, f64::min);
    assert_eq!(depth, -10.0);
    assert_eq!((run.machine("Z"), run.work("Z")), (0.0, -30.0));
}

#[test]
fn d42_a_cycle_orients_a_spindle_that_turns_by_m03_and_taps() {
    let run = simulate("F100 S300 M03\nG99 G84 Z-10 R0\nG80\nM30\n").completed();
    assert_eq!(run.story(&["output"]), ["output 3", "output 19", "output 5"]);
    let depth = run.trace.iter().map(|row| row.axes[Z]).fold(0.0, f64::min);
    assert_eq!(depth, -10.0);
}

/// One axis, Z, and no spindle; M03, M04 and M19 are reset at once.
fn without_spindle() -> Machine {
    let auto_reset = [3, 4, 19].map(|m| format!("[m_code.{m}]\nunhandled = \"auto_reset\"\n"));
    Machine::with_config(&format!(
        "[machine]\nname = \"test-1\"\n\n[[motor]]\nnumber = 1\nkind = \"linear\"\nmax_velocity = 500.0\n\
         max_acceleration = 5000.0\n\n[[coordinate_system]]\nnumber = 1\naxes = {{ Z = 1 }}\n\n{}",
        auto_reset.concat()
    ))
}

#[test]
fn d42_without_a_spindle_m_codes_turn_it_between_the_ways() {
    let machine = without_spindle();
    let run = simulate_on(&machine, "F100 S300\nG98 G74 Z-10 R-5 P100\nG80\nM30\n", &[]).completed();
    let kinds = ["output", "block"];
    // A cycle is one block, whatever it moves.
    let expected = ["block 2", "output 19", "output 4", "output 3", "output 4"];
    assert_eq!(run.story(&kinds), expected);
    // Oriented at R and turned in one direction, in the other direction at Z, and back at R.
    assert_eq!(run.at_outputs(0), [-5.0, -5.0, -10.0, -5.0]);
    assert_eq!(run.machine("Z"), 0.0);
}

#[test]
fn m1h_without_spindle_f_above_maximum_is_an_alarm_before_the_motion() {
    // max_feedrate is 10,000 by default.
    let run = simulate_on(&without_spindle(), "S300\nF10001\nG74 Z-10 R-5\nG80\nM30\n", &[]);
    assert_eq!((run.alarm(), &run.json["alarm"]["line"]), (11, &3.into()));
    assert!(run.trace.iter().all(|row| row.axes == [0.0]));
    assert_eq!(run.events("output").len(), 0);
}

#[test]
fn m1h_impossible_tap_is_an_alarm_before_motion_s_above_max_refused() {
    let third = "number = 3\nkind = \"linear\"\n";
    let motors = MOTORS.replace(third, &format!("{third}soft_limits = [-50.0, 50.0]\n"));
    let config = format!("[machine]\nname = \"test-1\"\n{motors}{COORDINATE_SYSTEMS}");
    let machine = Machine::with_config(&config);
    for (before, cycle, alarm) in [
        ("F100", "G84 X10 Z-10 R-5", 113),
        ("F100", "S0 G74 X10 Z-10 R-5", 113),
        // F is missing.
        ("S300", "G84 X10 Z-10 R-5", 101),
        // The Z point is beyond the soft limit; so is the R point.
        ("F100 S300", "G84 X10 Z-51 R-5", 102),
        ("F100 S300", "G91 G99 G74 X10 Z-10 R51 K2", 102),
    ] {
        let run = simulate_on(&machine, &format!("{before}\n{cycle}\nG80\nM30\n"), &[]);
        assert_eq!(run.alarm(), alarm);
        // At the block, before any of its motion and before M19.
        assert_eq!(run.json["alarm"]["line"], 2);
        assert!(run.trace.iter().all(|row| row.axes == [0.0; 3]), "{cycle} moves");
        assert_eq!(run.events("output").len(), 0);
    }
    let run = simulate("F100 S3000.1\nG84 Z-10 R-5\nG80\nM30\n");
    assert_eq!(run.json["outcome"], "errors", "{}", run.json);
    let run = simulate("F100\nL0 = 3001\nS[L0]\nG84 Z-10 R-5\nG80\nM30\n");
    assert_eq!(run.alarm(), 11);
    assert!(run.trace.iter().all(|row| row.axes[Z] == 0.0));
}

#[test]
fn m1h_holes_beyond_a_soft_limit_are_an_alarm_before_the_first_is_tapped() {
    // X is limited to -100 to 300: the second hole in G91 is outside, the third of G90 is the first; the
    // initial level to which G98 returns is within the limits, because the tool is already there
    for (cycle, column) in [
        ("G91 G84 X200 Z-10 R-5 K2", Some(9)),
        ("G91 G99 G84 Z-10 R-5 Y1 X-50 K3", Some(25)),
        ("G90 G84 X301 Z-10 R-5", Some(9)),
        ("G91 G84 X100 Z-10 R-5 K3", None),
        ("G90 G84 X300 Z-10 R-5 K3", None),
    ] {
        let run = simulate(&format!("F6000 S3000\n{cycle}\nG80\nM30\n"));
        let Some(column) = column else {
            run.completed();
            continue;
        };
        assert_eq!(run.alarm(), 102);
        let alarm = &run.json["alarm"];
        assert_eq!(
            (&alarm["line"], &alarm["column"]),
            (&2.into(), &column.into()),
            "{alarm}"
        );
        assert!(run.trace.iter().all(|row| row.axes == [0.0; 3]), "{cycle} moves");
        assert_eq!(run.events("output").len(), 0);
    }
}

fn with_spindle() -> Machine {
    Machine::new("")
}

/// Z and the spindle's angle of each servo cycle.
type Samples = Arc<Mutex<Vec<(f64, f64)>>>;

/// Runs a program on a machine; `during` is called when the tool is below a level.
fn run(
    machine: fn() -> Machine,
    program: &'static str,
    level: f64,
    during: impl AsyncFnOnce(Plc, Samples) + Send + 'static,
) -> Vec<(f64, f64)> {
    let samples = Samples::default();
    let recorded = Arc::clone(&samples);
    let bench = Bench::with_config(machine().config()).unwrap();
    let bench = bench.subprogram(500, program).on_cycle(move |servo| {
        let channel = servo.channel(0);
        let sample = (channel.setpoint().0[Z], channel.spindle_deg());
        recorded.lock().unwrap().push(sample);
    });
    let played = bench.play(async move |scene, _| {
        let (plc, system) = (scene.plc(), scene.cs(1));
        system.load(500).await.unwrap();
        system.start().await.unwrap();
        while samples.lock().unwrap().last().is_none_or(|(z, _)| *z >= level) {
            plc.sleep(Duration::from_millis(1)).await;
        }
        during(plc.clone(), Arc::clone(&samples)).await;
        samples.lock().unwrap().clone()
    });
    played.unwrap()
}

/// Revolutions of the spindle in each cycle in which the tool is below a level, from there.
fn in_phase(samples: &[(f64, f64)], level: f64, per_mm: f64) -> f64 {
    let first = samples.iter().position(|(z, _)| *z < level).expect("a thread");
    let (mut revolutions, mut most, mut last_deg) = (0.0, 0.0_f64, samples[first - 1].1);
    for (z, deg) in samples[first..].iter().take_while(|(z, _)| *z < level) {
        revolutions += ((deg - last_deg + 540.0).rem_euclid(360.0) - 180.0) / 360.0;
        last_deg = *deg;
        let expected = (level - z) * per_mm;
        let off: f64 = revolutions - expected;
        assert!(
            off.abs() <= 1e-9,
            "{revolutions} revolutions at Z{z}, not {expected}"
        );
        most = most.max(revolutions.abs());
    }
    most
}

#[test]
fn m1h_hold_in_thread_stays_holding_until_tool_is_out_in_phase() {
    // in the infeed, at the Z point, and in the retract
    for wait_ms in [1000, 3300, 5000] {
        let program = "F100 S300\nG98 G84 Z-10 R-5 P500\nG80\nM30\n";
        let samples = run(with_spindle, program, -5.0, async move |plc, samples| {
            let system = plc.coordinate_system(1);
            plc.sleep(Duration::from_millis(wait_ms)).await;
            let holding = system.clone();
            let hold = tokio::spawn(async move { holding.hold().await });
            plc.sleep(Duration::from_millis(5)).await;
            let state = system.state().await.unwrap();
            assert_eq!(
                (state.execution, state.transition),
                (Execution::Active, Some(Transition::Holding))
            );
            hold.await.unwrap().unwrap();
            assert_eq!(system.state().await.unwrap().execution, Execution::FeedHold);
            plc.sleep(Duration::from_millis(300)).await;
            assert_eq!(
                samples.lock().unwrap().last().unwrap().0,
                -5.0,
                "rests at the R point"
            );
            system.resume().await.unwrap();
            system.wait_until(Execution::ProgramCompleted).await.unwrap();
            assert_eq!(samples.lock().unwrap().last().unwrap().0, 0.0);
        });
        let most = in_phase(&samples, -5.0, 3.0);
        assert!((most - 15.0).abs() < 1e-9, "{most} revolutions");
    }
}

#[test]
fn m1h_left_handed_threads_turn_the_other_way_and_overrides_do_not_act() {
    let program = "F100 S300\nG99 G74 Z-10 R0\nG80\nM30\n";
    let samples = run(with_spindle, program, 0.0, async |plc, _| {
        let system = plc.coordinate_system(1);
        let change = plc_protocol::types::request::OverrideChange {
            feed: Some(50.0),
            rapid: None,
            spindle: Some(10.0),
        };
        let input = plc_protocol::types::request::Input::Override(change);
        plc.port().request(Request::Input(1, input)).await.unwrap();
        let begun_s = plc.now_s();
        system.wait_until(Execution::ProgramCompleted).await.unwrap();
        let took_s = plc.now_s() - begun_s;
        let ways_s = 2.0 * way(10.0).end_s;
        assert!(
            (ways_s - 0.01..ways_s + 0.1).contains(&took_s),
            "{took_s} s, not {ways_s} s"
        );
    });
    let most = in_phase(&samples, 0.0, -3.0);
    assert!((most - 30.0).abs() < 1e-9, "{most} revolutions");
}

#[test]
fn m1h_f_above_maximum_slows_z_and_spindle_and_keeps_the_pitch() {
    let slow = || {
        let systems = COORDINATE_SYSTEMS.replace("max_feedrate = 12000.0", "max_feedrate = 1000.0");
        Machine::with_config(&format!("[machine]\nname = \"test-1\"\n{MOTORS}{systems}"))
    };
    // 1.5 mm a revolution, F60 in inches: 1.524 mm
    for (program, pitch) in [
        ("F1500 S1000\nG84 X0 Z-30 R0\nG80\nM30\n", 1.5),
        ("G20 F60 S1000\nG21 G84 X0 Z-30 R0\nG80\nM30\n", 1.524),
    ] {
        let samples = run(slow, program, 0.0, async |plc, _| {
            plc.coordinate_system(1)
                .wait_until(Execution::ProgramCompleted)
                .await
                .unwrap();
        });
        let most = in_phase(&samples, 0.0, 1.0 / pitch);
        assert!((most - 30.0 / pitch).abs() < 1e-9, "{most} revolutions");
        let steps = samples.windows(2).map(|two| (two[1].0 - two[0].0).abs());
        let fastest = steps.fold(0.0, f64::max) / 0.001;
        assert!((fastest - 1000.0 / 60.0).abs() < 1e-6, "{fastest} mm/s");
    }
}

#[test]
fn m1h_a_stop_in_the_thread_comes_to_rest_in_phase() {
    let samples = run(
        with_spindle,
        "F100 S300\nG98 G84 Z-10 R-5\nG80\nM30\n",
        -5.0,
        async |plc, samples| {
            let system = plc.coordinate_system(1);
            plc.sleep(Duration::from_secs(1)).await;
            system.stop().await.unwrap();
            let z = samples.lock().unwrap().last().unwrap().0;
            assert!((-7.0..-6.0).contains(&z), "in the thread: {z}");
            plc.sleep(Duration::from_millis(500)).await;
            assert_eq!(samples.lock().unwrap().last().unwrap().0, z);
        },
    );
    let most = in_phase(&samples, -5.0, 3.0);
    assert!((3.0..6.0).contains(&most), "{most} revolutions");
}

#[test]
fn m1h_without_spindle_a_hold_in_the_thread_passes_its_m_codes() {
    let program = "F100 S300\nG98 G84 Z-10 R-5 P500\nG80\nM30\n";
    run(without_spindle, program, -5.0, async |plc, samples| {
        let system = plc.coordinate_system(1);
        let begun_s = plc.now_s();
        system.hold().await.unwrap();
        let took_s = plc.now_s() - begun_s;
        // the whole infeed, retract and dwell, with M04 between them
        let expected_s = 2.0 * way(5.0).end_s + 0.5;
        assert!(
            (expected_s - 0.02..expected_s + 0.02).contains(&took_s),
            "{took_s} s"
        );
        assert_eq!(
            samples.lock().unwrap().last().unwrap().0,
            -5.0,
            "rests at the R point"
        );
        plc.sleep(Duration::from_millis(300)).await;
        let pending = system.pending().await.unwrap();
        assert!(
            pending.outputs.is_empty(),
            "M03 at the R point waits for the resume (D18)"
        );
        assert_eq!(samples.lock().unwrap().last().unwrap().0, -5.0);
        system.resume().await.unwrap();
        system.wait_until(Execution::ProgramCompleted).await.unwrap();
        assert_eq!(samples.lock().unwrap().last().unwrap().0, 0.0);
    });
}

#[test]
fn d42_levels_count_with_the_tool_length_in_force() {
    let machine = Machine::new("[[tool]]\nid = 1\nlength = 8.0\n\n[m_code.6]\nstock = \"select_tool\"\n");
    let program = "M06 VA1\nG54 G43 F1000 S300\nG98 G84 X5 Z-40 R-35\nG80\nM30\n";
    let run = simulate_on(&machine, program, &[]).completed();
    let depth = run.trace.iter().map(|row| row.axes[Z]).fold(0.0, f64::min);
    assert!((depth - (-2.0)).abs() < 1e-9, "{depth}");
    assert!(
        (run.work("Z") + 30.0).abs() < 1e-9,
        "{} {}",
        run.work("Z"),
        run.machine("Z")
    );
}
