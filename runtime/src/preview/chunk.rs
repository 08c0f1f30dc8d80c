//! Pieces of a planned path, each in several levels of detail.

use tandem_model::Origin;

/// Maximum number of lines of a chunk.
pub(super) const CHUNK_LINES: usize = 4096;

/// Number of levels of detail.
pub(super) const LEVELS: usize = 4;

/// Factor by which the tolerance of each level exceeds that of the previous one.
const LEVEL_FACTOR: f64 = 4.0;

/// Maximum distance in mm between the path and the lines of each level, finest level first.
pub(super) const TOLERANCES_MM: [f64; LEVELS] = {
    let finest = plc_protocol::types::planned::PATH_TOLERANCE_MM;
    let second = finest * LEVEL_FACTOR;
    let third = second * LEVEL_FACTOR;
    [finest, second, third, third * LEVEL_FACTOR]
};

/// Bits of the line number in a word; they hold the line number of every program.
const LINE_BITS: u32 = 26;

/// Maximum number of programs with an index in a path. All further programs share the last index.
pub(super) const PROGRAMS_MAX: usize = 31;

/// Bit of a word that marks a line traversed in rapid motion (G00).
const RAPID: u32 = 1 << 31;

/// Converts a value to single precision, which is enough for the picture.
#[allow(
    clippy::cast_possible_truncation,
    reason = "single precision is enough for a picture"
)]
pub(super) fn single(value: f64) -> f32 {
    value as f32
}

/// A point of the path, and the origin of the path line that ends at this point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Vertex {
    /// Machine position, mm.
    pub at: [f32; 3],
    /// Line number in the program, index of the program, and the bit for rapid motion.
    pub word: u32,
    /// Time at which the point is reached, s.
    pub time_s: f32,
}

/// The program numbers of a path; words contain their index here.
#[derive(Debug, Clone, Default)]
pub(super) struct Palette(pub Vec<u16>);

impl Palette {
    /// Returns the word for a line of the path.
    pub fn word(&mut self, origin: Origin, is_rapid: bool) -> u32 {
        let known = self.0.iter().position(|number| *number == origin.program);
        let place = known.unwrap_or_else(|| {
            if self.0.len() < PROGRAMS_MAX {
                self.0.push(origin.program);
                self.0.len() - 1
            } else {
                PROGRAMS_MAX
            }
        });
        let line = origin.line.min((1 << LINE_BITS) - 1);
        let rapid = if is_rapid { RAPID } else { 0 };
        line | u32::try_from(place).unwrap_or_default() << LINE_BITS | rapid
    }
}

/// Successive lines of a path, in all levels of detail.
#[derive(Debug)]
pub(super) struct Chunk {
    pub vertices: Vec<Vertex>,
    /// Indices of the vertices that each coarser level contains.
    coarser: [Vec<u16>; LEVELS - 1],
    pub low: [f32; 3],
    pub high: [f32; 3],
}

impl Chunk {
    /// Creates a chunk. The number of vertices must be from 1 to [`CHUNK_LINES`] + 1.
    pub fn new(vertices: Vec<Vertex>) -> Self {
        let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for vertex in &vertices {
            low = std::array::from_fn(|i| low[i].min(vertex.at[i]));
            high = std::array::from_fn(|i| high[i].max(vertex.at[i]));
        }
        let mut coarser: [Vec<u16>; LEVELS - 1] = Default::default();
        let mut kept: Vec<u16> = (0_u16..).take(vertices.len()).collect();
        for (level, tolerance) in coarser.iter_mut().zip(&TOLERANCES_MM[1..]) {
            // The previous levels have already used up to 1 / [`LEVEL_FACTOR`] of the tolerance.
            let tolerance = tolerance * (1.0 - 1.0 / LEVEL_FACTOR);
            kept = thinned(&vertices, &kept, single(tolerance));
            level.clone_from(&kept);
        }
        Self {
            vertices,
            coarser,
            low,
            high,
        }
    }

    /// Returns the number of vertices of a level.
    pub fn len(&self, level: usize) -> usize {
        match level.checked_sub(1) {
            None => self.vertices.len(),
            Some(level) => self.coarser[level].len(),
        }
    }

    /// Returns the vertices of a level.
    pub fn level(&self, level: usize) -> Box<dyn Iterator<Item = &Vertex> + '_> {
        match level.checked_sub(1) {
            None => Box::new(self.vertices.iter()),
            Some(level) => Box::new(
                self.coarser[level]
                    .iter()
                    .map(|i| &self.vertices[usize::from(*i)]),
            ),
        }
    }

    pub fn begin_s(&self) -> f32 {
        self.vertices.first().map_or(0.0, |vertex| vertex.time_s)
    }

    pub fn end_s(&self) -> f32 {
        self.vertices.last().map_or(0.0, |vertex| vertex.time_s)
    }
}

/// Returns those of the vertices `of` that the tolerance requires. The algorithm of Douglas and Peucker is
/// applied between changes from feed to rapid and back.
fn thinned(vertices: &[Vertex], of: &[u16], tolerance: f32) -> Vec<u16> {
    let at = |i: usize| vertices[usize::from(of[i])];
    let mut keeps = vec![false; of.len()];
    let mut first = 0;
    for i in 0..of.len() {
        let is_last = i + 1 == of.len();
        if is_last || i > 0 && (at(i).word ^ at(i + 1).word) & RAPID != 0 || i == 0 {
            keeps[i] = true;
            thin(&at, first, i, tolerance, &mut keeps);
            first = i;
        }
    }
    of.iter()
        .zip(keeps)
        .filter(|(_, keeps)| *keeps)
        .map(|(i, _)| *i)
        .collect()
}

fn thin(at: &impl Fn(usize) -> Vertex, first: usize, last: usize, tolerance: f32, keeps: &mut [bool]) {
    let mut open = vec![(first, last)];
    while let Some((first, last)) = open.pop() {
        let (from, to) = (at(first).at, at(last).at);
        let mut farthest = (0.0_f32, first);
        for i in first + 1..last {
            let off = distance_squared(at(i).at, from, to);
            if off > farthest.0 {
                farthest = (off, i);
            }
        }
        if farthest.0 > tolerance * tolerance {
            keeps[farthest.1] = true;
            open.push((first, farthest.1));
            open.push((farthest.1, last));
        }
    }
}

/// Returns the squared distance of a point from the straight line between `from` and `to`.
pub(super) fn distance_squared(point: [f32; 3], from: [f32; 3], to: [f32; 3]) -> f32 {
    let along = share_along(point, from, to);
    (0..3)
        .map(|i| (point[i] - from[i] - along * (to[i] - from[i])).powi(2))
        .sum()
}

/// Returns the location on the straight line between `from` and `to` that is nearest to a point, 0 to 1.
pub(super) fn share_along(point: [f32; 3], from: [f32; 3], to: [f32; 3]) -> f32 {
    let way: [f32; 3] = std::array::from_fn(|i| to[i] - from[i]);
    let length: f32 = way.iter().map(|part| part * part).sum();
    if length == 0.0 {
        return 0.0;
    }
    let along: f32 = (0..3).map(|i| (point[i] - from[i]) * way[i]).sum();
    (along / length).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn circle(turns: f32) -> Vec<Vertex> {
        (0..=CHUNK_LINES)
            .map(|i| {
                let angle = i as f32 / CHUNK_LINES as f32 * turns * std::f32::consts::TAU;
                Vertex {
                    at: [10.0 * angle.cos(), 10.0 * angle.sin(), angle],
                    word: if i < CHUNK_LINES / 2 { 1 } else { 2 | RAPID },
                    time_s: angle,
                }
            })
            .collect()
    }

    #[test]
    fn each_level_is_within_its_tolerance_and_has_fewer_vertices() {
        let vertices = circle(5.0);
        let chunk = Chunk::new(vertices.clone());
        for (level, tolerance) in TOLERANCES_MM.iter().enumerate().skip(1) {
            assert!(chunk.len(level) < chunk.len(level - 1), "{level}");
            let lines: Vec<_> = chunk.level(level).collect();
            assert_eq!(
                (lines[0], *lines.last().unwrap()),
                (&vertices[0], vertices.last().unwrap())
            );
            for vertex in &vertices {
                let near = lines
                    .windows(2)
                    .map(|ends| distance_squared(vertex.at, ends[0].at, ends[1].at));
                let off = f64::from(near.fold(f32::INFINITY, f32::min).sqrt());
                assert!(off <= tolerance * 1.001, "{level}: {off}");
            }
        }
    }

    #[test]
    fn every_level_keeps_where_feed_becomes_rapid() {
        let chunk = Chunk::new(circle(1.0));
        for level in 0..LEVELS {
            assert!(
                chunk
                    .level(level)
                    .any(|vertex| *vertex == chunk.vertices[CHUNK_LINES / 2 - 1]),
                "{level}"
            );
        }
    }

    #[test]
    fn word_holds_line_program_and_rapid_last_index_is_shared() {
        let mut palette = Palette::default();
        let origin = |program, line| Origin {
            program,
            line,
            ..Origin::default()
        };
        assert_eq!(palette.word(origin(7, 3), false), 3);
        assert_eq!(palette.word(origin(1000, 5), true), 5 | 1 << 26 | 1 << 31);
        for number in 2000..2100 {
            palette.word(origin(number, 1), false);
        }
        assert_eq!(palette.0.len(), PROGRAMS_MAX);
        assert_eq!(palette.word(origin(2099, 9), false), 9 | 31 << 26);
    }
}
