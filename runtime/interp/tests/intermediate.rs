//! The intermediate code, by the rules of appendix A-1 and D43.

use tandem_interp::dialects;
use tandem_syntax::{Grammar, Header, compile, parse};

fn check(source: &str, header: Header, expect: &[&str]) {
    let (program, findings) = parse(source, Grammar::nj());
    assert!(findings.is_empty(), "{findings:?}");
    let code = compile(&program, header, dialects::nj());
    assert_eq!(code.lines().collect::<Vec<_>>(), expect, "{source:?}");
    assert!(code.ends_with('\n'));
}

#[test]
fn a_main_program_with_all_constructs() {
    let source = "// drilling plate\n\
        n1 g17 G90 G64 F500 ta100\n\
        /2 N7 G00 X 5.50 /* clear */ Y-1\n\
        \n\
        /1/31 X[Q12] Z[_CNC_CapturedPosition3]\n\
        N9 while(L1 < 4 && !(L2==1)) { L1=L1+1 X[L1]\n\
        }\n\
        M150 VA1.5 VH[L3]\n\
        M98 P2000 L2\n\
        G98 G74 X1 Z-3 R2 P500\n\
        G99 X2\n\
        G98\n\
        Y4 K2\n\
        G80\n\
        X3\n\
        M30";
    check(
        source,
        Header::Program(7),
        &[
            "open prog 7",
            "N2 G17 G90 G64 F500 ta100 M999.002",
            "cskip2 N3 G00 X5.50 Y-1 M999.002",
            "cskip1 cskip31 N5 X(Q12) Z(_CNC_CapturedPosition3) M999.002",
            "while(L1 < 4 && !(L2 == 1))",
            "{",
            "L1 = L1 + 1",
            "N6 X(L1) M999.002",
            "}",
            "N8 M150 A1.5 H(L3) M999.002",
            "N9 M98 P2000 L2 M999.002",
            "N10 G98 G80.001 G74 X1 Z-3 R2 P500 M999.002",
            "N11 G99 G74 X2 M999.002",
            "N12 G98 M999.002",
            "N13 G74 Y4 K2 M999.002",
            "N14 G80 M999.002",
            "N15 X3 M999.002",
            "N16 M30 M999.002",
            "close",
        ],
    );
}

#[test]
fn d43_return_stands_once_for_each_m99() {
    check(
        "G04 P5\nM99",
        Header::Subprogram(1000),
        &[
            "open subprog 1000",
            "N1 G04 P5 M999.002",
            "N2 M99 M999.002 return",
            "close",
        ],
    );
    check(
        "if(L1==1) M99\nX1",
        Header::Subprogram(3000),
        &[
            "open subprog 3000",
            "if(L1 == 1)",
            "N1 M99 M999.002 return",
            "N2 X1 M999.002",
            "return",
            "close",
        ],
    );
    check(
        "M99",
        Header::Program(1),
        &["open prog 1", "N1 M99 M999.002 return", "close"],
    );
}

#[test]
fn a_cycle_begins_again_after_its_end() {
    check(
        "G84 Z-1 R1\nG84 X1\nG01 X2\nX3\nG74 X4",
        Header::Program(1),
        &[
            "open prog 1",
            "N1 G80.001 G84 Z-1 R1 M999.002",
            "N2 G84 X1 M999.002",
            "N3 G01 X2 M999.002",
            "N4 X3 M999.002",
            "N5 G80.001 G74 X4 M999.002",
            "close",
        ],
    );
}

#[test]
fn program_codes_have_lines_of_their_own() {
    check(
        "do L1=-(1+2)*3-(4-5) while(isnan(L1)||L1==2&&L2!=3)\nswitch(atan2(L1,2)){\ncase -1: break\ndefault: X1\n}\nif(L1==1) X1 else { }",
        Header::Program(1),
        &[
            "open prog 1",
            "do",
            "L1 = -(1 + 2) * 3 - (4 - 5)",
            "while(isnan(L1) || L1 == 2 && L2 != 3)",
            "switch(atan2(L1, 2))",
            "{",
            "case -1:",
            "break",
            "default:",
            "N4 X1 M999.002",
            "}",
            "if(L1 == 1)",
            "N6 X1 M999.002",
            "else",
            "{",
            "}",
            "close",
        ],
    );
}
