//! Formatting of programs.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use tandem_syntax::{Grammar, format, tokens};

fn nj(text: &str) -> String {
    format(text, Grammar::nj()).unwrap_or_else(|found| panic!("{found:?} in {text:?}"))
}

fn dgshape(text: &str) -> String {
    format(text, Grammar::dgshape()).unwrap_or_else(|found| panic!("{found:?} in {text:?}"))
}

#[test]
fn one_blank_stands_between_words_and_none_within() {
    assert_eq!(
        nj("n10g01  x 10\tY-.5f1000 \nM100VA1 vb-2.50\n"),
        "N10 G01 X10 Y-.5 F1000\nM100 VA1 VB-2.50\n"
    );
    assert_eq!(nj("TA40td 40Ts20\n"), "ta40 td40 ts20\n");
    assert_eq!(nj("x[ l12 ]y [Q3]\n"), "X[L12] Y[Q3]\n");
    assert_eq!(nj("x[_cnc_capturedposition2]\n"), "X[_CNC_CapturedPosition2]\n");
}

#[test]
fn block_skips_stand_apart() {
    assert_eq!(
        nj("/n10x1\n/1/2/31X3\n/ / X1\n"),
        "/ N10 X1\n/1 /2 /31 X3\n/ / X1\n"
    );
    assert_eq!(dgshape("/G01Z-7.\n"), "/ G01 Z-7.\n");
}

#[test]
fn operators_stand_between_blanks_and_signs_do_not() {
    assert_eq!(
        nj("L1=P3+2*SIN ( 30 )-(4%3)/-L2 Q2=- -1\n"),
        "L1 = P3 + 2 * sin(30) - (4 % 3) / -L2 Q2 = --1\n"
    );
    assert_eq!(nj("l1=+5 l2=atan2d( 1,l3 )\n"), "L1 = +5 L2 = atan2d(1, L3)\n");
    assert_eq!(
        nj("IF(l1==1&&! (l2>=3||ISNAN(l3)))x1\n"),
        "if (L1 == 1 && !(L2 >= 3 || isnan(L3))) X1\n"
    );
    assert_eq!(nj("L1 = L2 / /* by */ L3\n"), "L1 = L2 / /* by */ L3\n");
}

#[test]
fn commands_of_branches_loops_and_cases_are_indented() {
    let text = "\
if(L1==1){
X1
if(L2==2)
X2
else if(L2==3)
X3
else
X4
}else{
while(L1<3)
{
L1=L1+1
}
}
do
X1
while(L1<2)
do{
X2
}while(1==2)
switch(L1){
// one
case 1:
X1
break
default:
X2
}";
    let laid_out = "\
if (L1 == 1) {
    X1
    if (L2 == 2)
        X2
    else if (L2 == 3)
        X3
    else
        X4
} else {
    while (L1 < 3)
    {
        L1 = L1 + 1
    }
}
do
    X1
while (L1 < 2)
do {
    X2
} while (1 == 2)
switch (L1) {
        // one
    case 1:
        X1
        break
    default:
        X2
}
";
    assert_eq!(nj(text), laid_out);
    assert_eq!(nj(laid_out), laid_out);
}

#[test]
fn an_else_is_indented_with_the_if_that_it_belongs_to() {
    let text = "\
if(L1==1)
if(L1==2)
X1
else
X2
else
X3
while(L1<9) L1=L1+1
M30";
    let laid_out = "\
if (L1 == 1)
    if (L1 == 2)
        X1
    else
        X2
else
    X3
while (L1 < 9) L1 = L1 + 1
M30
";
    assert_eq!(nj(text), laid_out);
    assert_eq!(nj(laid_out), laid_out);
}

#[test]
fn comments_keep_their_text_and_those_that_stand_apart_their_column() {
    assert_eq!(
        nj("  //  A  b\nX1// c\nG00X1      // d \nG01 X1 Y2 Z3  /* e */\n/* f\n  g */x1 /*h*/ y 2\n"),
        "//  A  b\nX1 // c\nG00 X1     // d\nG01 X1 Y2 Z3  /* e */\n/* f\n  g */ X1 /*h*/ Y2\n"
    );
    assert_eq!(nj("X /* a */ 1\n"), "X /* a */ 1\n");
    let apart = nj("G1X1Y1  // a\n");
    assert_eq!(apart, "G1 X1 Y1  // a\n");
    assert_eq!(nj(&apart), apart);
}

#[test]
fn line_ends_are_those_of_the_first_line_and_the_text_ends_with_one() {
    assert_eq!(nj("X1\r\nX2\n\r\n\r\n"), "X1\r\nX2\r\n");
    assert_eq!(nj("X1\nX2\r\n/*\r\n*/\r\n"), "X1\nX2\n/*\n*/\n");
    assert_eq!(nj("X1"), "X1\n");
    assert_eq!(nj(" \r\n\n"), "");
    assert_eq!(
        nj("\u{feff}x1\n\n\nx2"),
        "\u{feff}X1\n\n\nX2\n",
        "blank lines count"
    );
}

#[test]
fn marks_numbers_and_what_follows_the_program_stay() {
    assert_eq!(
        dgshape(" %\no0001(plate)\nn10g21g90\nG92X0Y0Z0\nm30\n%\nrest  x1\n"),
        "%\nO0001 (plate)\nN10 G21 G90\nG92 X0 Y0 Z0\nM30\n%\nrest  x1\n"
    );
}

#[test]
fn a_line_that_would_become_too_long_for_a_block_stays() {
    let words = "X1Y1".repeat(255);
    let text = format!("  {words}  \n");
    assert_eq!(nj(&text), format!("{words}\n"), "{} bytes", words.len());
}

#[test]
fn a_program_with_errors_is_not_laid_out() {
    let found = format("x1\nx 1 (c)\n", Grammar::nj()).unwrap_err();
    assert_eq!(found[0].code, "E0003");
}

#[test]
fn every_text_has_tokens() {
    for (text, count) in [
        ("", 0),
        ("\u{e4} \u{1f600}", 2),
        ("G01X", 3),
        ("(a", 2),
        ("/* a", 1),
        ("X-", 2),
    ] {
        assert_eq!(tokens(text, Grammar::nj()).count(), count, "{text:?}");
    }
}
