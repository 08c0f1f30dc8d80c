//! External values that the interpreter reads.

use std::collections::BTreeMap;
use std::sync::Arc;

use tandem_model::settings::{Tool, WorkOffsets};
use tandem_model::variables::Variables;
use tandem_model::{AXES_MAX, AxisVector};
use tandem_syntax::NcProgram;

/// An empty tool table.
pub static NO_TOOLS: BTreeMap<u16, Tool> = BTreeMap::new();

/// External values that the interpreter reads when it interprets a block (D16).
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a> {
    /// The programs that M98 may call.
    pub programs: &'a BTreeMap<u16, Arc<NcProgram>>,
    /// Block skip inputs: bit `n - 1` for number `n` (D13).
    pub optional_skip: u32,
    /// Work offsets of G54 to G59.
    pub work_offsets: &'a WorkOffsets,
    /// The variables P and Q.
    pub variables: &'a Variables,
    /// The selected tool (D17). `None` if no tool is selected, or if the selected tool is not in the table;
    /// G41 to G44 then warn.
    pub tool: Option<Tool>,
    /// The tool table by number, for dialects in which a word names the number of an offset.
    pub tools: &'a BTreeMap<u16, Tool>,
    /// Values of `_CNC_CapturedPosition<n>` after the last G31, in command units (D41). `None` while a G31
    /// that was returned is unfinished; a block that reads a captured position then returns
    /// `Item::NeedsStandstill` (D15).
    pub captured: Option<[f64; AXES_MAX]>,
    /// Machine position from which the next block is measured: the end of all items returned so far,
    /// including a change of tool length that no motion has applied yet (D22). `None` while the end of a G31
    /// is unknown; a block that needs the position then returns `Item::NeedsStandstill`.
    pub position: Option<AxisVector>,
}
