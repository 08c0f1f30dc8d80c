//! Meaning of codes, independent of their numbers in a dialect: the values that modal codes set, and the role
//! of a code in its block. The decisions of checker and interpreter depend only on these meanings.

use tandem_model::flow::{Distance, MultiBlock, PathControl};
use tandem_model::plane::Plane;
use tandem_model::settings::Unit;

use crate::fixed_cycles::FixedCycle;

/// Side of the path on which cutter compensation guides the tool's centre.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Side {
    /// The tool's centre moves on the path: no compensation.
    #[default]
    Off,
    /// The tool's centre is to the left of the path, seen along the motion.
    Left,
    /// The tool's centre is to the right of the path, seen along the motion.
    Right,
}

/// Effect of the selected tool's length on Z.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LengthOffset {
    /// The length has no effect.
    #[default]
    Off,
    /// The length is added to Z.
    Added,
    /// The length is subtracted from Z.
    Subtracted,
}

/// The level at which a fixed cycle ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ReturnLevel {
    /// The initial level: Z where the cycle began.
    #[default]
    Initial,
    /// The Z level of the R point.
    RPoint,
}

/// Functions that change the shape of a programmed path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// Scaling: a factor for each axis.
    Scaling,
    /// Mirroring: axes with reversed direction.
    Mirroring,
    /// Rotation: an angle in a plane.
    Rotation,
}

/// Value that a modal code sets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ModalValue {
    /// The plane of arcs, cutter compensation and rotation.
    Plane(Plane),
    /// Meaning of axis words: positions or distances.
    Distance(Distance),
    /// Unit of lengths.
    Unit(Unit),
    /// Side of cutter compensation.
    Side(Side),
    /// Effect of the tool length.
    Length(LengthOffset),
    /// The active fixed cycle. `None` for the end of a cycle.
    Cycle(Option<&'static FixedCycle>),
    /// Level to which fixed cycles return.
    ReturnLevel(ReturnLevel),
    /// Selects whether blocks may blend.
    PathControl(PathControl),
    /// Selects whether acceleration ramps span blocks.
    MultiBlock(MultiBlock),
    /// A function that changes the shape; true if it is on.
    Shape(Shape, bool),
    /// True if the spindle turns.
    Spindle(bool),
}

/// Kind of a modal motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MotionKind {
    /// Each motor moves alone, in its shortest time.
    Rapid,
    /// A straight line, at the feedrate.
    Linear,
    /// An arc at the feedrate.
    Arc,
}

/// Role of a code in its block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// A code that only sets or requests values: it moves nothing, and positions do not change.
    Plain,
    /// A motion that stays active until another motion code.
    Motion(MotionKind),
    /// A motion, in its block only, that a signal may end.
    Skip,
    /// A motion, in its block only, whose target is a machine position.
    ToMachine,
    /// A motion, in its block only, of the named axes to a reference point.
    ToReference,
    /// An arc about the corner between two motions during cutter compensation.
    Corner,
    /// A dwell; its words are times, whatever their addresses.
    Dwell,
    /// A code that changes the coordinates of later positions.
    Coordinates,
    /// An output to the sequence program.
    Auxiliary,
    /// A call of a subprogram.
    Call,
    /// The end of a subprogram.
    Return,
    /// The end of the program.
    End,
    /// A stop until the program is resumed.
    Stop,
}

/// Modal values in force; `None` if a value is unknown.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct InForce {
    /// The plane of arcs, cutter compensation and rotation.
    pub plane: Option<Plane>,
    /// Meaning of axis words: positions or distances.
    pub distance: Option<Distance>,
    /// The unit of lengths.
    pub unit: Option<Unit>,
    /// Side of cutter compensation.
    pub side: Option<Side>,
    /// Number of the offset that cutter compensation uses, in dialects with offset numbers.
    pub offset_number: Option<f64>,
    /// Effect of the tool length.
    pub length: Option<LengthOffset>,
    /// Number of the offset that gives the tool length, in dialects with offset numbers.
    pub length_number: Option<f64>,
    /// The fixed cycle; `Some(None)` if no cycle is active.
    pub cycle: Option<Option<&'static FixedCycle>>,
    /// Level to which fixed cycles return.
    pub return_level: Option<ReturnLevel>,
    /// Selects whether blocks may blend.
    pub path_control: Option<PathControl>,
    /// Selects whether acceleration ramps span blocks.
    pub multi_block: Option<MultiBlock>,
    /// For each function of [`Shape`], true if it is on.
    pub shapes: [Option<bool>; 3],
    /// True if the spindle turns.
    pub spindle: Option<bool>,
}

impl InForce {
    /// The modal state before any code has set a value.
    pub(crate) const START: Self = Self {
        plane: Some(Plane::Xy),
        distance: Some(Distance::Absolute),
        unit: Some(Unit::Millimetre),
        side: Some(Side::Off),
        offset_number: None,
        length: Some(LengthOffset::Off),
        length_number: None,
        cycle: Some(None),
        return_level: Some(ReturnLevel::Initial),
        path_control: Some(PathControl::ContinuousPath),
        multi_block: Some(MultiBlock::Off),
        shapes: [Some(false); 3],
        spindle: Some(false),
    };

    /// Sets a modal value.
    pub(crate) fn set(&mut self, value: ModalValue) {
        match value {
            ModalValue::Plane(plane) => self.plane = Some(plane),
            ModalValue::Distance(distance) => self.distance = Some(distance),
            ModalValue::Unit(unit) => self.unit = Some(unit),
            ModalValue::Side(side) => self.side = Some(side),
            ModalValue::Length(length) => self.length = Some(length),
            ModalValue::Cycle(cycle) => self.cycle = Some(cycle),
            ModalValue::ReturnLevel(level) => self.return_level = Some(level),
            ModalValue::PathControl(control) => self.path_control = Some(control),
            ModalValue::MultiBlock(multi_block) => self.multi_block = Some(multi_block),
            ModalValue::Shape(shape, is_on) => self.shapes[shape as usize] = Some(is_on),
            ModalValue::Spindle(turns) => self.spindle = Some(turns),
        }
    }

    /// Sets each value that is different in `other` to unknown (`None`).
    pub(crate) fn join(&mut self, other: &Self) {
        fn both<T: PartialEq + Copy>(one: &mut Option<T>, other: Option<T>) {
            if *one != other {
                *one = None;
            }
        }
        both(&mut self.plane, other.plane);
        both(&mut self.distance, other.distance);
        both(&mut self.unit, other.unit);
        both(&mut self.side, other.side);
        both(&mut self.offset_number, other.offset_number);
        if self.length_number != other.length_number {
            // number 0 means no offset, so the effect of the length differs too
            (self.length, self.length_number) = (None, None);
        }
        both(&mut self.length, other.length);
        both(&mut self.cycle, other.cycle);
        both(&mut self.return_level, other.return_level);
        both(&mut self.path_control, other.path_control);
        both(&mut self.multi_block, other.multi_block);
        for (shape, other) in self.shapes.iter_mut().zip(&other.shapes) {
            both(shape, *other);
        }
        both(&mut self.spindle, other.spindle);
    }

    /// Returns true if cutter compensation is on.
    pub(crate) fn compensates(&self) -> bool {
        matches!(self.side, Some(Side::Left | Side::Right))
    }
}
