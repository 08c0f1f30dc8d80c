//! The restrictions of fixed cycles, cutter compensation and machine positions (D23; manual, restrictions of G41 and G74).

use tandem_syntax::diagnostics::{COMPENSATION_RULE, FIXED_CYCLE_RULE, TOOL_OFFSET_RULE};

use super::{During, Restriction, What};
use crate::meaning::{MotionKind, Role};

const fn in_compensation(
    during: During,
    what: What,
    message: &'static str,
    help: &'static str,
) -> Restriction {
    Restriction::new(&COMPENSATION_RULE, during, what, message, help)
}

const LEAD_OUT: &str = "Write {no compensation} and a lead-out first.";
const CUTTING: &str = "during cutter compensation, only {cutting} are allowed as motions";
const WAITS: &str = "the program waits during cutter compensation";
const WAIT_ELSEWHERE: &str = "Write it before {compensation}, or after the lead-out.";

/// Only the first restriction that a block violates is reported.
pub static USUAL: [Restriction; 13] = [
    Restriction::new(
        &FIXED_CYCLE_RULE,
        During::CycleBegin,
        What::MissingOfCycle,
        "the first block of a fixed cycle has no {code}",
        "Write {needed} in it.",
    ),
    Restriction::new(
        &FIXED_CYCLE_RULE,
        During::Cycle,
        What::ForeignToCycles,
        "{code} is not allowed in a fixed cycle",
        "Write {no cycle} before it.",
    ),
    in_compensation(
        During::Lead,
        What::MovesBy(MotionKind::Arc),
        "an arc leads cutter compensation in or out",
        "Lead in and out with {linear}.",
    ),
    in_compensation(
        During::Compensation,
        What::OtherSide,
        "the side of the compensation changes",
        LEAD_OUT,
    ),
    in_compensation(
        During::Compensation,
        What::OtherPlane,
        "the plane changes during cutter compensation",
        LEAD_OUT,
    ),
    in_compensation(
        During::CompensatedBlock,
        What::MovesBy(MotionKind::Rapid),
        CUTTING,
        LEAD_OUT,
    ),
    in_compensation(
        During::CompensationOrWayOut,
        What::MovesByCycle,
        CUTTING,
        LEAD_OUT,
    ),
    in_compensation(
        During::CompensationOrWayOut,
        What::Has(Role::Skip),
        CUTTING,
        LEAD_OUT,
    ),
    in_compensation(
        During::CompensatedEnd,
        What::Has(Role::End),
        "the program ends during cutter compensation",
        "Write {no compensation} and a lead-out before it.",
    ),
    in_compensation(
        During::CompensatedEnd,
        What::Has(Role::Stop),
        WAITS,
        WAIT_ELSEWHERE,
    ),
    in_compensation(During::CompensatedEnd, What::Parameters, WAITS, WAIT_ELSEWHERE),
    in_compensation(
        During::AnyCompensation,
        What::Has(Role::ToMachine),
        "{code} is not allowed during cutter compensation",
        "Write {no compensation} and a lead-out before it.",
    ),
    Restriction::new(
        &TOOL_OFFSET_RULE,
        During::ToolOffset,
        What::Has(Role::ToMachine),
        "{code} is not allowed with a tool offset",
        "Write {no tool offset} before it, with G90 and a motion to a free Z. Under G91, Z comes down by the offset.",
    ),
];
