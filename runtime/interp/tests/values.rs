//! Values that the manual of dialect dgshape allows, and those that it does not.

#![allow(clippy::panic, reason = "tests")]

use tandem_interp::dialects::{dgshape, nj};
use tandem_interp::{CheckContext, Dialect, check_source};
use tandem_model::settings::NcOptions;

fn codes_in(text: &str, dialect: &'static Dialect, context: &CheckContext) -> Vec<&'static str> {
    let (_, check) = check_source(text.to_owned(), dialect, context);
    check.diagnostics.iter().map(|found| found.code).collect()
}

fn codes(blocks: &str) -> Vec<&'static str> {
    codes_in(
        &format!("%\n{blocks}\nM30\n"),
        dgshape(),
        &CheckContext::default(),
    )
}

const NONE: [&str; 0] = [];

#[test]
fn dgshape_g04_needs_its_time() {
    assert_eq!(codes("G04"), ["E0111"]);
    assert_eq!(codes("G04P100"), NONE);
    assert_eq!(codes("G04X1."), NONE);
    assert_eq!(codes("G04X1.P1"), ["E0113"]);
}

/// 2-5: the minimum feedrate is set if the specified one is less.
#[test]
fn dgshape_f_below_the_least_feedrate_counts_as_that() {
    let mut context = CheckContext::default();
    for (f, is_motion) in [("F0", false), ("F-5.", false), ("F0.5", true)] {
        let text = format!("%\nM03\nG01X1.{f}\nM30\n");
        context.options = NcOptions::default();
        assert_eq!(codes_in(&text, dgshape(), &context), NONE, "{f}");
        // without a least feedrate it must move
        context.options.min_feedrate_mm_min = 0.0;
        assert_eq!(codes_in(&text, dgshape(), &context).is_empty(), is_motion, "{f}");
    }
    for f in ["F0", "F-5."] {
        let text = format!("G01X1{f}\nM30\n");
        let told = codes_in(&text, nj(), &CheckContext::default());
        assert!(!told.is_empty(), "dialect nj has no least feedrate: {f}");
    }
}

/// 2-4: when a value less than the minimum speed is specified, the minimum speed is used.
#[test]
fn dgshape_s_below_the_least_speed_is_no_error() {
    assert_eq!(codes("M03S-5"), NONE);
    assert_eq!(codes("M03S0"), NONE);
}

/// 2-2: Q is within range 1, which has both signs.
#[test]
fn dgshape_q_of_g83_has_either_sign() {
    assert_eq!(codes("M03\nG83Z-5.R1.Q-1.F100."), NONE);
}

#[test]
fn dgshape_an_arc_that_ends_beside_its_circle_is_doubted() {
    let arc = |blocks: &str| codes(&format!("M03F100.\nG00X10.Y0.\n{blocks}"));
    assert_eq!(arc("G03X0.Y10.I-10.J0."), NONE);
    // rounded to three decimals, or by less than a hundredth of the radius
    assert_eq!(arc("G03X0.Y10.001I-10.J0."), NONE);
    assert_eq!(arc("G03X0.Y10.09I-10.J0."), NONE);
    assert_eq!(arc("G03X0.Y10.2I-10.J0."), ["W0017"]);
    // the centre as a position, as some controls have it
    assert_eq!(arc("G03X0.Y10.I1.J0."), ["W0017"]);
    assert_eq!(arc("G91G03X-10.Y10.I1.J0."), ["W0017"]);
    // in the other planes, and in the one that the block selects
    assert_eq!(codes("M03F100.\nG00X10.Z0.\nG18G02X0.Z10.I-10.K0."), NONE);
    assert_eq!(codes("M03F100.\nG00X10.Z0.\nG18G02X0.Z10.I3.K0."), ["W0017"]);
    // a radius, a full circle, and a start that the text does not show
    assert_eq!(arc("G03X0.Y10.R10."), NONE);
    assert_eq!(arc("G03I-10."), NONE);
    assert_eq!(codes("M03F100.\nG03X0.Y10.I1.J0."), NONE);
}

#[test]
fn nj_spirals_are_meant() {
    let text = "G00 X10 Y0\nG03 X0 Y15 I-10 J0 F100\nM30\n";
    assert_eq!(codes_in(text, nj(), &CheckContext::default()), NONE);
}
