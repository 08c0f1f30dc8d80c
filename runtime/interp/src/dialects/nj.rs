//! Dialect nj, as defined by the manual O031 of the NJ/NY series.

use tandem_model::settings::PathRules;
use tandem_syntax::Grammar;

use crate::codes::feed_words::FEED_WORDS;
use crate::codes::g00_rapid::G00;
use crate::codes::g01_linear::G01;
use crate::codes::g02_g03_arc::{G02, G03};
use crate::codes::g04_dwell::G04;
use crate::codes::g09_exact_stop::G09;
use crate::codes::g17_g18_g19_plane::{G17, G18, G19};
use crate::codes::g20_g21_unit::{G20, G21};
use crate::codes::g28_g30_reference::{G28, G30};
use crate::codes::g31_skip::G31;
use crate::codes::g40_g41_g42_cutter_compensation::{G40, G41, G42};
use crate::codes::g43_g44_g49_tool_offset::{G43, G44, G49};
use crate::codes::g50_1_g51_1_mirroring::{G50_1, G51_1};
use crate::codes::g50_g51_scaling::{G50, G51};
use crate::codes::g52_local::G52;
use crate::codes::g53_machine::G53;
use crate::codes::g61_g64_path_control::{G61, G64};
use crate::codes::g68_g69_rotation::{G68, G69};
use crate::codes::g74_g84_tapping::{G74, G80, G84};
use crate::codes::g90_g91_distance::{G90, G91};
use crate::codes::g98_g99_return_level::{G98, G99};
use crate::codes::g500_g501_multi_block::{G500, G501};
use crate::codes::m_auxiliary::AUXILIARY;
use crate::codes::m00_m01_stop::{M00, M01};
use crate::codes::m02_m30_end::{M02, M30};
use crate::codes::m98_call::M98;
use crate::codes::m99_return::M99;
use crate::codes::work_offset::{G54, G55, G56, G57, G58, G59};
use crate::codes::{AXIS_WORDS, CodeTable};
use crate::dialect::{Dialect, ModalWords, Policy};
use crate::restrictions;

/// Name of the dialect.
pub(super) const NAME: &str = "nj";

/// Returns the dialect of the NJ/NY-series controllers.
pub fn nj() -> &'static Dialect {
    &NJ
}

pub(super) static NJ: Dialect = Dialect {
    name: NAME,
    grammar: Grammar::nj,
    g_codes: CodeTable::new(&[
        &G00, &G01, &G02, &G03, &G04, &G09, &G17, &G18, &G19, &G20, &G21, &G28, &G30, &G31, &G40, &G41, &G42,
        &G43, &G44, &G49, &G50, &G50_1, &G51, &G51_1, &G52, &G53, &G54, &G55, &G56, &G57, &G58, &G59, &G61,
        &G64, &G68, &G69, &G74, &G80, &G84, &G90, &G91, &G98, &G99, &G500, &G501,
    ])
    .shown_by(super::examples::NJ),
    m_codes: CodeTable::new(&[&M00, &M01, &M02, &M30, &M98, &M99]),
    auxiliary: &AUXILIARY,
    modal_words: ModalWords::new(&AXIS_WORDS, &FEED_WORDS),
    start_up: &[
        &G01, &G17, &G90, &G21, &G40, &G49, &G80, &G98, &G50, &G64, &G69, &G50_1, &G501,
    ],
    cycle_cancel: Some(&G80),
    home: "G91 G28",
    block_end: "M999.002",
    policy: Policy::NJ,
    path: PathRules::NJ,
    restrictions: &restrictions::USUAL,
    texts: &super::texts::NO_TEXTS,
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codes::ModalGroup;
    use crate::codes::tenths;

    /// The manual's table of G codes.
    const MANUAL: &[&str] = &[
        "G00", "G01", "G02", "G03", "G04", "G09", "G17", "G18", "G19", "G20", "G21", "G28", "G30", "G31",
        "G40", "G41", "G42", "G43", "G44", "G49", "G50", "G50.1", "G51", "G51.1", "G52", "G53", "G54", "G55",
        "G56", "G57", "G58", "G59", "G61", "G64", "G68", "G69", "G74", "G80", "G84", "G90", "G91", "G98",
        "G99", "G500", "G501",
    ];

    #[test]
    fn the_tables_hold_each_g_code_of_the_manual_once() {
        let mut named: Vec<&str> = NJ.g_codes.codes.iter().map(|code| code.code).collect();
        named.sort_unstable();
        let mut manual = MANUAL.to_vec();
        manual.sort_unstable();
        assert_eq!(named, manual);
    }

    #[test]
    fn names_and_numbers_of_codes_agree() {
        let codes = NJ.g_codes.codes.iter().chain(NJ.m_codes.codes);
        let numbers = codes.map(|code| (code.code, code.tenths()));
        for (code, number) in numbers {
            assert_eq!(tenths(code[1..].parse().unwrap()), Some(number), "{code}");
        }
    }

    #[test]
    fn each_modal_group_but_14_has_one_code_in_force_at_start_up() {
        for group in ModalGroup::ALL {
            let expected = usize::from(!matches!(
                group,
                ModalGroup::NonModal | ModalGroup::WorkCoordinates
            ));
            let found = NJ.start_up.iter().filter(|code| code.group == *group).count();
            assert_eq!(found, expected, "group {}", group.number());
        }
    }
}
