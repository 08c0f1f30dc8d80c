//! State that the effects of codes read and change while a block is interpreted.

use std::sync::Arc;

use tandem_model::Alarm;
use tandem_model::alarm::VALUE_LOST;
use tandem_model::axis::{Axis, AxisSet, AxisVector};
use tandem_model::flow::{Action, AxisWords, Frame, Transform};
use tandem_model::settings::{CoordinateSystemSettings, NcOptions, Tool};
use tandem_syntax::{Address, AddressSet};

use crate::block_words::BlockWords;
use crate::codes::{AXIS_ADDRESSES, ModalGroup};
use crate::dialect::Dialect;
use crate::fixed_cycles::Expansion;
use crate::inputs::Inputs;
use crate::meaning::ModalValue;
use crate::modal::{Modal, NOTHING_KEPT, RetainedData};

/// Limits of the coordinate system that apply to words (D11).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Maximum feedrate, mm/min, in G20 inch/min (D25); a larger F is clipped.
    pub max_feedrate_mm_min: f64,
    /// Feedrate before the first F, mm/min, in G20 inch/min.
    pub default_feedrate_mm_min: f64,
    /// Maximum spindle speed, r/min; a larger S is an alarm. `None` without a spindle.
    pub max_spindle_speed_r_min: Option<f64>,
    /// True if the coordinate system has a spindle.
    pub has_spindle: bool,
    /// Amount by which the radius R of an arc may be smaller than half the chord, mm (D26).
    pub arc_radius_tolerance_mm: f64,
    /// Maximum number of blocks in a row without motion and without output.
    pub blocks_without_motion_max: u32,
    /// NC options that the dialect leaves to the machine.
    pub options: NcOptions,
}

impl Limits {
    pub(crate) fn from_settings(settings: &CoordinateSystemSettings) -> Self {
        Self {
            max_feedrate_mm_min: settings.max_feedrate_mm_min,
            default_feedrate_mm_min: settings.default_feedrate_mm_min,
            max_spindle_speed_r_min: settings.spindle.as_ref().map(|spindle| spindle.max_velocity),
            has_spindle: settings.spindle.is_some(),
            arc_radius_tolerance_mm: settings.motion.arc_radius_tolerance_mm,
            blocks_without_motion_max: settings.blocks_without_motion_max,
            options: settings.nc,
        }
    }
}

/// Continuation of the program after a block.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Flow {
    /// The program continues with the next block.
    #[default]
    Next,
    /// The block makes an output to the sequence program.
    Output {
        /// M number of the output.
        m: u16,
        /// Values of VA to VH; `None` for a parameter that is not programmed.
        params: [Option<f64>; 8],
    },
    /// The program stops by M00, or by M01 if `optional`.
    Stop {
        /// True for M01, which stops only if the optional stop input is on.
        optional: bool,
    },
    /// The program ends.
    End,
    /// The block calls a subprogram.
    Call {
        /// Program number of the subprogram.
        program: u16,
        /// Number of times that the subprogram runs.
        times: u16,
    },
    /// The subprogram returns to its caller.
    Return,
}

/// Result of a block, collected while its codes take effect.
#[derive(Debug, Default)]
pub struct Draft {
    pub(crate) action: Option<Action>,
    /// True if the block has changed the transform.
    pub(crate) transforms: bool,
    /// True if the changed transform takes effect after the motion of the block.
    pub transform_after: bool,
    pub(crate) cycle: Option<Box<Expansion>>,
    /// Exact stop before the motion of the block, and exact stop after it.
    pub exact_stops: [bool; 2],
    /// Continuation of the program after the block.
    pub flow: Flow,
    pub(crate) warnings: Vec<String>,
    pub(crate) alarm: Option<Alarm>,
    /// True if the block needs the machine position, which is not yet known.
    pub(crate) needs_position: bool,
}

/// A block while it is interpreted, with the data that its codes read and change.
#[derive(Debug)]
pub struct Execution<'a> {
    /// The dialect of the program.
    pub dialect: &'static Dialect,
    /// Words of the block.
    pub words: &'a BlockWords,
    /// Modal state, which the codes of the block change.
    pub modal: &'a mut Modal,
    /// Data that G10, G28 or G92 has set. `None` before the first such code.
    pub(crate) kept: &'a mut Option<Arc<RetainedData>>,
    /// External values that the block reads.
    pub inputs: &'a Inputs<'a>,
    /// Limits of the coordinate system.
    pub limits: &'a Limits,
    /// Index of the current code among the words of the block.
    pub place: usize,
    /// True for the first block of words after a reset, which selects the work coordinate system of the
    /// start-up state.
    pub(crate) opens: bool,
    /// Result of the block, which its codes collect.
    pub draft: &'a mut Draft,
}

impl Execution<'_> {
    /// Returns the data that G10, G28 and G92 have set.
    pub(crate) fn retained(&self) -> &RetainedData {
        self.kept.as_deref().unwrap_or(&NOTHING_KEPT)
    }

    /// Returns the data that G10, G28 and G92 have set, so that a code can change them.
    pub(crate) fn retained_mut(&mut self) -> &mut RetainedData {
        Arc::make_mut(self.kept.get_or_insert_with(|| Arc::new(NOTHING_KEPT.clone())))
    }

    /// Returns the value of a word, unless a code of the block other than the motion or fixed cycle takes the
    /// word.
    pub fn free_word(&self, address: Address) -> Option<f64> {
        self.words
            .get(address)
            .filter(|_| !self.words.own.contains(address))
    }

    /// Returns the selected tool (D17). Without a selected tool, issues a warning and returns a tool of
    /// length and radius 0. The warning names the active code of `group` and `what` (radius or length).
    pub fn selected_tool(&mut self, group: ModalGroup, what: &str) -> Tool {
        if self.inputs.tool.is_some_and(|tool| tool.is_lost()) {
            let text =
                format!("the {what} of the tool in the spindle is damaged, or the number of that tool");
            self.refuse(Alarm::new(&VALUE_LOST, text));
            return Tool::default();
        }
        self.inputs.tool.unwrap_or_else(|| {
            let code = self.modal.code(group).map_or("", |code| code.code);
            self.warn(format!(
                "{code}: no tool of the tool table is selected; a {what} of 0 mm is used"
            ));
            Tool::default()
        })
    }

    /// Returns the entry of the tool table whose number the word with this address gives. For number 0, and
    /// for a number that is not in the table, the entry is zero.
    pub(crate) fn offset_entry(&mut self, address: Address) -> (u16, Tool) {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "the range has been checked, and a cast saturates"
        )]
        let number = self.words.get(address).unwrap_or_default() as u16;
        let tool = self.inputs.tools.get(&number).copied();
        if tool.is_some_and(|tool| tool.is_lost()) {
            let text = format!("offset {number} is damaged");
            self.refuse(Alarm::new(&VALUE_LOST, text));
        }
        let is_set = number == 0 || tool.is_some() || self.retained().radii.contains_key(&number);
        if !is_set {
            let name = address.text();
            self.warn(format!(
                "{name}{number}: the tool table has no offset of this number; 0 mm is used"
            ));
        }
        (number, tool.unwrap_or_default())
    }

    /// Returns the machine position from which the next block is measured. While the end of a G31 is unknown,
    /// the interpreter discards the result of this block, and interprets the block again after the G31.
    pub fn position(&mut self) -> AxisVector {
        self.draft.needs_position |= self.inputs.position.is_none();
        self.inputs.position.unwrap_or_default()
    }

    /// Returns the length in a word, converted from the active unit to mm (D25).
    pub fn length(&self, address: Address) -> Option<f64> {
        Some(self.words.get(address)? * self.modal.unit())
    }

    /// Returns the axis words that the active motion or fixed cycle takes.
    pub fn axis_words(&self) -> AxisWords {
        self.axes_of(self.words.axis_words)
    }

    /// Returns the axis words of the block for a code that takes axis words instead of the motion.
    pub fn own_axis_words(&self) -> AxisWords {
        self.axes_of(self.words.present.intersection(AXIS_ADDRESSES))
    }

    /// Returns a centre on the axes `of`, absolute. An axis with an axis word takes the value of this word.
    /// Any other axis takes the tool's position, which `seen` computes from the transform and the machine
    /// position.
    pub fn centre(&mut self, of: &[Axis], seen: fn(&Transform, AxisVector) -> AxisVector) -> AxisVector {
        let words = self.own_axis_words();
        let mut centre = AxisVector::ZERO;
        if !of.iter().all(|axis| words.named.contains(*axis)) {
            let position = self.position();
            centre = seen(&self.modal.transform, position);
        }
        for axis in words.named.iter() {
            centre[axis] = words.values[axis];
        }
        centre
    }

    fn axes_of(&self, addresses: AddressSet) -> AxisWords {
        let mut values = AxisVector::ZERO;
        let mut named = AxisSet::EMPTY;
        for address in addresses.iter() {
            if let Some(axis) = axis_of(address) {
                let value = self.words.get(address).unwrap_or_default();
                values[axis] = if axis.is_orthogonal() {
                    value * self.modal.unit()
                } else {
                    value
                };
                named.insert(axis);
            }
        }
        AxisWords {
            values,
            named,
            distance: self.modal.distance(),
            frame: Frame::Work,
        }
    }

    /// Switches scaling, mirroring and rotation off. Returns true if this changes the transform.
    pub fn release_shape(&mut self) -> bool {
        for code in self.dialect.start_up {
            if matches!(code.sets, Some(ModalValue::Shape(_, false))) {
                self.modal.remember(code);
            }
        }
        let transform = &self.modal.transform;
        let any = transform.mirror.is_some() || transform.scaling.is_some() || transform.rotation.is_some();
        if any {
            self.transform(|transform| {
                (transform.mirror, transform.scaling, transform.rotation) = (None, None, None);
            });
        }
        any
    }

    /// Sets the action of the block, such as a motion.
    pub fn act(&mut self, action: Action) {
        self.draft.action = Some(action);
    }

    /// Changes the transform with `change`; the change applies from the motion of this block on.
    pub fn transform(&mut self, change: impl FnOnce(&mut Transform)) {
        change(&mut self.modal.transform);
        self.draft.transforms = true;
    }

    /// Rejects the block with an alarm. If a block causes several alarms, the first is reported.
    pub fn refuse(&mut self, alarm: Alarm) {
        self.draft.alarm.get_or_insert(alarm);
    }

    /// Adds a warning, which is published as an event; the program continues.
    pub fn warn(&mut self, text: String) {
        self.draft.warnings.push(text);
    }
}

/// Returns the axis of an address, or `None` if the address is not an axis.
pub(crate) const fn axis_of(address: Address) -> Option<Axis> {
    match address {
        Address::X => Some(Axis::X),
        Address::Y => Some(Axis::Y),
        Address::Z => Some(Axis::Z),
        Address::A => Some(Axis::A),
        Address::B => Some(Axis::B),
        Address::C => Some(Axis::C),
        _ => None,
    }
}
