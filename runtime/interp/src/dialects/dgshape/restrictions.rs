//! Restrictions of dialect dgshape (manual dgshape, 2-2 and 2-3).

use tandem_syntax::diagnostics::{
    COMPENSATION_RULE, FIXED_CYCLE_RULE, M_NOT_ALONE, MACHINE_POSITION_RULE, TOOL_OFFSET_RULE, UNIT_CHANGE,
};

use crate::meaning::{MotionKind, Role};
use crate::restrictions::{ForbiddenElement, Restriction, RestrictionScope};

const fn in_compensation(what: ForbiddenElement, message: &'static str) -> Restriction {
    Restriction::new(
        &COMPENSATION_RULE,
        RestrictionScope::Compensation,
        what,
        message,
        LEAD_OUT,
    )
}

const fn alone(role: Role) -> Restriction {
    Restriction::new(
        &M_NOT_ALONE,
        RestrictionScope::Always,
        ForbiddenElement::Accompanied(role),
        "{code} is not alone in its block",
        "Write it in a block of its own.",
    )
}

const LEAD_OUT: &str = "Write {no compensation} and a lead-out before it.";
const DURING: &str = "{code} is not allowed during tool-diameter offset";
const ONLY_XY: &str = "the plane is not XY";
const SELECT_XY: &str = "Select the XY plane before it.";
const STRAIGHT: &str = "tool-diameter offset begins or ends with an arc";
const BY_LINES: &str = "Write G00 or {linear} in the block.";

/// Only the first restriction that a block violates is reported.
pub static RESTRICTIONS: [Restriction; 20] = [
    alone(Role::Stop),
    alone(Role::End),
    Restriction::new(
        &UNIT_CHANGE,
        RestrictionScope::UnitSettled,
        ForbiddenElement::OtherUnit,
        "{code} changes the unit during the program",
        "Write one unit at the start of the program, before all coordinates.",
    ),
    Restriction::new(
        &COMPENSATION_RULE,
        RestrictionScope::SideSwitch,
        ForbiddenElement::ArcInForce,
        STRAIGHT,
        BY_LINES,
    ),
    Restriction::new(
        &COMPENSATION_RULE,
        RestrictionScope::Lead,
        ForbiddenElement::MovesBy(MotionKind::Arc),
        STRAIGHT,
        BY_LINES,
    ),
    in_compensation(
        ForbiddenElement::OtherSide,
        "the side of the tool-diameter offset changes",
    ),
    in_compensation(
        ForbiddenElement::OffsetNumber,
        "the number of the tool-diameter offset changes",
    ),
    Restriction::new(
        &COMPENSATION_RULE,
        RestrictionScope::CompensatedBlock,
        ForbiddenElement::NotXy,
        ONLY_XY,
        SELECT_XY,
    ),
    in_compensation(ForbiddenElement::Has(Role::Coordinates), DURING),
    in_compensation(ForbiddenElement::CycleCode, DURING),
    Restriction::new(
        &COMPENSATION_RULE,
        RestrictionScope::CompensatedBlock,
        ForbiddenElement::MovesByCycle,
        DURING,
        LEAD_OUT,
    ),
    Restriction::new(
        &COMPENSATION_RULE,
        RestrictionScope::AnyCompensation,
        ForbiddenElement::Has(Role::ToReference),
        DURING,
        LEAD_OUT,
    ),
    Restriction::new(
        &COMPENSATION_RULE,
        RestrictionScope::AnyCompensation,
        ForbiddenElement::Has(Role::ToMachine),
        DURING,
        LEAD_OUT,
    ),
    Restriction::new(
        &COMPENSATION_RULE,
        RestrictionScope::CompensatedEnd,
        ForbiddenElement::Has(Role::End),
        "the program ends during tool-diameter offset",
        LEAD_OUT,
    ),
    Restriction::new(
        &COMPENSATION_RULE,
        RestrictionScope::CompensatedEnd,
        ForbiddenElement::Has(Role::Stop),
        "the program waits during tool-diameter offset",
        LEAD_OUT,
    ),
    Restriction::new(
        &COMPENSATION_RULE,
        RestrictionScope::NoCompensation,
        ForbiddenElement::Has(Role::Corner),
        "{code} is not allowed without tool-diameter offset",
        "Write {compensation} before it, or remove the code.",
    ),
    Restriction::new(
        &TOOL_OFFSET_RULE,
        RestrictionScope::ToolOffset,
        ForbiddenElement::Has(Role::ToMachine),
        "{code} is not allowed with a tool-length offset",
        "Write {no tool offset} before it, with G90 and a free Z. Without axis words, that moves Z down by the offset.",
    ),
    Restriction::new(
        &MACHINE_POSITION_RULE,
        RestrictionScope::Incremental,
        ForbiddenElement::Has(Role::ToMachine),
        "{code} is not allowed in incremental programming",
        "Write G90 in its block or before it.",
    ),
    Restriction::new(
        &FIXED_CYCLE_RULE,
        RestrictionScope::Drilling,
        ForbiddenElement::NotXy,
        ONLY_XY,
        SELECT_XY,
    ),
    Restriction::new(
        &FIXED_CYCLE_RULE,
        RestrictionScope::Drilling,
        ForbiddenElement::SpindleAtRest,
        "{code} drills while the spindle rests",
        "Write M03 before it.",
    ),
];
