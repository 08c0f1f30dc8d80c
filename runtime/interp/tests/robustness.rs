//! No text makes the parser, checker or interpreter panic or run endlessly, and all three agree on errors.
//! The texts are seeded: each run uses the same texts.

mod properties;
mod random;

use properties::all as examine;
use random::Random;

/// Texts from which mutations begin: each construct of the language, valid and invalid.
const CORPUS: &[&str] = &[
    "N10 G17 G54 G90 G01 ta100 td100 ts50 F1000 X10.5 Y-.5 Z5.\n/1 N20 G00 X0\nM100 VA1 VB-2 VH3\nM98 P1000 L2\nM30\n",
    "g91g61x1y2z3a4b5c6\ng09x1\nx1g09\ng64\ng04p100\ng04x1\ng04f.5\nm00\nm01\nm02\n",
    "// comment\n/* block\ncomment */ X1 /* in */ Y2\r\n\t/1/2/31 X3\n/ X4\nM99\n",
    "L12=10 Q34=-20 P5=+1\nL1 = P3 + 2*sin(30) - (4 % 3) / -L2\nG01 X[L12] Y[Q34] VA[_CNC_CapturedPosition2]\nM30",
    "if (L1==1) { X1 } else { X2 }\nwhile(L1<3) { L1=L1+1 }\ndo X1 while(1==2)\nswitch(L1) { case 1: X1 break default: X2 }\nM30",
    "G02 X1 I1\nG84 Z-5 R2 P1 K2\nX1 R5\nG05\nM200\nM3 M4\nX1 X2\nG90 G91\nW5\nX1,2\nX--1\n(c)\n%\nO1000\n",
    "X\nG\nM\nN\nVA\nta\nX[\nX[L\nX[L1\nL1=\nL1=(\nif\nif(\nif(1\n{\n}\n/\n/*",
    "G18 G20 G41 G01 X5\nG02 Z5 K2\nG40 X9\nG43 Z1\nG49\nG28 X0\nG30 P3\nG31 Z-5\nX[_CNC_CapturedPosition1]\nG51 X1 P2\nG51.1 Y3\nG68 R30\nG52 X1\nG53 X0\nG500\nM30",
    "G91 G99 S300 F100 G84 X1 Z-5 R-2 P1 K3\nG98 X1\nG80\nP1=L0/0 Q1=isnan(P1)\nwhile(Q1<3){Q1=Q1+1 if(Q1==2) break}\nX[P1]\nM30",
    "S8000 M03 X1000000 F0.000000001\nM98\nM98 P999\nG50.1 G501 G40\nM191\n",
    "%\nO0001 (plate)\nN10 G21 G90 G54\nG92X0Y0Z0\nG10P1R3.0\nG10L2P0X1.\nM06T1\nS60M03\nG00X8.0Y8.0\nG43H1Z5.\nF300.\n/G01Z-7.\nM05\nM30\n%\nrest",
    "%\nF60.S100M03\nG41D1G00X10.\nG01Y10.\nG39X20.Y10.\nX20.\nG03X30.Y20.R10.\nG40G00X0Y0\nG51X0P2.\nG98G83X1.Z-5.R2.Q1.K2\nX2.\nG80\nG50\nG91G28Z0\nG90G53X0\nG04P100\nM02",
    "%\nG20\nG18G02X1Z1I1\nG19\nA90\nG49\nG99G89Z-1R1P5\nM01\nT5\nD1\n(not closed\nX[L1]\nO5\n% x",
    "\u{feff}X1 \u{e4} \u{0} \u{7f}\nM30",
];

/// Texts that mutations insert.
const PIECES: &[&str] = &[
    "G",
    "M",
    "X",
    "/",
    "//",
    "/*",
    "*/",
    "(",
    ")",
    "{",
    "}",
    "[",
    "]",
    "=",
    "==",
    ",",
    "%",
    "-",
    "+",
    ".",
    "\n",
    "\r\n",
    " ",
    "9",
    "0",
    "1e9",
    "M30",
    "M99",
    "M98 P1",
    "L1=",
    "if(",
    "else",
    "while",
    "do",
    "switch",
    "_CNC_CapturedPosition",
    "VA",
    "ta",
    "N1",
    "/31",
    "999999999999999999999999",
    "\u{e4}",
    "\u{1f600}",
    "\0",
    "G04",
    "G41D1",
    "G81Z-1.",
    "M06T1",
    "sin(",
];

/// Returns a random position between two characters of a text.
fn boundary(random: &mut Random, text: &str) -> usize {
    let mut at = random.below(text.len() + 1);
    while !text.is_char_boundary(at) {
        at -= 1;
    }
    at
}

fn mutate(text: &mut String, random: &mut Random) {
    let (a, b) = (boundary(random, text), boundary(random, text));
    let (from, to) = (a.min(b), a.max(b).min(a.min(b) + 20));
    let to = (from..=to)
        .rev()
        .find(|at| text.is_char_boundary(*at))
        .unwrap_or(from);
    match random.below(4) {
        0 => text.replace_range(from..to, ""),
        1 => {
            let copy = text[from..to].to_owned();
            let at = boundary(random, text);
            text.insert_str(at, &copy);
        }
        _ => text.insert_str(from, PIECES[random.below(PIECES.len())]),
    }
}

#[test]
fn the_corpus_itself_is_read() {
    for source in CORPUS {
        examine(source);
    }
}

#[test]
fn the_corpus_of_the_fuzzers_is_read() -> std::io::Result<()> {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fuzz/corpus");
    let mut files = 0;
    for entry in std::fs::read_dir(folder)? {
        let bytes = std::fs::read(entry?.path())?;
        examine(&String::from_utf8_lossy(&bytes));
        files += 1;
    }
    assert!(files > 0);
    Ok(())
}

#[test]
fn mutated_programs_are_read_and_run_without_a_panic() {
    let mut random = Random(0x7a4d_e311_0000_0001);
    for round in 0..6000 {
        let mut text = CORPUS[round % CORPUS.len()].to_owned();
        for _ in 0..=random.below(8) {
            mutate(&mut text, &mut random);
        }
        examine(&text);
    }
}

#[test]
fn random_bytes_are_read_without_a_panic() {
    let mut random = Random(0x1234_5678_9abc_def1);
    for _ in 0..1000 {
        let bytes: Vec<u8> = (0..random.below(200))
            .map(|_| u8::try_from(random.below(256)).unwrap_or(0))
            .collect();
        examine(&String::from_utf8_lossy(&bytes));
    }
}

#[test]
fn long_lines_and_deep_nesting_are_read_in_a_moment() {
    for piece in [
        "(", "{", "[", "-", "L1=(", "if(", "if(1){", "else ", "/", "/*", "X", "X1 ", "ä", "do{", "N1", "VA[",
    ] {
        examine(&piece.repeat(50_000));
        examine(&format!("{}\nM30", format!("{piece}\n").repeat(5_000)));
        examine(&format!("L1={}", piece.repeat(50_000)));
        examine(&format!("if(1) {}", piece.repeat(50_000)));
    }
}
