//! Random programs, with blocks that are valid in some states and invalid in others.

#[path = "dgshape_programs.rs"]
mod dgshape_programs;

use std::collections::BTreeMap;
use std::fmt::{self, Write as _};
use std::sync::Arc;

use tandem_interp::dialects::{dgshape, nj};
use tandem_interp::{Check, CheckContext, Dialect, check_source};
use tandem_syntax::{NcProgram, parse};

use crate::random::Random;

/// Blocks that are valid in some states and invalid in others.
const BLOCKS: &[&str] = &[
    "X1",
    "X1 Y2 Z3",
    "G00 X5",
    "G01 X3 Y1",
    "G02 X4 R9",
    "G02 X4 I2",
    "G03 Y5 J2",
    "X1 R5",
    "X2 I1",
    "G91",
    "G90",
    "G91 G01 X1",
    "G17",
    "G18",
    "G19",
    "G02 X1",
    "G41 X9",
    "G01 G42 Y9",
    "G40",
    "G40 G01 X0 Y0",
    "G43",
    "G49",
    "G28 X0",
    "G53 X1",
    "G30 P2 X1",
    "G84 X1 Z-5 R2 P100",
    "G74 X1 Z-5 R2 P100 K2",
    "X3 Y3 R1",
    "G80",
    "G98",
    "G99",
    "G51 X0 Y0 Z0 P2",
    "G50",
    "G68 X0 Y0 R30",
    "G69",
    "G51.1 X0",
    "G50.1",
    "G20",
    "G21",
    "G52 X1",
    "G54",
    "G55",
    "G04 P10",
    "M100 VA1",
    "M08",
    "M00",
    "M01",
    "F[L1]",
    "X[L2]",
    "G04 P[L3]",
    "X[L1] Y[L2]",
    "G09 X1",
    "G61",
    "G64",
    "G500",
    "G501",
    "S[L4] F200",
    "F0.1",
    "L5",
    "P100",
];
const ASSIGNMENTS: &[&str] = &[
    "L1=5",
    "L1=0",
    "L1=L1+1",
    "L2=L1*400000",
    "L2=1000/L1",
    "L3=sqrt(L1-2)",
    "L3=L2%3",
    "L4=2000000",
    "L4=0-L1",
    "Q1=L1",
    "L1=Q1",
    "P1=7",
    "L2=P1*1000000",
    "L3=asin(L1)",
    "L1=atan2(L2,L3)",
];
const CONDITIONS: &[&str] = &[
    "P5==1",
    "L1<3",
    "L2==0",
    "Q7>2",
    "L1>100",
    "!(P6>2)",
    "L1==1||P8==2",
    "P9==1&&L3>=0",
    "isnan(L2)",
];

fn commands(random: &mut Random, depth: usize, calls: &[u16], text: &mut String) {
    for _ in 0..=random.below(4) {
        let _ = match random.below(16) {
            0 if depth > 0 => {
                let _ = writeln!(text, "if({}) {{", random.of(CONDITIONS));
                commands(random, depth - 1, calls, text);
                if random.below(2) == 0 {
                    let _ = writeln!(text, "}} else {{");
                    commands(random, depth - 1, calls, text);
                }
                writeln!(text, "}}")
            }
            1 if depth > 0 => {
                let counter = 10 + depth;
                let _ = writeln!(text, "L{counter}=0\nwhile(L{counter}<{}) {{", random.below(6));
                commands(random, depth - 1, calls, text);
                writeln!(text, "L{counter}=L{counter}+1 }}")
            }
            2 if depth > 0 => {
                let _ = writeln!(
                    text,
                    "switch({}) {{ case 1:",
                    random.of(&["P3", "L1", "L2", "Q4"])
                );
                commands(random, depth - 1, calls, text);
                let _ = writeln!(text, "break\ncase 5:");
                commands(random, depth - 1, calls, text);
                writeln!(text, "break }}")
            }
            3 if !calls.is_empty() => {
                let number = calls[random.below(calls.len())];
                writeln!(text, "M98 P{number}{}", random.of(&["", "", " L2", " L0"]))
            }
            4 => writeln!(text, "/{} {}", 1 + random.below(3), random.of(BLOCKS)),
            5..8 => writeln!(text, "{}", random.of(ASSIGNMENTS)),
            _ => writeln!(text, "{}", random.of(BLOCKS)),
        };
    }
}

fn program(random: &mut Random, calls: &[u16], end: &str) -> String {
    let mut text = String::from("G90 G54 F500 S100\n");
    if end == "M99" {
        text.clear();
    }
    commands(random, 3, calls, &mut text);
    text + random.of(&["G80 G40\n", "G80\nG40\nG01 X0 Y0\n", ""]) + end
}

/// A main program and the programs that it calls.
pub struct Made {
    pub dialect: &'static Dialect,
    pub main: String,
    pub called: Vec<(u16, String)>,
}

impl Made {
    /// Creates a main program with two called programs, branches, loops and block skip.
    pub fn nj(seed: u64) -> Self {
        let mut random = Random(seed | 1);
        let second = program(&mut random, &[], "M99");
        let first = program(&mut random, &[1001], "M99");
        let main = program(&mut random, &[1000, 1001], "M30");
        Self {
            dialect: nj(),
            main,
            called: vec![(1000, first), (1001, second)],
        }
    }

    /// Creates a program with block skip.
    pub fn dgshape(seed: u64) -> Self {
        Self {
            dialect: dgshape(),
            main: dgshape_programs::text(seed),
            called: Vec::new(),
        }
    }

    pub fn trees(&self) -> (Arc<NcProgram>, BTreeMap<u16, Arc<NcProgram>>) {
        let tree = |text: &str| Arc::new(parse(text, (self.dialect.grammar)()).0);
        let called = self.called.iter().map(|(number, text)| (*number, tree(text)));
        (tree(&self.main), called.collect())
    }

    pub fn check(&self, programs: &BTreeMap<u16, Arc<NcProgram>>, context: CheckContext<'_>) -> Check {
        let context = CheckContext {
            programs: Some(programs),
            ..context
        };
        check_source(self.main.as_str(), self.dialect, &context).1
    }

    pub fn contains(&self, word: &str) -> bool {
        let called = self.called.iter().map(|(_, text)| text);
        std::iter::once(&self.main)
            .chain(called)
            .any(|text| text.contains(word))
    }
}

impl fmt::Display for Made {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.main)?;
        self.called
            .iter()
            .try_for_each(|(number, text)| write!(f, "\n--- {number}\n{text}"))
    }
}
