//! Checks the words of a block against the machine data in the context, and finds words that a motion lacks
//! or does not use.

use tandem_syntax::{Address, AddressSet, diagnostics};

use super::explore::Explorer;
use super::graph::CurrentBlock;
use super::state::CheckState;
use super::verdict::Weight;
use crate::codes::{Code, ModalGroup};
use crate::dialect::{SpindleWord, Spiral};
use crate::execution::axis_of;
use crate::meaning::{ModalValue, MotionKind, Role};
use crate::restrictions;

/// Addresses of the centre of an arc.
const CENTRES: AddressSet = AddressSet::from_addresses(&[Address::I, Address::J, Address::K]);

/// Allowed distance of the end of an arc from its circle, as a fraction of the radius.
const BESIDE_MAX: f64 = 0.01;

/// Allowed distance of the end of a small arc from its circle, mm or inches: the error of rounding to three
/// decimals.
const ROUNDING_MAX: f64 = 0.01;

impl Explorer<'_> {
    /// Checks the words of a block against the known data of the coordinate system.
    pub(super) fn context_of_words(&mut self, here: CurrentBlock<'_>, state: &CheckState) {
        let CurrentBlock { tree, block, .. } = here;
        let words = &self.words;
        let mut found = Vec::new();
        if let Some(axes) = self.context.axes {
            let dwells = words.codes().any(|code| code.role == Role::Dwell);
            let own = if dwells {
                AddressSet::EMPTY
            } else {
                words.own.intersection(words.present)
            };
            for address in words.axis_words.union(own).iter() {
                if axis_of(address).is_some_and(|axis| !axes.contains(axis)) {
                    found.push(diagnostics::AXIS_UNKNOWN.at(
                        tree.span_of(block, address),
                        format!("the coordinate system has no axis {}", address.text()),
                        "Remove the word, or assign a motor to the axis.",
                    ));
                }
            }
        }
        let free = |address| words.get(address).filter(|_| !words.own.contains(address));
        if let (Some(feedrate), Some(max)) = (free(Address::F), self.context.max_feedrate_mm_min)
            && feedrate > max
        {
            let unit = state.modal.unit_text();
            found.push(diagnostics::FEEDRATE_CLIPPED.at(
                tree.span_of(block, Address::F),
                format!("F{feedrate} is above the maximum feedrate of {max} {unit}/min, which will be used"),
                format!("Write F{max} or less, or raise max_feedrate."),
            ));
        }
        let is_bounded = self.dialect.policy.spindle_word == SpindleWord::Speed;
        if let (Some(speed), Some(max)) = (free(Address::S), self.context.max_spindle_speed_r_min)
            && is_bounded
            && speed > max
        {
            found.push(diagnostics::OUT_OF_RANGE.at(
                tree.span_of(block, Address::S),
                format!("S{speed} is above the spindle's maximum of {max} r/min"),
                format!("Write S{max} or less."),
            ));
        }
        if found.is_empty() {
            return;
        }
        let is_calculated = !self.calculates(here.node) && words.indirect.contains(Address::S);
        for finding in found {
            let is_of_value = finding.code == diagnostics::OUT_OF_RANGE.code;
            let weight = if is_calculated && is_of_value {
                Weight::Calculated
            } else {
                Weight::Sure
            };
            self.record_finding(here, finding, weight);
        }
    }

    /// Warns of words that the arc of the block does not use.
    pub(super) fn arc_words(&mut self, here: CurrentBlock<'_>, state: &CheckState) {
        let CurrentBlock { tree, block, .. } = here;
        let words = &self.words;
        let is_arc = |code: &Code| code.role == Role::Motion(MotionKind::Arc);
        let centres = words.taken.intersection(CENTRES);
        if centres.is_empty() || !words.taker.is_some_and(is_arc) {
            return;
        }
        let (unused, why) = if words.taken.contains(Address::R) {
            (centres, "with R the centre is not used")
        } else {
            let Some(plane) = state.modal.in_force.plane else {
                return;
            };
            let used = AddressSet::from_addresses(&plane.axes().map(restrictions::centre));
            if centres.intersection(used).is_empty() {
                // another check reports this case as an error
                return;
            }
            let unused = centres.without(used);
            (unused, "it is not in the plane of the arc")
        };
        let found: Vec<_> = unused
            .iter()
            .map(|address| {
                diagnostics::ARC_WORD_UNUSED.at(
                    tree.span_of(block, address),
                    format!("{} is not used: {why}", address.text()),
                    "Remove the word, or select the plane to which it belongs.",
                )
            })
            .collect();
        for finding in found {
            self.record_finding(here, finding, Weight::Sure);
        }
    }

    /// Warns of an arc whose end is not on its circle, if the text shows it. `state` is the state before the
    /// block.
    pub(super) fn arc_end(&mut self, here: CurrentBlock<'_>, state: &CheckState) {
        let words = &self.words;
        let is_arc = |code: &Code| code.role == Role::Motion(MotionKind::Arc);
        let is_doubted = self.dialect.policy.spiral == Spiral::Doubted;
        if !is_doubted || !words.taker.is_some_and(is_arc) || words.taken.contains(Address::R) {
            return;
        }
        let (in_force, own) = (&state.modal.in_force, words.sets());
        let Some(plane) = own.plane.or(in_force.plane) else {
            return;
        };
        let distance = own.distance.or(in_force.distance);
        let axes = plane.axes();
        let [x, y] = axes.map(|axis| state.position.move_distance(words, distance, axis));
        let [i, j] = axes.map(|axis| words.get(restrictions::centre(axis)).unwrap_or_default());
        let (start, end) = (i.hypot(j), (x - i).hypot(y - j));
        let difference = (start - end).abs();
        // If the text does not determine the start or end point, `difference` is NaN, and no warning follows.
        if start > 0.0 && difference > ROUNDING_MAX && difference > BESIDE_MAX * start {
            let CurrentBlock { tree, block, .. } = here;
            let finding = diagnostics::ARC_END_OFF.at(
                tree.span(block),
                format!("the arc begins {start:.3} from its centre and ends {end:.3} from it"),
                "Write I, J and K as distances from the start of the arc to its centre.",
            );
            self.record_finding(here, finding, Weight::Sure);
        }
    }

    /// Reports a cutting motion before the first F (alarm 101), if the machine has no default feedrate or is
    /// unknown. Also reports a thread before the first S (alarm 113).
    pub(super) fn feed_and_speed(&mut self, here: CurrentBlock<'_>, state: &mut CheckState) {
        let CurrentBlock { tree, block, .. } = here;
        let words = &self.words;
        let has = |address| words.present.contains(address) && !words.own.contains(address);
        let lacks_feed =
            !state.has_feed && !has(Address::F) && !words.taken.is_empty() && words.taker.is_some_and(cuts);
        let lacks_speed = !state.has_speed
            && !has(Address::S)
            && !words.taken.is_empty()
            && words.taker.is_some_and(threads);
        // on each path, the fault is reported only once
        state.has_feed |= lacks_feed || has(Address::F);
        state.has_speed |= lacks_speed || has(Address::S);
        if lacks_feed {
            let entry = match self.context.default_feedrate_mm_min {
                Some(_) => &diagnostics::FEEDRATE_MISSING,
                None => &diagnostics::FEEDRATE_OPEN,
            };
            let finding = entry.at(
                tree.span(block),
                "the block moves at the feedrate, but no feedrate is programmed",
                "Write F in this block or before it, or set default_feedrate.",
            );
            self.record_finding(here, finding, Weight::Sure);
        }
        if lacks_speed {
            let finding = diagnostics::SPEED_MISSING.at(
                tree.span(block),
                "the block cuts a thread, but no spindle speed is programmed",
                "Write S in this block or before it: the pitch is F / S.",
            );
            self.record_finding(here, finding, Weight::Sure);
        }
    }
}

/// Returns true for a code that moves at the feedrate.
fn cuts(code: &Code) -> bool {
    match code.role {
        Role::Motion(kind) => kind != MotionKind::Rapid,
        _ => code.group == ModalGroup::FixedCycle,
    }
}

/// Returns true for a cycle that cuts a thread.
fn threads(code: &Code) -> bool {
    matches!(code.sets, Some(ModalValue::Cycle(Some(cycle))) if cycle.threads().is_some())
}
