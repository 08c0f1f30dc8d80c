//! Random chains for G500, equal on every computer.

use std::f64::consts::TAU;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;

use tandem_model::flow::{Path, Segment, SegmentFeed, SegmentMotion};
use tandem_model::plane::{Plane, Turn};
use tandem_model::{ArcPath, Axis, AxisVector};

use crate::look_ahead_rig::{Chain, Shape};
use crate::rig::{feed, line, segment};

/// A random number generator with the same numbers on every computer (splitmix64).
pub struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Returns a number that is distributed evenly over the orders of magnitude.
    pub fn magnitude(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.unit())
    }

    pub fn one_of<T: Copy>(&mut self, all: &[T]) -> T {
        all[usize::try_from(self.bits() % all.len() as u64).unwrap()]
    }
}

/// Returns the number of random chains: 2,000, or 200,000 with `TANDEM_LONG=1`.
pub fn chains() -> u64 {
    if std::env::var("TANDEM_LONG").is_ok_and(|value| value == "1") {
        200_000
    } else {
        2000
    }
}

/// Runs `check` with every seed below `seeds`, on all processors. The first seed that panics ends the run.
pub fn each_seed(seeds: u64, check: impl Fn(u64) + Sync) {
    let next = AtomicU64::new(0);
    let take_seeds = || {
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= seeds {
                return;
            }
            if let Err(panic) = catch_unwind(AssertUnwindSafe(|| check(seed))) {
                next.store(seeds, Ordering::Relaxed);
                resume_unwind(panic);
            }
            // The long run takes half an hour.
            if (seed + 1).is_multiple_of(5000) {
                eprintln!("seed {seed} of {seeds} passed");
            }
        }
    };
    thread::scope(|scope| {
        for _ in 0..thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(take_seeds);
        }
    });
}

/// Creates a random chain: lines, arcs, spirals and helices in all planes, with lengths over nine orders of
/// magnitude. It contains reversals, points at a distance of a micrometre, ramps from one servo period to 0.3
/// s, and limits over three orders of magnitude. In half of the chains A, B and C move too, or alone.
pub fn random(random: &mut Random, blocks: usize) -> Chain {
    let (accelerations, all) = random_blocks(random, blocks);
    Chain::new(&accelerations, all)
}

/// Returns maximum accelerations, and the blocks of [`random`].
pub fn random_blocks(random: &mut Random, blocks: usize) -> (Vec<f64>, Vec<(Segment, Shape)>) {
    let rotary = random.unit() < 0.5;
    let accelerations: Vec<f64> = (0..if rotary { 6 } else { 3 })
        .map(|_| random.magnitude(50.0, 20_000.0))
        .collect();
    let f = random.magnitude(60.0, 30_000.0);
    let times = [
        random.one_of(&[0.0, 1.0, 20.0, 100.0, 300.0]),
        random.one_of(&[0.0, 10.0, 100.0, 250.0]),
        random.one_of(&[0.0, 0.0, 5.0, 50.0, 100.0]),
    ];
    let lengths = random.one_of(&[[1e-3, 1e-3], [1e-3, 1e-1], [0.1, 1.0], [1.0, 50.0], [1e-6, 200.0]]);
    let style = random.one_of(&[0, 0, 1, 2, 3]);
    let mut at = AxisVector::ZERO;
    let mut angle = random.within(0.0, TAU);
    let mut all = Vec::new();
    for _ in 0..blocks {
        let own = feed(
            if style == 3 {
                random.magnitude(60.0, 30_000.0)
            } else {
                f
            },
            times,
        );
        let length = random.magnitude(lengths[0], lengths[1]);
        angle += match style {
            0 => random.within(-3.2, 3.2),
            1 => random.within(-0.2, 0.2),
            2 => random.one_of(&[0.0, std::f64::consts::PI, 1.5]),
            _ => random.within(-1.0, 1.0),
        };
        let mut turned = AxisVector::ZERO;
        if rotary && random.unit() < 0.5 {
            for axis in [Axis::A, Axis::B, Axis::C] {
                turned[axis] = length * random.one_of(&[0.0, -5.0, 0.1, 1.0]);
            }
        }
        let (segment, shape) = if style != 2 && random.unit() < 0.3 && length > 1e-5 {
            arc(at.plus(turned), at, angle, length, random, own)
        } else if rotary && turned != AxisVector::ZERO && random.unit() < 0.2 {
            (line(at, at.plus(turned), own), Shape::Line)
        } else {
            let z = if random.unit() < 0.3 {
                random.within(-1.0, 1.0)
            } else {
                0.0
            };
            let mut to = at.plus(turned);
            to.0[0] += length * angle.cos();
            to.0[1] += length * angle.sin();
            to.0[2] += length * z;
            (line(at, to, own), Shape::Line)
        };
        if let SegmentMotion::Feed { path, .. } = &segment.motion {
            at = path.end();
        }
        all.push((segment, shape));
    }
    (accelerations, all)
}

/// Creates an arc that begins in a direction. `turned` is its start, with the rotary axes of its end.
fn arc(
    turned: AxisVector,
    from: AxisVector,
    direction: f64,
    length: f64,
    random: &mut Random,
    feed: SegmentFeed,
) -> (Segment, Shape) {
    let plane = random.one_of(&[Plane::Xy, Plane::Xy, Plane::Zx, Plane::Yz]);
    let [first, second] = plane.axes();
    let swept = random.within(0.3, 6.0);
    let sense = random.one_of(&[1.0, -1.0]);
    let radius = length / swept;
    // A spiral: its radius at the end is half to twice the radius at the start, and clearly differs from it.
    let growth = if random.unit() < 0.3 && length > 1e-3 {
        radius * random.one_of(&[-0.5, -0.1, 0.1, 1.0])
    } else {
        0.0
    };
    let angle = direction - sense * TAU / 4.0;
    let centre = [
        from[first] - radius * angle.cos(),
        from[second] - radius * angle.sin(),
    ];
    let end = angle + sense * swept;
    let mut to = turned;
    to[first] = centre[0] + (radius + growth) * end.cos();
    to[second] = centre[1] + (radius + growth) * end.sin();
    if random.unit() < 0.3 {
        let height = [Axis::X, Axis::Y, Axis::Z]
            .into_iter()
            .find(|axis| *axis != first && *axis != second)
            .unwrap();
        to[height] += length * random.one_of(&[0.5, -2.0]);
    }
    let turn = if sense > 0.0 {
        Turn::CounterClockwise
    } else {
        Turn::Clockwise
    };
    let motion = SegmentMotion::Feed {
        path: Path::Arc(ArcPath::new(from, to, plane, centre, turn)),
        feed,
    };
    let shape = Shape::Arc {
        plane,
        centre,
        radius,
        growth,
        angle,
        sweep: sense * swept,
    };
    (segment(motion), shape)
}
