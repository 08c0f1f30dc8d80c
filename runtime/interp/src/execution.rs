//! State that a code's effect reads and changes while its block is interpreted.

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

/// Limits of the coordinate system for words (D11).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// F above it is clipped, mm/min, in G20 inch/min (D25).
    pub max_feedrate_mm_min: f64,
    /// F before one is programmed, in the same unit.
    pub default_feedrate_mm_min: f64,
    /// S above it is an alarm, r/min; `None` without a spindle.
    pub max_spindle_speed_r_min: Option<f64>,
    /// True if the coordinate system has a spindle.
    pub has_spindle: bool,
    /// Amount by which a radius may be smaller than half the chord, mm (D26).
    pub arc_radius_tolerance_mm: f64,
    /// Maximum number of blocks in a row without motion or output.
    pub blocks_without_motion_max: u32,
    /// Options that the dialect leaves to the machine.
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

/// How the program continues after a block.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Flow {
    /// It continues with the next block.
    #[default]
    Next,
    /// It makes an output to the sequence program.
    Output {
        /// M number.
        m: u16,
        /// VA to VH.
        params: [Option<f64>; 8],
    },
    /// It stops by M00, or by M01 if `optional`.
    Stop {
        /// True for M01.
        optional: bool,
    },
    /// It ends.
    End,
    /// It calls a subprogram.
    Call {
        /// Number of the subprogram.
        program: u16,
        /// Number of calls.
        times: u16,
    },
    /// It returns to the caller.
    Return,
}

/// The parts of a block collected so far.
#[derive(Debug, Default)]
pub struct Draft {
    pub(crate) action: Option<Action>,
    /// True if the transform has changed.
    pub(crate) transforms: bool,
    /// True if the transform takes effect after the motion of the block.
    pub transform_after: bool,
    pub(crate) cycle: Option<Box<Expansion>>,
    /// Exact stops before and after the block's motion.
    pub exact_stops: [bool; 2],
    /// How the program continues.
    pub flow: Flow,
    pub(crate) warnings: Vec<String>,
    pub(crate) alarm: Option<Alarm>,
    /// True if the block needs the position, which is not yet known.
    pub(crate) needs_position: bool,
}

/// A block while it is interpreted.
#[derive(Debug)]
pub struct Execution<'a> {
    /// The dialect of the program.
    pub dialect: &'static Dialect,
    /// The words of the block.
    pub words: &'a BlockWords,
    /// The modal state, which codes change.
    pub modal: &'a mut Modal,
    /// Data kept by codes that set data. `None` if none have been set.
    pub(crate) kept: &'a mut Option<Arc<RetainedData>>,
    /// Values from outside.
    pub inputs: &'a Inputs<'a>,
    /// Limits of the coordinate system.
    pub limits: &'a Limits,
    /// Place of the code among the words of the block.
    pub place: usize,
    /// True for the first block in the start-up state.
    pub(crate) opens: bool,
    /// The result of the block.
    pub draft: &'a mut Draft,
}

impl Execution<'_> {
    /// Returns the data kept by codes that set data.
    pub(crate) fn retained(&self) -> &RetainedData {
        self.kept.as_deref().unwrap_or(&NOTHING_KEPT)
    }

    /// Returns the kept data for a change.
    pub(crate) fn retained_mut(&mut self) -> &mut RetainedData {
        Arc::make_mut(self.kept.get_or_insert_with(|| Arc::new(NOTHING_KEPT.clone())))
    }

    /// Returns the value of a word that no code of the block has as its own.
    pub fn free_word(&self, address: Address) -> Option<f64> {
        self.words
            .get(address)
            .filter(|_| !self.words.own.contains(address))
    }

    /// Returns the selected tool (D17). Without one, its radius or length (`what`) is 0, and the active code of the
    /// group issues a warning.
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

    /// Returns the entry of the tool table that a word of the block names. For number 0, and for a number
    /// that is not in the table, the entry is zero.
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

    /// Returns the position from which the next block is measured, in machine coordinates. While the end of a
    /// G31 is unknown, the result of this block is discarded, and the block is interpreted again after the
    /// G31.
    pub fn position(&mut self) -> AxisVector {
        self.draft.needs_position |= self.inputs.position.is_none();
        self.inputs.position.unwrap_or_default()
    }

    /// Returns a length in mm, whatever the unit in force (D25).
    pub fn length(&self, address: Address) -> Option<f64> {
        Some(self.words.get(address)? * self.modal.unit())
    }

    /// Returns the axis words that the motion or fixed cycle in force takes.
    pub fn axis_words(&self) -> AxisWords {
        self.axes_of(self.words.axis_words)
    }

    /// Returns the axis words that a code of the block has as its own.
    pub fn own_axis_words(&self) -> AxisWords {
        self.axes_of(self.words.present.intersection(AXIS_ADDRESSES))
    }

    /// Returns a centre on these axes, absolute: from the axis words that a code of the block has as its own. An axis
    /// that has none takes the tool's position, which `seen` computes from the transform and the machine position.
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

    /// Ends scaling, mirroring and rotation. Returns true if this changes the transform.
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

    /// Sets the action of the block.
    pub fn act(&mut self, action: Action) {
        self.draft.action = Some(action);
    }

    /// Changes the transform; the change applies from this block's motion on.
    pub fn transform(&mut self, change: impl FnOnce(&mut Transform)) {
        change(&mut self.modal.transform);
        self.draft.transforms = true;
    }

    /// Rejects the block with an alarm; the first one is reported.
    pub fn refuse(&mut self, alarm: Alarm) {
        self.draft.alarm.get_or_insert(alarm);
    }

    /// Publishes an event; the program continues.
    pub fn warn(&mut self, text: String) {
        self.draft.warnings.push(text);
    }
}

/// Returns the axis of an address.
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
