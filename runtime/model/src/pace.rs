//! The pace of a profile: with G500, the motion is slower than planned wherever a motor would otherwise
//! exceed its maximum acceleration (M1d).
//!
//! Plan time is the time of the motion without look-ahead; the rate is plan time per second. On each piece
//! the square of the rate is linear in plan time. Therefore the rate is linear in real time, and plan time is
//! quadratic in real time. On a piece with a [`SpeedGrowth`] the same holds for distance instead of plan
//! time. Where the jerk is limited, the rate is quadratic in time, or its change is linear in plan time.

use crate::hyperbolic;
use crate::speed_growth::SpeedGrowth;

/// Maximum number of pieces of one pace. A block that needs more pieces is divided into several profiles.
pub const PACE_PIECES_MAX: usize = 2;

/// A position on the path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathPlace {
    /// Number of the segment.
    pub segment: u64,
    /// Plan time within the block of this segment, s. Any later time, even infinite, means the end of the
    /// block.
    pub plan_s: f64,
}

/// The part of a block's plan time that a profile passes, at the rate 1, or at -1 if plan time falls.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stretch {
    /// Plan time at its start, s.
    pub from_s: f64,
    /// Plan time at its end, s.
    pub to_s: f64,
}

impl Stretch {
    /// Returns the stretch that passes a whole block of this plan time forward.
    pub fn whole(plan_s: f64) -> Self {
        Self {
            from_s: 0.0,
            to_s: plan_s,
        }
    }

    /// Returns true if plan time falls.
    pub fn is_backward(self) -> bool {
        self.to_s < self.from_s
    }

    /// Returns the duration of the stretch, s.
    pub fn duration_s(self) -> f64 {
        (self.to_s - self.from_s).abs()
    }

    /// Returns the plan time `t_s` seconds after the start of the stretch, s.
    pub fn plan_time(self, t_s: f64) -> f64 {
        if t_s >= self.duration_s() {
            self.to_s
        } else if self.is_backward() {
            self.from_s - t_s.max(0.0)
        } else {
            self.from_s + t_s.max(0.0)
        }
    }
}

/// Plan time as a function of time over one profile. In backward motion the rates are negative.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pace {
    pieces: [PacePiece; PACE_PIECES_MAX],
    count: usize,
    /// Plan time at the end of the profile, s.
    pub ends_s: f64,
    /// Feed override for which the full rate was planned.
    pub feed_override: f64,
    /// Segment to whose end the motion may continue as soon as this profile is known; in backward motion, to
    /// whose start. From there the motion can still come to rest within the known profiles.
    pub free_to: u64,
}

/// A piece of a pace.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PacePiece {
    /// Time within the profile at which the piece begins, s.
    pub begins_s: f64,
    /// Plan time at the start of the piece, s.
    pub plan_s: f64,
    /// Plan time per time at the start of the piece; 1 is the speed planned without look-ahead, a negative
    /// rate is backward motion.
    pub rate: f64,
    /// Change of the rate per second. With a growth, `rate` and its changes refer to distance instead of plan
    /// time.
    pub rate_change: f64,
    /// Change of `rate_change` per second.
    pub rate_jerk: f64,
    /// Change of `rate_change` per second of plan time, per second squared; 0 with a growth or a `rate_jerk`.
    pub rate_slope: f64,
    /// Growth of the programmed speed over the piece.
    pub growth: SpeedGrowth,
    /// Room that the motors leave to overrides and feed hold.
    pub room: SlewRoom,
}

impl PacePiece {
    /// Returns the plan time `past_s` seconds after the start of the piece, s.
    fn plan_time(&self, past_s: f64) -> f64 {
        if self.rate_slope != 0.0 {
            let [first, second] = hyperbolic::integrals(self.rate_slope, past_s);
            return self.plan_s + self.rate * first + self.rate_change * second;
        }
        let rate_change = self.rate_change + self.rate_jerk * past_s / 3.0;
        let distance_s = past_s * (self.rate + rate_change * past_s / 2.0);
        self.plan_s + self.growth.plan_s(distance_s)
    }

    /// Returns the time within the profile at which this plan time is reached, s, and the rate there. Returns
    /// `None` if the rate is 0 there and at the start of the piece.
    fn when(&self, plan_s: f64) -> Option<(f64, f64)> {
        let past_s = plan_s - self.plan_s;
        let distance_s = self.growth.distance_s(past_s);
        if self.rate_slope != 0.0 {
            let change = 2.0 * self.rate_change + self.rate_slope * past_s;
            let square = self.rate * self.rate + change * past_s;
            let rate = square.max(0.0).sqrt().copysign(self.rate);
            let time_s = hyperbolic::duration([self.rate, rate], self.rate_slope, past_s);
            return Some((self.begins_s + time_s, rate));
        }
        if self.rate_jerk != 0.0 {
            if self.rate == 0.0 {
                let time_s = (6.0 * distance_s / self.rate_jerk).max(0.0).cbrt();
                return Some((self.begins_s + time_s, self.rate_jerk * time_s * time_s / 2.0));
            }
            // The rate is the same polynomial of time as the speed of a growth is of plan time.
            let by_time = SpeedGrowth {
                first: self.rate_change / self.rate,
                second: self.rate_jerk / self.rate,
            };
            let time_s = by_time.plan_s(distance_s / self.rate);
            let rate = self.rate * by_time.speed(time_s);
            return Some((self.begins_s + time_s, rate / self.growth.speed(past_s)));
        }
        let square = self.rate * self.rate + 2.0 * self.rate_change * distance_s;
        let rate = square.max(0.0).sqrt().copysign(self.rate);
        let sum = self.rate + rate;
        (sum != 0.0).then(|| {
            let time_s = self.begins_s + 2.0 * distance_s / sum;
            (time_s, rate / self.growth.speed(past_s))
        })
    }
}

/// Limits of how fast an override factor `o`, 0 to 1, may change without any motor exceeding its maximum
/// acceleration a. Velocity V and acceleration A at 100 percent become `V o` and `A o^2 + V o'` (M1i).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SlewRoom {
    /// Smallest a/|V| of all motors, per second.
    pub slope: f64,
    /// Largest share of a that a motor uses for braking, 0 to 1.
    pub braking: f64,
    /// Largest share of a that a motor uses for speeding up, 0 to 1.
    pub driving: f64,
}

impl Default for SlewRoom {
    fn default() -> Self {
        Self {
            slope: f64::INFINITY,
            braking: 0.0,
            driving: 0.0,
        }
    }
}

impl SlewRoom {
    /// Returns the smaller room of the two, field by field.
    #[must_use]
    pub fn worst(self, other: SlewRoom) -> Self {
        Self {
            slope: self.slope.min(other.slope),
            braking: self.braking.max(other.braking),
            driving: self.driving.max(other.driving),
        }
    }

    /// Returns the room on the same path in the opposite direction.
    #[must_use]
    pub fn reversed(self) -> Self {
        Self {
            braking: self.driving,
            driving: self.braking,
            ..self
        }
    }

    /// Returns the largest fall of the override factor per second, starting at `factor`.
    pub fn fall(self, factor: f64) -> f64 {
        self.slope * (1.0 - self.braking * factor * factor).max(0.0)
    }

    /// Returns the square of the factor at `time_s` before the factor's square is `square`, if the factor
    /// falls as fast as this room and `slope` per second allow.
    pub fn square_before(&self, square: f64, slope: f64, time_s: f64) -> f64 {
        let by_room = if self.slope.is_finite() {
            let gained = 2.0 * self.slope * time_s;
            (square + gained) / (1.0 + gained * self.braking.min(1.0))
        } else {
            f64::INFINITY
        };
        by_room.min(square + 2.0 * slope * time_s)
    }

    /// Returns the largest rise of the override factor per second, starting at `factor`, to at most 1 within
    /// `period_s`: `s = slope (1 - driving (o + s T)^2)`, with `(o + s T)^2 <= o^2 + 2 s T`.
    pub fn rise(self, factor: f64, period_s: f64) -> f64 {
        let room = (1.0 - self.driving * factor * factor).max(0.0);
        room / (1.0 / self.slope + 2.0 * self.driving * period_s)
    }
}

impl Pace {
    /// Creates a pace from pieces in order of time. Pieces beyond [`PACE_PIECES_MAX`] are dropped.
    pub fn new(
        pieces: impl IntoIterator<Item = PacePiece>,
        ends_s: f64,
        feed_override: f64,
        free_to: u64,
    ) -> Self {
        let mut pace = Self {
            pieces: [PacePiece::default(); PACE_PIECES_MAX],
            count: 0,
            ends_s,
            feed_override,
            free_to,
        };
        for (place, piece) in pace.pieces.iter_mut().zip(pieces) {
            *place = piece;
            pace.count += 1;
        }
        pace
    }

    /// Returns the plan time at the start of the profile, s.
    pub fn begins_s(&self) -> f64 {
        self.pieces().first().map_or(self.ends_s, |first| first.plan_s)
    }

    /// Returns true if plan time falls.
    pub fn is_backward(&self) -> bool {
        self.ends_s < self.begins_s()
    }

    /// Returns true if the motion may continue through this segment once this profile is known.
    pub fn frees(&self, segment: u64) -> bool {
        if self.is_backward() {
            segment >= self.free_to
        } else {
            segment <= self.free_to
        }
    }

    /// Returns the time within the profile at which this plan time is reached, s, and the rate there. Returns
    /// `None` if the plan time is outside this profile.
    pub fn when(&self, plan_s: f64) -> Option<(f64, f64)> {
        let way_s = |to_s: f64| if self.is_backward() { -to_s } else { to_s };
        if way_s(plan_s) < way_s(self.begins_s()) || way_s(plan_s) >= way_s(self.ends_s) {
            return None;
        }
        let begun = self
            .pieces()
            .partition_point(|piece| way_s(piece.plan_s) <= way_s(plan_s));
        self.pieces().get(begun.saturating_sub(1))?.when(plan_s)
    }

    /// Returns the pieces in order of time.
    pub fn pieces(&self) -> &[PacePiece] {
        self.pieces.get(..self.count).unwrap_or(&[])
    }

    /// Returns the plan time `t_s` seconds after the start of the profile, s.
    pub fn plan_time(&self, t_s: f64) -> f64 {
        let pieces = self.pieces();
        let begun = pieces.partition_point(|piece| piece.begins_s <= t_s);
        let Some(piece) = pieces.get(begun.saturating_sub(1)) else {
            return self.ends_s;
        };
        let plan_s = piece.plan_time((t_s - piece.begins_s).max(0.0));
        if self.is_backward() {
            plan_s.max(self.ends_s)
        } else {
            plan_s.min(self.ends_s)
        }
    }

    /// Returns the room that the motors leave between two times of the profile.
    pub fn room(&self, from_s: f64, to_s: f64) -> SlewRoom {
        let pieces = self.pieces();
        let first = pieces
            .partition_point(|piece| piece.begins_s <= from_s)
            .saturating_sub(1);
        pieces
            .iter()
            .skip(first)
            .take_while(|piece| piece.begins_s <= from_s.max(to_s))
            .fold(SlewRoom::default(), |room, piece| room.worst(piece.room))
    }
}
