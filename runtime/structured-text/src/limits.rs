//! Limits of programs.

/// Bytes of a source text.
pub const SOURCE_BYTES_MAX: usize = 1024 * 1024;

/// Findings that are listed.
pub const FINDINGS_MAX: usize = 100;

/// Statements and expressions within each other. Reason: each takes some of the stack.
pub const NESTING_MAX: usize = 40;

/// Functions and function blocks that call each other, program included. Reason: as [`NESTING_MAX`].
pub const CALL_DEPTH_MAX: usize = 10;

/// Programs, function blocks, functions and types of a text.
pub const UNITS_MAX: usize = 256;

/// Values of all variables; a `STRING` counts as one for each 16 characters.
pub const MEMORY_MAX: usize = 100_000;

/// Characters of a `STRING`, whose default is [`STRING_DEFAULT`].
pub const STRING_MAX: usize = 1_000;

/// Characters of a `STRING` without a length.
pub const STRING_DEFAULT: usize = 255;

/// Dimensions of an array.
pub const DIMENSIONS_MAX: usize = 8;

/// Statements, operations and copied values of one scan. Reason: a loop without end must not stop the machine's sequence side
/// unnoticed.
pub const STEPS_MAX: u32 = 1_000_000;
