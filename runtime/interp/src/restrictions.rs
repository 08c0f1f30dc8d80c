//! What may not stand where another code is in force (D23, D26; manual, restrictions of G41 and G74). The checker asks
//! with what the text shows, the interpreter with what is in force.

use tandem_model::Axis;
use tandem_model::flow::Distance;
use tandem_syntax::Address;
use tandem_syntax::DiagnosticEntry;
use tandem_syntax::diagnostics::{ARC_SHAPE, COMPENSATION_RULE, FIXED_CYCLE_RULE, TOOL_OFFSET_RULE};

use crate::block_words::{BlockWords, Reading};
use crate::codes::g00_rapid::G00;
use crate::codes::g01_linear::G01;
use crate::codes::{ModalGroup, Refusal};
use crate::modal::Modal;

const COMPENSATING: &[&str] = &["G41", "G42"];
const OFFSETTING: &[&str] = &["G43", "G44"];
const CYCLES: &[&str] = &["G74", "G84"];

/// What is wrong with a block that is read so: what is in force before it, and where it begins.
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
    let modal = with.modal;
    in_fixed_cycle(words, modal)
        .or_else(|| with_compensation(words, modal))
        .or_else(|| to_machine_position(words, modal))
        .or_else(|| arc(words, with))
}

/// True for a block of words of G00 or G01 only, where nothing restricts it: most blocks of a program.
#[inline]
fn is_plain(words: &BlockWords, modal: &Modal) -> bool {
    words.g_codes().is_empty()
        && words.m_code().is_none()
        && !modal.lead_pending
        && words.taker().is_some_and(|taker| taker == &G00 || taker == &G01)
        && modal.is(ModalGroup::ToolRadius, &["G40"])
}

/// Follows which motion leads compensation in and out, when the block has been found right.
#[inline]
pub(crate) fn follow(words: &BlockWords, modal: &mut Modal) {
    if has(words, &["G40", "G41", "G42"]) && modal.is(ModalGroup::ToolRadius, &["G40", "G41", "G42"]) {
        let before = modal.is(ModalGroup::ToolRadius, COMPENSATING);
        if before != has(words, COMPENSATING) {
            // what has not led in needs no way out
            modal.lead_pending = !modal.lead_pending;
        }
    }
    if modal.lead_pending && moves_in_plane(words, modal) {
        modal.lead_pending = false;
    }
}

/// True when the motion in force takes a word that may move in the plane of the compensation.
fn moves_in_plane(words: &BlockWords, modal: &Modal) -> bool {
    let outside = match modal.code(ModalGroup::Plane).map(|code| code.code) {
        Some("G17") => Address::Z,
        Some("G18") => Address::Y,
        Some("G19") => Address::X,
        _ => return moves(words),
    };
    words
        .taken()
        .iter()
        .any(|address| address != outside && !matches!(address, Address::A | Address::B | Address::C))
}

fn has(words: &BlockWords, codes: &[&str]) -> bool {
    words.g_codes().iter().any(|(code, _)| codes.contains(&code.code))
}

/// The code of a group that holds in a block: its own one, or the one in force before it.
fn code_of(words: &BlockWords, modal: &Modal, group: ModalGroup) -> Option<&'static str> {
    let own = words.g_codes().iter().map(|(code, _)| *code);
    let own = own.into_iter().find(|code| code.group == group);
    own.or(modal.code(group)).map(|code| code.code)
}

/// True when the motion or cycle in force takes a word of the block.
fn moves(words: &BlockWords) -> bool {
    !words.taken().is_empty()
}

fn moves_by(words: &BlockWords, codes: &[&str]) -> bool {
    moves(words) && words.taker().is_some_and(|code| codes.contains(&code.code))
}

fn refusal(entry: &'static DiagnosticEntry, address: Address, message: String, help: &str) -> Refusal {
    Refusal {
        entry,
        address,
        message,
        help: help.to_owned(),
    }
}

fn in_fixed_cycle(words: &BlockWords, modal: &Modal) -> Option<Refusal> {
    let starts = has(words, CYCLES);
    if starts && modal.is(ModalGroup::FixedCycle, &["G80"]) {
        let missing = [Address::Z, Address::R]
            .into_iter()
            .find(|address| !words.present().contains(*address))?;
        let text = format!("the first block of a fixed cycle has no {}", missing.text());
        return Some(refusal(
            &FIXED_CYCLE_RULE,
            Address::G,
            text,
            "Write Z and R in it.",
        ));
    }
    let ends = has(words, &["G80", "G00", "G01", "G02", "G03"]);
    if !modal.is(ModalGroup::FixedCycle, CYCLES) || ends {
        return None;
    }
    let foreign = words
        .g_codes()
        .iter()
        .map(|(code, _)| code.code)
        .find(|code| !["G74", "G84", "G98", "G99"].contains(code));
    let (what, address) = match (foreign, words.m_code()) {
        (Some(code), _) => (code.to_owned(), Address::G),
        (None, Some(_)) => (format!("M{:02}", words.m_number()), Address::M),
        (None, None) => return None,
    };
    Some(refusal(
        &FIXED_CYCLE_RULE,
        address,
        format!("{what} stands in a fixed cycle"),
        "Write G80 before it.",
    ))
}

fn with_compensation(words: &BlockWords, modal: &Modal) -> Option<Refusal> {
    let ends = has(words, &["G40"]);
    let before = modal.is(ModalGroup::ToolRadius, COMPENSATING);
    let after = (before && !ends) || has(words, COMPENSATING);
    let rule = |address, message: &str, help: &str| {
        Some(refusal(&COMPENSATION_RULE, address, message.to_owned(), help))
    };
    let leads = if after == before {
        modal.lead_pending
    } else {
        !modal.lead_pending
    };
    if leads && moves_by(words, &["G02", "G03"]) {
        return rule(
            Address::G,
            "an arc leads cutter compensation in or out",
            "Lead in and out with G01.",
        );
    }
    // G40 ends it with the motion that leads out: where the tool is before depends on that motion.
    let still_on = leads && !after;
    if !after && !still_on {
        return None;
    }
    if before && has(words, COMPENSATING) {
        let same = modal
            .code(ModalGroup::ToolRadius)
            .is_some_and(|code| has(words, &[code.code]));
        if !same {
            return rule(
                Address::G,
                "the side of the compensation changes",
                "Write G40 and a lead-out first.",
            );
        }
    }
    let plane = modal.code(ModalGroup::Plane);
    let other_plane = words
        .g_codes()
        .iter()
        .any(|(code, _)| code.group == ModalGroup::Plane && plane.is_some_and(|plane| plane != *code));
    if (before || still_on) && other_plane {
        return rule(
            Address::G,
            "the plane changes during cutter compensation",
            "Write G40 and a lead-out first.",
        );
    }
    let rapid = after && moves_by(words, &["G00"]);
    if rapid || moves_by(words, &["G74", "G84"]) || has(words, &["G31"]) {
        return rule(
            Address::G,
            "only G01, G02 and G03 move during cutter compensation",
            "Write G40 and a lead-out first.",
        );
    }
    let leads_out_here = still_on && moves_in_plane(words, modal);
    if leads_out_here { None } else { waits(words) }
}

/// What may not stand where the next motion decides where the tool is.
fn waits(words: &BlockWords) -> Option<Refusal> {
    let code = words.m_code()?.code;
    let (message, help) = match code {
        "M02" | "M30" => (
            "the program ends during cutter compensation",
            "Write G40 and a lead-out before it.",
        ),
        _ if matches!(code, "M00" | "M01") || words.has_parameters() => (
            "the program waits during cutter compensation",
            "Write it before G41 or G42, or behind the lead-out.",
        ),
        _ => return None,
    };
    Some(refusal(&COMPENSATION_RULE, Address::M, message.to_owned(), help))
}

fn to_machine_position(words: &BlockWords, modal: &Modal) -> Option<Refusal> {
    let (code, _) = words
        .g_codes()
        .iter()
        .find(|(code, _)| matches!(code.code, "G28" | "G30" | "G53"))?;
    let led_out = modal.is(ModalGroup::ToolRadius, &["G40"]) && !modal.lead_pending;
    let unknown = modal.code(ModalGroup::ToolRadius).is_none();
    if !(led_out || unknown) || has(words, COMPENSATING) {
        let text = format!("{} stands during cutter compensation", code.code);
        return Some(refusal(
            &COMPENSATION_RULE,
            Address::G,
            text,
            "Write G40 and a lead-out before it.",
        ));
    }
    if modal.is(ModalGroup::ToolLength, OFFSETTING) || has(words, OFFSETTING) {
        let text = format!("{} stands with a tool offset", code.code);
        return Some(refusal(
            &TOOL_OFFSET_RULE,
            Address::G,
            text,
            "Write G49 before it.",
        ));
    }
    None
}

fn arc(words: &BlockWords, with: &Reading<'_>) -> Option<Refusal> {
    let (modal, position) = (with.modal, with.position);
    if !moves_by(words, &["G02", "G03"]) {
        return None;
    }
    let address = words.taken().iter().next()?;
    let (axes, centres) = match code_of(words, modal, ModalGroup::Plane) {
        Some("G18") => ([Axis::Z, Axis::X], [Address::K, Address::I]),
        Some("G19") => ([Axis::Y, Axis::Z], [Address::J, Address::K]),
        Some(_) => ([Axis::X, Axis::Y], [Address::I, Address::J]),
        None => return None,
    };
    let Some(radius) = words.get(Address::R) else {
        let centred = centres.iter().any(|centre| words.present().contains(*centre));
        let text = "the arc has neither a centre in its plane nor a radius".to_owned();
        let help = format!("Write {} and {}, or R.", centres[0].text(), centres[1].text());
        return (!centred).then(|| refusal(&ARC_SHAPE, address, text, &help));
    };
    if radius.abs() <= 0.0 {
        return None;
    }
    let distance = match code_of(words, modal, ModalGroup::Distance) {
        Some("G91") => Some(Distance::Incremental),
        Some(_) => Some(Distance::Absolute),
        None => None,
    };
    let [first, second] = axes.map(|axis| position.way(words, distance, axis));
    // not a number, and so no reason to refuse, where the text does not show the way
    let chord = first.hypot(second);
    // a difference in the unit in force: an inch is more than a millimetre, so this never refuses too much; what
    // scaling leaves of it the path stage knows
    let unscaled = code_of(words, modal, ModalGroup::Scaling) == Some("G50");
    let short = unscaled && radius.abs() < chord / 2.0 - with.arc_radius_tolerance_mm;
    (short || chord <= 0.0).then(|| {
        let text = format!("no arc of radius {} reaches over {chord}", radius.abs());
        refusal(
            &ARC_SHAPE,
            Address::R,
            text,
            "Write a radius of half the way or more; a full circle needs a centre.",
        )
    })
}
