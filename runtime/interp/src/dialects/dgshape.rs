//! Dialect dgshape, as defined by the NC code reference manual of DGSHAPE Corporation.
//!
//! The manual leaves some options to the machine; these options are settings ([`NcOptions`]). Where the
//! figures of the manual are lost or the manual is silent, the dialect behaves like most controls:
//!
//! - A program begins with G54, G90, G17, G00, G40, G49, G50, G80 and G98 active; in mm, unless `units` sets another
//!   unit.
//! - A comment ends on its line.
//! - D and H name an entry of the tool table: D its radius, H its length.
//! - Data that G10, G28 and G92 set are valid until the next program begins.
//! - Motion keeps to the path within the limits of the motors, as with G500 of dialect nj and ramp times of 0.
//! - Cutter compensation does not check for overcuts, and does not reject rapids.
//!
//! [`NcOptions`]: tandem_model::settings::NcOptions

mod restrictions;

use tandem_model::flow::MultiBlock;
use tandem_model::settings::{CompensationRules, PathRules, RapidPath, RotaryFeed};
use tandem_syntax::Grammar;

use crate::codes::feed_words::FEED_AND_SPEED;
use crate::codes::g00_rapid::G00;
use crate::codes::g01_linear::G01;
use crate::codes::g02_g03_arc::{G02_ORTHOGONAL, G03_ORTHOGONAL};
use crate::codes::g04_dwell::G04_X_P;
use crate::codes::g10_data::G10;
use crate::codes::g17_g18_g19_plane::{G17, G18, G19};
use crate::codes::g20_g21_unit::{G20, G21};
use crate::codes::g28_g30_reference::G28_REMEMBERED;
use crate::codes::g39_corner::G39;
use crate::codes::g40_g41_g42_cutter_compensation::{G40, G41_D, G42_D};
use crate::codes::g43_g44_g49_tool_offset::{G43_H, G49_H};
use crate::codes::g50_g51_scaling::{G50, G51_P};
use crate::codes::g53_machine::G53_ALONE;
use crate::codes::g74_g84_tapping::G80;
use crate::codes::g81_g89_drilling::{G81, G82, G83, G85, G86, G89};
use crate::codes::g90_g91_distance::{G90, G91};
use crate::codes::g92_coordinates::G92;
use crate::codes::g98_g99_return_level::{G98, G99};
use crate::codes::m_auxiliary::AUXILIARY;
use crate::codes::m00_m01_stop::{M00, M01};
use crate::codes::m02_m30_end::{M02, M30};
use crate::codes::m03_m17_machine::{M03, M05, M06, M12, M13, M14, M15, M16, M17};
use crate::codes::work_offset::{
    G54_SHIFTED, G55_SHIFTED, G56_SHIFTED, G57_SHIFTED, G58_SHIFTED, G59_SHIFTED,
};
use crate::codes::{AXIS_WORDS, CodeTable};
use crate::dialect::{
    Dialect, GroupConflict, MCodeTime, ModalWords, Numbers, OtherMCodes, OutputDefault, Policy, SpindleWord,
    Spiral,
};

/// Returns the dialect of the machines of DGSHAPE.
pub fn dgshape() -> &'static Dialect {
    &DGSHAPE
}

pub(super) static DGSHAPE: Dialect = Dialect {
    name: "dgshape",
    grammar: Grammar::dgshape,
    g_codes: CodeTable::new(&[
        &G00,
        &G01,
        &G02_ORTHOGONAL,
        &G03_ORTHOGONAL,
        &G04_X_P,
        &G10,
        &G17,
        &G18,
        &G19,
        &G20,
        &G21,
        &G28_REMEMBERED,
        &G39,
        &G40,
        &G41_D,
        &G42_D,
        &G43_H,
        &G49_H,
        &G50,
        &G51_P,
        &G53_ALONE,
        &G54_SHIFTED,
        &G55_SHIFTED,
        &G56_SHIFTED,
        &G57_SHIFTED,
        &G58_SHIFTED,
        &G59_SHIFTED,
        &G80,
        &G81,
        &G82,
        &G83,
        &G85,
        &G86,
        &G89,
        &G90,
        &G91,
        &G92,
        &G98,
        &G99,
    ])
    .shown_by(super::examples::DGSHAPE),
    m_codes: CodeTable::new(&[
        &M00, &M01, &M02, &M30, &M03, &M05, &M06, &M12, &M13, &M14, &M15, &M16, &M17,
    ]),
    auxiliary: &AUXILIARY,
    modal_words: ModalWords::new(&AXIS_WORDS, &FEED_AND_SPEED),
    start_up: &[
        &G00,
        &G17,
        &G90,
        &G21,
        &G40,
        &G49_H,
        &G80,
        &G98,
        &G50,
        &G54_SHIFTED,
    ],
    cycle_cancel: Some(&G80),
    home: "G91 G28",
    block_end: "M999.002",
    policy: Policy {
        rivals: GroupConflict::LastHolds,
        m_code: MCodeTime::BeforeMotion,
        numbers: Numbers::Counted,
        spindle_word: SpindleWord::SpeedOrCode,
        other_m_codes: OtherMCodes::Declared,
        output: OutputDefault::WithMotion,
        spiral: Spiral::Doubted,
        has_least_feedrate: true,
    },
    path: PathRules {
        rapid: RapidPath::Straight,
        rotary_feed: RotaryFeed::Surface,
        compensation: CompensationRules::Unchecked,
        multi_block: MultiBlock::On,
    },
    restrictions: &restrictions::RESTRICTIONS,
    texts: &super::texts::DGSHAPE,
};
