//! Converts blocks that set coordinates, or that move in machine coordinates.

use tandem_syntax::{Address, Word};

use crate::codes::g50_g51_scaling::{SAME_FACTOR_MAX as SCALE_MAX, SAME_FACTOR_MIN as SCALE_MIN};

use super::state::{ConversionState, POSITIONS, Source, Words, shown};

impl ConversionState {
    /// Converts G28 or G30, which return the named axes to a reference point.
    pub(super) fn reference(&mut self, words: &mut Words<'_>, code: &str) -> Result<String, String> {
        let named: Vec<Address> = POSITIONS.into_iter().filter(|axis| words.has(&[*axis])).collect();
        let remembers = self.from == Source::Dgshape;
        if remembers && self.returned.iter().any(|axis| !named.contains(axis)) {
            return Err("axes that an earlier G28 has named return too. Name them in this G28.".to_owned());
        }
        if named.is_empty() {
            return Err("the block names no axis. Name the axes that return.".to_owned());
        }
        self.in_plain_shape(code)?;
        self.returned.clone_from(&named);
        let point = if code == "G30" {
            words.take_word(Address::P)
        } else {
            None
        };
        let point = point
            .and_then(Word::whole)
            .map_or_else(String::new, |point| format!("P{point} "));
        let positions = self.positions(words)?.join(" ");
        self.lose_position();
        Ok(format!("{code} {point}{positions}"))
    }

    /// Rejects a code within mirroring, scaling or rotation: in nj, the code ends these functions; in the
    /// source, it does not.
    pub(super) fn in_plain_shape(&self, code: &str) -> Result<(), String> {
        self.within(code, self.mirror.iter().any(Option::is_some))
    }

    fn within(&self, code: &str, is_mirrored: bool) -> Result<(), String> {
        let (begin, end) = match (self.is_rotated, self.is_scaled, is_mirrored) {
            (false, false, false) => return Ok(()),
            (true, _, _) => ("G68", "G69"),
            (false, true, _) => ("G51", "G50"),
            (false, false, true) => ("G51.1", "G50.1"),
        };
        Err(format!(
            "{code} is within {begin}. Write {end} before it, and {begin} again after it."
        ))
    }

    /// Converts G52. The G52 of the result contains the values of the source plus the shift of G92.
    pub(super) fn local_coordinates(&mut self, words: &mut Words<'_>) -> Result<String, String> {
        self.in_plain_shape("G52")?;
        let mut parts = vec!["G52".to_owned()];
        for (axis, address) in POSITIONS.into_iter().enumerate() {
            let Some(word) = words.take_word(address) else {
                continue;
            };
            let unit = self.unit_of(axis);
            self.local[axis] = self.value(word)? * unit;
            let all = (self.shift[axis] + self.local[axis]) / unit;
            parts.push(format!("{}{}", address.text(), shown(all)));
        }
        self.lose_position();
        Ok(parts.join(" "))
    }

    /// Converts G92, which gives the tool's position new coordinates, to the local coordinates of G52.
    pub(super) fn shifted_coordinates(&mut self, words: &mut Words<'_>) -> Result<String, String> {
        self.in_plain_shape("G92")?;
        if self.from == Source::Fanuc && self.absolute != Some(true) {
            return Err("G92 is in G91. Write G90 before it.".to_owned());
        }
        let mut parts = vec!["G52".to_owned()];
        for (axis, address) in POSITIONS.into_iter().enumerate() {
            let Some(word) = words.take_word(address) else {
                continue;
            };
            let letter = address.text();
            let wanted = self.value(word)?;
            let at = self.at[axis].ok_or_else(|| {
                format!(
                    "G92 depends on the position of the tool, and its {letter} is unknown at this block. \
                     Write G90 and a motion to a position of {letter} before it, or G54 to G59 with this \
                     zero in the configuration."
                )
            })?;
            let unit = self.unit_of(axis);
            let all = self.shift[axis] + self.local[axis] + (at - wanted) * unit;
            (self.shift[axis], self.local[axis]) = (all, 0.0);
            self.at[axis] = Some(wanted);
            parts.push(format!("{letter}{}", shown(all / unit)));
        }
        if parts.len() == 1 {
            return Err("G92 names no axis. Name the axes with their coordinates.".to_owned());
        }
        Ok(parts.join(" "))
    }

    /// Converts G53, a motion to a machine position.
    pub(super) fn machine_position(&mut self, words: &mut Words<'_>) -> Result<String, String> {
        let is_shifted = self.shift.iter().chain(&self.local).any(|way| way.abs() > 0.0);
        if is_shifted
            || self.in_plain_shape("G53").is_err()
            || self.absolute != Some(true)
            || self.motion != "G00"
        {
            let why = "G53 moves at rapid speed to absolute positions in nj, and ends G52, G51 and G68. Write G90, G00 and the codes that end G52, G51 and G68 before it.";
            return Err(why.to_owned());
        }
        let positions = self.positions(words)?.join(" ");
        self.lose_position();
        Ok(format!("G53 {positions}").trim_end().to_owned())
    }

    /// Converts G51, with one factor for all axes or one factor for each axis. The centre is absolute in all
    /// dialects.
    pub(super) fn scaling(&mut self, words: &mut Words<'_>) -> Result<String, String> {
        let mut parts = vec!["G51".to_owned()];
        for address in [Address::X, Address::Y, Address::Z] {
            let Some(word) = words.take_word(address) else {
                continue;
            };
            parts.push(format!("{}{}", address.text(), shown(self.value(word)?)));
        }
        let factors = [Address::P, Address::I, Address::J, Address::K];
        if !words.has(&factors) {
            return Err("G51 has no factor. Write P.".to_owned());
        }
        for address in factors {
            let Some(word) = words.take_word(address) else {
                continue;
            };
            let factor = word.number().unwrap_or_default();
            let factor = match self.from {
                Source::Dgshape => factor.clamp(SCALE_MIN, SCALE_MAX),
                Source::Fanuc if word.is_whole() => {
                    return Err(format!(
                        "{}{factor} is in steps whose size is a setting of the control. Write the factor with a decimal point.",
                        address.text()
                    ));
                }
                Source::Fanuc => factor,
            };
            parts.push(format!("{}{}", address.text(), shown(factor)));
        }
        self.is_scaled = true;
        self.lose_position();
        Ok(parts.join(" "))
    }

    /// Converts G51.1 and G50.1. In nj, G51.1 mirrors only the axes that it names; on the controls of the
    /// source, axes of earlier G51.1 stay mirrored too.
    pub(super) fn mirroring(&mut self, words: &mut Words<'_>, on: bool) -> Result<String, String> {
        let code = if on { "G51.1" } else { "G50.1" };
        self.within(code, false)?;
        if self.absolute != Some(true) {
            return Err(format!("{code} is in G91. Write G90 before it."));
        }
        let mut names_none = true;
        for (axis, address) in POSITIONS.into_iter().take(self.mirror.len()).enumerate() {
            let Some(word) = words.take_word(address) else {
                continue;
            };
            let about = self.value(word)? * self.unit_of(axis);
            self.mirror[axis] = on.then_some(about);
            names_none = false;
        }
        if names_none && on {
            return Err("G51.1 names no axis. Name the axes to mirror.".to_owned());
        }
        if names_none {
            self.mirror = [None; 3];
        }
        self.lose_position();
        let axes = self.mirror.iter().enumerate();
        let axes = axes.filter_map(|(axis, about)| {
            let about = shown((*about)? / self.unit_of(axis));
            Some(format!(" {}{about}", POSITIONS[axis].text()))
        });
        let axes: String = axes.collect();
        Ok(if axes.is_empty() {
            "G50.1".to_owned()
        } else {
            format!("G51.1{axes}")
        })
    }

    /// Converts G68, whose centre is absolute in both dialects.
    pub(super) fn rotation(&mut self, words: &mut Words<'_>) -> Result<String, String> {
        let mut parts = vec!["G68".to_owned()];
        for address in POSITIONS {
            let Some(word) = words.take_word(address) else {
                continue;
            };
            parts.push(format!("{}{}", address.text(), shown(self.value(word)?)));
        }
        if words.has(&[Address::I, Address::J, Address::K]) {
            return Err("I, J and K select an axis in space. Write G68 X_ Y_ R_ in the plane.".to_owned());
        }
        let angle = words.take_word(Address::R).and_then(Word::number);
        let angle = angle.ok_or("the block has no angle R. Write R.")?;
        if self.is_rotated && self.absolute != Some(true) {
            let why =
                "in G91, R may be added to the angle in force. Write G90 before it, and the whole angle.";
            return Err(why.to_owned());
        }
        self.is_rotated = true;
        self.lose_position();
        parts.push(format!("R{}", shown(angle)));
        Ok(parts.join(" "))
    }
}
