//! Random programs of dialect dgshape, with blocks that are valid in some states and invalid in others.

use crate::random::Random;

const BLOCKS: &[&str] = &[
    "X1.0",
    "X1.0Y2.0Z3.0",
    "G00X5.0",
    "G01X3.0Y1.0",
    "G01Z-2.0",
    "G02X4.0R9.0",
    "G02X4.0I2.0",
    "G03Y5.0J2.0",
    "G03I5.0",
    "X1.0R5.0",
    "X2.0I1.0",
    "Y20.0",
    "X-20.0",
    "X20.0Y20.0",
    "G91",
    "G90",
    "G91G01X1.0",
    "G17",
    "G18",
    "G19",
    "G02X1.0",
    "G41D1X9.0",
    "G01G42D1Y9.0",
    "G41D2X20.0",
    "G00G41D1X30.0Y5.0",
    "G41D1",
    "G42D2",
    "D2",
    "G40",
    "G40G01X0Y0",
    "G40G00X-20.0",
    "G40X50.0",
    "G39X5.0",
    "G39",
    "G43H1",
    "G43H2Z5.0",
    "G43H0",
    "G49",
    "G28X0",
    "G28Z5.0",
    "G28",
    "G53X1.0",
    "G90G53Z0",
    "G81X1.0Z-5.0R2.0",
    "G82X2.0Y1.0Z-5.0R2.0P100",
    "G83Z-6.0R1.0Q2.0",
    "G83X3.0Z-6.0R1.0Q1.5K2",
    "G85Z-5.0R2.0",
    "G86X4.0Z-3.0R1.0",
    "G89X5.0Z-3.0R1.0P50K3",
    "X3.0Y3.0R1.0",
    "K0",
    "G80",
    "G98",
    "G99",
    "G51X0Y0Z0P2.0",
    "G51P0.5",
    "G51P0.0001",
    "G50",
    "G10L2P1X1.0",
    "G10L2P0Z0.5",
    "G10P1R3.0",
    "G10P2R0.5",
    "G10P1R-2.0",
    "G92X0Y0Z0",
    "G92X1.0",
    "G54",
    "G59",
    "G04X1.0",
    "G04P10",
    "M03",
    "M03S6000",
    "M05",
    "S50",
    "F300.0",
    "F0.1",
    "F0",
    "M06T1",
    "G28G91Z0",
    "M12",
    "M13",
    "M00",
    "M01",
    "A90.0",
    "G01A45.0",
    "G01X1.0A5.0",
    "G00Z5.0",
    "(comment)",
    "N00000001G01X2.0",
    "G20",
    "G21",
    "G02X3.0Y3.0R-5.0",
    "G02Z-1.0X4.0I2.0",
    "G18G02X4.0K2.0",
    "G19G03Y2.0J1.0",
    "G00",
    "G01",
    "G01X0Y0",
];

const RADII: &[&str] = &["3.0", "1.0", "5.0", "0"];

/// Returns the program for a seed.
pub fn text(seed: u64) -> String {
    let random = &mut Random(seed | 1);
    let mut lines = vec!["%".to_owned(), "G21".to_owned()];
    if random.below(3) > 0 {
        lines.push("G90G54G17F500.0M03S6000".to_owned());
    }
    for number in 1..=2 {
        if random.below(2) == 0 {
            lines.push(format!("G10P{number}R{}", random.of(RADII)));
        }
    }
    for _ in 0..=random.below(14) {
        let skip = if random.below(12) == 0 { "/" } else { "" };
        lines.push(format!("{skip}{}", random.of(BLOCKS)));
    }
    lines.push(
        random
            .of(&["G80\nG40", "G80\nG40G01X0Y0", "G40\nG01X0Y0", "G80"])
            .to_owned(),
    );
    lines.push(format!("{}\n%\n", random.of(&["M30", "M02"])));
    lines.join("\n")
}
