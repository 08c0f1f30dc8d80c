//! M codes that the manual of dialect nj names as outputs.

/// The manual's description of an M code that is an output.
#[derive(Debug)]
pub struct UsualOutput {
    /// Number of the M code.
    pub m: u16,
    /// Name of the M code in the manual.
    pub name: &'static str,
    /// Description of the effect.
    pub docs: &'static str,
}

/// Outputs that turn and stop the spindle (manual 3, Spindle Axis).
pub(crate) static USUAL_OUTPUTS: &[UsualOutput] = &[
    UsualOutput {
        m: 3,
        name: "Spindle CW",
        docs: "Turns the spindle clockwise at S r/min. If no handler serves the M code, the runtime turns \
               the spindle of the coordinate system (D35).",
    },
    UsualOutput {
        m: 4,
        name: "Spindle CCW",
        docs: "Turns the spindle counter-clockwise at S r/min. If no handler serves the M code, the runtime \
               turns the spindle of the coordinate system (D35).",
    },
    UsualOutput {
        m: 5,
        name: "Spindle OFF",
        docs: "Stops the spindle. If no handler serves the M code, the runtime stops the spindle of the coordinate system (D35).",
    },
    UsualOutput {
        m: 19,
        name: "Spindle Orientation",
        docs: "Stops the spindle at its orientation position. If no handler serves the M code, the runtime \
               orients the spindle of the coordinate system (D35).",
    },
];
