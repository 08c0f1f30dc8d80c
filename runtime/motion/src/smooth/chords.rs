//! Chords of a path: an arc becomes many, and consecutive short lines become one.

use tandem_model::flow::Path;
use tandem_model::{ArcPath, AxisVector};

use super::widths::{Vertices, size};

/// Share of the tolerance that the joining of lines, and the chords of an arc, may use. The larger rest makes the
/// kernels wide in relation to the chords, so that the curvature hardly varies between the vertices.
const SHARE: f64 = 0.4;

/// Maximum number of lines that become one chord.
const LINES_MAX: usize = 64;

/// Maximum number of chords of an arc.
const CHORDS_MAX: usize = 100_000;

/// Largest share of the tolerance that a chord may use if an arc needs more chords.
const ERROR_MAX: f64 = 0.9;

/// Relative difference of the radii of an arc below which it is bent equally everywhere.
const SAME_RADIUS: f64 = 1e-9;

/// Relative difference below which two speeds are equal.
const SAME_SPEED: f64 = 1e-9;

/// A point of the path, and its distance along the chain.
#[derive(Debug, Clone, Copy)]
struct PathPoint {
    at: f64,
    point: AxisVector,
}

/// Lines that are joined to one chord so far.
#[derive(Debug, Clone)]
struct OpenChord {
    from: PathPoint,
    to: PathPoint,
    /// Ends of all lines but the last one.
    between: Vec<PathPoint>,
    speed: f64,
    error: f64,
}

/// Conversion of the blocks of a chain to chords.
#[derive(Debug, Clone, Default)]
pub(super) struct Chords {
    open: Option<OpenChord>,
    length: f64,
}

impl Chords {
    /// Returns the distance along the chain at the end of the last block.
    pub(super) fn length(&self) -> f64 {
        self.length
    }

    /// Adds the path of a block. Distances are those of the path, to which F refers.
    pub(super) fn push(&mut self, path: &Path, speed: f64, tolerance: f64, vertices: &mut Vertices) {
        let from = PathPoint {
            at: self.length,
            point: path.start(),
        };
        self.length += path.length();
        match path {
            Path::Line { to, .. } => {
                let to = PathPoint {
                    at: self.length,
                    point: *to,
                };
                self.push_line(from, to, speed, tolerance, vertices);
            }
            Path::Arc(arc) => {
                self.finish(vertices);
                vertices.begin_chain(from.at, from.point, tolerance);
                add_arc(arc, from.at, tolerance, vertices);
            }
        }
    }

    fn push_line(
        &mut self,
        from: PathPoint,
        to: PathPoint,
        speed: f64,
        tolerance: f64,
        vertices: &mut Vertices,
    ) {
        if let Some(open) = &mut self.open {
            if open.extend(to, speed, SHARE * tolerance) {
                return;
            }
            self.finish(vertices);
        }
        vertices.begin_chain(from.at, from.point, tolerance);
        self.open = Some(OpenChord {
            from,
            to,
            between: Vec::new(),
            speed,
            error: 0.0,
        });
    }

    /// Ends the open chord.
    pub(super) fn finish(&mut self, vertices: &mut Vertices) {
        if let Some(open) = self.open.take() {
            vertices.add(open.to.at, open.to.point, open.error);
        }
    }
}

impl OpenChord {
    /// Extends the chord to a new end, if it then passes all points between within the tolerance.
    fn extend(&mut self, to: PathPoint, speed: f64, tolerance: f64) -> bool {
        let is_same_speed = (speed - self.speed).abs() <= SAME_SPEED * speed;
        if !is_same_speed || self.between.len() >= LINES_MAX {
            return false;
        }
        let way = to.point.minus(self.from.point);
        let square = dot(way, way);
        let (mut error, mut last) = (0.0_f64, 0.0);
        for point in self.between.iter().chain([&self.to]) {
            let off = point.point.minus(self.from.point);
            let share = dot(off, way) / square;
            error = error.max(size(off.minus(way.scaled(share))));
            // A line that goes back must stay.
            if error > tolerance || share <= last || share >= 1.0 || error.is_nan() {
                return false;
            }
            last = share;
        }
        self.between.push(self.to);
        self.to = to;
        self.error = error;
        true
    }
}

/// Adds the chords of an arc that begins at this distance along the chain. A part of the arc is divided into halves
/// until its chord misses it by little, because a spiral is bent more where it is narrow.
fn add_arc(arc: &ArcPath, at: f64, tolerance: f64, vertices: &mut Vertices) {
    let length = arc.length();
    let share = SHARE * tolerance;
    let [start, end] = arc.radii();
    let is_even = (end - start).abs() <= SAME_RADIUS * start;
    let count = if is_even {
        (largest_error(arc, [0.0, length]) / share).sqrt().ceil()
    } else {
        1.0
    };
    let count = count.clamp(1.0, CHORDS_MAX as f64);
    let mut k = 1.0;
    let mut added = 0;
    while k <= count {
        let mut parts = vec![[length * (k - 1.0) / count, length * k / count]];
        while let Some(part) = parts.pop() {
            let [from, to] = part;
            let error = largest_error(arc, part);
            if error > share && added < CHORDS_MAX && !is_even {
                let middle = f64::midpoint(from, to);
                parts.extend([[middle, to], [from, middle]]);
            } else {
                added += 1;
                let point = if to < length { arc.point_at(to) } else { arc.end() };
                // A part of the tolerance always remains, because a vertex without a width would be a sharp corner.
                vertices.add(at + to, point, error.min(ERROR_MAX * tolerance));
            }
        }
        k += 1.0;
    }
}

/// Returns a bound of the distance by which the chord of a part of an arc misses that part: `b c^2/8` for a chord of
/// the length c and a second derivative b.
fn largest_error(arc: &ArcPath, [from, to]: [f64; 2]) -> f64 {
    let [[_, in_plane, ..], [_, out_of_plane, ..]] = arc.derivative_bounds(from, to);
    let mut bound = arc.end().minus(arc.start()).scaled(out_of_plane);
    let [first, second] = arc.plane().axes();
    (bound[first], bound[second]) = (in_plane, 0.0);
    size(bound) * (to - from) * (to - from) / 8.0
}

fn dot(a: AxisVector, b: AxisVector) -> f64 {
    a.0.iter().zip(&b.0).map(|(a, b)| a * b).sum()
}
