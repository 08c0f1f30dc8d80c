//! The values of the last servo cycle, which any number of readers read without a lock.

use std::sync::atomic::{AtomicU64, Ordering, fence};

use tandem_model::{AXES_MAX, AxisSet, AxisVector, MachinePosition, Origin};

/// Number of spins before a reader yields its processor, because the writer may wait for the same processor.
const SPINS_BEFORE_YIELD: u32 = 64;

/// The values of one servo cycle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Reading {
    /// Time of the cycle, s.
    pub time_s: f64,
    /// Commanded position.
    pub commanded: MachinePosition,
    /// Actual position. The following error is the commanded minus the actual position.
    pub actual: MachinePosition,
    /// Axes whose motor position refers to the machine's zero; the positions of other axes have no meaning.
    pub homed: AxisSet,
    /// Distance from the commanded position to the end of the current block, signed; zero between blocks.
    pub distance_to_go: AxisVector,
    /// Commanded speed along X, Y, Z, mm/min. If X, Y, Z rest, the speed along the other axes, deg/min.
    pub feedrate_mm_min: f64,
    /// Rate of the time base: 1.0 is the programmed speed, 0.0 is rest.
    pub rate: f64,
    /// Segment number of the current block or, between blocks, of the last block; 0 before the first block.
    pub segment: u64,
    /// Plan time within the block, s. Between two blocks it is the end of the block, or infinite.
    pub plan_s: f64,
    /// Origin of the block to which the commanded position belongs, including its end point. `None` if no
    /// block runs.
    pub executing: Option<Origin>,
    /// True under feed hold, including the deceleration and, in a thread, the wait for the end of the move
    /// out.
    pub held: bool,
    /// Actual spindle speed, r/min, clockwise positive.
    pub spindle_rpm: f64,
    /// Angle of the spindle, degrees, 0 to below 360, clockwise positive.
    pub spindle_deg: f64,
    /// True while the spindle rests at its orientation position after an orientation.
    pub oriented: bool,
}

const TIME: usize = 0;
const FEEDRATE: usize = 1;
const RATE: usize = 2;
const SEGMENT: usize = 3;
const PLACE: usize = 4;
const COLUMN: usize = 5;
const FLAGS: usize = 6;
const SPINDLE: usize = 7;
const ANGLE: usize = 8;
const PLAN: usize = 9;
const VECTORS: usize = 10;
const CELLS: usize = VECTORS + 3 * AXES_MAX;

const EXECUTING: u64 = 1;
const HELD: u64 = 2;
const ORIENTED: u64 = 4;
/// Bit of the flags at which the set of homed axes begins.
const HOMED_SHIFT: u32 = 8;

/// A snapshot that the servo cycle writes for any number of readers: a sequence lock of atomics. The writer
/// never waits. A reader that overlaps with a write reads again.
#[derive(Debug)]
pub struct Readings {
    /// Version of the snapshot; odd during a write.
    version: AtomicU64,
    cells: [AtomicU64; CELLS],
}

impl Default for Readings {
    fn default() -> Self {
        Self {
            version: AtomicU64::new(0),
            cells: std::array::from_fn(|_| AtomicU64::new(0)),
        }
    }
}

impl Readings {
    /// Returns the values of the last servo cycle. All values are from the same cycle.
    pub fn read(&self) -> Reading {
        let mut spins = 0_u32;
        loop {
            let before = self.version.load(Ordering::Acquire);
            let cells: [u64; CELLS] = std::array::from_fn(|i| self.cells[i].load(Ordering::Relaxed));
            fence(Ordering::Acquire);
            if before.is_multiple_of(2) && before == self.version.load(Ordering::Relaxed) {
                return unpack(&cells);
            }
            spins += 1;
            if spins.is_multiple_of(SPINS_BEFORE_YIELD) {
                std::thread::yield_now();
            } else {
                std::hint::spin_loop();
            }
        }
    }

    /// Writes the values of a cycle. The channel is the only writer.
    pub(crate) fn write(&self, reading: &Reading) {
        self.change(|cells| {
            let (single, vectors) = cells.split_at(VECTORS);
            for (cell, value) in single.iter().zip(pack(reading)) {
                cell.store(value, Ordering::Relaxed);
            }
            let values = [reading.commanded.0, reading.actual.0, reading.distance_to_go];
            for (cells, values) in vectors.chunks_exact(AXES_MAX).zip(&values) {
                for (cell, value) in cells.iter().zip(&values.0) {
                    cell.store(value.to_bits(), Ordering::Relaxed);
                }
            }
        });
    }

    /// Writes the time of a cycle that has changed nothing else.
    pub(crate) fn write_time(&self, time_s: f64) {
        self.change(|cells| cells[TIME].store(time_s.to_bits(), Ordering::Relaxed));
    }

    fn change(&self, store: impl FnOnce(&[AtomicU64; CELLS])) {
        let version = self.version.load(Ordering::Relaxed);
        self.version.store(version.wrapping_add(1), Ordering::Relaxed);
        fence(Ordering::Release);
        store(&self.cells);
        self.version.store(version.wrapping_add(2), Ordering::Release);
    }
}

/// Returns the cells before the cells of the vectors.
fn pack(reading: &Reading) -> [u64; VECTORS] {
    let mut cells = [0; VECTORS];
    cells[TIME] = reading.time_s.to_bits();
    cells[FEEDRATE] = reading.feedrate_mm_min.to_bits();
    cells[RATE] = reading.rate.to_bits();
    cells[SEGMENT] = reading.segment;
    cells[PLAN] = reading.plan_s.to_bits();
    cells[SPINDLE] = reading.spindle_rpm.to_bits();
    cells[ANGLE] = reading.spindle_deg.to_bits();
    if let Some(origin) = reading.executing {
        cells[PLACE] = u64::from(origin.program) << 32 | u64::from(origin.line);
        cells[COLUMN] = u64::from(origin.column);
        cells[FLAGS] |= EXECUTING;
    }
    cells[FLAGS] |= u64::from(reading.homed.bits()) << HOMED_SHIFT;
    if reading.held {
        cells[FLAGS] |= HELD;
    }
    if reading.oriented {
        cells[FLAGS] |= ORIENTED;
    }
    cells
}

fn unpack(cells: &[u64; CELLS]) -> Reading {
    let number = |i: usize| f64::from_bits(cells[i]);
    let vector = |n: usize| AxisVector(std::array::from_fn(|i| number(VECTORS + n * AXES_MAX + i)));
    let flag = |mask: u64| cells[FLAGS] & mask != 0;
    Reading {
        time_s: number(TIME),
        commanded: MachinePosition(vector(0)),
        actual: MachinePosition(vector(1)),
        homed: AxisSet::from_bits(low_bits(cells[FLAGS] >> HOMED_SHIFT)),
        distance_to_go: vector(2),
        feedrate_mm_min: number(FEEDRATE),
        rate: number(RATE),
        segment: cells[SEGMENT],
        plan_s: number(PLAN),
        executing: flag(EXECUTING).then(|| Origin {
            program: low_bits(cells[PLACE] >> 32),
            line: low_bits(cells[PLACE]),
            column: low_bits(cells[COLUMN]),
        }),
        held: flag(HELD),
        spindle_rpm: number(SPINDLE),
        spindle_deg: number(ANGLE),
        oriented: flag(ORIENTED),
    }
}

/// Returns the lowest bits of a cell, as [`pack`] has written them.
fn low_bits<T: TryFrom<u64> + Default>(cell: u64) -> T {
    let bits = 8 * size_of::<T>();
    T::try_from(cell & ((1 << bits) - 1)).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use std::sync::atomic::AtomicBool;

    fn sample(n: f64) -> Reading {
        Reading {
            time_s: n,
            commanded: MachinePosition(AxisVector([n; AXES_MAX])),
            actual: MachinePosition(AxisVector([n + 0.5; AXES_MAX])),
            homed: AxisSet::from_bits(0b1010_0101),
            distance_to_go: AxisVector([-n; AXES_MAX]),
            feedrate_mm_min: n * 60.0,
            rate: 1.0,
            segment: 7,
            plan_s: n * 2.0,
            executing: Some(Origin {
                program: 65_535,
                line: u32::MAX,
                column: 12,
            }),
            held: true,
            spindle_rpm: -n,
            spindle_deg: n + 0.25,
            oriented: true,
        }
    }

    #[test]
    fn a_reading_comes_back_as_written() {
        let readings = Readings::default();
        assert_eq!(readings.read(), Reading::default());
        readings.write(&sample(3.25));
        assert_eq!(readings.read(), sample(3.25));
    }

    #[test]
    fn a_reader_never_sees_two_cycles_mixed() {
        let readings = Arc::new(Readings::default());
        let done = Arc::new(AtomicBool::new(false));
        readings.write(&sample(0.0));
        let reader = {
            let (readings, done) = (readings.clone(), done.clone());
            std::thread::spawn(move || {
                let mut reads = 0_u32;
                while !done.load(Ordering::Relaxed) || reads < 1000 {
                    let reading = readings.read();
                    assert_eq!(reading, sample(reading.time_s));
                    reads += 1;
                }
            })
        };
        for n in 0..20_000 {
            readings.write(&sample(f64::from(n)));
        }
        done.store(true, Ordering::Relaxed);
        reader.join().unwrap();
    }
}
