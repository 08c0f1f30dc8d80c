//! Ratio of simulated time to real time: three axes, servo period 1 ms, ten minutes and more of motion, for a complete
//! run including the reading of the text. Simulated seconds divided by seconds on the clock.
//!
//! - long lines: sides of 100 mm, each from rest to rest (G61);
//! - short lines: sides of 0.4 mm in a polygon, blended (G64, G501), 6 ms each;
//! - look-ahead: short lines with G500;
//! - dense lines, dense ahead: like short lines and look-ahead, with sides of 0.1 mm, 2 ms each, which costs about
//!   1.7 us a block;
//! - arcs: full circles of 20 mm.
//!
//! Measured on two cores of an AMD EPYC virtual machine on which the lines of the bench `stages` reach 1,270,000 blocks
//! a second from the text to profiles; bench profile, the medians of three runs, and the lowest of all rounds. In tests
//! with handlers, the clock of tokio follows that of the machine, and short lines take about a third longer.
//!
//! | program | times real time | lowest |
//! | --- | --- | --- |
//! | long lines | 432,000 to 549,000 | 166,000 |
//! | short lines | 2540 to 2840 | 2410 |
//! | look-ahead | 2340 to 2570 | 1970 |
//! | dense lines | 901 to 1110 | 681 |
//! | dense ahead | 936 to 1030 | 848 |
//! | arcs | 420,000 to 487,000 | 153,000 |
//!
//! A host with half of that speed reaches half of these values.

use std::fmt::Write as _;
use std::time::{Duration, Instant};

use tandem_runtime::Config;
use tandem_testing::Bench;

use crate::machine::CONFIG;
use crate::table::say;

/// Smallest number of runs and smallest total time of each program, so that short programs are measured after warm-up.
const ROUNDS_MIN: usize = 5;
const TIME_MIN: Duration = Duration::from_millis(500);

pub fn run() -> anyhow::Result<()> {
    say("Simulated time by real time, three axes");
    let texts = [
        ("long lines", squares()),
        ("short lines", polygons("G501 F4000", 0.4, 100)),
        ("look-ahead", polygons("G500 F4000", 0.4, 100)),
        ("dense lines", polygons("G501 F3000", 0.1, 200)),
        ("dense ahead", polygons("G500 F3000", 0.1, 200)),
        ("arcs", circles()),
    ];
    for (name, text) in texts {
        let mut ratios = Vec::new();
        let mut simulated_s = 0.0;
        let first = Instant::now();
        while ratios.len() < ROUNDS_MIN || first.elapsed() < TIME_MIN {
            let folder = tempfile::tempdir()?;
            let machine = Config::from_toml(CONFIG, folder.path())?.resolve()?;
            let begin = Instant::now();
            let run = Bench::on_machine(machine).run(text.clone())?.completed()?;
            simulated_s = run.time_s;
            ratios.push(simulated_s / begin.elapsed().as_secs_f64());
        }
        ratios.sort_by(f64::total_cmp);
        say(&format!(
            "  {name:<12} {simulated_s:>6.0} s simulated   median {:>6.0} times   lowest {:>6.0}",
            ratios[ratios.len() / 2],
            ratios[0]
        ));
    }
    Ok(())
}

/// 100 squares of 100 mm at 4000 mm/min.
fn squares() -> String {
    let mut text = String::from("G17 G61 G91 G01 F4000\n");
    for _ in 0..100 {
        text.push_str("X100\nY100 Z0.1\nX-100\nY-100\n");
    }
    text.push_str("M30\n");
    text
}

/// Returns a number of blended polygons of 1000 sides, mm.
fn polygons(codes: &str, side_mm: f64, turns: u32) -> String {
    let mut text = format!("G17 G64 G91 G01 {codes}\n");
    for _ in 0..turns {
        for side in 0..1000_u32 {
            let angle = f64::from(side) * std::f64::consts::TAU / 1000.0;
            let [x, y] = [side_mm * angle.cos(), side_mm * angle.sin()];
            let _ = writeln!(text, "X{x:.5}Y{y:.5}");
        }
    }
    text.push_str("M30\n");
    text
}

/// 300 full circles of radius 20 mm at 4000 mm/min.
fn circles() -> String {
    let mut text = String::from("G17 G64 G501 G91 F4000\n");
    for _ in 0..300 {
        text.push_str("G03 I20 J0\n");
    }
    text.push_str("M30\n");
    text
}
