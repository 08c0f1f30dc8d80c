//! Variables of the NC language by name (manual 4-3).

/// Name of a variable: an array and an index.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Variable {
    /// Array of the variable.
    pub kind: VariableKind,
    /// Index in the array.
    pub index: u16,
}

/// The arrays of variables (manual 4-3), and the captured positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum VariableKind {
    /// L0 to L255: variables of one call.
    Local,
    /// Q0 to Q4095: variables of the coordinate system.
    CoordinateSystem,
    /// P0 to P32767: variables of the controller.
    Global,
    /// `_CNC_CapturedPosition<n>`, read only; n numbers the motors of the coordinate system from 0 (D16).
    CapturedPosition,
}

/// Highest index of a captured position: one for each axis that a coordinate system can have.
const CAPTURED_POSITION_MAX: u16 = 7;
const _: () = assert!(CAPTURED_POSITION_MAX as usize + 1 == tandem_model::AXES_MAX);

impl VariableKind {
    /// All arrays of variables.
    pub const ALL: [VariableKind; 4] = [
        VariableKind::Local,
        VariableKind::CoordinateSystem,
        VariableKind::Global,
        VariableKind::CapturedPosition,
    ];

    /// Returns the highest index (manual, table of parameters; captured positions: one for each possible
    /// axis).
    pub const fn index_max(self) -> u16 {
        match self {
            VariableKind::Local => 255,
            VariableKind::CoordinateSystem => 4095,
            VariableKind::Global => 32767,
            VariableKind::CapturedPosition => CAPTURED_POSITION_MAX,
        }
    }

    /// Returns a description of the variables: their content, lifetime, readers and writers.
    pub const fn meaning(self) -> &'static str {
        match self {
            VariableKind::Local => {
                "Local variables of one call of a program: all are 0 when the program is called or started \
                 (D12). Only this call reads and writes them."
            }
            VariableKind::CoordinateSystem => {
                "Variables of the coordinate system: its programs share them, and sequence programs and HMIs read and \
                 write them."
            }
            VariableKind::Global => {
                "Variables of the controller: all coordinate systems share them, and sequence programs and HMIs read and \
                 write them."
            }
            VariableKind::CapturedPosition => {
                "Machine position of a motor when its skip input ended the last G31, in mm or degrees; read \
                 only. The index numbers the motors of the coordinate system from 0 (D16, D41)."
            }
        }
    }

    /// Returns the array with this name; upper and lower case are equal (D01).
    pub(crate) fn find(letters: &str) -> Option<Self> {
        let mut kinds = Self::ALL.into_iter();
        kinds.find(|kind| kind.prefix().eq_ignore_ascii_case(letters))
    }

    /// Returns the name of the array, which stands before the index.
    pub const fn prefix(self) -> &'static str {
        match self {
            VariableKind::Local => "L",
            VariableKind::CoordinateSystem => "Q",
            VariableKind::Global => "P",
            VariableKind::CapturedPosition => "_CNC_CapturedPosition",
        }
    }
}
