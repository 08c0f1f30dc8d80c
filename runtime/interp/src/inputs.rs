//! External values that the interpreter reads.

use std::collections::BTreeMap;
use std::sync::Arc;

use tandem_model::settings::{Tool, WorkOffsets};
use tandem_model::variables::Variables;
use tandem_model::{AXES_MAX, AxisVector};
use tandem_syntax::NcProgram;

/// An empty tool table.
pub static NO_TOOLS: BTreeMap<u16, Tool> = BTreeMap::new();

/// Values from outside, read when a block is interpreted (D16).
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a> {
    /// The programs that M98 may call.
    pub programs: &'a BTreeMap<u16, Arc<NcProgram>>,
    /// Block skip inputs: bit `n - 1` for number `n` (D13).
    pub optional_skip: u32,
    /// G54 to G59.
    pub work_offsets: &'a WorkOffsets,
    /// P and Q.
    pub variables: &'a Variables,
    /// The selected tool (D17); `None` if no tool is selected, or one that is not in the table: G41 to G44
    /// then warn.
    pub tool: Option<Tool>,
    /// The tool table by number, for dialects whose words name an offset.
    pub tools: &'a BTreeMap<u16, Tool>,
    /// `_CNC_CapturedPosition<n>` of the last G31, in command units (D41). `None` while a returned G31 is
    /// unfinished: a block that reads a captured position returns `Item::NeedsStandstill` (D15).
    pub captured: Option<[f64; AXES_MAX]>,
    /// Position from which the next block is measured, machine coordinates: the end of all items returned so
    /// far, with a change of tool length that no motion has applied yet (D22). `None` while the end of a G31
    /// is unknown: a block that needs the position returns `Item::NeedsStandstill`.
    pub position: Option<AxisVector>,
}
