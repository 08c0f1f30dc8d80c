//! Speed of the path stage on 102,000 blocks: 1000 squares with rounded corners. Each side has 13 lines, each
//! corner 12 arcs or 12 chords; one block leads in and one leads out.
//!
//! Medians in millions of blocks a second, on one core of an AMD EPYC virtual machine with two cores and
//! other load:
//!
//! | blocks | without compensation | with compensation |
//! | --- | --- | --- |
//! | lines | 4.8 | 1.6 |
//! | lines and arcs | 3.4 | 1.1 |

use divan::Bencher;
use divan::counter::ItemsCount;
use tandem_model::flow::{
    Action, Arc, ArcShape, AxisWords, Block, Compensation, Distance, Frame, MultiBlock, PathControl,
    ProgrammedFeed, Segment,
};
use tandem_model::plane::{Plane, Turn};
use tandem_model::settings::{CoordinateSystemSettings, MotorKind, MotorSettings, Unit};
use tandem_model::{Axis, AxisSet, AxisVector, MachinePosition, Origin};
use tandem_path::PathStage;

const SQUARES: u32 = 1000;

/// Number of blocks of one square, including lead-in and lead-out.
const BLOCKS: usize = 102;

fn main() {
    divan::main();
}

fn settings() -> CoordinateSystemSettings {
    let motor = |number| {
        Some(MotorSettings {
            soft_limits: Some([-1000.0, 1000.0]),
            ..MotorSettings::new(number, MotorKind::Linear, 500.0, 5000.0)
        })
    };
    CoordinateSystemSettings {
        motors: [motor(1), motor(2), motor(3), None, None, None, None, None],
        ..CoordinateSystemSettings::default()
    }
}

/// Returns the blocks of squares of 50 mm whose corners have a radius of 10 mm. Sides and corners consist of
/// short blocks; a corner has 12 arcs or 12 chords.
fn squares(arcs: bool, compensation: Compensation) -> Vec<Block> {
    let mut blocks = Vec::new();
    for square in 0..SQUARES {
        let z = f64::from(square) * 0.001;
        let mut points = vec![((-20.0, -25.0), None)];
        for side in 0..4_u32 {
            let (sin, cos) = (f64::from(side) * std::f64::consts::FRAC_PI_2).sin_cos();
            let turn = |u: f64, v: f64| (cos * u - sin * v, sin * u + cos * v);
            for i in 1..=13_u32 {
                points.push((turn(-15.0 + 30.0 * f64::from(i) / 13.0, -25.0), None));
            }
            for i in 1..=12_u32 {
                let angle = std::f64::consts::FRAC_PI_2 * (f64::from(i) / 12.0 - 1.0);
                let point = turn(15.0 + 10.0 * angle.cos(), -15.0 + 10.0 * angle.sin());
                points.push((point, arcs.then(|| turn(15.0, -15.0))));
            }
        }
        points.push(((-10.0, -15.0), None));
        // The lead-in begins within the square, where the lead-out of the square before has ended.
        points[0] = ((-15.0, -25.0), None);
        let mut at = (-10.0, -15.0);
        let last = points.len() - 1;
        for (i, (to, centre)) in points.into_iter().enumerate() {
            let mut target = AxisWords {
                values: AxisVector::ZERO,
                named: [Axis::X, Axis::Y, Axis::Z].into_iter().collect::<AxisSet>(),
                distance: Distance::Absolute,
                frame: Frame::Work,
            };
            target.values.0[..3].copy_from_slice(&[to.0, to.1, z]);
            let action = match centre {
                None => Action::Linear(target),
                Some((u, v)) => Action::Arc(Box::new(Arc {
                    target,
                    plane: Plane::Xy,
                    turn: Turn::CounterClockwise,
                    shape: ArcShape::Centre([u - at.0, v - at.1, 0.0]),
                })),
            };
            blocks.push(Block {
                origin: Origin {
                    program: 1,
                    line: u32::try_from(blocks.len()).unwrap_or_default() + 1,
                    column: 1,
                },
                action,
                feed: ProgrammedFeed {
                    feedrate_mm_min: 3000.0,
                    ta_ms: 100.0,
                    td_ms: 100.0,
                    ts_ms: 50.0,
                },
                unit: Unit::default(),
                feedrate_deg_min: 3000.0,
                path_control: PathControl::ContinuousPath,
                exact_stop_before: false,
                exact_stop_after: false,
                multi_block: MultiBlock::Off,
                compensation: if i == last {
                    Compensation::Off
                } else {
                    compensation
                },
            });
            at = to;
        }
    }
    assert_eq!(blocks.len(), BLOCKS * SQUARES as usize);
    blocks
}

fn run(bencher: Bencher<'_, '_>, arcs: bool, compensation: Compensation) {
    let blocks = squares(arcs, compensation);
    let settings = settings();
    let mut out: Vec<Segment> = Vec::new();
    bencher.counter(ItemsCount::new(blocks.len())).bench_local(|| {
        let mut stage = PathStage::new(&settings, MachinePosition::default());
        let mut count = 0;
        for block in &blocks {
            assert_eq!(stage.push(block, &mut out), Ok(()));
            count += out.len();
            out.clear();
        }
        count
    });
}

const LEFT: Compensation = Compensation::Left {
    radius: 3.0,
    plane: Plane::Xy,
};

#[divan::bench(sample_count = 20)]
fn lines(bencher: Bencher<'_, '_>) {
    run(bencher, false, Compensation::Off);
}

#[divan::bench(sample_count = 20)]
fn lines_compensated(bencher: Bencher<'_, '_>) {
    run(bencher, false, LEFT);
}

#[divan::bench(sample_count = 20)]
fn lines_and_arcs(bencher: Bencher<'_, '_>) {
    run(bencher, true, Compensation::Off);
}

#[divan::bench(sample_count = 20)]
fn lines_and_arcs_compensated(bencher: Bencher<'_, '_>) {
    run(bencher, true, LEFT);
}
