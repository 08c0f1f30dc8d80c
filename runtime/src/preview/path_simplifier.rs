//! Reduces a polyline of many points in space and time to the fewest points that its tolerance allows.

/// A point of the path in mm, and the time at which the point is reached in s.
pub(super) type PathPoint = ([f64; 3], f64);

/// Tolerance of the time at which a point is reached, s. Reason: the display of a run's progress need not be
/// more exact.
const LATE_S: f64 = 0.02;

/// Selects points so that the straight lines between them pass all omitted points within the tolerance. A
/// cone of directions starts at the last selected point and narrows with each added point. A point outside
/// the cone begins the next line. This is the sleeve algorithm of Zhao and Saalfeld, with time as a further
/// direction.
#[derive(Debug)]
pub(super) struct PathSimplifier {
    tolerance: f64,
    from: PathPoint,
    end: PathPoint,
    cone: Option<SlopeCone>,
}

/// Range of slopes with which a line passes all points added so far. Slopes are relative to the distance
/// along the first direction.
#[derive(Debug, Clone, Copy)]
struct SlopeCone {
    along: [f64; 3],
    across: [[f64; 3]; 2],
    /// Lowest and highest slope: in both directions across the line, and of time.
    slopes: [[f64; 2]; 3],
    reach: f64,
}

impl PathSimplifier {
    pub fn new(tolerance: f64, from: PathPoint) -> Self {
        Self {
            tolerance,
            from,
            end: from,
            cone: None,
        }
    }

    /// Returns the last added point.
    pub fn end_point(&self) -> PathPoint {
        self.end
    }

    /// Adds a point. If the current line cannot pass the point within the tolerance, returns the end of that
    /// line.
    pub fn push(&mut self, point: PathPoint) -> Option<PathPoint> {
        let mut given = None;
        match self.cone {
            None => self.cone = SlopeCone::to(self.from, point, self.tolerance),
            Some(cone) => {
                self.cone = cone.narrowed(self.from, point, self.tolerance);
                if self.cone.is_none() {
                    given = Some(self.end);
                    self.from = self.end;
                    self.cone = SlopeCone::to(self.from, point, self.tolerance);
                }
            }
        }
        self.end = point;
        given
    }

    /// Ends the line at the last added point and begins the next line there. Returns this point, unless the
    /// line had no other point.
    pub fn cut(&mut self) -> Option<PathPoint> {
        let is_new = self.cone.is_some();
        self.from = self.end;
        self.cone = None;
        is_new.then_some(self.end)
    }

    /// Extends the time at the last added point to `until_s`.
    pub fn rest(&mut self, until_s: f64) {
        self.end.1 = until_s;
        self.from = self.end;
    }
}

impl SlopeCone {
    /// Creates the cone from one point to the next. Returns `None` if they are too near to define a
    /// direction.
    fn to(from: PathPoint, to: PathPoint, tolerance: f64) -> Option<Self> {
        let way = minus(to.0, from.0);
        let reach = dot(way, way).sqrt();
        if reach <= tolerance {
            return None;
        }
        let along = way.map(|part| part / reach);
        let least = if along[0].abs() < 0.6 {
            [1.0, 0.0, 0.0]
        } else {
            [0.0, 1.0, 0.0]
        };
        let first = unit(cross(along, least));
        let cone = Self {
            along,
            across: [first, cross(along, first)],
            slopes: [[f64::NEG_INFINITY, f64::INFINITY]; 3],
            reach: 0.0,
        };
        cone.narrowed(from, to, tolerance)
    }

    fn narrowed(self, from: PathPoint, to: PathPoint, tolerance: f64) -> Option<Self> {
        let way = minus(to.0, from.0);
        let reach = dot(way, self.along);
        // The path turns back.
        if reach < self.reach || reach <= 0.0 {
            return None;
        }
        let half = tolerance / std::f64::consts::SQRT_2;
        let [u, v] = self.across.map(|across| dot(way, across));
        let of = [(u, half), (v, half), (to.1 - from.1, LATE_S)];
        let mut slopes = self.slopes;
        for ([lowest, highest], (off, within)) in slopes.iter_mut().zip(of) {
            let slope = off / reach;
            if slope < *lowest || slope > *highest {
                return None;
            }
            *lowest = lowest.max((off - within) / reach);
            *highest = highest.min((off + within) / reach);
        }
        Some(Self {
            slopes,
            reach,
            ..self
        })
    }
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn unit(a: [f64; 3]) -> [f64; 3] {
    let length = dot(a, a).sqrt();
    a.map(|part| part / length)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOLERANCE: f64 = 0.01;

    fn through(points: impl IntoIterator<Item = PathPoint>) -> Vec<PathPoint> {
        let mut points = points.into_iter();
        let first = points.next().unwrap();
        let mut sleeve = PathSimplifier::new(TOLERANCE, first);
        let mut given = vec![first];
        given.extend(points.filter_map(|point| sleeve.push(point)).collect::<Vec<_>>());
        given.extend(sleeve.cut());
        given
    }

    #[test]
    fn a_straight_way_at_one_speed_keeps_its_ends_only() {
        let points = (0..=1000).map(|i| {
            (
                [f64::from(i) * 0.1, 0.0, f64::from(i) * 0.2],
                f64::from(i) * 0.001,
            )
        });
        assert_eq!(through(points), [([0.0; 3], 0.0), ([100.0, 0.0, 200.0], 1.0)]);
    }

    #[test]
    fn a_change_of_speed_and_a_turn_back_are_kept() {
        let slow = (0..=100).map(|i| ([f64::from(i) * 0.01, 0.0, 0.0], f64::from(i) * 0.01));
        let fast = (1..=100).map(|i| ([1.0 + f64::from(i), 0.0, 0.0], 1.0 + f64::from(i) * 0.01));
        let back = (1..=10).map(|i| ([101.0 - f64::from(i), 0.0, 0.0], 2.0 + f64::from(i) * 0.01));
        let kept = through(slow.chain(fast).chain(back));
        assert!(kept.contains(&([101.0, 0.0, 0.0], 2.0)));
        for (at, s) in &kept {
            let x = if *s <= 1.0 {
                *s
            } else if *s <= 2.0 {
                1.0 + (s - 1.0) * 100.0
            } else {
                101.0 - (s - 2.0) * 100.0
            };
            assert!((at[0] - x).abs() < 1e-9);
        }
        assert!(kept.len() < 8, "{kept:?}");
    }

    #[test]
    fn no_point_of_a_helix_is_farther_from_the_line_than_the_tolerance() {
        let helix: Vec<PathPoint> = (0..=20_000)
            .map(|i| {
                let angle = f64::from(i) / 20_000.0 * 20.0;
                ([20.0 * angle.cos(), 20.0 * angle.sin(), angle], angle)
            })
            .collect();
        let kept = through(helix.iter().copied());
        assert!(kept.len() < 700, "{}", kept.len());
        for (point, _) in helix {
            let nearest = kept.windows(2).map(|ends| distance(point, ends[0].0, ends[1].0));
            let nearest = nearest.fold(f64::INFINITY, f64::min);
            assert!(nearest <= TOLERANCE * (1.0 + 1e-9), "{nearest}");
        }
    }

    fn distance(point: [f64; 3], from: [f64; 3], to: [f64; 3]) -> f64 {
        let (way, off) = (minus(to, from), minus(point, from));
        let along = (dot(off, way) / dot(way, way)).clamp(0.0, 1.0);
        let beside = minus(off, way.map(|part| part * along));
        dot(beside, beside).sqrt()
    }
}
