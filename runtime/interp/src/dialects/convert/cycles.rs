//! Converts fixed cycles to their motions.

use tandem_syntax::{Address, Word};

use super::state::{ConversionState, CycleState, PLANE_XY, Source, Words, Z, shown};

/// Maximum number of holes of one block that are converted to motions.
const REPETITIONS_MAX: u32 = 100;

/// The boring cycle that stops the spindle at the bottom, on controls whose cycles start and stop the
/// spindle.
const STOPS_SPINDLE: u32 = 86;

/// Maximum number of cuts of one hole.
const CUTS_MAX: u32 = 1000;

/// Levels of Z in a hole: positions, or distances from the initial level.
struct ConvertedHoleLevels {
    r: f64,
    z: f64,
    /// Level of Z at which the hole ends.
    end: f64,
}

/// Motions of Z in a hole.
struct HolePath<'a> {
    lines: &'a mut Vec<String>,
    absolute: bool,
    at: f64,
}

impl HolePath<'_> {
    /// Adds a motion to a level. In G91, adds no motion if Z is already at the level.
    fn move_to(&mut self, code: &str, to: f64) {
        let value = shown(if self.absolute { to } else { to - self.at });
        if self.absolute || value != "0" {
            self.lines.push(format!("{code} Z{value}"));
        }
        self.at = to;
    }
}

impl ConversionState {
    /// Returns the motions for all holes of a block.
    pub fn holes(&mut self, words: &mut Words<'_>, begins: bool) -> Result<Vec<String>, String> {
        let Some(mut cycle) = self.cycle.clone() else {
            return Ok(Vec::new());
        };
        if Some(cycle.absolute) != self.absolute {
            return Err(
                "G90 or G91 changes within a fixed cycle. Write G80 before the change, and begin the cycle again after it.".to_owned(),
            );
        }
        let own = [
            Address::X,
            Address::Y,
            Address::Z,
            Address::R,
            Address::P,
            Address::Q,
            Address::K,
        ];
        if !begins && !words.has(&own) {
            return Ok(Vec::new());
        }
        self.drills_along_z()?;
        if cycle.taps() {
            return self.threads(words, cycle);
        }
        let mut take = |address| words.take_word(address).map(|word| self.value(word)).transpose();
        cycle.z = take(Address::Z)?.or(cycle.z);
        cycle.r = take(Address::R)?.or(cycle.r);
        cycle.depth = take(Address::Q)?.map(f64::abs).or(cycle.depth);
        cycle.dwell_s = self.cycle_dwell(words)?.or(cycle.dwell_s);
        let repetitions = self
            .repetitions(words)
            .filter(|count| *count <= REPETITIONS_MAX)
            .ok_or_else(|| format!("more than {REPETITIONS_MAX} repetitions. Write a loop with while."))?;
        if words.has(&[Address::A]) {
            return Err("A does not move in a fixed cycle. Write A in a block before the cycle.".to_owned());
        }
        if repetitions == 0 {
            // the cycle keeps its levels, and no axis moves
            for address in [Address::X, Address::Y] {
                words.take_word(address);
            }
            self.cycle = Some(cycle);
            return Ok(Vec::new());
        }
        let mut place = self.hole_position(words, repetitions)?;
        if !place.is_empty() {
            place = format!("G00 {place}");
        }
        let mut lines = Vec::new();
        for _ in 0..repetitions {
            if !place.is_empty() {
                lines.push(place.clone());
            }
            if cycle.z.is_some() {
                self.hole(&mut cycle, &mut lines)?;
            }
        }
        self.cycle = Some(cycle);
        Ok(lines)
    }

    /// Rejects a cycle in G18 or G19, because the axis of the drill then depends on the control.
    fn drills_along_z(&self) -> Result<(), String> {
        match self.plane {
            Some(PLANE_XY) => Ok(()),
            Some(plane) => Err(format!(
                "in G{plane}, a parameter of the control decides whether a fixed cycle drills along Z or \
                 perpendicular to the plane. Write G17 before it, or the motions."
            )),
            None => Err("the plane in force is unknown at this block, and so is the axis of the drill. Write G17 before it.".to_owned()),
        }
    }

    /// Returns the dwell of a fixed cycle, in seconds.
    fn cycle_dwell(&self, words: &mut Words<'_>) -> Result<Option<f64>, String> {
        words
            .take_word(Address::P)
            .map(|word| self.dwell_of_p(word))
            .transpose()
    }

    /// Returns the number of repetitions of a hole: from K, or from L on controls that use L.
    fn repetitions(&self, words: &mut Words<'_>) -> Option<u32> {
        let k = words.take_word(Address::K);
        let l = || {
            let is_known = self.from == Source::Fanuc;
            is_known.then(|| words.take_word(Address::L)).flatten()
        };
        k.or_else(l).map_or(Some(1), Word::whole)
    }

    /// Returns the axis words of the hole positions in a block.
    fn hole_position(&mut self, words: &mut Words<'_>, repetitions: u32) -> Result<String, String> {
        let place = self.positions(words)?.join(" ");
        if repetitions != 1 {
            let z = self.z();
            self.lose_position();
            self.at[Z] = z;
        }
        Ok(place)
    }

    /// Adds the motions of one hole, beginning with the tool above the hole.
    fn hole(&mut self, cycle: &mut CycleState, lines: &mut Vec<String>) -> Result<(), String> {
        let levels = self.levels(cycle)?;
        let mut way = HolePath {
            lines,
            absolute: cycle.absolute,
            at: cycle.at,
        };
        way.move_to("G00", levels.r);
        if let Some(depth) = cycle
            .depth
            .filter(|depth| matches!(cycle.code, 73 | 83) && *depth > 0.0)
        {
            self.cuts(&mut way, &levels, depth, cycle.code == 83)?;
        }
        way.move_to("G01", levels.z);
        if let Some(dwell_s) = cycle.dwell_s.filter(|_| matches!(cycle.code, 82 | 89)) {
            way.lines.push(format!("G04 X{}", shown(dwell_s)));
        }
        let stops = self.from == Source::Fanuc && cycle.code == STOPS_SPINDLE;
        if stops {
            way.lines.push("M05".to_owned());
        }
        let slowly = matches!(cycle.code, 85 | 89);
        if slowly {
            way.move_to("G01", levels.r);
        }
        if !slowly || self.to_initial == Some(true) {
            way.move_to("G00", levels.end);
        }
        if stops {
            // if the text does not show the direction of the spindle, M03 is written
            way.lines.push(format!("M{:02}", self.spindle.unwrap_or(3)));
        }
        let at = way.at;
        cycle.at = if cycle.absolute { 0.0 } else { at };
        self.end_hole_at(cycle, levels.end);
        Ok(())
    }

    /// Records Z at the end of a hole. `end` is a position, or in G91 a distance from the initial level.
    fn end_hole_at(&mut self, cycle: &CycleState, end: f64) {
        self.at[Z] = if cycle.absolute {
            Some(end)
        } else {
            cycle.initial.map(|initial| initial + end)
        };
    }

    /// Starts a cycle. If the cycle replaces another cycle, it keeps the words of that cycle.
    pub(super) fn begin_cycle(&mut self, code: u32) -> Result<(), String> {
        let unknown = "it is unknown at this block whether its words are positions or distances. Write G90 or G91 before it.";
        let absolute = self.absolute.ok_or(unknown)?;
        let before = self.cycle.take();
        let cycle = CycleState::new(code, before.clone(), self.z(), absolute);
        let anew = before.filter(|before| before.taps() != cycle.taps());
        if anew.is_some_and(|before| before.initial.is_none() || before.initial != self.z()) {
            let why = "the initial level of the cycle before differs from the present Z. Write G80 and a motion to the initial level before this cycle.";
            return Err(why.to_owned());
        }
        self.cycle = Some(cycle);
        Ok(())
    }

    /// Converts a block of a tapping cycle, which nj has too.
    fn threads(&mut self, words: &mut Words<'_>, mut cycle: CycleState) -> Result<Vec<String>, String> {
        if words.has(&[Address::Q]) {
            return Err(
                "with Q, the thread is cut in steps. Write G84 without Q, once for each depth.".to_owned(),
            );
        }
        if words.has(&[Address::A]) {
            return Err("A does not move in a fixed cycle. Write A in a block before the cycle.".to_owned());
        }
        let mut take = |address| words.take_word(address).map(|word| self.value(word)).transpose();
        cycle.z = take(Address::Z)?.or(cycle.z);
        cycle.r = take(Address::R)?.or(cycle.r);
        cycle.dwell_s = self.cycle_dwell(words)?.or(cycle.dwell_s);
        let (z, r) = cycle
            .z
            .zip(cycle.r)
            .ok_or("a tapping cycle needs Z and R. Write both in its first block.")?;
        let repetitions = self
            .repetitions(words)
            .ok_or("the number of repetitions must be a whole number")?;
        let mut place = self.hole_position(words, repetitions)?;
        if !place.is_empty() {
            place.push(' ');
        }
        let code = cycle.code;
        let level = if self.to_initial()? { "G98" } else { "G99" };
        let dwell_ms = shown(cycle.dwell_s.unwrap_or_default() * 1000.0);
        let line = format!(
            "{level} G{code} {place}Z{} R{} P{dwell_ms} K{repetitions}",
            shown(z),
            shown(r)
        );
        if let Ok(levels) = self.levels(&cycle) {
            self.end_hole_at(&cycle, levels.end);
        } else {
            self.at[Z] = None;
        }
        self.cycle = Some(cycle);
        Ok(vec![line])
    }

    /// Adds all cuts but the last one. Each cut has a retraction: to the R point and back, or a short one.
    fn cuts(
        &self,
        way: &mut HolePath<'_>,
        levels: &ConvertedHoleLevels,
        depth: f64,
        goes_out: bool,
    ) -> Result<(), String> {
        let below = |way: f64| levels.r + way.max(0.0).copysign(levels.z - levels.r);
        let mut cuts = 1;
        while f64::from(cuts) * depth < (levels.z - levels.r).abs() {
            let reached = f64::from(cuts) * depth;
            way.move_to("G01", below(reached));
            if goes_out {
                way.move_to("G00", levels.r);
            }
            way.move_to("G00", below(reached - self.clearance()));
            cuts += 1;
            if cuts > CUTS_MAX {
                return Err(format!(
                    "a hole has more than {CUTS_MAX} cuts. Write a loop with while."
                ));
            }
        }
        Ok(())
    }

    fn to_initial(&self) -> Result<bool, String> {
        let unknown = "it is unknown at this block whether the cycle returns to the initial level. Write G98 or G99 in it.";
        self.to_initial.ok_or_else(|| unknown.to_owned())
    }

    fn levels(&self, cycle: &CycleState) -> Result<ConvertedHoleLevels, String> {
        let z = cycle.z.unwrap_or_default();
        if !cycle.absolute {
            let r = cycle.r.unwrap_or_default();
            let end = if self.to_initial()? { 0.0 } else { r };
            return Ok(ConvertedHoleLevels { r, z: r + z, end });
        }
        let unknown = "Z at the start of the cycle is unknown. Write a motion to a position of Z before it.";
        let r = cycle.r.or(cycle.initial).ok_or(unknown)?;
        let end = if self.to_initial()? {
            cycle.initial.ok_or(unknown)?
        } else {
            r
        };
        Ok(ConvertedHoleLevels { r, z, end })
    }
}
