//! A line through many points, reduced to the points that are needed to draw it.

/// A position in the picture, mm to the right and up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point(pub [f64; 2]);

/// Maximum distance of an omitted point from the drawn line, mm.
const TOLERANCE_MM: f64 = 0.001;

/// Points of a line, in order. A point is omitted if the drawn line passes it within [`TOLERANCE_MM`]. A cone
/// of directions starts at the last kept point and narrows with each added point. A point outside the cone
/// begins the next line. This is the sleeve algorithm of Zhao and Saalfeld.
#[derive(Debug)]
pub struct Polyline {
    /// The kept points, at least one.
    kept: Vec<Point>,
    end: Point,
    cone: Option<DirectionCone>,
}

/// Range of directions from the last kept point in which a line passes all later points, in radians relative
/// to `middle`. Also contains the distance of the farthest of these points.
#[derive(Debug, Clone, Copy)]
struct DirectionCone {
    middle: f64,
    lowest: f64,
    highest: f64,
    reach: f64,
}

impl Polyline {
    /// Begins a line at this point.
    pub fn new(start: Point) -> Self {
        Self {
            kept: vec![start],
            end: start,
            cone: None,
        }
    }

    /// Returns the last added point.
    pub fn end_point(&self) -> Point {
        self.end
    }

    /// Continues the line to this point.
    pub fn push(&mut self, point: Point) {
        if point == self.end {
            return;
        }
        let anchor = self.anchor();
        let narrowed = self.cone.map(|cone| cone.narrowed(anchor, point));
        self.cone = narrowed.unwrap_or_else(|| Some(DirectionCone::to(anchor, point)));
        if self.cone.is_none() {
            self.kept.push(self.end);
            self.cone = Some(DirectionCone::to(self.end, point));
        }
        self.end = point;
    }

    /// Returns the last kept point.
    fn anchor(&self) -> Point {
        self.kept[self.kept.len() - 1]
    }

    /// Returns the kept points; there is only one if all points are at the same position.
    pub fn into_points(mut self) -> Vec<Point> {
        if self.end != self.anchor() {
            self.kept.push(self.end);
        }
        self.kept
    }
}

impl DirectionCone {
    fn to(anchor: Point, point: Point) -> Self {
        let (middle, reach) = polar(anchor, point);
        let half = half_angle(reach);
        Self {
            middle,
            lowest: -half,
            highest: half,
            reach,
        }
    }

    /// Returns the cone narrowed by one more point. Returns `None` if no straight line passes all points, or
    /// if the path turns back.
    fn narrowed(self, anchor: Point, point: Point) -> Option<Self> {
        let (direction, reach) = polar(anchor, point);
        let off = (direction - self.middle + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU)
            - std::f64::consts::PI;
        if off < self.lowest || off > self.highest || reach < self.reach {
            return None;
        }
        let half = half_angle(reach);
        Some(Self {
            middle: self.middle,
            lowest: self.lowest.max(off - half),
            highest: self.highest.min(off + half),
            reach,
        })
    }
}

fn polar(Point([x, y]): Point, Point([to_x, to_y]): Point) -> (f64, f64) {
    let (dx, dy) = (to_x - x, to_y - y);
    (dy.atan2(dx), dx.hypot(dy))
}

/// Returns the angle by which a line may deviate from the direction to a point at this distance, radians.
fn half_angle(reach: f64) -> f64 {
    if reach <= TOLERANCE_MM {
        std::f64::consts::PI
    } else {
        (TOLERANCE_MM / reach).asin()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn through(points: impl IntoIterator<Item = Point>) -> Vec<Point> {
        let mut points = points.into_iter();
        let mut line = Polyline::new(points.next().unwrap());
        points.for_each(|point| line.push(point));
        line.into_points()
    }

    #[test]
    fn a_straight_way_keeps_its_ends_only() {
        let points = (0..=1000).map(|i| Point([f64::from(i) * 0.01, f64::from(i) * 0.02]));
        assert_eq!(through(points), [[0.0, 0.0], [10.0, 20.0]].map(Point));
    }

    #[test]
    fn corners_and_turns_back_are_kept() {
        let points = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 5.0], [2.0, 1.0]].map(Point);
        assert_eq!(
            through(points),
            [[0.0, 0.0], [2.0, 0.0], [2.0, 5.0], [2.0, 1.0]].map(Point)
        );
    }

    #[test]
    fn no_point_is_farther_from_the_line_than_the_tolerance() {
        let circle: Vec<Point> = (0..=5000)
            .map(|i| {
                let (sin, cos) = (f64::from(i) / 5000.0 * 6.2).sin_cos();
                Point([20.0 * cos, 20.0 * sin])
            })
            .collect();
        let kept = through(circle.iter().copied());
        assert!(kept.len() < 600, "{}", kept.len());
        for point in circle {
            let nearest = kept
                .windows(2)
                .map(|ends| distance(point, ends[0], ends[1]))
                .fold(f64::INFINITY, f64::min);
            assert!(nearest <= TOLERANCE_MM * (1.0 + 1e-9), "{nearest}");
        }
    }

    /// Returns the distance of a point from the straight line between two other points.
    fn distance(Point([x, y]): Point, Point([ax, ay]): Point, Point([bx, by]): Point) -> f64 {
        let (dx, dy) = (bx - ax, by - ay);
        let along = (((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy)).clamp(0.0, 1.0);
        (x - ax - along * dx).hypot(y - ay - along * dy)
    }
}
