//! The motion along a part of the path, and its output as steps of the rate.

use tandem_model::hyperbolic;
use tandem_model::profile::SlewRoom;

use super::cell::{Cell, Row};
use crate::limit::ACCELERATION_RESERVE;
use crate::look_ahead::step::RateStep;

/// Motion along one cell: its square of the speed, acceleration and change of the acceleration at a distance from the start
/// follow from the kind.
#[derive(Debug, Clone)]
pub(super) struct CellLaw {
    pub(super) cell: Cell,
    pub(super) kind: Kind,
}

#[derive(Debug, Clone, Copy)]
pub(super) enum Kind {
    /// From rest at the start of the cell, with a constant jerk along the path.
    FromRest { jerk: f64 },
    /// To rest at the end of the cell, with a constant jerk along the path.
    ToRest { jerk: f64 },
    /// The acceleration is linear in distance.
    Linear {
        /// Square of the speed at the start.
        square: f64,
        /// Acceleration at the start.
        acceleration: f64,
        /// Change of the acceleration per distance.
        change: f64,
    },
}

impl CellLaw {
    pub(super) fn end_distance(&self) -> f64 {
        self.cell.from + self.cell.length
    }

    /// Returns the square of the speed and the acceleration at an offset.
    pub(super) fn state(&self, offset: f64) -> [f64; 2] {
        let after = |jerk: f64, distance: f64| {
            let time_s = (6.0 * distance.max(0.0) / jerk).cbrt();
            [(jerk * time_s * time_s / 2.0).powi(2), jerk * time_s]
        };
        match self.kind {
            Kind::FromRest { jerk } => after(jerk, offset),
            Kind::ToRest { jerk } => {
                let [square, acceleration] = after(jerk, self.cell.length - offset);
                [square, -acceleration]
            }
            Kind::Linear {
                square,
                acceleration,
                change,
            } => [
                (square + offset * (2.0 * acceleration + change * offset)).max(0.0),
                acceleration + change * offset,
            ],
        }
    }

    /// Returns the step between two offsets, for a block with a speed, whose plan time is `from_s` at the first.
    pub(super) fn step(&self, [from, to]: [f64; 2], from_s: f64, speed: f64) -> RateStep {
        let [[start, acceleration], [end, _]] = [self.state(from), self.state(to)];
        let [jerk, change] = match self.kind {
            Kind::FromRest { jerk } | Kind::ToRest { jerk } => [jerk, 0.0],
            Kind::Linear { change, .. } => [0.0, change],
        };
        RateStep {
            from_s,
            to_s: from_s + (to - from) / speed,
            start: start / (speed * speed),
            end: end / (speed * speed),
            rate_change: acceleration / speed,
            rate_jerk: jerk / speed,
            rate_slope: change,
            duration_s: Some(self.duration_s([from, to])),
            room: self.room([from, to]),
            ..RateStep::default()
        }
    }

    /// Returns the time between two offsets, s.
    pub(super) fn duration_s(&self, [from, to]: [f64; 2]) -> f64 {
        let since = |jerk: f64, distance: f64| (6.0 * distance.max(0.0) / jerk).cbrt();
        match self.kind {
            Kind::FromRest { jerk } => since(jerk, to) - since(jerk, from),
            Kind::ToRest { jerk } => {
                let length = self.cell.length;
                since(jerk, length - from) - since(jerk, length - to)
            }
            Kind::Linear { change, .. } => {
                let speeds = [from, to].map(|offset| self.state(offset)[0].sqrt());
                hyperbolic::duration(speeds, change, to - from)
            }
        }
    }

    /// Returns the room that the motors leave to overrides and feed hold between two offsets.
    fn room(&self, [from, to]: [f64; 2]) -> SlewRoom {
        let rows = || self.cell.rows.iter();
        let before = rows().rev().find(|row| row.at < from).map_or(from, |row| row.at);
        let after = rows().find(|row| row.at > to).map_or(to, |row| row.at);
        rows()
            .filter(|row| (before..=after).contains(&row.at))
            .fold(SlewRoom::default(), |room, row| room.worst(self.room_at(row)))
    }

    fn room_at(&self, row: &Row) -> SlewRoom {
        let [square, acceleration] = self.state(row.at);
        let used = row.second * square + row.first * acceleration;
        let along = used * row.first.signum() * (1.0 - ACCELERATION_RESERVE);
        SlewRoom {
            slope: 1.0 / (row.first.abs() * square.sqrt()),
            braking: (-along).max(0.0),
            driving: along.max(0.0),
        }
    }
}
