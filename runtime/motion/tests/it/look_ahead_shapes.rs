//! G500 on shapes of typical programs, with ramps of all times: near the best time (M1d).

use std::f64::consts::TAU;

use tandem_model::AxisVector;
use tandem_model::flow::{Path, Segment, SegmentFeed, SegmentMotion};
use tandem_model::plane::Plane;

use crate::look_ahead_random::{Random, chains, each_seed};
use crate::look_ahead_rig::{Chain, Shape, best_time_s, check, same_path, time_s};
use crate::rig::{PERIOD_S, feed, line, segment, turning, vector};

/// A chain that grows block by block.
struct Drawing {
    at: AxisVector,
    blocks: Vec<(Segment, Shape)>,
}

impl Drawing {
    fn new() -> Self {
        Self {
            at: AxisVector::ZERO,
            blocks: Vec::new(),
        }
    }

    fn to(mut self, x: f64, y: f64, feed: SegmentFeed) -> Self {
        let end = vector(&[x, y]);
        self.blocks.push((line(self.at, end, feed), Shape::Line));
        self.at = end;
        self
    }

    /// Adds a line in a direction.
    fn along(self, direction: f64, length: f64, feed: SegmentFeed) -> Self {
        let at = self.at.0;
        self.to(
            at[0] + length * direction.cos(),
            at[1] + length * direction.sin(),
            feed,
        )
    }

    /// Adds an arc in X and Y that begins in a direction, through a signed angle.
    fn arc(mut self, direction: f64, radius: f64, sweep: f64, feed: SegmentFeed) -> Self {
        let arc = turning(self.at, direction, radius, sweep);
        let (end, centre) = (arc.end(), arc.centre());
        let path = Path::Arc(arc);
        let shape = Shape::Arc {
            plane: Plane::Xy,
            centre,
            radius,
            growth: 0.0,
            angle: direction - sweep.signum() * TAU / 4.0,
            sweep,
        };
        self.blocks
            .push((segment(SegmentMotion::Feed { path, feed }), shape));
        self.at = end;
        self
    }

    /// Adds a line or, with this probability, an arc of this length in a direction, which turns with the arc.
    fn any(
        self,
        random: &mut Random,
        arcs: f64,
        direction: &mut f64,
        length: f64,
        feed: SegmentFeed,
    ) -> Self {
        if random.unit() >= arcs {
            return self.along(*direction, length, feed);
        }
        let sweep = random.one_of(&[0.02, -0.05, 0.2, -1.0, 3.0]);
        let begin = *direction;
        *direction += sweep;
        self.arc(begin, length / f64::abs(sweep), sweep, feed)
    }

    fn chain(self, acceleration: f64) -> Chain {
        Chain::new(&[acceleration; 3], self.blocks)
    }
}

/// Checks that the time is within 2 percent of the best time plus the allowance for start and end, and that
/// limits and path hold.
#[track_caller]
fn near(what: &str, chain: &Chain) {
    let profiles = chain.plan();
    if let Err(found) = check(chain, &profiles, 6).and_then(|()| same_path(chain, &profiles)) {
        panic!("{what}: {found}");
    }
    let time_s = time_s(&profiles) - 3.0 * PERIOD_S;
    // On a coarse grid the reference time may be too short.
    let over = |n| time_s / best_time_s(chain, n);
    let is_near = over(100) <= 1.02 || over(1000) <= 1.02;
    assert!(is_near, "{what}: {} of the best time", over(1000));
}

/// The times ta, td and ts, ms.
const RAMPS: [[f64; 3]; 7] = [
    [1.0, 1.0, 0.0],
    [1.0, 1.0, 1.0],
    [5.0, 5.0, 1.0],
    [20.0, 20.0, 5.0],
    [50.0, 50.0, 10.0],
    [50.0, 50.0, 50.0],
    [200.0, 200.0, 0.0],
];

#[test]
fn m1d_a_flat_arc_between_corners_is_gone_up_and_down_as_a_line_is() {
    for times in RAMPS {
        for radius in [20.0, 50.0, 200.0, 1000.0] {
            for length in [10.0, 20.0, 40.0, 80.0] {
                let f = feed(12_000.0, times);
                let sweep = -length / radius;
                let drawing = Drawing::new()
                    .to(0.0, 20.0, f)
                    .arc(-sweep / 2.0, radius, sweep, f);
                let x = drawing.at.0[0];
                let chain = drawing.to(x, 0.0, f).chain(1000.0);
                near(&format!("{times:?} R{radius} {length} mm"), &chain);
            }
        }
    }
}

#[test]
fn m1d_blocks_shorter_than_their_ramps_are_one_way_up_and_down() {
    for times in RAMPS {
        let f = feed(60_000.0, times);
        let chain = Drawing::new().to(15.0, 0.0, f).to(30.0, 0.0, f).chain(400.0);
        near(&format!("{times:?}"), &chain);
    }
}

#[test]
fn m1d_corners_of_any_ramps_are_passed_near_the_best_time() {
    for times in RAMPS {
        for f in [3000.0, 10_000.0, 30_000.0] {
            for size in [2.0, 20.0, 100.0] {
                let own = feed(f, times);
                let chain = Drawing::new()
                    .to(size, 0.0, own)
                    .to(size, size, own)
                    .to(0.0, size, own)
                    .to(0.0, 0.0, own)
                    .chain(500.0);
                near(&format!("{times:?} F{f} {size} mm"), &chain);
            }
        }
    }
}

#[test]
fn m1d_another_feedrate_is_met_near_the_best_time() {
    for times in [[20.0, 20.0, 0.0], [50.0, 50.0, 10.0], [100.0, 100.0, 50.0]] {
        for acceleration in [300.0, 1000.0, 3000.0] {
            for [first, second] in [
                [6000.0, 1000.0],
                [1000.0, 6000.0],
                [12_000.0, 3000.0],
                [30_000.0, 3000.0],
                [30_000.0, 20_000.0],
            ] {
                for angle in [0.0, 0.2, 1.5_f64] {
                    let chain = Drawing::new()
                        .to(100.0, 0.0, feed(first, times))
                        .to(
                            100.0 + 100.0 * angle.cos(),
                            100.0 * angle.sin(),
                            feed(second, times),
                        )
                        .chain(acceleration);
                    near(
                        &format!("{times:?} {acceleration} mm/s^2 F{first} F{second} {angle}"),
                        &chain,
                    );
                }
            }
        }
    }
}

/// Creates ten blocks on a line; the feedrate of every second block is ten times that of its neighbours.
fn alternating(length: f64, times: [f64; 3]) -> Chain {
    let blocks = (1..=10).map(|n| (n, if n % 2 == 1 { 30_000.0 } else { 3000.0 }));
    blocks
        .fold(Drawing::new(), |drawing, (n, f)| {
            drawing.to(length * f64::from(n), 0.0, feed(f, times))
        })
        .chain(500.0)
}

#[test]
fn m1d_tenfold_alternating_feedrates_cost_no_time_at_any_ramp_steepness() {
    for times in RAMPS {
        for length in [0.5, 5.0, 15.0, 50.0] {
            near(&format!("{times:?} {length} mm"), &alternating(length, times));
        }
    }
}

#[test]
fn m1d_line_with_ramps_a_million_times_too_steep_takes_shortest_time() {
    for (acceleration, times) in [(1.0, [0.1; 3]), (10.0, [0.125, 0.125, 0.0375])] {
        let blocks = (1..=200).map(|n| (n, if n % 2 == 1 { 60_000.0 } else { 20_000.0 }));
        let line = blocks.fold(Drawing::new(), |drawing, (n, f)| {
            drawing.to(f64::from(n), 0.0, feed(f, times))
        });
        let chain = line.chain(acceleration);
        near(&format!("{acceleration} mm/s^2"), &chain);
        // Acceleration for half of 200 mm and deceleration for the other half; the speed never reaches F.
        let best_s = 2.0 * (200.0 / acceleration).sqrt();
        let time_s = time_s(&chain.plan());
        assert!(
            time_s < 1.02 * best_s + 3.0 * PERIOD_S,
            "{time_s} s, best {best_s} s"
        );
    }
}

/// Creates lines and arcs of random lengths, feedrates and turns.
fn figure(seed: u64) -> Chain {
    let mut random = Random(3_000_000 + seed);
    let times = random.one_of(&RAMPS);
    let acceleration = random.magnitude(200.0, 5000.0);
    let mut drawing = Drawing::new();
    let mut direction = 0.0;
    let blocks = 2 + random.bits() % 8;
    for _ in 0..blocks {
        let f = feed(random.magnitude(1000.0, 60_000.0), times);
        let length = random.magnitude(0.5, 100.0);
        direction += random.one_of(&[0.0, 0.1, -0.5, TAU / 4.0, -TAU / 3.0]);
        drawing = drawing.any(&mut random, 0.5, &mut direction, length, f);
    }
    drawing.chain(acceleration)
}

#[test]
fn m1d_random_figures_are_passed_near_the_best_time() {
    for seed in 0..200 {
        near(&format!("seed {seed}"), &figure(seed));
    }
}

/// Creates lines and arcs whose feedrates change up to two thousandfold, in ramps of a fraction of a
/// millisecond and more.
fn steep(seed: u64) -> Chain {
    let mut random = Random(5_000_000 + seed);
    let ta_ms = random.magnitude(0.125, 20.0);
    let times = [ta_ms, ta_ms, random.one_of(&[0.0, 0.3, 1.0]) * ta_ms];
    let acceleration = random.magnitude(100.0, 10_000.0);
    let mut drawing = Drawing::new();
    let mut direction = 0.0;
    let blocks = 2 + random.bits() % 10;
    let arcs = random.unit();
    for _ in 0..blocks {
        let f = feed(random.magnitude(30.0, 60_000.0), times);
        let length = random.magnitude(0.02, 60.0);
        direction += random.one_of(&[0.0, 0.0, 0.0, 0.0, 1e-3, 0.03, 0.1, -0.5, TAU / 4.0, TAU / 2.0]);
        drawing = drawing.any(&mut random, arcs, &mut direction, length, f);
    }
    drawing.chain(acceleration)
}

#[test]
fn m1d_feedrates_that_jump_in_steep_ramps_cost_no_time() {
    each_seed(chains() / 10, |seed| near(&format!("seed {seed}"), &steep(seed)));
}

/// Creates blocks of one length that turn by a constant angle, at the speed that the slower axis allows.
fn polygon(times: [f64; 3], side: f64, turn: f64, accelerations: &[f64]) -> Chain {
    let mut drawing = Drawing::new();
    for n in 0..30 {
        let direction = turn * (f64::from(n) + 0.5);
        let speed = (150.0 / direction.cos().abs()).min(200.0 / direction.sin().abs());
        drawing = drawing.along(direction, side, feed(speed * 60.0, times));
    }
    Chain::new(accelerations, drawing.blocks)
}

#[test]
fn m1d_polygons_with_ramps_filling_their_blocks_take_near_the_best_time() {
    for times in [
        [5.0, 5.0, 0.0],
        [5.0, 5.0, 5.0],
        [10.0, 10.0, 5.0],
        [20.0, 20.0, 20.0],
    ] {
        for filled in [0.5, 1.0, 2.0] {
            for turn in [0.02, 0.084, 0.3] {
                for accelerations in [[500.0, 130.0, 50.0], [130.0; 3], [3000.0, 1000.0, 500.0]] {
                    let side = (times[0] + times[2]) / 1000.0 * 200.0 / filled;
                    let chain = polygon(times, side, turn, &accelerations);
                    near(&format!("{times:?} {filled} {turn} {accelerations:?}"), &chain);
                }
            }
        }
    }
}
