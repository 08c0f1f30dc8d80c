//! Limits of every configuration, with their reasons and effects.

/// Subprogram call depth, counted from 1 (manual, M98). A deeper call is not made; a warning event reports it (D12).
pub const CALL_DEPTH_MAX: usize = 8;

/// Largest source text of one program, bytes: the limit of REST. A larger text is rejected unread.
pub const PROGRAM_BYTES_MAX: usize = 64 * 1024 * 1024;

/// Largest text of one manual data input, bytes.
pub const MDI_BYTES_MAX: usize = 32 * 1024;

/// Largest block after parsing, bytes (manual, chapter 1).
pub const BLOCK_BYTES_MAX: usize = 1020;

/// Highest optional block skip number (manual: 1 to 31).
pub const OPTIONAL_SKIP_MAX: u8 = 31;

/// Highest M code (manual: 0 to 191).
pub const M_CODE_MAX: u16 = 191;

/// Smallest number of a subprogram (D05; manual, table of instruction parameters).
pub const SUBPROGRAM_MIN: u16 = 1000;

/// Highest program number, that of subprograms (D05, manual's subprogram ranges).
pub const PROGRAM_NUMBER_MAX: u16 = 9999;

/// Default limit of blocks without movement (skipped, calculations, calls) that the interpreter may pass between two
/// items that move, wait or output before it raises an alarm: a program that never moves must not block a thread. A
/// loop that reads P or Q waits until they are written, and raises no alarm.
pub const STEPS_WITHOUT_ITEM_MAX: u32 = 1_000_000;

/// Blocks without an item after which a read of P or Q is treated as waiting: each then ends a chain, so that time
/// passes. Reason: a calculation of this many blocks takes some 20 ms.
pub const STEPS_BEFORE_WAIT: u32 = 100_000;

/// Blocks that the interpreter may pass before a chain of blended blocks ends at rest: the blocks held back by the path
/// stage and the planner must not wait for a long calculation.
pub const STEPS_IN_CHAIN_MAX: u32 = 10_000;

/// Coordinate systems of one machine.
pub const COORDINATE_SYSTEMS_MAX: usize = 8;
