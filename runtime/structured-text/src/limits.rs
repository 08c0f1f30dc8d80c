//! Limits of programs.

/// Largest size of a source text, bytes.
pub const SOURCE_BYTES_MAX: usize = 1024 * 1024;

/// Largest number of findings that are listed.
pub const FINDINGS_MAX: usize = 100;

/// Greatest nesting depth of statements and expressions. Reason: each level takes some of the stack.
pub const NESTING_MAX: usize = 40;

/// Greatest nesting depth of calls, including the program. Reason: see [`NESTING_MAX`].
pub const CALL_DEPTH_MAX: usize = 10;

/// Largest number of programs, function blocks, functions and types of a source text together.
pub const UNITS_MAX: usize = 256;

/// Largest number of values of all variables; a `STRING` has one value for each 16 characters.
pub const MEMORY_MAX: usize = 100_000;

/// Largest length of a `STRING`, characters; the default is [`STRING_DEFAULT`].
pub const STRING_MAX: usize = 1_000;

/// Length of a `STRING` that is declared without a length, characters.
pub const STRING_DEFAULT: usize = 255;

/// Largest number of dimensions of an array.
pub const DIMENSIONS_MAX: usize = 8;

/// Largest number of statements, operations and copied values of one scan. Reason: an endless loop must not stop
/// the sequence program unnoticed.
pub const STEPS_MAX: u32 = 1_000_000;
