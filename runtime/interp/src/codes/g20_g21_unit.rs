//! G20 Inch input and G21 Metric input; `units` of the coordinate system selects the start-up unit (D25).

use tandem_model::settings::Unit;

use super::Code;
use crate::meaning::ModalValue;

/// G20: lengths are in inches, feedrates in inches per minute.
pub static G20: Code = Code::setting(
    ModalValue::Unit(Unit::Inch),
    "G20",
    "Inch input",
    "Lengths and feedrates from this block on are in inches and inches per minute, also `max_feedrate` and \
     `default_feedrate` of the coordinate system. Motor limits, soft limits, offsets, tools and \
     `_CNC_CapturedPosition` stay in mm, and F of blocks that move rotary axes only stays in degrees per \
     minute (D25).",
);

/// G21: lengths are in mm, feedrates in mm/min.
pub static G21: Code = Code::setting(
    ModalValue::Unit(Unit::Millimetre),
    "G21",
    "Metric input",
    "Lengths and feedrates from this block on are in mm and mm/min. In force at start-up, unless units = \"inch\".",
);
