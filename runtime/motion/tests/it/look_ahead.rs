//! G500 (M1d): limits, times near the best possible time, unchanged profiles where no limit is exceeded, the
//! path of G501, worst cases, and blocks held back.

use std::collections::VecDeque;

use tandem_model::alarm::LIMIT_ZERO;
use tandem_model::flow::{MultiBlock, SegmentFeed};
use tandem_model::profile::Profile;
use tandem_motion::Planner;

use crate::look_ahead_random::{Random, chains, each_seed, random};
use crate::look_ahead_rig::{Chain, Shape, best_time_at, best_time_s, check, pieces, same_path, time_s};
use crate::rig::{PERIOD_S, feed, line, vector};

#[test]
fn m1d_random_chains_keep_motor_limits_and_the_path_of_g501() {
    each_seed(chains(), |seed| {
        let mut numbers = Random(seed);
        let blocks = 1 + usize::try_from(numbers.bits() % 24).unwrap();
        let chain = random(&mut numbers, blocks);
        let profiles = chain.plan();
        if let Err(found) = check(&chain, &profiles, 6).and_then(|()| same_path(&chain, &profiles)) {
            panic!("seed {seed}, {blocks} blocks: {found}");
        }
        assert!(profiles[profiles.len() - 1].exact_stop);
    });
}

#[test]
fn m1d_plan_for_200_percent_override_keeps_limits_and_is_never_slower() {
    each_seed(chains() / 4, |seed| {
        let mut numbers = Random(2_000_000 + seed);
        let blocks = 1 + usize::try_from(numbers.bits() % 16).unwrap();
        let factor = numbers.within(1.0, 2.0);
        let chain = random(&mut numbers, blocks);
        let profiles = chain.plan_for(factor);
        if let Err(found) = check(&chain, &profiles, 6).and_then(|()| same_path(&chain, &profiles)) {
            panic!("seed {seed}, {blocks} blocks, {factor}: {found}");
        }
        let (faster, planned) = (time_s(&profiles), time_s(&chain.plan()));
        assert!(
            faster <= planned * 1.01 && faster >= planned / factor * 0.999,
            "seed {seed}: {faster} {planned}"
        );
    });
}

#[test]
fn m1i1_below_100_percent_f_is_multiplied_and_the_limits_stay() {
    each_seed(chains() / 10, |seed| {
        let mut numbers = Random(3_000_000 + seed);
        let blocks = 1 + usize::try_from(numbers.bits() % 8).unwrap();
        let factor = numbers.within(0.02, 1.0);
        let chain = random(&mut numbers, blocks);
        let profiles = chain.plan_for(factor);
        if let Err(found) = check(&chain, &profiles, 6).and_then(|()| same_path(&chain, &profiles)) {
            panic!("seed {seed}, {blocks} blocks, {factor}: {found}");
        }
        let time = time_s(&profiles) - 3.0 * PERIOD_S / factor;
        let is_near = |n| time <= best_time_at(&chain, n, factor) * 1.02;
        assert!([100, 1000].into_iter().any(is_near), "seed {seed}: {time} s");
        assert!(
            time_s(&profiles) >= time_s(&chain.plan()) * (1.0 - 1e-3),
            "seed {seed}"
        );
    });
}

#[test]
fn m1i1_an_override_of_50_percent_keeps_ramps_from_and_to_rest() {
    // 100 mm at 100 mm/s with ramps of 0.1 s: 1.1 s. At 50 mm/s: 2 s, and half of each ramp at half of its length.
    let feed = feed(6000.0, [100.0, 100.0, 0.0]);
    let chain = through(&[[0.0, 0.0], [100.0, 0.0]], feed, 1e4);
    let time = time_s(&chain.plan_for(0.5));
    assert!((time - 2.05).abs() < 0.02, "{time}");
}

#[test]
fn m1d_the_time_is_within_2_percent_of_the_best_possible() {
    each_seed(chains() / 10, |seed| {
        let mut numbers = Random(1_000_000 + seed);
        let blocks = 1 + usize::try_from(numbers.bits() % 8).unwrap();
        let chain = random(&mut numbers, blocks);
        let time = time_s(&chain.plan()) - 3.0 * PERIOD_S;
        // On a coarse grid the reference time may be too short.
        let is_near = |n| time <= best_time_s(&chain, n) * 1.02;
        assert!([100, 1000].into_iter().any(is_near), "seed {seed}: {time} s");
    });
}

/// Returns lines through points in X and Y at one feed.
fn through(points: &[[f64; 2]], feed: SegmentFeed, acceleration: f64) -> Chain {
    let blocks = points
        .windows(2)
        .map(|ends| (line(vector(&ends[0]), vector(&ends[1]), feed), Shape::Line))
        .collect();
    Chain::new(&[acceleration; 3], blocks)
}

fn assert_limits(chain: &Chain) -> Vec<Profile> {
    let profiles = chain.plan();
    check(chain, &profiles, 12)
        .and_then(|()| same_path(chain, &profiles))
        .unwrap();
    profiles
}

#[test]
fn m1d_within_the_limits_the_profile_is_the_programmed_one() {
    let feed = feed(3000.0, [100.0, 100.0, 50.0]);
    let chain = through(
        &[[0.0, 0.0], [30.0, 0.0], [30.0, 30.0], [0.0, 35.0]],
        feed,
        5000.0,
    );
    for profile in assert_limits(&chain) {
        assert!(
            pieces(&profile)
                .iter()
                .all(|(piece, _)| (piece.rate - 1.0).abs() < 1e-12)
        );
    }
    assert!((time_s(&chain.plan()) - chain.formula.end_s).abs() < 1e-9);
}

#[test]
fn m1d_reversals_keep_the_limits_and_a_stop_and_go_is_the_best_there() {
    let feed = feed(6000.0, [10.0, 10.0, 0.0]);
    let chain = through(&[[0.0, 0.0], [40.0, 0.0], [0.0, 0.0], [40.0, 0.0]], feed, 1000.0);
    let time = time_s(&assert_limits(&chain));
    // 100 mm/s at 1000 mm/s^2: 0.1 s to speed. Nothing is faster than three distances of 40 mm, except for
    // the rounded reversals.
    assert!(time < 3.0 * (0.4 + 0.1) * 1.02, "{time}");
}

#[test]
fn m1d_blocks_of_a_micrometre_and_points_that_coincide_keep_the_limits() {
    let feed = feed(6000.0, [50.0, 50.0, 20.0]);
    let zigzag: Vec<[f64; 2]> = (0..2000)
        .map(|n| [f64::from(n) * 1e-3, f64::from(n % 2) * 1e-3])
        .collect();
    assert_limits(&through(&zigzag, feed, 2000.0));
    // Moves of a micrometre forward and back, between moves of 0.1 m.
    let mut points = vec![[0.0, 0.0]];
    for n in 0..50 {
        let x = f64::from(n) * 100.0;
        points.extend([
            [x + 100.0, 0.0],
            [x + 100.0, 1e-6],
            [x + 100.0, 0.0],
            [x + 100.0, 1e-6],
        ]);
    }
    assert_limits(&through(&points, feed, 2000.0));
}

#[test]
fn m1d_steep_corners_take_few_profiles_a_servo_period() {
    // Seeds for which the fastest motion after a corner needs thousands of pieces; the servo passes 4096 in a
    // period.
    for seed in [17, 77, 86, 166, 291, 302, 308, 313] {
        let chain = random(&mut Random(seed * 77 + 5), 200);
        let mut at_s = 0.0;
        let ends: Vec<f64> = (chain.plan().iter())
            .map(|profile| {
                at_s += profile.duration_s;
                at_s
            })
            .collect();
        for (first, begin_s) in ends.iter().enumerate() {
            let within = ends.partition_point(|end_s| end_s - begin_s <= PERIOD_S) - first;
            assert!(
                within <= 1024,
                "seed {seed}: {within} profiles from {begin_s} s on"
            );
        }
    }
}

#[test]
fn m1d_more_blocks_than_look_ahead_holds_slow_down_and_keep_the_limits() {
    // 20,000 blocks of a micrometre are 20 mm; the stopping distance from 128 mm/s at 100 mm/s^2 is 82 mm.
    let feed = feed(60_000.0, [50.0, 50.0, 0.0]);
    let points: Vec<[f64; 2]> = (0..=20_000).map(|n| [f64::from(n) * 1e-3, 0.0]).collect();
    let chain = through(&points, feed, 100.0);
    let profiles = assert_limits(&chain);
    // The fastest motion accelerates for half of the distance and decelerates for the other half.
    let best = 2.0 * (2.0 * 10.0 / 100.0_f64).sqrt();
    let time = time_s(&profiles);
    assert!(time < 1.5 * best, "{time} s, best {best} s");
}

#[test]
fn m1d_blocks_are_output_once_final_and_flush_ends_at_rest() {
    let feed = feed(6000.0, [20.0, 20.0, 0.0]);
    let points: Vec<[f64; 2]> = (0..=400)
        .map(|n| [f64::from(n) * 2.0, f64::from(n % 2) * 0.5])
        .collect();
    let chain = through(&points, feed, 1000.0);
    let whole = chain.plan();
    let mut planner = Planner::new(&chain.settings);
    let mut out = VecDeque::new();
    for segment in &chain.segments[..200] {
        planner.push(segment, &mut out).unwrap();
    }
    let begun = out.len();
    assert!(out.iter().any(|profile| profile.segment > 100), "{begun}");
    assert!(out.iter().all(|profile| !profile.exact_stop));
    // The output equals the output with all blocks known.
    for (early, late) in out.iter().zip(&whole) {
        assert_eq!(early.segment, late.segment);
        assert!((early.duration_s - late.duration_s).abs() <= 2e-3 * late.duration_s);
    }
    planner.flush(&mut out);
    assert!(out[out.len() - 1].exact_stop);
    assert_eq!(out[out.len() - 1].segment, 200);
    planner.flush(&mut out);
    assert_eq!(out.iter().filter(|profile| profile.exact_stop).count(), 1);
}

#[test]
fn m1d_chain_stops_between_g500_and_g501_and_motors_need_acceleration() {
    let feed = feed(600.0, [20.0, 20.0, 0.0]);
    let mut chain = through(&[[0.0, 0.0], [10.0, 0.0], [20.0, 0.0]], feed, 1000.0);
    chain.segments[1].multi_block = MultiBlock::Off;
    let stops: Vec<bool> = chain.plan().iter().map(|profile| profile.exact_stop).collect();
    assert_eq!(stops, [true, true]);
    chain.settings.motors[0].as_mut().unwrap().max_acceleration = 0.0;
    let mut planner = Planner::new(&chain.settings);
    let refused = planner.push(&chain.segments[0], &mut VecDeque::new());
    assert_eq!(refused.unwrap_err().entry, &LIMIT_ZERO);
}
#[test]
fn m1d_a_block_of_a_nanometre_in_a_fast_line_costs_no_time() {
    let feed = crate::rig::feed(30_000.0, [50.0, 50.0, 0.0]);
    let at = |x: f64| [x, 0.0];
    let with = [0.0, 100.0, 100.000_001, 200.0].map(at);
    let time_of = |points: &[[f64; 2]]| time_s(&through(points, feed, 10_000.0).plan());
    let (time, without) = (time_of(&with), time_of(&[0.0, 100.0, 200.0].map(at)));
    assert!((time - without).abs() < 1e-6, "{time} and {without} s");
}
