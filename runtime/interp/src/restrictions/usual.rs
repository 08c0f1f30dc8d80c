//! Restrictions of fixed cycles, cutter compensation and machine positions (D23; manual, restrictions of G41
//! and G74).

use tandem_syntax::diagnostics::{COMPENSATION_RULE, FIXED_CYCLE_RULE, TOOL_OFFSET_RULE};

use super::{ForbiddenElement, Restriction, RestrictionScope};
use crate::meaning::{MotionKind, Role};

const fn in_compensation(
    during: RestrictionScope,
    what: ForbiddenElement,
    message: &'static str,
    help: &'static str,
) -> Restriction {
    Restriction::new(&COMPENSATION_RULE, during, what, message, help)
}

const LEAD_OUT: &str = "Write {no compensation} and a lead-out first.";
const CUTTING: &str = "during cutter compensation, only {cutting} are allowed as motions";
const WAITS: &str = "the program waits during cutter compensation";
const WAIT_ELSEWHERE: &str = "Write it before {compensation}, or after the lead-out.";

/// Restrictions in the order of the check: only the first restriction that a block violates is reported.
pub static USUAL: [Restriction; 13] = [
    Restriction::new(
        &FIXED_CYCLE_RULE,
        RestrictionScope::CycleBegin,
        ForbiddenElement::MissingOfCycle,
        "the first block of a fixed cycle has no {code}",
        "Write {needed} in it.",
    ),
    Restriction::new(
        &FIXED_CYCLE_RULE,
        RestrictionScope::Cycle,
        ForbiddenElement::ForeignToCycles,
        "{code} is not allowed in a fixed cycle",
        "Write {no cycle} before it.",
    ),
    in_compensation(
        RestrictionScope::Lead,
        ForbiddenElement::MovesBy(MotionKind::Arc),
        "an arc leads cutter compensation in or out",
        "Lead in and out with {linear}.",
    ),
    in_compensation(
        RestrictionScope::Compensation,
        ForbiddenElement::OtherSide,
        "the side of the compensation changes",
        LEAD_OUT,
    ),
    in_compensation(
        RestrictionScope::Compensation,
        ForbiddenElement::OtherPlane,
        "the plane changes during cutter compensation",
        LEAD_OUT,
    ),
    in_compensation(
        RestrictionScope::CompensatedBlock,
        ForbiddenElement::MovesBy(MotionKind::Rapid),
        CUTTING,
        LEAD_OUT,
    ),
    in_compensation(
        RestrictionScope::CompensationOrWayOut,
        ForbiddenElement::MovesByCycle,
        CUTTING,
        LEAD_OUT,
    ),
    in_compensation(
        RestrictionScope::CompensationOrWayOut,
        ForbiddenElement::Has(Role::Skip),
        CUTTING,
        LEAD_OUT,
    ),
    in_compensation(
        RestrictionScope::CompensatedEnd,
        ForbiddenElement::Has(Role::End),
        "the program ends during cutter compensation",
        "Write {no compensation} and a lead-out before it.",
    ),
    in_compensation(
        RestrictionScope::CompensatedEnd,
        ForbiddenElement::Has(Role::Stop),
        WAITS,
        WAIT_ELSEWHERE,
    ),
    in_compensation(
        RestrictionScope::CompensatedEnd,
        ForbiddenElement::Parameters,
        WAITS,
        WAIT_ELSEWHERE,
    ),
    in_compensation(
        RestrictionScope::AnyCompensation,
        ForbiddenElement::Has(Role::ToMachine),
        "{code} is not allowed during cutter compensation",
        "Write {no compensation} and a lead-out before it.",
    ),
    Restriction::new(
        &TOOL_OFFSET_RULE,
        RestrictionScope::ToolOffset,
        ForbiddenElement::Has(Role::ToMachine),
        "{code} is not allowed with a tool offset",
        "Write {no tool offset} before it, with G90 and a motion to a free Z. Under G91, Z comes down by the offset.",
    ),
];
