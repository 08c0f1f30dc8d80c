//! Example programs for the codes of a dialect: one for each family of codes, without the first and last
//! lines.

use crate::codes::{Code, Example};
use crate::dialect::Dialect;

/// Example programs of dialect nj.
pub static NJ: &[Example] = &[
    (&["G00", "G01"], "G90 G00 X10 Y10\nG01 X40 F600\nY30\nG00 X0 Y0"),
    (
        &["G02", "G03"],
        "G90 G00 X10 Y10\nG02 X30 Y10 R10 F600\nG03 X50 Y10 I10 J0\nG00 Y0",
    ),
    (&["G04"], "G90 G01 X20 F600\nG04 P500 // half a second\nY10"),
    (
        &["G09", "G61", "G64"],
        "G64 G90 G01 X20 F6000\nY20\nX40 G09 // stops here\nY0\nG61 X60 // and from here on\nY20",
    ),
    (
        &["G17", "G18", "G19"],
        "G90 G18 G00 X10 Z0\nG02 X30 Z0 R10 F600\nG17 G02 X50 Y0 R10",
    ),
    (&["G20"], "G20 G90 G01 X1 Y0.5 F24 // inches"),
    (&["G21"], "G21 G90 G01 X25.4 Y12.7 F600"),
    (&["G28", "G30"], "G90 G01 X20 Y20 F600\nG91 G28 X0 Y0\nG30 P2 X0"),
    (
        &["G31"],
        "G90 G01 X10 F600\nG31 X40 // ends where a skip input comes\nG01 X0",
    ),
    (
        &["G40", "G41", "G42"],
        "M100 VA5 // a tool with a radius\nG90 G00 X-20 Y0\nG41 G01 X0 Y0 F600 // lead in\nY30\nX40\nY0\nX0\nG40 X-20 Y-20 // lead out",
    ),
    (
        &["G43", "G44", "G49"],
        "M100 VA5 // a tool with a length\nG43 G90 G00 Z20\nG01 Z5 F300\nG49 G00 Z50",
    ),
    (
        &["G50", "G51"],
        "G90 G51 X0 Y0 P2\nG01 X10 Y10 F600 // ends at 20, 20\nG50 X0 Y0",
    ),
    (
        &["G50.1", "G51.1"],
        "G90 G51.1 X0\nG01 X10 Y10 F600 // ends at -10, 10\nG50.1\nX0 Y0",
    ),
    (
        &["G52"],
        "G52 X20 Y10\nG90 G01 X10 Y10 F600 // ends at 30, 20\nG52 X0 Y0",
    ),
    (&["G53"], "G54 G90 G01 X10 F600\nG53 X0 Y0 // of the machine"),
    (
        &["G54", "G55", "G56", "G57", "G58", "G59"],
        "G54 G90 G00 X0 Y0\nG01 X10 F600\nG55 X0",
    ),
    (
        &["G68", "G69"],
        "G90 G68 X0 Y0 R30\nG01 X40 F600\nY10\nG69\nX0 Y0",
    ),
    (
        &["G74", "G84", "G80", "G98", "G99"],
        "S500\nG90 G00 X10 Y10 Z5\nG99 G84 X10 Z-10 R2 F500\nG98 X30\nG80",
    ),
    (
        &["G90", "G91"],
        "G90 G01 X20 F600 // to X 20\nG91 X10 // to X 30\nY10",
    ),
    (
        &["G500", "G501"],
        "G500 G64 G90 G01 X20 F6000\nX40 Y5\nX60 Y0\nG501",
    ),
    (
        &["M00", "M01"],
        "G90 G01 X20 F600\nM00 // waits for resume\nM01 // where optional stop is on\nX40",
    ),
    (&["M02", "M30"], "G90 G01 X20 F600"),
    (&["M98"], "G90 M98 P1000 L2 // program 1000 twice\nG00 X0"),
    (&["M99"], "G91 G01 X10 F600 // a subprogram, such as 1000.nc\nM99"),
    (
        &["M"],
        "G90 G01 X20 F600\nM100 VA5 VB0.5 // waits for its reset\nX40",
    ),
];

/// Example programs of dialect dgshape.
pub static DGSHAPE: &[Example] = &[
    (&["G00", "G01"], "G90G00X10.Y10.\nG01X40.F600.\nY30.\nG00X0Y0"),
    (
        &["G02", "G03"],
        "G90G00X10.Y10.\nG02X30.Y10.R10.F600.\nG03X50.Y10.I10.J0\nG00Y0",
    ),
    (&["G04"], "G90G01X20.F600.\nG04P500 (half a second)\nY10."),
    (
        &["G10", "G54", "G55", "G56", "G57", "G58", "G59"],
        "G10L2P1X10.Y5.\nG54G90G00X0Y0 (at 10, 5)\nG01X10.F600.",
    ),
    (
        &["G17", "G18", "G19"],
        "G90G18G00X10.Z0\nG02X30.Z0R10.F600.\nG17G02X50.Y0R10.",
    ),
    (&["G20"], "G20G90G01X1.Y0.5F24. (inches)"),
    (&["G21"], "G21G90G01X25.4Y12.7F600."),
    (&["G28"], "G90G01X20.Y20.F600.\nG91G28X0Y0Z0"),
    (
        &["G39", "G40", "G41", "G42"],
        "G90G00X-20.Y0\nG41D1G01X0Y0F600. (lead in)\nY30.\nG39\nX40.\nY0\nX0\nG40G00X-20.Y-20. (lead out)",
    ),
    (&["G43", "G49"], "M06T1\nG43H1G90G00Z10.\nG01Z-2.F300.\nG49"),
    (
        &["G50", "G51"],
        "G90G51X0Y0P2.\nG01X10.Y10.F600. (ends at 20, 20)\nG50",
    ),
    (&["G53"], "G54G90G01X10.F600.\nG90G53X0Y0"),
    (
        &["G80", "G81", "G82", "G83", "G85", "G86", "G89", "G98", "G99"],
        "S6000M03\nG90G00X10.Y10.Z20.\nG99G83X10.Y10.Z-8.R2.Q3.F200.\nX40.\nG98Y30.\nG80\nM05",
    ),
    (
        &["G90", "G91"],
        "G90G01X20.F600. (to X 20)\nG91X10. (to X 30)\nY10.",
    ),
    (&["G92"], "G90G01X20.F600.\nG92X0 (here is X 0 now)\nG01X10."),
    (
        &["M00", "M01"],
        "G90G01X20.F600.\nM00 (waits for resume)\nM01 (where optional stop is on)\nX40.",
    ),
    (&["M02", "M30"], "G90G01X20.F600."),
    (&["M03", "M05"], "S6000M03\nG90G01X20.F600.\nM05"),
    (&["M06"], "M06T1\nG90G01X20.F600."),
    (
        &["M12", "M13", "M14", "M15", "M16", "M17"],
        "M12 (on)\nG90G01X20.F600.\nM13 (off)",
    ),
];

impl Dialect {
    fn example_of(&self, code: &Code) -> Option<&'static Example> {
        let mut examples = self.g_codes.examples.iter();
        examples.find(|(codes, _)| codes.contains(&code.code))
    }

    /// Returns the file name of the picture of a code's example program, and whether the program moves in Z.
    pub fn picture(&self, code: &Code) -> Option<(String, bool)> {
        let (codes, blocks) = self.example_of(code)?;
        let name = format!("{}-{}.svg", self.name, codes.first()?.to_lowercase());
        Some((name, blocks.contains('Z')))
    }

    /// Returns the example program of a code, complete as in a file.
    pub fn example(&self, code: &Code) -> Option<String> {
        let (_, blocks) = self.example_of(code)?;
        let end = if blocks.ends_with("M99") { "" } else { "M30\n" };
        let (before, after) = match (self.grammar)().program_form.mark {
            Some(_) => ("%\nO1\n", "%\n"),
            None => ("", ""),
        };
        Some(format!("{before}{blocks}\n{end}{after}"))
    }
}

#[cfg(test)]
mod tests {
    use crate::dialects::{dgshape, nj};
    use crate::{CheckContext, check_source};

    #[test]
    fn every_code_has_a_clean_example_with_it_or_a_code_of_its_family() {
        for dialect in [nj(), dgshape()] {
            for code in dialect.g_codes.codes.iter().chain(dialect.m_codes.codes) {
                let text = dialect
                    .example(code)
                    .unwrap_or_else(|| panic!("{} {}", dialect.name, code.code));
                let (_, check) = check_source(text.clone(), dialect, &CheckContext::default());
                assert!(
                    check.diagnostics.is_empty(),
                    "{} {}: {:?}\n{text}",
                    dialect.name,
                    code.code,
                    check.diagnostics
                );
            }
        }
    }
}
