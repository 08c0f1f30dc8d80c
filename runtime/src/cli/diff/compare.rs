//! Finds the differences between the actions (elements) of two programs.

use std::collections::BTreeSet;
use std::fmt;
use std::ops::Range;

use serde::Serialize;
use tandem_model::AxisVector;
use tandem_model::flow::Path;

use super::recorded::{Does, Element};

/// Maximum number of elements, of both programs together, in which the next match is searched. Reason: the
/// time of the search grows with the square of this number.
const SEARCH_MAX: usize = 4000;

/// Differences between two programs.
pub struct Comparison {
    pub differences: Vec<Difference>,
}

/// A difference between two programs.
#[derive(Debug, Serialize)]
pub struct Difference {
    /// Kinds of the difference: `path`, `m_codes`, `time`.
    what: Vec<&'static str>,
    /// Part of the old program; null if only the new program has these elements.
    pub old: Option<ProgramPart>,
    /// Part of the new program; null if only the old program has these elements.
    pub new: Option<ProgramPart>,
}

/// A part of a program.
#[derive(Debug, Serialize)]
pub struct ProgramPart {
    program: u16,
    from_line: u32,
    to_line: u32,
    /// Time of the part's blocks, s.
    time_s: f64,
    /// M codes that the part outputs, or at which it stops.
    m_codes: Vec<String>,
    #[serde(skip)]
    pub elements: Range<usize>,
}

impl ProgramPart {
    fn from_elements(all: &[Element], elements: Range<usize>) -> Option<Self> {
        let part = &all[elements.clone()];
        let first = part.first()?;
        let of_program = || part.iter().filter(|element| element.program == first.program);
        Some(Self {
            program: first.program,
            from_line: of_program().map(|element| element.lines.0).min()?,
            to_line: of_program().map(|element| element.lines.1).max()?,
            time_s: part.iter().map(|element| element.time_s).sum(),
            m_codes: part.iter().filter_map(m_code).collect(),
            elements,
        })
    }
}

fn m_code(element: &Element) -> Option<String> {
    match &element.does {
        Does::Output { m, params } => {
            let letters = ["A", "B", "C", "D", "E", "F", "G", "H"];
            let values = [
                params.a(),
                params.b(),
                params.c(),
                params.d(),
                params.e(),
                params.f(),
                params.g(),
                params.h(),
            ];
            let params = letters.iter().zip(values);
            let params: Vec<String> = params
                .filter_map(|(letter, value)| Some(format!(" V{letter}{}", value?)))
                .collect();
            Some(format!("M{m:02}{}", params.concat()))
        }
        Does::Stop { m: Some(m) } => Some(format!("M{m:02}")),
        _ => None,
    }
}

impl Difference {
    /// Returns true if the paths differ.
    pub fn moves(&self) -> bool {
        self.what.contains(&"path")
    }
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let part = |part: &Option<ProgramPart>| match part {
            None => "nothing".to_owned(),
            Some(part) => {
                let lines = if part.from_line == part.to_line {
                    format!("line {}", part.from_line)
                } else {
                    format!("lines {} to {}", part.from_line, part.to_line)
                };
                let m_codes: Vec<String> = part.m_codes.iter().map(|m| format!(", {m}")).collect();
                format!(
                    "{lines} of program {} ({:.3} s{})",
                    part.program,
                    part.time_s,
                    m_codes.concat()
                )
            }
        };
        let what = self.what.join(" and ").replace('_', " ");
        write!(f, "{what}: old {}, new {}", part(&self.old), part(&self.new))
    }
}

/// Compares the elements of two programs, with a tolerance for positions in mm or degrees and one for times
/// in s.
pub fn compare(programs: [&[Element]; 2], [tolerance, time_tolerance]: [f64; 2]) -> Comparison {
    let [old, new] = programs;
    let same = |i: usize, j: usize| match (old.get(i), new.get(j)) {
        (Some(old), Some(new)) => is_same(&old.does, &new.does, tolerance),
        (None, None) => true,
        _ => false,
    };
    let moves = |i: usize| old.get(i).is_some_and(|element| element.does.moves());
    let slower = |i: usize, j: usize| (old[i].time_s - new[j].time_s).abs() > time_tolerance;
    let mut differences = Vec::new();
    let mut push = |what: Vec<&'static str>, of_old: Range<usize>, of_new: Range<usize>| {
        differences.push(Difference {
            what,
            old: ProgramPart::from_elements(old, of_old),
            new: ProgramPart::from_elements(new, of_new),
        });
    };
    let (mut i, mut j) = (0, 0);
    while i < old.len() || j < new.len() {
        if i < old.len() && j < new.len() && same(i, j) {
            let mut count = 0;
            while i + count < old.len()
                && j + count < new.len()
                && same(i + count, j + count)
                && slower(i + count, j + count)
            {
                count += 1;
            }
            if count > 0 {
                push(vec!["time"], i..i + count, j..j + count);
            }
            (i, j) = (i + count.max(1), j + count.max(1));
            continue;
        }
        let (more_old, more_new) = again([i, j], &same, &moves).unwrap_or((old.len() - i, new.len() - j));
        let (to_i, to_j) = ((i + more_old).min(old.len()), (j + more_new).min(new.len()));
        push(kinds(&old[i..to_i], &new[j..to_j], tolerance), i..to_i, j..to_j);
        (i, j) = (to_i, to_j);
    }
    forget_ramps(&mut differences);
    Comparison { differences }
}

/// Removes time differences in the ramps next to a different path, because that path causes them.
fn forget_ramps(differences: &mut Vec<Difference>) {
    let range = |difference: &Difference| difference.old.as_ref().map(|part| part.elements.clone());
    let ways = differences.iter().filter(|difference| difference.moves());
    let ends: BTreeSet<usize> = (ways.filter_map(range))
        .flat_map(|range| [range.start, range.end])
        .collect();
    differences.retain(|difference| {
        let single = range(difference).filter(|range| difference.what == ["time"] && range.len() == 1);
        !single.is_some_and(|range| ends.contains(&range.start) || ends.contains(&range.end))
    });
}

/// Returns the number of elements of each program up to the next match of both programs.
fn again(
    [i, j]: [usize; 2],
    same: &impl Fn(usize, usize) -> bool,
    moves: &impl Fn(usize) -> bool,
) -> Option<(usize, usize)> {
    (1..SEARCH_MAX).find_map(|sum| {
        let both = (0..=sum).map(|more| (more, sum - more));
        // Elements without motion match at many positions, so one of them is not a reliable match.
        let mut found = both.filter(|(a, b)| {
            let (i, j) = (i + a, j + b);
            same(i, j) && (moves(i) || same(i + 1, j + 1))
        });
        found.next()
    })
}

/// Function that returns true for elements of one kind.
type IsOf = fn(&Does) -> bool;

/// Returns the kinds of differences between two parts of the programs.
fn kinds(old: &[Element], new: &[Element], tolerance: f64) -> Vec<&'static str> {
    let differ = |is_of: IsOf| {
        let of = |part: &[Element]| -> Vec<Does> {
            let does = part.iter().map(|element| &element.does);
            does.filter(|does| is_of(does)).cloned().collect()
        };
        let (old, new) = (of(old), of(new));
        let all_same = || {
            old.iter()
                .zip(&new)
                .all(|(old, new)| is_same(old, new, tolerance))
        };
        old.len() != new.len() || !all_same()
    };
    let is_m = |does: &Does| matches!(does, Does::Output { .. } | Does::Stop { .. });
    let is_way = |does: &Does| does.moves();
    let is_rest = |does: &Does| matches!(does, Does::Rest);
    let kinds: [(&str, IsOf); 3] = [("path", is_way), ("m_codes", is_m), ("time", is_rest)];
    let mut found: Vec<&str> = kinds
        .into_iter()
        .filter(|(_, is_of)| differ(*is_of))
        .map(|(kind, _)| kind)
        .collect();
    if found.is_empty() {
        // Both parts have the same M codes, in a different order.
        found.push("m_codes");
    }
    found
}

fn is_near(a: AxisVector, b: AxisVector, tolerance: f64) -> bool {
    a.minus(b).0.iter().all(|off| off.abs() <= tolerance)
}

fn is_same(old: &Does, new: &Does, tolerance: f64) -> bool {
    let near = |a: AxisVector, b: AxisVector| is_near(a, b, tolerance);
    match (old, new) {
        (Does::Feed(old), Does::Feed(new)) => {
            let at = |path: &Path, share: f64| path.point_at(path.length() * share);
            [0.0, 0.25, 0.5, 0.75, 1.0]
                .iter()
                .all(|share| near(at(old, *share), at(new, *share)))
        }
        (
            Does::Alone { skips, from, to },
            Does::Alone {
                skips: also,
                from: start,
                to: end,
            },
        ) => skips == also && near(*from, *start) && near(*to, *end),
        (
            Does::Tap {
                from,
                to,
                revolutions,
            },
            Does::Tap {
                from: start,
                to: end,
                revolutions: turns,
            },
        ) => near(*from, *start) && near(*to, *end) && (revolutions - turns).abs() <= 1e-9,
        (Does::Rest, Does::Rest) => true,
        (
            Does::Output { m, params },
            Does::Output {
                m: also,
                params: others,
            },
        ) => m == also && params == others,
        (Does::Stop { m }, Does::Stop { m: also }) => m == also,
        _ => false,
    }
}
