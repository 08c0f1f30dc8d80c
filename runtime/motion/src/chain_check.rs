//! Properties of chains that a program determines, without look-ahead: the distance of the path from corners, and the
//! limits of the motors that G501 exceeds.

use tandem_model::flow::{Path, Segment, SegmentEnd, SegmentMotion};
use tandem_model::profile::RampedMotion;
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{AXES_MAX, Alarm, Axis, AxisVector, Origin};

use crate::block::{BlockMotion, ChainBlock, PlannedBlock};
use crate::chain::Chain;
use crate::planner::ChainKind;
use crate::ramped;
use crate::smooth::Smoothing;

/// Factor of a limit from which it is exceeded; less is rounding.
const EXCEEDED_FROM: f64 = 1.001;

/// Number of points of an arc between its ramps at which the acceleration is calculated.
const ARC_POINTS: u32 = 8;

/// A programmed corner that the path misses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MissedCorner {
    /// Block that ends at the corner.
    pub origin: Origin,
    /// Distance of the path from the corner, mm.
    pub distance_mm: f64,
}

/// A limit that the plan of a block exceeds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExceededLimit {
    /// Axis of the motor.
    pub axis: Axis,
    /// Name of the limit's key.
    pub limit: &'static str,
    /// The planned value divided by the limit.
    pub factor: f64,
    /// Block with the largest factor.
    pub origin: Origin,
}

/// The check of the chains of one coordinate system.
#[derive(Debug)]
pub struct ChainCheck {
    settings: CoordinateSystemSettings,
    kind: ChainKind,
    chain: Chain,
    smoothing: Smoothing,
    segment: u64,
    found: ChainFindings,
}

#[derive(Debug)]
struct ChainFindings {
    /// Distance from which a corner is reported, mm.
    corners_from_mm: f64,
    corners: Vec<MissedCorner>,
    /// 1 divided by the maximum acceleration and the maximum jerk of each axis; 0 without a limit.
    inverse: [[f64; AXES_MAX]; 2],
    worst: [[Option<(f64, Origin)>; AXES_MAX]; 2],
}

impl ChainCheck {
    /// Creates a check that reports corners which the path misses by more than this distance, mm. A distance of 0
    /// reports none.
    pub fn new(settings: &CoordinateSystemSettings, corners_from_mm: f64) -> Self {
        let inverse = |limit: Option<f64>| {
            limit
                .filter(|limit| *limit > 0.0)
                .map_or(0.0, |limit| 1.0 / limit)
        };
        let motors = settings.motors.each_ref().map(Option::as_ref);
        Self {
            kind: ChainKind::Programmed,
            chain: Chain::default(),
            smoothing: Smoothing::new(settings.motion.path_tolerance_mm),
            segment: 0,
            found: ChainFindings {
                corners_from_mm: if corners_from_mm > 0.0 {
                    corners_from_mm
                } else {
                    f64::INFINITY
                },
                corners: Vec::new(),
                inverse: [
                    motors.map(|motor| inverse(motor.map(|motor| motor.max_acceleration))),
                    motors.map(|motor| inverse(motor.and_then(|motor| motor.max_jerk))),
                ],
                worst: [[None; AXES_MAX]; 2],
            },
            settings: settings.clone(),
        }
    }

    /// Adds a segment.
    ///
    /// # Errors
    /// Returns the alarm with which the motion stage would reject the segment.
    pub fn push(&mut self, segment: &Segment) -> Result<(), Alarm> {
        let SegmentMotion::Feed { path, feed } = &segment.motion else {
            self.finish();
            return Ok(());
        };
        let alone = ramped::plan(&self.settings, path, *feed, segment.multi_block)?;
        let kind = ChainKind::of_block(&self.settings, segment.multi_block, feed.keeps_path);
        if kind != self.kind {
            self.finish();
            self.kind = kind;
        }
        self.segment += 1;
        let block = ChainBlock {
            segment: self.segment,
            epoch: 0,
            origin: segment.origin,
            path: path.clone(),
            alone,
        };
        let found = &mut self.found;
        if kind == ChainKind::Smoothed {
            self.smoothing.push(&block, |block| found.add(kind, &block));
        } else {
            let rule = self.settings.motion.short_block;
            self.chain.push(rule, block, |block| found.add(kind, &block));
        }
        if segment.end == SegmentEnd::ExactStop {
            self.finish();
        }
        Ok(())
    }

    /// Ends the current chain.
    pub fn finish(&mut self) {
        let (kind, found) = (self.kind, &mut self.found);
        if kind == ChainKind::Smoothed {
            self.smoothing.finish(|block| found.add(kind, &block));
        } else {
            let rule = self.settings.motion.short_block;
            self.chain.finish(rule, |block| found.add(kind, &block));
        }
    }

    /// Returns the corners found since the last call.
    pub fn take_corners(&mut self) -> Vec<MissedCorner> {
        std::mem::take(&mut self.found.corners)
    }

    /// Returns the limits that G501 exceeds, each with its largest factor.
    pub fn exceeded(&self) -> impl Iterator<Item = ExceededLimit> {
        let names = ["max_acceleration", "max_jerk"];
        self.found.worst.iter().zip(names).flat_map(|(worst, limit)| {
            Axis::ALL.into_iter().zip(worst).filter_map(move |(axis, worst)| {
                let (factor, origin) = (*worst)?;
                Some(ExceededLimit {
                    axis,
                    limit,
                    factor,
                    origin,
                })
            })
        })
    }
}

impl ChainFindings {
    fn add(&mut self, kind: ChainKind, planned: &PlannedBlock) {
        let corner_mm = match &planned.motion {
            BlockMotion::Ramped { block, .. } => {
                if kind == ChainKind::Programmed {
                    self.compare(planned.origin, block);
                }
                block.corner_distance(self.corners_from_mm)
            }
            BlockMotion::Smoothed(block) => Some(block.corner_distance()),
        };
        if let Some(distance_mm) = corner_mm.filter(|distance| *distance > self.corners_from_mm) {
            self.corners.push(MissedCorner {
                origin: planned.origin,
                distance_mm,
            });
        }
    }

    /// Compares the ramps of a block, and an arc between them, with the limits.
    fn compare(&mut self, origin: Origin, block: &RampedMotion) {
        let stop_s = block.plan_s - block.stop.duration_s();
        let middle = |ramp_from_s: f64, duration_s: f64| ramp_from_s + duration_s / 2.0;
        if block.begun_s == 0.0 {
            let at_s = middle(0.0, block.start.duration_s());
            self.compare_ramp(origin, block, at_s, block.start.jerk_time_s());
        }
        self.compare_ramp(
            origin,
            block,
            middle(stop_s, block.stop.duration_s()),
            block.stop.jerk_time_s(),
        );
        if let Path::Arc(_) = block.path {
            let begin_s = block.start.duration_s() - block.begun_s;
            for k in 0..=ARC_POINTS {
                let at_s = begin_s + (stop_s - begin_s) * f64::from(k) / f64::from(ARC_POINTS);
                let [_, acceleration] = block.motion_at(at_s, f64::midpoint(begin_s, stop_s));
                self.keep_worst(0, origin, acceleration);
            }
        }
    }

    /// Compares the middle of a ramp. At its ends the acceleration changes by that of the middle in the jerk time.
    fn compare_ramp(&mut self, origin: Origin, block: &RampedMotion, at_s: f64, jerk_time_s: f64) {
        let [_, acceleration] = block.motion_at(at_s, at_s);
        self.keep_worst(0, origin, acceleration);
        // Without a jerk time the acceleration steps, which exceeds any limit.
        self.keep_worst(1, origin, acceleration.scaled(1.0 / jerk_time_s));
    }

    fn keep_worst(&mut self, quantity: usize, origin: Origin, value: AxisVector) {
        let compared = value
            .0
            .iter()
            .zip(&self.inverse[quantity])
            .zip(&mut self.worst[quantity]);
        for ((value, inverse), worst) in compared {
            if *value == 0.0 || *inverse == 0.0 {
                continue;
            }
            let factor = value.abs() * inverse;
            if factor > worst.map_or(EXCEEDED_FROM, |(factor, _)| factor) {
                *worst = Some((factor, origin));
            }
        }
    }
}
