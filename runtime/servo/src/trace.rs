//! The recent motion of the axes: samples of the last minute, which any number of readers read without a
//! lock.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering, fence};

use tandem_model::{Axis, AxisSet, AxisVector};

/// Number of samples that are kept.
pub const TRACE_SAMPLES: u64 = 6000;

/// Time between two samples, s, rounded down to whole servo periods.
const INTERVAL_S: f64 = 0.01;

/// Cells of a sample before the cells of its axes: time, feedrate and spindle.
const COMMON: usize = 3;
/// Cells of each axis.
const EACH: usize = 4;

/// One sample of the motion.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TraceSample {
    /// Time of the sampled servo cycle, s.
    pub time_s: f64,
    /// Commanded speed on the path, mm/min.
    pub feedrate_mm_min: f64,
    /// Actual spindle speed, r/min, clockwise positive.
    pub spindle_rpm: f64,
    /// Motion of each axis, in the order of [`Trace::axes`].
    pub motions: Vec<TraceMotion>,
}

/// Motion of an axis in one servo cycle, mm or degrees.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TraceMotion {
    /// Commanded machine position.
    pub position: f64,
    /// Change of the commanded position in the cycle, mm or degrees per second.
    pub velocity: f64,
    /// Change of the velocity in the cycle, mm or degrees per second squared.
    pub acceleration: f64,
    /// Commanded minus actual position.
    pub following_error: f64,
}

/// A ring of atomics with the samples, which the servo cycle writes. The writer never waits. A reader omits
/// samples that were overwritten while it read.
#[derive(Debug)]
pub struct Trace {
    axes: Vec<Axis>,
    interval_s: f64,
    /// Number of samples whose writing has begun, including the complete samples; `complete` is the number of
    /// complete samples.
    begun: AtomicU64,
    complete: AtomicU64,
    cells: Box<[AtomicU64]>,
}

impl Trace {
    fn new(axes: AxisSet, interval_s: f64) -> Self {
        let axes: Vec<Axis> = axes.iter().collect();
        let count = usize::try_from(TRACE_SAMPLES).unwrap_or(0) * (COMMON + EACH * axes.len());
        Self {
            axes,
            interval_s,
            begun: AtomicU64::new(0),
            complete: AtomicU64::new(0),
            cells: (0..count).map(|_| AtomicU64::new(0)).collect(),
        }
    }

    /// Returns the traced axes.
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// Returns the time between two samples, s.
    pub fn interval_s(&self) -> f64 {
        self.interval_s
    }

    /// Returns up to `count` samples from the number `from` on, or from the oldest kept sample if that is
    /// newer. Also returns the number of the first returned sample. Numbers start at 0.
    pub fn read(&self, from: u64, count: usize) -> (u64, Vec<TraceSample>) {
        let complete = self.complete.load(Ordering::Acquire);
        let first = from.clamp(complete.saturating_sub(TRACE_SAMPLES), complete);
        let samples: Vec<_> = (first..complete).take(count).map(|n| self.sample(n)).collect();
        fence(Ordering::Acquire);
        let oldest = self.begun.load(Ordering::Relaxed).saturating_sub(TRACE_SAMPLES);
        let lost = oldest.saturating_sub(first);
        let skip = usize::try_from(lost).unwrap_or(usize::MAX);
        (first + lost, samples.into_iter().skip(skip).collect())
    }

    fn sample(&self, number: u64) -> TraceSample {
        let mut values = self
            .cells_of(number)
            .iter()
            .map(|cell| f64::from_bits(cell.load(Ordering::Relaxed)));
        let mut next = || values.next().unwrap_or_default();
        TraceSample {
            time_s: next(),
            feedrate_mm_min: next(),
            spindle_rpm: next(),
            motions: (0..self.axes.len())
                .map(|_| TraceMotion {
                    position: next(),
                    velocity: next(),
                    acceleration: next(),
                    following_error: next(),
                })
                .collect(),
        }
    }

    fn cells_of(&self, number: u64) -> &[AtomicU64] {
        let width = COMMON + EACH * self.axes.len();
        let place = usize::try_from(number % TRACE_SAMPLES).unwrap_or(0) * width;
        &self.cells[place..place + width]
    }

    /// Writes a sample. The channel is the only writer.
    fn write(&self, cycle: &Cycle, acceleration: AxisVector) {
        let number = self.complete.load(Ordering::Relaxed);
        self.begun.store(number + 1, Ordering::Relaxed);
        fence(Ordering::Release);
        let mut cells = self.cells_of(number).iter();
        let mut put = |value: f64| {
            if let Some(cell) = cells.next() {
                cell.store(value.to_bits(), Ordering::Relaxed);
            }
        };
        put(cycle.time_s);
        put(cycle.feedrate_mm_min);
        put(cycle.spindle_rpm);
        for &axis in &self.axes {
            put(cycle.commanded[axis]);
            put(cycle.velocity[axis]);
            put(acceleration[axis]);
            put(cycle.commanded[axis] - cycle.actual[axis]);
        }
        self.complete.store(number + 1, Ordering::Release);
    }
}

/// The values of a servo cycle that the trace records.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cycle {
    pub(crate) time_s: f64,
    pub(crate) feedrate_mm_min: f64,
    pub(crate) spindle_rpm: f64,
    pub(crate) commanded: AxisVector,
    pub(crate) actual: AxisVector,
    pub(crate) velocity: AxisVector,
}

/// The writing end of a trace.
#[derive(Debug)]
pub(crate) struct Tracer {
    trace: Arc<Trace>,
    period_s: f64,
    /// Number of cycles from one sample to the next; `left` is the number of remaining cycles.
    every: u32,
    left: u32,
    /// Velocity of the cycle before the next sample. `None` if it is unknown.
    before: Option<AxisVector>,
}

impl Tracer {
    pub(crate) fn new(axes: AxisSet, period_s: f64) -> Self {
        let mut every = 1;
        while f64::from(every + 1) * period_s <= INTERVAL_S * 1.001 {
            every += 1;
        }
        Self {
            trace: Arc::new(Trace::new(axes, f64::from(every) * period_s)),
            period_s,
            every,
            left: 0,
            before: Some(AxisVector::ZERO),
        }
    }

    pub(crate) fn trace(&self) -> Arc<Trace> {
        Arc::clone(&self.trace)
    }

    /// Records the velocity of each cycle. If a sample is due, returns the acceleration of the cycle.
    pub(crate) fn see(&mut self, velocity: AxisVector) -> Option<AxisVector> {
        if self.left > 0 {
            self.left -= 1;
            if self.left == 0 {
                self.before = Some(velocity);
            }
            return None;
        }
        // After skipped cycles, the previous velocity is unknown, so the sample is taken one cycle later.
        let before = self.before.replace(velocity)?;
        self.left = self.every - 1;
        Some(velocity.minus(before).scaled(1.0 / self.period_s))
    }

    /// Writes the sample of a cycle for which [`Tracer::see`] has returned an acceleration.
    pub(crate) fn keep(&self, cycle: &Cycle, acceleration: AxisVector) {
        self.trace.write(cycle, acceleration);
    }

    /// Records that simulated time has skipped these cycles.
    pub(crate) fn skip(&mut self, cycles: u64) {
        self.before = None;
        self.left = self
            .left
            .saturating_sub(u32::try_from(cycles).unwrap_or(u32::MAX));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_S: f64 = 0.001;

    fn x(value: f64) -> AxisVector {
        let mut vector = AxisVector::ZERO;
        vector[Axis::X] = value;
        vector
    }

    fn axes() -> AxisSet {
        [Axis::X].into_iter().collect()
    }

    fn cycle(n: u32) -> Cycle {
        Cycle {
            time_s: f64::from(n) * PERIOD_S,
            feedrate_mm_min: 0.0,
            spindle_rpm: 0.0,
            commanded: x(f64::from(n)),
            actual: x(f64::from(n) - 0.25),
            velocity: x(f64::from(n) * 2.0),
        }
    }

    fn see(tracer: &mut Tracer, cycle: &Cycle) {
        if let Some(acceleration) = tracer.see(cycle.velocity) {
            tracer.keep(cycle, acceleration);
        }
    }

    #[test]
    fn every_tenth_1_ms_cycle_is_recorded_with_its_velocity_change() {
        let mut tracer = Tracer::new(axes(), PERIOD_S);
        (1..=31).for_each(|n| see(&mut tracer, &cycle(n)));
        let (first, samples) = tracer.trace().read(0, 100);
        assert_eq!(first, 0);
        let kept: Vec<_> = samples.iter().map(|sample| sample.motions[0].position).collect();
        assert_eq!(kept, [1.0, 11.0, 21.0, 31.0]);
        let motion = samples[1].motions[0];
        assert_eq!((motion.velocity, motion.following_error), (22.0, 0.25));
        assert!((motion.acceleration - 2.0 / PERIOD_S).abs() < 1e-6, "{motion:?}");
        let (first, rest) = tracer.trace().read(3, 100);
        assert_eq!((first, rest.len()), (3, 1));
        assert_eq!(tracer.trace().read(900, 100), (4, vec![]));
    }

    #[test]
    fn behind_cycles_that_were_left_out_no_acceleration_is_made_up() {
        let mut tracer = Tracer::new(axes(), PERIOD_S);
        see(&mut tracer, &cycle(1));
        tracer.skip(500);
        see(&mut tracer, &cycle(502));
        see(&mut tracer, &cycle(503));
        let (_, samples) = tracer.trace().read(0, 10);
        let kept: Vec<_> = samples.iter().map(|sample| sample.motions[0].position).collect();
        assert_eq!(kept, [1.0, 503.0]);
    }

    #[test]
    fn the_last_6000_samples_are_kept() {
        let mut tracer = Tracer::new(axes(), 0.01);
        (0..7000).for_each(|n| see(&mut tracer, &cycle(n)));
        let (first, samples) = tracer.trace().read(0, usize::MAX);
        assert_eq!((first, samples.len()), (1000, 6000));
        assert_eq!(samples[0].motions[0].position.to_bits(), 1000.0_f64.to_bits());
    }

    #[test]
    fn a_reader_beside_the_writer_never_sees_two_samples_mixed() {
        let mut tracer = Tracer::new(axes(), 0.01);
        let trace = tracer.trace();
        let reader = std::thread::spawn(move || {
            for _ in 0..200 {
                for sample in trace.read(0, usize::MAX).1 {
                    let motion = sample.motions[0];
                    assert_eq!(motion.velocity.to_bits(), (motion.position * 2.0).to_bits());
                }
            }
        });
        let mut n = 0;
        while !reader.is_finished() {
            see(&mut tracer, &cycle(n % 100_000));
            n += 1;
        }
        reader.join().unwrap();
    }
}
