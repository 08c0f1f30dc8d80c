//! Limits of programs.

/// Largest size of a source text, bytes.
pub const SOURCE_BYTES_MAX: usize = 1024 * 1024;

/// Number of findings that are listed.
pub const FINDINGS_MAX: usize = 100;

/// Nesting depth of statements and expressions. Reason: each level takes some of the stack.
pub const NESTING_MAX: usize = 40;

/// Nesting depth of calls, including the program. Reason: see [`NESTING_MAX`].
pub const CALL_DEPTH_MAX: usize = 10;

/// Programs, function blocks, functions and types of a text.
pub const UNITS_MAX: usize = 256;

/// Number of values of all variables; a `STRING` has one value for each 16 characters.
pub const MEMORY_MAX: usize = 100_000;

/// Number of characters of a `STRING`; the default is [`STRING_DEFAULT`].
pub const STRING_MAX: usize = 1_000;

/// Characters of a `STRING` without a length.
pub const STRING_DEFAULT: usize = 255;

/// Dimensions of an array.
pub const DIMENSIONS_MAX: usize = 8;

/// Number of statements, operations and copied values of one scan. Reason: an endless loop must not stop the
/// machine's sequence side unnoticed.
pub const STEPS_MAX: u32 = 1_000_000;
