//! G00: each motor alone, in the least time of its own limits (M1).

use crate::support::formula::{LATE_S, Rapid, assert_samples};
use crate::support::simulated::simulate;

const X: usize = 0;
const Y: usize = 1;

#[test]
fn m1e_a_long_rapid_takes_way_over_speed_and_speed_over_acceleration() {
    // 50 mm at 100 mm/s and 1000 mm/s^2: 0.5 + 0.1 s
    let run = simulate("G00 X50\nM30\n").completed();
    let motion = Rapid::new(50.0, 100.0, 1000.0);
    assert!((motion.end_s - 0.6).abs() < 1e-12);
    assert!((motion.end_s..motion.end_s + LATE_S).contains(&run.cycle_time_s()));
    assert_samples(&run.samples(1, 1, X), 0.0, 1.0, motion.end_s, |t| motion.way(t));
}

#[test]
fn m1e_a_short_rapid_takes_twice_the_root_of_way_over_acceleration() {
    // 2.5 mm at 1000 mm/s^2: twice 50 ms, peak 50 mm/s
    let run = simulate("G00 X-2.5\nM30\n").completed();
    let motion = Rapid::new(2.5, 100.0, 1000.0);
    assert!((motion.end_s - 0.1).abs() < 1e-12);
    assert!((motion.end_s..motion.end_s + LATE_S).contains(&run.cycle_time_s()));
    assert_samples(&run.samples(1, 1, X), 0.0, -1.0, motion.end_s, |t| motion.way(t));
}

#[test]
fn m1e_each_motor_moves_alone_and_the_block_ends_with_the_slowest() {
    // X: 0.4 s. Y at 50 mm/s and 250 mm/s^2: 0.8 s. The axes do not wait for each other on the way.
    let run = simulate("G00 X30 Y30\nM30\n").completed();
    let (x, y) = (Rapid::new(30.0, 100.0, 1000.0), Rapid::new(30.0, 50.0, 250.0));
    assert!((x.end_s - 0.4).abs() < 1e-12 && (y.end_s - 0.8).abs() < 1e-12);
    assert!((y.end_s..y.end_s + LATE_S).contains(&run.cycle_time_s()));
    assert_samples(&run.samples(1, 1, X), 0.0, 1.0, x.end_s, |t| x.way(t));
    assert_samples(&run.samples(1, 1, Y), 0.0, 1.0, y.end_s, |t| y.way(t));
}

#[test]
fn m1c_g00_blends_neither_before_nor_behind_it() {
    let run = simulate("G00 X20\nX20 Y10\nG01 X30 F3000\nG00 Z5\nM30\n").completed();
    for corner in [[20.0, 0.0, 0.0], [20.0, 10.0, 0.0], [30.0, 10.0, 0.0]] {
        assert!(
            run.trace.iter().any(|row| row.axes == corner),
            "the path meets {corner:?}"
        );
    }
}
