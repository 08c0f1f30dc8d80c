//! Combinations of codes and words that are not allowed (D23, D26; manual, restrictions of G41 and G74): a
//! table of the dialect. The checker applies the table to the state that the text shows, the interpreter to
//! the actual modal state.

mod arc_shape;
mod usual;

use tandem_model::Axis;
use tandem_model::flow::Distance;
use tandem_model::plane::Plane;
use tandem_syntax::{Address, DiagnosticEntry};

use crate::block_words::{BlockWords, Reading};
use crate::codes::{AXIS_ADDRESSES, Code, ModalGroup, Refusal};
use crate::dialect::{Dialect, list};
use crate::meaning::{LengthOffset, ModalValue, MotionKind, Role, Side};
use crate::modal::Modal;

pub use usual::USUAL;

/// A combination that is not allowed in a block.
#[derive(Debug)]
pub struct Restriction {
    /// Condition under which the restriction applies.
    pub during: RestrictionScope,
    /// The forbidden element of a block.
    pub what: ForbiddenElement,
    /// The diagnostic that reports a violation.
    pub entry: &'static DiagnosticEntry,
    /// Error text. `{code}` is replaced by the element found, `{needed}` by the words that the cycle of the
    /// block needs in its first block. The other marks are replaced by codes of the dialect: `{linear}`,
    /// `{cutting}`, `{compensation}`, `{no compensation}`, `{no cycle}`, `{no tool offset}`.
    pub message: &'static str,
    /// Text on how to correct the block, with the same marks.
    pub help: &'static str,
}

impl Restriction {
    /// Creates a restriction from its fields.
    pub(crate) const fn new(
        entry: &'static DiagnosticEntry,
        during: RestrictionScope,
        what: ForbiddenElement,
        message: &'static str,
        help: &'static str,
    ) -> Self {
        Self {
            during,
            what,
            entry,
            message,
            help,
        }
    }
}

/// Condition under which a restriction applies.
///
/// The lead-out of cutter compensation is pending from the block that switches compensation off to the motion
/// that leads out, both included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RestrictionScope {
    /// The restriction always applies.
    Always,
    /// Axis words of the block are distances.
    Incremental,
    /// An earlier block has a coordinate, a unit code or a work coordinate system, so that the unit must not
    /// change.
    UnitSettled,
    /// A fixed cycle takes words of the block, or the block begins a fixed cycle.
    Drilling,
    /// The block switches cutter compensation on or off.
    SideSwitch,
    /// Cutter compensation is off before the block.
    NoCompensation,
    /// The block begins a fixed cycle.
    CycleBegin,
    /// A fixed cycle is active, and the block does not end it.
    Cycle,
    /// The next motion in the plane, which may be in this block, leads cutter compensation in or out.
    Lead,
    /// Cutter compensation is on before and after the block, or its lead-out is pending.
    Compensation,
    /// Cutter compensation is on after the block.
    CompensatedBlock,
    /// Cutter compensation is on after the block, or its lead-out is pending.
    CompensationOrWayOut,
    /// After the block, cutter compensation is on, or its lead-out is still pending because no word of the
    /// block moves in the plane.
    CompensatedEnd,
    /// Cutter compensation is on before or after the block, or a lead-in or lead-out is pending.
    AnyCompensation,
    /// A tool offset is in force before the block, or the block switches a tool offset on.
    ToolOffset,
}

/// Elements that a restriction can forbid in a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ForbiddenElement {
    /// A missing word that the fixed cycle of the block needs in its first block.
    MissingOfCycle,
    /// A code that sets neither a fixed cycle nor the return level of fixed cycles.
    ForeignToCycles,
    /// Words that a motion of this kind takes.
    MovesBy(MotionKind),
    /// Words that a fixed cycle takes.
    MovesByCycle,
    /// A code with this role.
    Has(Role),
    /// A change to the other side of cutter compensation.
    OtherSide,
    /// A plane other than the current plane.
    OtherPlane,
    /// An output with parameters; the program always waits for the reset of such an output.
    Parameters,
    /// An M code with this role that is not alone in its block.
    Accompanied(Role),
    /// A current plane other than XY.
    NotXy,
    /// An arc as the current motion.
    ArcInForce,
    /// An offset number (D) other than the current number.
    OffsetNumber,
    /// A code that begins or ends a fixed cycle.
    CycleCode,
    /// A spindle that does not turn.
    SpindleAtRest,
    /// A unit of lengths other than the current unit.
    OtherUnit,
}

/// Returns the first restriction that a block violates. `with` contains the modal state and the position
/// before the block.
#[inline]
pub(crate) fn find(words: &BlockWords, with: &Reading<'_>) -> Option<Refusal> {
    if is_plain(words, with.modal) {
        None
    } else {
        first(words, with)
    }
}

#[inline(never)]
fn first(words: &BlockWords, with: &Reading<'_>) -> Option<Refusal> {
    let holds = state(words, with.modal);
    let rows = with.dialect.restrictions.iter();
    let mut broken = rows.filter(|row| holds(row.during)).filter_map(|row| {
        let (address, code) = found(row.what, words, with.modal)?;
        Some(Refusal {
            entry: row.entry,
            address,
            message: written(row.message, needed(words), with.dialect, &code),
            help: written(row.help, needed(words), with.dialect, &code),
        })
    });
    broken.next().or_else(|| arc_shape::find(words, with))
}

/// Returns true for a block of a straight motion with its words only, to which no restriction applies. Most
/// blocks of a program are of this kind.
#[inline]
fn is_plain(words: &BlockWords, modal: &Modal) -> bool {
    let straight = |code: &Code| matches!(code.role, Role::Motion(MotionKind::Rapid | MotionKind::Linear));
    words.codes().all(straight)
        && words.m_code().is_none()
        && !modal.lead_pending
        && words.taker.is_some_and(straight)
        && modal.in_force.side == Some(Side::Off)
}

/// Records after a block whether a lead-in or lead-out is pending, and other modal values of the block. The
/// block must be free of errors.
#[inline]
pub(crate) fn follow(words: &BlockWords, modal: &mut Modal) {
    if words.has_codes() || modal.lead_pending || !modal.unit_settled {
        follow_closely(words, modal);
    }
}

#[inline(never)]
fn follow_closely(words: &BlockWords, modal: &mut Modal) {
    if let (Some(side), Some(before)) = (own_side(words), modal.in_force.side)
        && (before == Side::Off) != (side == Side::Off)
    {
        // if compensation has not been led in yet, switching it off needs no lead-out
        modal.lead_pending = !modal.lead_pending;
    }
    if modal.lead_pending && moves_in_plane(words, modal) {
        modal.lead_pending = false;
    }
    if words.has_codes() {
        follow_codes(words, modal);
    }
    if !modal.unit_settled {
        let selects_coordinates = |code: &Code| code.group == ModalGroup::WorkCoordinates;
        modal.unit_settled = !words.present.intersection(AXIS_ADDRESSES).is_empty()
            || g_code(words, |code| sets_unit(code) || selects_coordinates(code)).is_some();
    }
}

/// Updates the offset numbers (D and H), and the value that the M code sets.
#[inline(never)]
fn follow_codes(words: &BlockWords, modal: &mut Modal) {
    if words.present.contains(Address::D) && own_side(words).is_some() {
        modal.in_force.offset_number = words.get(Address::D);
    }
    if g_code(words, |code| matches!(code.sets, Some(ModalValue::Length(_)))).is_some() {
        modal.in_force.length_number = words.get(Address::H);
    }
    if let Some(value) = words.m_code().and_then(|code| code.sets) {
        modal.in_force.set(value);
    }
}

/// Returns true if the current motion takes a word that may move an axis in the plane of the compensation.
pub(crate) fn moves_in_plane(words: &BlockWords, modal: &Modal) -> bool {
    let outside = match modal.in_force.plane {
        Some(Plane::Xy) => Address::Z,
        Some(Plane::Zx) => Address::Y,
        Some(Plane::Yz) => Address::X,
        None => return moves(words),
    };
    words
        .taken
        .iter()
        .any(|address| address != outside && !matches!(address, Address::A | Address::B | Address::C))
}

/// Returns the side of cutter compensation that a code of the block sets.
fn own_side(words: &BlockWords) -> Option<Side> {
    let mut values = words.codes().filter_map(|code| code.sets);
    values.find_map(|value| match value {
        ModalValue::Side(side) => Some(side),
        _ => None,
    })
}

fn sets_unit(code: &Code) -> bool {
    matches!(code.sets, Some(ModalValue::Unit(_)))
}

/// Returns the first G code of the block for which `is_so` returns true.
fn g_code(words: &BlockWords, is_so: impl Fn(&Code) -> bool) -> Option<&'static Code> {
    words.codes().find(|code| is_so(code))
}

/// Returns true if the current motion or cycle takes a word of the block.
fn moves(words: &BlockWords) -> bool {
    !words.taken.is_empty()
}

fn moves_by(words: &BlockWords, kind: MotionKind) -> bool {
    moves(words) && words.taker.is_some_and(|code| code.role == Role::Motion(kind))
}

/// Returns the address of the arc centre (I, J or K) along an axis.
pub(crate) fn centre(axis: Axis) -> Address {
    match axis {
        Axis::X => Address::I,
        Axis::Y => Address::J,
        _ => Address::K,
    }
}

/// Returns a function that decides whether a scope applies to a block, from the modal state before it and its
/// own codes.
fn state(words: &BlockWords, modal: &Modal) -> impl Fn(RestrictionScope) -> bool {
    let (in_force, own) = (modal.in_force, words.sets());
    let moves_anew = g_code(words, |code| matches!(code.role, Role::Motion(_))).is_some();
    let in_cycle = modal.fixed_cycle().is_some() && own.cycle != Some(None) && !moves_anew;
    let before = in_force.compensates();
    let switches_on = own.compensates();
    let after = (before && own.side != Some(Side::Off)) || switches_on;
    let leads = modal.lead_pending != (after != before);
    // while the lead-out is pending, the position of the tool depends on the motion that leads out
    let way_out = leads && !after;
    let leads_out_here = way_out && moves_in_plane(words, modal);
    let pending = in_force.side.is_some() && modal.lead_pending;
    let takes_cycle = words
        .taker
        .is_some_and(|code| code.group == ModalGroup::FixedCycle);
    let drills = takes_cycle && (moves(words) || own.cycle.flatten().is_some());
    let incremental = own.distance.or(in_force.distance) == Some(Distance::Incremental);
    let settled = modal.unit_settled;
    let is_offset = |length, number| {
        matches!(length, Some(LengthOffset::Added | LengthOffset::Subtracted)) && number != Some(0.0)
    };
    let tool_offset =
        is_offset(in_force.length, in_force.length_number) || is_offset(own.length, words.get(Address::H));
    move |during| match during {
        RestrictionScope::Always => true,
        RestrictionScope::Incremental => incremental,
        RestrictionScope::UnitSettled => settled,
        RestrictionScope::Drilling => drills,
        RestrictionScope::SideSwitch => after != before,
        RestrictionScope::NoCompensation => in_force.side == Some(Side::Off),
        RestrictionScope::CycleBegin => matches!(own.cycle, Some(Some(_))) && in_force.cycle == Some(None),
        RestrictionScope::Cycle => in_cycle,
        RestrictionScope::Lead => leads,
        RestrictionScope::Compensation => (before && after) || way_out,
        RestrictionScope::CompensatedBlock => after,
        RestrictionScope::CompensationOrWayOut => after || way_out,
        RestrictionScope::CompensatedEnd => (after || way_out) && !leads_out_here,
        RestrictionScope::AnyCompensation => before || pending || switches_on,
        RestrictionScope::ToolOffset => tool_offset,
    }
}

/// Returns the address at which a finding is shown, and the forbidden element; `None` if the block has no
/// such element.
fn found(what: ForbiddenElement, words: &BlockWords, modal: &Modal) -> Option<(Address, String)> {
    let in_force = &modal.in_force;
    let shown = |code: &Code| (Address::G, code.code.to_owned());
    let motion = |is_so: bool| (is_so && moves(words)).then(|| words.taker.map(shown)).flatten();
    let m_code = || (Address::M, format!("M{:02}", words.m_number()));
    match what {
        ForbiddenElement::MissingOfCycle => {
            let needed = words.sets().cycle??.needed;
            let missing = needed.iter().find(|word| !words.present.contains(**word))?;
            Some((Address::G, missing.text().to_owned()))
        }
        ForbiddenElement::ForeignToCycles => {
            let belongs =
                |code: &Code| matches!(code.sets, Some(ModalValue::Cycle(_) | ModalValue::ReturnLevel(_)));
            let foreign = g_code(words, |code| !belongs(code)).map(shown);
            foreign.or_else(|| words.m_code().map(|_| m_code()))
        }
        ForbiddenElement::MovesBy(kind) => motion(moves_by(words, kind)),
        ForbiddenElement::MovesByCycle => motion(
            words
                .taker
                .is_some_and(|code| matches!(code.sets, Some(ModalValue::Cycle(Some(_))))),
        ),
        ForbiddenElement::Has(role) => {
            let g_code = g_code(words, |code| code.role == role).map(shown);
            let is_m_code = || words.m_code().is_some_and(|code| code.role == role);
            g_code.or_else(|| is_m_code().then(m_code))
        }
        ForbiddenElement::OtherSide => {
            let on = |side: &Side| *side != Side::Off;
            let (own, before) = (own_side(words).filter(on)?, in_force.side.filter(on)?);
            (own != before).then(|| (Address::G, String::new()))
        }
        ForbiddenElement::OtherPlane => {
            let plane = in_force.plane?;
            let is_other = |code: &Code| matches!(code.sets, Some(ModalValue::Plane(own)) if own != plane);
            g_code(words, is_other).map(shown)
        }
        ForbiddenElement::Accompanied(role) => {
            let alone = words.present.is_empty() && words.g_codes().is_empty();
            (words.m_code()?.role == role && !alone).then(m_code)
        }
        ForbiddenElement::NotXy => {
            let plane = words.sets().plane.or(in_force.plane)?;
            (plane != Plane::Xy).then(|| (Address::G, String::new()))
        }
        ForbiddenElement::ArcInForce => {
            let own = g_code(words, |code| matches!(code.role, Role::Motion(_)));
            let code = own.or_else(|| modal.code(ModalGroup::Motion))?;
            (code.role == Role::Motion(MotionKind::Arc)).then(|| shown(code))
        }
        ForbiddenElement::OffsetNumber => {
            let (own, before) = (words.get(Address::D)?, in_force.offset_number?);
            (own.to_bits() != before.to_bits()).then(|| (Address::D, String::new()))
        }
        ForbiddenElement::CycleCode => g_code(words, |code| code.group == ModalGroup::FixedCycle).map(shown),
        ForbiddenElement::SpindleAtRest => {
            let turns = words.sets().spindle.or(in_force.spindle)?;
            words.taker.filter(|_| !turns).map(shown)
        }
        ForbiddenElement::OtherUnit => {
            let (own, before) = (words.sets().unit?, in_force.unit?);
            g_code(words, sets_unit).filter(|_| own != before).map(shown)
        }
        ForbiddenElement::Parameters => (words.m_code().is_some() && words.has_parameters()).then(m_code),
    }
}

/// Returns the words that a fixed cycle needs in its first block; none if the block begins no cycle.
fn needed(words: &BlockWords) -> &'static [Address] {
    words.sets().cycle.flatten().map_or(&[][..], |cycle| cycle.needed)
}

/// Returns a text with its marks (`{...}`) replaced.
#[cold]
pub(crate) fn written(text: &str, needed: &[Address], dialect: &Dialect, found: &str) -> String {
    let names = |last, is_meant: fn(&Code) -> bool| dialect.names(last, is_meant);
    let mut parts = text.split(['{', '}']);
    let mut written = parts.next().unwrap_or_default().to_owned();
    while let (Some(mark), Some(rest)) = (parts.next(), parts.next()) {
        written += &match mark {
            "linear" => names("or", |code| code.role == Role::Motion(MotionKind::Linear)),
            "cutting" => names("and", |code| {
                matches!(code.role, Role::Motion(MotionKind::Linear | MotionKind::Arc))
            }),
            "compensation" => names("or", |code| {
                matches!(code.sets, Some(ModalValue::Side(Side::Left | Side::Right)))
            }),
            "no compensation" => names("or", |code| code.sets == Some(ModalValue::Side(Side::Off))),
            "no cycle" => names("or", |code| code.sets == Some(ModalValue::Cycle(None))),
            "no tool offset" => names("or", |code| {
                code.sets == Some(ModalValue::Length(LengthOffset::Off))
            }),
            "needed" => {
                let needed: Vec<_> = needed.iter().map(|word| word.text()).collect();
                list(&needed, "and")
            }
            _ => found.to_owned(),
        };
        written += rest;
    }
    written
}
