//! Texts of the restrictions that concern a code.

use crate::codes::{Code, ModalGroup};
use crate::dialect::Dialect;
use crate::meaning::{LengthOffset, ModalValue, Role, Side};
use crate::restrictions::{ForbiddenElement, RestrictionScope, written};

/// Returns the texts of the restrictions of a code, each with its correction, from the dialect's table.
pub fn restrictions_of(code: &Code, dialect: &Dialect) -> Vec<String> {
    let rows = dialect.restrictions.iter();
    // a text with the mark `{code}` needs the element found in a block, which does not exist here
    let is_whole = |text: &str| !text.contains("{code}");
    let rows = rows.filter(|row| {
        concerns_code(row.what, code)
            || (holds_in(row.during, code) && is_whole(row.message) && is_whole(row.help))
    });
    let mut texts = Vec::new();
    for row in rows {
        let needed = match code.sets {
            Some(ModalValue::Cycle(Some(cycle))) => cycle.needed,
            _ => &[],
        };
        let text = |text| written(text, needed, dialect, code.code);
        let row = format!("{}. {}", text(row.message), text(row.help));
        if !texts.contains(&row) {
            texts.push(row);
        }
    }
    texts
}

/// Returns true if the forbidden element is this code, or a consequence of this code.
fn concerns_code(what: ForbiddenElement, code: &Code) -> bool {
    let is_cycle = matches!(code.sets, Some(ModalValue::Cycle(Some(_))));
    match what {
        ForbiddenElement::MovesBy(kind) => code.role == Role::Motion(kind),
        ForbiddenElement::MissingOfCycle
        | ForbiddenElement::MovesByCycle
        | ForbiddenElement::SpindleAtRest => is_cycle,
        ForbiddenElement::Has(role) | ForbiddenElement::Accompanied(role) => code.role == role,
        ForbiddenElement::OtherSide => compensates(code),
        ForbiddenElement::OtherPlane => matches!(code.sets, Some(ModalValue::Plane(_))),
        ForbiddenElement::CycleCode => code.group == ModalGroup::FixedCycle,
        ForbiddenElement::OtherUnit => matches!(code.sets, Some(ModalValue::Unit(_))),
        ForbiddenElement::Parameters => code.role == Role::Auxiliary,
        ForbiddenElement::ForeignToCycles
        | ForbiddenElement::NotXy
        | ForbiddenElement::ArcInForce
        | ForbiddenElement::OffsetNumber => false,
    }
}

/// Returns true if the code creates the condition under which a restriction applies.
fn holds_in(during: RestrictionScope, code: &Code) -> bool {
    match during {
        RestrictionScope::CycleBegin | RestrictionScope::Cycle | RestrictionScope::Drilling => {
            matches!(code.sets, Some(ModalValue::Cycle(Some(_))))
        }
        RestrictionScope::SideSwitch
        | RestrictionScope::Lead
        | RestrictionScope::Compensation
        | RestrictionScope::CompensatedBlock
        | RestrictionScope::CompensationOrWayOut
        | RestrictionScope::CompensatedEnd
        | RestrictionScope::AnyCompensation => compensates(code),
        RestrictionScope::ToolOffset => {
            let offset = [LengthOffset::Added, LengthOffset::Subtracted];
            matches!(code.sets, Some(ModalValue::Length(length)) if offset.contains(&length))
        }
        RestrictionScope::Always
        | RestrictionScope::Incremental
        | RestrictionScope::UnitSettled
        | RestrictionScope::NoCompensation => false,
    }
}

fn compensates(code: &Code) -> bool {
    matches!(code.sets, Some(ModalValue::Side(Side::Left | Side::Right)))
}
