//! Back trace: from a feed hold back along the passed path of G500, and forward again.

use std::sync::{Arc, Mutex};

use plc_api::{AuxOutput, Execution, Plc, SequenceProgram};
use plc_protocol::types::request::{OverrideChange, RefusalCode};
use plc_protocol::types::state::Reason;

use super::rig::{Point, Rig, close, distance, on_machine, refused};
use super::stairs::{STAIRS, assert_on_stairs};
use crate::support::formula::{PERIOD_S, Rapid};

fn g500(program: &str) -> String {
    format!("G64 G500 {program}")
}

/// Moves back to the end of the path, and returns the lines of its blocks, without successive duplicates.
async fn to_the_end(rig: &Rig) -> Vec<u32> {
    rig.cs.back_trace(true).await.unwrap();
    let mut lines = Vec::new();
    for _ in 0..100_000 {
        lines.push(rig.cs.program().await.unwrap().line);
        match rig.state().await {
            (Execution::FeedHold, Some(Reason::BackTraceEnd)) => {
                lines.dedup();
                return lines;
            }
            (Execution::Active, Some(Reason::BackTrace)) => rig.sleep(0.002).await,
            other => panic!("{other:?}"),
        }
    }
    panic!("it never ends")
}

/// M1e: X 40 mm and Y 10 mm, each in its own least time, both from the start on.
fn assert_on_the_rapid(point: Point) {
    let (x, y) = (Rapid::new(40.0, 100.0, 1000.0), Rapid::new(10.0, 50.0, 250.0));
    let (mut low, mut high) = (0.0, x.end_s);
    for _ in 0..100 {
        let middle = f64::midpoint(low, high);
        if x.way(middle) + y.way(middle) > point[0] + point[1] {
            high = middle;
        } else {
            low = middle;
        }
    }
    close(point, [x.way(low), y.way(low), 0.0]);
}

/// Largest velocity of X, mm/s.
fn fastest(trace: &[Point]) -> f64 {
    let steps = trace.windows(2).map(|two| (two[1][0] - two[0][0]).abs());
    steps.fold(0.0, f64::max) / PERIOD_S
}

#[test]
fn m1e_back_trace_goes_back_along_a_rapid_on_the_path_of_its_motors() {
    on_machine("", |rig| async move {
        for moment_s in [0.03, 0.1, 0.22, 0.33, 0.42, 0.48] {
            rig.start(&g500("G00 X40 Y10\nM30\n")).await;
            rig.sleep(moment_s).await;
            for _ in 0..3 {
                rig.cs.hold().await.unwrap();
                let held_at = rig.at().await;
                rig.cs.back_trace(true).await.unwrap();
                assert_eq!(rig.state().await, (Execution::Active, Some(Reason::BackTrace)));
                rig.sleep(0.1).await;
                rig.cs.hold().await.unwrap();
                let back_at = rig.at().await;
                assert!(back_at[0] < held_at[0], "{back_at:?}");
                rig.cs.back_trace(false).await.unwrap();
                assert_eq!(rig.state().await, (Execution::Active, None));
                rig.sleep(0.13).await;
            }
            rig.cs.hold().await.unwrap();
            assert_eq!(to_the_end(&rig).await, [1]);
            close(rig.at().await, [0.0; 3]);
            rig.cs.resume().await.unwrap();
            rig.until(Execution::ProgramCompleted).await;
            close(rig.at().await, [40.0, 10.0, 0.0]);
            rig.trace().into_iter().for_each(assert_on_the_rapid);
            rig.cs.mdi("G90 G00 X0 Y0").await.unwrap();
            rig.trace();
        }
        assert_eq!(rig.alarms().await, [0_u16; 0]);
    });
}

#[test]
fn m1c_back_trace_passes_a_change_of_offset_that_stops_no_chain() {
    on_machine("", |rig| async move {
        // G54 has X10 Y20, G57 has X13
        rig.start(&g500("ta50 td50 ts0 G54 G01 F2400 X10\nG57\nX7 Y15\nX47\nM30\n"))
            .await;
        while rig.at().await[0] < 40.0 {
            rig.sleep(0.01).await;
        }
        rig.cs.hold().await.unwrap();
        let forward = rig.trace();
        let corners = [[20.0, 0.0, 0.0], [20.0, 15.0, 0.0]];
        assert!(!forward.iter().any(|at| corners.contains(at)));
        assert_eq!(to_the_end(&rig).await, [4, 3, 1]);
        close(rig.at().await, [0.0; 3]);
        let back = rig.trace();
        assert!(!back.iter().any(|at| corners.contains(at)));
        rig.cs.resume().await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
        close(rig.at().await, [60.0, 15.0, 0.0]);
        let work = rig.cs.position().await.unwrap().work;
        assert!((work["X"] - 47.0).abs() < 1e-9 && (work["Y"] - 15.0).abs() < 1e-9);
        assert_eq!(rig.alarms().await, [0_u16; 0]);
    });
}

#[test]
fn the_rapid_override_acts_on_a_rapid_that_is_gone_back() {
    on_machine("", |rig| async move {
        rig.start(&g500("G00 X40 Y10\nG01 X60 F3000\nM30\n")).await;
        rig.sleep(0.7).await;
        rig.cs.hold().await.unwrap();
        let rapid = Some(50.0);
        rig.cs
            .set_overrides(OverrideChange {
                rapid,
                ..OverrideChange::default()
            })
            .await
            .unwrap();
        rig.trace();
        assert_eq!(to_the_end(&rig).await, [2, 1]);
        let trace = rig.trace();
        let rapid: Vec<Point> = trace.into_iter().filter(|at| at[0] < 40.0).collect();
        assert!((fastest(&rapid) - 50.0).abs() < 1e-6, "{}", fastest(&rapid));
    });
}

#[test]
fn back_trace_passes_rapids_dwells_exact_stops_and_empty_blocks() {
    on_machine("", |rig| async move {
        let program = "ta50 td50 ts0 G00 X10 Y5\nG01 F3000 X20\nG04 P300\nG91 G53 G00 X10\nG90\nG01 G09 X40\nG61 \
                       X50\nG64 F2400\nS100\nG04 P200\nX60\nX90\nM30\n";
        rig.start(&g500(program)).await;
        while rig.at().await[0] < 70.0 {
            rig.sleep(0.01).await;
        }
        rig.cs.hold().await.unwrap();
        let forward = rig.trace();
        let lines = to_the_end(&rig).await;
        assert_eq!(lines, [12, 11, 10, 7, 6, 4, 3, 2, 1]);
        close(rig.at().await, [0.0; 3]);
        let back = rig.trace();
        assert!(back.len() < forward.len() - 400, "the dwells are not waited for");
        let refusal = refused(rig.cs.back_trace(true).await, RefusalCode::NotAllowed);
        assert!(
            refusal.text.contains("back trace cannot go back"),
            "{}",
            refusal.text
        );
        rig.cs.resume().await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
        close(rig.at().await, [90.0, 5.0, 0.0]);
        let again = rig.trace();
        for (from, to) in [(20.0, 20.0), (50.0, 50.0)] {
            let rests = again.iter().filter(|at| (from..=to).contains(&at[0])).count();
            assert!(rests < 10, "{rests} periods at {from}");
        }
        assert_eq!(rig.alarms().await, [0_u16; 0]);
    });
}

#[test]
fn back_trace_passes_g28_and_m00_and_m00_does_not_stop_again() {
    on_machine("", |rig| async move {
        rig.start(&g500("G00 X10 Y5\nG28 X20 Y10\nM00\nG01 X30 F3000\nM30\n"))
            .await;
        rig.until(Execution::ProgramStopped).await;
        close(rig.at().await, [0.0; 3]);
        rig.cs.resume().await.unwrap();
        rig.sleep(0.4).await;
        rig.cs.hold().await.unwrap();
        let forward = rig.trace();
        assert_eq!(to_the_end(&rig).await, [4, 2, 1]);
        let middle = |trace: &[Point]| trace.iter().any(|at| distance(*at, [20.0, 10.0, 0.0]) < 1e-9);
        assert!(middle(&forward) && middle(&rig.trace()));
        rig.cs.resume().await.unwrap();
        let state = rig
            .cs
            .wait_for(|state| state.execution != Execution::Active)
            .await;
        assert_eq!(state.unwrap().execution, Execution::ProgramCompleted);
        close(rig.at().await, [30.0, 0.0, 0.0]);
        assert!(middle(&rig.trace()));
    });
}

#[test]
fn a_dwell_waits_once_in_all_however_often_it_is_passed() {
    on_machine("", |rig| async move {
        let program = g500("ta50 td50 ts0 G01 F3000 X10\nG04 P500\nX20\nM30\n");
        rig.start(&program).await;
        let is_at_the_dwell = |at: &Point| at[0].to_bits() == 10.0_f64.to_bits();
        let mut waited = 0;
        for _ in 0..2 {
            while !is_at_the_dwell(&rig.at().await) {
                rig.sleep(0.001).await;
            }
            rig.sleep(0.2).await;
            waited += rig.trace().iter().filter(|at| is_at_the_dwell(at)).count();
            rig.cs.hold().await.unwrap();
            rig.cs.back_trace(true).await.unwrap();
            rig.sleep(0.1).await;
            rig.cs.hold().await.unwrap();
            assert!(rig.at().await[0] < 9.9);
            rig.trace();
            rig.cs.resume().await.unwrap();
        }
        while rig.at().await[0] <= 10.0 {
            rig.sleep(0.001).await;
        }
        waited += rig.trace().iter().filter(|at| is_at_the_dwell(at)).count();
        assert!((500..=520).contains(&waited), "{waited} periods");
        rig.until(Execution::ProgramCompleted).await;
        assert_eq!(rig.alarms().await, [0_u16; 0]);
    });
}

#[test]
fn back_trace_ends_at_g501_a_skip_and_a_thread() {
    on_machine("", |rig| async move {
        let cases = [
            ("G64 G501 F3000 G00 X10\nG500 G01 X40\nM30\n", [10.0, 0.0, 0.0]),
            (
                "G64 G500 F3000 G00 X5\nG31 X10\nG00 Y5\nG01 X40\nM30\n",
                [10.0, 0.0, 0.0],
            ),
            (
                "G64 G500 F600 S600 M19\nG84 Z-5 R0\nG80\nG00 X10\nG01 X40 F3000\nM30\n",
                [0.0, 0.0, 0.0],
            ),
        ];
        for (program, end) in cases {
            rig.start(program).await;
            while rig.at().await[0] < 20.0 {
                rig.sleep(0.01).await;
            }
            rig.cs.hold().await.unwrap();
            to_the_end(&rig).await;
            close(rig.at().await, end);
            rig.cs.resume().await.unwrap();
            rig.until(Execution::ProgramCompleted).await;
            rig.cs.mdi("G90 G00 X0 Y0").await.unwrap();
        }
        rig.start("G64 G501 G00 X40\nM30\n").await;
        rig.sleep(0.1).await;
        rig.cs.hold().await.unwrap();
        refused(rig.cs.back_trace(true).await, RefusalCode::NotAllowed);
        assert_eq!(rig.alarms().await, [0_u16; 0]);
    });
}

#[test]
fn back_trace_reversed_at_a_block_end_lets_the_program_continue() {
    on_machine("", |rig| async move {
        // 0.22 s and up to three periods; a hold just before its end arrives after the block.
        let mut at_the_end = 0;
        for moment_ms in 210_u32..230 {
            rig.start(&g500("ta20 td20 ts0 G01 F3000 X10\nM00\nX20\nM30\n"))
                .await;
            rig.sleep(f64::from(moment_ms) / 1000.0).await;
            if rig.state().await.0 == Execution::ProgramStopped {
                break;
            }
            rig.cs.hold().await.unwrap();
            at_the_end += u32::from(distance(rig.at().await, [10.0, 0.0, 0.0]) == 0.0);
            rig.cs.back_trace(true).await.unwrap();
            rig.cs.hold().await.unwrap();
            rig.cs.resume().await.unwrap();
            rig.until(Execution::ProgramStopped).await;
            close(rig.at().await, [10.0, 0.0, 0.0]);
            rig.cs.resume().await.unwrap();
            rig.until(Execution::ProgramCompleted).await;
            rig.cs.mdi("G90 G00 X0").await.unwrap();
        }
        assert!(at_the_end > 0);
    });
}

#[test]
fn back_trace_goes_back_on_the_path_and_the_program_goes_on_from_there() {
    on_machine("", |rig| async move {
        for (n, moment_s) in [0.2, 0.55, 0.91, 1.3].into_iter().enumerate() {
            rig.start(&g500(STAIRS)).await;
            rig.sleep(moment_s).await;
            rig.cs.hold().await.unwrap();
            let held_at = rig.at().await;
            rig.cs.back_trace(true).await.unwrap();
            assert_eq!(rig.state().await, (Execution::Active, Some(Reason::BackTrace)));
            rig.sleep(0.15).await;
            rig.cs.hold().await.unwrap();
            assert_eq!(rig.state().await, (Execution::FeedHold, Some(Reason::BackTrace)));
            let back_at = rig.at().await;
            assert!(
                back_at[0] + back_at[1] < held_at[0] + held_at[1] - 1.0,
                "{back_at:?}"
            );
            if n % 2 == 0 {
                rig.cs.back_trace(false).await.unwrap();
            } else {
                rig.cs.back_trace(true).await.unwrap();
                rig.sleep(0.05).await;
                rig.cs.hold().await.unwrap();
                rig.cs.resume().await.unwrap();
            }
            assert_eq!(rig.state().await, (Execution::Active, None));
            rig.until(Execution::ProgramCompleted).await;
            close(rig.at().await, [40.0, 40.0, 0.0]);
            rig.trace().into_iter().for_each(assert_on_stairs);
            rig.cs.mdi("G90 G00 X0 Y0").await.unwrap();
            rig.trace();
        }
        assert_eq!(rig.alarms().await, [0_u16; 0]);
    });
}

#[test]
fn back_trace_rests_at_the_end_of_its_way_and_says_so() {
    on_machine("", |rig| async move {
        rig.start(&g500(STAIRS)).await;
        rig.sleep(0.7).await;
        rig.cs.hold().await.unwrap();
        rig.cs.back_trace(true).await.unwrap();
        let state = rig.until(Execution::FeedHold).await;
        assert_eq!(state.reason, Some(Reason::BackTraceEnd));
        close(rig.at().await, [0.0, 0.0, 0.0]);
        let refusal = refused(rig.cs.back_trace(true).await, RefusalCode::NotAllowed);
        assert!(
            refusal.text.contains("back trace cannot go back"),
            "{}",
            refusal.text
        );
        rig.cs.resume().await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
        close(rig.at().await, [40.0, 40.0, 0.0]);
        rig.trace().into_iter().for_each(assert_on_stairs);
    });
}

#[test]
fn stop_and_abort_end_a_back_trace_and_keep_the_position() {
    on_machine("", |rig| async move {
        for abort in [false, true] {
            rig.start(&g500(STAIRS)).await;
            rig.sleep(0.7).await;
            rig.cs.hold().await.unwrap();
            rig.cs.back_trace(true).await.unwrap();
            rig.sleep(0.1).await;
            if abort {
                rig.cs.abort().await.unwrap();
            } else {
                rig.cs.stop().await.unwrap();
            }
            let at = rig.at().await;
            assert_eq!(rig.state().await.0, Execution::Stopped);
            rig.cs.reset().await.unwrap();
            rig.sleep(0.2).await;
            close(rig.at().await, at);
            rig.cs.mdi("G90 G00 X0 Y0").await.unwrap();
            assert!(distance(at, [0.0; 3]) > 1.0);
        }
        assert_eq!(rig.alarms().await, [0_u16; 0]);
    });
}

#[test]
fn back_trace_ends_at_the_last_m_code_and_puts_none_out_again() {
    on_machine("[m_code.60]\ntiming = \"with_motion\"\n", |rig| async move {
        let made = Arc::new(Mutex::new(Vec::new()));
        let sink = Arc::clone(&made);
        let handlers = SequenceProgram::new().on(50..=60, move |output: AuxOutput, _plc: Plc| {
            sink.lock().unwrap().push(output.m());
            async { Ok(()) }
        });
        let plc = rig.plc.clone();
        let running = tokio::spawn(async move { handlers.run(&plc).await });
        rig.sleep(0.01).await;
        rig.start(&g500("ta50 td50 ts0 G01 F3000\nX10\nM50\nX20\nM60\nX40\nM30\n"))
            .await;
        rig.sleep(0.7).await;
        rig.cs.hold().await.unwrap();
        let [x, ..] = rig.at().await;
        assert!((20.0..40.0).contains(&x), "{x}");
        rig.cs.back_trace(true).await.unwrap();
        let state = rig.until(Execution::FeedHold).await;
        assert_eq!(state.reason, Some(Reason::BackTraceEnd));
        close(rig.at().await, [10.0, 0.0, 0.0]);
        rig.cs.back_trace(false).await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
        close(rig.at().await, [40.0, 0.0, 0.0]);
        assert_eq!(*made.lock().unwrap(), [50, 60]);
        running.abort();
    });
}

#[test]
fn back_trace_is_refused_where_there_is_no_way_back() {
    on_machine("", |rig| async move {
        refused(rig.cs.back_trace(true).await, RefusalCode::NotAllowed);
        rig.start("G64 G501 ta50 td50 ts0 G01 F3000\nX10\nX40\nM30\n")
            .await;
        rig.sleep(0.3).await;
        let refusal = refused(rig.cs.back_trace(true).await, RefusalCode::NotAllowed);
        assert!(refusal.text.contains("hold first"), "{}", refusal.text);
        rig.cs.hold().await.unwrap();
        let refusal = refused(rig.cs.back_trace(true).await, RefusalCode::NotAllowed);
        assert!(refusal.text.contains("G500"), "{}", refusal.text);
        let refusal = refused(rig.cs.back_trace(false).await, RefusalCode::NotAllowed);
        assert!(refusal.text.contains("not on"), "{}", refusal.text);
        rig.cs.resume().await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
        close(rig.at().await, [40.0, 0.0, 0.0]);
    });
}

/// The same numbers for the same seed (Knuth's MMIX generator).
struct Random(u64);

impl Random {
    /// From 0 on, below `most`.
    fn up_to(&mut self, most: f64) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let high = u32::try_from(self.0 >> 32).unwrap();
        most * f64::from(high) / (f64::from(u32::MAX) + 1.0)
    }

    fn block(&mut self) -> String {
        let kind = self.up_to(10.0);
        let mut word = |letter: &str, least: f64, most: f64| {
            let value = least + self.up_to(most - least);
            format!("{letter}{value:.3} ")
        };
        if kind < 3.0 {
            let to = ["X", "Y", "Z"].map(|letter| word(letter, 0.0, 60.0));
            format!("G00 {}", to.concat())
        } else if kind < 6.0 {
            let to = ["X", "Y"].map(|letter| word(letter, 0.0, 60.0));
            format!("G01 {}", to.concat())
        } else if kind < 8.0 {
            let code = if kind < 7.0 { "G02" } else { "G03" };
            let to = [word("X", -9.0, 9.0), word("Y", 1.0, 9.0)];
            format!("G91 {code} {}R20\nG90", to.concat())
        } else if kind < 9.0 {
            format!("G04 {}", word("P", 1.0, 150.0))
        } else {
            let code = if kind < 9.5 { "G61" } else { "G64" };
            format!("{code} {}", word("F", 1000.0, 3000.0))
        }
    }
}

/// Returns the distance of a point from the nearest straight line between two samples, mm.
fn off_the_samples(point: Point, samples: &[Point]) -> f64 {
    let off = |two: &[Point]| {
        let dot = |f: &dyn Fn(usize) -> f64| (0..3).map(f).sum::<f64>();
        let way = |axis: usize| two[1][axis] - two[0][axis];
        let length = dot(&|axis| way(axis).powi(2));
        let share = dot(&|axis| (point[axis] - two[0][axis]) * way(axis)) / length.max(1e-300);
        let share = share.clamp(0.0, 1.0);
        distance(
            point,
            std::array::from_fn(|axis| two[0][axis] + share * way(axis)),
        )
    };
    samples.windows(2).map(off).fold(f64::INFINITY, f64::min)
}

#[test]
fn program_in_g500_reversed_at_any_moment_keeps_its_path_and_end() {
    for seed in 0..8 {
        let mut random = Random(seed);
        let blocks: Vec<String> = (0..10).map(|_| random.block()).collect();
        let program = g500(&format!("ta20 td20 ts0 F3000\n{}\nM30\n", blocks.join("\n")));
        on_machine("", move |rig| async move {
            rig.trace();
            rig.start(&program).await;
            rig.until(Execution::ProgramCompleted).await;
            let (end, mut undisturbed) = (rig.at().await, rig.trace());
            undisturbed.dedup();
            rig.cs.mdi("G90 G00 X0 Y0 Z0").await.unwrap();
            rig.trace();
            rig.start(&program).await;
            for _ in 0..6 {
                rig.sleep(random.up_to(0.8)).await;
                if rig.state().await.0 != Execution::Active {
                    break;
                }
                rig.cs.hold().await.unwrap();
                if rig.cs.back_trace(true).await.is_ok() {
                    rig.sleep(random.up_to(0.8)).await;
                    rig.cs.hold().await.unwrap();
                }
                rig.cs.resume().await.unwrap();
            }
            rig.until(Execution::ProgramCompleted).await;
            assert_eq!(
                rig.at().await.map(f64::to_bits),
                end.map(f64::to_bits),
                "{program}"
            );
            // Between two samples the path is within a T^2/8 of their line.
            let most = 2.0 * 5000.0 * PERIOD_S * PERIOD_S / 8.0;
            for point in rig.trace().into_iter().step_by(29) {
                let off = off_the_samples(point, &undisturbed);
                assert!(off <= most, "{point:?} is {off} off the path of\n{program}");
            }
            assert_eq!(rig.alarms().await, [0_u16; 0]);
        });
    }
}
