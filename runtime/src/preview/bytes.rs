//! Encodes a planned path as bytes; `docs/src/reference/planned-path.md` describes the format.

use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::planned::{PATH_HEADER_BYTES, PathIdentity, PathQuery};

use super::chunk::{Chunk, LEVELS, PROGRAMS_MAX, TOLERANCES_MM, Vertex, single};
use super::plan::{Plan, PlanContent};

/// First bytes of a path.
const MAGIC: [u8; 4] = *b"TPTH";

/// Version of the byte format.
const VERSION: u16 = 1;

/// Size of a vertex, in bytes.
const VERTEX: usize = 20;

/// Size of an entry in the table of chunks, in bytes.
const ENTRY: usize = 48;

/// Encodes the part of the path that `query` requests.
pub(super) fn encode(
    plan: &Plan,
    content: &PlanContent,
    identity: &PathIdentity,
    cs: CoordinateSystemNumber,
    query: &PathQuery,
) -> Vec<u8> {
    let finest = match query.tolerance {
        None => 0,
        Some(tolerance) => TOLERANCES_MM.iter().rposition(|of| *of <= tolerance).unwrap_or(0),
    };
    let all = &content.chunks;
    let from = (query.from as usize).min(all.len());
    let count = query.count.map_or(usize::MAX, |count| count as usize);
    let part = &all[from..all.len().min(from.saturating_add(count))];
    let lines = |chunk: &Chunk| (finest..LEVELS).map(|level| chunk.len(level)).sum::<usize>();
    let vertices: usize = part.iter().map(|chunk| lines(chunk)).sum();
    let mut out = ByteWriter(Vec::with_capacity(1024 + all.len() * ENTRY + vertices * VERTEX));
    header(&mut out, plan, content, identity, cs, [finest, from, part.len()]);
    for chunk in all {
        out.floats(&chunk.low);
        out.floats(&chunk.high);
        out.floats(&[chunk.begin_s(), chunk.end_s()]);
        for level in 0..LEVELS {
            out.u32(chunk.len(level));
        }
    }
    for level in (finest..LEVELS).rev() {
        for vertex in part.iter().flat_map(|chunk| chunk.level(level)) {
            out.vertex(vertex);
        }
    }
    out.0
}

fn header(
    out: &mut ByteWriter,
    plan: &Plan,
    content: &PlanContent,
    identity: &PathIdentity,
    cs: CoordinateSystemNumber,
    [finest, from, count]: [usize; 3],
) {
    let why = content
        .depends
        .as_ref()
        .map_or("", |depends| depends.why.as_str());
    let begin = (PATH_HEADER_BYTES + 2 * content.palette.len() + why.len()).next_multiple_of(4);
    let identity = serde_json::to_vec(identity).unwrap_or_default();
    let length = (begin + 4 + identity.len()).next_multiple_of(4);
    let flags = [content.is_complete(), content.is_cut, content.depends.is_some()];
    let flags = flags
        .iter()
        .zip(0..)
        .map(|(is_so, bit)| usize::from(*is_so) << bit);
    out.0.extend(MAGIC);
    out.u16(VERSION);
    out.u16(u16::try_from(length).unwrap_or(u16::MAX));
    out.u32(flags.sum());
    out.u16(plan.conditions.main.number);
    out.u16(cs.into());
    out.u32(content.chunks.iter().map(|chunk| chunk.len(0)).sum());
    out.u32(content.chunks.len());
    out.u32(LEVELS);
    out.floats(&TOLERANCES_MM.map(single));
    out.u32(finest);
    out.u32(from);
    out.u32(count);
    out.floats(&[single(content.times.total)]);
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for chunk in &content.chunks {
        low = std::array::from_fn(|i| low[i].min(chunk.low[i]));
        high = std::array::from_fn(|i| high[i].max(chunk.high[i]));
    }
    out.floats(&low);
    out.floats(&high);
    let depends = content.depends.as_ref();
    out.floats(&[depends.map_or(f32::INFINITY, |depends| single(depends.at_s))]);
    out.u32(depends.map_or(0, |depends| {
        word_of(content, depends.program, depends.line) as usize
    }));
    out.hash(plan.conditions.main.checksum());
    out.u16(u16::try_from(content.palette.len()).unwrap_or_default());
    out.u16(u16::try_from(why.len()).unwrap_or_default());
    for program in &content.palette {
        out.u16(*program);
    }
    out.0.extend(why.as_bytes());
    out.0.resize(begin, 0);
    out.u32(identity.len());
    out.0.extend(identity);
    out.0.resize(length, 0);
}

fn word_of(content: &PlanContent, program: u16, line: u32) -> u32 {
    let place = content.palette.iter().position(|number| *number == program);
    line | u32::try_from(place.unwrap_or(PROGRAMS_MAX)).unwrap_or_default() << 26
}

struct ByteWriter(Vec<u8>);

impl ByteWriter {
    fn u16(&mut self, value: u16) {
        self.0.extend(value.to_le_bytes());
    }

    fn u32(&mut self, value: usize) {
        self.0
            .extend(u32::try_from(value).unwrap_or(u32::MAX).to_le_bytes());
    }

    fn floats(&mut self, values: &[f32]) {
        for value in values {
            self.0.extend(value.to_le_bytes());
        }
    }

    fn vertex(&mut self, vertex: &Vertex) {
        self.floats(&vertex.at);
        self.0.extend(vertex.word.to_le_bytes());
        self.floats(&[vertex.time_s]);
    }

    /// Writes the 32 bytes of a hash given as 64 hexadecimal digits.
    fn hash(&mut self, digits: &str) {
        let bytes = (0..32).map(|i| {
            let pair = digits.get(2 * i..2 * i + 2);
            pair.and_then(|pair| u8::from_str_radix(pair, 16).ok())
                .unwrap_or_default()
        });
        self.0.extend(bytes);
    }
}
