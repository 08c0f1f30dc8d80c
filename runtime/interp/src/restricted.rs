//! The restrictions that concern a code, in words.

use crate::codes::{Code, ModalGroup};
use crate::dialect::Dialect;
use crate::meaning::{LengthOffset, ModalValue, Role, Side};
use crate::restrictions::{During, What, written};

/// Returns the restrictions of a code with the correction, from the dialect's table.
pub fn restrictions_of(code: &Code, dialect: &Dialect) -> Vec<String> {
    let rows = dialect.restrictions.iter();
    // a row that names the element found is useless without it
    let is_whole = |text: &str| !text.contains("{code}");
    let rows = rows.filter(|row| {
        is_of(row.what, code) || (holds_in(row.during, code) && is_whole(row.message) && is_whole(row.help))
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

/// Returns true if the forbidden element is this code or its effect.
fn is_of(what: What, code: &Code) -> bool {
    let is_cycle = matches!(code.sets, Some(ModalValue::Cycle(Some(_))));
    match what {
        What::MovesBy(kind) => code.role == Role::Motion(kind),
        What::MissingOfCycle | What::MovesByCycle | What::SpindleAtRest => is_cycle,
        What::Has(role) | What::Accompanied(role) => code.role == role,
        What::OtherSide => compensates(code),
        What::OtherPlane => matches!(code.sets, Some(ModalValue::Plane(_))),
        What::CycleCode => code.group == ModalGroup::FixedCycle,
        What::OtherUnit => matches!(code.sets, Some(ModalValue::Unit(_))),
        What::Parameters => code.role == Role::Auxiliary,
        What::ForeignToCycles | What::NotXy | What::ArcInForce | What::OffsetNumber => false,
    }
}

/// Returns true if a restriction applies because of this code.
fn holds_in(during: During, code: &Code) -> bool {
    match during {
        During::CycleBegin | During::Cycle | During::Drilling => {
            matches!(code.sets, Some(ModalValue::Cycle(Some(_))))
        }
        During::SideSwitch
        | During::Lead
        | During::Compensation
        | During::CompensatedBlock
        | During::CompensationOrWayOut
        | During::CompensatedEnd
        | During::AnyCompensation => compensates(code),
        During::ToolOffset => {
            let offset = [LengthOffset::Added, LengthOffset::Subtracted];
            matches!(code.sets, Some(ModalValue::Length(length)) if offset.contains(&length))
        }
        During::Always | During::Incremental | During::UnitSettled | During::NoCompensation => false,
    }
}

fn compensates(code: &Code) -> bool {
    matches!(code.sets, Some(ModalValue::Side(Side::Left | Side::Right)))
}
