//! The formulas of one cutting block from stop to stop and of one rapid motion, derived from the rules M1 and
//! M1e, not from the planner.

/// One servo period of the test machines, s.
pub const PERIOD_S: f64 = 0.001;

/// Tolerance of a run, s: it begins at most 3 periods late, ends on a servo tick, and is found in position
/// one period later.
pub const LATE_S: f64 = 0.0051;

/// A ramp: total time `ta + ts`, jerk phases of `ts` at both ends.
#[derive(Debug, Clone, Copy)]
pub struct Ramp {
    ta: f64,
    ts: f64,
}

impl Ramp {
    /// Times in seconds. `ta` is at least `ts` and at least one servo period.
    pub fn new(ta: f64, ts: f64) -> Self {
        Self {
            ta: ta.max(ts).max(PERIOD_S),
            ts,
        }
    }

    pub fn total(self) -> f64 {
        self.ta + self.ts
    }

    /// P(t): the integral of the unit ramp.
    pub fn integral(self, t: f64) -> f64 {
        let Ramp { ta, ts } = self;
        let total = self.total();
        if t <= 0.0 {
            0.0
        } else if t >= total {
            t - total / 2.0
        } else if t > ta {
            t - total / 2.0 + self.integral(total - t)
        } else if t > ts {
            let u = t - ts;
            ts * ts / (6.0 * ta) + ts * u / (2.0 * ta) + u * u / (2.0 * ta)
        } else {
            t.powi(3) / (6.0 * ta * ts)
        }
    }
}

/// One cutting block from stop to stop.
#[derive(Debug, Clone, Copy)]
pub struct Block {
    length: f64,
    v: f64,
    up: Ramp,
    down: Ramp,
    pub end_s: f64,
}

impl Block {
    /// Length in mm, speed in mm/s, times in s.
    pub fn new(length: f64, v: f64, ta: f64, td: f64, ts: f64) -> Self {
        let (up, down) = (Ramp::new(ta, ts), Ramp::new(td, ts));
        let ramps = up.total() + down.total();
        // A block too short to reach the speed: the ramps keep their time, and the peak is lower.
        let v = v.min(2.0 * length / ramps);
        Self {
            length,
            v,
            up,
            down,
            end_s: length / v + ramps / 2.0,
        }
    }

    /// M1b, `shrink`: a chain of equal blocks in one line that are shorter than their ramps. They run as one, whose
    /// ramps have shrunk to the time of one of them.
    pub fn of_short_ones(blocks: u32, length: f64, v: f64) -> Self {
        let ramp = Ramp {
            ta: length / v,
            ts: 0.0,
        };
        let length = f64::from(blocks) * length;
        Self {
            length,
            v,
            up: ramp,
            down: ramp,
            end_s: length / v + ramp.total(),
        }
    }

    /// Way at time t.
    pub fn way(self, t: f64) -> f64 {
        if t >= self.end_s {
            return self.length;
        }
        let brake = t - (self.end_s - self.down.total());
        self.v * (self.up.integral(t) - self.down.integral(brake))
    }
}

/// One motor's rapid motion: the least time with its own velocity and acceleration.
#[derive(Debug, Clone, Copy)]
pub struct Rapid {
    distance: f64,
    peak: f64,
    acceleration: f64,
    pub end_s: f64,
}

impl Rapid {
    /// Distance in mm, 0 or more; velocity in mm/s, acceleration in mm/s^2.
    pub fn new(distance: f64, velocity: f64, acceleration: f64) -> Self {
        let peak = velocity.min((distance * acceleration).sqrt());
        let end_s = if peak < velocity {
            2.0 * (distance / acceleration).sqrt()
        } else {
            distance / velocity + velocity / acceleration
        };
        Self {
            distance,
            peak,
            acceleration,
            end_s,
        }
    }

    /// Way at time t.
    pub fn way(self, t: f64) -> f64 {
        let ramp_s = self.peak / self.acceleration;
        let rest_s = self.end_s - t;
        if rest_s <= 0.0 {
            self.distance
        } else if t < ramp_s {
            self.acceleration * t * t / 2.0
        } else if rest_s < ramp_s {
            self.distance - self.acceleration * rest_s * rest_s / 2.0
        } else {
            self.peak * (t - ramp_s / 2.0)
        }
    }
}

/// Compares samples with a formula: sample k is the formula at k periods, the last one its end, exactly.
pub fn assert_samples(samples: &[f64], from: f64, direction: f64, end_s: f64, way: impl Fn(f64) -> f64) {
    let periods = (end_s / PERIOD_S - 1e-6).ceil();
    let mut moving = 0;
    for (k, sample) in samples.iter().enumerate() {
        let expected = from + direction * way(k as f64 * PERIOD_S);
        assert!(
            (sample - expected).abs() <= 1.1e-9,
            "sample {k} is {sample}, the formula gives {expected}"
        );
        moving += usize::from(k as f64 <= periods);
    }
    assert!(
        moving as f64 >= periods,
        "{moving} samples for {periods} periods of motion"
    );
}
