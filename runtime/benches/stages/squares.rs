//! From text to profiles: 102,000 blocks, 1000 squares with rounded corners and lead-in and lead-out, as lines and arcs,
//! without and with cutter compensation.
//!
//! Medians, blocks a second on one core of a virtual machine with two cores. The lines of `look_ahead` reach 980,000
//! from the text to profiles on the faster one, 470,000 on the slower one.
//!
//! | machine | without compensation, G501 | G500 | with compensation, G501 | G500 |
//! | --- | --- | --- | --- | --- |
//! | the faster one | 929,000 | 525,000 | 647,000 | 395,000 |
//! | the slower one | 406,000 | 231,000 | 294,000 | 236,000 |

use std::fmt::Write as _;

use divan::Bencher;
use divan::counter::ItemsCount;

use crate::{from_text, measured};

fn count() -> u32 {
    measured(1000)
}

/// Number of blocks of one square, including lead-in and lead-out.
const BLOCKS: u32 = 102;

/// Sides of 30 mm in 13 lines, corners of 10 mm in 12 arcs.
fn squares(multi_block: &str, on: &str, off: &str) -> String {
    let mut text = format!("G17 G90 G64 {multi_block} F3000\n");
    for square in 0..count() {
        let z = f64::from(square) * 0.001;
        let _ = writeln!(text, "G01 {on} X-15 Y-25 Z{z:.3}");
        for side in 0..4_u32 {
            let (sin, cos) = (f64::from(side) * std::f64::consts::FRAC_PI_2).sin_cos();
            let turn = |u: f64, v: f64| (cos * u - sin * v, sin * u + cos * v);
            for i in 1..=13_u32 {
                let (x, y) = turn(-15.0 + 30.0 * f64::from(i) / 13.0, -25.0);
                let _ = writeln!(text, "{}X{x:.5}Y{y:.5}", if i == 1 { "G01 " } else { "" });
            }
            let mut arm = turn(0.0, 10.0);
            for i in 1..=12_u32 {
                let angle = std::f64::consts::FRAC_PI_2 * (f64::from(i) / 12.0 - 1.0);
                let (x, y) = turn(15.0 + 10.0 * angle.cos(), -15.0 + 10.0 * angle.sin());
                let word = if i == 1 { "G03 " } else { "" };
                let _ = writeln!(text, "{word}X{x:.5}Y{y:.5}I{:.5}J{:.5}", arm.0, arm.1);
                arm = turn(-10.0 * angle.cos(), -10.0 * angle.sin());
            }
        }
        let _ = writeln!(text, "G01 {off} X-10 Y-15");
    }
    text.push_str("M30\n");
    text
}

fn run(bencher: Bencher<'_, '_>, multi_block: &str, [on, off]: [&str; 2]) {
    let source = squares(multi_block, on, off).into();
    bencher
        .counter(ItemsCount::new(count() * BLOCKS))
        .bench_local(|| from_text(&source));
}

#[divan::bench(args = ["G501", "G500"], sample_count = 20)]
fn without_compensation(bencher: Bencher<'_, '_>, multi_block: &str) {
    run(bencher, multi_block, ["", ""]);
}

#[divan::bench(args = ["G501", "G500"], sample_count = 20)]
fn with_compensation(bencher: Bencher<'_, '_>, multi_block: &str) {
    run(bencher, multi_block, ["G41", "G40"]);
}
