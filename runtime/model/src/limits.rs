//! Limits of every configuration, with their reasons and effects.

/// Maximum depth of subprogram calls, counted from 1 (manual, M98). The interpreter skips a deeper call; a
/// warning event reports it (D12).
pub const CALL_DEPTH_MAX: usize = 8;

/// Maximum source text of one program, bytes: the limit of REST. The runtime rejects a larger text without
/// reading it.
pub const PROGRAM_BYTES_MAX: usize = 64 * 1024 * 1024;

/// Maximum text of one manual data input, bytes.
pub const MDI_BYTES_MAX: usize = 32 * 1024;

/// Maximum size of a block after parsing, bytes (manual, chapter 1).
pub const BLOCK_BYTES_MAX: usize = 1020;

/// Highest optional block skip number (manual: 1 to 31).
pub const OPTIONAL_SKIP_MAX: u8 = 31;

/// Highest M code (manual: 0 to 191).
pub const M_CODE_MAX: u16 = 191;

/// Smallest number of a subprogram (D05; manual, table of instruction parameters).
pub const SUBPROGRAM_MIN: u16 = 1000;

/// Highest program number, which is also the highest number of a subprogram (D05, manual's subprogram
/// ranges).
pub const PROGRAM_NUMBER_MAX: u16 = 9999;

/// Default limit of blocks without movement (skipped blocks, calculations, calls) between two items that
/// move, wait or output. After this many the interpreter raises an alarm, because a program that never moves
/// must not block a thread. A loop that reads P or Q waits until they are written, and raises no alarm.
pub const STEPS_WITHOUT_ITEM_MAX: u32 = 1_000_000;

/// Number of blocks without an item after which a read of P or Q is treated as a wait. Each such read then
/// ends a chain, so that time passes. Reason: a calculation of this many blocks takes some 20 ms.
pub const STEPS_BEFORE_WAIT: u32 = 100_000;

/// Number of blocks that the interpreter may pass before a chain of blended blocks ends at rest. Reason: the
/// path stage and the planner hold back blocks, which must not wait for a long calculation.
pub const STEPS_IN_CHAIN_MAX: u32 = 10_000;

/// Maximum number of coordinate systems of one machine.
pub const COORDINATE_SYSTEMS_MAX: usize = 8;
